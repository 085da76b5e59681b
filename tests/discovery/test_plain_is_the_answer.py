"""What does no better than the plain model on the record that judges it is no answer: the plain model is."""

from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lsim

import greybox as gb
from greybox.base.errors import DataError, FitError, ModelError
from greybox.base.values import with_code
from greybox.discovery import conclusion
from greybox.discovery.claims import Depth
from greybox.discovery.conclusion import judge_against_plain, judge_on_test
from greybox.discovery.decision import Grade, Verdict
from greybox.discovery.execution import FailureLog
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import ValidationSet, finish_fit
from greybox.estimation.result_parts import Misfit, Trace, Validation
from greybox.model.parts import Occurrence
from tests.support.first_order import first_order

SQUARES = np.random.default_rng(0).uniform(0.9, 1.1, 400)  # of a plain model whose error is about one


def validated(**residuals):
    """A fit of which only the run over a validation record is there; the noise of each output is a tenth."""
    misfit = {
        name: Misfit(rms := float(np.sqrt(np.mean(r**2))), "m", 0.0, rms / 0.1, len(r)) for name, r in residuals.items()
    }
    rows = len(next(iter(residuals.values())))
    zeros = dict.fromkeys(residuals, np.zeros(rows))
    trace = Trace("record", "", np.arange(rows), residuals, zeros, {})
    noise = SimpleNamespace(bound=lambda _: None, std=dict.fromkeys(residuals, 0.1))
    return SimpleNamespace(validation=Validation(misfit, (trace,)), noise=noise)


@pytest.mark.parametrize(
    ("change", "is_better"),
    [
        (np.full(400, 0.5), True),
        (np.full(400, 0.99), True),  # a hundredth everywhere is little, and no chance
        (np.repeat([1.0, 0.2, 1.0], [300, 60, 40]), True),  # much in one place only: a stop that is reached once
        (np.repeat([0.95, 1.05, 0.9995], [199, 199, 2]), False),  # now better, now worse
        (np.ones(400), False),
        (np.full(400, 85.0), False),
        (np.repeat([0.5, 9.0], [380, 20]), False),  # better in most parts, and worse in all
        (np.full(400, np.nan), False),  # it ran away
    ],
)
def test_an_answer_is_better_than_the_plain_model_beyond_chance(change, is_better):
    decision = judge_against_plain(validated(x=SQUARES), validated(x=change * SQUARES), 0)
    assert decision.passed is is_better


def test_whatever_runs_is_better_than_a_plain_model_that_ran_away():
    assert judge_against_plain(validated(x=np.full(400, np.nan)), validated(x=SQUARES), 0).passed is True


def test_all_outputs_count_by_their_noise_and_the_first_rows_do_not():
    plain = validated(x=SQUARES, i=0.2 * SQUARES)
    assert judge_against_plain(plain, validated(x=0.5 * SQUARES, i=0.3 * SQUARES), 0)
    assert not judge_against_plain(plain, validated(x=0.9 * SQUARES, i=8 * SQUARES), 0)


class TestRecords:
    """Runs over test records, by what stands for the model."""

    __test__ = False
    uncounted = 0

    def run(self, model, *_):
        if model.run is None:
            raise FitError("it ran away")
        return model.run


def on_test(residual):
    """A fit with this residual (N,) on the test records; None: it cannot be run there."""
    run = None if residual is None else validated(x=residual).validation
    noise = SimpleNamespace(std={"x": 0.1}, bound=lambda _: None)
    return SimpleNamespaceFit(model=SimpleNamespace(run=run, effects=()), noise=noise)


@dataclass(frozen=True)
class SimpleNamespaceFit:
    """As much of a fit as a run takes."""

    model: object
    noise: object
    validation: object = None


@pytest.mark.parametrize(
    ("change", "is_kept"),
    [
        (np.full(400, 0.5), True),
        (np.ones(400), True),
        (np.full(400, 1.03), True),  # larger everywhere, by a share that does not count
        (np.repeat([1.3, 0.8, 1.3, 0.8], 100), True),  # larger in some parts only
        (np.full(400, 1.2), False),
        (None, False),
    ],
)
def test_an_answer_that_is_worse_on_records_that_took_no_part_is_none(change, is_kept):
    problem = SimpleNamespace(failures=FailureLog(), options=None)
    plain, answer = on_test(SQUARES), on_test(None if change is None else change * SQUARES)
    decision = judge_on_test(problem, plain, answer, TestRecords(), "an effect")
    assert decision.passed is is_kept and len(decision.checks) == 1


def test_nothing_speaks_against_an_answer_without_test_records_or_where_the_plain_model_fails_there():
    problem = SimpleNamespace(failures=FailureLog(), options=None)
    assert judge_on_test(problem, on_test(SQUARES), on_test(None), ValidationSet(())).passed
    assert judge_on_test(problem, on_test(None), on_test(None), TestRecords()).passed


