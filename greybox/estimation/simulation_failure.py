"""Where a simulation broke: which term of which balance, when, and at which states."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum

import casadi as ca
import numpy as np

from greybox.estimation.findings import EstimationCode
from greybox.expressions.text import expression_text
from greybox.findings import Finding, Severity
from greybox.model import Model
from greybox.numerics import STATE_BOUND_MARGIN
from greybox.transcription import DecisionVector
from greybox.transcription.problem import EstimationProblem


class QuantityKind(StrEnum):
    """What may fail to be a number in a run."""

    START = "start"
    TERM = "term"
    STORAGE = "storage"
    OUTPUT = "output"


def locate_simulation_failure(
    problem: EstimationProblem, variables: DecisionVector, experiment: int, sample: int
) -> Finding:
    """What went wrong where the run of record number ``experiment`` is no longer finite at row ``sample`` (both from 0).

    The terms of every balance are evaluated at the last states that were finite, and then at the points to which a Runge-Kutta
    step goes from there; the first term that is not a number is named, with its formula, the time, the states and the inputs. Where
    all terms are finite the states themselves run away: then the largest of them is named. ``variables``: the point is ``z = 0``.
    """
    model, record = problem.model, problem.records[experiment]
    z = variables.here
    p = variables.parameters(z, experiment)
    _, states = problem.shooting(variables).simulate(z)[experiment]
    if sample >= len(states):
        return Finding(EstimationCode.SENSITIVITY_NOT_FINITE, Severity.ERROR, "", {"experiment": experiment + 1})
    finite = np.isfinite(states).all(axis=1)
    last = min(sample, max(int(np.argmin(finite)) - 1, 0)) if not finite.all() else sample
    x, u = states[last], record.u[last, : len(model.inputs)]
    place = {
        "experiment": experiment + 1,
        "time": float(problem.experiments[experiment].time[last]),
        "row": last + 1,
    }
    h = float(record.h[min(last, len(record.h) - 1)]) if len(record.h) else 0.0
    for at in _points(model, x, u, p, h):
        quantity = _first_not_finite(model, at, u, p)
        if quantity:
            values = {**place, **quantity, "point": _name_point(model, at, u)}
            return Finding(EstimationCode.TERM_NOT_FINITE, Severity.ERROR, quantity["name"], values)
    largest = model.system.state_names[int(np.argmax(np.abs(x)))]
    return Finding(EstimationCode.STATES_DIVERGE, Severity.ERROR, largest, {**place, "point": _name_point(model, x, u)})


def _points(model: Model, x: np.ndarray, u: np.ndarray, p: np.ndarray, h: float) -> Iterator[np.ndarray]:
    """The states, and those at which an RK4 step of length ``h`` asks for their rates."""
    yield x
    rate = model.system.rhs_function
    at = x
    for share in (0.5, 0.5, 1.0):
        at = x + share * h * np.asarray(rate(at, u, p)).ravel()
        if not np.isfinite(at).all():
            return
        yield at


def _first_not_finite(model: Model, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> dict[str, str]:
    """The first quantity of the equations that is not finite: its kind, name, balance, formula, value and unit; empty if none is."""
    system = model.system
    for name, value in zip(system.state_names, x, strict=True):
        if not np.isfinite(value):
            return _describe_quantity(QuantityKind.START, name, "", "", float(value), "")
    bounds = np.array([s.bounds for s in model.all_states], float)
    inside = np.clip(x, bounds[:, 0] + STATE_BOUND_MARGIN, bounds[:, 1] - STATE_BOUND_MARGIN)
    quantities: list[tuple[QuantityKind, str, str, ca.SX, str]] = []
    for balance in system.balances:
        quantities += [
            (QuantityKind.TERM, name, balance.name, ca.SX(term), balance.unit) for name, term in balance.terms.items()
        ]
        quantities.append((QuantityKind.STORAGE, balance.name, balance.name, 1 / ca.SX(balance.storage), ""))
    quantities += [
        (QuantityKind.OUTPUT, name, "", system.outputs[j], model.outputs[j].unit)
        for j, name in enumerate(system.output_names)
    ]
    values = _evaluate(model, [formula for _, _, _, formula, _ in quantities], inside, u, p)
    for (kind, name, balance_name, formula, unit), value in zip(quantities, values, strict=True):
        if not np.isfinite(value):
            return _describe_quantity(kind, name, balance_name, expression_text(formula), float(value), unit)
    return {}


def _describe_quantity(
    kind: QuantityKind, name: str, balance: str, formula: str, value: float, unit: str
) -> dict[str, str]:
    # JSON has no infinities: the value is text.
    return {
        "kind": str(kind),
        "name": name,
        "balance": balance,
        "formula": formula,
        "value": f"{value:g}",
        "unit": unit,
    }


def _evaluate(model: Model, formulas: list[ca.SX], x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
    system = model.system
    known = [system.x, system.u, system.p]
    whole = ca.vertcat(*formulas)
    names = {s.name() for group in known for s in ca.symvar(ca.SX(group))}
    other = [s for s in ca.symvar(whole) if s.name() not in names]  # an input of the past: as good as zero here
    if other:
        whole = ca.substitute(whole, ca.vertcat(*other), ca.SX.zeros(len(other)))
    return np.asarray(ca.Function("terms", known, [ca.densify(whole)])(x, u, p)).ravel()


def _name_point(model: Model, x: np.ndarray, u: np.ndarray) -> list[dict[str, str]]:
    """States and inputs with their units, values as text."""
    states = zip(model.system.state_names, x, (s.unit for s in model.all_states), strict=True)
    inputs = zip((i.name for i in model.inputs), u, (i.unit for i in model.inputs), strict=True)
    return [{"name": name, "value": f"{value:.4g}", "unit": unit} for name, value, unit in (*states, *inputs)]
