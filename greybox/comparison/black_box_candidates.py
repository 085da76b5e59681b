"""Every black box that the training records bear, each chosen by its own scan: what a physical model has to beat."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from greybox.blackbox import best_black_boxes, keep_measured_rows, monte_carlo_smoothing, resample
from greybox.comparison.black_box_runs import match_sampling_time
from greybox.comparison.compare import NamedModel
from greybox.comparison.result import BlackBoxModel
from greybox.errors import DataError
from greybox.experiment import Experiment

SMOOTHING = "monte_carlo_smoothing"
SEED = 1  # of the random jumping, so that a comparison can be repeated
STILL = 0.1  # of an output's range, by which it may begin away from zero and still count as at rest
# An output measured in fewer than this share of the rows has no history at the records' own step.
DENSE = 0.5

BlackBoxProgress = Callable[[str, int, int], None]


def fit_black_boxes(
    training: Sequence[Experiment],
    outputs: Sequence[str],
    inputs: Sequence[str],
    *,
    at_rest: bool = False,
    units: Mapping[str, str] | None = None,
    report: BlackBoxProgress | None = None,
) -> tuple[tuple[NamedModel, ...], tuple[str, ...]]:
    """The best ARX, ARMAX, output-error, Box-Jenkins and Hammerstein model of each output, and Monte-Carlo smoothing of a step.

    Models of one kind for several outputs make one contestant. ``at_rest``: everything was zero before each record; it is not
    assumed where an output begins elsewhere. Records of irregular time are resampled at their usual step, and an output measured in
    few of the rows has its models on those rows. ``report(what, done, of)`` is called on the way. Also returns, in words, what
    could not be fitted and what was done to the records.
    """
    even, notes = _even(training)
    found: dict[str, list[BlackBoxModel]] = {}
    seconds: dict[str, float] = {}
    for output in outputs:

        def tell(what: str, done: int, of: int, output: str = output) -> None:
            if report is not None:
                report(f"{what} of {output}", done, of)

        records = _dense(even, output, notes)
        rest = at_rest and _begins_at_rest(records, output)
        try:
            scans = best_black_boxes(records, output=output, inputs=inputs, at_rest=rest, units=units, report=tell)
        except DataError as error:
            notes.append(str(error))
            continue
        for what, scan in scans.items():
            name = what.replace(" ", "_").replace("-", "_")
            found.setdefault(name, []).append(scan.best)
            seconds[name] = seconds.get(name, 0.0) + scan.seconds
    for output in outputs:
        began = time.perf_counter()
        smoothed = _smoothed(even, output, inputs, units or {}, notes)
        if smoothed is not None:
            found.setdefault(SMOOTHING, []).append(smoothed)
            seconds[SMOOTHING] = seconds.get(SMOOTHING, 0.0) + time.perf_counter() - began
    return tuple(NamedModel(name, tuple(models), seconds[name]) for name, models in found.items()), tuple(notes)


def check_sampling_times(training: Sequence[Experiment], judging: Sequence[Experiment], outputs: Sequence[str]) -> None:
    """DataError, before anything is fitted, for a record that no black box of the ``training`` records could be judged on."""
    even, notes = _even(training)
    for output in outputs:
        records = _dense(even, output, notes)
        if records:
            for record in (e for e in judging if output in e.outputs):
                match_sampling_time(record, output, float(np.median(records[0].intervals)), "a black box")


def _even(records: Sequence[Experiment]) -> tuple[tuple[Experiment, ...], list[str]]:
    """The records at one equal step, and what was done to them."""
    steps = [float(np.median(e.intervals)) for e in records]
    notes: list[str] = []
    result = []
    for record, step in zip(records, steps, strict=True):
        alike = record.regular and np.isclose(step, steps[0], rtol=2e-3)
        if not alike:
            notes.append(
                f"{record.name}: resampled to every {steps[0]:.6g} s for the black boxes, which need one and the same step"
            )
        result.append(record if alike else resample(record, steps[0]))
    return tuple(result), notes


def _dense(records: Sequence[Experiment], output: str, notes: list[str]) -> tuple[Experiment, ...]:
    """The records at the rows at which a slow sensor measures ``output``; as they are for any other output."""
    shown = [e for e in records if output in e.outputs and np.isfinite(e.outputs[output]).any()]
    if not shown or np.mean(np.concatenate([np.isfinite(e.outputs[output]) for e in shown])) >= DENSE:
        return tuple(shown)
    sparse = [keep_measured_rows(e, output) for e in shown]
    there = [e for e in sparse if e is not None]
    steps = np.array([e.sampling_time or np.nan for e in there])
    if len(there) < len(shown) or not np.allclose(steps, steps[0], rtol=2e-3):
        return tuple(shown)
    notes.append(f"{output}: black boxes at the rows where it is measured, every {steps[0]:.6g} s")
    return tuple(there)


def _begins_at_rest(records: Sequence[Experiment], output: str) -> bool:
    """Whether the ``output`` begins near zero, as seen from how far it moves."""
    for record in records:
        y = record.outputs[output]
        y = y[np.isfinite(y)]
        if len(y) and abs(y[0]) > STILL * np.ptp(y):
            return False
    return True


def _smoothed(
    records: Sequence[Experiment], output: str, inputs: Sequence[str], units: Mapping[str, str], notes: list[str]
) -> BlackBoxModel | None:
    """Monte-Carlo smoothing of the first record that is a single step from zero; None where none is, or it has no resonance."""
    for record in records:
        steps = [name for name in inputs if _is_step(record.inputs[name])]
        if len(steps) != 1 or len(inputs) != 1 or output not in record.outputs:
            continue
        try:
            return monte_carlo_smoothing(record, seed=SEED, output=output, input=steps[0], units=units)
        except DataError as error:
            notes.append(f"{SMOOTHING}: {error}")
    return None


def _is_step(u: np.ndarray) -> bool:
    return np.count_nonzero(np.diff(u, prepend=0.0)) == 1
