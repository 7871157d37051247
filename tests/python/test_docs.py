# SPDX-License-Identifier: BSD-3-Clause
"""What the pages of docs/ show is run, page by page, in the order in which a reader would.

With NDTREE_UPDATE_DOCS in the environment, pages get the numbers that their commands print now.
"""

from __future__ import annotations

import importlib.util
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from snippets import ROOT, anchors, blocks, fenced, links, run_cpp

import ndtree
from ndtree.base.options import OPTIONS

DOCS = ROOT / "docs"
PAGES = sorted(path.name for path in DOCS.glob("*.md"))
LONG = {"parameters.md"}
EXECUTED = sorted(
    page
    for page in PAGES
    if {"python", "sh"} & {language for language, _ in fenced((DOCS / page).read_text())}
)


def write_bag_of_office(folder: Path) -> None:
    """`run`, an MCAP bag of a robot with a planar laser: /scan, and poses in /tf and /tf_static."""
    pytest.importorskip("rosbags", reason="rosbags is not installed: no bag to read")
    from bags import Messages, write_bag

    make = Messages("mcap")
    content: list[Any] = []
    content.append(make.fixed(0.0, "base_link", "laser", (0.1, 0.0, 0.3), at=100.0))
    office = ndtree.simulate("office", scans=60)
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    directions = np.column_stack((np.cos(angles), np.sin(angles)))
    noise = np.random.default_rng(1)
    for i, scan in enumerate(office):
        stamp = 100.0 + 0.1 * i
        x, y = scan.origin - (0.1, 0.0)
        ranges = office.distance(np.tile(scan.origin, (len(angles), 1)), directions, max_range=30.0)
        ranges = np.where(np.isnan(ranges), np.inf, ranges + noise.normal(0.0, 0.02, len(angles)))
        pose = make.transform(stamp, "odom", "base_link", (x, y, 0), (0, 0, 0, 1))
        laser = make.laser(
            stamp, "laser", ranges, angle_min=angles[0], angle_max=angles[-1],
            angle_increment=angles[1] - angles[0], range_max=30.0,
        )  # fmt: skip
        content += [("/tf", stamp, make.tf(pose)), ("/scan", stamp, laser)]
    fixed = make.transform(100.0, "map", "odom", (0, 0, 0), (0, 0, 0, 1))
    content.insert(0, ("/tf_static", 100.0, make.tf(fixed)))
    write_bag(folder / "run", make, content)


#: What a page says that its reader has.
GIVEN = {"ros.md": write_bag_of_office, "live.md": write_bag_of_office}


def shape_of(line: str) -> str:
    """A line of output but for its numbers and spaces: those are the machine's, or of the day."""
    return re.sub(r"-?\d[\d,]*(\.\d+)?(e[-+]\d+)?", "#", "".join(line.split()))


