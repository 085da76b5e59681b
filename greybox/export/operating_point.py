"""The operating point: what is given is kept, what is not is found so that every balance is met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.errors import ModelError, nearest
from greybox.export.model_functions import BalanceResidual, ModelFunctions
from greybox.export.plant import format_signals
from greybox.model import Model
from greybox.units import format_unit

NEWTON, HALVINGS, RESTARTS = 60, 30, 25
# A direction in which the scaled slopes are below this share of the steepest is left as it is (a piston may rest anywhere).
FLAT = 1e-11
# A change below this share of the typical size is none.
STILL = 1e-13


@dataclass(frozen=True)
class OperatingPoint:
    """States, inputs and outputs by name in the model's units; ``rates`` of the states, by name, in their unit per second.

    ``equilibrium``: every balance is met (dry friction at standstill holds up to its static level). ``moving``: positions that
    move at a constant rate while everything else stays (steady motion). ``left``: what is left of each balance that is not met,
    by name, in its unit. ``notes`` say all this in words.
    """

    states: Mapping[str, float]
    inputs: Mapping[str, float]
    outputs: Mapping[str, float]
    rates: Mapping[str, float]
    equilibrium: bool
    moving: tuple[str, ...] = ()
    left: Mapping[str, float] | None = None
    notes: tuple[str, ...] = ()

    @property
    def z(self) -> np.ndarray:
        """States and inputs (nx + nu,) as one array."""
        return np.array([*self.states.values(), *self.inputs.values()])


def find_operating_point(model: Model, at: Mapping[str, float] | None = None) -> OperatingPoint:
    """The equilibrium of ``model`` that has the states and inputs named in ``at``, in the model's units.

    What ``at`` does not name is solved for: the other states; and, where states are given, the other inputs, which are zero
    otherwise. Where the equations leave something open (a piston may rest anywhere) it stays at its declared start. If no
    equilibrium exists and only positions move, it is a steady motion. With every state and input given the point is taken as it is,
    equilibrium or not.

    Raises ModelError for an unknown name, with the nearest ones, and where there is no equilibrium, with what is left of which
    balance.
    """
    return solve_operating_point(ModelFunctions(model), np.array(list(model.values.values())), at)


def solve_operating_point(
    equations: ModelFunctions, p: np.ndarray, at: Mapping[str, float] | None = None
) -> OperatingPoint:
    """`find_operating_point` of a model whose ``equations`` are made already, at the constants ``p`` (np,)."""
    given = _checked(equations, at or {})
    z = equations.start(p)
    known = np.isin(equations.names, list(given))
    z[known] = [given[name] for name in equations.names if name in given]
    if not known[: equations.nx].any():
        known[equations.nx :] = True
    known[: equations.nx] |= ~equations.rated
    if known.all():
        return _described(equations, _settled(equations, z, p, given), p, moving=())
    every = [k for k in range(equations.nx) if equations.rated[k]]
    held = [k for k in every if k not in equations.bodies]  # dry friction may hold what is left of the others
    steady = [k for k in every if k not in equations.kinematic]
    in_place = known | np.isin(np.arange(len(z)), equations.kinematic)  # a moving position is passed where it starts
    attempts = ((every, every, known), (held, every, known), (steady, steady, in_place), (steady, steady, known))
    for rows, met, kept in attempts:
        found = _settled(equations, _solved(equations, z, p, ~kept, rows, met), p, given)
        if all(left.met for left in _of_rows(equations, found, p, met)):
            rates = equations.rates(found, p, equations.direction(found))
            moving = [k for k in every if k not in met and rates[k]]
            if all(_matters_not(equations, found, p, k) or _speed_given(equations, k, given) for k in moving):
                return _described(equations, found, p, moving)
    raise ModelError(_nowhere(equations, z, p, known, given, every))


def _matters_not(equations: ModelFunctions, z: np.ndarray, p: np.ndarray, k: int) -> bool:
    """Whether no rate depends on the position ``k`` where it is: then everything else can stay while it moves."""
    moves = np.abs(equations.slopes(z, p, equations.direction(z)) * equations.sizes(z, p))
    return bool(np.all(moves[:, k] <= 1e-9 * moves.sum(axis=1)))


def _speed_given(equations: ModelFunctions, k: int, given: Mapping[str, float]) -> bool:
    """Whether the rate of the position ``k`` was asked for: then it is a moment of a motion that is meant."""
    return equations.system.rhs[k].name() in given


def _checked(equations: ModelFunctions, at: Mapping[str, float]) -> dict[str, float]:
    """``at`` as numbers; refuses unknown names and values that are not finite, all in one message."""
    problems = []
    for name, value in at.items():
        if name in equations.model.values:
            problems.append(f"{name!r} is a constant; set it with model.start({name}=...)")
        elif name not in equations.names:
            problems.append(f"no state or input {name!r}; {nearest(name, equations.names)}")
        elif not isinstance(value, int | float | np.number) or not np.isfinite(value):
            problems.append(f"{name} = {value!r} is not a finite number; give it in the model's unit")
    if problems:
        raise ModelError(f"operating point of {equations.model.title}: {'; '.join(problems)}")
    return {name: float(value) for name, value in at.items()}


def _solved(
    equations: ModelFunctions, z: np.ndarray, p: np.ndarray, free: np.ndarray, rows: Sequence[int], met: Sequence[int]
) -> np.ndarray:
    """The nearest point to ``z`` that solves ``rows`` and meets the balances in ``met``, or the best that was found."""
    if not equations.rates(z, p, equations.direction(z))[rows].any():
        return z
    generator = np.random.default_rng(0)
    sizes, best, least = equations.sizes(z, p), z, np.inf
    for attempt in range(RESTARTS):
        begin = z.copy()
        if attempt:  # a slope may vanish where the search starts: a valve that is just shut
            reach = np.where(z == 0, 10.0 ** (attempt % 5), 0.1) * sizes
            begin[free] += (reach * generator.standard_normal(len(z)))[free]
        found = _newton(equations, begin, p, free, rows)
        found = _newton(equations, found, p, free, rows)  # now with friction against the motion that was found
        unmet = [left for left in _of_rows(equations, found, p, met) if not left.met]
        if not unmet:
            return _nearer(equations, z, p, free, rows, met, found) if attempt else _snapped(found, z, sizes)
        excess = sum(abs(left.value) / max(left.tolerance, 1e-300) for left in unmet)
        if excess < least:
            best, least = found, excess
    return best


def _newton(
    equations: ModelFunctions, z: np.ndarray, p: np.ndarray, free: np.ndarray, rows: Sequence[int]
) -> np.ndarray:
    """Gauss-Newton steps of least length, halved until they help, within the bounds of the states."""
    begin, direction = z, equations.direction(z)
    sizes = equations.sizes(z, p)[free]
    low, high = np.full(len(z), -np.inf), np.full(len(z), np.inf)
    for k, state in enumerate(equations.model.all_states):
        low[k], high[k] = state.bounds
    for _ in range(NEWTON):
        residual = equations.rates(z, p, direction)[rows]
        slopes = equations.slopes(z, p, direction)[np.ix_(np.asarray(rows), np.flatnonzero(free))] * sizes
        if not (np.isfinite(residual).all() and np.isfinite(slopes).all()):
            break
        steep = np.abs(slopes).sum(axis=1)
        scale = 1 / np.where(steep > 0, steep, 1.0)
        step = -np.linalg.lstsq(scale[:, None] * slopes, scale * residual, rcond=FLAT)[0] * sizes
        now, share = np.linalg.norm(scale * residual), 1.0
        for _ in range(HALVINGS):
            trial = z.copy()
            trial[free] = np.clip((z[free] + share * step), low[free], high[free])
            after = np.linalg.norm(scale * equations.rates(trial, p, direction)[rows])
            if after < now:
                break
            share /= 2
        else:
            break
        z = trial
    return _snapped(z, begin, equations.sizes(z, p))


def _snapped(z: np.ndarray, begin: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """``z`` without rounding errors, which are neither a move nor sliding."""
    return np.where(np.abs(z - begin) > STILL * sizes, z, begin)


def _nearer(
    equations: ModelFunctions, z: np.ndarray, p: np.ndarray, free: np.ndarray, rows: Sequence[int], met: Sequence[int], found: np.ndarray
) -> np.ndarray:  # fmt: skip
    """The solution next to the states of ``z`` with the inputs of ``found``, if there is one; else ``found``."""
    begin = np.concatenate([z[: equations.nx], found[equations.nx :]])
    again = _newton(equations, begin, p, free, rows)
    good = all(left.met for left in _of_rows(equations, again, p, met))
    return _snapped(again if good else found, z, equations.sizes(z, p))


def _settled(equations: ModelFunctions, z: np.ndarray, p: np.ndarray, given: Mapping[str, float]) -> np.ndarray:
    """``z`` with the states that are set after each step as that sets them, unless they are given."""
    kept = np.isin(equations.names, list(given))
    return np.where(kept, z, equations.updated(z, p))


def _of_rows(equations: ModelFunctions, z: np.ndarray, p: np.ndarray, rows: Sequence[int]) -> list[BalanceResidual]:
    states = {equations.system.state_names[k] for k in rows}
    return [left for left in equations.left(z, p) if left.state in states]


def _described(equations: ModelFunctions, z: np.ndarray, p: np.ndarray, moving: Sequence[int]) -> OperatingPoint:
    names, nx = equations.names, equations.nx
    rates = equations.rates(z, p, equations.direction(z))
    for k, (push, static) in equations.holding(z, p).items():
        rates[k] = 0.0 if abs(push) <= static else rates[k]
    unmet = [left for left in equations.left(z, p) if not left.met and names.index(left.state) not in moving]
    notes = []
    if unmet:
        short = ", ".join(f"{left.balance} by {_amount(left.value, left.unit)}" for left in unmet)
        notes.append(
            f"{format_signals(names, z, equations.units)} is no equilibrium, out of balance: {short}; the linear model holds for deviations"
            " from the motion that goes through it"
        )
    for k in moving:
        speed = _amount(rates[k], f"({equations.units[k]})/s")
        rest = "everything else stays" if _matters_not(equations, z, p, k) else "and the rest only for this moment"
        notes.append(f"no equilibrium but a steady motion: {names[k]} moves at {speed}, {rest}")
    return OperatingPoint(
        dict(zip(names[:nx], map(float, z[:nx]), strict=True)),
        dict(zip(names[nx:], map(float, z[nx:]), strict=True)),
        {o.name: float(y) for o, y in zip(equations.model.outputs, equations.outputs(z, p), strict=True)},
        dict(zip(names[:nx], map(float, rates), strict=True)),
        not unmet and not moving,
        tuple(names[k] for k in moving),
        {left.balance: left.value for left in unmet},
        tuple(notes),
    )


def _nowhere(
    equations: ModelFunctions, z: np.ndarray, p: np.ndarray, known: np.ndarray, given: Mapping[str, float], rows: Sequence[int]
) -> str:  # fmt: skip
    """The message where no equilibrium was found: what is given, what is left of which balance, what to do."""
    for k in sorted(rows, key=equations.kinematic.__contains__):  # one balance alone may be what cannot be met
        others = [row for row in rows if row != k]
        best = _solved(equations, z, p, ~known, others, others)
        if all(left.met for left in _of_rows(equations, best, p, others)):
            break
    else:
        best = _solved(equations, z, p, ~known, rows, rows)
    unmet = [left for left in _of_rows(equations, best, p, rows) if not left.met]
    units = dict(zip(equations.names, equations.units, strict=True))
    said = format_signals(list(given), list(given.values()), [units[n] for n in given]) or "every input at zero"
    short = ", ".join(f"{left.balance} by {_amount(left.value, left.unit)}" for left in unmet)
    return (
        f"{equations.model.title} has no equilibrium with {said}, out of balance: {short}; give fewer of the states and"
        f" inputs, or all of them ({', '.join(equations.names)}) to linearise there all the same"
    )


def _amount(value: float, unit: str) -> str:
    return f"{value:.4g} {format_unit(unit)}".rstrip()
