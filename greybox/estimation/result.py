"""Codes of what can be said of a result that was read; the sentences are in ``greybox.show.sentences.estimation``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np

from greybox.base import FileKind, Finding, Severity, StoredResult, from_json_data, parse_unit, read_json
from greybox.base.errors import DataError, GreyboxError, ModelError, shorten
from greybox.base.packing import pack, unpack
from greybox.base.values import Printable, ReadOnly
from greybox.data.identity import find_shared_readings
from greybox.data.noise import BoundDirection, NoiseSource
from greybox.data.problems import RowLabels, find_array_problems
from greybox.estimation import result_parts
from greybox.model import Model
from greybox.model.equations import compare_definition
from greybox.model.system import intensity_name
from greybox.simulation.plant import Plant, as_model


class ResultCode(StrEnum):
    """Codes of the findings of a saved result."""

    FOREIGN_FINDING = "foreign_finding"
    """A finding in a file whose code or figures this version does not know."""

    OTHER_MODEL = "other_model"
    """The model that a saved result was joined with states something else than the one that was fitted."""

    OTHER_CONSTANT = "other_constant"
    """A constant that is known has another value in the model now than it had in the fit."""


# A fit as a value, and as a file ``fit.json`` that is written and read without loss. Its keys are flat and stay the same from version to
# version.


# Up to so many times the noise an error counts as noise: its level is known to about a tenth.
GOOD_MISFIT = 1.2
# A model that follows less than this per cent of an output (best fit) describes another plant, unless noise is all that is left.
FOLLOWED_PERCENT = 50.0


@dataclass(frozen=True)
class Fit(Printable, ReadOnly, StoredResult):
    """A fitted model, read-only throughout.

    Attributes
    ----------
    model
        The model with the fitted values.
    parameters
        Name -> `Estimate`: value, standard deviation and 95 % interval; ``parameters.to_frame()`` is a data frame of them.
    misfit
        Free-run error by output over the estimation records.
    traces
        The estimation records with the model's runs over them.
    solver
        How the search ended: ``success`` and ``status`` stand there and as short cuts here.
    noise
        The noise that the outputs were weighed with, and where it is known from.
    uncertainty
        Covariance of the free parameters and how it was computed.
    discretisation
        How the model was integrated, and how much half the step would change.
    provenance
        What repeats the fit.
    validation
        Misfit and runs on records that were not used for the fit.
    constraints
        Ties, priors, and parameters with a value for each experiment.
    robust
        The robust loss and the outliers.
    prediction
        For a model with process noise: its intensities, the one-step error and the likelihood.
    starts
        Where each of several starts ended, best first (`greybox.multistart`).
    findings
        What a reader should know before trusting a number, the most important first.
    """

    model: Model
    parameters: result_parts.Estimates
    misfit: Mapping[str, result_parts.Misfit]
    traces: Sequence[result_parts.Trace]
    solver: result_parts.SolverReport
    noise: result_parts.FitNoise
    uncertainty: result_parts.FitUncertainty
    discretisation: result_parts.FitDiscretisation
    provenance: result_parts.Provenance = field(default_factory=result_parts.Provenance)
    validation: result_parts.Validation = field(default_factory=result_parts.Validation)
    constraints: result_parts.FitConstraints = field(default_factory=result_parts.FitConstraints)
    robust: result_parts.RobustReport = field(default_factory=result_parts.RobustReport)
    prediction: result_parts.PredictionReport = field(default_factory=result_parts.PredictionReport)
    starts: Sequence[result_parts.StartResult] = ()
    findings: tuple[Finding, ...] = ()

    FILE: ClassVar[FileKind] = FileKind("a fit", "fit.json that greybox fit has written")
    KEYS: ClassVar[str] = """
        model=model.name effects!=model.effect_names status=solver.status success=solver.success meaning=str(solver) parameters
        misfit traces free=uncertainty.free covariance=uncertainty.covariance noise=noise.std noise_source=str(noise)
        discretisation=discretisation.label integration_error=discretisation.error cost=solver.cost solver=solver.figures
        options=provenance.stored_options equations=provenance.equations declared?=provenance.declared start?=provenance.start
        versions=provenance.versions notes=str(findings) findings
        status_details=solver.details search=solver.strategy misfit_at_least validation=validation.misfit
        validation_at_least validation_traces=validation.traces noise_sources=noise.sources noise_colour=noise.colour
        noise_log_std=noise.log_std noise_units=noise.units noise_bounds=noise.bounds noise_growth?=noise.growth noise_named?=noise.named
        interval_kind=uncertainty.kind inflation=uncertainty.inflation reach?=uncertainty.reach discretisation_shift=discretisation.shift
        tied=constraints.tied ties=constraints.ties own=constraints.per_experiment priors=constraints.priors loss=robust.name
        loss_scale=robust.scale outliers=robust.outliers ends=starts process_noise=prediction.process_noise
        prediction=prediction.one_step log_likelihood=prediction.log_likelihood
        """

    def __reduce__(self) -> tuple[Any, ...]:
        # Models are made of functions, which are packed as they are for another process.
        return unpack_fit, (pack(super().__reduce__()),)

    @property
    def success(self) -> bool:
        """Whether the search ended at an optimum."""
        return self.solver.success

    @property
    def judged_misfit(self) -> Mapping[str, result_parts.Misfit]:
        """What the model is judged by: its free run, or the prediction that its process noise corrects."""
        return self.prediction.one_step if self.prediction.process_noise else self.misfit

    @cached_property
    def judges_validation(self) -> bool:
        """Whether validation records judge it: none that is fitted too does.

        Nor do any the mean of constants that each record has for itself, or a predicting model.
        """
        if self.constraints.per_experiment or self.prediction.process_noise:
            return False
        fitted, others = ([trace.experiment for trace in traces] for traces in (self.traces, self.validation.traces))
        used = {id(shared.second) for shared in find_shared_readings(others, fitted)}
        return len(used) < len(others)

    @property
    def explains_records(self) -> bool:
        """Whether no error is above its noise, on the fitted records and on those that judge: ``success`` is no word on that."""
        judged = self.validation.misfit if self.judges_validation else {}
        misfits = (*self.judged_misfit.values(), *judged.values())
        # A run that fails has no error; without a noise the ratio is infinite.
        return all(math.isfinite(m.rmse) and not (self.is_above_noise(m) and m.noise_ratio < math.inf) for m in misfits)

    def is_above_noise(self, misfit: result_parts.Misfit) -> bool:
        """Whether an error is more than noise. Nothing stands above a noise that is the residual's own: what the model follows tells."""
        is_own = misfit.source is NoiseSource.RESIDUAL and not self.prediction.process_noise
        return misfit.noise_ratio > GOOD_MISFIT or (is_own and misfit.best_fit_percent < FOLLOWED_PERCENT)

    @property
    def worse_than_constant(self) -> tuple[str, ...]:
        """Outputs above their noise that their own mean would follow better than the model: an optimum that describes nothing."""
        return tuple(n for n, m in self.judged_misfit.items() if m.best_fit_percent < 0 and self.is_above_noise(m))

    @property
    def status(self) -> str:
        """How the search ended, in a word."""
        return self.solver.status

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(map(str, self.findings))

    @property
    def misfit_at_least(self) -> dict[str, float]:
        """How many times the noise each error is at least, of the outputs whose noise has no more than a ceiling."""
        return _least_ratios(self.noise, self.misfit)

    @property
    def validation_at_least(self) -> dict[str, float]:
        """The same on the validation records."""
        return _least_ratios(self.noise, self.validation.misfit)


