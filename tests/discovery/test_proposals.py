"""What is proposed for an effect that is not established: an experiment only where the records do not separate it from another one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.data.noise.noise_model import BoundDirection
from greybox.discovery.claims import Claim, Depth
from greybox.discovery.curve_shape import CurveShape, Dependence, ShapeKind
from greybox.discovery.disturbance_sites import SiteKind
from greybox.discovery.effect_signal import measure_remaining_error
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import HoldoutError
from greybox.discovery.localisation import MisfitWindow, RankedSite, ResidualLocalisation
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.proposals import explain_doubt, propose_next_steps


@pytest.mark.parametrize(
    ("equals", "rival", "expected"),
    [
        (("drive_lag",), "quadratic_damping", "drive_lag"),
        ((), "quadratic_damping", "quadratic_damping"),
        ((), "cubic_damping + fitted_curve", "fitted_curve"),
        ((), "", None),
        ((), "plain_model", None),
        ((), "cubic_damping", None),
    ],
    ids=[
        "another does the same",
        "a rival wins at times",
        "a curve beside it",
        "no rival",
        "the plain model",
        "a rival that is itself",
    ],
)
def test_an_experiment_is_asked_for_only_where_the_records_do_not_separate(equals, rival, expected):
    step = explain_doubt(Claim(Depth.NAME, "y", name="cubic_damping", equals=equals, rival=rival))
    if expected is None:
        assert step is None
    else:
        assert (step.code, step.subject) == (DiscoveryCode.SEPARATE_FROM_RIVAL, "cubic_damping")
        assert dict(step.values) == {"rival": expected, "advice": ""}


def test_of_what_is_one_equation_only_a_change_of_the_rig_tells_more():
    step = explain_doubt(Claim(Depth.NAME, "y", name="constant_load", equals=("asymmetric_friction",)))
    assert step.values["advice"] == gb.effect("asymmetric_friction").tells_apart


NONE = np.zeros(0)


def dependence(shape=ShapeKind.UNNAMED, *, tone=None, period=None, position=None, has_loop=False, is_relevant=True):
    shape = CurveShape(shape, position=position) if position is not None else CurveShape(shape)
    return Dependence("v", "m/s", 0.8, shape, 0.4 * has_loop, tone, NONE, NONE, NONE, period, is_relevant, has_loop)


def fit_of(rmse, ceiling=1.0, outputs=("y",)):
    bound = SimpleNamespace(direction=BoundDirection.AT_MOST, level=ceiling)
    noise = SimpleNamespace(bound=lambda _: bound, std=dict.fromkeys(outputs, ceiling))
    return SimpleNamespace(
        misfit={name: SimpleNamespace(rmse=rmse) for name in outputs},
        noise=noise,
        model=SimpleNamespace(inputs=[], outputs=[SimpleNamespace(name=name, unit="m") for name in outputs]),
        traces=(),
        validation=SimpleNamespace(traces=()),
    )


def codes(location, rmse=10.0, left=None):
    return [f.code for f in propose_next_steps(fit_of(rmse), location, None, (), DiscoveryPolicy(), left=left)]


BURST = tuple(MisfitWindow("run", k, k + 1.0, 0.9 * (k == 4) + 0.1 / 20, 2.0) for k in range(20))


@pytest.mark.parametrize(
    ("location", "code"),
    [
        (ResidualLocalisation(10.0, 1.1), DiscoveryCode.SUSPECT_MEMORY),
        (ResidualLocalisation(10.0, 1.1, dependences=(dependence(is_relevant=False),)), DiscoveryCode.SUSPECT_MEMORY),
        (ResidualLocalisation(10.0, 1.1, windows=BURST), DiscoveryCode.LOOK_AT_STRETCH),
        (ResidualLocalisation(10.0, 1.1, dependences=(dependence(),)), DiscoveryCode.TRACE_CURVE),
        (ResidualLocalisation(10.0, 1.1, dependences=(dependence(has_loop=True),)), DiscoveryCode.TRACE_LOOP),
        (ResidualLocalisation(10.0, 1.1, dependences=(dependence(period=0.1),)), DiscoveryCode.SUSPECT_PERIODIC_PART),
        (
            ResidualLocalisation(10.0, 1.1, dependences=(dependence(ShapeKind.BEND, position=0.2),)),
            DiscoveryCode.SUSPECT_CONTACT,
        ),
        (
            ResidualLocalisation(10.0, 1.1, dependences=(dependence(ShapeKind.TONE, tone=50.01),)),
            DiscoveryCode.SUSPECT_MAINS,
        ),
    ],
    ids=["nothing seen", "no variable", "a burst", "a curve", "a loop", "periodic", "a bend", "mains"],
)
def test_what_to_do_next_follows_from_what_was_seen(location, code):
    assert codes(location) == [code]


def curve(explained, has_loop=False):
    own = dependence(has_loop=has_loop)
    return SimpleNamespace(
        explained_fraction=explained,
        tone=None,
        variable="v",
        variable_unit="m/s",
        dependence=own,
        shape=own.shape,
        signal=SimpleNamespace(variables={}),
    )


@pytest.mark.parametrize(
    ("surrogate", "location", "code"),
    [
        (curve(0.99), ResidualLocalisation(10.0, 1.1), DiscoveryCode.USE_CURVE_MODEL),
        (curve(0.5), ResidualLocalisation(10.0, 1.1), DiscoveryCode.VARY_SPEED_AND_AMPLITUDE),
        (curve(0.5, has_loop=True), ResidualLocalisation(10.0, 1.1), DiscoveryCode.TRACE_LOOP),
        (
            curve(0.5),
            ResidualLocalisation(10.0, 1.1, dependences=(replace(dependence(), variable="x"),)),
            DiscoveryCode.VARY_OTHER_VARIABLE,
        ),
        (curve(0.5), ResidualLocalisation(10.0, 1.1, windows=BURST), DiscoveryCode.LOOK_AT_STRETCH),
        (curve(0.0), ResidualLocalisation(10.0, 1.1, dependences=(dependence(),)), DiscoveryCode.TRACE_CURVE),
    ],
    ids=["it explains all", "a part", "a loop", "another variable", "a burst", "it explains nothing"],
)
def test_what_a_curve_leaves_says_what_to_do(surrogate, location, code):
    steps = propose_next_steps(fit_of(10.0), location, surrogate, (), DiscoveryPolicy())
    assert [step.code for step in steps] == [code]


def test_the_noise_is_asked_for_only_where_it_would_decide():
    location = ResidualLocalisation(10.0, 1.1)
    assert DiscoveryCode.STATE_NOISE not in codes(location, rmse=10.0)
    assert DiscoveryCode.STATE_NOISE in codes(location, rmse=1.2)
    # With an effect the rest is near the ceiling: whether more hides below it, the noise tells.
    assert DiscoveryCode.STATE_NOISE in codes(location, rmse=10.0, left=fit_of(1.2))


def test_what_a_sensor_adds_is_told_of_its_own_output_only():
    sensor = RankedSite("p1", SiteKind.SENSOR, 1e3, 0.1, "bar")
    location = ResidualLocalisation(10.0, 1.1, (sensor,), ((sensor.label,),), dependences=(dependence(),))
    holdout = {name: HoldoutError(2.0, 1.0, 0.1, "bar") for name in ("p1", "p2")}
    left = measure_remaining_error(fit_of(1.0, outputs=("p1", "p2")), holdout, location, 0)
    assert left["p1"].sites == ("sensor of p1",) and left["p1"].dependence is not None
    assert left["p2"].sites == () and left["p2"].dependence is None
    balance = RankedSite("flow", SiteKind.BALANCE, 1e3, 0.1, "kg/s")
    location = ResidualLocalisation(10.0, 1.1, (balance,), ((balance.label,),), dependences=(dependence(),))
    left = measure_remaining_error(fit_of(1.0, outputs=("p1", "p2")), holdout, location, 0)
    assert left["p1"].sites == left["p2"].sites == ("balance flow",)
    assert left["p2"].dependence is not None
    # Where the drive cannot be told from the sensor, it may reach the other output; the signal that was looked at is the sensor's.
    drive = RankedSite("u", SiteKind.INPUT, 1e3, 0.1, "V")
    tied = ((sensor.label, drive.label),)
    location = ResidualLocalisation(10.0, 1.1, (sensor, drive), tied, dependences=(dependence(),))
    left = measure_remaining_error(fit_of(1.0, outputs=("p1", "p2")), holdout, location, 0)
    assert left["p2"].sites == ("input u",) and left["p2"].dependence is None
    assert left["p1"].dependence is not None
    # Where no site leads there is no signal that could be a function of anything.
    location = ResidualLocalisation(10.0, 1.1, dependences=(dependence(),))
    left = measure_remaining_error(fit_of(1.0, outputs=("p1", "p2")), holdout, location, 0)
    assert left["p1"].dependence is left["p2"].dependence is None
