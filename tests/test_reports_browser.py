"""Reports as a reader sees them: opened as files in a real browser, without a network."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.reports import page_of, write
from models.micro_actuator import micro_actuator

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: no browser to look with")
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed to open reports with")

HOSTILE = """<script>window.hurt=1</script></script>"><img src=x onerror="window.hurt=1">&amp;'`${1}"""


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        one = driver.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield one
        one.close()


@contextmanager
def opened(browser, path: Path, **context) -> Iterator:
    """The page of a report; any error in its console and any request to elsewhere fails the test."""
    page = browser.new_page(**context)
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda message: wrong.append(message.text) if message.type in ("error", "warning") else None)
    page.on("request", lambda r: None if r.url.startswith(("file:", "data:", "blob:")) else wrong.append(r.url))
    page.goto(path.as_uri())
    page.wait_for_function("window.greyboxReady === true", timeout=20_000)
    yield page
    page.close()
    assert not wrong


@pytest.fixture(scope="module")
def good_fit():
    t = 5e-4 * np.arange(1500)
    u = np.sign(np.sin(40 * t)) + np.sin(300 * t)
    made = gb.simulate(micro_actuator, gb.Experiment("bench", t, {"u": u}, {})).outputs
    noise = np.random.default_rng(4)
    y = {"x": made["x"] + noise.normal(0, 2e-7, len(t)), "i": made["i"] + noise.normal(0, 5e-3, len(t))}
    y["x"][300:420] = np.nan
    return gb.fit(micro_actuator.fix("M", "Ra"), gb.Experiment(HOSTILE, t, {"u": u}, y))


@pytest.fixture(scope="module")
def report(good_fit, tmp_path_factory) -> Path:
    return write(page_of(good_fit, command=f"greybox fit {HOSTILE}"), tmp_path_factory.mktemp("report") / "fit.html")


def test_the_page_draws_every_figure_and_stays_small(browser, report):
    assert report.stat().st_size < 6_000_000
    with opened(browser, report) as page:
        drawn = page.locator("figure.drawn")
        assert drawn.count() >= 8
        for k in range(drawn.count()):
            assert drawn.nth(k).locator("svg.main-svg").count() > 0
            assert len(drawn.nth(k).locator(".plot").get_attribute("aria-label")) > 20


def test_text_from_files_is_text(browser, report):
    with opened(browser, report) as page:
        assert page.evaluate("window.hurt") is None
        assert page.locator("img").count() == 0
        assert HOSTILE in page.locator("body").inner_text()


def test_dark_and_light_follow_the_reader_and_the_button(browser, report):
    with opened(browser, report, color_scheme="dark") as page:
        paper = "getComputedStyle(document.body).backgroundColor"
        dark = page.evaluate(paper)
        page.click("#theme")
        assert page.evaluate(paper) == "rgb(255, 255, 255)" != dark
        assert page.get_attribute("#theme", "aria-pressed") == "false"


def test_zooming_the_residual_zooms_the_run_and_renews_the_spectrum(browser, report):
    with opened(browser, report) as page:
        before = page.evaluate("document.querySelector('#spectrum-0 .plot').data[0].x.length")
        page.evaluate("Plotly.relayout(document.querySelector('#residual-0 .plot'), {'xaxis.range': [0.3, 0.5]})")
        page.wait_for_function("document.querySelector('#run-0 .plot').layout.xaxis.range[1] === 0.5")
        page.wait_for_function(f"document.querySelector('#spectrum-0 .plot').data[0].x.length !== {before}")


def test_a_phone_shows_the_page_without_scrolling_sideways(browser, report):
    with opened(browser, report, viewport={"width": 390, "height": 800}) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_the_page_prints(browser, report):
    with opened(browser, report) as page:
        assert len(page.pdf(format="A4")) > 20_000
