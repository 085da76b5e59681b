"""What the tests of discrete steps share: small models, and runs through a kernel with slopes by finite differences."""

import casadi as ca
import numpy as np

from greybox import Balance, DryFriction, Effect, Input, Model, Output, Parameter, State
from greybox.simulation.kernel.compiled import CompiledKernel
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.interpreted import InterpretedKernel
from greybox.simulation.kernel.record import Record

KERNELS = (CompiledKernel, InterpretedKernel)
NONE = np.empty(0, int)


def values(model):
    """Parameter values in the order of the system."""
    return np.array(list(model.values.values()))


def record(u, period, outputs=1, first_order=False):
    """Inputs (N,) or (N, nu) on a uniform grid, with nothing measured."""
    u = np.asarray(u, float).reshape(len(u), -1)
    n = len(u)
    return Record(
        u, np.full((n, outputs), np.nan), np.full(n - 1, period), np.zeros(n - 1), np.array([period]), first_order
    )


def path(step, data, p, x0, kernel=CompiledKernel):
    """Outputs and states of a run."""
    seen = data.read_by(step)
    q, _ = step.coefficients(p, seen.lengths, NONE)
    return kernel(step).simulate(seen, q, p, np.asarray(x0, float))


def slopes(step, data, p, x0, kernel=CompiledKernel):
    """Jacobian of the outputs (N, ny, np) along all parameters, from the kernel's tangents."""
    seen = data.read_by(step)
    n = len(p)
    q, dq = step.coefficients(p, seen.lengths, np.arange(n))
    seen = type(seen)(seen.u, np.zeros_like(seen.y), seen.h, seen.row, seen.lengths, seen.is_linear)
    _, jacobian = kernel(step).residuals(
        seen, KernelPoint(q, dq, p, np.eye(n), np.asarray(x0, float), np.zeros((len(x0), n))), np.ones(seen.y.shape[1])
    )
    return -jacobian


def differences(step, data, p, x0, k, relative=1e-6, absolute=0.0):
    """Slope of the outputs (N, ny) along parameter ``k`` by central differences."""
    e = np.zeros(len(p))
    e[k] = relative * abs(p[k]) + absolute
    return (path(step, data, p + e, x0)[0] - path(step, data, p - e, x0)[0]) / (2 * e[k])


def orders(errors):
    """Orders of convergence between errors at successively halved steps."""
    errors = np.asarray(errors)
    return np.log2(errors[:-1] / errors[1:])


def oscillator(**start):
    """A mass on a spring, 2 kg and 50 N/m."""
    return Model(
        "oscillator",
        [State("x", "m", role="displacement"), State("v", "m/s", role="velocity")],
        [Input("u", "N", role="drive")],
        [Output("x", "m")],
        [Parameter("M", "kg", 2.0), Parameter("K", "N/m", 50.0), Parameter("B", "N*s/m", 0.5)],
        lambda x, u, p: [
            Balance("position", "m/s", 1, "x", velocity=x.v),
            Balance("force", "N", p.M, "v", drive=u.u, spring=-p.K * x.x, damping=-p.B * x.v),
        ],
    ).start(**start)


def lugre(relaxing=True, s0=3e5, s1=300.0):
    """LuGre friction: bristle state, force ``-(s0 z + s1 dz/dt)``."""

    def rate(x, p):
        g = p.Fc + (p.Fs - p.Fc) * ca.exp(-((x.velocity / p.vs) ** 2))
        return x.velocity, -p.s0 * ca.fabs(x.velocity) * x.z / g

    return Effect(
        "lugre_friction",
        "force",
        [
            Parameter("Fc", "{force}", 20.0, (1e-3, 1e4)),
            Parameter("Fs", "{force}", 30.0, (1e-3, 1e4)),
            Parameter("vs", "{velocity}", 0.01, (1e-5, 1.0)),
            Parameter("s0", "{force}/{displacement}", s0, (1.0, 1e7)),
            Parameter("s1", "{force}/{velocity}", s1, (0.0, 1e5)),
        ],
        states=[State("z", "{displacement}", relaxing=relaxing)],
        balances=lambda x, u, p: [Balance("bristle", "{velocity}", 1, "z", slip=rate(x, p)[0], back=rate(x, p)[1])],
        terms=lambda x, u, p: -(p.s0 * x.z + p.s1 * sum(rate(x, p))),
    )


def stribeck(Fc=20.0, Fs=30.0, vs=0.05):
    """Dry friction that falls from ``Fs`` at standstill to ``Fc``."""
    return Effect(
        "stribeck_friction",
        "force",
        [
            Parameter("Fc", "{force}", Fc, (0.0, 1e4)),
            Parameter("Fs", "{force}", Fs, (0.0, 1e4)),
            Parameter("vs", "{velocity}", vs, (1e-5, 1.0)),
        ],
        dry=lambda x, u, p: DryFriction(p.Fc + (p.Fs - p.Fc) * ca.exp(-((x.velocity / p.vs) ** 2)), p.Fs),
    )


def bouc_wen():
    """Hysteretic force ``-alpha z`` with ``dz/dt = v - beta |v| z - gamma v |z|``."""
    return Effect(
        "bouc_wen",
        "force",
        [
            Parameter("alpha", "{force}/{displacement}", 40.0),
            Parameter("beta", "1/{displacement}", 6.0),
            Parameter("gamma", "1/{displacement}", 3.0),
        ],
        states=[State("z", "{displacement}", relaxing=True)],
        balances=lambda x, u, p: [
            Balance(
                "loop",
                "{velocity}",
                1,
                "z",
                slip=x.velocity,
                decay=-p.beta * ca.fabs(x.velocity) * x.z,
                bend=-p.gamma * x.velocity * ca.fabs(x.z),
            )
        ],
        terms=lambda x, u, p: -p.alpha * x.z,
    )


def delay(longest=1e-3, value=0.0):
    """Input that arrives late."""
    return Effect(
        "transport_delay", "input", [Parameter("delay", "s", value, (0.0, longest))], delay=lambda x, u, p: p.delay
    )


def play(gap=0.01):
    """Backlash between the mass and its sensor."""
    return Effect(
        "backlash",
        "sensor",
        [Parameter("gap", "{sensor}", gap, (0.0, 1.0))],
        states=[State("w", "{sensor}")],
        update=lambda x, u, p: {"w": ca.fmin(ca.fmax(x.w, x.displacement - p.gap), x.displacement + p.gap)},
        on_output=lambda y, x, u, p: x.w,
    )
