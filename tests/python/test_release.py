# SPDX-License-Identifier: BSD-3-Clause
"""``tools/release`` takes a tag whose files agree, and refuses any other in one line that names the file."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = [
    "include/ndtree/version.hpp", "CHANGELOG.md", "package.xml", "CITATION.cff", "debian/changelog",
    "packaging/vcpkg/ndtree/vcpkg.json",
]  # fmt: skip
VERSION = re.search(r'VERSION "([\d.]+)"', (ROOT / FILES[0]).read_text())[1]
OTHER = "77.6.5"


def git(folder: Path, *arguments: str) -> None:
    identity = ["-c", "user.name=nobody", "-c", "user.email=nobody@example.org", "-c", "commit.gpgsign=false"]
    subprocess.run(["git", *identity, *arguments], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """The files that say a version, all of them 77.6.5, committed."""
    if not shutil.which("git"):
        pytest.skip("no git here")
    for name in [
        *FILES,
        "tools/release",
        "tools/with_address",
        "README.md",
        "docs/index.md",
        "pyproject.toml",
    ]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    for name in FILES:
        file = tmp_path / name
        file.write_text(file.read_text().replace(VERSION, OTHER))
    changelog = tmp_path / "CHANGELOG.md"
    changelog.write_text(f"# Changelog\n\n## [{OTHER}] – 2030-01-02\n\n- New.\n\n## [{VERSION}]\n\n- Old.\n")
    readme = tmp_path / "README.md"
    readme.write_text(readme.read_text().replace("**Nothing is released yet** (0.1.0): start", "Start"))
    git(tmp_path, "init")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-m", "all")
    return tmp_path


def release(repository: Path, *arguments: str) -> tuple[int, str, str]:
    done = subprocess.run(
        [repository / "tools/release", *arguments], capture_output=True, text=True, cwd=repository
    )
    return done.returncode, done.stdout, done.stderr


def test_a_tag_whose_files_agree_is_taken(repository: Path) -> None:
    git(repository, "tag", f"v{OTHER}")
    status, out, err = release(repository, f"v{OTHER}")
    assert (status, err) == (0, "")
    assert f"v{OTHER} is consistent" in out
    typed = [line.split()[0] for line in out.splitlines() if line.startswith("  ")]
    assert len(typed) > 6 and f"git push origin HEAD v{OTHER}" in out
    elsewhere = "git", "gh", "dpkg-buildpackage", "bloom-release"
    for program in typed:  # What a maintainer types to publish it is there.
        assert program in elsewhere or (ROOT / program).exists() or program.endswith("python"), program
    assert not (repository / "dist").exists()  # It only says what it would do.


def test_packages_get_the_address_and_links_that_work_anywhere(repository: Path) -> None:
    git(repository, "tag", f"v{OTHER}")
    status, out, err = release(repository, "--address", "https://example.org/us/ndtree/", f"v{OTHER}")
    assert (status, err) == (0, "")
    assert "Without --address" not in out
    assert f"tools/with_address . https://example.org/us/ndtree/ v{OTHER}" in out  # For the wheels.
    before = (repository / "README.md").read_text()
    command = [repository / "tools/with_address", repository, "https://example.org/us/ndtree/", f"v{OTHER}"]
    subprocess.run(command, check=True)
    text = (repository / "README.md").read_text()
    targets = re.findall(r"\]\(([^)]*)\)", text)
    assert len(targets) == len(re.findall(r"\]\(([^)]*)\)", before)) > 10
    for target in targets:
        found = re.fullmatch(rf"https://example.org/us/ndtree/(raw|blob)/v{OTHER}/([^#]*)(#.*)?", target)
        assert found, target
        assert (ROOT / found[2]).exists()
        assert (found[1] == "raw") == found[2].endswith((".png", ".gif"))
    tomllib = pytest.importorskip("tomllib")  # Python 3.11.
    urls = tomllib.loads((repository / "pyproject.toml").read_text())["project"]["urls"]
    assert urls["Homepage"] == "https://example.org/us/ndtree"
    again = subprocess.run(command, capture_output=True, text=True)
    assert again.returncode == 1
    assert again.stderr.endswith("has project URLs already, expected none\n")


def test_a_file_that_says_another_version_is_named(repository: Path) -> None:
    for name in FILES:
        file = repository / name
        good = file.read_text()
        file.write_text(good.replace(OTHER, "77.6.4"))
        git(repository, "commit", "-am", "one")
        git(repository, "tag", "--force", f"v{OTHER}")
        status, _, err = release(repository, f"v{OTHER}")
        assert status == 1
        assert err == f"release: {name}: says 77.6.4, expected {OTHER} as the tag v{OTHER}\n"
        file.write_text(good)


def test_pages_that_say_that_nothing_is_released_are_named(repository: Path) -> None:
    shutil.copy(ROOT / "README.md", repository)
    git(repository, "commit", "-am", "as before")
    git(repository, "tag", f"v{OTHER}")
    status, _, err = release(repository, f"v{OTHER}")
    assert status == 1
    assert re.fullmatch(rf"release: README.md:\d+: says that nothing is released, in v{OTHER}\n", err)


def test_a_call_that_is_wrong_ends_in_one_line(repository: Path) -> None:
    for arguments, status, says in (
        ([], 2, "expected TAG"),
        (["1.2.3"], 2, "1.2.3: expected v and a version"),
        (["v1.2"], 2, "v1.2: expected v and a version"),
        (["--bulid", "v1.2.3"], 2, "unknown option: --bulid"),
        (["v1.2.3", "--address"], 2, "--address: expected the address"),
        (["v1.2.3"], 1, "v1.2.3: there is no such tag"),
    ):
        code, out, err = release(repository, *arguments)
        assert (code, out) == (status, ""), arguments
        assert says in err
        assert err.count("\n") == 1


def test_an_address_that_is_none_is_refused(repository: Path) -> None:
    git(repository, "tag", f"v{OTHER}")
    status, _, err = release(repository, "--address", "ndtree", f"v{OTHER}")
    assert status == 1
    assert (
        err
        == "with_address: ndtree: expected the address of a repository, as https://example.org/us/ndtree\n"
    )
