"""What a fit says of its constants, on the scale on which their estimates are nearest to normal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, fdtrc, stdtr, stdtrit

from greybox.base.linear_algebra import decompose_symmetric, pseudo_inverse
from greybox.base.numerics import NEARLY_NORMAL
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import join_series
from greybox.estimation.findings import EstimationCode
from greybox.estimation.fit import fit
from greybox.estimation.optimum import restore_noise
from greybox.estimation.options import FitOptions
from greybox.estimation.residuals import ljung_box_test, measure_mean
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import IntervalKind
from greybox.estimation.sandwich import ResidualColour, estimate_residual_colour


@dataclass(frozen=True, eq=False)
class FittedConstants:
    """Estimated constants of one fit: the logarithm of a positive one, the value of any other.

    Parameters
    ----------
    names, units
        Of each constant (k,).
    values : array (k,)
        Estimates in their units.
    covariance : array (k, k)
        On the scale of the comparison; infinite on the diagonal where the records leave a constant open, NaN at a bound. Constants at
        their bounds count as free in the variances of the others.
    positive : array (k,)
        Which of them are compared by their logarithm.
    at_bound
        Names of those that were stopped by a bound.
    degrees
        Degrees of freedom of the variance behind the covariance.
    narrowed
        Names of those whose intervals rest on others being exactly at their bounds: how far each is known with these free is in its
        variance, how they then go together is not known.
    undetermined
        Names of those whose interval reaches further than half of the value, and of the ``narrowed``.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    positive: np.ndarray
    at_bound: tuple[str, ...]
    degrees: float
    narrowed: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()

    def index(self, names: Sequence[str]) -> list[int]:
        """Positions of these constants."""
        return [self.names.index(name) for name in names]

    @property
    def scaled(self) -> np.ndarray:
        """The estimates (k,) on the scale of the comparison."""
        return np.where(self.positive, np.log(np.where(self.positive, self.values, 1.0)), self.values)

    @property
    def variances(self) -> np.ndarray:
        """Variances (k,) on that scale."""
        return np.diag(self.covariance)


@dataclass(frozen=True, eq=False)
class FittedResidual:
    """The residual of a fit over its noise.

    Parameters
    ----------
    outputs
        Names of the measured outputs (ny,).
    squares
        Sum of squares of the residual over the noise, whitened where the noise's colour is known, of all outputs.
    whiteness : array (ny,)
        Probability that white noise is as coloured as it (Ljung and Box); NaN of too few rows.
    colour
        Autoregression and variance of each.
    degrees : array (ny,)
        Independent samples behind each variance, less the share of the unknowns.
    kurtosis : array (ny,)
        Of each; 3 for normal noise.
    adequate
        Whether nothing but noise is left of it.
    """

    outputs: tuple[str, ...]
    squares: float
    whiteness: np.ndarray
    colour: ResidualColour
    degrees: np.ndarray
    kurtosis: np.ndarray
    adequate: bool


def read_constants(fit: Fit, residual: FittedResidual | None = None) -> FittedConstants:
    """The constants of ``fit`` that can be compared: estimated for all its records together, and no intensities of noise.

    ``residual`` is read where it is not given.
    """
    excluded = {*fit.model.noise_parameters, *fit.constraints.per_experiment}
    quantities = {q.name: q for q in fit.model.all_parameters}
    names = tuple(name for name in fit.uncertainty.free if name not in excluded and name in fit.parameters)
    places = [fit.uncertainty.free.index(name) for name in names]
    values = np.array([fit.parameters[name].value for name in names])
    positive = np.array([quantities[name].positive and fit.parameters[name].value > 0 for name in names], bool)
    # d ln p = dp / p: the covariance on the scale of the comparison.
    slopes = np.where(positive, 1 / np.where(positive, values, 1.0), 1.0)
    # A colour that a short record shows by chance may make an interval narrower than a white residual would: not here.
    inflation = np.array([fit.uncertainty.inflation.get(name, 1.0) for name in names])
    slopes /= np.where(inflation > 0, np.minimum(inflation, 1.0), 1.0)
    # A constant at its bound counts as known in the covariance of the fit; another fit may have it elsewhere.
    findings = [f for f in fit.findings if f.code == EstimationCode.NARROWED_BY_BOUND]
    # ... by how much its standard deviation grows with those at their bounds free; None where it is open then.
    growth: dict[str, float | None] = {n: g for finding in findings for n, g in finding.values["growth"].items()}
    slopes *= np.array([growth.get(name) or 1.0 for name in names])
    covariance = fit.uncertainty.covariance[np.ix_(places, places)] * np.outer(slopes, slopes)
    units = tuple(fit.parameters[name].unit for name in names)
    at_bound = tuple(name for name in names if fit.parameters[name].at_bound)
    # A constant that the records leave open has any value; one at a bound has a covariance that is NaN already.
    is_open = [fit.parameters[name].std is None or growth.get(name, 1.0) is None for name in names]
    open_ones = [k for k, name in enumerate(names) if is_open[k] and name not in at_bound]
    covariance[open_ones, open_ones] = np.inf
    narrowed = tuple(name for name in names if name in growth)
    undetermined = tuple(name for name in names if name in growth or not fit.parameters[name].determined)
    degrees = _degrees(fit, residual or read_residual(fit))
    return FittedConstants(names, units, values, covariance, positive, at_bound, degrees, narrowed, undetermined)


