"""From a covariance to estimates: parameters, those of each experiment, tied ones, and what became of priors."""

from __future__ import annotations

import casadi as ca
import numpy as np

from greybox.estimation.covariance import ParameterCovariance, compute_interval, compute_quantile
from greybox.linear_algebra import pseudo_inverse
from greybox.model import Model
from greybox.model.signals import Parameter
from greybox.numerics import PRIOR_INFORMATION_CUTOFF
from greybox.result import Estimate, PriorCheck
from greybox.transcription import DecisionVector
from greybox.transcription.decision_vector import SHARED


def to_estimates(variables: DecisionVector, covariance: ParameterCovariance) -> dict[str, Estimate]:
    """Every parameter of the model with its interval; of a positive constant the interval is multiplicative.

    A constant that each experiment has for itself stands here with the mean of its values.
    """
    everything = variables.model.all_parameters
    result = {q.name: Estimate(float(variables.fixed[k]), q.unit, fixed=True) for k, q in enumerate(everything)}
    matrix, active = to_model_covariance(variables, covariance.covariance), variables.active
    for j, k in enumerate(locate_fitted(variables)):
        q, entries = everything[k], variables.which == k
        bound = bool(active[entries].any())
        result[q.name] = _estimate(q, float(variables.fixed[k]), matrix[j, j], covariance.degrees, bound)
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
            estimate = _estimate(q, value, variance, covariance.degrees, bool(variables.active[k]))
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
        left = 1 - w * inverse[j, j]
        variance_reduction = (
            float(np.clip(1 - covariance.covariance[k, k] / std**2, 0.0, 1.0))
            if np.isfinite(covariance.covariance[k, k])
            else 0.0
        )
        conflict = None
        if left > PRIOR_INFORMATION_CUTOFF:
            without = inverse + w * np.outer(inverse[:, j], inverse[:, j]) / left
            others = precision[inside].copy()
            others[j] = 0.0
            row = without[j]
            variance = float(row @ (covariance.scores[block] + np.diag(others)) @ row)
            conflict = float(shift / left / np.sqrt(1 + w * variance))
        result[variables.names[k]] = PriorCheck(mean, std, shift, variance_reduction, conflict)
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
            mean[j, m] = (variables.fixed[k] / variables.base[m] if geometric else 1.0) / len(entries)
    undetermined = np.isinf(np.diag(covariance))
    missing = np.isnan(np.diag(covariance))
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    result = mean @ finite @ mean.T
    for mask, value in ((undetermined, np.inf), (missing, np.nan)):
        touched = (np.abs(mean[:, mask]) > 0).any(axis=1)
        result[touched, touched] = value
    return result


def _estimate(q: Parameter, value: float, variance: float, degrees: float, bound: bool) -> Estimate:
    std = float(np.sqrt(variance)) if np.isfinite(variance) else None
    limits = None if std is None else compute_interval(value, compute_quantile(degrees) * std, q.positive, q.bounds)
    return Estimate(value, q.unit, std, limits, False, bound)
