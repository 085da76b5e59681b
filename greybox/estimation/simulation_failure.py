"""Where a simulation broke: which term of which balance, when, and at which states."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from greybox.estimation.problem import EstimationProblem
from greybox.expressions.text import expression_text
from greybox.model import Model
from greybox.numerics import STATE_BOUND_MARGIN
from greybox.transcription import DecisionVector

LONGEST = 80  # characters of a formula that are worth showing


def describe_simulation_failure(
    problem: EstimationProblem, variables: DecisionVector, experiment: int, sample: int
) -> str:
    """What went wrong where the run of record number ``experiment`` is no longer finite at row ``sample`` (both from 0).

    The terms of every balance are evaluated at the last states that were finite, and then at the points to which a Runge-Kutta
    step goes from there; the first term that is not a number is named, with its formula, the time, the states and the inputs. Where
    all terms are finite the states themselves run away: then the largest of them is named. ``variables``: the point is ``z = 0``.
    """
    model, record = problem.model, problem.records[experiment]
    z = np.zeros(variables.size)
    p = variables.parameters(z, experiment)
    run = problem.shooting(variables).simulate(z)[experiment]
    where = f"The simulation of experiment {experiment + 1}"
    if sample >= len(run[1]):
        return (
            f"{where} goes through, but its slope along the constants is not finite: a term has an infinite slope, as sqrt has"
            " at 0; give the state behind it a bound, or write the term without it"
        )
    finite = np.isfinite(run[1]).all(axis=1)
    last = min(sample, max(int(np.argmin(finite)) - 1, 0)) if not finite.all() else sample
    x, u = run[1][last], record.u[last, : len(model.inputs)]
    time = float(problem.experiments[experiment].time[last])
    place = f"{where} fails at t = {time:.6g} s (row {last + 1})"
    h = float(record.h[min(last, len(record.h) - 1)]) if len(record.h) else 0.0
    for at in _points(model, x, u, p, h):
        found = _first_bad(model, at, u, p)
        if found:
            return f"{place}: {found}, at {_state(model, at, u)}"
    return (
        f"{place}: every term is finite there, but the states run away; {_largest(model, x)}, at {_state(model, x, u)}"
    )


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


def _first_bad(model: Model, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> str:
    """The first quantity of the equations that is not finite, in words; empty if there is none."""
    system = model.system
    named = [
        (f"the starting value of the state {n!r}", e)
        for n, e in zip(system.state_names, x, strict=True)
        if not np.isfinite(e)
    ]
    if named:
        return f"{named[0][0]} is {named[0][1]:g}"
    bounds = np.array([s.bounds for s in model.all_states], float)
    inside = np.clip(x, bounds[:, 0] + STATE_BOUND_MARGIN, bounds[:, 1] - STATE_BOUND_MARGIN)
    things: list[tuple[str, ca.SX, str]] = []
    for balance in system.balances:
        things += [
            (f"in the balance {balance.name!r} the term {n!r}", ca.SX(t), balance.unit)
            for n, t in balance.terms.items()
        ]
        things.append((f"in the balance {balance.name!r} one over the storage", 1 / ca.SX(balance.storage), ""))
    things += [
        (f"the output {n!r}", system.outputs[j], model.outputs[j].unit) for j, n in enumerate(system.output_names)
    ]
    values = _values(model, [e for _, e, _ in things], inside, u, p)
    for (name, formula, unit), value in zip(things, values, strict=True):
        if not np.isfinite(value):
            text = expression_text(formula)
            shown = f" ({text})" if len(text) <= LONGEST else ""
            return f"{name}{shown} is {value:g} {unit}".rstrip()
    return ""


def _values(model: Model, formulas: list[ca.SX], x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
    system = model.system
    known = [system.x, system.u, system.p]
    whole = ca.vertcat(*formulas)
    names = {s.name() for group in known for s in ca.symvar(group)}
    other = [s for s in ca.symvar(whole) if s.name() not in names]  # an input of the past: as good as zero here
    if other:
        whole = ca.substitute(whole, ca.vertcat(*other), ca.SX.zeros(len(other)))
    return np.asarray(ca.Function("terms", known, [ca.densify(whole)])(x, u, p)).ravel()


def _largest(model: Model, x: np.ndarray) -> str:
    k = int(np.argmax(np.abs(x)))
    return f"{model.system.state_names[k]!r} is largest"


def _state(model: Model, x: np.ndarray, u: np.ndarray) -> str:
    """``x = 0.1 m, v = -2 m/s, u = 1 V``."""
    units = [s.unit for s in model.all_states]
    parts = [f"{n} = {value:.4g} {unit}" for n, value, unit in zip(model.system.state_names, x, units, strict=True)]
    parts += [f"{i.name} = {value:.4g} {i.unit}" for i, value in zip(model.inputs, u, strict=True)]
    return ", ".join(part.strip() for part in parts)