# Misfit over noise up to which a fit leaves only noise, whatever the colour of that: its residual is a yardstick for today's.
ADEQUATE_RATIO = 1.1
# Lags at most over which the residual's autocorrelation is summed (Ljung and Box) ...
CHANGE_TEST_LAGS = 20
# ... with so many rows at least for each lag.
ROWS_PER_LAG = 10


def read_residual(fit: Fit, adequate_ratio: float = ADEQUATE_RATIO) -> FittedResidual:
    """The residual of ``fit``; of a fit with process noise there is none to compare, as its runs follow the measurement."""
    noise = restore_noise(fit)
    names = [o.name for o in fit.model.outputs]
    measured = tuple(name for name in names if name in fit.misfit and name in fit.noise.std)
    # NaN where a record lacks the output.
    series = tuple(
        tuple(
            noise.colour[names.index(name)].whiten(trace.residual(name) / fit.noise.std[name], overwrite_input=True)
            if name in trace.measured and name in trace.simulated
            else np.full(len(trace.time), np.nan)
            for trace in fit.traces
        )
        for name in measured
    )
    # Of one output nothing is copied.
    rows = [
        (each[0][:, None] if len(each) == 1 else np.column_stack(each), np.empty((len(each[0]), 0, 0)))
        for each in zip(*series, strict=True)
    ]
    unknowns = len(fit.uncertainty.free) + len(fit.traces) * len(fit.model.system.state_names)
    colour = estimate_residual_colour(rows, unknowns, False, None)
    total = max(sum(colour.counts), 1)
    degrees, kurtosis, whiteness = [], [], []
    for j, (count, (_, correlated)) in enumerate(zip(colour.counts, colour.times, strict=True)):
        # Independent samples less the unknowns' share: N / sum of squared autocorrelations (Bartlett 1935).
        degrees.append(max((count - unknowns * count / total) / correlated, 1.0))
        mean, known = measure_mean(series[j])
        lags = min(CHANGE_TEST_LAGS, known // ROWS_PER_LAG)
        whiteness.append(ljung_box_test(join_series(series[j]), lags)[1] if lags else np.nan)
        variance, fourth = (measure_mean(series[j], power, mean)[0] for power in (2, 4))
        kurtosis.append(fourth / variance**2 if variance > 0 else 3.0)
    measures = [measure_mean(each, 2) for each in series]
    squares = sum(mean * known for mean, known in measures if known)
    ratios = [fit.misfit[name].noise_ratio for name in measured]
    adequate = not colour.coloured or max(ratios, default=0.0) <= adequate_ratio
    return FittedResidual(
        measured, squares, np.array(whiteness), colour, np.array(degrees), np.array(kurtosis), adequate
    )


def _degrees(fit: Fit, residual: FittedResidual) -> float:
    """Degrees of freedom behind the intervals of ``fit``, by the rule that the estimation made them with."""
    if fit.prediction.process_noise:
        return float(np.inf)
    count = sum(residual.colour.counts)
    if fit.uncertainty.kind is IntervalKind.SANDWICH:
        # The sandwich takes its scale from the residual, whose independent samples are fewer where it is coloured.
        return max(float(residual.degrees.sum()), 1.0)
    # A given noise is exact as long as the residual is no larger than it; else the residual is the estimate.
    left = max(count - residual.colour.unknowns, 1)
    return float(np.inf) if restore_noise(fit).known and residual.squares <= left else float(left)


# How far constants vary where nothing has changed, measured beside what their intervals say.
#
# A model that lacks something has constants that depend on what the record does, and no covariance that is computed says by how much. So
# it is measured: over the records of each side; or, of one record each of the same motion, over the change from piece to piece of both, in
# which what the model lacks acts alike and cancels; or over the pieces of each side by itself (batch means; Carlstein, Annals of
# Statistics 14, 1986). Estimates are joined by their information; their spread about that mean, in the standard deviations that
# their covariances promise, is the factor by which these are wrong. Pieces say how far constants scatter, and no more: each spends rows on
# a state of its own to begin in, so that their mean wanders further than the fit of the whole, and the constants are those of the fits.


class Yardstick(StrEnum):
    """What the scatter of constants was measured over."""

    RECORDS = "records"
    PAIRED_PIECES = "paired_pieces"
    PIECES = "pieces"

    @property
    def is_trusted(self) -> bool:
        """Whether a change beyond it is one of the machine: pieces by themselves say nothing of another input."""
        return self is not Yardstick.PIECES


@dataclass(frozen=True, eq=False)
class MeasuredScatter:
    """Constants of both sides, each as uncertain as it scatters.

    Parameters
    ----------
    before, after
        Joined from whole records; those of the fits where pieces were measured. Of pairs the scatter of the change alone is known, and
        stands with the second.
    factors : array (k,)
        By which the standard deviations of single records or pieces are wrong; infinite where too few determine the constant.
    degrees
        Degrees of freedom of the factors, of the constant that has the fewest.
    yardstick
        What they were measured over.
    """

    before: FittedConstants
    after: FittedConstants
    factors: np.ndarray
    degrees: int
    yardstick: Yardstick


@dataclass(frozen=True, eq=False)
class ConstantsEstimate:
    """Constants (k,) and their information (k, k), the inverse of a covariance, on the scale of the comparison."""

    values: np.ndarray
    information: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray, covariance: np.ndarray) -> ConstantsEstimate:
        """None of a constant that its records leave open."""
        known = np.flatnonzero(np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0))
        information = np.zeros_like(covariance)
        information[np.ix_(known, known)] = pseudo_inverse(covariance[np.ix_(known, known)])
        return cls(values, information)

    @property
    def covariance(self) -> np.ndarray:
        """Its inverse; infinite on the diagonal for what nothing is known of."""
        known = np.flatnonzero(np.diag(self.information) > 0)
        covariance = np.diag(np.where(np.diag(self.information) > 0, 0.0, np.inf))
        covariance[np.ix_(known, known)] = pseudo_inverse(self.information[np.ix_(known, known)])
        return covariance


