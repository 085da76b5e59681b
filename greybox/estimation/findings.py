"""What a reader should know before trusting a fit: likely causes of a failure, active bounds, open directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from greybox.estimation.covariance import SANDWICH, ParameterCovariance
from greybox.estimation.parameter_constancy import VISIBLE, VISIBLE_BY_DIFFERENCES, ParameterShift
from greybox.estimation.robust_estimation import compute_noise_ratios
from greybox.estimation.simulation_failure import describe_simulation_failure
from greybox.estimation.solution import Solution
from greybox.experiment import Experiment, collect_record_findings
from greybox.experiment.findings import is_sensor_fault
from greybox.noise.noise_sources import NoiseSource
from greybox.optim import TerminationStatus
from greybox.result import Estimate, Misfit, Trace
from greybox.transcription import DecisionVector

# Validation over fitted error from which the difference wants an explanation.
WORSE = 1.5

# Sample-to-sample correlation of the residual from which it is worth a remark, if there is a residual at all.
COLOURED, LITTLE = 0.3, 0.1
# A model that follows less than this per cent of an output, with a misfit above so many times the noise, describes another plant.
FOLLOWS, FAR = 50.0, 3.0
# Constants that move are listed up to this number.
MOST_MOVES = 3
# Share of a standard deviation that half the step may move a constant; nobody asks for more digits than this share of its value.
SHIFTED, LAST_DIGIT = 0.1, 1e-6

CAUSES = {
    TerminationStatus.NO_START: (
        "start values far from physical ones",
        "an unstable model over a long record",
        "a missing bound (for example a level below zero)",
    ),
    TerminationStatus.ITERATION_LIMIT: (
        "constants that the data do not determine: fix one",
        "start values far off: give others with start",
        "too few iterations",
    ),
    TerminationStatus.STUCK: (
        "constants that the data do not determine: fix one",
        "an effect that is not smooth in its constants",
        "bounds that exclude the optimum",
    ),
    TerminationStatus.FAILED: (
        "start values far from physical ones",
        "an unstable model over a long record",
        "bounds that exclude the optimum",
    ),
}


def describe_status(solution: Solution, misfit: Mapping[str, Misfit]) -> str:
    """The status in plain words, with misfit over noise beside it: a wrong model converges too."""
    text = solution.status.value
    if solution.status in CAUSES:
        causes = "; ".join(f"({k + 1}) {cause}" for k, cause in enumerate(CAUSES[solution.status]))
        text += f". Likely causes, in order: {causes}"
    if solution.evaluation.failed:
        text += f". {describe_simulation_failure(solution.problem, solution.variables, *solution.evaluation.failed)}"
    elif misfit:
        ratio = compute_noise_ratios(solution, misfit)
        worst = max(ratio, key=lambda name: ratio[name])
        bulk = ", outliers aside" if solution.problem.loss else ""
        text += f"; misfit {ratio[worst]:.3g} times the noise in {worst}{bulk}"
    return text


def find_fit_issues(
    solution: Solution,
    found: ParameterCovariance,
    estimates: Mapping[str, Estimate],
    misfit: Mapping[str, Misfit],
    runs: Sequence[Trace],
    moves: Sequence[ParameterShift] = (),
    shift: np.ndarray | None = None,
) -> tuple[str, ...]:
    """Sentences in order of importance."""
    result = _another_plant(misfit)
    for direction in found.open_directions:
        result.append(f"not determined by these data: {describe_direction(direction)}")
    at_bound = [name for name, e in estimates.items() if e.at_bound]
    if at_bound:
        result.append(
            f"stopped by a bound: {', '.join(at_bound)}; widen the bound, or the model needs something else there"
        )
    wide = [n for n, e in estimates.items() if e.std is not None and not e.at_bound and not e.determined]
    if wide:
        result.append(f"not determined (the 95 % interval reaches further than half the value): {', '.join(wide)}")
    result += _excess(solution, misfit)
    result += describe_shifts(moves)
    coloured = [
        n for n, m in misfit.items() if m.noise_ratio > LITTLE and compute_lag_one_correlation(runs, n) > COLOURED
    ]
    if found.kind == SANDWICH and coloured and found.inflation is not None and np.isfinite(found.inflation).any():
        result.append(
            f"the residual of {', '.join(coloured)} is correlated from sample to sample: the intervals allow for it, and are up to"
            f" {np.nanmax(found.inflation):.2g} times as wide as white noise would make them"
        )
    error = dict(zip((o.name for o in solution.problem.model.outputs), solution.integration_error, strict=True))
    coarse = [n for n, m in misfit.items() if error[n] > 0.1 and error[n] > 0.01 * m.noise_ratio]
    if coarse:
        result.append(
            f"integration error above a tenth of the noise in {', '.join(coarse)}: raise the number of substeps"
        )
    rough = [] if shift is None else _moved_by_step(solution.variables, found, shift)
    if rough:
        listed = ", ".join(f"{n} by {s:.2g}" for n, s in rough)
        result.append(
            f"with half the step the constants change by more than a tenth of their standard deviation ({listed} of it):"
            " raise the number of substeps"
        )
    return tuple(result)


def _another_plant(misfit: Mapping[str, Misfit]) -> list[str]:
    """A warning where the model follows little of an output: then its constants mean nothing."""
    lost = {n: m.best_fit_percent for n, m in misfit.items() if m.best_fit_percent < FOLLOWS and m.noise_ratio > FAR}
    if not lost:
        return []
    listed = ", ".join(f"{max(percent, 0.0):.2g} % of {name}" for name, percent in lost.items())
    return [
        f"the model follows only {listed} (best fit, 100 % is all): do not use these constants. Check the units and the signs of the"
        " columns, the fixed constants, and whether this is the plant's model"
    ]


def _moved_by_step(variables: DecisionVector, found: ParameterCovariance, shift: np.ndarray) -> list[tuple[str, float]]:
    """Constants that half the step moves by too much of their standard deviation, and by how much of it."""
    deviations = np.sqrt(np.diag(found.covariance))
    known = np.isfinite(deviations) & np.isfinite(shift)
    change = np.where(known, shift, 0.0) * np.where(known, deviations, 0.0)
    moved = known & (shift > SHIFTED) & (change > LAST_DIGIT * np.abs(variables.base))
    return [(variables.names[k], float(shift[k])) for k in np.flatnonzero(moved)]


def _excess(solution: Solution, misfit: Mapping[str, Misfit]) -> list[str]:
    """What a misfit above the noise means, by how the noise is known."""
    louder = {n: ratio for n, ratio in compute_noise_ratios(solution, misfit).items() if ratio > VISIBLE}
    if not louder:
        return []
    sources = solution.problem.noise.sources
    if all(sources.get(n) is NoiseSource.DIFFERENCES and ratio < VISIBLE_BY_DIFFERENCES for n, ratio in louder.items()):
        return [
            "the misfit exceeds the noise that the records' differences show: the model lacks something, or the noise is"
            " coloured (a quiet record tells)"
        ]
    return ["the misfit exceeds the noise: the model lacks something, and the constants may imitate it"]


def describe_shifts(moves: Sequence[ParameterShift]) -> list[str]:
    """The sentence on constants that move; none where none does."""
    told = "; ".join(map(_moved, moves[:MOST_MOVES]))
    return [f"not constant: {told}: imitating something that the model lacks, or that changes"] if moves else []


def _moved(move: ParameterShift) -> str:
    return (
        f"{move.name} goes from {move.before:.4g} to {move.after:.4g} {move.unit} between {move.between},"
        f" {move.deviations:.2g} standard deviations of the noise"
    )


def collect_record_notes(experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """What is to be known about the records themselves; records that share a note share its sentence."""
    return tuple(map(str, collect_record_findings(experiments)))


def add_record_notes(remarks: Sequence[str], experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """``remarks`` on a fit and what is to be known about its records: first what casts doubt on a measurement, then the rest."""
    known = collect_record_findings(experiments)
    faults = [str(finding) for finding in known if is_sensor_fault(finding)]
    return (*faults, *remarks, *(str(finding) for finding in known if not is_sensor_fault(finding)))


def describe_direction(direction: Mapping[str, float]) -> str:
    """An undetermined direction in words: ``Kf, La, Ra scale together: fix one, or measure more``."""
    names = list(direction)
    if len(names) == 1:
        return f"{names[0]} has no influence on the measured outputs"
    return f"{', '.join(names)} can change together without changing the outputs: fix one of them, or measure another output"


def compute_lag_one_correlation(runs: Sequence[Trace], output: str) -> float:
    """Correlation of one output's residual with the sample before, over all records."""
    products, squares = 0.0, 0.0
    for run in runs:
        if output in run.measured:
            r = run.residual(output)
            pair = np.isfinite(r[1:]) & np.isfinite(r[:-1])
            products += float(r[1:][pair] @ r[:-1][pair])
            squares += float(r[np.isfinite(r)] @ r[np.isfinite(r)])
    return products / squares if squares > 0 else 0.0


def find_validation_issues(misfit: Mapping[str, Misfit], validation: Mapping[str, Misfit]) -> tuple[str, ...]:
    """Why an output is worse on records that were not fitted, where it visibly is."""
    return tuple(
        f"the error in {name} is {m.rmse / misfit[name].rmse:.1f} times that on the fitted records: a free run carries small errors of"
        " force and offset along, a plant that integrates adds them up, and constants differ from day to day; judge on shorter"
        " records as well"
        for name, m in validation.items()
        if name in misfit and m.noise_ratio > VISIBLE and m.rmse > WORSE * misfit[name].rmse
    )
