"""The misfit over noise of a fit is one number: in the answer, the tables, the page, the figure, the app and the JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import greybox as gb
from greybox.base.document import Tone
from greybox.data.noise import BoundDirection, GrowingNoise, NoiseSource
from greybox.estimation.result import load_fit
from greybox.estimation.result_parts import Misfit
from greybox.extensions.app.session import LoadedRecord, Session
from greybox.extensions.app.workbench import show_run
from greybox.show import text
from greybox.show.documents.fit import fit_tone
from greybox.show.figures.pictures import fit_sheets
from greybox.show.printers.html import render_page
from greybox.show.sentences.wording import format_with_std, make_formatter, ratio_text
from tests.support.first_order import first_order

NOISE = 0.02


def record(
    name: str,
    seed: int,
    *,
    wild: int = 0,
    sag: float = 0.0,
    noise: float = NOISE,
    gap: int = 0,
    rows: int = 400,
    start: float = 0.0,
    drift: float = 0.0,
) -> gb.Experiment:
    """A lag driven by steps, with white noise, ``wild`` readings, a ``gap`` in them, and a ``sag`` that no linear model has."""
    rng = np.random.default_rng(seed)
    time = 0.05 * np.arange(rows)
    drive = np.repeat(rng.normal(size=rows // 10), 10)
    level = np.full(rows, start)
    for k in range(rows - 1):
        part = level[k]
        for _ in range(20):  # y' = (gain u - y) / lag - sag y^3
            part += 0.05 / 20 * ((2.0 * drive[k] - part) / 0.5 - sag * part**3)
        level[k + 1] = part
    y = level + drift * time + noise * rng.normal(size=rows)
    y[rng.choice(rows, wild, replace=False)] += 5.0
    y[rows // 4 : rows // 4 + gap] = np.nan
    return gb.Experiment(name, time, {"u": drive}, {"y": y})


OPTIONS = gb.FitOptions(at_rest=True)
HUBER = gb.FitOptions(at_rest=True, loss="huber")
STUDENT = gb.FitOptions(at_rest=True, loss="student")
TOLD = {"noise": {"y": NOISE}}


def having(**options: Any) -> dict[str, Any]:
    return {**TOLD, "options": gb.FitOptions(**{"at_rest": True, **options})}


# What is fitted, and what the noise is known from.
KINDS = {
    "told": ({}, {"noise": {"y": NOISE}}),
    "told too small": ({}, {"noise": {"y": NOISE / 7}}),
    "estimated": ({}, {}),
    "not explained, told": ({"sag": 1.0}, {"noise": {"y": NOISE}}),
    "not explained, estimated": ({"sag": 1.0}, {}),
    "huber, told": ({"wild": 20}, {"noise": {"y": NOISE}, "options": HUBER}),
    "huber, estimated": ({"wild": 20}, {"options": HUBER}),
    "student, told": ({"wild": 20}, {"noise": {"y": NOISE}, "options": STUDENT}),
    "huber, not explained": ({"wild": 20, "sag": 1.0}, {"noise": {"y": NOISE}, "options": HUBER}),
    "squares over wild readings": ({"wild": 20}, {"noise": {"y": NOISE}}),
    "grows with the signal": ({}, {"noise": {"y": GrowingNoise(floor=NOISE, share=0.01)}}),
    "growth estimated": ({}, {"noise": {"y": GrowingNoise()}}),
    "grows, not explained": ({"sag": 1.0}, {"noise": {"y": GrowingNoise(floor=NOISE, share=0.01)}}),
    "student, estimated": ({"wild": 20}, {"options": STUDENT}),
    "huber with a limit of its own": ({"wild": 20}, having(loss="huber:2.5")),
    "hardly any noise": ({"noise": 1e-6}, {"noise": {"y": 1e-6}}),
    "large units": ({"noise": 50.0}, {"noise": {"y": 50.0}}),
    "gaps": ({"gap": 60}, TOLD),
    "gaps, estimated": ({"gap": 60}, {}),
    "few rows": ({"rows": 30}, TOLD),
    "drifts": ({"drift": 0.02}, TOLD),
    "drifts, estimated": ({"drift": 0.02}, {}),
    "first state free": ({"start": 2.0}, having(at_rest=False)),
    "multiple shooting": ({}, having(transcription="multiple")),
    "multiple shooting, not explained": ({"sag": 1.0}, having(transcription="multiple")),
    "collocation": ({"rows": 100}, having(transcription="collocation-radau")),
    "arcs": ({}, having(transcription="arcs", at_rest=False, arc_length=5.0)),
    "steps of its own": ({}, having(method="rk4", substeps=3)),
    "rows not counted": ({}, {**TOLD, "skip": 40}),
    "first rows for the state": ({"start": 2.0}, {**having(at_rest=False), "beginning": 20}),
    "a prior": ({}, {**TOLD, "model": lambda model: model.prior(lag=(0.5, 0.01))}),
    "a constant known wrongly": ({}, {**TOLD, "model": lambda model: model.fix(lag=0.6)}),
}


class Fits(dict[str, tuple[gb.Fit, Path]]):
    """The fit of each kind and its file; made when a test asks for it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __missing__(self, kind: str) -> tuple[gb.Fit, Path]:
        rig, given = KINDS[kind]
        options = {"options": OPTIONS, **given}
        model = options.pop("model", lambda model: model)(first_order())
        fit = gb.fit(model, record("a", 1, **rig), validation=record("b", 2, **rig), **options)
        self[kind] = fit, fit.save(self.folder / f"{list(KINDS).index(kind)}.json")
        return self[kind]