def join_estimates(estimates: Sequence[ConstantsEstimate]) -> ConstantsEstimate:
    """The mean of independent estimates, each weighed by its information."""
    # M = sum M_i, theta = M^-1 sum M_i theta_i
    total = sum((e.information for e in estimates), start=np.zeros_like(estimates[0].information))
    weighed = sum((e.information @ e.values for e in estimates), start=np.zeros_like(estimates[0].values))
    return ConstantsEstimate(pseudo_inverse(total) @ weighed, total)


# Degrees of freedom below which a spread says nothing: of whole records, which are few and cost a run of the rig each ...
LEAST_RECORD_DEGREES = 2
# ... and of pieces.
LEAST_PIECE_DEGREES = 3


# p-value of the scatter from record to record below which a model that lacks nothing is taken to wander from day to day.
WANDER_P = 0.1


def measure_scatter(
    reference: Fit,
    today: Fit,
    before: FittedConstants,
    after: FittedConstants,
    pairs: Sequence[tuple[Experiment, Experiment]] = (),
    *,
    adequate: bool = False,
) -> MeasuredScatter | None:
    """How far the constants of both sides scatter where nothing has changed; None where too few records or pieces determine them.

    Parameters
    ----------
    reference, today
        The two fits that are compared.
    before, after
        Their constants, of the same names.
    pairs
        Records of both of the same motion, as long as each other.
    adequate
        Whether the model lacks nothing: then its intervals hold within a record, and whole records alone can show that the machine
        wanders from one to the next.
    """
    fits = (reference, today)
    records = [[trace.experiment for trace in f.traces] for f in fits]
    if sum(len(of) - 1 for of in records) >= LEAST_RECORD_DEGREES:
        sides = [_estimate_each(f, of, before) for f, of in zip(fits, records, strict=True)]
        # What a model lacks acts alike in records that repeat each other: their spread may be smaller than any interval. Of other
        # motion it says something else, and the intervals are the least that is allowed.
        spread = _measure(sides, LEAST_RECORD_DEGREES, 0.0 if pairs else 1.0)
        if spread is not None and not (adequate and spread.p > WANDER_P):
            joined = [join_estimates(_known(side)) for side in sides]
            one, other = (_scatter_by(before, e.covariance, spread, values=e.values) for e in joined)
            return MeasuredScatter(one, other, spread.factors, spread.degrees, Yardstick.RECORDS)
    if adequate:
        return None
    if pairs:
        ones, others = (_estimate_each(f, cut_records([pair[k] for pair in pairs]), before) for k, f in enumerate(fits))
        changes = [
            ConstantsEstimate.of(b.values - a.values, a.covariance + b.covariance)
            for a, b in zip(ones, others, strict=True)
            if a is not None and b is not None
        ]
        # The covariances hold what both have in common, which cancels: the spread may be smaller.
        spread = _measure([changes], LEAST_PIECE_DEGREES, 0.0)
        if spread is not None:
            # The change scatters by so much, the constants of the fit count as exact.
            exact = replace(_scatter_by(before, np.zeros_like(before.covariance), spread), degrees=float(np.inf))
            other = _scatter_by(after, join_estimates(changes).covariance, spread)
            return MeasuredScatter(exact, other, spread.factors, spread.degrees, Yardstick.PAIRED_PIECES)
    sides = [_estimate_each(f, cut_records(of), before) for f, of in zip(fits, records, strict=True)]
    spread = _measure(sides, LEAST_PIECE_DEGREES, 1.0)
    if spread is None:
        return None
    one, other = (
        _scatter_by(fitted, join_estimates(_known(side)).covariance, spread)
        for fitted, side in zip((before, after), sides, strict=True)
    )
    return MeasuredScatter(one, other, spread.factors, spread.degrees, Yardstick.PIECES)


