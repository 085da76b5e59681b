"""What a design gives back, as a value and as files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import ClassVar

from greybox.base.findings import Finding
from greybox.base.json_file import write_json
from greybox.base.json_shape import FileKind
from greybox.base.values import Printable
from greybox.data.experiment import Experiment
from greybox.extensions.design.limits import LimitPrediction
from greybox.extensions.design.problem import CriterionName, DesignPolicy, GoalName
from greybox.model.model import Model
from greybox.simulation.simulate import write_csv

INPUT_FILE = "input.csv"
"""The record to drive the rig with."""


@dataclass(frozen=True)
class PredictedConstant:
    """What the record should make of one constant.

    Parameters
    ----------
    value, unit
        The present value.
    std_before, std_after
        Standard deviation from the earlier records, and with this one; None where the constant is not determined.
    """

    value: float
    std_before: float | None
    std_after: float | None
    unit: str


@dataclass(frozen=True)
class PredictedDetection:
    """The smallest amount of an effect that would be seen.

    Parameters
    ----------
    parameter, unit
        The amplitude of the effect.
    before, after
        From the earlier records, and with this one; None where no amount would show.
    """

    parameter: str
    before: float | None
    after: float | None
    unit: str


class AlternativeKind(StrEnum):
    """What could be done instead of, or beside, the designed record."""

    INPUT = "input"
    REPEAT = "repeat"
    LONGER = "longer"
    SAMPLE_FASTER = "sample_faster"
    SENSOR = "sensor"


@dataclass(frozen=True)
class Alternative:
    """Another way, on the same scale.

    Parameters
    ----------
    kind, name
        What it is: a kind of input, two records, twice the duration, half the sampling time, or a sensor more.
    gain
        Factor on what the designed record brings: on one over the width of intervals, on distances between rivals, or on one over the
        smallest amount. Above one it brings more.
    """

    kind: AlternativeKind
    name: str
    gain: float


@dataclass(frozen=True, eq=False)
class Design(Printable):
    """The next record, and what it should bring.

    Parameters
    ----------
    goal, criterion
        What was asked.
    models
        The explanations in the running, the best one first.
    experiment
        The input, a record without outputs.
    kind
        What the input is called.
    predicted
        For every free constant of the best explanation its standard deviation before and after.
    separation
        For each pair of explanations the cost by which the wrong one would lose, after a refit.
    detection
        For each effect that may hide the smallest amount that would be seen.
    limits
        For each limited signal what is predicted.
    alternatives
        Other inputs, repetition, duration, sampling time and sensors on the same scale.
    findings
        What to know before the record is taken.
    policy
        The decision numbers.
    seconds
        Time that it took.
    """

    goal: GoalName
    criterion: CriterionName
    models: tuple[Model, ...]
    experiment: Experiment
    kind: str
    predicted: Mapping[str, PredictedConstant]
    separation: Mapping[str, float]
    detection: Mapping[str, PredictedDetection]
    limits: Mapping[str, LimitPrediction]
    alternatives: tuple[Alternative, ...]
    findings: tuple[Finding, ...] = ()
    policy: DesignPolicy = field(default_factory=DesignPolicy)
    seconds: float = 0.0

    FILE: ClassVar[FileKind] = FileKind("a design", "design.json that greybox design has written")
    KEYS: ClassVar[str] = """
        goal criterion models=titles input!=input_file kind rows=experiment.rows sampling_time=experiment.sampling_time
        hold=experiment.hold predicted separation detection limits alternatives findings notes=str(findings) policy seconds
        """

    @property
    def titles(self) -> tuple[str, ...]:
        """The explanations in the running, the best one first."""
        return tuple(model.title for model in self.models)

    @property
    def input_file(self) -> str:
        """The file with the input, beside this one."""
        return INPUT_FILE

    @property
    def model(self) -> Model:
        """The best explanation."""
        return self.models[0]

    def save(self, folder: str | Path) -> Path:
        """Write ``design.json`` and ``input.csv`` into a folder.

        Parameters
        ----------
        folder
            Where to; it is made.

        Returns
        -------
        Path
            ``design.json``.
        """
        return save_design(self, folder)


def save_design(design: Design, folder: str | Path) -> Path:
    """Write ``design.json`` and ``input.csv``; the former names the latter."""
    place = Path(folder)
    write_csv(design.experiment, design.model, place / design.input_file)
    return write_json(place / "design.json", design)