def unpack_fit(data: bytes) -> Fit:
    """The fit that was pickled."""
    rebuild, values = unpack(data)
    return cast(Fit, rebuild(*values))


def _least_ratios(noise: result_parts.FitNoise, misfit: Mapping[str, result_parts.Misfit]) -> dict[str, float]:
    # A file of an older version holds no more than the rms.
    known = {
        n: m if m.noise is not None else replace(m, noise_ratio=1.0, noise=m.rmse).over(noise, n)
        for n, m in misfit.items()
    }
    return {name: m.noise_ratio for name, m in known.items() if m.direction is BoundDirection.AT_MOST}


def load_fit(path: str | Path, model: Model | Plant, *, insist: bool = False) -> Fit:
    """Read a fit that `Fit.save` wrote, without loss.

    The file keeps what its model stated: equations, units, bounds, constants. A model that states something else is refused.

    Parameters
    ----------
    path
        The ``fit.json``.
    model
        States the equations, effects included, or the plant; it gets the fitted values.
    insist
        Take ``model`` although it is not the one that was fitted; `Fit.findings` then says what differs.

    Returns
    -------
    Fit
        The fit as it was saved.

    Raises
    ------
    DataError
        If the file is not a fit, or belongs to another model: what differs, as it was fitted and as it is now.

    Examples
    --------
    >>> load_fit("results/fit.json", micro_actuator).parameters["K"].value  # doctest: +SKIP
    5895.47
    """
    return restore_fit(read_json(path, Fit), as_model(model), str(path), insist=insist)


