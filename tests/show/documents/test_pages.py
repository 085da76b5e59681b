"""Pages as text: what they say, what they hold, and that nothing from a file becomes markup. A browser looks at them elsewhere."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, lfilter

import greybox as gb
from greybox.base.document import BulletList, Document, FigureBlock, Section, Subheading, TableBlock
from greybox.base.figure import Axis, Band, Curve, Figure, Panel, Role
from greybox.base.values import Finding
from greybox.comparison.result import ComparisonFinding
from greybox.data.noise.noise_model import NoiseSource
from greybox.estimation.check import check
from greybox.estimation.findings import EstimationCode
from greybox.estimation.residuals import residual_tests
from greybox.estimation.result_parts import FitNoise, Misfit, Trace
from greybox.shell.commands import app
from greybox.show import describe_page
from greybox.show import text as write
from greybox.show.documents.tables import misfit_table
from greybox.show.figures.records import plot_residual
from greybox.show.printers.html import LARGEST_PAGE, cell, label, render_page, say, say_answer, write_page
from models.micro_actuator import micro_actuator
from tests.support.command import CliRunner
from tests.support.findings import codes
from tests.support.first_order import first_order

HOSTILE = """</script><script>alert(1)</script><img src=x onerror="alert(2)">{{ 7 * 7 }}'&amp;"""


def bench(rows: int = 500) -> gb.Experiment:
    t = 5e-4 * np.arange(rows)
    u = np.sign(np.sin(40 * t)) + np.sin(300 * t)
    made = gb.simulate(micro_actuator, {"time": t, "u": u}).outputs
    noise = np.random.default_rng(4)
    y = {"x": made["x"] + noise.normal(0, 2e-7, rows), "i": made["i"] + noise.normal(0, 5e-3, rows)}
    y["x"][100:140] = np.nan
    return gb.Experiment("bench", t, {"u": u}, y)


@pytest.fixture(scope="module")
def good() -> gb.Fit:
    known = micro_actuator.fix("M", "Ra", "Kf", "Kv")
    return gb.fit(known, bench(), noise={"x": 2e-7, "i": 5e-3}, options=gb.FitOptions(progressive=False))


def said(page: Document) -> list[str]:
    """What the verdict of a page says."""
    return [label(item) for item in page.verdict.items]


