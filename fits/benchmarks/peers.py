"""Other ways to fit the same problem: each ``prepare(case)`` gives ``solve() -> fitted values``, imports and compilation done before.

All start at the same values, take the same RK4 step, know the same bounds and see constants divided by their start values.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import casadi as ca
import numpy as np

from fits.benchmarks.problems import Case
from fits.benchmarks.rates import Mathematics, make_rate, make_rk4

Solve = Callable[[], np.ndarray]

COMPILE_SECONDS: dict[tuple[str, str], float] = {}
"""Wall time of the first call, compilation and one fit, of the peers that compile a whole fit: (peer, problem) -> s."""


class Arrays:
    """A case as arrays: parameters at the start, which are free and their bounds (over the start), input, output, first state."""

    def __init__(self, case: Case) -> None:
        model = case.start
        self.p = np.array(list(model.values.values()))
        names = list(model.values)
        self.which = np.array([names.index(n) for n in case.free])
        self.start = self.p[self.which]
        bounds = np.array([model.parameter(n).bounds for n in case.free])
        self.low, self.high = bounds[:, 0] / self.start, bounds[:, 1] / self.start
        self.u = case.experiment.inputs[model.inputs[0].name].copy()
        self.y = case.experiment.outputs[model.outputs[0].name].copy()
        self.noise = case.noise[model.outputs[0].name]
        self.h = float(case.experiment.intervals[0]) / case.substeps
        self.substeps = case.substeps
        self.x0 = np.asarray(model.system.start_function(self.p)[0]).ravel()

    def full(self, z: np.ndarray) -> np.ndarray:
        """All parameters for free ones at ``z`` times their start."""
        p = self.p.copy()
        p[self.which] = z * self.start
        return p


def casadi_single_shooting(case: Case) -> Solve:
    """The usual way: ``mapaccum`` of the step, ``jacobian`` of the residual, Gauss-Newton Hessian, IPOPT."""
    a = Arrays(case)
    advance, n = case.step.advance, len(a.u)
    x, u, q = ca.SX.sym("x", len(a.x0)), ca.SX.sym("u"), ca.SX.sym("q", len(a.p))
    following = x
    for _ in range(a.substeps):
        following = advance(following, u, u, q, a.h)
    sample = ca.Function("sample", [x, u, q], [following])
    z = ca.MX.sym("z", len(a.which))
    p = ca.MX(ca.DM(a.p))
    p[a.which.tolist()] = z * a.start
    states = ca.horzcat(ca.DM(a.x0), sample.mapaccum("all", n - 1)(a.x0, a.u[None, :-1], ca.repmat(p, 1, n - 1)))
    residual = (states[0, :].T - a.y) / a.noise
    jacobian = ca.jacobian(residual, z)
    factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("lam", 0)
    hessian = ca.Function("hessian", [z, ca.MX(0, 0), factor, multipliers], [factor * ca.triu(jacobian.T @ jacobian)])
    problem = {"x": z, "f": 0.5 * ca.sumsqr(residual)}
    quiet = {"print_level": 0, "sb": "yes", "tol": 1e-8}
    solver = ca.nlpsol("solver", "ipopt", problem, {"hess_lag": hessian, "print_time": False, "ipopt": quiet})
    return lambda: solver(x0=np.ones(len(a.which)), lbx=a.low, ubx=a.high)["x"].full().ravel() * a.start


def _numba_residual(case: Case) -> tuple[Arrays, Callable[[np.ndarray], np.ndarray]]:
    import math

    import numba

    a = Arrays(case)
    jit = numba.njit(inline="always")
    m = Mathematics(math.tanh, math.sqrt, jit(lambda a, b: a if a > b else b), jit(lambda c, a, b: a if c else b))
    advance = make_rk4(make_rate(case.name, m, jit), len(a.x0), jit)

    @numba.njit
    def run(x, u, p, h, substeps):
        y = np.empty(len(u))
        for k in range(len(u)):
            y[k] = x[0]
            for _ in range(substeps):
                x = advance(x, u[k], p, h)
        return y

    first = tuple(a.x0)
    return a, lambda z: (run(first, a.u, a.full(z), a.h, a.substeps) - a.y) / a.noise


def scipy_numba(case: Case) -> Solve:
    """``scipy.optimize.least_squares`` (trust region, finite differences) with a numba RK4."""
    from scipy.optimize import least_squares

    a, residual = _numba_residual(case)
    residual(np.ones(len(a.which)))
    return lambda: least_squares(residual, np.ones(len(a.which)), bounds=(a.low, a.high), x_scale="jac").x * a.start


def lmfit_numba(case: Case) -> Solve:
    """``lmfit`` (MINPACK's leastsq, finite differences, bounds by transformation) with a numba RK4."""
    import lmfit

    a, residual = _numba_residual(case)
    residual(np.ones(len(a.which)))
    start = lmfit.Parameters()
    for name, low, high in zip(case.free, a.low, a.high, strict=True):
        start.add(name, value=1.0, min=low, max=high)

    def solve() -> np.ndarray:
        result = lmfit.minimize(lambda q: residual(np.array([q[n].value for n in case.free])), start, method="leastsq")
        return np.array([result.params[n].value for n in case.free]) * a.start

    return solve


def jax_sysid(case: Case) -> Solve:
    """``jax-sysid``: automatic differentiation through a scan, L-BFGS-B, double precision; it compiles anew in every fit."""
    import jax
    import jax.numpy as jnp
    from jax_sysid.models import Model

    jax.config.update("jax_enable_x64", True)
    a = Arrays(case)
    m = Mathematics(jnp.tanh, jnp.sqrt, jnp.maximum, jnp.where)
    advance = make_rk4(make_rate(case.name, m), len(a.x0))
    size = np.where(a.x0 == 0, 1.0, np.abs(a.x0))
    which, start, fixed = jnp.array(a.which), jnp.array(a.start), jnp.array(a.p)

    @jax.jit
    def state(x, u, params):
        p = fixed.at[which].set(params[0] * start)
        values = tuple(x[k] * size[k] for k in range(len(size)))
        for _ in range(a.substeps):
            values = advance(values, u[0], p, a.h)
        return jnp.stack([v / s for v, s in zip(values, size, strict=True)])

    scale = np.std(a.y)

    @jax.jit
    def output(x, u, params):
        return jnp.array([x[0] * size[0] / scale])

    def solve() -> np.ndarray:
        model = Model(len(a.x0), 1, 1, state_fcn=state, output_fcn=output)
        model.init(params=[np.ones(len(a.which))], x0=a.x0 / size)
        model.loss(rho_x0=0.0, rho_th=0.0, train_x0=False)
        model.optimization(
            adam_epochs=0, lbfgs_epochs=2000, lbfgs_tol=1e-14, iprint=-1, params_min=[a.low], params_max=[a.high]
        )
        model.fit(a.y[:, None] / scale, a.u[:, None])
        return np.asarray(model.params[0]) * a.start

    return solve


def diffrax_optimistix(case: Case) -> Solve:
    """``diffrax`` steps (Tsitouras 5(4), the same substeps) in a scan, ``optimistix``'s Levenberg-Marquardt, all compiled once.

    Positive constants are fitted on a logarithmic scale, which keeps them within sense without bounds. Double precision.
    """
    import diffrax
    import jax
    import jax.numpy as jnp
    import optimistix

    jax.config.update("jax_enable_x64", True)
    a = Arrays(case)
    rate = make_rate(case.name, Mathematics(jnp.tanh, jnp.sqrt, jnp.maximum, jnp.where))
    size = np.where(a.x0 == 0, 1.0, np.abs(a.x0))
    which, start, fixed, u, y = (jnp.asarray(v) for v in (a.which, a.start, a.p, a.u, a.y))
    solver = diffrax.Tsit5(scan_kind="lax")  # Levenberg-Marquardt differentiates forward

    def field(_, x, known):
        return jnp.stack(rate(tuple(x[k] * size[k] for k in range(len(size))), known[0], known[1])) / size

    term = diffrax.ODETerm(field)

    def residual(z, _):
        p = fixed.at[which].set(jnp.exp(z) * start)

        def sample(x, held):
            following, known = x, (held, p)
            state = solver.init(term, 0.0, a.h, x, known)  # the input jumps at every sample
            for _ in range(a.substeps):
                following, _, _, state, _ = solver.step(term, 0.0, a.h, following, known, state, made_jump=False)
            return following, x[0]

        _, output = jax.lax.scan(sample, jnp.asarray(a.x0 / size), u)
        return (output * size[0] - y) / a.noise

    method = optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8)

    @jax.jit
    def search(z):
        return optimistix.least_squares(residual, method, z, max_steps=200, throw=False).value

    nothing = jnp.zeros(len(a.which))
    began = time.perf_counter()
    search(nothing).block_until_ready()
    COMPILE_SECONDS["diffrax_optimistix", case.name] = time.perf_counter() - began
    return lambda: np.exp(np.asarray(search(nothing).block_until_ready())) * a.start


