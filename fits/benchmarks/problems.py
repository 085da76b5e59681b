"""The problems of the benchmark: model, record and a start about 40 % off. All records begin at rest, which is known.

- ``actuator``: the micro-motion actuator at 4 kHz, linear, three states; `B, K, Kf, La` from the displacement, noise 1 %.
- ``pneumatic``: a cylinder behind a proportional valve with the flow of ISO 6358, four states; six constants from the
  position alone, noise 0.2 mm, 200 Hz.
- ``positioning``: motor, ball screw and carriage with a smooth friction law (``tanh``), two states; four constants,
  noise 20 um, 1 kHz.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from greybox.data.experiment import Experiment
from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State
from greybox.simulation.integrators.runge_kutta import rk4
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record
from models.micro_actuator import micro_actuator


@dataclass(frozen=True)
class Case:
    """One problem: the true model, the factors of the wrong start, the record, noise (standard deviation of the only
    output), number of RK4 substeps a sample."""

    name: str
    truth: Model
    wrong: tuple[float, ...]
    experiment: Experiment
    noise: dict[str, float]
    substeps: int

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the constants that are fitted."""
        return tuple(q.name for q in self.truth.free_parameters)

    @cached_property
    def start(self) -> Model:
        """The model with its start values."""
        free = self.truth.free_parameters
        return self.truth.start(**{q.name: q.value * f for q, f in zip(free, self.wrong, strict=True)})

    @cached_property
    def step(self) -> Step:
        """The RK4 step that every peer takes."""
        return rk4(self.truth.system, self.substeps)


def actuator(rows: int = 4000) -> Case:
    """Held multisine from 5 to 800 Hz."""
    truth = micro_actuator.fix("M", "Ra", "Kv")
    truth = replace(truth, outputs=truth.outputs[:1])
    free = [q.name for q in truth.free_parameters]
    truth = truth.bound(**{name: (truth.values[name] / 5, truth.values[name] * 5) for name in free})
    u = _multisine(rows, 2.5e-4, 5.0, 800.0, 3.0, 1)
    return _case(
        "actuator" if rows == 4000 else "actuator_long", truth, (1.4, 0.75, 0.7, 1.4), u, 2.5e-4, 8, None, 0.01
    )


def pneumatic(rows: int = 10_001) -> Case:
    """Slow multisine on the valve with some steps."""
    time = np.arange(rows) * 5e-3
    u = _multisine(rows, 5e-3, 0.1, 8.0, 6.0, 2) + 2.0 * np.sign(np.sin(2.3 * time)) * (np.sin(0.31 * time) > 0)
    return _case("pneumatic", _cylinder(), (1.35, 0.65, 1.3, 0.6, 1.5, 1.4), u, 5e-3, 4, 2e-4, None)


def positioning(rows: int = 25_000) -> Case:
    """Multisine force with zero mean."""
    u = _multisine(rows, 1e-3, 0.3, 15.0, 4.0, 3)
    return _case("positioning", _carriage(), (1.4, 0.6, 0.65, 1.4), u, 1e-3, 1, 2e-5, None)


CASES = {"actuator": actuator, "pneumatic": pneumatic, "positioning": positioning}


def _case(
    name: str,
    truth: Model,
    wrong: tuple[float, ...],
    u: np.ndarray,
    period: float,
    substeps: int,
    noise: float | None,
    share: float | None,
) -> Case:
    """Simulate the truth by RK4 with four times the substeps and add noise: an amount, or a share of the signal.

    ``substeps`` are those that greybox chooses for RK4 (at most half a unit of |h lambda| each).
    """
    time = np.arange(len(u)) * period
    step = rk4(truth.system, 4 * substeps)
    p = np.array(list(truth.values.values()))
    empty = np.zeros((len(u), 1))
    record = Record(u[:, None], empty, np.full(len(u) - 1, period), np.zeros(len(u) - 1), np.array([period]))
    x0 = np.asarray(truth.system.start_function(p)[0]).ravel()
    y = make_kernel(step).simulate(record, p[None], p, x0)[0][:, 0]
    amount = share * float(np.std(y)) if noise is None else noise
    y = y + amount * np.random.default_rng(11).normal(size=len(y))
    output = truth.outputs[0].name
    experiment = Experiment(name, time, {truth.inputs[0].name: u}, {output: y})
    return Case(name, truth, wrong, experiment, {output: amount}, substeps)


