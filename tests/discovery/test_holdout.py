"""Candidates on the validation records, with errors that are given: nothing is simulated."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

import greybox.discovery.execution as execution
import greybox.discovery.holdout as holdout
from greybox.base.errors import FitError
from greybox.discovery.execution import FailureLog, RefitExecutor, SearchStage
from greybox.discovery.holdout import (
    HoldoutError,
    HoldoutScores,
    ValidationSet,
    block_errors,
    finish_fit,
    measure_structure,
    worst_output,
)
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.options import FitOptions
from greybox.estimation.result_parts import Misfit, Trace, Validation
from tests.support.fake_candidates import candidate


@pytest.mark.parametrize(
    ("before", "after", "floor", "fraction"),
    [(10.0, 1.0, 1.0, 1.0), (10.0, 5.5, 1.0, 0.5), (10.0, 10.9, 1.0, -0.1), (10.0, 0.1, 1.0, 1.1)],
)
def test_the_explained_fraction_counts_from_the_noise(before, after, floor, fraction):
    assert HoldoutError(before, after, floor, "m").explained_fraction == pytest.approx(fraction)


def test_the_worst_output_is_so_in_units_of_its_noise():
    errors = {"x": HoldoutError(10.0, 1.0, 5.0, "m"), "i": HoldoutError(1.0, 1.0, 0.1, "A")}
    assert worst_output(errors) == "i"


SELECTED = candidate(10, "s")


class FakeRuns(HoldoutScores):
    """Residuals by effects; None for a model that fails."""

    def run(self, fit):
        residual = self.problem[fit.effects]
        if residual is None:
            return None
        trace = Trace("a", "", np.arange(len(residual)), {"x": residual}, {"x": np.zeros(len(residual))}, {})
        return Validation({"x": Misfit(1.0, "m", 0.0, 2.0, len(residual))}, (trace,))


def test_block_errors_leave_the_first_rows_out():
    residual = np.concatenate([[9.0, 9.0], np.ones(10), 2 * np.ones(10)])
    scores = FakeRuns({("s",): residual}, ValidationSet((), skip=2))
    assert block_errors(scores.run(SELECTED), scores.validation.uncounted, 2)["x"] == pytest.approx([1.0, 4.0])


def test_a_model_that_fails_on_the_validation_records_is_out_with_its_reason():
    failures = FailureLog()
    problem = SimpleNamespace(failures=failures, noise_std={}, run_options=FitOptions())

    class Failing(ValidationSet):
        def run(self, *_):
            raise FitError("on purpose")

    scores = HoldoutScores(problem, Failing(("no record",)))
    assert scores.run(SELECTED) is None and scores.adapt(SELECTED) is None
    (failure,) = failures.entries.values()
    assert failure.stage is SearchStage.HOLDOUT


def test_a_bug_of_the_library_ends_the_run():
    """It must not pass for a model that fails, which would turn a name into *unknown*."""
    problem = SimpleNamespace(failures=FailureLog(), noise_std={}, run_options=FitOptions())

    class Broken(ValidationSet):
        def run(self, *_):
            raise TypeError("on purpose")

    with pytest.raises(TypeError, match="on purpose"):
        HoldoutScores(problem, Broken(("no record",))).run(SELECTED)


def test_a_run_that_is_lost_before_its_first_row_follows_nothing():
    scores = FakeRuns({("s",): np.full(40, np.nan)}, ValidationSet(("a record",), skip=2))
    assert scores.adapt(SELECTED) is None and scores.measure_drift(SELECTED) == {}
    assert measure_structure(scores, SELECTED, only_visible=True) == 1.0


def test_the_beginning_of_a_record_does_not_count():
    assert ValidationSet((), skip=20, beginning=50).uncounted == 50
    assert ValidationSet((), skip=80, beginning=50).uncounted == 80
    assert not ValidationSet(())


def test_a_share_is_of_the_error_and_needs_no_noise():
    error = HoldoutError(8.84e-3, 0.31e-3, 1e-3, "V", is_floor_known=False)
    assert error.share == pytest.approx(1 - 0.31 / 8.84)
    assert HoldoutError(0.0, 0.0, 1.0, "V").share == 0.0


# A fit of one's own of what a search hands over.


@dataclass(frozen=True)
class EndedFit:
    """A fit of which only the errors on both kinds of records, one constant and its standard deviation are there."""

    error: float
    constant: float = 1.0
    judged: float = 2.0
    status: str = "converged"
    runs: int = 10
    validation: object = None

    def __post_init__(self):
        if self.validation is None:
            object.__setattr__(self, "validation", SimpleNamespace(misfit={}))

    @property
    def success(self):
        return self.status == "converged"

    @property
    def solver(self):
        return SimpleNamespace(status=self.status, statistics={"passes": self.runs})

    @property
    def misfit(self):
        return {"x": Misfit(self.error, "m", 0.0, 1.0, 10)}

    @property
    def model(self):
        return SimpleNamespace(values={"k": self.constant}, fit=self)

    @property
    def parameters(self):
        return {"k": SimpleNamespace(value=self.constant, std=0.1)}

    @property
    def noise(self):
        return SimpleNamespace(std={})


class RecordsThatJudge(ValidationSet):
    """The error that a fit has there is its own number."""

    def run(self, model, *_):
        run = SimpleNamespace(misfit={"x": Misfit(model.fit.judged, "m", 0.0, 1.0, 10)})
        run.over = lambda noise: run
        return run


def finish(monkeypatch, first, *ends, is_late=False, end=np.inf):
    """`finish_fit` of ``first``, where fits that begin there end at ``ends``, one after the other; how many were made."""
    rest = list(ends)
    monkeypatch.setattr(holdout, "estimate", lambda *_, **__: rest.pop(0))
    problem = SimpleNamespace(
        user_settings=SimpleNamespace(noise={}, quiet=(), options=FitOptions()),
        executor=SimpleNamespace(is_late=is_late, limit_finishing=lambda: end),
        experiments=(),
    )
    validation = RecordsThatJudge(())
    first = holdout.replace(first, validation=validation.run(first.model))
    return finish_fit(problem, first, validation), len(ends) - len(rest)


def test_a_search_ends_with_a_fit_at_which_another_ends_too(monkeypatch):
    finished, made = finish(monkeypatch, EndedFit(1.0), EndedFit(0.9), EndedFit(0.8), EndedFit(0.8))
    assert finished.is_settled and made == 3
    assert finished.fit.error == 0.8


@pytest.mark.parametrize(
    ("moving", "errors", "constants"),
    [
        ([EndedFit(1 - 0.1 * k) for k in range(1, 8)], [("estimation", 0.7, 0.6)], {}),
        # The error on the records that were fitted is the same, and the constants go on along what these leave open.
        ([EndedFit(1.0, judged=2 - 0.1 * k) for k in range(1, 8)], [("validation", 1.7, 1.6)], {}),
        ([EndedFit(1.0, constant=1 + 0.05 * k) for k in range(1, 8)], [], {"k": 0.5}),
    ],
)
def test_a_search_says_what_another_fit_would_change(monkeypatch, moving, errors, constants):
    finished, made = finish(monkeypatch, EndedFit(1.0), *moving)
    assert made == holdout.MOST_FINISHES and not finished.is_settled
    # It stands one before the last, so that what the next fit does is known and not guessed.
    last = moving[made - 2]
    assert (finished.fit.error, finished.fit.constant, finished.fit.judged) == (last.error, last.constant, last.judged)
    assert [(e["records"], pytest.approx(e["before"]), pytest.approx(e["after"])) for e in finished.errors] == errors
    assert finished.constants == pytest.approx(constants)


def test_a_fit_that_does_not_end_leaves_the_one_before(monkeypatch):
    finished, _ = finish(monkeypatch, EndedFit(1.0), EndedFit(0.9), EndedFit(0.5, status="iteration_limit"))
    assert finished.fit.error == 0.9
    assert not finished.is_settled and finished.status == "iteration_limit"


def test_fits_of_thousands_of_runs_are_not_repeated_until_they_settle(monkeypatch):
    moving = [EndedFit(1 - 0.1 * k, runs=holdout.MOST_FINISHING_RUNS // 2) for k in range(1, 5)]
    finished, made = finish(monkeypatch, EndedFit(1.0), *moving)
    assert made == 2 and finished.fit.error == 0.9
    assert not finished.is_settled and [(e["before"], e["after"]) for e in finished.errors] == [(0.9, 0.8)]


def test_a_fit_that_ends_worse_than_where_it_began_leaves_the_one_before(monkeypatch):
    # The first is what a fit of one's own makes of the search's end, be it worse; the third follows none.
    finished, made = finish(monkeypatch, EndedFit(0.7), EndedFit(0.8), EndedFit(1.6), EndedFit(1.8))
    assert made == 2 and finished.fit.error == 0.8
    assert not finished.is_settled and [(e["before"], e["after"]) for e in finished.errors] == [(0.8, 1.6)]


def test_where_the_time_is_over_it_is_said_that_nobody_tried(monkeypatch):
    finished, made = finish(monkeypatch, EndedFit(1.0), EndedFit(0.9), is_late=True)
    assert made == 0 and finished.fit.error == 1.0
    assert finished.is_late and not finished.is_settled and not finished.errors


def test_a_fit_that_its_time_ended_changes_nothing_and_is_told(monkeypatch):
    stopped = EndedFit(0.5, status=TerminationStatus.INTERRUPTED)
    finished, made = finish(monkeypatch, EndedFit(1.0), stopped, end=0.0)
    assert made == 1 and finished.fit.error == 1.0
    assert finished.is_late and not finished.is_settled and not finished.errors
    # What a fit before it changed is known.
    finished, made = finish(monkeypatch, EndedFit(1.0), EndedFit(0.9), stopped, end=0.0)
    assert made == 2 and not finished.is_late and [e["after"] for e in finished.errors] == [0.9]


def test_finishing_takes_as_long_as_the_search_and_passes_no_limit(monkeypatch):
    seconds = {"now": 110.0}
    monkeypatch.setattr(execution.time, "perf_counter", lambda: seconds["now"])
    quick, limited = RefitExecutor(), RefitExecutor(last_deadline=190.0)
    quick.began = limited.began = 100.0
    assert quick.limit_finishing() == 110.0 + execution.FINISHING_SECONDS
    seconds["now"] = 180.0
    assert quick.limit_finishing() == 260.0
    assert limited.limit_finishing() == 190.0
