# SPDX-License-Identifier: BSD-3-Clause
"""Terms are defined once, and the library's pages lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from snippets import ROOT, anchors, links


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
