"""Fitted on a step, judged on a sweep: which models of the micro-motion actuator hold where they were not fitted?

Records of the stand-in (`fits.papers.micromotion_twin`: generated, not measured): the paper's step to fit, a sweep from 5 to 400 Hz and of
1 V to judge, at the same 4 kHz and at 10 kHz. The physical model is equation 16.2 with a delay; mass, resistance and back EMF
constant are given, three combinations and the delay are fitted. Against it the paper's black boxes (its best ARX and ARMAX,
Monte-Carlo smoothing with its intervals) and output-error models, which the paper does not have.

    python -m fits.papers.micromotion_chirp [--output docs/studies]

What to expect: on the step every output-error kind of fit looks alike (within 5 %), on the sweep they differ by a factor of 2.5, and
nothing in the step says which to take. The physical model has no such choice and keeps its error. ARX and ARMAX are off by 13 to 23
times as much. A well chosen output-error model is as good as physics at its own sampling rate: there the gain is the criterion, not
the physics. At another sampling rate it says nothing, and the physical model is what it was.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import greybox as gb
from fits.papers import micromotion_printed as printed
from fits.papers.micromotion_smoothing import MonteCarloSmoothing, monte_carlo_smoothing
from fits.papers.micromotion_twin import DELAY, MICRO, ROWS, SAMPLING_TIME, SEED, in_micrometres, record, step_record
from fits.papers.paper_page import MEASURED, MODELS, Say, docs_folder, legend, markdown, picture, save, write_section
from greybox.comparison.blackbox.arx import arx
from greybox.comparison.blackbox.polynomial import PolynomialModel
from greybox.comparison.blackbox.prediction_error_models import armax, output_error
from greybox.data.signals import chirp
from models.micro_actuator import micro_actuator_no_inductance

BAND, FAST = (5.0, 400.0), 1e-4  # Hz; s
OFF = {"B": 0.4, "K": 4500.0, "Kf": 1.0, "delay": 1e-4}  # where the search starts
SHOWN = ("armax(4,1,1,3)", "smoothing", "oe(2,2,1)")  # in the figure, beside the physical model
BlackBox = PolynomialModel | MonteCarloSmoothing


@dataclass(frozen=True)
class Score:
    """Free-run errors in um rms: on the step, on the sweep, and on the sweep at 10 kHz (None where the model says nothing)."""

    step: float
    sweep: float
    fast: float | None = None


@dataclass(frozen=True, eq=False)
class Study:
    """The physical fit, the black boxes by name, and the scores of all; "physical" is the first."""

    fit: gb.Fit
    boxes: Mapping[str, BlackBox]
    scores: Mapping[str, Score]


def sweep(sampling_time: float = SAMPLING_TIME) -> gb.Experiment:
    """The judging record."""
    t = np.arange(0, ROWS * SAMPLING_TIME, sampling_time)
    return record(chirp(t, *BAND, 1.0), SEED + 1, sampling_time=sampling_time, name="sweep")


def physical() -> gb.Model:
    """Equation 16.2 with a delay, at wrong values."""
    return (micro_actuator_no_inductance + gb.effect("transport_delay")).fix("M", "Ra", "Kv").start(**OFF)


def fitted_on_step(step: gb.Experiment) -> gb.Fit:
    """The physical model fitted to the step, which begins at rest."""
    return gb.fit(physical(), step, options=gb.FitOptions(at_rest=True))


def black_boxes(step: gb.Experiment) -> dict[str, BlackBox]:
    """The paper's best ARX and ARMAX and its smoothing, and output-error models of order two; on the step in um."""
    models: dict[str, BlackBox] = {
        "arx(5,1,3)": arx(step, na=5, nb=1, nk=3),
        "armax(4,1,1,3)": armax(step, na=4, nb=1, nc=1, nk=3, history="zero"),
        "smoothing": monte_carlo_smoothing(
            step, seed=SEED, intervals=printed.INTERVALS, specification=printed.SPECIFICATION
        ),
    }
    for nb, nk in ((2, 1), (2, 2), (3, 1), (3, 2)):
        models[f"oe({nb},2,{nk})"] = output_error(step, nb=nb, nf=2, nk=nk, history="zero")
    return models


