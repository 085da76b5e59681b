"""The rules by which a transcription is proposed, one by one: candidates in, proposal and reason out."""

import numpy as np
import pytest

from greybox.estimation.options import TranscriptionPolicy
from greybox.estimation.transcription.problem import TranscriptionReason
from greybox.estimation.transcription.select import (
    _compute_lyapunov_exponent,
    estimate_error_growth,
    propose_transcription,
)
from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State
from greybox.simulation.kernel.record import Record

ROWS, PERIOD = 101, 0.01  # one second


def first_order(rate, cubic=0.0):
    """``x' = rate x - c x^3 + u``; with ``c`` the model is nonlinear, with eigenvalue ``rate`` at ``x = 0``."""
    return Model(
        "first_order",
        [State("x", "m")],
        [Input("u", "m/s")],
        [Output("x", "m")],
        [Parameter("a", "1/s", rate, (-1e6, 1e6)), Parameter("c", "1/(m**2*s)", cubic, (0, 1e6))],
        lambda x, u, p: [Balance("motion", "m/s", 1, "x", own=p.a * x.x, cubic=-p.c * x.x**3, push=u.u)],
    )


def standing_still():
    return Record(
        np.zeros((ROWS, 1)), np.zeros((ROWS, 1)), np.full(ROWS - 1, PERIOD), np.zeros(ROWS - 1), np.array([PERIOD])
    )


def propose(model, **options):
    return propose_transcription(model.system, np.array(list(model.values.values())), standing_still(), **options)


@pytest.mark.parametrize(
    ("rate", "expected", "reason"),
    [
        (np.log(20) + 0.01, "multiple", TranscriptionReason.UNSTABLE),
        (np.log(20) - 0.01, "single", TranscriptionReason.STABLE),
        (-1.0, "single", TranscriptionReason.STABLE),
        (-0.02, "single", TranscriptionReason.INTEGRATING_GROWING),
    ],
)
def test_the_eigenvalue_decides(rate, expected, reason):
    proposal = propose(first_order(rate))
    assert (proposal.transcription, proposal.reason.code) == (expected, reason)


def test_a_free_run_that_is_asked_for_still_gets_the_steps_that_it_needs():
    unstable, stiff = first_order(10.0, cubic=1e-3), first_order(-2000.0, cubic=1e-3)
    assert propose(unstable).transcription == "multiple"
    assert propose(unstable, free_run=True).transcription == "single"
    assert propose(stiff, free_run=True).implicit


def test_an_integrator_has_no_time_constant():
    proposal = propose(first_order(-0.02))
    assert proposal.reason.values == {"duration": pytest.approx(1.0), "time_constants": None}


@pytest.mark.parametrize(("rate", "is_stiff"), [(-1599.0, False), (-1601.0, True)])
def test_a_model_is_stiff_beyond_the_explicit_substeps_of_the_policy(rate, is_stiff):
    """32 substeps of ``|h lambda| = 0.5`` in a sample of 10 ms: 1600 1/s."""
    proposal = propose(first_order(rate, cubic=1e-3))
    assert proposal.implicit == ("esdirk" if is_stiff else "")
    assert (proposal.reason.code == TranscriptionReason.STIFF_IMPLICIT) is is_stiff
    if is_stiff:
        assert proposal.reason.values["substeps"] == pytest.approx(32.02)


def test_the_limits_are_those_of_the_policy():
    tolerant = TranscriptionPolicy(max_error_growth=1e3)
    assert propose(first_order(4.0)).transcription == "multiple"
    assert propose(first_order(4.0), policy=tolerant).transcription == "single"


def test_the_growth_of_errors_is_the_real_part_of_the_eigenvalue():
    model = first_order(4.0)
    p = np.array(list(model.values.values()))
    assert estimate_error_growth(model.system, p, standing_still()) == pytest.approx(4.0)


def test_errors_that_overflow_within_a_step_grow_without_end():
    """A candidate that has gone astray; a warning would be an error here."""
    jacobian = 1e9 * np.array([[0.0, 1.0, 0.0], [50.0, 1.0, 3.0], [2.0, 1.0, 4.0]])
    assert _compute_lyapunov_exponent(np.tile(jacobian, (10, 1, 1)), 10.0) == np.inf