def run_shell(code: str) -> str:
    """Run each line that calls ndtree; the others must name a script of ours. Returns what was printed."""
    from calling import cli

    printed = ""
    lines = [line for line in code.replace("\\\n", " ").splitlines() if not line.lstrip().startswith("#")]
    for line in filter(str.strip, lines):
        name, *arguments = shlex.split(line, comments=True)
        assert name == "ndtree", f"{line}: expected a call of ndtree"
        done = cli(*arguments)
        assert done.exit_code == 0, f"{line}: {done.output}"
        printed += done.stdout
    return printed


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=pytest.mark.long) if page in LONG else page for page in EXECUTED]
)
def test_a_page_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for library in ("typer", "matplotlib", "yaml", "PIL", "trimesh", "pypcd4", "meshio"):
        pytest.importorskip(library, reason=f"{library} is not installed: the page's commands need it")
    if page in GIVEN:
        GIVEN[page](tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    printed: str | None = None
    ran = 0
    text = updated = (DOCS / page).read_text()
    for language, code in fenced(text):
        if language == "python":
            with redirect_stdout(io.StringIO()) as said:
                exec(compile(code, page, "exec", dont_inherit=True), names)
            printed = said.getvalue()
            ran += 1
        elif language == "sh":
            printed = run_shell(code)
            ran += 1
        elif language == "text" and printed is not None:
            updated = updated.replace(code, as_printed(code, printed))
    assert ran > 0
    if "NDTREE_UPDATE_DOCS" in os.environ:
        (DOCS / page).write_text(updated)


def as_printed(shown: str, printed: str) -> str:
    """The lines that are shown, with the numbers that were printed; each must have been."""
    lines: dict[str, list[str]] = {}
    for line in printed.splitlines():
        lines.setdefault(shape_of(line), []).append(line)
    result = ""
    for line in shown.splitlines():
        assert not line.strip() or lines.get(shape_of(line)), (
            f"{line!r} is shown, this was printed:\n{printed}"
        )
        result += (lines[shape_of(line)].pop(0) if line.strip() else line) + "\n"
    return result


def test_the_cpp_of_all_pages_compiles_and_runs(tmp_path: Path) -> None:
    """Those of README.md are the last."""
    codes = [code for page in (*PAGES, "../README.md") for code in blocks((DOCS / page).read_text(), "cpp")]
    assert len(codes) >= 3
    assert run_cpp(codes, tmp_path, end="return hit ? 0 : 1;") == 0


def test_scripts_that_pages_name_exist() -> None:
    named = {
        name
        for page in PAGES
        for code in blocks((DOCS / page).read_text(), "bash")
        for name in re.findall(r"^tools/\w+", code, re.MULTILINE)
    }
    assert "tools/demo" in named
    for name in named:
        assert os.access(ROOT / name, os.X_OK), name


def test_flags_that_pages_name_are_in_the_help() -> None:
    """Those of other programs aside."""
    helps = " ".join(one.flags or one.flag for one in OPTIONS if one.of != "node")
    others = {"help", "help-all", "install-completion", "ros-args", "system-site-packages", "tolerances"}
    pages = [page for page in PAGES if page not in ("install.md", "benchmarks.md", "peers.md")]
    named = {
        (page, name)
        for page in pages
        for name in re.findall(r"(?<![\w-])--([a-z][a-z-]+)", (DOCS / page).read_text())
        if name not in others
    }
    assert len(named) > 100
    missing = [one for one in sorted(named) if not re.search(rf"--{one[1]}(?![\w-])", helps)]
    assert not missing


def test_calls_that_pages_name_exist() -> None:
    prose = "\n".join((DOCS / page).read_text() for page in PAGES)
    headers = "\n".join(path.read_text() for path in (ROOT / "include").rglob("*.hpp"))
    methods = set(re.findall(r"\bm\.(\w+)\(", prose))
    functions = set(re.findall(r"\bndtree\.([a-z_]\w+)\(", prose))
    of_cpp = set(re.findall(r"`(?:ndtree::)?(\w+)(?:<[^>]*>+)?\(map\b", prose))
    assert min(len(methods), len(functions), len(of_cpp)) >= 5
    for name in methods:
        assert hasattr(ndtree.AdaptiveMap, name), f"no map has {name}()"
    for name in functions:
        assert hasattr(ndtree, name), f"ndtree has no {name}()"
    for name in of_cpp:
        assert re.search(rf"\b{name}\(", headers), f"no header has {name}()"


def test_comments_of_the_headers_are_what_doxygen_expects(tmp_path: Path) -> None:
    program = shutil.which("doxygen")
    if program is None:
        pytest.skip("no doxygen on PATH")
    settings = (DOCS / "Doxyfile").read_text() + f"OUTPUT_DIRECTORY = {tmp_path}\n"
    done = subprocess.run([program, "-"], input=settings, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "insert" in (tmp_path / "cpp" / "classndtree_1_1OccupancyMap.html").read_text()


def test_headers_that_the_reference_leads_to_exist() -> None:
    named = re.findall(r"\]\((\.\./include/ndtree/\S+\.hpp)\)", (DOCS / "cpp.md").read_text())
    assert len(named) > 10
    for name in named:
        assert (DOCS / name).exists(), name


@pytest.mark.parametrize("page", ["../README.md", *PAGES])
def test_links_lead_to_files_and_headings(page: str) -> None:
    path = DOCS / page
    text = path.read_text()
    for link in links(text):
        assert (path.parent / link).exists(), f"{page}: {link}"
    for link, anchor in re.findall(r"\]\((?!http)([^)#]*)#([^)]+)\)", text):
        target = path.parent / link if link else path
        assert anchor in anchors(target.read_text()), f"{page}: {link}#{anchor}"


@pytest.mark.long
def test_the_site_builds_without_a_warning_and_needs_no_network(tmp_path: Path) -> None:
    for module in ("mkdocs", "material", "mkdocstrings", "typer"):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed: it comes with the extra docs")
    site = tmp_path / "site"
    # Not --quiet: then --strict counts no warnings.
    call = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", site]
    environment = {
        **os.environ,
        "NO_MKDOCS_2_WARNING": "1",
        "PYTHONPATH": str(Path(ndtree.__file__).parents[1]),
    }
    done = subprocess.run(call, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr + done.stdout
    for page in PAGES:
        html = (site / page).with_suffix(".html").read_text()
        loaded = re.findall(
            r"<(?:script|img|iframe)[^>]*\bsrc=\"(https?:[^\"]+)|<link[^>]*\bhref=\"(https?:[^\"]+)", html
        )
        assert not loaded, (page, loaded)
        assert not re.search(r"<!-- (table: \w+|figures: \S+ \w+) -->", html), page
    reference = (site / "python.html").read_text()
    for name in ndtree.__all__:
        if not name.startswith("__"):
            assert re.search(rf'id="ndtree\.([\w.]+\.)?{name}"', reference), f"python.html: no {name}"


def rows_of(page: Path) -> list[tuple[str, str, str]]:
    """Terms, what they are, and where to read on."""
    return re.findall(r"^\| (\*\*.*?) \| (.*?) \| (.*?) \|$", page.read_text(), re.MULTILINE)


GLOSSARY = rows_of(ROOT / "docs" / "glossary.md")
LIBRARY = rows_of(ROOT / "include" / "ndtree" / "TERMS.md")


def test_each_term_is_defined_once_and_leads_somewhere() -> None:
    assert len(GLOSSARY) <= 30, "a user meets no more; terms of the headers are in include/ndtree/TERMS.md"
    rows = GLOSSARY + LIBRARY
    terms = [term for row in rows for term in re.findall(r"\*\*(.*?)\*\*", row[0] + row[1])]
    assert len(terms) > 60
    assert len(set(terms)) == len(terms), sorted(term for term in set(terms) if terms.count(term) > 1)
    for term, _, see in rows:
        assert links(see), f"{term} leads nowhere"
    for term in (
        *("saturated", "well observed", "sampled", "sampling fraction", "sampling key", "bucket"),
        *("cube-map face", "pixel", "bin", "partition", "subdivide", "finalize", "pad", "ray packet"),
        *("beam source", "t_max", "t_free", "child initialisation", "predicted to re-merge"),
        *("cell", "leaf", "node", "level", "hit", "miss", "log-odds", "evidence"),
    ):
        assert term in terms


@pytest.mark.parametrize("name", ["README.md", "TERMS.md"])
def test_links_of_the_library_s_pages_lead_to_files_and_headings(name: str) -> None:
    page = ROOT / "include" / "ndtree" / name
    text = page.read_text()
    found = re.findall(r"\]\((?!http)([^)#]+)(?:#([^)]*))?\)", text)
    assert len(found) > 40
    for target, anchor in found:
        path = (page.parent / target).resolve()
        assert path.exists(), target
        if anchor:
            assert anchor in anchors(path.read_text()), (target, anchor)
    named = set(re.findall(r"`((?:core|tree|cell|mapping|query|layers|io|evaluation)/[\w/]+\.hpp)`", text))
    assert name != "README.md" or len(named) > 40
    for header in named:
        assert (ROOT / "include" / "ndtree" / header).exists(), header
    for test in set(re.findall(r"`(test_\w+\.cpp)`", text)):
        assert any((ROOT / "tests" / "cpp" / folder / test).exists() for folder in (".", "worlds")), test