def study() -> Study:
    """Everything."""
    step, judge, fast = step_record(), sweep(), sweep(FAST)
    fit = fitted_on_step(step)
    scores = {"physical": Score(*(_rms(r, gb.simulate(fit.model, r).outputs) for r in (step, judge, fast)))}
    boxes = black_boxes(in_micrometres(step))
    for name, model in boxes.items():
        scores[name] = Score(_judged(model, step), _judged(model, judge), _where_it_holds(model, fast))
    return Study(fit, boxes, scores)


def _judged(model: BlackBox, record: gb.Experiment) -> float:
    return _rms(record, _in_metres(model.simulate(in_micrometres(record), initial="zero")))


def _where_it_holds(model: BlackBox, record: gb.Experiment) -> float | None:
    """Its error, or None where it refuses the record."""
    try:
        return _judged(model, record)
    except gb.errors.DataError:
        return None


def _in_metres(outputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: y / MICRO for name, y in outputs.items()}


def _rms(record: gb.Experiment, outputs: Mapping[str, np.ndarray]) -> float:
    return MICRO * float(np.sqrt(np.mean((record.outputs["x"] - outputs["x"]) ** 2)))


def verdict(s: Study) -> None:
    """The physical model keeps its error; black boxes that look alike on the step do not look alike on the sweep."""
    fit, scores = s.fit, s.scores
    assert fit.success
    low, high = fit.parameters["delay"].interval or (np.nan, np.nan)
    assert low < DELAY < high
    physical = scores["physical"]
    assert physical.sweep < 1.5 * physical.step and physical.fast is not None and physical.fast < 1.5 * physical.step
    alike = [s for s in scores.values() if s.step < 1.05 * physical.step]
    assert len(alike) >= 5 and max(s.sweep for s in alike) > 2 * physical.sweep
    assert scores["arx(5,1,3)"].sweep > 15 * physical.sweep and scores["armax(4,1,1,3)"].sweep > 8 * physical.sweep
    assert scores["smoothing"].sweep > 1.5 * physical.sweep
    assert all(s.fast is None for name, s in scores.items() if name != "physical")
    # honest: the right output-error structure is as good as physics, at this sampling rate
    assert min(s.sweep for name, s in scores.items() if name.startswith("oe")) < 1.1 * physical.sweep


def write(s: Study, folder: Path) -> None:
    """The page's part and its figure."""
    rows = [
        [name, f"{e.step:.3f}", f"{e.sweep:.3f}", "needs a new fit" if e.fast is None else f"{e.fast:.3f}"]
        for name, e in s.scores.items()
    ]
    text = [
        "### Fitted on a step, judged on a sweep (`fits/papers/micromotion_chirp.py`)",
        "Free-run errors in um rms; all models are fitted to the step alone. Records generated, not measured.",
        markdown(["model", "step", "sweep, 5 to 400 Hz", "sweep recorded at 10 kHz"], rows),
        "Models that look alike on the step differ on the sweep, and the step does not say which to take. The right output-error"
        " structure is as good as physics at its own sampling rate: that much of the gain is the criterion, not the physics.",
        "![The sweep, and what each model leaves of it](figures/only_physics_sweep.png)",
    ]
    write_section(folder, "3b", "\n\n".join(text))
    draw(s, folder)


def draw(s: Study, folder: Path) -> None:
    """The sweep, and what the models leave of it."""
    judge = in_micrometres(sweep())
    t, y = 1e3 * judge.time, judge.outputs["x"]
    runs = {name: s.boxes[name].simulate(judge, initial="zero")["x"] for name in SHOWN}
    runs["physical"] = MICRO * gb.simulate(s.fit.model, judge).outputs["x"]
    figure, (above, below) = picture(2, height=2.6)
    above.plot(t, y, color=MEASURED, lw=1.2, label="generated sweep")
    for colour, (name, run) in zip((*MODELS[1:], MODELS[0]), runs.items(), strict=True):
        below.plot(t, y - run, color=colour, lw=0.8, label=name)
    legend(above, "", "displacement [µm]", "Fitted on a step, judged on a sweep from 5 to 400 Hz")
    legend(below, "time [ms]", "error [µm]", "what the models leave of it", columns=4)
    save(figure, folder, "only_physics_sweep")


def main(folder: Path, say: Say = sys.stdout.write) -> None:
    """The whole study; a few seconds."""
    result = study()
    say(f"{result.fit}\n")
    verdict(result)
    write(result, folder)
    say(f"written to {folder}\n")


if __name__ == "__main__":
    main(docs_folder("papers.micromotion_chirp"))
