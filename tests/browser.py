"""Chromium without a screen, for pages that must open from a disk; skipped where there is none."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")

WIDTHS = {"desktop": (1280, 720), "phone": (390, 844)}  # of a window [px]: name to width and height


@dataclass(frozen=True)
class OpenedPage:
    """What a browser made of a page.

    Attributes:
        requests: addresses that it asked for, pictures within the page aside.
        messages: of its console, and errors.
        overflow_px: by how much it is wider than the window.
        height_px: of the whole page.
        text: that is seen.
        picture: of the first window.
    """

    requests: list[str]
    messages: list[str]
    overflow_px: int
    height_px: int
    text: str
    picture: bytes


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A Chromium or Chrome that is installed."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    place = next(filter(None, map(shutil.which, _NAMES)), None)
    if place is None:
        pytest.skip("needs Chromium or Chrome, which is not installed")
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=place, args=["--no-sandbox"])
        yield opened
        opened.close()


def opened(browser: Any, path: Path, width: str = "desktop", script: str = "") -> OpenedPage:
    """Open a page from the disk; `script` must be true in it."""
    across, down = WIDTHS[width]
    page = browser.new_page(viewport={"width": across, "height": down})
    requests: list[str] = []
    messages: list[str] = []
    page.on("request", lambda one: requests.append(one.url))
    page.on("console", lambda one: messages.append(one.text))
    page.on("pageerror", lambda one: messages.append(str(one)))
    page.on("dialog", lambda one: (messages.append(f"dialog: {one.message}"), one.dismiss()))
    page.goto(path.as_uri())
    root = "document.documentElement"
    found = OpenedPage(
        requests=[one for one in requests if not one.startswith("data:")],
        messages=messages,
        overflow_px=page.evaluate(f"{root}.scrollWidth - {root}.clientWidth"),
        height_px=page.evaluate(f"{root}.scrollHeight"),
        text=page.inner_text("body"),
        picture=page.screenshot(),
    )
    if script:
        assert page.evaluate(script), script
    page.close()
    return found