class _DiffSL:
    """An expression in DiffSL's notation, written by the operators of Python."""

    def __init__(self, text: object) -> None:
        self.text = text.text if isinstance(text, _DiffSL) else f"({text!r})" if isinstance(text, float) else str(text)

    def __neg__(self):
        return _DiffSL(f"(-{self.text})")


def _join(operator: str, swapped: bool):
    def apply(a, b):
        left, right = (_DiffSL(v).text for v in ((b, a) if swapped else (a, b)))
        return _DiffSL(f"({left} {operator} {right})")

    return apply


for _name, _operator in (("add", "+"), ("sub", "-"), ("mul", "*"), ("truediv", "/")):
    setattr(_DiffSL, f"__{_name}__", _join(_operator, False))
    setattr(_DiffSL, f"__r{_name}__", _join(_operator, True))
_DiffSL.__gt__ = lambda a, b: _call_diffsl("heaviside", a - b)  # type: ignore[assignment]


def _call_diffsl(function: str, *arguments: object) -> _DiffSL:
    return _DiffSL(f"{function}({', '.join(_DiffSL(float(a) if isinstance(a, int) else a).text for a in arguments)})")


def _write_diffsl(case: Case, a: Arrays, size: np.ndarray) -> str:
    """The problem, time in samples; free parameters (over their start), held input and first state (over ``size``) are its inputs."""
    m = Mathematics(
        lambda v: _call_diffsl("tanh", v),
        lambda v: _call_diffsl("sqrt", v),
        lambda v, w: _call_diffsl("max", v, w),
        lambda condition, yes, no: condition * yes + (1.0 - condition) * no,
    )
    p = [float(v) for v in a.p]
    for j, k in enumerate(a.which):
        p[k] = _DiffSL(f"f{j}") * float(a.start[j])  # type: ignore[call-overload]
    x = tuple(_DiffSL(f"x{k}") * float(s) for k, s in enumerate(size))
    rate = [
        (_DiffSL(v) * float(a.h * a.substeps / s)).text
        for v, s in zip(make_rate(case.name, m)(x, _DiffSL("drive"), p), size, strict=True)
    ]
    names = [*(f"f{j}" for j in range(len(a.which))), "drive", *(f"s{k}" for k in range(len(size)))]
    return "\n".join(
        [
            "in_i { " + ", ".join(f"{name} = 1.0" for name in names) + " }",
            "u_i { " + ", ".join(f"x{k} = s{k}" for k in range(len(size))) + " }",
            "F_i { " + ", ".join(rate) + " }",
        ]
    )


