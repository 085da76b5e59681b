"""What a command shows, as values; `greybox.show.documents` writes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from greybox.base import FileKind, Finding, Printable
from greybox.estimation import residuals, result, result_parts, score, uncertainty
from greybox.estimation.linear.linearisation import Linearisation
from greybox.estimation.linear.model_family import ModelFamily
from greybox.model import Model
from greybox.simulation.simulate import Simulation


@dataclass(frozen=True)
class RecordMisfit:
    """Free-run error of one output in one record.

    Attributes
    ----------
    record, output
        Their names.
    misfit
        The error there.
    """

    record: str
    output: str
    misfit: result_parts.Misfit

    KEYS: ClassVar[str] = "record output misfit.*"


@dataclass(frozen=True)
class FitAnswer(Printable):
    """A fit, with what was asked for beside it: what ``fit.json`` holds in the end.

    Attributes
    ----------
    fit
        The fit.
    remedies
        What would determine the parameters that the records left open.
    profiles, regions, bootstrap
        The intervals that were asked for, of one parameter or of two together.
    zero_noise
        Parameters of process noise that are zero: each has a limit only, and no profile.
    refusal
        Why there are no intervals, where they were asked for.
    scores, validation_scores
        Errors of the free run and of predictions on the fitted and on the validation records.
    tests
        The tests of the residual.
    misfits, validation_misfits
        Misfit of each output of each record, where there are several.
    """

    fit: result.Fit
    remedies: tuple[Finding, ...] = ()
    profiles: tuple[uncertainty.Profile, ...] = ()
    regions: tuple[uncertainty.ProfilePair, ...] = ()
    zero_noise: tuple[str, ...] = ()
    bootstrap: uncertainty.Bootstrap | None = None
    refusal: str = ""
    scores: score.Scores | None = None
    validation_scores: score.Scores | None = None
    tests: residuals.ResidualTests | None = None
    misfits: Sequence[RecordMisfit] = ()
    validation_misfits: Sequence[RecordMisfit] = ()

    FILE: ClassVar[FileKind] = result.Fit.FILE
    KEYS: ClassVar[str] = """
        fit.* profiles? regions? zero_noise? bootstrap? refusal? remedies? tests?=tests.tests scores?=scores.outputs
        validation_scores?=validation_scores.outputs record_misfits?=misfits validation_record_misfits?=validation_misfits
        """


@dataclass(frozen=True)
class SimulationAnswer(Printable):
    """A run of ``model``, and the standard deviations of the ``noise`` that was added to the record written from it."""

    run: Simulation
    model: Model
    noise: str = ""


@dataclass(frozen=True)
class LinearAnswer(Printable):
    """A linear model that was written, with a family drawn from the covariance where one was asked for."""

    linear: Linearisation
    family: ModelFamily | None


@dataclass(frozen=True)
class CodeAnswer(Printable):
    """A nonlinear model that was written as ``kind``, with its ``step`` in seconds where the format has one."""

    title: str
    kind: str
    step: float | None
    step_name: str