@pytest.fixture(scope="module")
def fits(tmp_path_factory: pytest.TempPathFactory) -> Fits:
    return Fits(tmp_path_factory.mktemp("fits"))


@pytest.mark.crossed(3)
@pytest.mark.parametrize("kind", KINDS)
def test_one_ratio_is_told_everywhere_to_its_last_digit(kind: str, fits: dict[str, tuple[gb.Fit, Path]]) -> None:
    fit, file = fits[kind]
    saved = json.loads(file.read_text(encoding="utf-8"))
    for stored, m in ((saved["misfit"]["y"], fit.misfit["y"]), (saved["validation"]["y"], fit.validation.misfit["y"])):
        assert stored["noise_ratio"] == m.noise_ratio
        # The ratio is that of the two numbers beside it.
        assert stored["error"] / stored["noise"] == pytest.approx(m.noise_ratio, rel=1e-12)
    fitted, judged = (ratio_text(m) for m in (fit.misfit["y"], fit.validation.misfit["y"]))
    answer = " ".join(str(fit).partition("\n\n")[0].split())
    assert f"is {fitted} times the noise" in answer and f", {judged} times in y." in answer
    assert f"{fitted} x noise" in text(fit, 200, details=True) and f"{judged} x noise" in text(fit, 200, details=True)
    page = render_page(fit.describe())
    assert f"{fitted} times the noise" in page and f"{fitted}\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}noise" in page
    session = Session(fit.model, tuple(LoadedRecord(t.experiment, Path(t.name)) for t in fit.traces)).with_fit(fit)
    (row,) = show_run(session, 0)["misfit"]["rows"]
    assert row[-1].startswith(f"{fitted} x noise")
    titles = [title for sheet in fit_sheets(fit, 0) for cell in sheet.cells for title in cell.titles]
    assert any(f"misfit {fitted} × noise" in title for title in titles)
    assert any(f"misfit {judged} × noise" in title for title in titles)


