"""What a command shows, as values; `greybox.show.sentences.shell` writes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from greybox.base.errors import ExitCode
from greybox.base.values import Printable

if TYPE_CHECKING:
    from greybox.estimation.linear.linearisation import Linearisation
    from greybox.estimation.linear.model_family import ModelFamily
    from greybox.estimation.residuals import ResidualTests
    from greybox.estimation.result import Fit
    from greybox.estimation.result_parts import Misfit
    from greybox.estimation.uncertainty import Bootstrap, Profile
    from greybox.simulation.simulate import Simulation


@dataclass(frozen=True)
class Answer:
    """What a command has found, and what is to be done with it: `greybox.shell.command_line` shows it.

    ``text``: what ``print`` shows of it. ``json``: the same for programs, given the report that was written, if any. ``files`` that were
    written; ``page`` writes the report, ``pictures`` the figures, where they are wanted; ``kept``: what there is if that is interrupted.
    ``failure``: why the command ends with ``code``.
    """

    text: object
    json: Callable[[Path | None], str]
    files: Sequence[Path] = ()
    page: Callable[[], Path] | None = None
    pictures: Callable[[], list[Path]] | None = None
    kept: str = ""
    failure: str = ""
    code: ExitCode = ExitCode.SUCCESS


RecordMisfit = tuple[str, str, "Misfit"]
"""Name of a record, name of an output, and the misfit there."""


@dataclass(frozen=True)
class FitAnswer(Printable):
    """A fit, with what was asked for beside it.

    ``remedies``: what would determine the parameters that the records left open. ``profiles`` and ``bootstrap``: the intervals
    asked for; ``zero_noise``: parameters of process noise that are zero and have a limit only; ``refusal``: why there are no
    intervals. ``scores``: free run and predictions on the fitted and the validation records. ``misfits`` of each record, where
    there are several.
    """

    fit: Fit
    remedies: tuple[Any, ...] = ()
    profiles: tuple[Profile, ...] = ()
    zero_noise: tuple[str, ...] = ()
    bootstrap: Bootstrap | None = None
    refusal: str = ""
    scores: Any = None
    validation_scores: Any = None
    tests: ResidualTests | None = None
    misfits: Sequence[RecordMisfit] = ()
    validation_misfits: Sequence[RecordMisfit] = ()


@dataclass(frozen=True)
class SimulationAnswer(Printable):
    """A run and the record that was written from it."""

    run: Simulation
    file: Path


@dataclass(frozen=True)
class LinearAnswer(Printable):
    """A linear model that was written, with a family drawn from the covariance where one was asked for."""

    linear: Linearisation
    family: ModelFamily | None
    files: tuple[Path, ...]


@dataclass(frozen=True)
class CodeAnswer(Printable):
    """A nonlinear model that was written as ``kind``, with its ``step`` in seconds where the format has one."""

    title: str
    kind: str
    step: float | None
    step_name: str
    files: tuple[Path, ...]
