"""A mass on a spring, pushed at random, sampled on a grid of which rows may be missing: records that several tests share."""

from dataclasses import replace

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from greybox import Balance, Experiment, Input, Model, Output, Parameter, State

MASS = Model(
    "mass",
    [State("x", "m"), State("v", "m/s")],
    [Input("u", "N")],
    [Output("x", "m"), Output("v", "m/s")],
    [
        Parameter("M", "kg", 1.0, (0.01, 100.0), fixed=True),
        Parameter("B", "N*s/m", 0.4, (1e-3, 100.0)),
        Parameter("K", "N/m", 4.0, (1e-3, 1000.0)),
    ],
    lambda x, u, p: [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", drive=u.u, damping=-p.B * x.v, spring=-p.K * x.x),
    ],
)
PERIOD, HELD = 0.1, 5
LEVEL = {"x": 0.01, "v": 0.02}
INTENSITY = 0.3
STARTS = ([0.0, 0.0], [1.0, -0.5], [-0.6, 1.2])


def discrete(period=PERIOD, intensity=INTENSITY, B=0.4, K=4.0, M=1.0):
    """Transition (2, 2), gain of the held input (2,) and noise covariance (2, 2) of one interval (Van Loan 1978)."""
    a, b = np.array([[0.0, 1.0], [-K / M, -B / M]]), np.array([[0.0], [1.0 / M]])
    gain = expm(np.block([[a, b], [np.zeros((1, 3))]]) * period)[:2, 2]
    push = np.diag([0.0, intensity**2])
    both = expm(np.block([[-a, push], [np.zeros((2, 2)), a.T]]) * period)
    phi = both[2:, 2:].T
    return phi, gain, phi @ both[:2, 2:]


def states(u, x0, rng, intensity=INTENSITY, stiffness=4.0):
    """The states (N, 2) of a mass under the held input ``u`` (N,)."""
    phi, gain, noise = discrete(intensity=intensity, K=stiffness)
    root = np.linalg.cholesky(noise) if intensity else np.zeros((2, 2))
    x, found = np.array(x0, float), []
    for force in u:
        found.append(x)
        x = phi @ x + gain * force + root @ rng.normal(size=2)
    return np.array(found)


def record(seed, rows=240, x0=(0.0, 0.0), intensity=0.0, rho=0.0, name="day 1", stiffness=4.0):
    """A record whose input changes every fifth row, with noise on the outputs; ``rho``: its correlation from row to row."""
    rng = np.random.default_rng([seed, 7])
    u = np.repeat(2.0 * rng.choice([-1.0, 0.0, 1.0], rows // HELD), HELD)
    x = states(u, x0, rng, intensity, stiffness)
    noise = lfilter([1.0], [1.0, -rho], rng.normal(size=(rows + 100, 2)) * np.sqrt(1 - rho**2), axis=0)[100:]
    outputs = {n: x[:, j] + LEVEL[n] * noise[:, j] for j, n in enumerate(LEVEL)}
    return Experiment(name, PERIOD * np.arange(rows), {"u": u}, outputs)


def hidden(data, seed=0, share=0.3):
    """Rows (N,) that may be missing: some of those in which the input does not change, and one long stretch of them."""
    rng = np.random.default_rng([seed, 8])
    rows = np.arange(data.rows)
    return (rng.random(data.rows) < share) & (rows % HELD != 0) | (rows % HELD != 0) & (rows > 100) & (rows < 120)


def with_gaps(data, seed=0):
    """``data`` with nothing measured in its `hidden` rows."""
    out = hidden(data, seed)
    return replace(data, outputs={n: np.where(out, np.nan, y) for n, y in data.outputs.items()})


def irregular(data, seed=0):
    """``data`` without its `hidden` rows: the same measurements, at irregular times."""
    keep = ~hidden(data, seed)
    inputs, outputs = ({n: y[keep] for n, y in part.items()} for part in (data.inputs, data.outputs))
    return Experiment(data.name, data.time[keep], inputs, outputs)


def three(seed=0, **options):
    """Three experiments, each with first states of its own: one with gaps, one at irregular times, one whole."""
    one, two, whole = (record(10 * seed + k, x0=x0, name=f"day {k + 1}", **options) for k, x0 in enumerate(STARTS))
    return with_gaps(one, seed), irregular(two, seed + 1), whole
