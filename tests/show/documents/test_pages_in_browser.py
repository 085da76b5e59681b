"""Reports as a reader sees them: opened as files in a real browser, without a network."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.base.document import CodeBlock, Details, FigureBlock, Paragraphs, Section, TableBlock
from greybox.base.figure import Axis, Curve, Figure, Panel, Role
from greybox.comparison.compare import compare
from greybox.estimation.check import check
from greybox.estimation.result_parts import StartResult
from greybox.show import describe_page
from greybox.show.printers.html import write_page
from models.micro_actuator import micro_actuator
from tests.support.browser import opened, wait_until

pytestmark = pytest.mark.rest

REST = gb.FitOptions(at_rest=True)
# Titles of axes that reach beyond their figure.
CUT_TITLES = """[...document.querySelectorAll('.plot')].flatMap((plot) => {
  const room = plot.getBoundingClientRect();
  return [...plot.querySelectorAll('.g-ytitle, .g-xtitle')].filter((title) => {
    const own = title.getBoundingClientRect();
    return own.height && (own.top < room.top - 1 || own.bottom > room.bottom + 1 || own.right > room.right + 1);
  }).map((title) => title.textContent);
})"""
HOSTILE = """<script>window.hurt=1</script></script>"><img src=x onerror="window.hurt=1">&amp;'`${1}"""


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
    return write_page(
        describe_page(good_fit, command=f"greybox fit {HOSTILE}"), tmp_path_factory.mktemp("report") / "fit.html"
    )


@pytest.fixture(scope="module")
def page(browser, report):
    """The page of the fit on a wide screen, opened once: what one test zooms or switches, the next does not mind."""
    one = browser.new_page()
    with opened(one, report):
        yield one
    one.close()


def test_the_page_draws_every_figure_and_stays_small(page, report):
    assert report.stat().st_size < 6_000_000
    drawn = page.locator("figure.drawn")
    assert drawn.count() >= 8
    for k in range(drawn.count()):
        assert drawn.nth(k).locator("svg.main-svg").count() > 0
        assert len(drawn.nth(k).locator(".plot").get_attribute("aria-label")) > 20


def test_text_from_files_is_text(page):
    assert page.evaluate("window.hurt") is None
    assert page.locator("img").count() == 0
    assert HOSTILE in page.locator("body").inner_text()


def test_a_button_switches_the_output_in_every_figure_of_the_record(page):
    title = "document.querySelector('#{} .plot').layout.yaxis.title.text"
    assert page.evaluate(title.format("spectrum-0")).startswith("x")
    page.focus("#run-0 .choices button:nth-child(2)")
    page.keyboard.press("Enter")
    for figure, text in (("run-0", "i ["), ("residual-0", "residual of i"), ("spectrum-0", "i [")):
        assert page.evaluate(title.format(figure)).startswith(text)
        assert page.get_attribute(f"#{figure} .choices button:nth-child(2)", "aria-pressed") == "true"
    page.click("#spectrum-0 .choices button:nth-child(1)")
    assert page.evaluate(title.format("run-0")).startswith("x")


def test_zooming_the_residual_zooms_the_run_and_renews_the_spectrum(page):
    points = "document.querySelector('#spectrum-0 .plot').data[0].x.length"
    before = page.evaluate(points)
    page.evaluate("Plotly.relayout(document.querySelector('#residual-0 .plot'), {'xaxis.range': [0.3, 0.5]})")
    wait_until(page, "document.querySelector('#run-0 .plot').layout.xaxis.range[1] === 0.5")
    wait_until(page, f"{points} !== {before}")
    page.evaluate("Plotly.relayout(document.querySelector('#run-0 .plot'), {'xaxis.autorange': true})")
    wait_until(page, f"{points} === {before}")


def test_the_page_is_printed_on_few_sheets(page):
    sheets = len(re.findall(rb"/Type\s*/Page\b(?!s)", page.pdf(format="A4")))
    assert 2 <= sheets <= 4


def test_a_fit_with_starts_and_a_validation_record_is_printed_on_four_sheets(tab, good_fit, tmp_path):
    values = {name: good_fit.parameters[name].value for name in good_fit.uncertainty.free}
    judged = gb.estimation.validate(good_fit.model, good_fit.traces[0].experiment, noise=dict(good_fit.noise.std))
    fit = replace(good_fit, starts=[StartResult(values, values, 1.0, "converged")] * 4, validation=judged)
    with opened(tab, write_page(describe_page(fit, command="greybox fit --at-rest"), tmp_path / "fit.html")):
        sheets = len(re.findall(rb"/Type\s*/Page\b(?!s)", tab.pdf(format="A4")))
        assert tab.evaluate("[...document.querySelectorAll('.code .whole')].map(e => e.textContent)") == ["--at-rest"]
    assert sheets <= 4


def test_paper_shows_every_output_with_its_name_and_the_screen_is_as_before(page):
    names = "[...document.querySelectorAll('#run-0 .name.printed')].map(e => e.textContent)"
    axes = "[...document.querySelectorAll('#run-0 .plot')].map(e => e.layout.yaxis.title.text[0])"
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate(names) == page.evaluate(axes) == ["x", "i"]
    again = "[...document.querySelectorAll('figure.again')].map(e => e.id)"
    assert len(page.evaluate(again)) == 1, "the run at the head of the page is not printed twice"
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert page.evaluate(names) == [] and page.evaluate(axes) == ["x"]


