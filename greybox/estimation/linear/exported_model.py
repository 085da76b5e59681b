"""What is exported: a model with its constants, where these come from, and the codes of what there is to say about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from greybox.base import Finding, ModelError, Severity, format_unit
from greybox.base.extensions import read_greybox_version
from greybox.base.texts import to_word
from greybox.data.experiment import Experiment
from greybox.estimation.findings import EstimationCode
from greybox.estimation.result import Fit
from greybox.model import Model
from greybox.simulation.plant import Plant, PlantModel, as_model, is_plant
from greybox.simulation.simulate import declared_initial_state


class ExportFinding(StrEnum):
    """Findings about an exported model; their sentences are in `greybox.show.sentences.linear`."""

    FIT_FAILED = "exported_fit_failed"
    """The fit behind the model did not succeed."""
    NO_EQUILIBRIUM = "export_no_equilibrium"
    """The operating point is given in full and is no equilibrium."""
    STEADY_MOTION = "export_steady_motion"
    """A position moves at a constant rate at the operating point."""
    OUTSIDE_RECORDS = "export_outside_records"
    """The operating point lies far outside the estimation records."""
    FRICTION_LEFT_OUT = "export_friction_left_out"
    """Dry friction at standstill is not in the matrices."""
    KINK = "export_kink"
    """The derivative differs by side; one side was used."""
    PLAY_CLOSED = "export_play_closed"
    """Play is taken as closed."""
    INPUT_WITHOUT_EFFECT = "export_input_without_effect"
    """An input has no effect at the operating point."""
    DELAY_APPROXIMATED = "export_delay_approximated"
    """A delay became a Pade approximation."""
    STATES_REMOVED = "export_states_removed"
    """A minimal realisation has fewer states."""
    MODE_UNDERSAMPLED = "export_mode_undersampled"
    """The sampling time is too long for an oscillating mode."""
    DECAY_UNDERSAMPLED = "export_decay_undersampled"
    """Every mode decays within one sample."""
    TUSTIN_RINGS = "export_tustin_rings"
    """The trapezoidal rule turns a fast real pole into an alternating one."""
    INPUT_BETWEEN_ROWS = "export_input_between_rows"
    """An effect says what the input does between the rows of a record."""
    ABOUT_THE_MEANS = "export_about_the_means"
    """No point was asked for: the means of the inputs in the records are taken."""
    ABOUT_THE_BEGINNING = "export_about_the_beginning"
    """No point was asked for, and the plant does not rest at the means: the inputs at which a record begins are taken."""
    ABOUT_A_RUN = "export_about_a_run"
    """The linear model is the answer to small changes along a run of a plant without equations."""
    PARAMETERS_NOT_DRAWN = "export_parameters_not_drawn"
    """Parameters without a covariance keep their fitted value in a family of models."""


@dataclass(frozen=True)
class ExportedModel:
    """A model at its present values, and the fit that found them (None for a model as stated)."""

    model: Model
    fit: Fit | None = None
    findings: tuple[Finding, ...] = ()

    @property
    def p(self) -> np.ndarray:
        """Values of all constants (np,), in the order of ``model.system.p``."""
        return np.array(list(self.model.values.values()))

    @property
    def sampling_time(self) -> float | None:
        """Sampling time of the fitted records in seconds; None where there is none, or none that is uniform."""
        return self.record.sampling_time if self.record is not None else None

    @property
    def record(self) -> Experiment | None:
        """The first record over time that was fitted, which holds outputs of the model; None where there is none (frequency responses)."""
        traces, names = self.fit.traces if self.fit is not None else (), {o.name for o in self.model.outputs}
        return next((t.experiment for t in traces if names & {*t.measured}), None)

    @property
    def recorded_inputs(self) -> dict[str, list[np.ndarray]]:
        """Input -> its values (N,) in each record over time that was fitted; empty where no record has them all."""
        traces, names = self.fit.traces if self.fit is not None else (), [i.name for i in self.model.inputs]
        records = [t.experiment for t in traces if {*names} <= {*t.experiment.inputs}]
        return {name: [r.inputs[name] for r in records] for name in names} if records else {}

    def propose_point(self) -> str:
        """What to type for an operating point: where the first record begins; a state that was not recorded as the model declares it."""
        declared = dict(zip(self.model.system.state_names, declared_initial_state(self.model).tolist(), strict=True))
        recorded = {} if self.record is None else {**self.record.inputs, **self.record.outputs}
        read = {name: float(v[np.isfinite(v)][0]) for name, v in recorded.items() if np.isfinite(v).any()}
        # All of them: such a point is taken as it is, whether the plant rests there or not.
        point = {
            name: read.get(name, value) for name, value in (dict.fromkeys(self.recorded_inputs, 0.0) | declared).items()
        }
        if not self.recorded_inputs:
            return "give a point near it: at={NAME: VALUE, ...} (shell: --at NAME=VALUE)"
        written, typed = (
            ", ".join(f"{name!r}: {value:.6g}" for name, value in point.items()),
            " ".join(f"--at {to_word(f'{name}={value:.6g}')}" for name, value in point.items()),
        )
        return f"give another, such as the one where the records begin: at={{{written}}} (shell: {typed})"

    def provenance(self, name: str) -> str:
        """Where the value of a constant comes from, in a line."""
        parameter = self.model.parameter(name)
        estimate = self.fit.parameters.get(name) if self.fit else None
        if estimate is None:
            return parameter.source or "as stated in the model"
        if estimate.fixed:
            return f"known: {parameter.source}" if parameter.source else "known"
        if estimate.interval is None:
            return "fitted, not determined by the records"
        low, high = estimate.interval
        return f"fitted, 95 % interval [{low:.6g}, {high:.6g}]{', at its bound' if estimate.at_bound else ''}"

    def find_extrapolation(
        self, inputs: Mapping[str, float], outputs: Mapping[str, float], margin: float
    ) -> tuple[Finding, ...]:
        """A finding where an operating point lies outside the estimation records by more than ``margin`` of their range."""
        traces = self.fit.traces if self.fit else ()
        units = {i.name: i.unit for i in self.model.inputs} | {o.name: o.unit for o in self.model.outputs}
        outside = []
        for name, value in {**inputs, **outputs}.items():
            recorded = [t.inputs.get(name, t.simulated.get(name)) for t in traces]
            ranges = [(np.nanmin(values), np.nanmax(values)) for values in recorded if values is not None]
            if not ranges:
                continue
            low, high = float(min(r[0] for r in ranges)), float(max(r[1] for r in ranges))
            # A signal that never moved has no range to go by: its size stands for it.
            reach = margin * (high - low) if high > low else abs(high)
            if not low - reach <= value <= high + reach:
                unit = format_unit(units[name])
                outside.append({"name": name, "value": value, "unit": unit, "low": low, "high": high})
        if not outside:
            return ()
        return (Finding(ExportFinding.OUTSIDE_RECORDS, Severity.WARNING, values={"signals": outside}),)

    def origin(self) -> tuple[str, ...]:
        """Lines that say where the whole comes from: program, model, records, how the fit ended."""
        lines = [f"greybox {read_greybox_version('(from its source)')}, model {self.model.title}"]
        if self.fit is not None:
            records = ", ".join(f"{t.name} ({t.fingerprint})" for t in self.fit.traces)
            lines += [f"fitted to {records}", f"fit: {self.fit.solver.status_message}"]
        return tuple(lines)


# What a fit says of its constants that whoever uses the model without the fit has to know.
DOUBTS = (
    EstimationCode.NO_FREEDOM,
    EstimationCode.MODEL_DOES_NOT_FOLLOW,
    EstimationCode.DIRECTION_UNDETERMINED,
    EstimationCode.PARAMETER_UNDETERMINED,
)


def to_plant(source: Fit | Model | Plant, *, with_equations: bool = True) -> ExportedModel:
    """The plant behind a fit or a model. Raises ModelError for anything else, and where it has no equations and needs them."""
    source = as_model(source) if is_plant(source) else source
    if not isinstance(source, (Fit, Model)):
        raise ModelError(f"{source!r} cannot be exported; give a fit (gb.fit, gb.load_fit, discovery.best) or a model")
    model = source.model if isinstance(source, Fit) else source
    if isinstance(model, PlantModel) and model.equations is not None:
        model = model.equations
    if with_equations:
        model.require_equations("a linearisation or an export")
    # What is exported gets its input from elsewhere: how a record's went on between its rows is no part of it.
    findings = [
        Finding(ExportFinding.INPUT_BETWEEN_ROWS, Severity.WARNING, effect.name)
        for effect in model.effects
        if effect.is_of_record
    ]
    if isinstance(source, Model):
        return ExportedModel(model, findings=tuple(findings))
    if not source.success:
        findings.append(Finding(ExportFinding.FIT_FAILED, Severity.ERROR, values={"status": str(source.status)}))
    findings += [finding for finding in source.findings if finding.code in DOUBTS]
    return ExportedModel(model, source, tuple(findings))


def check_sampling_time(dt: Any) -> None:
    """Raises ModelError for a sampling time that is no number above zero."""
    if not isinstance(dt, int | float | np.number):
        raise ModelError(f"dt={dt!r} is no sampling time; give a number of seconds, such as dt=0.001")
    if not (np.isfinite(dt) and dt > 0):
        raise ModelError(f"sampling time {dt} s: give a time above 0 s")


def format_signals(names: Sequence[str], values: Sequence[float] | np.ndarray, units: Sequence[str]) -> str:
    """``x = 1e-05 m, u = 0.5 V``."""
    return ", ".join(f"{n} = {v:.6g} {format_unit(u)}".rstrip() for n, v, u in zip(names, values, units, strict=True))