def restore_fit(data: Mapping[str, Any], model: Model, source: str, *, insist: bool = False) -> Fit:
    """A fit from the content of its file, which `greybox.base.json_file.read_json` has checked. Raises DataError that names ``source``."""
    if data["model"] != model.name or data["effects"] != [e.name for e in model.effects]:
        title = " + ".join([data["model"], *data["effects"]])
        raise DataError(f"{source}: belongs to the model {shorten(title)}, not to {model.title}; give that model")
    contradiction = _find_contradiction(data)
    if contradiction:
        raise DataError(f"{source}: {contradiction}; give the fit.json that greybox fit has written")
    try:
        return _restore_fit(data, model, insist)
    except GreyboxError as error:
        raise DataError(f"{source}: {error}") from error
    except (TypeError, ValueError, LookupError, AttributeError, ArithmeticError) as error:
        reason = shorten(f"{type(error).__name__}: {error}", 100)
        raise DataError(
            f"{source}: its entries contradict one another ({reason}); give the fit.json that greybox fit has written"
        ) from error


def _find_contradiction(data: Mapping[str, Any]) -> str:
    """What cannot be together in a fit, though each of it may be; "" where all is well."""
    free = len(data["free"])
    if [len(row) for row in data["covariance"]] != [free] * free:
        return f"covariance is no matrix of {free} rows and columns, one for each name in free"
    if not set(data["free"]) <= set(data["parameters"]):
        return "free names a parameter that parameters does not"
    if set(data.get("tied", {})) != set(data.get("ties", {})):
        return "tied and ties do not name the same parameters"
    for key in (
        "noise_sources",
        "noise_colour",
        "noise_log_std",
        "noise_units",
        "noise_bounds",
        "noise_growth",
        "noise_named",
    ):
        if not set(data.get(key, {})) <= set(data["noise"]):
            return f"{key} names an output that noise does not"
    if set(data.get("noise_log_std", {})) - set(data.get("noise_units", {})):
        return "noise_log_std names an output that noise_units does not"
    for place, unit in _list_units(data):
        try:
            parse_unit(unit)
        except ModelError as error:
            return f"{place}: {error}"
    for key in ("traces", "validation_traces"):
        for k, trace in enumerate(data.get(key, ())):
            for group in ("measured", "simulated", "inputs", "noise"):
                for name, values in trace.get(group, {}).items():
                    if len(values) != len(trace["time"]):
                        rows = f"{len(values)} rows, its time {len(trace['time'])}"
                        return f"{key}[{k}].{group}.{shorten(name)} has {rows}"
            inputs, outputs = (
                {name: np.array(values, dtype=float) for name, values in trace.get(group, {}).items()}
                for group in ("inputs", "measured")
            )
            problems = find_array_problems(np.array(trace["time"], dtype=float), inputs, outputs, RowLabels())
            if problems:
                return f"{key}[{k}]: {problems[0]}"
    return ""


