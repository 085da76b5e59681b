"""From the curvature at the optimum to standard deviations and intervals, and to what the data leave open."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
from scipy.special import ndtri, stdtrit

from greybox.base.linear_algebra import SymmetricDecomposition, decompose_symmetric, eliminate, pseudo_inverse
from greybox.base.numerics import AT_BOUND, PRIOR_INFORMATION_CUTOFF, TINY
from greybox.estimation.objective import LikelihoodMaximum, ResidualRows
from greybox.estimation.result_parts import Estimate, IntervalKind, PriorCheck
from greybox.estimation.sandwich import ResidualColour, estimate_kernel_score_covariance, give_back, sum_scores
from greybox.estimation.transcription.decision_vector import SHARED, DecisionVector
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.estimation.transcription.shooting_cost import Evaluation
from greybox.model import Model, Parameter

# Standard deviation with the constants at their bounds free, over the one with them held, from which it is told: an interval half as wide
# as it would be is read as a result of the records, and is one of the bound.
LEAST_GROWTH = 2.0


@dataclass(frozen=True)
class NarrowedInterval:
    """What a constant's interval owes to others that lie on their bounds and count as known.

    ``growth``: standard deviation of ``constant`` with those ``at_bounds`` free, over the one with them held; infinite where the data
    would not determine it then.
    """

    constant: str
    at_bounds: tuple[str, ...]
    growth: float


@dataclass(frozen=True)
class BoundLimit:
    """What the records say of a constant that lies on a bound.

    ``limit``: how far from the bound it may be at 95 %; None where that is the other bound, or where the records would have it beyond
    this one. ``pull``: by how many of its standard deviations they would.
    """

    limit: float | None
    pull: float


@dataclass(frozen=True)
class ParameterCovariance:
    """``covariance`` (nf, nf) of the free constants, and a basis ``null`` (nf, k), in ``z``, of directions that the data do not determine.

    ``kind``: ``gauss_newton`` (white residual) or ``sandwich`` (coloured residual); ``inflation`` (nf,): standard deviation over
    the one that a white residual of the same size would give; ``degrees`` of freedom of the variance behind it, infinite where
    the noise was given and not exceeded, and zero where there are as many unknowns as readings: then no variance is known.
    ``information`` and ``scores`` (nf, nf), both in ``z`` and with the initial states estimated as well: curvature of half the data's
    cost, and the covariance of its slope; NaN for a constant at its bound.
    """

    covariance: np.ndarray
    null: np.ndarray
    kind: IntervalKind = IntervalKind.GAUSS_NEWTON
    inflation: np.ndarray = field(default_factory=lambda: np.empty(0))
    degrees: float = np.inf
    information: np.ndarray | None = None
    scores: np.ndarray | None = None
    log_noise: np.ndarray = field(default_factory=lambda: np.empty(0))
    """Standard deviation of the logarithm of each noise level that was estimated with the rest (k,)."""
    spread: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    """The covariance along what the data determine alone (nf, nf): finite also where directions are open."""
    held: tuple[NarrowedInterval, ...] = ()
    """Constants whose intervals rest on others being exactly at their bounds."""
    limits: Mapping[int, BoundLimit] = field(default_factory=dict)
    """Of each constant that lies on a bound, by its number."""

    def __post_init__(self) -> None:
        # A variance below zero is what rounding leaves of a matrix that tells nothing of that constant.
        if (nothing := np.diag(self.covariance) < 0).any():
            known = np.where(nothing[:, None] | nothing, np.nan, self.covariance)
            object.__setattr__(self, "covariance", known)

    def with_spread(self, spread: np.ndarray) -> ParameterCovariance:
        """With the covariance (nf, nf) of something else that moves the constants, which nothing here knows of."""
        # A constant at its bound has none, and one that is open stays so.
        known = np.isfinite(self.covariance)
        covariance = np.where(known, self.covariance + spread, self.covariance)
        with np.errstate(divide="ignore", invalid="ignore"):
            growth = np.sqrt(np.diag(covariance) / np.diag(self.covariance))
        inflation = self.inflation * np.where(np.isfinite(growth), growth, 1.0)
        return replace(
            self, covariance=covariance, inflation=inflation, spread=self.spread + np.where(known, spread, 0.0)
        )

    @classmethod
    def unknown(cls, variables: DecisionVector) -> ParameterCovariance:
        """That of the constants where there is no optimum."""
        n, levels = len(variables.which), len(variables.estimated_noise)
        return cls(np.full((n, n), np.nan), np.empty((n, 0)), inflation=np.ones(n), log_noise=np.full(levels, np.nan))

    @classmethod
    def of(
        cls,
        variables: DecisionVector,
        spread: np.ndarray,
        decomposition: SymmetricDecomposition,
        *,
        kind: IntervalKind,
        inflation: np.ndarray,
        information: np.ndarray,
        scores: np.ndarray,
        degrees: float = np.inf,
    ) -> ParameterCovariance:
        """From the covariance ``spread`` in ``z`` of the constants off their bounds, and of the noise levels after them.

        ``decomposition`` of their information says which of them the data leave open; ``information`` and ``scores`` are those of the
        constants alone.
        """
        inside = np.flatnonzero(~variables.active)
        k, spans = len(inside), variables.spans[inside]
        variance = np.where(decomposition.is_open, np.inf, np.diag(spread))
        open_spread = spread.copy()
        open_spread[np.diag_indices_from(spread)] = variance
        null = np.zeros((len(variables.which), decomposition.weak.shape[1]))
        null[inside] = decomposition.null_basis[:k]
        whole_inflation = np.ones(len(variables.which))
        whole_inflation[inside] = inflation[:k]
        return cls(
            _place(open_spread[:k, :k] * np.outer(spans, spans), variables),
            null,
            kind,
            whole_inflation,
            degrees,
            _place(information, variables),
            _place(scores, variables),
            np.sqrt(variance[k:]),
            _place(spread[:k, :k] * np.outer(spans, spans), variables),
        )


# Share of a constant's information below which what is left beside the initial states is the rounding of sums over a record. (An unstable
# plant, whose runs hang on their start, keeps a few 1e-12.)
LOST_INFORMATION = 1e-13


@np.errstate(over="ignore", invalid="ignore")  # of numbers near the largest there are; what is not finite is told
def estimate_covariance(
    variables: DecisionVector,
    evaluation: Evaluation,
    residuals: ResidualRows,
    colour: ResidualColour,
    problem: EstimationProblem,
) -> ParameterCovariance:
    """Covariance of the constants, initial states projected out; constants at a bound count as fixed there.

    With the Jacobian ``J`` of the residual, its covariance ``R`` and the precision ``P`` of the priors it is the sandwich
    ``A^-1 (J'R J + P) A^-1`` with ``A = J'J + P``. Where the residual is white, ``R`` is ``s^2``, the residual variance over the noise
    variance of each output, and at least one where the noise was given: without priors that is ``s^2 (J'J)^-1``, the Gauss-Newton
    covariance, and with them, at ``s^2 = 1``, the posterior covariance ``A^-1``. The ``residuals`` may be coloured
    (`greybox.estimation.sandwich`); ``colour`` is theirs. Constants along an undetermined direction get an infinite
    variance.
    """
    n, inside = len(variables.which), np.flatnonzero(~variables.active)
    if not n:
        return ParameterCovariance.unknown(variables)
    # The Hessian of half the cost is the information: J'J from the data, P = 1 / std^2 from the priors.
    prior = variables.penalty(variables.here)[2] / 2
    known = np.diag(np.pad(prior, (0, variables.size - n)))
    rows, colour = residuals.rows, colour.share_variance(problem.noise.sharing)
    sums = sum_scores(variables, rows, colour)
    if colour.coloured:
        behind = give_back(variables, rows, colour, sums, pseudo_inverse(sums.information + known))
        sums, colour = (sums if behind is colour else sum_scores(variables, rows, behind)), behind
    data = sums.information
    freedom = evaluation.count - colour.unknowns + int(variables.has_prior.sum())
    # As many unknowns as readings take the residual away, and with it all that it could say of the noise.
    if freedom <= 0 and not problem.noise.known:
        return replace(ParameterCovariance.unknown(variables), degrees=0.0)
    degrees = float(max(freedom, 1))
    # Noise that was given, and not exceeded, is no estimate: intervals are normal. Else Student's, by the degrees
    # that the residual left.
    if problem.noise.known and (problem.variance_floor is not None or evaluation.squares.sum() <= degrees):
        degrees = np.inf
    kind = IntervalKind.SANDWICH if colour.coloured else IntervalKind.GAUSS_NEWTON
    degrees = colour.degrees if colour.coloured else degrees

    def spread(kept: np.ndarray) -> tuple[np.ndarray, np.ndarray, SymmetricDecomposition, dict[str, np.ndarray]]:
        held = np.diag(prior[kept])
        # Schur complement: A_cc - A_ci A_ii^-1 A_ic, the initial states estimated as well instead of counted as known.
        projector = eliminate(data + known, kept, np.arange(n, variables.size))
        information = _symmetrise(projector @ data[:, kept])
        # An offset that a free initial state can take the place of has no information left but rounding, of either sign.
        lost = np.diag(information) <= LOST_INFORMATION * np.diag(data)[kept]
        information[lost], information[:, lost] = 0.0, 0.0
        # Nor have the scores: beside a wide prior what is left of them would be a variance of either sign.
        projector[lost] = 0.0
        decomposition = decompose_symmetric(information + held)
        inverse = decomposition.pseudo_inverse
        scores = projector @ sums.white @ projector.T
        # A^-1 (s^2 J'J + P) A^-1; where s^2 = 1 it is A^-1 itself.
        result, inflation = inverse @ (scores + held) @ inverse, np.ones(len(kept))
        if colour.coloured:
            white = np.diag(result)
            scores = projector @ sums.coloured @ projector.T
            other = estimate_kernel_score_covariance(variables, rows, colour, projector)
            # Two estimates of the middle, each of which may fall short: the larger standard deviation of both counts.
            result = raise_to_larger(*(inverse @ (middle + held) @ inverse for middle in (scores, other)))
            with np.errstate(divide="ignore", invalid="ignore"):
                inflation = np.sqrt(np.diag(result) / white)
        figures = {"inflation": inflation, "information": information, "scores": scores}
        return result, inverse @ projector, decomposition, figures

    covariance, _, decomposition, figures = spread(inside)
    result = ParameterCovariance.of(variables, covariance, decomposition, kind=kind, degrees=degrees, **figures)
    # Of noise that is known no residual is less.
    floor = float(evaluation.count) if problem.noise.known else 0.0
    limits = find_bound_limits(variables, evaluation, lambda kept: spread(kept)[:3], degrees, floor)
    return replace(result, held=find_narrowed_intervals(variables, data + known), limits=limits)


def find_bound_limits(
    variables: DecisionVector,
    evaluation: Evaluation,
    spread: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, SymmetricDecomposition]],
    degrees: float,
    floor: float,
) -> dict[int, BoundLimit]:
    """What the records say of each constant on a bound: how far from it the constant may be, and whether they would have it beyond.

    Parameters
    ----------
    variables
        The unknowns, ``z = 0`` at the optimum.
    evaluation
        The cost with its slope there.
    spread
        From the numbers of constants to their covariance in ``z``, the matrix that takes half the gradient to their step, and the
        decomposition of their information.
    degrees
        Of freedom of the variance.
    floor
        What of the cost is noise at least; infinite where its level is not told by the cost.
    """
    limits = {}
    low, cost = variables.bounds()[0], evaluation.cost
    for k in np.flatnonzero(variables.active):
        kept = np.flatnonzero(~variables.active | (np.arange(len(variables.which)) == k))
        covariance, newton, decomposition = spread(kept)
        place = int(np.searchsorted(kept, k))
        inward = 1.0 if low[k] >= -AT_BOUND else -1.0
        # Where the least cost would be without the bound, from the bound inwards: - A^-1 g / 2.
        best = -inward * float(newton[place] @ evaluation.gradient) / 2
        deviation = float(np.sqrt(max(covariance[place, place], 0.0)))
        if decomposition.is_open[place] or not (np.isfinite(best) and deviation > 0):
            limits[int(k)] = BoundLimit(None, 0.0)
            continue
        outside, reach = min(best, 0.0), compute_quantile(degrees) * deviation
        # Held at the bound the misfit may be large for that alone: the noise is what is left where the cost is least, less d^2 / (A^-1)_kk.
        left = max(cost - outside**2 / float(newton[place, k]), floor, TINY)
        pull = -outside / deviation * (np.sqrt(cost / left) if left < cost else 1.0)
        # The rise over the cost at the bound, ((d - best)^2 - best^2) / s^2, comes to the squared 95 % point at this distance.
        distance = best + float(np.sqrt(outside**2 + reach**2))
        value, bounds = float(variables.base[k]), (variables.low[k], variables.high[k])
        limit = value + inward * distance * float(variables.scale[k])
        if variables.logarithmic[k]:
            # d log p = dp / p near a lower bound, where p may grow by decades, and -d(1/p) p near an upper one.
            limit = value * (1 + distance) ** inward
        is_set = bounds[0] < limit < bounds[1] and pull <= compute_quantile(degrees)
        limits[int(k)] = BoundLimit(limit if is_set else None, float(pull))
    return limits


def estimate_likelihood_covariance(
    optimum: LikelihoodMaximum, residuals: ResidualRows, colour: ResidualColour
) -> ParameterCovariance:
    """Covariance of the constants and of the noise levels at the optimum, the first states estimated as well.

    The observed information is half the Hessian of ``-2 log L``, by central differences of its exact gradient; where it is not positive
    definite, the expected one. Where the innovations are correlated from sample to sample (``colour``) the model lacks something: then
    it is the sandwich ``A^-1 B A^-1`` with Newey and West's covariance ``B`` of the scores, which for a model that lacks nothing are
    martingale differences, but no standard deviation gets smaller by that. Constants at a bound count as fixed there.
    """
    v = optimum.objective.variables
    n, inside, parts = len(v.which), np.flatnonzero(~v.active), v.split(np.arange(v.size))
    wanted, first_states = np.concatenate([inside, parts.noise_levels]), parts.initial_states.ravel()
    kind, whole = IntervalKind.OBSERVED_INFORMATION, compute_observed_information(optimum)
    expected = optimum.evaluation.hessian / 2
    # The expected information is a product and has no negative curvature: it says which directions are open, the
    # differences do not.
    decomposition = decompose_symmetric(_reduce_information(expected, wanted, first_states))
    # Differences leave a little curvature along directions that have none: the inverse is zero along the weak ones.
    observed, basis = (
        _reduce_information(whole, wanted, first_states),
        decomposition.strong / decomposition.scale[:, None],
    )
    values: np.ndarray = np.full(1, np.nan)
    vectors = basis
    if np.isfinite(observed).all():
        # The observed curvature along the directions that are determined.
        values, vectors = np.linalg.eigh(_symmetrise(basis.T @ observed @ basis))
    if values.min(initial=1.0) > 0:
        # Its inverse there: W L^-1 W'.
        strong = basis @ vectors
        inverse = (strong / values) @ strong.T
    else:
        kind, whole, inverse = IntervalKind.EXPECTED_INFORMATION, expected, decomposition.pseudo_inverse
    spread = inverse
    if colour.coloured:
        # Scores as rows of one output with residual 1, so that the same kernel estimate serves both objectives.
        rows = [(np.ones((len(s), 1)), s[:, None, :]) for s in residuals.scores]
        projector = eliminate(whole, wanted, first_states)
        scores = estimate_kernel_score_covariance(v, rows, colour, projector)
        spread, kind = raise_to_larger(inverse, inverse @ scores @ inverse), IntervalKind.SANDWICH
    with np.errstate(divide="ignore", invalid="ignore"):
        inflation = np.sqrt(np.diag(spread) / np.diag(inverse))
    data = whole - np.diag(np.pad(v.penalty(v.here)[2] / 2, (0, v.size - n)))
    information = _reduce_information(data, inside, np.arange(n, v.size))
    result = ParameterCovariance.of(
        v, spread, decomposition, kind=kind, inflation=inflation, information=information, scores=information
    )

    def spread_of(kept: np.ndarray) -> tuple[np.ndarray, np.ndarray, SymmetricDecomposition]:
        others = np.arange(n, v.size)
        parts = decompose_symmetric(_reduce_information(expected, kept, others))
        return parts.pseudo_inverse, parts.pseudo_inverse @ eliminate(expected, kept, others), parts

    limits = find_bound_limits(v, optimum.evaluation, spread_of, np.inf, np.inf)
    return replace(result, held=find_narrowed_intervals(v, expected), limits=limits)


def find_narrowed_intervals(variables: DecisionVector, information: np.ndarray) -> tuple[NarrowedInterval, ...]:
    """Constants that look better determined than the data make them, since others at their bounds count as known.

    Parameters
    ----------
    variables
        The unknowns, ``z = 0`` at the optimum.
    information
        The Gauss-Newton matrix (size, size) of half the cost in ``z``, constants at their bounds included.
    """
    inside, bounds = np.flatnonzero(~variables.active), np.flatnonzero(variables.active)
    if not len(bounds) or not len(inside) or not np.isfinite(information).all():
        return ()

    def variances(freed: np.ndarray) -> np.ndarray:
        # The Schur complement estimates initial states and noise levels as well; what is left out of it counts as known.
        kept, others = np.concatenate([inside, freed]), np.arange(len(variables.which), len(information))
        reduced = _reduce_information(information, kept, others)
        decomposition = decompose_symmetric(reduced)
        variance = np.where(decomposition.is_open, np.inf, np.diag(decomposition.pseudo_inverse))
        return variance[: len(inside)]

    held = variances(bounds[:0])
    # What is open with the bounds held is told as such, and owes nothing to them.
    # Variances are compared: a ratio of standard deviations, squared.
    limit = np.where(np.isfinite(held) & (held > 0), LEAST_GROWTH**2 * held, np.inf)
    all_free = variances(bounds)
    alone = [variances(np.array([k])) > limit for k in bounds]
    result = []
    for j in np.flatnonzero(all_free > limit):
        # Where none of them does it alone, they do it together.
        causes = [k for k, grows in zip(bounds, alone, strict=True) if grows[j]] or list(bounds)
        growth = float(np.sqrt(all_free[j] / held[j]))
        result.append(NarrowedInterval(variables.names[inside[j]], tuple(variables.names[k] for k in causes), growth))
    return tuple(result)


def decompose_information(variables: DecisionVector, information: np.ndarray) -> SymmetricDecomposition:
    """What the records show of the free constants, the initial states estimated as well; nothing where it is not finite.

    ``information`` as in `find_narrowed_intervals`.
    """
    constants = np.arange(len(variables.which))
    reduced = _reduce_information(information, constants, np.arange(len(constants), len(information)))
    return decompose_symmetric(np.nan_to_num(reduced))


# The gradient of a likelihood is differenced over this share of a standard deviation either way.
DIFFERENCE_SHARE = 0.01
# The same at most, in the scaled unknowns.
LONGEST_DIFFERENCE = 0.01


def compute_observed_information(optimum: LikelihoodMaximum) -> np.ndarray:
    """Half the Hessian (size, size) of ``-2 log L`` at the optimum; an experiment's first states concern it alone."""
    objective, v = optimum.objective, optimum.objective.variables
    expected = np.diag(optimum.evaluation.hessian) / 2
    # In standard deviations: the same relative accuracy of the difference for each unknown.
    steps = np.where(expected > 0, DIFFERENCE_SHARE / np.sqrt(np.maximum(expected, TINY)), 0.0)
    concerned: list[list[int] | None] = [None] * v.size
    for experiment, states in enumerate(v.split(np.arange(v.size)).initial_states):
        for k in states:
            concerned[k] = [experiment]
    whole = np.zeros((v.size, v.size))
    for k in np.flatnonzero(steps):
        step = v.here
        step[k] = min(steps[k], LONGEST_DIFFERENCE)
        # d^2 (cost / 2) = (g(z + s) - g(z - s)) / (4 s)
        rise = objective.gradient(step, concerned[k]) - objective.gradient(-step, concerned[k])
        whole[k] = rise / (4 * step[k])
    places = np.arange(len(v.which))
    # `gradient` is that of the data alone: the priors' curvature comes in exactly.
    whole[places, places] += v.penalty(v.here)[2] / 2
    return _symmetrise(whole)


def _place(matrix: np.ndarray, variables: DecisionVector) -> np.ndarray:
    """A matrix of the constants off their bounds among all of them (nf, nf), NaN elsewhere."""
    n, inside = len(variables.which), np.flatnonzero(~variables.active)
    whole = np.full((n, n), np.nan)
    whole[np.ix_(inside, inside)] = matrix
    return whole


def compute_quantile(degrees: float) -> float:
    """Two-sided 95 % point of Student's distribution, of the normal one for infinite ``degrees``."""
    return float(stdtrit(degrees, 0.975)) if np.isfinite(degrees) else float(ndtri(0.975))


def compute_interval(value: float, reach: float, positive: bool, bounds: tuple[float, float]) -> tuple[float, float]:
    """``value`` less and more ``reach``, by a factor where the constant is positive, within its bounds."""
    if positive:
        # value exp(+-reach / value): symmetric in the logarithm, whose standard deviation is std / value.
        factor = float(np.exp(min(reach / value, 700.0)))
        low, high = value / factor, value * factor
    else:
        low, high = value - reach, value + reach
    return max(low, bounds[0]), min(high, bounds[1])


def raise_to_larger(covariance: np.ndarray, other: np.ndarray) -> np.ndarray:
    """``covariance`` with each standard deviation raised to that of the other."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sqrt(np.diag(other) / np.diag(covariance))
    factor = np.where(np.isfinite(ratio), np.maximum(ratio, 1.0), 1.0)
    # S C S with diagonal S: the correlations stay.
    return covariance * np.outer(factor, factor)


def _reduce_information(information: np.ndarray, wanted: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Information on the ``wanted`` unknowns with the ``others`` estimated as well; what is not finite stays so."""
    if not np.isfinite(information).all():
        return np.full((len(wanted), len(wanted)), np.nan)
    # Schur's complement: A_ww - A_wo A_oo^-1 A_ow.
    return _symmetrise(eliminate(information, wanted, others) @ information[:, wanted])


def _symmetrise(matrix: np.ndarray) -> np.ndarray:
    """The symmetric part."""
    return (matrix + matrix.T) / 2


# From a covariance to estimates: parameters, those of each experiment, tied ones, and what became of priors.


def to_estimates(variables: DecisionVector, covariance: ParameterCovariance) -> dict[str, Estimate]:
    """Every parameter of the model with its interval; of a positive constant the interval is multiplicative.

    A constant that each experiment has for itself stands here with the mean of its values.
    """
    everything = variables.model.all_parameters
    result = {q.name: Estimate(float(variables.fixed[k]), q.unit, fixed=True) for k, q in enumerate(everything)}
    matrix, active = to_model_covariance(variables, covariance.covariance), variables.active
    for j, k in enumerate(locate_fitted(variables)):
        q, entries = everything[k], variables.which == k
        # Of its own value in each record the limits stand with these.
        at = np.flatnonzero(entries & active)
        limit = covariance.limits.get(int(at[0])) if entries.sum() == 1 and len(at) else None
        result[q.name] = _estimate(q, float(variables.fixed[k]), matrix[j, j], covariance.degrees, bool(len(at)), limit)
    return result


def to_experiment_estimates(
    variables: DecisionVector, covariance: ParameterCovariance
) -> dict[str, dict[str, Estimate]]:
    """The values of each constant that experiments have for themselves: constant -> experiment -> value with its interval."""
    result: dict[str, dict[str, Estimate]] = {}
    for k, (label, q) in enumerate(zip(variables.names, variables.quantities, strict=True)):
        if variables.owner[k] != SHARED:
            title = label[len(q.name) + 2 : -1]
            value, variance = float(variables.base[k]), covariance.covariance[k, k]
            limit = covariance.limits.get(k)
            estimate = _estimate(q, value, variance, covariance.degrees, bool(variables.active[k]), limit)
            result.setdefault(q.name, {})[title] = estimate
    return result


def to_tied_estimates(variables: DecisionVector, covariance: ParameterCovariance) -> dict[str, Estimate]:
    """The constants that others give, each with the interval that theirs leave it (the delta method)."""
    model, p = variables.model, variables.fixed
    matrix, free = to_model_covariance(variables, covariance.covariance), locate_fitted(variables)
    result = {}
    for q in model.stated_parameters:
        if q.name in model.tied_values:
            value, slope = evaluate_tie(model, q.name, p)
            along = slope[free]
            acting = np.flatnonzero(along)
            if not len(acting):
                result[q.name] = Estimate(value, q.unit, fixed=True)
                continue
            # g' C g
            variance = float(along[acting] @ matrix[np.ix_(acting, acting)] @ along[acting])
            result[q.name] = _estimate(q, value, variance, covariance.degrees, False)
    return result


def evaluate_tie(model: Model, name: str, p: np.ndarray) -> tuple[float, np.ndarray]:
    """A tied constant at the parameters ``p`` (np,), and its slopes (np,) along them."""
    symbols = model.system.p
    named = model.parameters_as_symbols(symbols)
    formula = ca.SX(named[name])
    value, slope = ca.Function("tie", [symbols], [formula, ca.jacobian(formula, symbols)])(p)
    return float(value), np.asarray(ca.densify(slope)).ravel()


def check_priors(variables: DecisionVector, covariance: ParameterCovariance) -> dict[str, PriorCheck]:
    """For each constant with a prior how far the data moved it, what they added, and whether the two agree.

    The conflict compares the prior with what the data (and the other priors) say without it: their difference over the root of
    the sum of both variances, standard normal where both are right.
    """
    result: dict[str, PriorCheck] = {}
    if covariance.information is None or covariance.scores is None:
        return result
    inside = np.flatnonzero(~variables.active)
    block = np.ix_(inside, inside)
    precision = variables.penalty(variables.here)[2] / 2
    whole = covariance.information[block] + np.diag(precision[inside])
    inverse = pseudo_inverse(whole)
    for j, k in enumerate(inside):
        if not variables.has_prior[k]:
            continue
        mean, std = map(float, variables.prior[k])
        shift, w = float(variables.base[k] - mean) / std, precision[k]
        # Share of the information on the constant that is not its prior's.
        left = 1 - w * inverse[j, j]
        variance_reduction = (
            float(np.clip(1 - covariance.covariance[k, k] / std**2, 0.0, 1.0))
            if np.isfinite(covariance.covariance[k, k])
            else 0.0
        )
        conflict, factor, factor_std = None, None, None
        if left > PRIOR_INFORMATION_CUTOFF:
            # Sherman and Morrison: (A - w e e')^-1 = A^-1 + w A^-1 e e' A^-1 / (1 - w e'A^-1 e), the inverse without
            # this prior.
            without = inverse + w * np.outer(inverse[:, j], inverse[:, j]) / left
            others = precision[inside].copy()
            others[j] = 0.0
            row = without[j]
            # A^-1 S A^-1 of the estimate without this prior, S over the scores of the data and the other priors.
            variance = float(row @ (covariance.scores[block] + np.diag(others)) @ row)
            # Of heights that no record determines it is lost in rounding, and the data say nothing by themselves.
            is_known = variance >= 0
            # The estimate without the prior lies shift / left from its mean (in its standard deviations): what is
            # seen is that pulled back by it.
            conflict = float(shift / left / np.sqrt(1 + w * variance)) if is_known else None
            if is_known and mean != 0:
                # The same estimate and its standard deviation, both over the mean.
                factor = float(1 + shift / left * std / mean)
                factor_std = float(std / abs(mean) * np.sqrt(w * variance))
        result[variables.names[k]] = PriorCheck(mean, std, shift, variance_reduction, conflict, factor, factor_std)
    return result


def locate_fitted(variables: DecisionVector) -> np.ndarray:
    """Positions in ``system.p`` of what was fitted, each once, in the order of ``names``."""
    return np.array(list(dict.fromkeys(variables.which.tolist())), int)


def to_model_covariance(variables: DecisionVector, covariance: np.ndarray) -> np.ndarray:
    """Covariance of the model's parameters (`locate_fitted`) from that of all free ones: own values count through their mean."""
    if (variables.owner == SHARED).all():
        return covariance
    places = locate_fitted(variables)
    mean = np.zeros((len(places), len(variables.which)))
    for j, k in enumerate(places):
        entries = np.flatnonzero(variables.which == k)
        for m in entries:
            geometric = variables.logarithmic[m] and variables.owner[m] != SHARED
            # d(mean) / d(value): 1 / n, of a geometric mean times mean / value.
            mean[j, m] = (variables.fixed[k] / variables.base[m] if geometric else 1.0) / len(entries)
    undetermined = np.isinf(np.diag(covariance))
    missing = np.isnan(np.diag(covariance))
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    # Propagation of errors: J C J'.
    result = mean @ finite @ mean.T
    # Zero times infinity is NaN: what is not finite is put back where its weight is not zero.
    for mask, value in ((undetermined, np.inf), (missing, np.nan)):
        touched = (np.abs(mean[:, mask]) > 0).any(axis=1)
        result[touched, touched] = value
    return result


def _estimate(
    q: Parameter, value: float, variance: float, degrees: float, bound: bool, limit: BoundLimit | None = None
) -> Estimate:
    std = float(np.sqrt(variance)) if np.isfinite(variance) else None
    limits = None if std is None else compute_interval(value, compute_quantile(degrees) * std, q.positive, q.bounds)
    if limit is not None and limit.limit is not None:  # from the bound to as far as the records let it be
        limits = (min(value, limit.limit), max(value, limit.limit))
    return Estimate(value, q.unit, std, limits, False, bound)
