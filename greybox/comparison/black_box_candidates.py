"""Every black box that the estimation records support, each chosen by its own scan: what a physical model has to beat."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from greybox.base.errors import DataError
from greybox.base.numerics import SAME_SAMPLING_TIME, TINY
from greybox.base.values import Finding, Severity
from greybox.comparison.blackbox.best_models import best_black_boxes
from greybox.comparison.blackbox.resample import Fold, hold_out, keep_measured_rows, match_sampling_time, resample
from greybox.comparison.blackbox.structure_scan import AS_GOOD
from greybox.comparison.blackbox.subspace import StateSpaceModel, SubspaceOutput, scan_orders, subspace
from greybox.comparison.compare import NamedModel
from greybox.comparison.result import DEFAULT_COMPARISON, BlackBoxModel, ComparisonFinding, ComparisonPolicy
from greybox.data.experiment import Experiment

STATE_SPACE = "subspace"

BlackBoxProgress = Callable[[str, int, int], None]


def fit_black_boxes(
    training: Sequence[Experiment],
    outputs: Sequence[str],
    inputs: Sequence[str],
    *,
    at_rest: bool = False,
    units: Mapping[str, str] | None = None,
    report: BlackBoxProgress | None = None,
    policy: ComparisonPolicy = DEFAULT_COMPARISON,
) -> tuple[tuple[NamedModel, ...], tuple[Finding, ...]]:
    """Fit the best ARX, ARMAX, output-error, Box-Jenkins and Hammerstein model of each output.

    Where there are several inputs or outputs a state-space model of all of them is identified as well, by subspace projection. Models of
    one kind for several outputs are compared together. Records of irregular time are resampled at their usual step, and
    an output measured in few of the rows has its models on those rows.

    Parameters
    ----------
    training
        The estimation records.
    outputs, inputs
        Names of the signals.
    at_rest
        The plant rests before each record, as of `best_black_boxes`.
    units
        Name of a signal -> unit.
    report
        Called as ``report(what, done, total)`` on the way.
    policy
        How structures are chosen, and which rows are used.

    Returns
    -------
    tuple
        The models with their names, and findings: what could not be fitted, and what was done to the records.

    Examples
    --------
    >>> black, findings = gb.comparison.fit_black_boxes([record], ["x"], ["u"])  # doctest: +SKIP
    """
    regular, findings = _make_regular(training)
    models: dict[str, list[BlackBoxModel]] = {}
    seconds: dict[str, float] = {}
    for output in outputs:

        def report_kind(kind: str, done: int, total: int, output: str = output) -> None:
            if report is not None:
                report(f"{kind} of {output}", done, total)

        records, sparse = _select_rows(regular, output)
        findings += sparse
        try:
            scans = best_black_boxes(
                records,
                output=output,
                inputs=inputs,
                at_rest=at_rest,
                units=units,
                report=report_kind,
                policy=policy.scan,
            )
        except DataError as error:
            findings.append(Finding(ComparisonFinding.NO_BLACK_BOX, Severity.WARNING, output, {"reason": str(error)}))
            continue
        for kind, scan in scans.items():
            name = kind.replace(" ", "_").replace("-", "_")
            models.setdefault(name, []).append(scan.best)
            seconds[name] = seconds.get(name, 0.0) + scan.seconds
    if len(outputs) + len(inputs) > 2:
        began = time.perf_counter()
        boxes, failed = _identify_state_space(regular, outputs, inputs)
        findings += failed
        if boxes:
            models[STATE_SPACE] = list(boxes)
            seconds[STATE_SPACE] = time.perf_counter() - began
    named = tuple(NamedModel(name, tuple(boxes), seconds[name]) for name, boxes in models.items())
    return named, tuple(findings)


def check_sampling_times(
    training: Sequence[Experiment], validation: Sequence[Experiment], outputs: Sequence[str]
) -> None:
    """DataError, before anything is fitted, for a validation record of another sampling time than the black boxes will have."""
    regular, _ = _make_regular(training)
    for output in outputs:
        records, _ = _select_rows(regular, output)
        if records:
            for record in (e for e in validation if output in e.outputs):
                match_sampling_time(record, output, float(np.median(records[0].intervals)), "a black box")


def _make_regular(records: Sequence[Experiment]) -> tuple[tuple[Experiment, ...], list[Finding]]:
    """The records at one equal step, and what was done to them."""
    steps = [float(np.median(e.intervals)) for e in records]
    result, findings = [], []
    for record, step in zip(records, steps, strict=True):
        matches = record.regular and np.isclose(step, steps[0], rtol=SAME_SAMPLING_TIME)
        if not matches:
            values = {"sampling_time": steps[0]}
            findings.append(Finding(ComparisonFinding.RECORD_RESAMPLED, subject=record.name, values=values))
        result.append(record if matches else resample(record, steps[0]))
    return tuple(result), findings


# An output measured in fewer than this share of the rows has its black boxes on the rows where it is measured.
DENSE_SHARE = 0.5


def _select_rows(records: Sequence[Experiment], output: str) -> tuple[tuple[Experiment, ...], list[Finding]]:
    """The records at the rows at which a slow sensor measures ``output``; as they are for any other output."""
    with_output = [e for e in records if output in e.outputs and np.isfinite(e.outputs[output]).any()]
    if not with_output:
        return (), []
    measured = np.concatenate([np.isfinite(e.outputs[output]) for e in with_output])
    if np.mean(measured) >= DENSE_SHARE:
        return tuple(with_output), []
    sparse = [e for e in (keep_measured_rows(e, output) for e in with_output) if e is not None]
    steps = np.array([e.sampling_time or np.nan for e in sparse])
    if len(sparse) < len(with_output) or not np.allclose(steps, steps[0], rtol=SAME_SAMPLING_TIME):
        return tuple(with_output), []
    values = {"sampling_time": float(steps[0])}
    return tuple(sparse), [Finding(ComparisonFinding.MEASURED_ROWS_ONLY, subject=output, values=values)]


def _identify_state_space(
    records: Sequence[Experiment], outputs: Sequence[str], inputs: Sequence[str]
) -> tuple[tuple[SubspaceOutput, ...], list[Finding]]:
    """One model of every input and output: of the order and weights whose free run follows rows that it was not fitted to best."""
    folds = hold_out(records, outputs, inputs)

    def measure(model: StateSpaceModel, fold: Fold) -> float:
        """Mean square of the free run's error over that of the outputs' movement; infinite for a run that overflows."""
        scores = [fold.score(box, box.output) for box in model.boxes()]
        return sum((s.rmse / max(s.movement, TINY)) ** 2 for s in scores)

    try:
        errors: dict[tuple[str, int], list[float]] = {}
        for fold in folds:
            for model in scan_orders(fold.estimation, outputs, inputs):
                errors.setdefault((model.weight, model.order), []).append(measure(model, fold))
        tried = {key: float(np.mean(each)) for key, each in errors.items() if len(each) == len(folds)}
        # As of a difference equation: of those that run equally well the smallest.
        limit = (1 + AS_GOOD) ** 2 * min(tried.values())
        weight, order = min((key for key, error in tried.items() if error <= limit), key=lambda key: key[1])
        best = subspace(records, order, outputs=outputs, inputs=inputs, weight=weight)
    except DataError as error:
        return (), [Finding(ComparisonFinding.NO_STATE_SPACE, Severity.NOTE, "", {"reason": str(error)})]
    return best.boxes(), []
