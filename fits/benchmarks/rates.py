"""The right-hand sides of the problems once more, in plain scalar code that numba and jax both understand.

``make_rate(name, m)`` gives ``rate(x, u, p) -> dx`` on tuples; ``m`` holds ``tanh, sqrt, larger, choose``. ``p`` is in the
order of the model's parameters. A test holds them against the models.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Mathematics(NamedTuple):
    """Scalar functions; ``choose(condition, yes, no)``."""

    tanh: Callable
    sqrt: Callable
    larger: Callable
    choose: Callable


def make_rate(name: str, m: Mathematics, jit: Callable = lambda f: f) -> Callable:
    """The rate function of a problem; ``jit`` compiles the functions it is made of."""
    return {"actuator": _actuator, "pneumatic": _pneumatic, "positioning": _positioning}[name.removesuffix("_long")](
        m, jit
    )


def make_rk4(rate: Callable, states: int, jit: Callable = lambda f: f) -> Callable:
    """``advance(x, u, p, h) -> x`` by one RK4 step with the input held."""
    plus = {2: _plus2, 3: _plus3, 4: _plus4}[states](jit)

    def advance(x, u, p, h):
        k1 = rate(x, u, p)
        k2 = rate(plus(x, k1, h / 2), u, p)
        k3 = rate(plus(x, k2, h / 2), u, p)
        k4 = rate(plus(x, k3, h), u, p)
        return plus(plus(plus(plus(x, k1, h / 6), k2, h / 3), k3, h / 3), k4, h / 6)

    return jit(advance)


def _plus2(jit: Callable) -> Callable:
    return jit(lambda x, k, h: (x[0] + h * k[0], x[1] + h * k[1]))


def _plus3(jit: Callable) -> Callable:
    return jit(lambda x, k, h: (x[0] + h * k[0], x[1] + h * k[1], x[2] + h * k[2]))


def _plus4(jit: Callable) -> Callable:
    return jit(lambda x, k, h: (x[0] + h * k[0], x[1] + h * k[1], x[2] + h * k[2], x[3] + h * k[3]))


def _actuator(m: Mathematics, jit: Callable) -> Callable:
    def rate(x, u, p):
        M, B, K, Kf, Kv, Ra, La = p[0], p[1], p[2], p[3], p[4], p[5], p[6]
        return x[1], (Kf * x[2] - B * x[1] - K * x[0]) / M, (u - Ra * x[2] - Kv * x[1]) / La

    return jit(rate)


def _positioning(m: Mathematics, jit: Callable) -> Callable:
    tanh = m.tanh

    def rate(x, u, p):
        M, Fv, Fc, Ks, g, vs = p[0], p[1], p[2], p[3], p[4], p[5]
        return x[1], (g * u - Fv * x[1] - Fc * tanh(x[1] / vs) - Ks * x[0]) / M

    return jit(rate)


def _pneumatic(m: Mathematics, jit: Callable) -> Callable:
    tanh, sqrt, larger, choose = m

    def flow(w, pressure, C, b, P_S, P_a, rho_a, u_ref):
        upstream, downstream = choose(w > 0, P_S, pressure), choose(w > 0, pressure, P_a)
        excess = larger(downstream / upstream - b, 0.0) / (1 - b)
        return C * rho_a * w / u_ref * upstream * sqrt(larger(1 - excess * excess, 1e-4))

    flow = jit(flow)

    def rate(x, u, p):
        C, b, M, Fv, Fc, sd, A, V_h, P_S, P_a = p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9]
        rho_a, RT, u_ref, vs, Ks = p[10], p[11], p[12], p[13], p[14]
        s, v, p_a, p_b = x[0], x[1], x[2], x[3]
        w = u - sd * tanh(u / sd)
        volume_a, volume_b = V_h + A * s, V_h - A * s
        force = A * (p_a - p_b) - Fv * v - Fc * tanh(v / vs) - Ks * s
        into_a = RT * flow(w, p_a, C, b, P_S, P_a, rho_a, u_ref) - p_a * A * v
        into_b = RT * flow(-w, p_b, C, b, P_S, P_a, rho_a, u_ref) + p_b * A * v
        return v, force / M, into_a / volume_a, into_b / volume_b

    return jit(rate)
