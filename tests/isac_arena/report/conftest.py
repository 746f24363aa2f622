"""One browser for all tests of pages."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.isac_arena.report.browser import Tab, find_browser, open_browser


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where pages are written and the browser saves what it is told to."""
    return tmp_path_factory.mktemp("pages")


@pytest.fixture(scope="session")
def tab(folder: Path) -> Iterator[Tab]:
    if find_browser() is None:
        pytest.skip("no Chromium on this machine")
    with open_browser(folder) as tab:
        tab.size(1300, 900)
        yield tab