def _list_units(data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Place and text of every unit."""
    groups = {key: data.get(key, {}) for key in ("parameters", "tied", "misfit", "validation", "prediction")}
    for key, group in (groups | {f"own.{name}": group for name, group in data.get("own", {}).items()}).items():
        yield from ((f"{key}.{shorten(name)}", each["unit"]) for name, each in group.items())
    yield from ((f"noise_units.{shorten(name)}", unit) for name, unit in data.get("noise_units", {}).items())


def join_definition(data: Mapping[str, Any], model: Model, *, insist: bool = False) -> tuple[Finding, ...]:
    """Join the content of a result, ``fit.json`` or ``discovery.json``, with a model of today.

    Parameters
    ----------
    data
        Its ``equations``, ``declared`` and ``parameters``.
    model
        The model with the effects and ties of the result.
    insist
        Take the model although it differs.

    Returns
    -------
    tuple of Finding
        What differs, where ``insist`` takes it; and known constants that have another value now, in whose place the result keeps its own.

    Raises
    ------
    DataError
        For a model that states something else, with each line as it was fitted and as it is now.
    """
    units = {name: each["unit"] for name, each in data["parameters"].items()}
    differences = compare_definition(model, data.get("equations", ""), data.get("declared", {}), units)
    if differences and not insist:
        lines = "".join(
            f"\n  fitted: {shorten(d.stored, 300) or '-'}\n  now:    {d.present or '-'}" for d in differences
        )
        raise DataError(
            f"the model {model.title} is not the one that was fitted: repeat the fit, give the model as it was, or insist on this one"
            f" (--model, insist=True){lines}"
        )
    findings = [
        Finding(
            ResultCode.OTHER_MODEL, Severity.WARNING, model.title, {"fitted": shorten(d.stored, 300), "now": d.present}
        )
        for d in differences
    ]
    # A value may have been fixed for that fit alone, which is no reason to refuse the model.
    for q in (q for q in model.all_parameters if q.fixed):
        fitted = data["parameters"].get(q.name, {})
        if fitted.get("fixed") and fitted["value"] != q.value:
            values = {"fitted": fitted["value"], "now": q.value, "unit": q.unit}
            findings.append(Finding(ResultCode.OTHER_CONSTANT, subject=q.name, values=values))
    return tuple(findings)


def _restore_fit(data: Mapping[str, Any], model: Model, insist: bool) -> Fit:
    """The fit that ``data`` holds; a model with other ties is refused with DataError."""
    parameters = result_parts.Estimates(
        {n: from_json_data(result_parts.Estimate, e) for n, e in data["parameters"].items()}
    )
    # Process noise of the fit, where it was added to the model (`Model.with_process_noise`).
    states = [s for s in data.get("process_noise", {}) if s in model.system.state_names and s not in model.noisy_states]
    estimated = [s for s in states if intensity_name(s) in data["parameters"] and intensity_name(s) not in model.values]
    known = {
        s: data["process_noise"][s] for s in states if s not in estimated and intensity_name(s) not in model.values
    }
    model = model.with_process_noise(*estimated, **known) if states else model
    ties, stated = dict(data.get("ties", {})), {tie.name: tie.formula for tie in model.ties}
    if stated and stated != ties:
        text = ", ".join(f"{name} = {formula}" for name, formula in ties.items()) or "none"
        raise DataError(f"it has other ties than the model ({text}); give the model without ties, or with these")
    model = model if stated or not ties else model.start(**_known(model, data)).with_ties(ties)
    differences = join_definition(data, model, insist=insist)
    # Of a constant that each experiment has for itself the label is 'B (day 1)'.
    priors = {label.partition(" (")[0]: (c["mean"], c["std"]) for label, c in data.get("priors", {}).items()}
    model = model.prior(**priors) if priors else model
    fixed = [n for n, e in parameters.items() if e.fixed]
    fitted = model.free(*(n for n, e in parameters.items() if not e.fixed)).fix(*fixed)
    given: dict[str, Any] = {
        "parameters": parameters,
        "model": fitted.start(**{n: e.value for n, e in parameters.items()}),
        "solver.statistics": {name: value for name, value in data.get("solver", {}).items() if name != "strategy"},
        "solver.strategy": _finding(data["search"]) if data.get("search") else None,
        "solver.details": tuple(map(_finding, data.get("status_details", ()))),
        "provenance.options": result_parts.restore_options(data.get("options", {})),
        "findings": (*differences, *(f for f in map(_finding, data.get("findings", ())) if f not in differences)),
    }
    return from_json_data(Fit, data, given)


def _finding(data: Mapping[str, Any]) -> Finding:
    """A finding; one that this version has no sentence for is named by its code."""
    finding = from_json_data(Finding, data)
    try:
        str(finding)
    # A sentence takes figures as it needs them: one that is missing, of another type or zero.
    except (GreyboxError, LookupError, TypeError, ValueError, AttributeError, ArithmeticError):
        code = shorten(data["code"])
        return Finding(ResultCode.FOREIGN_FINDING, finding.severity, shorten(finding.subject), {"code": code})
    return finding


def _known(model: Model, data: Mapping[str, Any]) -> dict[str, float]:
    """The fitted values of the constants that ``model`` has."""
    return {n: e["value"] for n, e in data["parameters"].items() if n in model.values}
