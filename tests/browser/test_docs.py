"""The documentation, opened from a folder: the search finds things, and nothing is fetched."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.browser.driver import Page


@pytest.fixture(scope="module")
def documentation(in_make_browser: None, tmp_path_factory: pytest.TempPathFactory, repository: Path) -> Path:
    """The documentation site."""
    folder = tmp_path_factory.mktemp("docs") / "site"
    words = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(folder)]
    subprocess.run(words, cwd=repository, check=True)
    return folder


@pytest.mark.parametrize(
    ("word", "page"), [("install", "index.html"), ("BSA", "metrics.html"), ("citation", "index.html")]
)
def test_the_search_works_from_a_folder(chromium: Any, documentation: Path, word: str, page: str) -> None:
    shown = Page(chromium, documentation)
    shown.driver.get(f"file://{documentation}/tutorial.html")
    shown.size(1280)
    box = shown.one("input[name=query]")
    box.click()
    box.send_keys(word)
    shown.one(".md-search-result__link")
    links = [link.get_attribute("href") for link in shown.all(".md-search-result__link")]
    assert any(link.split("?")[0].split("#")[0].endswith(f"/{page}") for link in links), links
    shown.note()
    assert shown.messages == []
    assert shown.outside() == []