class Outline(HTMLParser):
    """What a screen reader meets: headings, ids, tables with or without captions, figures with their descriptions."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.headings: list[int] = []
        self.ids: list[str] = []
        self.tags: Counter[str] = Counter()
        self.fetched: list[str] = []
        self.silent: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        own = dict(attrs)
        self.tags[tag] += 1
        self.ids += [own["id"]] if own.get("id") else []
        self.headings += [int(tag[1])] if re.fullmatch("h[1-6]", tag) else []
        self.fetched += [
            v for n in ("src", "href", "data", "action") if (v := own.get(n)) and not v.startswith(("#", "data:"))
        ]
        if own.get("role") == "img" and len(own.get("aria-label") or "") < 20:
            self.silent.append(str(own))


def test_the_verdict_of_a_good_fit_comes_first_and_in_plain_words(good: gb.Fit) -> None:
    page = describe_page(good, command="greybox fit micro_actuator bench.csv")
    assert page.tone == "plain"  # nothing has judged it
    explained, validated = said(page)
    assert re.fullmatch(
        r"micro_actuator explains its records: the error in [xi], [\d.]+ [mµ][mA], is [01]\.?\d* times the noise of [\d.]+ [mµ][mA]\.",
        explained,
    )
    assert validated == "not validated: give a second record"
    html = render_page(page)
    for text in (
        "40 of x",
        "N\N{NO-BREAK SPACE}s/m",
        "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}",
        "greybox fit micro_actuator bench.csv",
        good.traces[0].fingerprint[:12],
    ):
        assert text in html
    assert [s.name for s in page.sections] == ["parameters", "misfit", "residual", "model", "data", "repeat"]


def test_a_fit_that_failed_says_so_and_tests_nothing() -> None:
    far = micro_actuator.fix("M", "Ra").start(K=3000.0, B=2.0)
    failed = gb.fit(far, bench(), options=gb.FitOptions(iterations=1, progressive=False))
    assert not failed.success
    page = describe_page(failed)
    assert page.verdict.tone == "bad"
    failure = said(page)[0]
    assert failure.startswith("The fit of micro_actuator did not succeed: ")
    assert failure.endswith("Use its numbers only for diagnosis: they are those of the last point of the search.")
    (residual,) = (s for s in page.sections if s.name == "residual")
    assert residual.blocks[-1].items == ["The fit did not succeed, so its residual was not tested."]
    findings = tuple(
        Finding(ComparisonFinding.NO_BLACK_BOX, values={"reason": f"remark number {k} of five"}) for k in range(5)
    )
    html = render_page(describe_page(replace(failed, findings=findings)))
    assert [html.count(f"emark number {k} of five") for k in range(5)] == [1] * 5


def test_what_would_determine_the_open_constants_stands_beside_them(good: gb.Fit) -> None:
    found = gb.fit(micro_actuator, bench(), noise={"x": 2e-7, "i": 5e-3}, options=gb.FitOptions(progressive=False))
    headings = [
        [b.title for b in describe_page(fit).sections[0].blocks if isinstance(b, Subheading)] for fit in (found, good)
    ]
    assert headings == [["How to determine the other parameters"], []]
    assert "Fix one of M, B, K, Kf" in render_page(describe_page(found))


def test_the_figure_that_convinces_stands_below_the_box(good: gb.Fit) -> None:
    comparison = gb.compare([good], bench(300))
    for result, name in ((good, "evidence"), (comparison, "errors")):
        html = render_page(describe_page(result))
        box, _, rest = html[html.index('<section id="verdict"') :].partition("</section>")
        assert "<figure" not in box and html.count(f'id="{name}" class="drawn"') == 1
        assert rest.index(f'<figure id="{name}"') < rest.index("<section")


def test_the_box_of_a_page_has_five_lines_and_a_fold_the_rest() -> None:
    notes = [f"remark {k} " + "of some length " * 9 for k in range(9)]
    html = render_page(Document("t", "An answer.", notes=notes, sections=[Section("data", "Data", [])]))
    box, _, rest = html[html.index('<section id="verdict"') :].partition("</section>")
    assert [f"emark {k} " in box for k in range(9)] == [True] * 2 + [False] * 7
    assert "<summary>7 more notes</summary>" in rest and all(rest.count(f"emark {k} ") == 1 for k in range(2, 9))


def test_a_name_at_the_beginning_of_the_answer_stays_as_it_is_written() -> None:
    named = Document("Fit of axis + play", "axis + play explains its records")
    told = Document("Effects that axis lacks", "the plain model lacks play")
    assert (
        say_answer(named) == "axis + play explains its records." and say_answer(told) == "The plain model lacks play."
    )


def test_a_column_of_a_page_has_something_below_its_head() -> None:
    table = TableBlock("constants", ["name", "value", "remark"], [["a", "1", ""], ["b", "2", ""]])
    html = render_page(Document("t", "An answer.", sections=[Section("data", "Data", [table])]))
    assert ">value</th>" in html and ">remark</th>" not in html


def test_a_page_has_no_bar_of_buttons_over_a_figure_and_one_meaning_of_plus_minus(good: gb.Fit) -> None:
    page = describe_page(good)
    html = render_page(page)
    assert "displayModeBar: false" in html
    figures = [b.figure for s in page.sections for b in s.blocks if isinstance(b, FigureBlock)]
    texts = [text for f in figures for p in f.panels for s in p.series for text in (s.label, *getattr(s, "texts", ()))]
    assert any("95 %" in text for text in texts) and not any("±" in text for text in texts)
    assert "±" not in say(page.verdict.items)  # in the table, after a value: its standard deviation


def test_noise_that_is_only_bounded_is_no_band_and_no_yardstick() -> None:
    sources = {"x": NoiseSource.GIVEN, "i": NoiseSource.DIFFERENCES}
    noise = FitNoise(std={"x": 2e-7, "i": 4e-3}, sources=sources)
    assert noise.levels == {"x": 2e-7}
    trace = Trace("run", "", np.arange(3.0), {n: np.ones(3) for n in "xi"}, {n: np.zeros(3) for n in "xi"}, {})
    residual = plot_residual(trace, {"x": "m", "i": "A"}, noise.levels, "residual")
    assert [[type(s) for s in p.series] for p in residual.panels] == [[Band, Curve], [Curve]]
    table = misfit_table("misfit", {"i": Misfit(1e-2, "A", 90.0, 2.0, 3, 5e-3).over(noise, "i")})
    assert table.rows[0] == ["i", "10 mA", "90.00 %", "at most 4 mA", "at least 2.50 x noise"]


def test_a_page_says_once_that_a_model_does_not_explain_its_records() -> None:
    stiff = micro_actuator.fix("M", "Ra", "Kf", "Kv", K=7000.0)
    fit = gb.fit(stiff, bench(), noise={"x": 2e-7, "i": 5e-3}, options=gb.FitOptions(progressive=False))
    found = {f.code for f in fit.findings}
    assert {EstimationCode.MISFIT_ABOVE_NOISE, EstimationCode.RESIDUAL_CORRELATED} <= found
    page = describe_page(fit)
    shown = [
        i.code
        for s in page.sections
        for b in s.blocks
        if isinstance(b, BulletList)
        for i in b.items
        if isinstance(i, Finding)
    ]
    shown += [item.code for item in page.verdict.items if isinstance(item, Finding)]
    assert sum("does not explain its records" in text for text in said(page)) == 1
    assert not {EstimationCode.MISFIT_ABOVE_NOISE, EstimationCode.RESIDUAL_CORRELATED} & set(shown)
    assert len(shown) == len(set(shown))
    assert "which allows for the colour of the residual (up to" in render_page(page)
    # Wider by a hundredth is as wide.
    uncertainty = replace(fit.uncertainty, inflation=dict.fromkeys(fit.uncertainty.inflation, 1.01))
    as_wide = render_page(describe_page(replace(fit, uncertainty=uncertainty)))
    assert "which allows for the colour of the residual" in as_wide and "of the residual (up to" not in as_wide


def test_what_may_be_noise_is_not_said_to_exceed_it() -> None:
    """Behind a filter differences show next to nothing of the noise: many times their level may lie below its ceiling."""
    tank = gb.Model(
        "tank",
        [gb.State("y", "V")],
        [gb.Input("u", "V")],
        [gb.Output("y", "V")],
        [gb.Parameter(name, "1/s", 1.5, (0.01, 100.0)) for name in ("k", "b")],
        lambda x, u, p: [gb.Balance("rate", "V/s", 1, "y", flow=p.b * u.u, loss=-p.k * x.y)],
    )
    rng, time = np.random.default_rng(3), 0.01 * np.arange(1500)
    record = gb.Experiment("run", time, {"u": np.repeat(rng.normal(size=20), 75)}, {"y": time})
    run = gb.simulate(tank.start(k=2.0, b=2.0), record).outputs["y"]
    noise = lfilter(*butter(4, 0.1), rng.normal(size=2000))[500:]
    fit = gb.fit(tank, record.with_outputs({"y": run + 0.01 * run.std() / noise.std() * noise}))
    m = fit.misfit["y"]
    assert m.rmse > 5 * fit.noise.std["y"] and m.noise_ratio == fit.misfit_at_least["y"] < 1.1
    assert not {EstimationCode.MISFIT_ABOVE_NOISE, EstimationCode.MISFIT_ABOVE_DIFFERENCE_NOISE} & codes(fit.findings)
    first, *_ = said(describe_page(fit))
    assert "may explain its records" in first and "at least 0.650 times the noise (at most" in first


def test_a_sensor_in_doubt_stands_in_the_verdict_of_a_check() -> None:
    sound = bench()
    dead = {name: values.copy() for name, values in sound.outputs.items()}
    dead["i"][400:] = dead["i"][400]
    record = gb.Experiment.from_arrays(sound.time, sound.inputs, dead, name="bench")
    found = check(micro_actuator.fix("M", "Ra"), record, noise={"x": 2e-7, "i": 5e-3})
    page = describe_page(found)
    assert page.verdict.tone == "caution"
    assert said(page)[1].startswith("Record bench: ")
    html = render_page(page)
    assert html.count("stays at exactly") == 1
    assert "Record bench: output &#39;x&#39; has 40 gaps" in html
    assert found.as_dict()["records"][0]["notes"] == list(map(str, record.findings))


def test_errors_further_ahead_stand_on_the_page_of_a_comparison(good: gb.Fit) -> None:
    other = bench(400)
    compared = gb.compare([good, gb.blackbox.arx(other, output="x", na=2, nb=2, nk=1)], other, steps=[7])
    html = render_page(describe_page(compared, known=["bench.csv: output 'x' has 40 gaps"]))
    assert "Record bench.csv: output &#39;x&#39; has 40 gaps." in html
    assert ">7 ahead<" in html
    ahead = compared["arx"].validation["x"].ahead_rmse[7]
    unit = re.search(r"ahead: rms errors in (\S+)\.<", html)[1]
    assert f">{ahead * {'µm': 1e6, 'nm': 1e9}[unit]:#.4g}<" in html


@pytest.mark.parametrize("kind", ["fit", "check", "simulation", "linear model"])
def test_pages_are_whole_offline_and_can_be_read_aloud(kind: str, good: gb.Fit) -> None:
    run = gb.simulate(micro_actuator, {"time": 1e-3 * np.arange(50), "u": np.ones(50)})
    page = {
        "fit": lambda: describe_page(good),
        "check": lambda: describe_page(check(micro_actuator)),
        "simulation": lambda: describe_page(run, model=micro_actuator),
        "linear model": lambda: describe_page(gb.linearise(good)),
    }[kind]()
    found = Outline(render_page(page))
    assert found.headings[0] == 1 and found.headings.count(1) == 1
    assert all(b - a <= 1 for a, b in pairwise(found.headings))
    assert not [name for name, count in Counter(found.ids).items() if count > 1]
    assert found.tags["table"] == found.tags["caption"] > 0
    assert found.tags["math"] > 3 or kind == "linear model"
    assert found.tags["figure"] > 0
    assert not found.silent
    assert not found.fetched
    assert found.tags["main"] == found.tags["nav"] == found.tags["header"] == found.tags["footer"] == 1


def test_a_state_that_an_output_shows_is_not_drawn_twice() -> None:
    run = gb.simulate(micro_actuator, bench(100))
    assert {"x", "i"} <= set(run.states) & set(run.outputs)
    blocks = describe_page(run, model=micro_actuator).sections[0].blocks
    drawn = {b.figure.name: [p.name for p in b.figure.panels] for b in blocks if isinstance(b, FigureBlock)}
    assert drawn == {"outputs": ["x", "i"], "inputs": ["u"], "states": ["v"]}


def test_text_from_files_stays_text(good: gb.Fit, tmp_path: Path) -> None:
    named = replace(
        good,
        traces=[replace(good.traces[0], name=HOSTILE)],
        findings=(Finding(ComparisonFinding.NO_BLACK_BOX, values={"reason": HOSTILE}),),
        solver=replace(good.solver, status=HOSTILE),
    )
    html = write_page(describe_page(named, command=f"greybox fit '{HOSTILE}'"), tmp_path / "page.html").read_text(
        encoding="utf-8"
    )
    plain = Outline(render_page(describe_page(good)))
    found = Outline(html)
    assert found.tags["script"] == plain.tags["script"]
    assert found.tags["img"] == 0
    assert HOSTILE not in html


def test_text_in_figures_ends_no_script_and_is_no_markup() -> None:
    curve = Curve(np.arange(2.0), np.arange(2.0), Role.MEASURED, HOSTILE)
    panel = Panel(HOSTILE, (curve,), Axis(HOSTILE, HOSTILE), Axis(HOSTILE))
    figure = FigureBlock(Figure("a", (panel,), HOSTILE, (HOSTILE,)))
    html = render_page(
        Document(
            HOSTILE,
            HOSTILE,
            notes=[HOSTILE],
            question=HOSTILE,
            evidence=[],
            sections=[Section("data", "Data", [figure])],
            kind=HOSTILE,
        )
    )
    found = Outline(html)
    assert (found.tags["img"], found.tags["script"]) == (0, 3)
    data = json.loads(re.search(r'<script type="application/json">(.*?)</script>', html)[1])
    (view,) = data["views"]
    assert data["data"][0]["name"] == view["layout"]["yaxis"]["title"]["text"] == escape(HOSTILE, quote=False)
    assert view["name"] == HOSTILE


def test_many_long_records_make_a_page_that_can_be_mailed(good: gb.Fit) -> None:
    one = good.traces[0]
    repeat = 40

    def tiled(group: dict) -> dict:
        return {name: np.tile(values, repeat) for name, values in group.items()}

    time = 5e-4 * np.arange(repeat * len(one.time))
    long = replace(
        one, time=time, measured=tiled(one.measured), simulated=tiled(one.simulated), inputs=tiled(one.inputs)
    )
    many = replace(good, traces=[replace(long, name=f"r{k}") for k in range(24)])
    html = render_page(describe_page(many, tests=residual_tests(good)))
    assert len(html.encode()) < LARGEST_PAGE
    assert "The tables include 4 more records that are not drawn." in html


def test_numbers_travel_in_six_digits_and_gaps_as_gaps() -> None:
    given = np.array([0.1234567891, -1.987654321e-9, 12345678.9, 0.0, np.nan, np.inf])
    panel = Panel("x", (Curve(np.arange(6.0), given, Role.MEASURED),), Axis("time", "s"), Axis("x"))
    figure = FigureBlock(Figure("a", (panel,), "Phase over frequency."))
    html = render_page(Document("t", "v", question="q", sections=[Section("data", "Data", [figure])]))
    assert '"y":[0.123457,-1.98765e-09,12345700.0,0.0,null,null]' in html


def luminance(colour: str) -> float:
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_can_be_read_on_its_ground(theme: str) -> None:
    """Contrast of at least 4.5 to 1 (WCAG 2.2, 1.4.3)."""
    css = files("greybox.show.printers").joinpath("template", "page.css").read_text(encoding="utf-8")
    block = re.findall(r":root[^{]*\{([^}]*)\}", css)[theme == "dark"]
    colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", block))
    for ground in ("paper", "panel"):
        for ink in ("ink", "soft", "accent"):
            high, low = sorted((luminance(colours[ground]), luminance(colours[ink])), reverse=True)
            assert (high + 0.05) / (low + 0.05) >= 4.5, f"{ink} on {ground}"


def test_what_has_no_page_is_refused(tmp_path: Path) -> None:
    with pytest.raises(gb.GreyboxError, match="a dict has no page; give one of Fit"):
        gb.report({}, tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


def test_commands_leave_their_page_and_say_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["check", "micro_actuator", "--output", "out"])
    assert done.exit_code == 0, done.output
    assert done.stdout.splitlines()[-1] == f"files: {Path('out', 'check.json')}, {Path('out', 'report.html')}"
    assert sorted(p.name for p in Path("out").iterdir()) == ["check.json", "report.html"]
    pace = ["--step", "1", "--duration", "0.1", "--sampling-time", "1e-3"]
    CliRunner().invoke(app, ["simulate", "micro_actuator", *pace, "--output", "run.csv"])
    CliRunner().invoke(app, ["simulate", "micro_actuator", *pace, "--output", "bare.csv", "--no-report"])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bare.csv", "out", "run.csv", "run.html"]
    CliRunner().invoke(app, ["simulate", "micro_actuator", *pace, "--noise", "x=2e-7", "--output", "run.csv"])
    assert "x 2·10⁻⁷ m" in Path("run.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("written", "shown"),
    [
        ("0.5 N*s/m^2", "0.5 N s/m²"),
        ("-3e-4 +- 1e-5 rad/s^2", "−3·10⁻⁴ ± 1·10⁻⁵ rad/s²"),
        ("3 ohm", "3 Ω"),
        ("x*y^2", "x*y^2"),  # no number before it: a name
        ("5 of 10 rows", "5 of 10 rows"),
    ],
)
def test_a_unit_behind_a_number_of_a_cell_is_typeset(written, shown):
    assert cell(written).replace("\N{NO-BREAK SPACE}", " ") == shown


@pytest.mark.parametrize(
    ("how", "estimation", "validation"),
    [
        ({"transcription": "single", "free_run": True}, "misfit (free run)", "validation records (free run)"),
        ({"transcription": "multiple", "free_run": False}, "misfit (run in segments)", "records (run in segments)"),
        ({"transcription": "arcs", "free_run": False}, "misfit (run in arcs)", "validation records (free run)"),
    ],
)
def test_a_run_whose_states_were_fitted_is_not_called_free(how, estimation, validation):
    time = np.arange(50) * 0.1
    record = gb.Experiment("a", time, {"u": np.sin(time)}, {"y": np.sin(time - 0.3)})
    found = gb.fit(first_order(), record, validation=record, noise={"y": 0.01})
    how = replace(found.solver, statistics={**found.solver.statistics, **how})
    text = write(replace(found, solver=how), 200, details=True)
    assert estimation in text and validation in text
