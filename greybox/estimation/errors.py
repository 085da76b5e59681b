"""How far runs lie from what was measured: the errors of an output over records, of free runs and of predictions, whole or by block."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from scipy.linalg import norm

from greybox.base.numerics import ROWS_AT_A_TIME, TINY
from greybox.data.noise.growing import GrowingNoise
from greybox.data.noise.noise_model import BoundDirection, NoiseBound, NoiseModel, NoiseSource
from greybox.data.noise.spectrum import estimate_spread
from greybox.estimation.options import FitOptions, RobustLoss
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Misfit, Trace
from greybox.estimation.transcription.problem import EstimationProblem


class ErrorSize(NamedTuple):
    """Root mean square error, best fit in percent, and how many samples went into them."""

    rmse: float
    best_fit_percent: float
    samples: int


def measure_errors(pairs: Iterable[tuple[np.ndarray, np.ndarray]]) -> ErrorSize:
    """Error of computed against measured values, one pair of arrays (N,) a record; NaN without a sample, and of a run that is NaN.

    Gaps of the measured values are left out.
    """
    size = movement = 0.0
    samples = 0
    for y, computed in pairs:
        measured = np.isfinite(y)
        # Where all was measured nothing is copied.
        mean = float(np.mean(y, where=True if measured.all() else measured)) if measured.any() else np.nan
        for first in range(0, len(y), ROWS_AT_A_TIME):
            rows = slice(first, first + ROWS_AT_A_TIME)
            seen, run = y[rows][measured[rows]], computed[rows][measured[rows]]
            # Lengths of vectors by BLAS: squares of a run that has left its record overflow, lengths do not.
            with np.errstate(over="ignore", invalid="ignore"):
                size = math.hypot(size, norm(seen - run, check_finite=False)) if len(seen) else size
            # About each record's own mean: records at different levels would make any model look good.
            movement = math.hypot(movement, norm(seen - mean, check_finite=False)) if len(seen) else movement
            samples += len(seen)
    if not samples:
        return ErrorSize(np.nan, np.nan, 0)
    # 100 (1 - |y - yhat| / |y - mean y|)
    best_fit = 100 * (1 - size / movement) if movement > 0 else np.nan
    return ErrorSize(size / math.sqrt(samples), best_fit, samples)


# Of what a fit keeps: misfit of each output, over its noise. Nothing else divides an error by a noise for a reader.


def compute_misfits(
    problem: EstimationProblem, traces: Sequence[Trace], skip: int = 0, loss: RobustLoss | None = None
) -> dict[str, Misfit]:
    """Free-run error of each output over all records, their first ``skip`` rows left out; without the outliers of a robust ``loss``."""
    noise, result = problem.noise, {}
    for j, output in enumerate(problem.model.outputs):
        if any(output.name in trace.measured for trace in traces):
            std, bound = float(noise.std[j]), noise.bound(output.name)
            # A level that is the residual's own is its ceiling already: the bound is of before the fit.
            if bound is None or bound.source is NoiseSource.RESIDUAL or bound.direction is not BoundDirection.AT_MOST:
                bound = bound and replace(bound, level=std)
            growth = noise.growth.get(output.name)
            if bound is not None and growth is not None:  # of each row, and not of the rms of all rows
                bound = replace(bound, direction=BoundDirection.ABOUT)
            result[output.name] = _compute_misfit(
                traces, output.name, output.unit, std, bound, loss or problem.loss, growth, skip
            )
    return result


def compute_record_misfits(fit: Fit, trace: Trace, skip: int = 0) -> dict[str, Misfit]:
    """Misfit of one record of a fit by output, without its first ``skip`` rows."""
    units = {o.name: o.unit for o in fit.model.outputs}
    loss = FitOptions.from_data(fit.provenance.options).to_loss()
    # An output that the fitted records lack has the noise by which the validation judged it.
    judged = {name: m.noise for name, m in fit.validation.misfit.items() if m.noise is not None}
    levels, growth = {**judged, **fit.noise.std}, fit.noise.growth
    return {
        name: _compute_misfit(
            [trace], name, units[name], levels.get(name, np.nan), fit.noise.level(name), loss, growth.get(name), skip
        )
        for name in trace.measured
    }


def _compute_misfit(
    traces: Sequence[Trace],
    output: str,
    unit: str,
    std: float,
    bound: NoiseBound | None,
    loss: RobustLoss | None,
    growth: GrowingNoise | None,
    skip: int,
) -> Misfit:
    """Error of one output over the records that have it, and over its noise: ``std``, or what ``bound`` says of it."""
    seen = [trace for trace in traces if output in trace.measured]
    rmse, best_fit, samples = measure_errors((t.measured[output][skip:], t.simulated[output][skip:]) for t in seen)
    level = std if bound is None else bound.level
    known: dict[str, Any] = {} if bound is None else {"source": bound.source, "direction": bound.direction}
    known_growth = None if growth is None or growth.unknown else growth
    by_row = known_growth is not None or any(output in t.noise for t in seen)
    if not samples or (loss is None and not by_row):
        return Misfit(rmse, unit, best_fit, rmse / level, samples, level, **known)
    # (y - yhat) / sd, each row over its own noise where that is not the same in all
    scaled = [
        (
            known_growth.scale_errors(t.measured[output], t.simulated[output])
            if known_growth
            else t.residual(output) / t.noise.get(output, level)
        )[skip:]
        for t in seen
    ]
    if loss is not None:
        # Outliers are those of the bulk of this residual: a model that is wrong has few.
        spread = max(estimate_spread(np.concatenate(scaled), robust=True), TINY)
        bulk = replace(loss, scale=np.array([spread]))
        wild = [bulk.outliers(each[:, None])[:, 0] for each in scaled]
        scaled = [np.where(out, np.nan, each) for out, each in zip(wild, scaled, strict=True)]
        pairs = ((t.measured[output][skip:], t.simulated[output][skip:]) for t in seen)
        best_fit = measure_errors(
            (np.where(out, np.nan, y), run) for (y, run), out in zip(pairs, wild, strict=True)
        ).best_fit_percent
        loss = bulk if any(out.any() for out in wild) else None
    ratio = measure_errors((np.where(np.isfinite(each), 0.0, np.nan), each) for each in scaled).rmse
    ratio /= loss.bulk_size() if loss is not None else 1.0
    noise = (rmse / ratio if ratio > 0 else level) if by_row else level
    return Misfit(rmse, unit, best_fit, ratio, samples, noise, without_outliers=loss is not None, **known)


def compute_weighed_ratio(noise: NoiseModel, output: str, misfit: Misfit) -> float:
    """Misfit over the level that a fit weighs an output with, which may lie below the ceiling that is known of its noise."""
    is_ceiling = misfit.direction is BoundDirection.AT_MOST and misfit.source is not NoiseSource.RESIDUAL
    return misfit.noise_ratio * (noise.ceiling_ratio(output) if is_ceiling else 1.0)


# Of free runs and predictions side by side.


@dataclass(frozen=True, eq=False)
class PredictionsAhead(Mapping[int, np.ndarray]):
    """Predictions (N,) by the numbers ``steps`` of samples ahead, each made by ``predict`` when it is asked for.

    The first so many rows have no measurement to go by: NaN.
    """

    steps: tuple[int, ...]
    predict: Callable[[int], np.ndarray]

    def __getitem__(self, ahead: int) -> np.ndarray:
        if ahead not in self.steps:
            raise KeyError(ahead)
        predicted = np.array(self.predict(ahead))
        predicted[:ahead] = np.nan
        return predicted

    def __iter__(self) -> Iterator[int]:
        return iter(self.steps)

    def __len__(self) -> int:
        return len(self.steps)


@dataclass(frozen=True, eq=False)
class OutputRun:
    """One output of one record beside the free run of a model and its predictions.

    Attributes
    ----------
    record, output
        Their names.
    time, measured
        Seconds, and what was measured (N,), NaN in gaps.
    free
        The free run (N,), or what makes it: of a long record it is not kept for each of many models.
    skip
        First rows that do not count.
    ahead
        Predictions (N,) by the number of samples ahead, NaN where nothing is predicted.
    """

    record: str
    output: str
    time: np.ndarray
    measured: np.ndarray
    free: np.ndarray | Callable[[], np.ndarray]
    skip: int = 0
    ahead: Mapping[int, np.ndarray] = field(default_factory=dict)

    @property
    def simulated(self) -> np.ndarray:
        """The free run (N,)."""
        return self.free if isinstance(self.free, np.ndarray) else self.free()


@dataclass(frozen=True)
class OutputScore:
    """Errors of one output over one or more records; infinite where a run leaves all bounds.

    Attributes
    ----------
    rmse
        Root mean square error of the free run.
    best_fit_percent
        ``100 (1 - ||y - yhat|| / ||y - mean(y)||)`` of the free run, with each record's own mean.
    samples
        How many went into it.
    unit
        Of the output.
    ahead
        Root mean square errors of predictions by the number of samples ahead.
    movement
        Standard deviation of the measurement itself.
    predictor
        What corrects the model at each sample.
    """

    rmse: float
    best_fit_percent: float
    samples: int
    unit: str = ""
    ahead: Mapping[int, float] = field(default_factory=dict)
    movement: float = np.nan
    predictor: str = ""

    KEYS: ClassVar[str] = "unit free_run=rmse prediction=ahead movement predictor"

    @classmethod
    def of(cls, runs: Sequence[OutputRun], unit: str = "", predictor: str = "") -> Self:
        """That of one output over its runs."""
        measured = [run.measured[run.skip :] for run in runs]
        rmse, best_fit, samples = measure_errors(
            (y, run.simulated[run.skip :]) for y, run in zip(measured, runs, strict=True)
        )
        if not samples:
            return cls(np.nan, np.nan, 0, unit, predictor=predictor)
        ahead = {}
        for steps in dict.fromkeys(k for run in runs for k in run.ahead):
            pairs = (
                (np.where(np.isnan(p[rows]), np.nan, y[rows]), p[rows])
                for y, run in zip(measured, runs, strict=True)
                if steps in run.ahead
                for p in [run.ahead[steps][run.skip :]]
                for rows in (slice(k, k + ROWS_AT_A_TIME) for k in range(0, len(p), ROWS_AT_A_TIME))
            )
            # NaN is no prediction; an infinite one is a wrong one.
            ahead[steps] = measure_errors(pairs).rmse
        # A free run that is no number has gone beyond all numbers.
        rmse, best_fit = (np.inf, -np.inf) if np.isnan(rmse) else (rmse, best_fit)
        return cls(rmse, best_fit, samples, unit, ahead, _measure_movement(measured), predictor)

    @property
    def one_step_rmse(self) -> float:
        """Error of the prediction one sample ahead."""
        return self.ahead.get(1, np.nan)


def _measure_movement(records: Sequence[np.ndarray]) -> float:
    """Standard deviation of an output over its records, NaN in gaps."""
    parts = [y[k : k + ROWS_AT_A_TIME] for y in records for k in range(0, len(y), ROWS_AT_A_TIME)]
    if len(parts) == len(records):
        return float(np.nanstd(np.concatenate(parts)))
    samples = sum(int(np.isfinite(part).sum()) for part in parts)
    mean = math.fsum(float(np.nansum(part)) for part in parts) / samples
    return math.sqrt(math.fsum(float(np.nansum((part - mean) ** 2)) for part in parts) / samples)


def errors_by_block(
    residuals: Mapping[str, Sequence[np.ndarray]], blocks: int, charge: Mapping[str, float] | None = None
) -> dict[str, np.ndarray]:
    """Mean square error by output in about ``blocks`` blocks of equal length.

    Parameters
    ----------
    residuals
        By output one array (N,) a record, NaN in gaps.
    blocks
        How many there shall be over all records.
    charge
        What is added to the mean square of each output.

    Returns
    -------
    dict
        By output an array (B,), of those that were measured; a block without a sample is left out.
    """
    rows = sum(len(r) for r in next(iter(residuals.values()), []))
    length = max(math.ceil(rows / blocks), 1)
    errors = {}
    for name, records in residuals.items():
        parts = [p for r in records for p in np.array_split(r, max(round(len(r) / length), 1)) if np.isfinite(p).any()]
        if parts:
            more = (charge or {}).get(name, 0.0)
            errors[name] = np.array([more + float(np.mean(p[np.isfinite(p)] ** 2)) for p in parts])
    return errors
