"""The exact hold's coefficients from compiled code, against scipy's matrix exponential and its derivative."""

import numpy as np
import pytest
from scipy.linalg import expm, expm_frechet

from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.simulation.integrators.exact_hold import exact_hold
from greybox.simulation.kernel.gradual import GradualKernel, GradualPolicy
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record
from models.micro_actuator import micro_actuator

KERNELS = ["compiled", "interpreted", "machine"]


@pytest.fixture(params=KERNELS)
def build(request, monkeypatch, tmp_path_factory):
    """Makes a kernel of either kind from a step."""
    if request.param == "machine":
        monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path_factory.getbasetemp() / "machine"))
        return make_machine
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path_factory.getbasetemp() / "kernels"))
    monkeypatch.setenv("GREYBOX_KERNEL", request.param)
    return make_kernel


def make_machine(step):
    """The tape machine, which never earns a library."""
    return GradualKernel(
        step,
        None,
        pytest.fail,
        GradualPolicy(earned_seconds=np.inf, translated_seconds=np.inf, long_pass_seconds=np.inf),
    )


def oscillator(stiffness, damping):
    """Two inputs, a constant force and a state that nothing drives back: A is singular."""
    return Model(
        "oscillator",
        [State("x", "m"), State("v", "m/s"), State("s", "m*s")],
        [Input("u", "V"), Input("w", "m/s**2")],
        [Output("x", "m")],
        [
            Parameter("k", "1/s**2", stiffness),
            Parameter("c", "1/s", damping),
            Parameter("g", "m/(V*s**2)", 2.0),
            Parameter("f", "m/s**2", -0.3),
        ],
        lambda x, u, p: [
            Balance("position", "m/s", 1, "x", velocity=x.v),
            Balance("force", "m/s**2", 1, "v", spring=-p.k * x.x, damping=-p.c * x.v, drive=p.g * u.u, rest=u.w + p.f),
            Balance("sum", "m", 1, "s", position=x.x),
        ],
    )


def generator(k, c, g, f, h):
    """``[[A h, [B, c] h, 0], [0, 0, I], [0, 0, 0]]`` of the oscillator by hand."""
    m = np.zeros((9, 9))
    m[0, 1] = m[2, 0] = h
    m[1, :6] = np.array([-k, -c, 0, g, 1, f]) * h
    m[3:6, 6:] = np.eye(3)
    return m


def blocks(m):
    return np.concatenate([part.ravel(order="F") for part in (m[:3, :3], m[:3, 3:6], m[:3, 6:8])])


def balanced(function, units, *matrices):
    """A function of matrices in which the states are measured in other units: scipy loses digits where entries differ by 1e8."""
    return function(*(m / units[:, None] * units for m in matrices)) * units[:, None] / units


def record(lengths, inputs=2, first_order=False):
    n = len(lengths) + 1
    return Record(np.zeros((n, inputs)), np.zeros((n, 1)), lengths, np.arange(n - 1), np.array(lengths), first_order)


# slow and fast against the interval; entries of A from 1 to 1e10
@pytest.mark.parametrize(("k", "c"), [(4.0, 0.1), (1e4, 50.0), (1e6, 1e5), (1e10, 3e4), (0.0, 0.0)])
def test_coefficients_are_scipys(build, k, c):
    h = np.array([1e-4, 3e-3, 0.05])
    model, p, units = oscillator(k, c), np.array([k, c, 2.0, -0.3]), np.ones(9)
    units[1] = max(1.0, np.sqrt(k))
    q, dq = build(exact_hold(model.system)).coefficients(record(h), p, np.eye(4))
    assert q.shape == (3, 24) and dq.shape == (3, 24, 4)
    for row, length in enumerate(h):
        m = generator(*p, length)
        expected = blocks(balanced(expm, units, m))
        assert np.allclose(q[row], expected, rtol=1e-11, atol=1e-13 * np.abs(expected).max())
        for j in range(4):
            along = generator(*np.eye(4)[j], length) - generator(0, 0, 0, 0, length)
            slope = blocks(balanced(lambda a, e: expm_frechet(a, e, compute_expm=False), units, m, along))
            assert np.allclose(dq[row, :, j], slope, rtol=1e-8, atol=1e-9 * np.abs(slope).max())


@pytest.mark.parametrize("directions", [1, 4, 9])
def test_slopes_along_any_number_of_directions(build, directions):
    """Along combinations of the constants, and none where a direction moves only the first state."""
    rng = np.random.default_rng(1)
    p = np.array(list(micro_actuator.values.values()))
    step, h = exact_hold(micro_actuator.system), record(np.array([2.5e-4, 1e-3]), inputs=1, first_order=True)
    dp = p[:, None] * rng.standard_normal((len(p), directions))
    dp[:, ::3] = 0.0
    kernel = build(step)
    _, dq = kernel.coefficients(h, p, dp)
    assert not dq[:, :, ::3].any()
    for j in range(directions):
        ends = [step.coefficients(p + e * dp[:, j], h.lengths, np.arange(0))[0] for e in (1e-6, -1e-6)]
        difference = (ends[0] - ends[1]) / 2e-6
        scale = np.abs(difference).max(axis=1, keepdims=True)
        assert np.all(np.abs(dq[:, :, j] - difference) <= 1e-7 * scale)


def test_kernels_agree(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path_factory.getbasetemp() / "kernels"))
    p = np.array(list(micro_actuator.values.values()))
    found = []
    for name in KERNELS[:2]:
        monkeypatch.setenv("GREYBOX_KERNEL", name)
        kernel = make_kernel(exact_hold(micro_actuator.system))
        found.append(kernel.coefficients(record(np.array([2.5e-4, 1e-3, 0.1]), inputs=1), p, np.diag(p)))
    for ours, theirs in zip(*found, strict=True):
        scale = np.abs(theirs).max(axis=1, keepdims=True)
        assert np.all(np.abs(ours - theirs) <= 1e-9 * scale)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e308])
def test_constants_that_overflow_give_no_number(build, bad):
    """The pass that follows then fails at its second sample, and the point is one that cannot be simulated."""
    model = oscillator(1.0, 1.0)
    kernel, data, p = build(exact_hold(model.system)), record(np.ones(3)), np.array([1.0, -bad, 2.0, -0.3])
    with np.errstate(all="ignore"):
        q, dq = kernel.coefficients(data, p, np.eye(4))
    assert not np.isfinite(q).all()
    sums = kernel.sums(data, KernelPoint(q, dq, p, np.eye(4), np.ones(3), np.zeros((3, 4))), np.ones(1))
    assert sums.cost == np.inf and sums.failed_at == 1
