"""Codes of what can be said of a result that was read; the sentences are in ``greybox.show.sentences.estimation``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from greybox.base.errors import DataError, GreyboxError, ModelError, shorten
from greybox.base.files import write_file
from greybox.base.findings import Finding, Severity
from greybox.base.json_file import ResultKind, read_json
from greybox.base.units import parse_unit
from greybox.base.values import Printable, ReadOnly
from greybox.data.noise.growing import GrowingNoise
from greybox.data.noise.noise_model import BoundDirection, NoiseBound, NoiseSource
from greybox.data.problems import RowLabels, find_array_problems
from greybox.estimation.result_parts import (
    Estimate,
    FitConstraints,
    FitDiscretisation,
    FitNoise,
    FitUncertainty,
    IntervalKind,
    Misfit,
    PredictionReport,
    PriorCheck,
    Provenance,
    RobustReport,
    SolverReport,
    StartResult,
    Trace,
    Validation,
    iterate_json,
)
from greybox.model.model import Model
from greybox.model.process_noise import intensity_name


class ResultCode(StrEnum):
    """Codes of the findings of a saved result."""

    FOREIGN_FINDING = "foreign_finding"
    """A finding in a file whose code or figures this version does not know."""


# A fit as a value, and as a file ``fit.json`` that is written and read without loss.

FORMAT = 1
"""Version of ``fit.json``. Its keys are flat and stay the same from version to version."""

# Names of options whose key in the file is older, and back.
_OPTION_KEYS = {"per_experiment": "own"}
_OPTION_NAMES = {key: name for name, key in _OPTION_KEYS.items()}


@dataclass(frozen=True)
class Fit(Printable, ReadOnly):
    """A fitted model, read-only throughout.

    Attributes
    ----------
    model
        The model with the fitted values.
    parameters
        Name -> `Estimate`: value, standard deviation and 95 % interval.
    misfit, traces
        Free-run error by output over the estimation records, and the runs.
    solver
        How the search ended; ``success`` and ``status`` stand there and as short cuts here.
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
    parameters: Mapping[str, Estimate]
    misfit: Mapping[str, Misfit]
    traces: Sequence[Trace]
    solver: SolverReport
    noise: FitNoise
    uncertainty: FitUncertainty
    discretisation: FitDiscretisation
    provenance: Provenance = field(default_factory=Provenance)
    validation: Validation = field(default_factory=Validation)
    constraints: FitConstraints = field(default_factory=FitConstraints)
    robust: RobustReport = field(default_factory=RobustReport)
    prediction: PredictionReport = field(default_factory=PredictionReport)
    starts: Sequence[StartResult] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def success(self) -> bool:
        """Whether the search ended at an optimum."""
        return self.solver.success

    @property
    def status(self) -> str:
        """How the search ended, in a word."""
        return self.solver.status

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(map(str, self.findings))

    def save(self, path: str | Path) -> Path:
        """Write ``fit.json``; `greybox.load_fit` reads it back without loss.

        Parameters
        ----------
        path
            Where to; folders are made.

        Returns
        -------
        Path
            The file that was written.
        """
        return save_fit(self, path)


def save_fit(fit: Fit, path: str | Path) -> Path:
    """Write ``fit`` to ``path`` (folders are made); numbers that are not finite become null."""
    return write_file(path, iterate_json(fit_data(fit)))


