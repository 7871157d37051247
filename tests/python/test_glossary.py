# SPDX-License-Identifier: BSD-3-Clause
"""Pages and comments use the glossary's words, and the check that says so finds what it should."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from snippets import ROOT, anchors, links

sys.path.insert(0, str(ROOT / "tools"))
import check_words


def rows_of(page: Path) -> list[tuple[str, str, str]]:
    """Terms, what they are, and where to read on."""
    return re.findall(r"^\| (\*\*.*?) \| (.*?) \| (.*?) \|$", page.read_text(), re.MULTILINE)


GLOSSARY = rows_of(ROOT / "docs" / "glossary.md")
LIBRARY = rows_of(ROOT / "include" / "ndtree" / "TERMS.md")


def test_pages_and_comments_use_the_words_of_the_glossary() -> None:
    count, findings = check_words.check(ROOT)
    assert count > 500
    assert not findings, "\n" + "\n".join(findings)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("docs/a.md", "One.\n\nTwo of\nso many cells.\n", [(4, "so many", "this many")]),
        ("docs/a.md", "`whoever` is code,\n\n```sh\nwhoever\n```\n", []),
        ("docs/a.md", "Whoever maps.\n", [(1, "Whoever", "say who")]),
        ("a.hpp", "// The beams that\n// settled cells take.\nint x;\n", [(2, "settled", "saturated")]),
        ("a.hpp", 'f("settled");  // A saturated cell.\n', []),
        ("a.hpp", "int x;  ///< The same of eight.\n", [(1, "The same of", "say what it does")]),
        ("a.hpp", "int y;\n/// ... or few beams.\n", [(2, "...", "a comment is understood")]),
        ("a.hpp", "bool is_settled();\n", [(1, "is_settled", "saturated")]),
        ("a.hpp", "auto theirs = its;\n", []),
        ("a.py", '"""What nobody needs."""\nx = "heirs"\n', [(1, "nobody", "")]),
        ("a.py", "x = {\n    'nobody': 1,\n}\n", []),
        ("a.py", "def f():\n    x = 1  # heritage\n", [(2, "heritage", "child initialisation")]),
        ("a.py", "\n# It brings beams\n# to their cells.\n", [(2, "brings beams to their cells", "bin")]),
        ("run.sh", "#!/bin/sh\nx=1 # in vain\n", [(2, "in vain", "without success")]),
        ("docs/a.md", "Of the beams, those that end there are hits.\n", [(1, "Of the beams", "")]),
        ("docs/a.md", "Half of the cells are free; a known cell; it settles; a chance.\n", []),
    ],
)  # fmt: skip
def test_the_check_names_line_word_and_a_better_one(
    name: str, text: str, expected: list[tuple[int, str, str]]
) -> None:
    found = sorted(check_words.findings_in(name, text))
    assert len(found) == len(expected), found
    for (line, word, better), (expected_line, expected_word, expected_better) in zip(found, expected):
        assert line == expected_line
        assert word.startswith(expected_word)
        assert expected_better in better


def test_a_listed_file_that_is_clean_must_leave_the_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "a.md").write_text("Nobody.\n")
    (tmp_path / "docs" / "b.md").write_text("A cell.\n")
    monkeypatch.setattr(check_words, "NOT_YET", {"docs/a.md", "docs/b.md"})
    count, findings = check_words.check(tmp_path)
    assert count == 2
    assert findings == [
        "tools/check_words.py: NOT_YET lists docs/b.md, which has no finding: take it from the list"
    ]
    assert check_words.check(tmp_path, skip=False)[1][0].startswith("docs/a.md:1: 'Nobody': write ")


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
