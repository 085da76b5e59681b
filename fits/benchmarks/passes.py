"""One pass over a chain of masses on springs by other programs: cost, gradient and Gauss-Newton matrix along every free constant.

Each ``prepare(task) -> run`` builds and compiles what it needs; ``run()`` gives ``r'r``, ``J'r`` and ``J'J`` with ``r = y - model``. They
are the chain of `fits/benchmarks/chains.py` with springs that harden, written anew in each program's own way.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np

from fits.benchmarks.chains import HARDENING, STEP

Sums = tuple[float, np.ndarray, np.ndarray]


class Pass(NamedTuple):
    """What a pass starts from: stiffnesses (n,) and damping, the force of each sample (rows,), the measured positions (rows, n)."""

    stiffness: np.ndarray
    damping: float
    force: np.ndarray
    measured: np.ndarray
    substeps: int
    """Steps of RK4 in a sampling interval."""


def prepare_numba(task: Pass) -> Callable[[], Sums]:
    """RK4 of the equations and of their variations, written by hand for this chain; the Jacobian is kept, and multiplied by BLAS."""
    import numba

    n, h, g = len(task.stiffness), STEP / task.substeps, HARDENING

    @numba.njit(fastmath=True)
    def rate(s, k, c, force, r):
        """Rates ``r`` of the state ``s`` (2 n, 1 + n + 1): positions, then speeds; each row the value, then its tangents."""
        n, columns = len(s) // 2, s.shape[1]
        for i in range(n):
            for j in range(columns):
                r[i, j], r[n + i, j] = s[n + i, j], -c * s[n + i, j]
            r[n + i, columns - 1] -= s[n + i, 0]
        r[2 * n - 1, 0] += force
        for i in range(n):
            e = s[i, 0] - (s[i - 1, 0] if i else 0.0)
            pull, slope = e * (1 + g * e * e), k[i] * (1 + 3 * g * e * e)
            r[n + i, 0] -= k[i] * pull
            r[n + i, 1 + i] -= pull
            if i:
                r[n + i - 1, 0] += k[i] * pull
                r[n + i - 1, 1 + i] += pull
                for j in range(1, columns):
                    change = slope * (s[i, j] - s[i - 1, j])
                    r[n + i, j] -= change
                    r[n + i - 1, j] += change
            else:
                for j in range(1, columns):
                    r[n, j] -= slope * s[0, j]

    @numba.njit(fastmath=True)
    def move(a, b, share, target):
        """target = a + share b"""
        for i in range(a.shape[0]):
            for j in range(a.shape[1]):
                target[i, j] = a[i, j] + share * b[i, j]

    @numba.njit(fastmath=True)
    def run(k, c, force, measured, substeps):
        rows, n = measured.shape
        s = np.zeros((2 * n, n + 2))
        stage, total, r = s.copy(), s.copy(), s.copy()
        residual, jacobian = np.empty((rows, n)), np.empty((rows, n, n + 1))
        for row in range(rows):
            for i in range(n):
                residual[row, i] = measured[row, i] - s[i, 0]
                for j in range(n + 1):
                    jacobian[row, i, j] = s[i, 1 + j]
            for _ in range(substeps):
                rate(s, k, c, force[row], r)
                move(s, r, h / 6, total)
                for share, ahead in ((h / 3, h / 2), (h / 3, h / 2), (h / 6, h)):
                    move(s, r, ahead, stage)
                    rate(stage, k, c, force[row], r)
                    move(total, r, share, total)
                s, total = total, s
        return residual.ravel(), jacobian.reshape(rows * n, n + 1)

    def sums() -> Sums:
        r, slopes = run(task.stiffness, task.damping, task.force, task.measured, task.substeps)
        return float(r @ r), -(slopes.T @ r), slopes.T @ slopes

    assert n == task.measured.shape[1]
    return sums


def prepare_diffrax(task: Pass) -> Callable[[], Sums]:
    """One step of ``diffrax.Tsit5`` (six stages) in a sampling interval, differentiated forwards as ``optimistix`` does it, compiled."""
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    n, solver = len(task.stiffness), diffrax.Tsit5(scan_kind="lax")
    force, measured = jnp.asarray(task.force), jnp.asarray(task.measured)

    def field(_, state, known):
        x, v = state
        k, c, push = known
        e = jnp.diff(x, prepend=0.0)
        pull = k * e * (1 + HARDENING * e**2)
        return v, jnp.append(pull[1:], push) - pull - c * v

    term = diffrax.ODETerm(field)

    def residual(z):
        def sample(state, held):
            known = z[:n], z[n], held
            memory = solver.init(term, 0.0, STEP, state, known)
            following, *_ = solver.step(term, 0.0, STEP, state, known, memory, made_jump=False)
            return following, state[0]

        start = jnp.zeros(n), jnp.zeros(n)
        return (measured - jax.lax.scan(sample, start, force)[1]).ravel()

    @jax.jit
    def run(z):
        r, slopes = residual(z), jax.jacfwd(residual)(z)
        return r @ r, slopes.T @ r, slopes.T @ slopes

    z = jnp.append(jnp.asarray(task.stiffness), task.damping)

    def sums() -> Sums:
        cost, gradient, matrix = (np.asarray(found) for found in run(z))
        return float(cost), gradient, matrix

    return sums


def prepare_casadi(task: Pass) -> Callable[[], Sums]:
    """``mapaccum`` of an RK4 step and ``jacobian`` of the residual, in CasADi's virtual machine."""
    import casadi as ca

    n, rows, h = len(task.stiffness), len(task.force), STEP / task.substeps
    state, push, z = ca.SX.sym("state", 2 * n), ca.SX.sym("push"), ca.SX.sym("z", n + 1)

    def rate(s):
        x, v = s[:n], s[n:]
        e = x - ca.vertcat(0, x[:-1])
        pull = z[:n] * e * (1 + HARDENING * e**2)
        return ca.vertcat(v, ca.vertcat(pull[1:], push) - pull - z[n] * v)

    following = state
    for _ in range(task.substeps):
        k1 = rate(following)
        k2 = rate(following + h / 2 * k1)
        k3 = rate(following + h / 2 * k2)
        following += h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(following + h * k3))
    sample = ca.Function("sample", [state, push, z], [following])
    constants = ca.MX.sym("z", n + 1)
    states = sample.mapaccum("all", rows - 1)(
        ca.DM.zeros(2 * n), ca.DM(task.force[None, :-1]), ca.repmat(constants, 1, rows - 1)
    )
    positions = ca.horzcat(ca.DM.zeros(n), states[:n, :])
    residual = ca.vec(ca.DM(task.measured.T) - positions)
    slopes = ca.jacobian(residual, constants)
    run = ca.Function("run", [constants], [ca.sumsqr(residual), slopes.T @ residual, slopes.T @ slopes])
    values = np.append(task.stiffness, task.damping)

    def sums() -> Sums:
        cost, gradient, matrix = (found.full() for found in run(values))
        return float(cost), gradient.ravel(), matrix

    return sums