def fit_data(fit: Fit) -> dict[str, Any]:
    """``fit`` under the keys of ``fit.json``, which are flat and stay the same from version to version."""
    strategy = fit.solver.strategy
    return {
        "format": FORMAT,
        "model": fit.model.name,
        "effects": [e.name for e in fit.model.effects],
        "status": fit.solver.status,
        "success": fit.solver.success,
        "meaning": fit.solver.status_message,
        "parameters": fit.parameters,
        "misfit": fit.misfit,
        "traces": fit.traces,
        "free": fit.uncertainty.free,
        "covariance": fit.uncertainty.covariance,
        "noise": fit.noise.std,
        "noise_source": fit.noise.source,
        "discretisation": fit.discretisation.label,
        "integration_error": fit.discretisation.error,
        "cost": fit.solver.cost,
        "solver": {**fit.solver.statistics, "strategy": "" if strategy is None else str(strategy)},
        "options": {_OPTION_KEYS.get(name, name): value for name, value in fit.provenance.options.items()},
        "equations": fit.provenance.equations,
        "versions": fit.provenance.versions,
        "notes": fit.notes,
        "findings": fit.findings,
        "status_details": fit.solver.details,
        "search": strategy,
        "misfit_at_least": _least_ratios(fit, fit.misfit),
        "validation": fit.validation.misfit,
        "validation_at_least": _least_ratios(fit, fit.validation.misfit),
        "validation_traces": fit.validation.traces,
        "noise_sources": fit.noise.sources,
        "noise_colour": fit.noise.colour,
        "noise_log_std": fit.noise.log_std,
        "noise_units": fit.noise.units,
        "noise_bounds": {name: asdict(bound) for name, bound in fit.noise.bounds.items()},
        "noise_growth": {name: asdict(growth) for name, growth in fit.noise.growth.items()},
        "interval_kind": fit.uncertainty.kind,
        "inflation": fit.uncertainty.inflation,
        "discretisation_shift": fit.discretisation.shift,
        "tied": fit.constraints.tied,
        "ties": fit.constraints.ties,
        "own": fit.constraints.per_experiment,
        "priors": {name: _prior_data(check) for name, check in fit.constraints.priors.items()},
        "loss": fit.robust.name,
        "loss_scale": fit.robust.scale,
        "outliers": fit.robust.outliers,
        "ends": fit.starts,
        "process_noise": fit.prediction.process_noise,
        "prediction": fit.prediction.one_step,
        "log_likelihood": fit.prediction.log_likelihood,
    }


def _least_ratios(fit: Fit, misfit: Mapping[str, Misfit]) -> dict[str, float]:
    """How many times the noise each error is at least, of the outputs whose noise has no more than a ceiling."""
    bounds = {name: fit.noise.bound(name) for name in misfit}
    ratios = {name: bound.least_ratio(misfit[name].rmse) for name, bound in bounds.items() if bound is not None}
    return {name: ratio for name, ratio in ratios.items() if ratio is not None}


def load_fit(path: str | Path, model: Model) -> Fit:
    """Read a fit that `Fit.save` wrote.

    Parameters
    ----------
    path
        The ``fit.json``.
    model
        States the equations, effects included; it gets the fitted values.

    Returns
    -------
    Fit
        The fit as it was saved.

    Raises
    ------
    DataError
        If the file is not a fit, or belongs to another model.

    Examples
    --------
    >>> load_fit("results/fit.json", micro_actuator).parameters["K"].value  # doctest: +SKIP
    5895.47
    """
    return restore_fit(read_json(path, ResultKind.FIT), model, str(path))


def restore_fit(data: Mapping[str, Any], model: Model, source: str) -> Fit:
    """A fit from the content of its file, which `greybox.base.json_file.read_json` has checked. Raises DataError that names ``source``."""
    if data["model"] != model.name or data["effects"] != [e.name for e in model.effects]:
        title = " + ".join([data["model"], *data["effects"]])
        raise DataError(f"{source}: belongs to the model {shorten(title)}, not to {model.title}; give that model")
    contradiction = _find_contradiction(data)
    if contradiction:
        raise DataError(f"{source}: {contradiction}; give the fit.json that greybox fit has written")
    try:
        return _restore_fit(data, model)
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
    if set(data.get("tied", {})) != set(data.get("ties", {})):
        return "tied and ties do not name the same parameters"
    for key in ("noise_sources", "noise_colour", "noise_log_std", "noise_units", "noise_bounds", "noise_growth"):
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
        for k, trace in enumerate(data[key]):
            for group in ("measured", "simulated", "inputs", "noise"):
                for name, values in trace.get(group, {}).items():
                    if len(values) != len(trace["time"]):
                        rows = f"{len(values)} rows, its time {len(trace['time'])}"
                        return f"{key}[{k}].{group}.{shorten(name)} has {rows}"
            inputs, outputs = (
                {name: _array(values) for name, values in trace.get(group, {}).items()}
                for group in ("inputs", "measured")
            )
            problems = find_array_problems(_array(trace["time"]), inputs, outputs, RowLabels())
            if problems:
                return f"{key}[{k}]: {problems[0]}"
    return ""