def test_long_names_of_many_curves_are_whole_on_paper_and_phones_and_code_stays_folded(tab, good_fit, tmp_path):
    time = np.linspace(0.0, 1.0, 50)
    curves = [Curve(time, time**k, Role.SIMULATED, f"model {k} with an effect of a long name") for k in range(1, 10)]
    figure = FigureBlock(Figure("many", (Panel("x", tuple(curves), Axis("time", "s"), Axis("x", "m")),), "Many."))
    folds = [Details("Code", [CodeBlock("a = 1")]), Details("Words", [Paragraphs(["Something."])])]
    document = replace(describe_page(good_fit), evidence=[], sections=[Section("all", "All", [*folds, figure])])
    path = write_page(document, tmp_path / "many.html")
    # A legend that hides names is drawn less high than it is.
    whole = (
        "(legend => legend._height <= legend._effHeight + 1)(document.querySelector('#many .plot')._fullLayout.legend)"
    )
    tab.set_viewport_size({"width": 390, "height": 800})
    with opened(tab, path) as page:
        assert page.evaluate(whole)
    tab.set_viewport_size({"width": 1280, "height": 720})
    with opened(tab, path) as page:
        page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        assert page.evaluate(whole)
        assert page.evaluate("[...document.querySelectorAll('details:not(.words)')].map(e => e.open)") == [False, True]


def test_a_sentence_behind_four_numbers_is_not_read_word_below_word_on_a_phone(tab, good_fit, tmp_path):
    combination = (
        "Izz1 + Izz2 + Izz3 + 0.0185 m2 + 0.272 my2 + 0.000261 (m3 + m4) + 0.0323 (my3 + my4) + 0.0119 (m5 + m6)"
    )
    table = TableBlock(
        "Base", ["constant", "estimate", "unit", "described", "remark"], [["Izz1", "0.4", "kg m^2", "0.4", combination]]
    )
    document = replace(describe_page(good_fit), evidence=[], sections=[Section("all", "All", [table])])
    tab.set_viewport_size({"width": 390, "height": 800})
    with opened(tab, write_page(document, tmp_path / "table.html")) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        # Of lines about 23 pixels high, no more than five.
        assert page.evaluate("document.querySelector('td:last-child').offsetHeight") < 130


@pytest.mark.rest
def test_dark_and_light_follow_the_reader_and_the_button_on_a_phone_too(tab, report):
    tab.emulate_media(color_scheme="dark")
    tab.set_viewport_size({"width": 390, "height": 800})
    with opened(tab, report) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        tests = page.locator(".wide[aria-label='Tests of the residual']")
        assert tests.evaluate("e => e.scrollWidth <= e.clientWidth")
        paper = "getComputedStyle(document.body).backgroundColor"
        dark = page.evaluate(paper)
        page.click("#theme")
        assert page.evaluate(paper) == "rgb(255, 255, 255)" != dark
        assert page.get_attribute("#theme", "aria-pressed") == "false"
    tab.emulate_media(color_scheme="light")
    tab.set_viewport_size({"width": 1280, "height": 720})


def test_every_kind_of_page_opens_and_is_drawn(tab, good_fit, tmp_path):
    """Nothing in the console, nothing fetched, every figure drawn; one page after the other."""
    t = 5e-4 * np.arange(400)
    rig = (micro_actuator + gb.effect("cubic_stiffness")).start(K3=5e9)
    records = [
        gb.simulate(rig, gb.Experiment(n, t, {"u": s * np.sin((40 + 600 * t) * t)}, {}))
        for n, s in (("a", 4), ("b", 3))
    ]
    noise = {"x": 2e-7, "i": 5e-3}
    made = [r.record(noise, np.random.default_rng(k)) for k, r in enumerate(records)]
    known = micro_actuator.fix("M", "Ra", "Kf", "Kv", "La")
    found = gb.discover(
        known, made[0], validation=made[1], noise=noise, effects=[gb.effect("cubic_stiffness")], options=REST
    )
    black = gb.blackbox.arx(made[0], output="x", inputs=["u"], na=3, nb=3, nk=1)
    compared = compare({HOSTILE: found.base, "with it": found.best, "arx": [black]}, made[1], training=made[0])
    values = {
        "check": (check(micro_actuator), {}),
        "discovery": (found, {}),
        "linear": (gb.linearise(found.best), {}),
        "comparison": (compared, {"fits": {HOSTILE: found.base}}),
        "simulation": (records[0], {"model": rig}),
    }
    for name, (value, more) in values.items():
        with opened(tab, gb.report(value, tmp_path / f"{name}.html", **more)) as page:
            undrawn = [f.get_attribute("id") for f in page.locator("figure.drawn:not(:has(svg.main-svg))").all()]
            assert page.locator("figure.drawn").count() > 0
            assert not undrawn
            assert page.evaluate("window.hurt") is None
            assert page.evaluate("document.documentElement.scrollWidth") <= 1280
            assert page.evaluate(CUT_TITLES) == []