def diffsol(case: Case) -> Solve:
    """``pydiffsol`` (Tsitouras 4(5), rtol 1e-6) with forward sensitivities, in ``scipy.optimize.least_squares``.

    The input jumps at every sample, so each sample is a solution of its own from the state before; its sensitivities to parameters and
    first state are chained.
    """
    import pydiffsol
    from scipy.optimize import least_squares

    a = Arrays(case)
    n, nx = len(a.which), len(a.x0)
    size = np.where(a.x0 == 0, 1.0, np.abs(a.x0))
    ode = pydiffsol.Ode(_write_diffsl(case, a, size), matrix_type=pydiffsol.nalgebra_dense)
    ode.ode_solver, ode.rtol, ode.atol, ode.h0 = pydiffsol.tsit45, 1e-6, 1e-9, 1.0 / a.substeps
    ends = np.array([1.0])
    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def run(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual and Jacobian, for the two functions that ``least_squares`` asks for."""
        if z.tobytes() not in known:
            known.clear()
            x, slopes = a.x0 / size, np.zeros((nx, n))
            y, jacobian = np.empty(len(a.u)), np.empty((len(a.u), n))
            inputs = np.concatenate([z, [0.0], x])
            for k, u in enumerate(a.u):
                y[k], jacobian[k] = x[0], slopes[0]
                inputs[n], inputs[n + 1 :] = u, x
                solution = ode.solve_fwd_sens(inputs, ends)
                x, along = solution.ys[:, -1], np.asarray(solution.sens)[:, :, -1]
                slopes = along[n + 1 :].T @ slopes + along[:n].T
            known[z.tobytes()] = (y * size[0] - a.y) / a.noise, jacobian * size[0] / a.noise
        return known[z.tobytes()]

    ode.solve_fwd_sens(np.concatenate([np.ones(n), [0.0], a.x0 / size]), ends)
    return lambda: (
        least_squares(lambda z: run(z)[0], np.ones(n), lambda z: run(z)[1], bounds=(a.low, a.high), x_scale="jac").x
        * a.start
    )


def solve_ivp_seconds(case: Case, samples: int = 200) -> float:
    """CPU seconds of one simulation by ``solve_ivp`` (RK45, rtol 1e-6) over the record, from its first ``samples``."""
    from scipy.integrate import solve_ivp

    a = Arrays(case)
    larger, choose = max, lambda c, yes, no: yes if c else no
    import math

    rate = make_rate(case.name, Mathematics(math.tanh, math.sqrt, larger, choose))
    x, period, p = a.x0, a.h * a.substeps, a.p.tolist()
    began = time.process_time()
    for u in a.u[:samples]:  # the input jumps at every sample, so the solver is started anew there
        x = solve_ivp(lambda t, x, u=u: rate(x, u, p), (0, period), x, rtol=1e-6, atol=1e-9).y[:, -1]
    return (time.process_time() - began) * len(a.u) / samples


PEERS: dict[str, Callable[[Case], Solve]] = {
    "casadi_single_shooting": casadi_single_shooting,
    "scipy_numba": scipy_numba,
    "lmfit_numba": lmfit_numba,
    "jax_sysid": jax_sysid,
    "diffrax_optimistix": diffrax_optimistix,
    "diffsol": diffsol,
}