def _known(estimates: Sequence[ConstantsEstimate | None]) -> list[ConstantsEstimate]:
    return [e for e in estimates if e is not None]


def _scatter_by(
    fitted: FittedConstants, covariance: np.ndarray, spread: _Spread, *, values: np.ndarray | None = None
) -> FittedConstants:
    """The constants, as uncertain as the covariance widened by the measured factors; with other ``values``, on their scale, if given."""
    is_measured = np.isfinite(spread.factors)
    factors = np.where(is_measured, spread.factors, 1.0)
    widened = covariance * np.outer(factors, factors)
    # How far it scatters is not known: no change of it can be told from that.
    widened[~is_measured, ~is_measured] = np.inf
    if values is None:
        # A constant that the whole record does not determine, or that a bound has stopped, is known no better from its pieces.
        unknown = fitted.index(fitted.undetermined)
        by_pieces, by_whole = np.diag(widened)[unknown], fitted.variances[unknown]
        widened[unknown, unknown] = np.where(by_whole < by_pieces, by_pieces, by_whole)
        return replace(fitted, covariance=widened, degrees=float(spread.degrees))
    back = np.where(fitted.positive, np.exp(np.where(fitted.positive, values, 0.0)), values)
    return replace(fitted, values=back, covariance=widened, at_bound=(), degrees=float(spread.degrees), narrowed=())


def _estimate_each(
    whole: Fit, pieces: Sequence[Experiment], constants: FittedConstants
) -> list[ConstantsEstimate | None]:
    """The constants of the model of ``whole`` from each piece alone; None where a piece does not give them."""
    # A piece begins in motion; it is short, so that no shorter part comes first. The constants of the whole are where it starts: a piece
    # of a steady run has little to explain, and no other start is asked for that.
    options_of_whole = FitOptions.from_data(whole.provenance.options)
    options = replace(options_of_whole, at_rest=False, progressive=False, other_starts=0, exchange=False)
    estimates: list[ConstantsEstimate | None] = []
    for piece in pieces:
        result = fit(whole.model, piece, noise=restore_noise(whole), options=options)
        read = read_constants(result) if result.success else None
        if read is None or read.names != constants.names or (read.positive != constants.positive).any():
            estimates.append(None)
            continue
        # What holds only with another constant at its bound is no estimate of this one: the next piece has that off its bound.
        narrowed = read.index(read.narrowed)
        read.covariance[narrowed, narrowed] = np.inf
        estimates.append(ConstantsEstimate.of(read.scaled, read.covariance))
    return estimates


