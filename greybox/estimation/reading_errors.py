"""What a fit shows of its sensors and clocks: a gain that is a mistaken unit, a residual of the steps of a reading or of jitter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from greybox.base import Finding, Severity
from greybox.data.findings import RecordCode
from greybox.data.sensor_faults import find_rounding_share
from greybox.estimation.findings import (
    REPORTING_CORRELATION,
    EstimationCode,
    compute_lag_one_correlation,
    name_unit_factor,
)
from greybox.estimation.result_parts import Estimate, Trace
from greybox.model import Model
from greybox.model.effects.catalogue import AT

# What a fit and its records say of the instruments and not of the plant.
OF_INSTRUMENTS = frozenset(
    {
        *(EstimationCode.PRIOR_CONFLICT, EstimationCode.PRIORS_OFF_ALIKE, EstimationCode.GAIN_IS_UNIT_FACTOR),
        *(EstimationCode.RESIDUAL_OF_STEPS, EstimationCode.RESIDUAL_OF_JITTER),
        *(RecordCode.TIME_JITTER, RecordCode.INPUT_FOLLOWS_OUTPUT),
    }
)

# Effects whose amplitude is a gain less one, and what each scales.
GAINS = {"input_gain": "input", "sensor_gain": "output"}


def find_mistaken_units(model: Model, estimates: Mapping[str, Estimate]) -> tuple[Finding, ...]:
    """The gains of a fitted model that are the factor between two units."""
    result = []
    for bound in model.bound_effects:
        kind = GAINS.get(bound.effect.name.partition(AT)[0])
        estimate = estimates.get(bound.model_names["g"]) if kind else None
        if estimate is None or estimate.fixed or estimate.std is None:
            continue
        factor = 1 + estimate.value
        if units := name_unit_factor(factor, estimate.std):
            values = {"kind": kind, "signal": bound.site, "factor": factor, "factor_std": estimate.std, "units": units}
            result.append(Finding(EstimationCode.GAIN_IS_UNIT_FACTOR, Severity.WARNING, bound.effect.name, values))
    return tuple(result)


# Share of a residual's mean square from which the steps of the reading are what is left: more than everything else together.
STEPS_SHARE = 0.5


def find_reading_errors(traces: Sequence[Trace]) -> tuple[Finding, ...]:
    """For each output whose residual is that of its steps, or of stamps with jitter: how large these are."""
    result = []
    for name in dict.fromkeys(name for trace in traces for name in trace.measured):
        records = [t for t in traces if name in t.measured]
        left = np.concatenate([t.residual(name) for t in records])
        usable = left[np.isfinite(left)]
        if not len(usable):  # a run that failed
            continue
        step, steps_share = find_rounding_share([t.measured[name] for t in records], float(np.mean(usable**2)))
        if steps_share > STEPS_SHARE:
            values = {"step": step, "share": min(steps_share, 1.0)}
            result.append(Finding(EstimationCode.RESIDUAL_OF_STEPS, Severity.NOTE, name, values))
        elif compute_lag_one_correlation(traces, name) < REPORTING_CORRELATION:
            # What a model lacks grows with the motion too, but it lasts from row to row; errors of stamps do not.
            rates = [np.gradient(t.simulated[name], t.time) for t in records]
            levels = [t.simulated[name] for t in records]
            jitter = estimate_jitter(left, np.concatenate(rates), np.concatenate(levels))
            usual = float(np.median(np.concatenate([np.diff(t.time) for t in records])))
            # Stamps of rows in order are not off by more than a step: what looks so is a lag, or another fault of the model.
            if jitter is not None and jitter[0] < usual:
                values = {"jitter": jitter[0], "share": jitter[1], "usual_step": usual}
                result.append(Finding(EstimationCode.RESIDUAL_OF_JITTER, Severity.NOTE, name, values))
    return tuple(result)


# Rows below which nothing is said of how the size of an error changes.
LEAST_JITTER_ROWS = 50
# By how much the logarithm of the likelihood must be better with jitter than with noise of one size, and than with noise that grows with
# the reading: a factor of 20,000, as many outputs of many fits are looked at.
JITTER_EVIDENCE = 10.0
# Share of the residual's mean square that jitter must make to be worth saying.
JITTER_SHARE = 0.2
# Rows times the squared correlation of the squared residual with the squared rate, below which a residual does not grow with it: three
# standard deviations of chance (R. Koenker 1981, A note on studentizing a test for heteroscedasticity, J. Econometrics 17).
LEAST_TREND = 9.0
# Sizes of the growing part over the constant one that are tried, at the rms of what it grows with; around the best of them again, finer.
GROWTH_GRID = np.concatenate(([0.0], np.geomspace(0.03, 300.0, 41)))
FINER_GROWTH = np.geomspace(0.8, 1.25, 11)
# Rows, evenly spread, that tell how the size of an error changes.
JITTER_ROWS = 5000


def estimate_jitter(residual: np.ndarray, rate: np.ndarray, level: np.ndarray) -> tuple[float, float] | None:
    """Standard deviation (s) of the stamps' errors, and their share of the residual's mean square; None where it shows none.

    A reading ``y`` stamped off by ``d`` is off by ``d dy/dt``: the variance of the residual (N,) is ``s^2 + j^2 (dy/dt)^2``. That is held
    against a variance that is constant and one that grows with the ``level`` (N,) of the reading.
    """
    every = max(len(residual) // JITTER_ROWS, 1)
    residual, rate, level = residual[::every], rate[::every], level[::every]
    known = np.isfinite(residual) & np.isfinite(rate) & np.isfinite(level)
    e, rate, level = residual[known], rate[known], level[known]
    if len(e) < LEAST_JITTER_ROWS or not e.any():
        return None
    sizes = [float(np.sqrt(np.mean(v**2))) for v in (rate, level)]
    if not sizes[0]:
        return None
    # The test by one regression comes first: most residuals show nothing, and the likelihoods take a tenth of a short fit.
    if len(e) * _correlate(e**2, rate**2) ** 2 < LEAST_TREND:
        return None
    (with_jitter, growth), (with_level, _) = (
        _fit_growing_variance(e, v / size) if size else (-np.inf, 0.0)
        for v, size in zip((rate, level), sizes, strict=True)
    )
    constant = _log_likelihood(e, np.zeros(len(e)), 0.0)[0]
    if with_jitter < max(constant, with_level) + JITTER_EVIDENCE:
        return None
    # The rate was over its rms: its mean square is one.
    deviation = _log_likelihood(e, rate / sizes[0], growth)[1]
    share = growth**2 / (1 + growth**2)
    return (growth * deviation / sizes[0], share) if share > JITTER_SHARE else None


def _correlate(a: np.ndarray, b: np.ndarray) -> float:
    """The correlation of two series (N,); 0 where one does not vary."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size else 0.0


def _fit_growing_variance(e: np.ndarray, v: np.ndarray) -> tuple[float, float]:
    """The largest log likelihood of ``e`` under a variance ``s^2 (1 + c^2 v^2)``, and ``c`` there."""
    _, best = max((_log_likelihood(e, v, c)[0], c) for c in GROWTH_GRID.tolist())
    return max((_log_likelihood(e, v, c)[0], c) for c in (best * FINER_GROWTH).tolist())


def _log_likelihood(e: np.ndarray, v: np.ndarray, c: float) -> tuple[float, float]:
    """Of normal errors with the variance ``s^2 (1 + c^2 v^2)`` at its best ``s``, and that."""
    growth = 1 + (c * v) ** 2
    variance = float(np.mean(e**2 / growth))
    return -0.5 * (len(e) * np.log(variance) + float(np.log(growth).sum())), float(np.sqrt(variance))
