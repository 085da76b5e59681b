"""Models side by side on the same records, as values, and their scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np

from greybox.base.frames import make_frame
from greybox.base.json_file import read_json, write_json
from greybox.base.json_shape import FileKind
from greybox.base.values import Finding, Printable
from greybox.comparison.blackbox.structure_scan import StructureScanPolicy
from greybox.data.experiment import Experiment
from greybox.estimation.errors import OutputRun, OutputScore
from greybox.estimation.options import FitOptions


class ComparisonFinding(StrEnum):
    """Verdict and findings of a comparison; their sentences are in `greybox.show.sentences.comparison`."""

    BEST_MODEL = "best_model"
    """The model with the smallest error of one output, and the best model of the other kind."""
    UNSTABLE_MODELS = "compared_unstable"
    """Models that are unstable."""
    FEEDTHROUGH_MODELS = "compared_feedthrough"
    """Models whose output depends on the input of the same row."""
    BIC_OF_DIFFERENT_OUTPUTS = "compared_bic_outputs"
    """Models whose BIC sums over different outputs."""
    FAILED_FITS = "compared_fits_failed"
    """Models whose fit did not succeed."""
    FAILED_MODELS = "compared_models_failed"
    """Models that follow their records worse than a constant."""
    FIT_FAILED = "compared_fit_failed"
    """The fit of this model did not succeed."""
    PREDICTION_FILTER = "compared_prediction_filter"
    """What the one-step predictions of this model are made with."""
    NO_BLACK_BOX = "compared_no_black_box"
    """No black box could be fitted to an output."""
    NO_STATE_SPACE = "compared_no_state_space"
    """No state-space model of all inputs and outputs could be identified."""
    RECORD_RESAMPLED = "compared_record_resampled"
    """A record was resampled for the black boxes."""
    WORSE_THAN_CONSTANT = "compared_worse_than_constant"
    """A model that errs by more than a constant does, on the records that it was fitted to: it failed."""
    DIVERGED = "compared_diverged"
    """A model whose free run leaves a record for validation far behind: it failed."""
    MEASURED_ROWS_ONLY = "compared_measured_rows_only"
    """Black boxes use the rows at which a slow sensor was read."""


@dataclass(frozen=True)
class ComparisonPolicy:
    """Which rows count, when two models are equally good, and how the black boxes beside a physical model are fitted.

    Parameters
    ----------
    scan
        How the structures of the black boxes are chosen.
    """

    scan: StructureScanPolicy = field(default_factory=StructureScanPolicy)


DEFAULT_COMPARISON = ComparisonPolicy()


class BoxKind(StrEnum):
    """Whether a model is a grey box or a black box."""

    GREY = "grey"
    BLACK = "black"


class BlackBoxModel(Protocol):
    """What a black-box model of one output offers: `greybox.comparison.blackbox.arx` and its kin give such values."""

    @property
    def kind(self) -> str:
        """``arx``, ``armax`` ..."""

    @property
    def label(self) -> str:
        """Kind and orders."""

    @property
    def output(self) -> str:
        """Name of the output."""

    @property
    def sampling_time(self) -> float:
        """Seconds from sample to sample."""

    @property
    def parameters(self) -> int:
        """Number of fitted coefficients."""

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle."""

    @property
    def history(self) -> str:
        """``zero`` where it was fitted from rest."""

    @property
    def feedthrough(self) -> Mapping[str, float]:
        """Direct share of each input in the output of the same row."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What one should know before trusting it."""

    def simulate(self, experiment: Experiment, *, initial: Any = ..., rows: int | None = ...) -> dict[str, np.ndarray]:
        """Free run ``{output: (N,)}``."""

    def predict(
        self, experiment: Experiment, steps: int = ..., *, initial: Any = ..., rows: int | None = ...
    ) -> dict[str, np.ndarray]:
        """Prediction ``{output: (N,)}``."""