def _list_units(data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Place and text of every unit."""
    groups = {key: data.get(key, {}) for key in ("parameters", "tied", "misfit", "validation", "prediction")}
    for key, group in (groups | {f"own.{name}": group for name, group in data.get("own", {}).items()}).items():
        yield from ((f"{key}.{shorten(name)}", each["unit"]) for name, each in group.items())
    yield from ((f"noise_units.{shorten(name)}", unit) for name, unit in data.get("noise_units", {}).items())


def _restore_fit(data: Mapping[str, Any], model: Model) -> Fit:
    parameters = _estimates(data["parameters"])
    fixed = [n for n, e in parameters.items() if e.fixed]
    model = _restore_constraints(_restore_process_noise(model, data), data)
    fitted = model.free(*(n for n, e in parameters.items() if not e.fixed)).fix(*fixed)
    fitted = fitted.start(**{n: e.value for n, e in parameters.items()})
    get = data.get  # the first files of this format lack some of the keys
    return Fit(
        model=fitted,
        parameters=parameters,
        misfit=_misfits(data["misfit"]),
        traces=_traces(data["traces"]),
        solver=SolverReport(
            data["status"],
            data["success"],
            _number(data["cost"]),
            {name: value for name, value in data["solver"].items() if name != "strategy"},
            _finding(data["search"]) if get("search") else None,
            _findings(get("status_details", ())),
        ),
        noise=FitNoise(
            _numbers(data["noise"]),
            {name: NoiseSource(source) for name, source in get("noise_sources", {}).items()},
            {n: tuple(k) for n, k in get("noise_colour", {}).items()},
            _numbers(get("noise_log_std", {})),
            dict(get("noise_units", {})),
            {
                name: NoiseBound(
                    float(b["level"]),
                    BoundDirection(b["direction"]),
                    NoiseSource(b["source"]),
                    b["correlation_time"],
                    float(b["relative_error"]),
                )
                for name, b in get("noise_bounds", {}).items()
            },
            {
                name: GrowingNoise(g["floor"], g["share"], g["logarithmic"], tuple(g["estimated"]))
                for name, g in get("noise_growth", {}).items()
            },
        ),
        uncertainty=FitUncertainty(
            tuple(data["free"]),
            _array(data["covariance"]).reshape(len(data["free"]), len(data["free"])),
            IntervalKind(get("interval_kind", "gauss_newton")),
            _numbers(get("inflation", {})),
        ),
        discretisation=FitDiscretisation(
            data["discretisation"], _numbers(data["integration_error"]), _numbers(get("discretisation_shift", {}))
        ),
        provenance=Provenance(
            {_OPTION_NAMES.get(key, key): value for key, value in data["options"].items()},
            data["equations"],
            data["versions"],
        ),
        validation=Validation(_misfits(data["validation"]), _traces(data["validation_traces"])),
        constraints=FitConstraints(
            dict(get("ties", {})),
            _estimates(get("tied", {})),
            {name: _estimates(each) for name, each in get("own", {}).items()},
            {name: _prior_check(each) for name, each in get("priors", {}).items()},
        ),
        robust=RobustReport(get("loss", ""), _numbers(get("loss_scale", {})), _numbers(get("outliers", {}))),
        prediction=PredictionReport(
            _numbers(get("process_noise", {})), _misfits(get("prediction", {})), get("log_likelihood")
        ),
        starts=tuple(
            StartResult(
                **_pick(StartResult, {**e, "noise_ratio": math.inf if e["noise_ratio"] is None else e["noise_ratio"]})
            )
            for e in get("ends", ())
        ),
        findings=_findings(get("findings", ())),
    )


def _findings(data: Sequence[Mapping[str, Any]]) -> tuple[Finding, ...]:
    return tuple(map(_finding, data))


def _finding(data: Mapping[str, Any]) -> Finding:
    """A finding; one that this version has no sentence for is named by its code."""
    finding = Finding(data["code"], Severity(data["severity"]), data["subject"], data["values"])
    try:
        str(finding)
    except Exception:  # templates take figures as they need them: a missing or foreign one fails in many ways
        code = shorten(data["code"])
        return Finding(ResultCode.FOREIGN_FINDING, finding.severity, shorten(data["subject"]), {"code": code})
    return finding


def _prior_data(check: PriorCheck) -> dict[str, float | None]:
    return {
        "mean": check.mean,
        "std": check.std,
        "moved": check.shift,
        "learnt": check.variance_reduction,
        "conflict": check.conflict,
    }


def _prior_check(data: Mapping[str, Any]) -> PriorCheck:
    return PriorCheck(data["mean"], data["std"], _number(data["moved"]), data["learnt"], data["conflict"])


def _restore_process_noise(model: Model, data: Mapping[str, Any]) -> Model:
    """``model`` with the process noise of a fit, where it was added to it (`Model.with_process_noise`)."""
    states = [s for s in data.get("process_noise", {}) if s in model.system.state_names and s not in model.noisy_states]
    estimated = [s for s in states if intensity_name(s) in data["parameters"] and intensity_name(s) not in model.values]
    known = {
        s: data["process_noise"][s] for s in states if s not in estimated and intensity_name(s) not in model.values
    }
    return model.with_process_noise(*estimated, **known) if states else model


def _restore_constraints(model: Model, data: Mapping[str, Any]) -> Model:
    """``model`` with the ties and priors of a fit; a model with other ties is refused with DataError."""
    ties = dict(data.get("ties", {}))
    stated = {tie.name: tie.formula for tie in model.ties}
    if stated and stated != ties:
        text = ", ".join(f"{name} = {formula}" for name, formula in ties.items()) or "none"
        raise DataError(f"it has other ties than the model ({text}); give the model without ties, or with these")
    model = model if stated or not ties else model.start(**_known(model, data)).with_ties(ties)
    # Of a constant that each experiment has for itself the label is 'B (day 1)'.
    priors = {label.partition(" (")[0]: (c["mean"], c["std"]) for label, c in data.get("priors", {}).items()}
    return model.prior(**priors) if priors else model


def _known(model: Model, data: Mapping[str, Any]) -> dict[str, float]:
    """The fitted values of the constants that ``model`` has."""
    return {n: e["value"] for n, e in data["parameters"].items() if n in model.values}


def _estimates(data: Mapping[str, dict]) -> dict[str, Estimate]:
    return {n: Estimate(**_pick(Estimate, {**e, "interval": _pair(e["interval"])})) for n, e in data.items()}


def _pick(kind: type, data: Mapping[str, Any]) -> dict[str, Any]:
    """The entries that ``kind`` knows: a later version may have written more."""
    names = {field.name for field in fields(kind)}
    return {name: value for name, value in data.items() if name in names}


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _numbers(values: Mapping[str, float | None]) -> dict[str, float]:
    return {name: _number(value) for name, value in values.items()}


def _pair(values: list | None) -> tuple[float, float] | None:
    if values is None:
        return None
    low, high = values
    return (-math.inf if low is None else low, math.inf if high is None else high)


def _array(values: list) -> np.ndarray:
    return np.array(values, dtype=float)  # None becomes NaN


def _misfits(data: Mapping[str, dict]) -> dict[str, Misfit]:
    return {
        o: Misfit(**_pick(Misfit, {**m, **{k: _number(m[k]) for k in ("rmse", "best_fit_percent", "noise_ratio")}}))
        for o, m in data.items()
    }


def _traces(data: Sequence[dict]) -> tuple[Trace, ...]:
    def arrays(group: Mapping[str, list]) -> dict[str, np.ndarray]:
        return {name: _array(values) for name, values in group.items()}

    return tuple(
        Trace(
            t["name"],
            t["fingerprint"],
            _array(t["time"]),
            arrays(t["measured"]),
            arrays(t["simulated"]),
            t["initial_state"],
            arrays(t.get("inputs", {})),
            t.get("hold", "zero"),
            t.get("conditions", {}),
            arrays(t.get("noise", {})),
        )
        for t in data
    )
