"""Chains of masses on springs: as many states, constants and outputs as are asked for.

The first body hangs on a wall, the last one is pushed with the force ``F``::

    x_i'   = v_i
    m v_i' = -k_i e_i (1 + g e_i^2) - c v_i + k_(i+1) e_(i+1) (1 + g e_(i+1)^2)      e_i = x_i - x_(i-1)

``n`` bodies have ``2 n`` states, ``n`` measured positions and ``n + 1`` free constants, the stiffnesses and the damping. Without ``g`` they
are linear.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

import greybox as gb

NOISE = 1e-5  # m, of each position
STEP = 0.005  # s
START = 0.03  # share by which start values are off, to either side; more of it and few bodies end in a local minimum
HARDENING = 100.0  # 1/m^2: springs are up to a tenth stiffer in these records; many times as much is chaos


def make_chain(bodies: int, *, hardening: bool = False) -> gb.Model:
    """The chain of so many ``bodies``, its springs linear or harder the longer they are."""

    def balances(x: Any, u: Any, p: Any) -> list[gb.Balance]:
        def pull(i: int) -> Any:
            """The force of spring ``i`` over its constant."""
            if i == bodies:
                return 0
            e = x[f"x{i}"] - (x[f"x{i - 1}"] if i else 0)
            return e * (1 + p.g * e**2) if hardening else e

        rows = []
        for i in range(bodies):
            terms = {"spring": -p[f"k{i}"] * pull(i), "damping": -p.c * x[f"v{i}"]}
            terms |= {"next": p[f"k{i + 1}"] * pull(i + 1)} if i + 1 < bodies else {"drive": u.F}
            rows.append(gb.Balance(f"position{i}", "m/s", 1, f"x{i}", velocity=x[f"v{i}"]))
            rows.append(gb.Balance(f"force{i}", "N", p.m, f"v{i}", **terms))
        return rows

    states = [gb.State(name, unit) for i in range(bodies) for name, unit in ((f"x{i}", "m"), (f"v{i}", "m/s"))]
    constants = [gb.Parameter(f"k{i}", "N/m", 1000.0 + 50 * i, (1, 1e6)) for i in range(bodies)]
    constants += [gb.Parameter("c", "N*s/m", 1.0, (1e-3, 1e3)), gb.Parameter("m", "kg", 1.0, (1e-3, 1e3))]
    constants += [gb.Parameter("g", "1/m**2", HARDENING, (1, 1e6))] if hardening else []
    outputs = [gb.Output(f"x{i}", "m") for i in range(bodies)]
    chain = gb.Model(f"chain{bodies}", states, [gb.Input("F", "N")], outputs, constants, balances)
    return chain.fix("m", *(["g"] if hardening else []))


class Trial(NamedTuple):
    """A fit that is about to begin: the true model, the model at its start values, the record and its noise."""

    truth: gb.Model
    model: gb.Model
    record: gb.Experiment
    noise: Mapping[str, float]

    def fit(self) -> gb.Fit:
        """The fit, from rest."""
        return gb.fit(self.model, self.record, noise=self.noise, options=gb.FitOptions(at_rest=True))

    def find_worst_error(self, fit: gb.Fit) -> float:
        """The largest relative error of a constant."""
        free = [p.name for p in self.truth.all_parameters if not p.fixed]
        return max(abs(fit.parameters[name].value / self.truth.values[name] - 1) for name in free)


def make_trial(bodies: int, rows: int = 1000, *, hardening: bool = False, seed: int = 0) -> Trial:
    """A record of a chain under random steps of the force, and start values that are off."""
    rng, chain = np.random.default_rng(seed), make_chain(bodies, hardening=hardening)
    noise = {output.name: NOISE for output in chain.outputs}
    force = np.repeat(rng.normal(0, 10, -(-rows // 10)), 10)[:rows]
    run = gb.simulate(chain, {"time": STEP * np.arange(rows), "F": force})
    record = run.record(noise, rng)
    free = [p.name for p in chain.all_parameters if not p.fixed]
    start = {name: chain.values[name] * (1 + START * rng.choice([-1, 1])) for name in free}
    return Trial(chain, chain.start(**start), record, noise)


def measure_seconds(trial: Trial) -> tuple[float, gb.Fit]:
    """Wall-clock seconds of one fit."""
    began = time.perf_counter()
    fit = trial.fit()
    return time.perf_counter() - began, fit