@dataclass(frozen=True)
class ComparisonScore(OutputScore):
    """Errors of one output over one or more records; infinite where a run leaves all bounds.

    Attributes
    ----------
    rmse
        Root mean square error of the free run.
    best_fit_percent
        ``100 (1 - ||y - yhat|| / ||y - mean(y)||)`` of the free run, with each record's own mean.
    one_step_rmse
        Error of the prediction one sample ahead.
    samples
        How many went into it.
    unit
        Of the output.
    ahead_rmse
        Errors of predictions further ahead, by the number of samples.
    """

    KEYS: ClassVar[str] = "rmse best_fit_percent one_step_rmse samples unit ahead_rmse?"

    @property
    def ahead_rmse(self) -> Mapping[int, float]:
        """Errors of predictions further ahead than one sample, by the number of samples."""
        return {k: error for k, error in self.ahead.items() if k != 1}


@dataclass(frozen=True, eq=False)
class ComparisonEntry:
    """One model of a comparison.

    Attributes
    ----------
    name
        What it is called.
    kind
        ``grey`` or ``black``.
    structure
        Output -> which model.
    parameters
        Number of fitted parameters or coefficients, without initial states.
    training, validation
        Output -> `ComparisonScore` over all records of that group.
    records
        Record -> output -> `ComparisonScore`.
    bic
        ``sum N ln(mean square free-run error) + p ln(sum N)`` on the estimation records, summed over the outputs; NaN without them.
    stable
        Whether every pole of a black box lies inside the unit circle; whether a linear grey box has no pole in the right half plane,
        and the runs of a nonlinear one stay bounded.
    feedthrough
        ``output/input`` -> direct share within the same row, where there is one.
    seconds
        Time that the fit took (a black box: with its scan).
    findings
        What one should know before trusting its numbers.
    training_runs, validation_runs
        The runs behind the scores.
    """

    name: str
    kind: BoxKind
    structure: Mapping[str, str]
    parameters: int
    training: Mapping[str, ComparisonScore]
    validation: Mapping[str, ComparisonScore]
    records: Mapping[str, Mapping[str, ComparisonScore]]
    bic: float
    stable: bool
    feedthrough: Mapping[str, float]
    seconds: float = 0.0
    findings: tuple[Finding, ...] = ()
    training_runs: tuple[OutputRun, ...] = ()
    validation_runs: tuple[OutputRun, ...] = ()

    KEYS: ClassVar[str] = """
        kind parameters structure validation training records bic stable feedthrough seconds notes=str(findings) findings
        """

    @property
    def failed_outputs(self) -> frozenset[str]:
        """Outputs that it follows worse than a constant: they take no part in what is said and drawn of models."""
        codes = (ComparisonFinding.WORSE_THAN_CONSTANT, ComparisonFinding.DIVERGED)
        return frozenset(finding.subject for finding in self.findings if finding.code in codes)

    @property
    def failed(self) -> bool:
        """Whether no output is left."""
        return bool(self.failed_outputs) and self.failed_outputs >= {*self.training, *self.validation}

    def score(self, output: str, group: str = "", record: str = "") -> ComparisonScore | None:
        """That of an ``output`` on the records of a ``group``, or on one ``record``; None where there is none or it failed."""
        scores: Mapping[str, ComparisonScore] = getattr(self, group) if group else self.records.get(record, {})
        return None if output in self.failed_outputs else scores.get(output)


