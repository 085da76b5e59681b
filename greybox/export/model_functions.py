"""The equations of a model as numbers at a point: rates, outputs, what each balance lacks, and slopes on either side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from greybox.expressions.switches import Switches
from greybox.model import Model
from greybox.model.effect_hooks import InputDelay
from greybox.model.signals import Input, State
from greybox.numerics import BALANCE_MET, BALANCE_MET_OF_MOVE, SMALLEST_TYPICAL_SIZE


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
        x = np.asarray(self.system.start_function(p)[0]).ravel()
        return np.concatenate([x, np.zeros(self.nu)])

    def sizes(self, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Typical sizes of states and inputs (nx + nu,)."""
        start = np.abs(self.start(p))
        return np.maximum(np.abs(z), np.where(start > 0, start, SMALLEST_TYPICAL_SIZE))

    def direction(self, z: np.ndarray) -> np.ndarray:
        """Sign of motion of each dry friction at ``z``, 0 at standstill."""
        return np.array([np.sign(z[d.state]) for d in self.system.dry])

    def rates(self, z: np.ndarray, p: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """``dx/dt`` (nx,), dry friction acting against ``direction``."""
        return self._rates(z, p, direction).full().ravel()

    def slopes(self, z: np.ndarray, p: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """``d rates / d z`` (nx, nx + nu) as differentiation gives it, kinks or not."""
        return self._slopes(z, p, direction).full()

    def outputs(self, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """``y`` (ny,)."""
        return self._outputs(z, p).full().ravel()

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
        direction = self.direction(z)
        rates = self.rates(z, p, direction)
        amounts, storages = (v.full().ravel() for v in self._amounts(z, p))
        moves = np.abs(self.slopes(z, p, direction) * self.sizes(z, p)).sum(axis=1)
        static = self._static(z, p).full().ravel()
        residuals = []
        for balance in self.system.balances:
            k = self.system.state_names.index(balance.state)
            held = static[k] if k in self.bodies and z[k] == 0 else 0.0
            tolerance = BALANCE_MET * amounts[k] + BALANCE_MET_OF_MOVE * moves[k] * abs(storages[k]) + held
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
        rates, static = self.rates(z, p, 0 * self.direction(z)), self._static(z, p).full().ravel()
        storages = self._amounts(z, p)[1].full().ravel()
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