class _Spread(NamedTuple):
    """Factors (k,) by which standard deviations are wrong, their fewest degrees of freedom, and the p-value of so wide a spread."""

    factors: np.ndarray
    degrees: int
    p: float


def _measure(
    groups: Sequence[Sequence[ConstantsEstimate | None]], least_degrees: int, least_factor: float
) -> _Spread | None:
    """The spread of the estimates of each constant about the mean of each group; None with fewer degrees of freedom."""
    known = [group for group in map(_known, groups) if group]
    if len(known) < len(groups):
        return None
    means = [join_estimates(group).values for group in known]
    rows = [(e.values - mean, e) for group, mean in zip(known, means, strict=True) for e in group]
    squares, counts = np.zeros(len(means[0])), np.zeros(len(means[0]))
    for deviation, e in rows:
        # What a piece says of each constant by itself, the others free.
        variance = np.diag(e.covariance)
        is_known = np.isfinite(variance) & (variance > 0)
        squares[is_known] += deviation[is_known] ** 2 / variance[is_known]
        counts[is_known] += 1
    # A mean of each group is taken off.
    degrees = np.maximum(counts - len(known), 0)
    enough = degrees >= least_degrees
    if not enough.any():
        return None
    # By itself: root of the mean square of deviations over their promised standard deviations.
    factors = np.where(enough, np.maximum(np.sqrt(squares / np.maximum(degrees, 1)), least_factor), np.inf)
    # Of all together: sum of d' M d, a chi-square where the covariances are right.
    p = float(chdtrc(degrees.sum(), sum(float(d @ e.information @ d) for d, e in rows)))
    return _Spread(factors, int(degrees[enough].min()), p)


# Pieces of each side's records at least: their variance is known to half of itself.
SCATTER_PIECES = 8
# Rows of a piece at least; a shorter record stays whole.
SCATTER_LEAST_ROWS = 20