class Program(NamedTuple):
    """Another program: how it is prepared, the packages it needs, and how far its sums may be off by its method."""

    prepare: Callable[[Pass], Callable[[], Sums]]
    packages: tuple[str, ...]
    tolerance: float


PROGRAMS: Mapping[str, Program] = {
    "numba, by hand": Program(prepare_numba, ("numba",), 1e-8),
    "diffrax": Program(prepare_diffrax, ("diffrax", "jax"), 1e-2),
    "CasADi": Program(prepare_casadi, ("casadi",), 1e-8),
}

# Seconds of a pass, and of its preparation, beyond which larger chains are left to the others.
LONGEST_PASS, LONGEST_PREPARATION = 2.0, 20.0
REPEATS = 5


def measure_programs(
    sizes: tuple[int, ...], ours: Callable[[Pass], Callable[[], Sums]], begin: Callable[[int], Pass]
) -> dict[str, Any]:
    """Milliseconds of processor time of a pass by size for ``ours`` and each program that is installed, and their versions."""
    passes: dict[str, dict[int, float]] = {}
    versions: dict[str, str] = {}
    left_out: set[str] = set()
    for bodies in sizes:
        task = begin(bodies)
        run = ours(task)
        expected = run()
        passes.setdefault("greybox", {})[bodies] = 1e3 * _take_least(run)
        for name, program in PROGRAMS.items():
            if name in left_out:
                continue
            began = time.process_time()
            try:
                run = program.prepare(task)
            except ImportError:
                left_out.add(name)
                continue
            sums = run()
            preparation = time.process_time() - began
            for found, wanted in zip(sums, expected, strict=True):
                np.testing.assert_allclose(found, wanted, rtol=0, atol=program.tolerance * np.abs(wanted).max())
            seconds = _take_least(run)
            passes.setdefault(name, {})[bodies] = 1e3 * seconds
            versions |= {package: version(package) for package in program.packages}
            if seconds > LONGEST_PASS or preparation > LONGEST_PREPARATION:
                left_out.add(name)
            print(name, bodies, f"prepared in {preparation:.1f} s, {1e3 * seconds:.2f} ms", flush=True)
    return {"passes": passes, "versions": versions}


def _take_least(run: Callable[[], Any]) -> float:
    """Seconds of processor time of one call, the least of some."""
    times = []
    for _ in range(REPEATS):
        began = time.process_time()
        run()
        times.append(time.process_time() - began)
    return min(times)