def test_a_robust_fit_that_is_right_is_told_to_be_right(fits: dict[str, tuple[gb.Fit, Path]]) -> None:
    for kind in ("huber, told", "student, told"):
        m, judged = fits[kind][0].misfit["y"], fits[kind][0].validation.misfit["y"]
        assert m.without_outliers and judged.without_outliers and m.rmse > 40 * NOISE
        # rms of normal noise without the few readings beyond the loss's outliers
        assert 0.9 < m.noise_ratio < 1.1 and 0.9 < judged.noise_ratio < 1.1
        assert fit_tone(fits[kind][0]) is Tone.GOOD
    assert fits["squares over wild readings"][0].misfit["y"].noise_ratio > 20
    wrong = fits["huber, not explained"][0].misfit["y"]
    assert wrong.noise_ratio > 3  # a wrong model has no outliers to hide behind


def test_what_the_noise_is_known_from_stands_with_the_ratio(fits: dict[str, tuple[gb.Fit, Path]]) -> None:
    told, estimated = fits["told"][0], fits["not explained, estimated"][0]
    assert (told.misfit["y"].source, told.misfit["y"].noise) == (NoiseSource.GIVEN, NOISE)
    m, judged = estimated.misfit["y"], estimated.validation.misfit["y"]
    assert m.source not in (None, NoiseSource.GIVEN) and (judged.source, judged.noise) == (m.source, m.noise)
    assert (m.direction is BoundDirection.AT_MOST) == ratio_text(m).startswith("at least ")
    fit, file = fits["huber, told"]
    again = load_fit(file, first_order())
    assert again.misfit == fit.misfit and again.validation.misfit == fit.validation.misfit


def test_a_frame_is_green_only_where_the_validation_passes(fits: dict[str, tuple[gb.Fit, Path]]) -> None:
    fit = fits["told"][0]
    assert fit_tone(fit) is Tone.GOOD
    worse = {"y": replace(fit.validation.misfit["y"], noise_ratio=9.0)}
    assert fit_tone(replace(fit, validation=replace(fit.validation, misfit=worse))) is Tone.CAUTION
    assert fit_tone(replace(fit, validation=replace(fit.validation, misfit={}, traces=()))) is Tone.PLAIN
    assert fit_tone(fits["not explained, told"][0]) is Tone.CAUTION
    # The mean of a constant that each record has for itself judges nothing.
    own = replace(fit.constraints, per_experiment={"lag": {"a": fit.parameters["lag"]}})
    mean = replace(fit, constraints=own, validation=replace(fit.validation, misfit=worse))
    assert fit_tone(mean) is Tone.PLAIN and "which judges nothing" in " ".join(str(mean).split())
    # Nor does a copy of what was fitted, whatever it is called.
    copies = replace(fit.validation, traces=[replace(trace, name="another") for trace in fit.traces])
    copied = replace(fit, validation=copies)
    assert fit_tone(copied) is Tone.PLAIN and "which judges nothing" in " ".join(str(copied).split())


@pytest.mark.parametrize(
    ("value", "std", "written"),
    [
        (0.0441, 2.2, "0.044 +- 2.2"),
        (-0.0441, 2.2, "-0.044 +- 2.2"),
        (5895.4, 44.0, "5895 +- 44"),
        (0.2691, 0.00034, "0.26910 +- 0.00034"),
        (5.01e-4, 3e-6, "5.010e-04 +- 3.0e-06"),
        (3e-5, 2e-3, "3.0e-05 +- 2.0e-03"),
        (0.0, 2.2, "0.0 +- 2.2"),
        (7.3e8, 4e9, "7.3e+08 +- 4.0e+09"),
    ],
)
def test_a_number_has_the_digits_of_its_uncertainty_and_two_of_its_own(value: float, std: float, written: str) -> None:
    assert format_with_std(value, std) == written
    assert float(make_formatter(value, std)(value)) == pytest.approx(value, rel=0.05)


def test_ratios_are_written_in_three_digits() -> None:
    def written(ratio: float) -> str:
        return ratio_text(Misfit(1.0, "m", 50.0, ratio, 10))

    assert [written(r) for r in (0.7541, 1.0, 35.26, 100.2, 1320.4)] == ["0.754", "1.00", "35.3", "100", "1320"]
