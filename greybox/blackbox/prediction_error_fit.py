"""A prediction-error model from candidates of a start to the finished value with covariance and notes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from greybox.blackbox.linear_regression import COLLINEAR, SHARE, refuse_few_rows
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.prediction_error import (
    ENOUGH,
    ITERATIONS,
    PredictionErrorMinimum,
    PredictionErrors,
    compute_prediction_errors,
    minimise,
    split_records,
    stabilise,
)
from greybox.blackbox.rounding import find_instability
from greybox.blackbox.sampled_data import SampledData, SampledRecord
from greybox.blackbox.structure import PolynomialStructure
from greybox.errors import DataError, nearest

HistoryTreatment = Literal["estimated", "zero"]
SAME = 1e-3  # relative difference of two candidates' sums of squares that makes them one


@dataclass(frozen=True)
class SearchEffort:
    """How hard to search: ``starts`` that are followed, best first, for ``race`` iterations, after which only the best goes on for
    at most ``iterations`` or until it gains less than ``enough`` of the sum of squares."""

    starts: int = 3
    race: int = 8
    iterations: int = ITERATIONS
    enough: float = ENOUGH


@dataclass(frozen=True, eq=False)
class PredictionErrorProblem:
    """A structure and the stretches of the records that it is fitted to; ``rest``: all was zero before them."""

    structure: PolynomialStructure
    data: SampledData
    parts: tuple[SampledRecord, ...]
    rest: bool

    def evaluate(self, theta: np.ndarray, slopes: bool) -> PredictionErrors:
        """Errors of the stretches at the coefficients ``theta`` (p,)."""
        return compute_prediction_errors(self.structure, theta, self.data, self.parts, rest=self.rest, slopes=slopes)

    def admissible(self, theta: np.ndarray) -> np.ndarray:
        """The coefficients with stable filters."""
        return stabilise(self.structure, theta)


def fit_prediction_error(
    structure: PolynomialStructure,
    data: SampledData,
    begin: Callable[[PolynomialStructure, SampledData, bool], Sequence[np.ndarray]],
    history: HistoryTreatment,
    units: Mapping[str, str] | None = None,
    effort: SearchEffort | None = None,
) -> PolynomialModel:
    """The best minimum from the best of the starts that ``begin`` makes of structure, records and whether all was zero before.

    Raises DataError where there are too few rows or the columns are collinear.
    """
    effort = effort or SearchEffort()
    problem = PredictionErrorProblem(structure, data, split_records(data, structure), history == "zero")
    label = structure.model(np.zeros(structure.size), data).label
    count = int(sum(np.isfinite(part.y).sum() for part in problem.parts))
    refuse_few_rows(data, label, count, structure.size, history)
    starts = [problem.admissible(start) for start in begin(structure, data, problem.rest)]
    at = [problem.evaluate(start, False) for start in starts] if problem.parts else []
    refuse_few_rows(data, label, count - max((e.states for e in at), default=0), structure.size, history)
    best = minimise_from_starts(problem, starts, [e.squares for e in at], effort)
    return _finished(structure, data, best, count, label, history, units or {})


def minimise_from_starts(
    problem: PredictionErrorProblem, starts: Sequence[np.ndarray], squares: Sequence[float], effort: SearchEffort
) -> PredictionErrorMinimum:
    """Short searches from the ``starts`` that differ, and a long one from where the best of them ended."""
    chosen: list[int] = []
    for k in sorted(range(len(starts)), key=lambda k: squares[k]):
        if all(abs(squares[k] - squares[c]) > SAME * squares[c] for c in chosen):
            chosen.append(k)
    first = effort.race if len(chosen[: effort.starts]) > 1 else effort.iterations
    races = [
        minimise(problem.evaluate, problem.admissible, starts[k], iterations=first, enough=effort.enough)
        for k in chosen[: effort.starts]
    ]
    best = min(races, key=lambda m: m.errors.squares)
    if best.converged or first == effort.iterations:
        return best
    return minimise(
        problem.evaluate, problem.admissible, best.theta, iterations=effort.iterations, enough=effort.enough
    )


def check_history(history: str) -> None:
    """Refuse, with DataError, a history that is neither estimated nor zero."""
    if history not in get_args(HistoryTreatment):
        raise DataError(f"unknown history {history!r}; {nearest(history, get_args(HistoryTreatment))}")


def estimate_coefficient_covariance(slopes: np.ndarray, squares: float, freedom: int) -> np.ndarray:
    """Covariance (p, p) of coefficients with these ``slopes`` (n, p), for a white error."""
    scale = np.linalg.norm(slopes, axis=0)
    _, size, right = np.linalg.svd(slopes / scale, full_matrices=False)
    inverse = right.T / size
    return squares / freedom * (inverse @ inverse.T) / np.outer(scale, scale)


def refuse_collinear(slopes: np.ndarray, names: Sequence[str], label: str) -> None:
    """DataError that names the coefficients whose ``slopes`` (n, p) are zero or combinations of one another."""
    scale = np.linalg.norm(slopes, axis=0)
    still = [n for n, s in zip(names, scale, strict=True) if s == 0]
    if still:
        raise DataError(f"{label}: {', '.join(still)} change nothing in these records; take a smaller structure")
    _, size, right = np.linalg.svd(np.linalg.qr(slopes / scale, mode="r"))
    if size[-1] <= COLLINEAR * np.sqrt(len(slopes)):
        shares = np.abs(right[-1]) / np.abs(right[-1]).max()
        together = [n for n, s in zip(names, shares, strict=True) if s > SHARE]
        raise DataError(
            f"{label}: the coefficients {', '.join(together)} act alike in these records and cannot be told apart; a constant"
            " input (a step after its edge) carries one, and each sine two: take a smaller structure, history='zero' where the"
            " record begins at rest and with the step's edge, or a record with a livelier input"
        )


def _finished(
    structure: PolynomialStructure,
    data: SampledData,
    best: PredictionErrorMinimum,
    count: int,
    label: str,
    history: str,
    units: Mapping[str, str],
) -> PolynomialModel:
    model = structure.model(best.theta, data)
    found = best.errors
    refuse_collinear(found.slopes, list(model.coefficients), label)
    freedom = count - structure.size - found.states
    notes = () if best.converged else (f"the search stopped after {best.iterations} iterations, before it had settled",)
    return replace(
        model,
        noise_std=float(np.sqrt(found.squares / freedom)),
        covariance=estimate_coefficient_covariance(found.slopes, found.squares, freedom),
        samples=count,
        loss=found.squares / count,
        history=history,
        units=dict(units),
        focus="simulation" if not (structure.orders.na or structure.nc or structure.nd) else "prediction",
        notes=(*notes, *find_instability(model)),
    )
