"""The Chromium in which pages are tested."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser to open pages with; skips where there is none."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: no browser to look with"
    )
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no Chromium is installed to open pages with")
    with playwright.sync_playwright() as driver:
        one = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield one
        one.close()


@pytest.fixture(scope="module")
def tab(browser: Any) -> Iterator[Any]:
    """A tab in which one page is opened after the other: it compiles the scripts that they share once."""
    one = browser.new_page()
    yield one
    one.close()


@contextmanager
def collected_faults(page: Any, allowed: tuple[str, ...], expected: str = "") -> Iterator[list[str]]:
    """A list that fills with errors and warnings of the page's console and with requests to elsewhere.

    ``allowed`` are beginnings of addresses, ``expected`` is a part of a text that is no fault.
    """
    faults: list[str] = []

    def hear(message: Any) -> None:
        if message.type in ("error", "warning") and not (expected and expected in message.text):
            faults.append(message.text)

    def fail(error: Any) -> None:
        faults.append(str(error))

    def look(request: Any) -> None:
        if not request.url.startswith((*allowed, "data:", "blob:")):
            faults.append(request.url)

    listeners = {"pageerror": fail, "console": hear, "request": look}
    for event, listener in listeners.items():
        page.on(event, listener)
    yield faults
    for event, listener in listeners.items():
        page.remove_listener(event, listener)


@contextmanager
def opened(tab: Any, path: Path) -> Iterator[Any]:
    """The page of a report in a tab; any error in its console and any request to elsewhere fails the test."""
    with collected_faults(tab, ("file:",)) as faults:
        tab.goto(path.as_uri())
        wait_until(tab, "window.greyboxReady === true")
        yield tab
        # What the page still says is heard before it goes.
        tab.goto("about:blank")
    assert not faults


def wait_until(page: Any, expression: str, seconds: float = 60.0) -> None:
    """Until ``expression`` is true on the page.

    Playwright's own waiting evaluates a text inside the page, which the page's policy forbids.
    """
    deadline = time.monotonic() + seconds
    while not page.evaluate(expression):
        assert time.monotonic() < deadline, f"not true after {seconds:g} s: {expression}"
        page.wait_for_timeout(20)