def lag_record(name, seed, disturbance):
    """A first-order lag under a held random input: its exact answer, sensor noise, and what only this record has."""
    rng = np.random.default_rng(seed)
    step, u, y = 0.1, np.repeat(rng.normal(size=32), 5), np.zeros(160)
    pole = np.exp(-step / 0.5)
    for k in range(159):
        y[k + 1] = pole * y[k] + (1 - pole) * 2.0 * u[k]
    measured = y + 0.02 * rng.normal(size=160) + disturbance(np.arange(160) * step)
    return gb.Experiment(name, np.arange(160) * step, {"u": u}, {"y": measured})


@pytest.mark.rest
def test_an_effect_of_the_estimation_record_alone_is_no_answer(monkeypatch):
    """Something drifted while the estimation record was taken, and not on the day of the other one.

    Only the plain model, which is handed over, is fitted once more: to finish what is rejected may take longer than the search.
    """
    finished = []

    def finish(problem, fit, *rest):
        finished.append(fit.model.effects)
        return finish_fit(problem, fit, *rest)

    monkeypatch.setattr(conclusion, "finish_fit", finish)
    drifting, quiet = lag_record("drifting", 1, lambda t: 0.03 * t), lag_record("quiet", 2, lambda t: 0 * t)
    found = gb.discover(
        first_order().start(gain=1.5, lag=0.7),
        drifting,
        validation=quiet,
        noise={"y": 0.02},
        effects=[gb.effect("sensor_drift"), gb.effect("input_offset")],
    )
    assert found.verdict is Verdict.UNKNOWN
    # That something may be missing is no more than a guess: it is in one of the two records.
    assert found.effects == [] and all(claim.grade is Grade.STAND_IN for claim in found.claims)
    assert finished == [()]
    assert found.best.parameters["gain"].value == found.base.parameters["gain"].value
    error = found.holdout["y"]
    assert error.after == error.before
    (tried,) = with_code(found.conclusion, DiscoveryCode.NO_LOOK_ALIKE)
    assert "sensor_drift" in tried.subject
    assert "takes" not in str(found).partition("candidate ")[0].replace("takes away", "")
    # What was tried is told, with its error on the day on which nothing drifted: that of a run which drifts by what it learnt.
    tried = next(rank for rank in found.ranking if rank.effects == ("sensor_drift",))
    assert (tried.constants, tried.occurrence) == (2, Occurrence.RARE)
    assert tried.errors["y"] > error.before
    assert "sensor_drift" in str(found).partition("taken away")[2].partition("note:")[0]


def test_a_third_record_contradicts_that_only_noise_is_left():
    """On the two days that the search knows nothing drifted, on the third something did."""
    learnt, chosen = (lag_record(f"day {seed}", seed, lambda t: 0 * t) for seed in (1, 2))
    search = partial(
        gb.discover,
        first_order().start(gain=1.5, lag=0.7),
        learnt,
        validation=chosen,
        noise={"y": 0.02},
        effects=[gb.effect("sensor_drift")],
    )
    verdicts = {}
    for drift in (0.0, 0.03):
        found = search(test=lag_record("third day", 3, lambda t: drift * t))  # noqa: B023
        verdicts[drift] = found.verdict, len(with_code(found.findings, DiscoveryCode.MISSING_ON_TEST))
    assert verdicts == {0.0: (Verdict.COMPLETE, 0), 0.03: (Verdict.UNKNOWN, 1)}


def test_a_record_of_the_search_is_no_test_record():
    learnt, chosen = (lag_record(f"day {seed}", seed, lambda t: 0 * t) for seed in (1, 2))
    with pytest.raises(DataError, match="test record day 2: it takes part in the search already"):
        gb.discover(first_order(), learnt, validation=chosen, test=chosen)


def test_a_record_that_is_fitted_is_no_validation_record():
    learnt, again = (lag_record(name, 1, lambda t: 0 * t) for name in ("day 1", "copy"))
    with pytest.raises(DataError, match="validation record copy: it is fitted too"):
        gb.discover(first_order(), learnt, validation=again)


def test_an_unknown_name_among_the_effects_to_try_is_refused_with_the_nearest():
    learnt, chosen = (lag_record(f"day {seed}", seed, lambda t: 0 * t) for seed in (1, 2))
    with pytest.raises(ModelError, match="input_offset"):
        gb.discover(first_order(), learnt, validation=chosen, effects=["input_offest"])