def cut_records(records: Sequence[Experiment]) -> list[Experiment]:
    """The records, each cut into equal pieces so that there are `SCATTER_PIECES`, or as many as its rows allow."""
    # As many pieces of each record, rounded up.
    each = -(-SCATTER_PIECES // len(records))
    pieces = []
    for record in records:
        count = min(each, record.rows // SCATTER_LEAST_ROWS)
        if count > 1:
            rows = record.rows // count
            pieces += [record.window(k * rows, (k + 1) * rows) for k in range(count)]
        else:
            pieces.append(record)
    return pieces


def reach_of_missing_part(fit: Fit, constants: FittedConstants) -> np.ndarray:
    """How far (k,) what a model lacks can take each constant, on the scale of the comparison; infinite where nobody knows.

    As large a signal as the fit leaves, acting as this constant does wherever the others do not: with the residual's variance ``s^2``
    and N samples that is ``s sqrt(N) / |J|``, where ``J`` is the part of the constant's slopes that no other constant explains, and
    ``s / |J|`` its standard deviation for a white residual.
    """
    inflation = np.array([fit.uncertainty.inflation.get(name, np.inf) for name in constants.names])
    samples = sum(misfit.samples for misfit in fit.misfit.values())
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = np.sqrt(constants.variances * samples) / np.maximum(inflation, 1.0)
    return np.where(np.isfinite(reach), reach, np.inf)


# Have constants moved between two fits? A joint test, and a look at each that allows for the number of looks.
#
# The difference of two independent estimates is normal with the sum of their covariances, or Student's where the noise was estimated. Two
# statistics are computed: the largest standardised difference, which finds a change of one constant, and Wald's quadratic form, which
# finds a change of a combination that the records determine better than any constant by itself. The p-value of the smaller of their two
# p-values comes from its distribution under no change, drawn with the correlation of the estimates at hand (Westfall and Young,
# Resampling-based multiple testing, 1993; Hothorn, Bretz and Westfall, Biometrical Journal 50, 2008), so that the rate of false alarms is
# neither shared out nor exceeded. Each constant's own p-value is that of the largest of as many standardised differences, stepping down
# from the largest (Holm's order).


@dataclass(frozen=True, eq=False)
class DifferenceTest:
    """The test of the differences of some constants.

    Parameters
    ----------
    names
        What was compared (k,).
    difference, std : array (k,)
        After less before, and its standard deviation, on the scale of the comparison.
    p : array (k,)
        Of each constant, corrected for looking at all of them.
    p_value
        Of all together.
    half_widths : array (k,)
        Of the intervals of the differences, which hold together.
    visible : array (k,)
        Difference of each that would be seen with the power of the policy.
    direction : array (k,)
        The combination that stands out most, each constant in its standard deviations, the largest entry one.
    """

    names: tuple[str, ...]
    difference: np.ndarray
    std: np.ndarray
    p: np.ndarray
    p_value: float
    half_widths: np.ndarray
    visible: np.ndarray
    direction: np.ndarray


def list_comparable(before: FittedConstants, after: FittedConstants) -> list[str]:
    """Constants that both fits have determined, off their bounds."""
    known = [set(np.array(c.names)[np.isfinite(c.variances)].tolist()) for c in (before, after)]
    return [name for name in before.names if name in known[0] & known[1] and name in after.names]


# Probability that all intervals of a comparison hold together.
INTERVAL_LEVEL = 0.95


def compare_constants(
    before: FittedConstants,
    after: FittedConstants,
    names: Sequence[str],
    level: float,
    power: float,
    scatter_degrees: float = np.inf,
) -> DifferenceTest:
    """The test whether ``names`` are the same in both fits, at the ``level`` of false alarms.

    ``scatter_degrees``: degrees of freedom of a scatter that was measured over both sides together. It says how far each constant
    wanders, and not how far a combination does: then only each by itself is tested, as it is beside a constant at its bound.
    """
    i, j = before.index(names), after.index(names)
    common = before.positive[i] & after.positive[j]
    one, other = _rescale(before, i, common), _rescale(after, j, common)
    # Independent estimates: their covariances add up.
    difference = other[0] - one[0]
    covariance = one[1] + other[1]
    std = np.sqrt(np.diag(covariance))
    degrees = min(combine_degrees(np.diag(one[1]), np.diag(other[1]), before.degrees, after.degrees), scatter_degrees)
    correlation = covariance / np.outer(std, std)
    z = difference / std
    null = _NullDistribution.draw(correlation, degrees, is_own=bool(np.isfinite(scatter_degrees)))
    p, critical = null.step_down(np.abs(z)), null.quantile(1 - level)
    wide = null.quantile(INTERVAL_LEVEL)
    joint = np.isinf(scatter_degrees) and not {*before.narrowed, *after.narrowed}.intersection(names)
    # The gradient of z' R^-1 z: the combination that stands out most.
    direction = null.inverse @ z
    largest = np.abs(direction).max(initial=0.0)
    return DifferenceTest(
        tuple(names),
        difference,
        std,
        p,
        null.joint_p_value(z) if joint else float(p.min(initial=1.0)),
        wide * std,
        (critical + stdtrit(degrees, power)) * std,
        direction / largest if largest else direction,
    )


def combine_degrees(one: np.ndarray, other: np.ndarray, degrees_one: float, degrees_other: float) -> float:
    """Degrees of freedom of a sum of two estimated variances (Welch 1938, Satterthwaite 1946): the fewest of all constants."""
    inverse = (one**2 / degrees_one + other**2 / degrees_other) / (one + other) ** 2
    worst = float(inverse.max(initial=0.0))
    return 1 / worst if worst > 0 else float(np.inf)


def _rescale(constants: FittedConstants, places: list[int], common: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimates and covariance, logarithmic only where both fits allow it."""
    values = constants.values[places]
    scaled = np.where(common, np.log(np.where(common, values, 1.0)), values)
    back = np.where(constants.positive[places] & ~common, values, 1.0)
    return scaled, constants.covariance[np.ix_(places, places)] * np.outer(back, back)


# Draws of the null distribution of the constants' tests: the limit at 1 % is then known to 5 % of itself.
CHANGE_TEST_DRAWS = 40000
# Draws beyond what was seen from which their share counts as the p-value; with fewer it is bounded from the distributions' tails.
COUNTED_DRAWS = 20
# Of these draws: the same records give the same p-values.
CHANGE_TEST_SEED = 0


@dataclass(frozen=True, eq=False)
class _NullDistribution:
    """Standardised differences (draws, k) of constants that have not changed, with the inverse of their correlation."""

    z: np.ndarray
    inverse: np.ndarray
    rank: int
    degrees: float

    @classmethod
    def draw(cls, correlation: np.ndarray, degrees: float, *, is_own: bool = False) -> _NullDistribution:
        """``is_own``: the deviation of each constant was measured by its own scatter, and not all of them by one residual."""
        decomposition = decompose_symmetric(correlation)
        inverse = decomposition.pseudo_inverse
        values, vectors = np.linalg.eigh(correlation)
        # R = root root': draws with the correlation of the estimates; rounding may make an eigenvalue negative.
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        generator = np.random.default_rng(CHANGE_TEST_SEED)
        z = generator.standard_normal((CHANGE_TEST_DRAWS, len(correlation))) @ root.T
        if is_own:
            # Each difference over its own deviation: of so many draws of all constants together, whose squares add up to the diagonal of a
            # Wishart matrix. One deviation for all would call a machine changed up to twice as often where constants go together.
            draws = round(degrees)
            squares = sum((generator.standard_normal(z.shape) @ root.T) ** 2 for _ in range(draws))
            z /= np.sqrt(squares / draws)
        elif np.isfinite(degrees):
            # Student: all differences of a draw over one estimated deviation.
            z /= np.sqrt(generator.chisquare(degrees, (CHANGE_TEST_DRAWS, 1)) / degrees)
        # Wald's form has as many degrees of freedom as the correlation has rank.
        rank = max(round(float(np.trace(inverse @ correlation))), 1)
        return cls(z, inverse, rank, degrees)

    @cached_property
    def largest(self) -> np.ndarray:
        """The largest of the standardised differences of each draw (draws,)."""
        return np.abs(self.z).max(axis=1)

    @cached_property
    def ordered(self) -> np.ndarray:
        """Draws (draws,) by their ``largest``, ascending."""
        return np.argsort(self.largest)

    def quantile(self, level: float) -> float:
        """What the largest of the standardised differences stays below with this probability."""
        return float(self.largest[self.ordered[min(int(level * len(self.largest)), len(self.largest) - 1)]])

    def step_down(self, z: np.ndarray) -> np.ndarray:
        """p-values (k,) of each, corrected for the looks that are left when it has its turn."""
        p, left, worst = np.ones(len(z)), np.ones(len(z), bool), 0.0
        # The largest first; each is held against the largest of those that are left, and is no more certain than the one before (Holm).
        for k in np.argsort(-z):
            largest = self.largest if left.all() else np.abs(self.z[:, left]).max(axis=1)
            exceeding = int((largest >= z[k]).sum())
            worst = max(worst, self._share(exceeding, float(left.sum()) * self._tail(z[k])))
            p[k], left[k] = worst, False
        return p

    def joint_p_value(self, z: np.ndarray) -> float:
        """Probability that one of the two statistics is as unlikely as the less likely one at hand."""
        count = len(self.largest)
        of_largest = np.empty(count)
        # p-value of each draw by the first statistic: its rank among the draws.
        of_largest[self.ordered] = 1 - np.arange(count) / count
        seen = float(np.abs(z).max(initial=0.0))
        of_form = float(self._form_tail(self._form(z[None]))[0])
        p_largest = self._share(int((self.largest >= seen).sum()), len(z) * self._tail(seen))
        # The smaller of two p-values is no p-value: it is held against the smaller one of every draw.
        smallest = min(p_largest, of_form)
        exceeding = int((np.minimum(of_largest, self._form_tail(self._form(self.z))) <= smallest).sum())
        return self._share(exceeding, 2 * smallest)

    def _form(self, z: np.ndarray) -> np.ndarray:
        return ((z @ self.inverse) * z).sum(axis=1)

    def _form_tail(self, form: np.ndarray) -> np.ndarray:
        if self.degrees >= NEARLY_NORMAL:
            return chdtrc(self.rank, form)
        return fdtrc(self.rank, self.degrees, form / self.rank)

    def _tail(self, z: float) -> float:
        return 2 * float(stdtr(min(self.degrees, NEARLY_NORMAL), -z))

    def _share(self, exceeding: int, bound: float) -> float:
        """A share of the draws, or where hardly any exceeds, a bound on the probability."""
        if exceeding >= COUNTED_DRAWS:
            return exceeding / CHANGE_TEST_DRAWS
        return min(bound, max(exceeding, COUNTED_DRAWS) / CHANGE_TEST_DRAWS)