@dataclass(frozen=True, eq=False)
class Comparison(Printable):
    """Models on the same rows of the same records.

    Attributes
    ----------
    entries
        The models, in the order they were given.
    outputs
        Name of each output -> unit.
    training, validation
        Names of the estimation and validation records.
    skip
        Rows at the start of each validation record that do not count.
    verdict
        Which model is best where and by how much, then what to keep in mind, as findings.
    findings
        What could not be compared.
    policy
        What it was steered by.
    options
        How physical models were simulated; None: each fit with its own options.
    """

    entries: tuple[ComparisonEntry, ...]
    outputs: Mapping[str, str]
    training: tuple[str, ...]
    validation: tuple[str, ...]
    skip: int = 0
    verdict: tuple[Finding, ...] = ()
    findings: tuple[Finding, ...] = ()
    policy: ComparisonPolicy = DEFAULT_COMPARISON
    options: FitOptions | None = None

    FILE: ClassVar[FileKind] = FileKind("a comparison", "compare.json that greybox compare has written")
    KEYS: ClassVar[str] = """
        models! outputs training validation skip verdict=str(verdict) notes=str(findings) findings=all_findings policy options
        """

    def __getitem__(self, name: str) -> ComparisonEntry:
        return next(e for e in self.entries if e.name == name)

    @property
    def models(self) -> dict[str, ComparisonEntry]:
        """Name -> model."""
        return {entry.name: entry for entry in self.entries}

    @property
    def standing(self) -> tuple[ComparisonEntry, ...]:
        """The models that did not fail in every output."""
        return tuple(entry for entry in self.entries if not entry.failed)

    @property
    def all_findings(self) -> tuple[Finding, ...]:
        """The verdict, and what could not be compared."""
        return (*self.verdict, *self.findings)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the models."""
        return tuple(e.name for e in self.entries)

    def deciding_scores(self, entry: ComparisonEntry) -> Mapping[str, ComparisonScore]:
        """The scores that decide: on the validation records, or on the estimation records where there are no others."""
        scores = entry.validation if self.validation else entry.training
        return {output: score for output, score in scores.items() if output not in entry.failed_outputs}

    def to_frame(self) -> Any:
        """A pandas data frame with a row for each model and output, the best first: what decides, on the records that judge.

        Columns are output, unit, kind, parameters, error (rms of the free run, in the unit), fit in per cent and the records that judge.
        Raises ModuleNotFoundError without pandas (``pip install 'greybox-sysid[frames]'``).
        """
        scored = [(e, output, s) for e in self.entries for output, s in self.deciding_scores(e).items()]
        order = list(self.outputs)
        scored.sort(key=lambda row: (order.index(row[1]), not np.isfinite(row[2].rmse), row[2].rmse))
        columns: dict[str, list[Any]] = {
            "output": [output for _, output, _ in scored],
            "unit": [self.outputs[output] for _, output, _ in scored],
            "kind": [str(e.kind) for e, _, _ in scored],
            "parameters": [e.parameters for e, _, _ in scored],
            "error": [s.rmse for _, _, s in scored],
            "fit_percent": [s.best_fit_percent for _, _, s in scored],
            "records": ["validation" if self.validation else "estimation"] * len(scored),
        }
        return make_frame("model", [e.name for e, _, _ in scored], columns)


# A comparison as JSON: ``compare.json``.


def save_comparison(comparison: Comparison, path: str | Path) -> Path:
    """Write a comparison as JSON.

    Parameters
    ----------
    comparison
        What `greybox.compare` gave.
    path
        The file; missing folders are made.

    Returns
    -------
    Path
        The file. Numbers that are not finite become null.

    Raises
    ------
    OutputError
        If it cannot be written; an older file is then left as it was.

    Examples
    --------
    >>> comparison = gb.compare([fit], record)  # doctest: +SKIP
    >>> gb.comparison.save_comparison(comparison, "results/compare.json")  # doctest: +SKIP
    """
    return write_json(path, comparison)


def load_comparison(path: str | Path) -> dict[str, Any]:
    """What ``compare.json`` holds, checked.

    Parameters
    ----------
    path
        The file that `save_comparison` or ``greybox compare`` has written.

    Returns
    -------
    dict
        ``models`` -> name -> kind, parameters, validation ..., ``outputs``, ``verdict`` and more, as ``docs/result_files.md`` lists them.

    Raises
    ------
    DataError
        If it cannot be read, or is not a comparison as the schema says, with the first offence.

    Examples
    --------
    >>> gb.comparison.load_comparison("results/compare.json")["verdict"]  # doctest: +SKIP
    """
    return read_json(path, Comparison)
