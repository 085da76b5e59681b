"""Refits and their journal, with a problem that only counts."""

from dataclasses import dataclass, field
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from greybox.base.errors import DataError, ModelError, nearest
from greybox.data.noise.noise_model import AutoRegression, NoiseModel
from greybox.discovery.execution import FailureLog, RefitExecutor, RefitJob, RefitJournal, RefitOutcome, SearchStage
from greybox.discovery.problem import DiscoveryProblem
from greybox.estimation.options import FitOptions, Transcription
from models.micro_actuator import micro_actuator


@dataclass
class CountingProblem:
    """A refit's result is its number of starts; a job without one cannot be simulated."""

    refits: int = 0
    restored: list[RefitOutcome] = field(default_factory=list)
    failures: FailureLog = field(default_factory=FailureLog)

    def refit(self, job):
        self.refits += 1
        return len(job.starts) or None

    def to_outcome(self, candidate):
        return RefitOutcome({"starts": float(candidate)}, ((0.5, 1.5),))

    def restore(self, model, outcome):
        self.restored.append(outcome)
        return int(outcome.values["starts"])

    def job_key(self, job):
        return f"job with {len(job.starts)} starts"


def jobs(*counts):
    return [RefitJob(micro_actuator, ({},) * count, 1, 10) for count in counts]


def test_results_come_in_the_order_of_the_jobs_and_are_reported():
    finished = []
    executor = RefitExecutor(report=finished.append)
    assert executor.run(CountingProblem(), jobs(3, 0, 2)) == [3, None, 2]
    assert finished == [1, 2, 3]


def test_a_journal_restores_what_was_finished(tmp_path):
    path = tmp_path / "deep" / "journal.jsonl"
    assert RefitExecutor(journal=RefitJournal(path)).run(CountingProblem(), jobs(3, 0)) == [3, None]
    again, journal = CountingProblem(), RefitJournal(path)
    assert RefitExecutor(journal=journal).run(again, jobs(3, 0, 4)) == [3, None, 4]
    assert (again.refits, journal.reused) == (1, 2)
    assert again.restored == [RefitOutcome({"starts": 3.0}, ((0.5, 1.5),))]


def test_a_last_line_that_was_cut_short_is_left_out(tmp_path):
    path = tmp_path / "journal.jsonl"
    RefitExecutor(journal=RefitJournal(path)).run(CountingProblem(), jobs(3))
    with path.open("a") as file:
        file.write('{"key": "cut sho')
    assert set(RefitJournal(path).known) == {"job with 3 starts"}


def test_a_file_that_is_no_journal_is_refused(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_text("time,x\n1,2\n3,4\n")
    with pytest.raises(DataError, match="line 1 is not a journal entry"):
        RefitJournal(path)


def test_a_job_that_fails_is_out_and_the_others_go_on():
    class Failing(CountingProblem):
        def refit(self, job):
            if len(job.starts) == 2:
                raise ModelError("the delay needs equal intervals")
            return super().refit(job)

    problem = Failing()
    assert RefitExecutor().run(problem, jobs(3, 2, 1)) == [3, None, 1]
    (failure,) = problem.failures.entries.values()
    assert (failure.stage, failure.reason) == (SearchStage.REFIT, "the delay needs equal intervals")


def test_a_job_that_failed_before_is_known_to_the_journal(tmp_path):
    path = tmp_path / "journal.jsonl"
    RefitExecutor(journal=RefitJournal(path)).run(CountingProblem(), jobs(0))
    again = CountingProblem()
    assert RefitExecutor(journal=RefitJournal(path)).run(again, jobs(0)) == [None]
    assert again.refits == 0 and len(again.failures.entries) == 1


def test_an_interruption_is_no_failure_of_a_candidate():
    class Interrupted(CountingProblem):
        def refit(self, job):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        RefitExecutor().run(Interrupted(), jobs(1, 1))


@pytest.mark.parametrize(
    ("of_plain", "asked", "expected"),
    [
        ("single", "automatic", "single"),
        ("multiple", "automatic", "automatic"),
        ("single", "multiple", "multiple"),
    ],
    ids=["free runs follow the plain model", "they do not", "the user decides"],
)
def test_candidates_are_judged_by_what_follows_the_plain_model(monkeypatch, of_plain, asked, expected):
    choice = SimpleNamespace(transcription=Transcription(of_plain))
    monkeypatch.setattr("greybox.discovery.problem.select_transcription", lambda *_: choice)
    problem = DiscoveryProblem(
        None, (), NoiseModel(("x",), np.ones(1), {}, (AutoRegression(),), True), (), FitOptions(transcription=asked)
    )
    problem.__dict__["baseline"] = SimpleNamespace(problem=None)
    assert problem.refit_options.transcription == expected
    assert problem.to_portable().options.transcription == expected


def test_while_a_candidate_is_prepared_only_functions_of_users_may_raise_anything():
    failures = FailureLog()

    def write_own_effect():
        raise KeyError("of a user's function")

    assert failures.attempt(SearchStage.PREPARATION, ("own",), write_own_effect, "none") == "none"
    with pytest.raises(KeyError):
        failures.attempt(SearchStage.REFIT, ("own",), write_own_effect, "none")
    # A sequence is asked for, in a line of the library.
    with pytest.raises(TypeError):
        failures.attempt(SearchStage.PREPARATION, ("own",), partial(nearest, "gain", None), "none")
    assert set(failures.of_single_effects()) == {"own"}
