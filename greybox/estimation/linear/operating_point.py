"""The operating point: given values are kept, and the others are solved for so that every balance holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from greybox.base import Finding, ModelError, Severity, decompose_columns, format_unit, nearest, numerics
from greybox.estimation.linear.exported_model import ExportFinding, format_signals
from greybox.model import Input, Model, State
from greybox.model.effect import InputDelay
from greybox.model.expressions.graph import Switches
from greybox.simulation.integrators.step import call_function

# The equations of a model as numbers at a point: rates, outputs, what each balance lacks, and slopes on either side.


@dataclass(frozen=True)
class BalanceResidual:
    """What is left of a balance: ``value`` in ``unit``, and the largest residual that counts as zero."""

    balance: str
    unit: str
    state: str
    value: float
    tolerance: float

    @property
    def met(self) -> bool:
        """Whether it counts as zero."""
        return abs(self.value) <= self.tolerance


class ModelFunctions:
    """Functions of ``z = [x; u]`` (nx + nu,) and ``p`` (np,) for one model; made once, evaluated at many points."""

    def __init__(self, model: Model) -> None:
        s = model.system
        self.model, self.system = model, s
        self.nx, self.nu = s.x.numel(), s.u.numel()
        self.z = ca.vertcat(s.x, s.u)
        self.signals: tuple[State | Input, ...] = (*model.all_states, *model.inputs)
        self.names = [signal.name for signal in self.signals]
        self.units = [signal.unit for signal in self.signals]
        self.bodies = sorted({d.state for d in s.dry})
        self._rates = ca.Function("rates", [self.z, s.p, s.direction], [ca.densify(s.rhs)])
        self._slopes = ca.Function("slopes", [self.z, s.p, s.direction], [ca.densify(ca.jacobian(s.rhs, self.z))])
        self._outputs = ca.Function("outputs", [self.z, s.p], [ca.densify(s.outputs)])
        amounts = ca.SX.zeros(self.nx)
        for balance in s.balances:
            row = s.state_names.index(balance.state)
            amounts[row] = sum((ca.fabs(term) for term in balance.terms.values()), ca.SX(0))
        self._amounts = ca.Function("amounts", [self.z, s.p], [ca.densify(amounts), ca.densify(s.storages)])
        static = ca.SX.zeros(self.nx)
        for d in s.dry:
            static[d.state] += ca.substitute(d.static, s.x[d.state], 0)
        self._static = ca.Function("static", [self.z, s.p], [ca.densify(static)])
        self._started: tuple[bytes, np.ndarray] | None = None

    @cached_property
    def kinematic(self) -> tuple[int, ...]:
        """Rows whose rate is another state as it is: positions."""
        rows = [self.system.rhs[k] for k in range(self.nx)]
        return tuple(k for k, r in enumerate(rows) if r.is_symbolic() and r.name() in self.system.state_names)

    @cached_property
    def rated(self) -> np.ndarray:
        """Which states have a rate (nx,), true or false; the others are set after each step."""
        rated = np.ones(self.nx, bool)
        rated[[update.state for update in self.system.updates]] = False
        return rated

    def start(self, p: np.ndarray) -> np.ndarray:
        """The states as declared, inputs at zero (nx + nu,)."""
        # What asks for typical sizes asks for them several times at the same parameters.
        key = p.tobytes()
        if self._started is None or self._started[0] != key:
            x = np.asarray(self.system.start_function(p)[0]).ravel()
            self._started = key, np.concatenate([x, np.zeros(self.nu)])
        return self._started[1].copy()

    def sizes(self, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Typical sizes of states and inputs (nx + nu,)."""
        start = np.abs(self.start(p))
        # As declared where that is not zero: a variable at zero has a size all the same.
        return np.maximum(np.abs(z), np.where(start > 0, start, numerics.SMALLEST_TYPICAL_SIZE))

    def direction(self, z: np.ndarray) -> np.ndarray:
        """Sign of motion of each dry friction at ``z``, 0 at standstill."""
        return np.array([np.sign(z[d.state]) for d in self.system.dry])

    def rates(self, z: np.ndarray, p: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """``dx/dt`` (nx,), dry friction acting against ``direction``."""
        return call_function(self._rates, z, p, direction)[0].ravel()

    def slopes(self, z: np.ndarray, p: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """``d rates / d z`` (nx, nx + nu) as differentiation gives it, kinks or not."""
        return call_function(self._slopes, z, p, direction)[0]

    def outputs(self, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """``y`` (ny,)."""
        return call_function(self._outputs, z, p)[0].ravel()

    def updated(self, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """``z`` with the states that are set after each step as that sets them."""
        after = z.copy()
        for update, value in zip(self.system.updates, self._updates(z, p)[0].full().ravel(), strict=True):
            after[update.state] = value
        return after

    def update_slopes(self, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Slopes of what each of these states is set to (number of updates, nx + nu)."""
        return self._updates(z, p)[1].full()

    def balance_residuals(self, z: np.ndarray, p: np.ndarray) -> list[BalanceResidual]:
        """What is left of each balance at ``z``; dry friction at standstill takes up to its static level."""
        # Friction acts against the motion; at standstill it takes up what is left of the balance.
        direction = self.direction(z)
        rates = self.rates(z, p, direction)
        amounts, storages = (v.ravel() for v in call_function(self._amounts, z, p))
        moves = np.abs(self.slopes(z, p, direction) * self.sizes(z, p)).sum(axis=1)
        static = call_function(self._static, z, p)[0].ravel()
        residuals = []
        for balance in self.system.balances:
            k = self.system.state_names.index(balance.state)
            # At standstill friction takes up any push to its static level.
            held = static[k] if k in self.bodies and z[k] == 0 else 0.0
            # Share of the terms that cancel, of what a typical move changes, and what dry friction may hold.
            tolerance = (
                numerics.BALANCE_MET * amounts[k] + numerics.BALANCE_MET_OF_MOVE * moves[k] * abs(storages[k]) + held
            )
            residuals.append(
                BalanceResidual(
                    balance.name, balance.unit, balance.state, float(rates[k] * storages[k]), float(tolerance)
                )
            )
        return residuals

    def seconds(self, delay: InputDelay, p: np.ndarray) -> float:
        """A delay of an input in seconds."""
        return float(ca.Function("seconds", [self.system.p], [delay.seconds])(p))

    def holding(self, z: np.ndarray, p: np.ndarray) -> Mapping[int, tuple[float, float]]:
        """For each body at standstill: the push that dry friction holds, and the most it can hold, in the balance's unit."""
        if not self.bodies:
            return {}
        rates, static = self.rates(z, p, 0 * self.direction(z)), call_function(self._static, z, p)[0].ravel()
        storages = call_function(self._amounts, z, p)[1].ravel()
        return {k: (float(rates[k] * storages[k]), float(static[k])) for k in self.bodies if z[k] == 0}

    @cached_property
    def _updates(self) -> ca.Function:
        values = ca.vertcat(*[update.value for update in self.system.updates], ca.SX(0, 1))
        return ca.Function(
            "updates", [self.z, self.system.p], [ca.densify(values), ca.densify(ca.jacobian(values, self.z))]
        )

    @cached_property
    def _switches(self) -> dict[tuple[float, ...], Switches]:
        return {}

    def switches(self, direction: np.ndarray) -> Switches:
        """The switches in rates and outputs with dry friction acting against ``direction``."""
        key = tuple(map(float, direction))
        if key not in self._switches:
            s = self.system
            fixed = ca.substitute(s.rhs, s.direction, ca.DM(direction)) if len(direction) else s.rhs
            self._switches[key] = Switches(ca.vertcat(fixed, s.outputs), self.z, [s.p])
        return self._switches[key]


@dataclass(frozen=True)
class OperatingPoint:
    """States, inputs and outputs at which a model is linearised.

    Attributes
    ----------
    states, inputs, outputs
        Values by name, in the model's units.
    rates
        Rate of each state, in its unit per second.
    equilibrium
        Every balance is met (dry friction at standstill holds up to its static level).
    moving
        Positions that move at a constant rate while everything else stays (steady motion).
    imbalance
        Residual of each balance that is not met, by name, in its unit.
    findings
        What to know of the point.
    """

    states: Mapping[str, float]
    inputs: Mapping[str, float]
    outputs: Mapping[str, float]
    rates: Mapping[str, float]
    equilibrium: bool
    moving: tuple[str, ...] = ()
    imbalance: Mapping[str, float] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    @property
    def z(self) -> np.ndarray:
        """States and inputs (nx + nu,) as one array."""
        return np.array([*self.states.values(), *self.inputs.values()])


def find_operating_point(model: Model, at: Mapping[str, float] | None = None) -> OperatingPoint:
    """Find the equilibrium of a model that has given states and inputs.

    What ``at`` does not name is solved for: the other states; and, where states are given, the other inputs, which are zero
    otherwise. Where the equations leave something open (a piston may rest anywhere) it stays at its declared start. If no
    equilibrium exists and only positions move, it is a steady motion. With every state and input given the point is taken as it is,
    equilibrium or not.

    Parameters
    ----------
    model
        A model at its present values.
    at
        States and inputs by name, in the model's units.

    Returns
    -------
    OperatingPoint
        States, inputs, outputs and rates.

    Raises
    ------
    ModelError
        For an unknown name, with the nearest ones, and where there is no equilibrium, with the residuals of the balances.

    Examples
    --------
    >>> point = gb.export.find_operating_point(model, {"x": 1e-5})  # doctest: +SKIP
    >>> point.inputs["u"]  # doctest: +SKIP
    """
    return solve_operating_point(ModelFunctions(model), np.array(list(model.values.values())), at)


def solve_operating_point(
    functions: ModelFunctions, p: np.ndarray, at: Mapping[str, float] | None = None
) -> OperatingPoint:
    """`find_operating_point` of a model whose ``functions`` are made already, at the parameters ``p`` (np,)."""
    given = _check_point(functions, at or {})
    z = functions.start(p)
    known = np.isin(functions.names, list(given))
    z[known] = [given[name] for name in functions.names if name in given]
    # No state is asked for: then the inputs are as given, or zero, and the states follow.
    if not known[: functions.nx].any():
        known[functions.nx :] = True
    known[: functions.nx] |= ~functions.rated
    if known.all():
        return _describe_point(functions, _apply_updates(functions, z, p, given), p, moving=())
    rated = [k for k in range(functions.nx) if functions.rated[k]]
    without_bodies = [k for k in rated if k not in functions.bodies]  # dry friction may hold the residual of the others
    without_positions = [k for k in rated if k not in functions.kinematic]
    # A moving position is passed where it starts.
    positions_fixed = known | np.isin(np.arange(len(z)), functions.kinematic)
    # From what is wanted to what is left: all balances; those without friction, which holds the rest; then a steady
    # motion, its positions where they are, and at last free.
    attempts = (
        (rated, rated, known),
        (without_bodies, rated, known),
        (without_positions, without_positions, positions_fixed),
        (without_positions, without_positions, known),
    )
    for rows, to_meet, fixed in attempts:
        solution = _solve(functions, z, p, ~fixed, rows, to_meet)
        solution = _apply_updates(functions, solution, p, given)
        if all(residual.met for residual in _residuals_of_rows(functions, solution, p, to_meet)):
            rates = functions.rates(solution, p, functions.direction(solution))
            moving = [k for k in rated if k not in to_meet and rates[k]]
            # Positions may move if nothing depends on where they are, or on how far together (two masses on one shaft), or where their
            # speed was asked for: a moment of a motion is meant.
            alone = (
                _motion_is_steady(functions, solution, p, [k]) or functions.system.rhs[k].name() in given
                for k in moving
            )
            if all(alone) or _motion_is_steady(functions, solution, p, moving):
                return _describe_point(functions, solution, p, moving)
    raise ModelError(_no_equilibrium_message(functions, z, p, known, given, rated))


class PointMemory:
    """The operating point of a model at changing constants: solved for anew only where a constant that moves it has changed.

    Parameters
    ----------
    functions
        Those of the model.
    at
        As of `find_operating_point`.
    """

    def __init__(self, functions: ModelFunctions, at: Mapping[str, float] | None) -> None:
        self.functions, self.at = functions, at
        self._known: tuple[OperatingPoint, np.ndarray, np.ndarray] | None = None

    def find(self, p: np.ndarray) -> OperatingPoint:
        """The point at the parameters ``p`` (np,). Raises ModelError where there is none."""
        if self._known is not None:
            point, moving, values = self._known
            if np.array_equal(p[moving], values):
                return point
        point = solve_operating_point(self.functions, p, self.at)
        moving = _find_moving_parameters(self.functions, point)
        self._known = point, moving, p[moving].copy()
        return point


def _find_moving_parameters(functions: ModelFunctions, point: OperatingPoint) -> np.ndarray:
    """Numbers of the parameters on which an operating point depends: those that its equations still hold once its values stand in them."""
    system = functions.system
    everything = np.arange(system.p.numel())
    # Friction that holds, and a motion, depend on more than balances that are zero.
    if system.dry or not point.equilibrium:
        return everything
    sums = [sum((ca.SX(term) for term in b.terms.values()), ca.SX(0)) for b in system.balances]
    parts = ca.vertcat(*sums, *(update.value for update in system.updates), system.outputs)
    held = ca.substitute(parts, functions.z, ca.DM(point.z))
    depends = ca.which_depends(ca.vertcat(held, system.start), system.p, 1)
    return everything[np.array(depends, bool)]


def _motion_is_steady(functions: ModelFunctions, z: np.ndarray, p: np.ndarray, moving: Sequence[int]) -> bool:
    """Whether no rate changes while the positions ``moving`` go on at their rates: then everything else can stay."""
    which, direction, sizes = np.array(moving, int), functions.direction(z), functions.sizes(z, p)
    slopes, rates = functions.slopes(z, p, direction), functions.rates(z, p, direction)[which]
    # As far as takes one of them by its typical size.
    reach = rates / np.max(np.abs(rates) / sizes[which], initial=numerics.TINY)
    change = np.abs(slopes[:, which] @ reach)
    return bool(np.all(change <= numerics.FREE_POSITION * np.abs(slopes * sizes).sum(axis=1)))


def _check_point(functions: ModelFunctions, at: Mapping[str, float]) -> dict[str, float]:
    """``at`` as numbers; refuses unknown names, values that are not finite and states out of bounds, all in one message."""
    problems, limits = [], {state.name: state.bounds for state in functions.model.all_states}
    for name, value in at.items():
        if name in functions.model.values:
            problems.append(f"{name!r} is a parameter; set it with model.start({name}=...)")
        elif name not in functions.names:
            problems.append(f"no state or input {name!r}; {nearest(name, functions.names)}")
        elif not isinstance(value, int | float | np.number) or not np.isfinite(value):
            problems.append(f"{name} = {value!r} is not a finite number; give it in the model's unit")
        elif (bounds := limits.get(name)) and not bounds[0] <= value <= bounds[1]:
            low, high = bounds
            problems.append(
                f"{name} = {value:.6g} lies outside the bounds of the state, {low:g} to {high:g}; give a value within them"
            )
    if problems:
        raise ModelError(f"operating point of {functions.model.title}: {'; '.join(problems)}")
    return {name: float(value) for name, value in at.items()}


# Searches from random points, where the first one finds nothing.
OPERATING_POINT_RESTARTS = 25
# Standard deviation of a restart, relative to the typical size of a variable that is not zero at the start.
RESTART_REACH = 0.1
# A variable that is zero at the start is moved by 1 to ``10 ** (restart_decades - 1)`` times its typical size.
RESTART_DECADES = 5


def _solve(
    functions: ModelFunctions,
    z: np.ndarray,
    p: np.ndarray,
    free: np.ndarray,
    rows: Sequence[int],
    to_meet: Sequence[int],
) -> np.ndarray:
    """The nearest point to ``z`` that solves ``rows`` and meets the balances in ``to_meet``, or the best point on the way."""
    if not functions.rates(z, p, functions.direction(z))[rows].any():
        return z
    generator = np.random.default_rng(0)
    sizes, best, least = functions.sizes(z, p), z, np.inf
    for attempt in range(OPERATING_POINT_RESTARTS):
        start = z.copy()
        if attempt:  # a derivative may vanish where the search starts: a valve that is just shut
            reach = np.where(z == 0, 10.0 ** (attempt % RESTART_DECADES), RESTART_REACH) * sizes
            # From random points: a vanishing derivative, or a wrong side of a kink, holds a search that starts
            # there.
            start[free] += (reach * generator.standard_normal(len(z)))[free]
        solution = _run_newton(functions, start, p, free, rows)
        # Again, with friction against the motion of this solution.
        solution = _run_newton(functions, solution, p, free, rows)
        unmet = [r for r in _residuals_of_rows(functions, solution, p, to_meet) if not r.met]
        if not unmet:
            if attempt:  # the solution next to the states of z with these inputs, if there is one
                nearer = np.concatenate([z[: functions.nx], solution[functions.nx :]])
                nearer = _run_newton(functions, nearer, p, free, rows)
                met = all(r.met for r in _residuals_of_rows(functions, nearer, p, to_meet))
                solution = nearer if met else solution
            return _snap(solution, z, sizes)
        excess = sum(abs(r.value) / max(r.tolerance, numerics.TINY) for r in unmet)
        if excess < least:
            best, least = solution, excess
    return best


# Newton steps of one search.
OPERATING_POINT_ITERATIONS = 60
# How often a step is halved until it helps.
OPERATING_POINT_HALVINGS = 30


def _run_newton(
    functions: ModelFunctions, z: np.ndarray, p: np.ndarray, free: np.ndarray, rows: Sequence[int]
) -> np.ndarray:
    """Gauss-Newton steps of least length, halved until they help, within the bounds of the states."""
    start, direction = z, functions.direction(z)
    sizes = functions.sizes(z, p)[free]
    low, high = np.full(len(z), -np.inf), np.full(len(z), np.inf)
    for k, state in enumerate(functions.model.all_states):
        low[k], high[k] = state.bounds
    for _ in range(OPERATING_POINT_ITERATIONS):
        residual = functions.rates(z, p, direction)[rows]
        jacobian = functions.slopes(z, p, direction)[np.ix_(np.asarray(rows), np.flatnonzero(free))] * sizes
        if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
            break
        # Rows of like size: a residual in newtons must not hide one in metres per second.
        row_sums = np.abs(jacobian).sum(axis=1)
        scale = 1 / np.where(row_sums > 0, row_sums, 1.0)
        # A direction in which nothing changes is left as it is: a piston may rest anywhere.
        linear = decompose_columns(scale[:, None] * jacobian, scale=np.ones(jacobian.shape[1]))
        # The least-norm step J^+ r in units of the typical sizes.
        step = -linear.solve(scale * residual) * sizes
        before, share = np.linalg.norm(scale * residual), 1.0
        for _ in range(OPERATING_POINT_HALVINGS):
            trial = z.copy()
            trial[free] = np.clip((z[free] + share * step), low[free], high[free])
            after = np.linalg.norm(scale * functions.rates(trial, p, direction)[rows])
            if after < before:
                break
            share /= 2
        else:
            break
        z = trial
    return _snap(z, start, functions.sizes(z, p))


def _snap(z: np.ndarray, begin: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """``z`` without rounding errors, which are neither a move nor sliding."""
    return np.where(np.abs(z - begin) > numerics.NEGLIGIBLE_MOVE * sizes, z, begin)


def _apply_updates(functions: ModelFunctions, z: np.ndarray, p: np.ndarray, given: Mapping[str, float]) -> np.ndarray:
    """``z`` with the states that are set after each step as that sets them, unless they are given."""
    kept = np.isin(functions.names, list(given))
    return np.where(kept, z, functions.updated(z, p))


def _residuals_of_rows(
    functions: ModelFunctions, z: np.ndarray, p: np.ndarray, rows: Sequence[int]
) -> list[BalanceResidual]:
    states = {functions.system.state_names[k] for k in rows}
    return [residual for residual in functions.balance_residuals(z, p) if residual.state in states]


def _describe_point(functions: ModelFunctions, z: np.ndarray, p: np.ndarray, moving: Sequence[int]) -> OperatingPoint:
    names, nx = functions.names, functions.nx
    rates = functions.rates(z, p, functions.direction(z))
    for k, (push, static) in functions.holding(z, p).items():
        rates[k] = 0.0 if abs(push) <= static else rates[k]
    residuals = functions.balance_residuals(z, p)
    unmet = [r for r in residuals if not r.met and names.index(r.state) not in moving]
    findings = []
    if unmet:
        values: dict[str, Any] = {
            "point": format_signals(names, z, functions.units),
            "imbalance": [{"balance": r.balance, "value": r.value, "unit": format_unit(r.unit)} for r in unmet],
        }
        findings.append(Finding(ExportFinding.NO_EQUILIBRIUM, Severity.WARNING, values=values))
    is_steady = _motion_is_steady(functions, z, p, moving)
    for k in moving:
        values = {
            "speed": float(rates[k]),
            "unit": format_unit(f"({functions.units[k]})/s"),
            "others_rest": is_steady,
        }
        findings.append(Finding(ExportFinding.STEADY_MOTION, Severity.WARNING, names[k], values))
    return OperatingPoint(
        dict(zip(names[:nx], map(float, z[:nx]), strict=True)),
        dict(zip(names[nx:], map(float, z[nx:]), strict=True)),
        {o.name: float(y) for o, y in zip(functions.model.outputs, functions.outputs(z, p), strict=True)},
        dict(zip(names[:nx], map(float, rates), strict=True)),
        not unmet and not moving,
        tuple(names[k] for k in moving),
        {r.balance: r.value for r in unmet},
        tuple(findings),
    )


def _no_equilibrium_message(
    functions: ModelFunctions,
    z: np.ndarray,
    p: np.ndarray,
    known: np.ndarray,
    given: Mapping[str, float],
    rows: Sequence[int],
) -> str:
    """Why there is no equilibrium: what is given, the residuals of the balances, and what to do."""
    for k in sorted(rows, key=functions.kinematic.__contains__):  # a single balance may be what cannot be met
        others = [row for row in rows if row != k]
        best = _solve(functions, z, p, ~known, others, others)
        if all(r.met for r in _residuals_of_rows(functions, best, p, others)):
            break
    else:
        best = _solve(functions, z, p, ~known, rows, rows)
    unmet = [r for r in _residuals_of_rows(functions, best, p, rows) if not r.met]
    units = dict(zip(functions.names, functions.units, strict=True))
    point = format_signals(list(given), list(given.values()), [units[n] for n in given]) or "every input at zero"
    imbalance = ", ".join(f"{r.balance} by {r.value:.4g} {format_unit(r.unit)}".rstrip() for r in unmet)
    return (
        f"{functions.model.title} has no equilibrium with {point}, out of balance: {imbalance}; give fewer of the states and"
        f" inputs, or all of them ({', '.join(functions.names)}) to linearise there all the same"
    )
