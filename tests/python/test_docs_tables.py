# SPDX-License-Identifier: BSD-3-Clause
"""Tables of the pages that are made from the package are as it is, and pages read well without the site."""

from __future__ import annotations

import importlib.util
import os
import re
from typing import Any

import pytest
from snippets import ROOT

pytest.importorskip("griffe", reason="griffe is not installed: the pages' tables are made with it")
pytest.importorskip("typer")
pytest.importorskip("matplotlib")
pytest.importorskip("viser", reason="viser is not installed: the page of the viewer is described")

DOCS = ROOT / "docs"
PAGES = sorted(path.name for path in DOCS.glob("*.md"))


@pytest.fixture(scope="module")
def site() -> Any:
    """tools/docs_site.py."""
    spec = importlib.util.spec_from_file_location("docs_site", ROOT / "tools" / "docs_site.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("page", PAGES)
def test_tables_are_as_the_package_is(page: str, site: Any) -> None:
    """With NDTREE_UPDATE_DOCS in the environment, they are written."""
    text = (DOCS / page).read_text()
    made = site.filled(text)
    if "NDTREE_UPDATE_DOCS" in os.environ:
        (DOCS / page).write_text(made)
        text = made
    assert made == text, "NDTREE_UPDATE_DOCS=1 pytest tests/python/test_docs_tables.py mends it"


def test_every_table_has_a_page(site: Any) -> None:
    every = "".join((DOCS / page).read_text() for page in PAGES)
    assert set(re.findall(r"<!-- (?:site )?table: (\w+) -->", every)) == set(site.TABLES)
    assert every.count("<!-- reference: ") > 10


@pytest.mark.parametrize("page", PAGES)
def test_a_page_has_nothing_that_the_site_alone_understands(page: str) -> None:
    text = re.sub(r"```.*?```", "", (DOCS / page).read_text(), flags=re.DOTALL)
    assert not re.search(r"^(:::|--8<--|!!!|\?\?\?|===)", text, re.MULTILINE)
    assert not re.search(r"\{[:#.]\S*\}\s*$", text, re.MULTILINE)
    assert text.startswith("# ") or "<!-- include" in text


def test_the_site_has_the_whole_docstrings_and_files(site: Any) -> None:
    python = site.on_page_markdown((DOCS / "python.md").read_text())
    assert "\n::: ndtree.Comparison\n" in python and "<!-- reference" not in python
    assert "        - occupancy\n" in python
    assert "\n| `--min-cell-size M` |" in site.on_page_markdown((DOCS / "commands.md").read_text())
    assert site.on_page_markdown((DOCS / "changes.md").read_text()).startswith("# Changelog")
    cpp = site.on_page_markdown((DOCS / "cpp.md").read_text())
    assert '<a href="cpp/occupancy__map_8hpp.html"><code>mapping/occupancy_map.hpp</code></a>' in cpp
    assert "../include" not in cpp