def _multisine(rows: int, period: float, low: float, high: float, amplitude: float, seed: int) -> np.ndarray:
    """Forty tones of equal size and random phase between two frequencies (Hz)."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows) * period
    signal = np.zeros(rows)
    for f, phase in zip(np.geomspace(low, high, 40), rng.uniform(0, 2 * np.pi, 40), strict=True):
        signal += np.cos(2 * np.pi * f * time + phase)
    return amplitude * signal / np.abs(signal[: min(rows, 4000)]).max()


# --- plants ------------------------------------------------------------------------------------------------------


def _known(name: str, unit: str, value: float) -> Parameter:
    return Parameter(name, unit, value, fixed=True, source="benchmark")


def _sought(name: str, unit: str, value: float, low: float = 0.2, high: float = 5.0) -> Parameter:
    """A constant to be fitted, with physical bounds as multiples of its value."""
    return Parameter(name, unit, value, (low * value, high * value), source="benchmark")


def _subsonic(ratio, b):
    """ISO 6358: 1 below the critical pressure ratio ``b``, an ellipse above it."""
    return ca.sqrt(ca.fmax(1 - (ca.fmax(ratio - b, 0) / (1 - b)) ** 2, 1e-4))


def _flow(w, pressure, p):
    """Mass flow into a chamber: from the supply for ``w > 0``, to the room for ``w < 0``."""
    upstream = ca.if_else(w > 0, p.P_S, pressure)
    downstream = ca.if_else(w > 0, pressure, p.P_a)
    return p.C * p.rho_a * w / p.u_ref * upstream * _subsonic(downstream / upstream, p.b)


def _pneumatic_balances(x, u, p):
    w = u.u - p.sd * ca.tanh(u.u / p.sd)  # the spool's overlap, smooth
    volume_a, volume_b = p.V_h + p.A * x.s, p.V_h - p.A * x.s
    flow_a, flow_b = p.RT * _flow(w, x.p_a, p) / volume_a, p.RT * _flow(-w, x.p_b, p) / volume_b
    swept = p.A * x.v
    return [
        Balance("position", "m/s", 1, "s", velocity=x.v),
        Balance(
            "force",
            "N",
            p.M,
            "v",
            pressure=p.A * (x.p_a - x.p_b),
            viscous=-p.Fv * x.v,
            dry=-p.Fc * ca.tanh(x.v / p.vs),
            spring=-p.Ks * x.s,
        ),
        Balance("pressure_a", "Pa/s", 1, "p_a", flow=flow_a, motion=-x.p_a * swept / volume_a),
        Balance("pressure_b", "Pa/s", 1, "p_b", flow=flow_b, motion=x.p_b * swept / volume_b),
    ]


def _cylinder() -> Model:
    def half(p):
        return 0.6 * p.P_S

    return Model(
        "cylinder",
        [State("s", "m"), State("v", "m/s"), State("p_a", "Pa", half), State("p_b", "Pa", half)],
        [Input("u", "V")],
        [Output("s", "m")],
        [
            _sought("C", "m**3/(s*Pa)", 1.2e-9),
            Parameter("b", "1", 0.4, (0.2, 0.8), source="benchmark"),
            _sought("M", "kg", 3.0),
            _sought("Fv", "N*s/m", 90.0),
            _sought("Fc", "N", 25.0),
            _sought("sd", "V", 0.6),
            _known("A", "m**2", 11.56e-4),
            _known("V_h", "m**3", 4.2e-4),
            _known("P_S", "Pa", 8e5),
            _known("P_a", "Pa", 1.013e5),
            _known("rho_a", "kg/m**3", 1.185),
            _known("RT", "J/kg", 8.41e4),
            _known("u_ref", "V", 1.0),
            _known("vs", "m/s", 0.05),
            _known("Ks", "N/m", 1500.0),
        ],
        _pneumatic_balances,
    )


def _carriage_balances(x, u, p):
    return [
        Balance("position", "m/s", 1, "q", velocity=x.v),
        Balance(
            "force",
            "N",
            p.M,
            "v",
            motor=p.g * u.u,
            viscous=-p.Fv * x.v,
            dry=-p.Fc * ca.tanh(x.v / p.vs),
            spring=-p.Ks * x.q,
        ),
    ]


def _carriage() -> Model:
    return Model(
        "carriage",
        [State("q", "m"), State("v", "m/s")],
        [Input("u", "V")],
        [Output("q", "m")],
        [
            _sought("M", "kg", 95.0),
            _sought("Fv", "N*s/m", 203.5),
            _sought("Fc", "N", 20.4),
            _sought("Ks", "N/m", 900.0),
            _known("g", "N/V", 35.15065),
            _known("vs", "m/s", 0.01),
        ],
        _carriage_balances,
    )
