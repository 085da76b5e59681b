"""A free curve in the place of one factor of a law: what a law must not be beaten by."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import casadi as ca
import numpy as np

from greybox.discovery.laws.equation import law_values
from greybox.discovery.laws.policy import LawPolicy
from greybox.discovery.laws.terms import LAW, LawTerm
from greybox.expressions.formula import evaluate_formula
from greybox.linear_algebra import decompose_columns
from greybox.model import Effect, Model
from greybox.model.signals import Expression, NamedValues, Parameter

LAW_CURVE = "law_curve"


def curve_effects(
    model: Model, terms: Sequence[LawTerm], seen: Mapping[str, tuple[float, float]], policy: LawPolicy
) -> Iterator[tuple[Model, dict[str, float]]]:
    """For each variable of the last term the model with a curve over it, its other factors kept, and start values: the law itself."""
    names = [e.name for e in model.effects if e.name.partition("_")[0] == LAW]
    name, term = names[-1], terms[-1]
    if term.has_memory:
        return
    values = law_values(model, name)
    for variable in term.variables:
        mine = [f for f in term.factors if f.variables == (variable,)]
        others = [f for f in term.factors if f.variables != (variable,)]
        if not mine or any(variable in f.variables for f in others):
            continue
        shape = values.get(term.constants.shape, 1.0)
        low, high = seen[variable]
        pitch = (high - low) / (policy.curve_heights - 1) or 1.0
        z = np.linspace(low, high, 8 * policy.curve_heights)
        target = values[term.constants.amplitude] * _product_of(term, mine, {variable: z}, shape)
        bumps = np.exp(-(((z[:, None] - low) / pitch - np.arange(policy.curve_heights)) ** 2))
        heights = decompose_columns(np.vstack([bumps, 1e-6 * np.eye(policy.curve_heights)])).solve(
            np.append(target, np.zeros(policy.curve_heights))
        )
        unit = term.site_unit if not others else f"({term.site_unit})/({_unit_of(term, others)})"
        effect = _curve_effect(term, variable, others, shape, low, pitch, unit, heights)
        curved = model.without(name) + effect
        names_in_model = next(b.model_names for b in curved.bound_effects if b.effect.name == LAW_CURVE)
        start = {n: v for n, v in model.values.items() if n in curved.values}
        yield curved, start | {names_in_model[f"h{k}"]: float(v) for k, v in enumerate(heights)}


def _product_of(term: LawTerm, factors: Sequence, values: Mapping[str, np.ndarray], shape: float) -> np.ndarray:
    part = LawTerm(term.site, tuple(factors), term.units, term.site_unit, term.constants)
    return part.evaluate(values, shape)


def _unit_of(term: LawTerm, factors: Sequence) -> str:
    return LawTerm(term.site, tuple(factors), term.units, term.site_unit, term.constants).product_unit


def _curve_effect(
    term: LawTerm,
    variable: str,
    others: Sequence,
    shape: float,
    low: float,
    pitch: float,
    unit: str,
    heights: np.ndarray,
) -> Effect:
    variable_unit = dict(term.units)[variable]
    names = [f"h{k}" for k in range(len(heights))]
    rest = LawTerm(term.site, tuple(others), term.units, term.site_unit, term.constants)
    parameters = [
        Parameter("lowest", variable_unit, low, fixed=True),
        Parameter("pitch", variable_unit, pitch, fixed=True),
        Parameter(term.constants.shape, rest.shape_unit, shape, fixed=True),
        *(Parameter(n, unit, float(v)) for n, v in zip(names, heights, strict=True)),
    ]

    def curve(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        value = x[variable] if variable in x else u[variable]
        t = (value - p["lowest"]) / p["pitch"]
        total: Expression = 0
        for k, n in enumerate(names):
            total = total + p[n] * ca.exp(-((t - k) ** 2))
        if not others:
            return total
        known = {v: (x[v] if v in x else u[v]) for v in rest.variables}
        known[term.constants.shape] = p[term.constants.shape]
        return total * evaluate_formula("law", rest.product, _Known(known))

    return Effect(LAW_CURVE, term.site, parameters, terms=curve, amplitudes=names, equation=f"curve over {variable}")


class _Known(dict):
    """Values by name, as a formula asks for them."""

    @property
    def names(self) -> list[str]:
        """Every name."""
        return list(self)