def search_drift(**more):
    """A search in two days on which the sensor drifted."""
    learnt, chosen = (lag_record(f"day {seed}", seed, lambda t: 0.03 * t) for seed in (1, 2))
    return gb.discover(
        first_order().start(gain=1.5, lag=0.7),
        learnt,
        validation=chosen,
        noise={"y": 0.02},
        effects=["sensor_drift", gb.effect("input_offset")],  # by name, or as a value
        **more,
    )


@pytest.fixture(scope="module")
def without():
    return search_drift()


@pytest.mark.rest
@pytest.mark.parametrize("drift_of_third", [pytest.param(0.0, marks=pytest.mark.slow), 0.03])
def test_a_third_record_takes_no_part_and_holds_the_answer_against_the_plain_model(without, drift_of_third):
    """The sensor drifted on the two days that the search knows; on the third as well, or not."""
    third = lag_record("third day", 3, lambda t: drift_of_third * t)
    found = search_drift(test=third)
    quoted = with_code(found.findings, DiscoveryCode.TEST_ERROR)
    assert [e["name"] for e in without.effects] == ["sensor_drift"] and without.test == {}
    # Its own fit tells what the plain model leaves there.
    free = gb.validate(found.base.model, third, noise={"y": 0.02})
    assert found.test["y"].before == pytest.approx(free.misfit["y"].rmse)
    if drift_of_third:
        assert found.verdict is without.verdict and found.best.model.values == without.best.model.values
        assert found.test["y"].after < 0.2 * found.test["y"].before
    else:
        assert found.effects == [] and found.extended is found.base
        (said,) = with_code(found.conclusion, DiscoveryCode.WORSE_ON_TEST)
        assert "sensor_drift" in said.subject
        assert found.test["y"].after == found.test["y"].before
        # No name and nothing certain, but that something is missing on the two days; where it acts there is said all the same.
        certain = [c.depth for c in found.claims if c.is_established]
        assert certain == [Depth.MISSING] and max(c.depth for c in found.claims) is Depth.VARIABLES
        places = [c for c in found.claims if c.depth is Depth.PLACE and c.grade is Grade.PROBABLE]
        assert any("sensor of y" in c.sites for c in places)
    assert len(quoted) == 1


GAIN, LAG, SENSOR, NOISE = 1.5, 3.0, 0.8, 0.01


def search_for_sensor_lag(rows, seed, unknown=0.0):
    """A search in a short step and a long square wave, read by a slow sensor, with something ``unknown`` that acts from 2 s on."""

    def record(name, seed, rows, u):
        time = 0.1 * np.arange(rows)
        _, y, _ = lsim(([GAIN], np.polymul([LAG, 1], [SENSOR, 1])), u(time), time, interp=False)
        read = y + unknown * np.sin(1.3 * time) * (time > 2) + NOISE * np.random.default_rng(seed).normal(size=rows)
        return gb.Experiment(name, time, {"u": u(time)}, {"y": read})

    return gb.discover(
        first_order(),
        record("short", seed, rows, np.ones_like),
        validation=record("long", 50, 240, lambda t: np.where(t % 8 < 3.95, 1.0, -1.0)),
        noise={"y": NOISE},
        effects=[gb.effect("sensor_lag"), gb.effect("input_offset")][: 1 if unknown else 2],
        options=gb.FitOptions(at_rest=True),
    )


@pytest.mark.slow
def test_a_search_that_learnt_from_the_validation_record_learns_no_second_time():
    found = search_for_sensor_lag(9, 0, unknown=0.15)
    assert len(with_code(found.findings, DiscoveryCode.LEARNT_FROM_VALIDATION)) == 1 and found.failures == ()
    assert [trace.name for trace in found.best.traces] == ["short", "long[0:120]"]


@pytest.mark.rest
@pytest.mark.parametrize(("rows", "seed"), [(14, 1), pytest.param(9, 0, marks=pytest.mark.slow)])
def test_constants_that_a_short_record_does_not_carry_are_learnt_from_half_of_the_other(rows, seed):
    """Of 14 rows the constants are off threefold, and yet better than no sensor lag; 9 rows show no sensor lag at all."""
    found = search_for_sensor_lag(rows, seed)
    assert [e["name"] for e in found.effects] == ["sensor_lag"]
    assert len(with_code(found.findings, DiscoveryCode.LEARNT_FROM_VALIDATION)) == 1 and found.failures == ()
    # Whoever fits the estimation record alone gets other constants: that is the first note.
    assert "first half of these was fitted as well" in " ".join(str(found).split()).split("note:")[1]
    constants = found.best.parameters
    # The two lags may change places.
    lags = sorted((constants["lag"].value, constants["tau_s"].value))
    assert lags == pytest.approx([SENSOR, LAG], rel=0.05)
    assert found.holdout["y"].after < 1.5 * NOISE < 0.1 * found.holdout["y"].before
