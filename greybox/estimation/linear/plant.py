"""What is exported: a model with its constants, and where these come from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from greybox.base.errors import ModelError
from greybox.base.findings import Finding, Severity
from greybox.base.units import format_unit
from greybox.estimation.linear.findings import ExportFinding
from greybox.estimation.result import Fit
from greybox.model.model import Model


@dataclass(frozen=True)
class Plant:
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
        if self.fit is None or not self.fit.traces:
            return None
        return self.fit.traces[0].experiment.sampling_time

    def provenance(self, name: str) -> str:
        """Where the value of a constant comes from, in a line."""
        parameter = self.model.parameter(name)
        estimate = self.fit.parameters.get(name) if self.fit else None
        if estimate is None:
            return parameter.source or "as stated in the model"
        if estimate.fixed:
            return f"known: {parameter.source}" if parameter.source else "known"
        if estimate.std is None or estimate.interval is None:
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
        lines = [f"greybox {_version()}, model {self.model.title}"]
        if self.fit is not None:
            records = ", ".join(f"{t.name} ({t.fingerprint})" for t in self.fit.traces)
            lines += [f"fitted to {records}", f"fit: {self.fit.solver.status_message}"]
        return tuple(lines)


def to_plant(source: Fit | Model) -> Plant:
    """The plant behind a fit or a model. Raises ModelError for anything that is neither."""
    if isinstance(source, Fit):
        values = {"status": str(source.status)}
        failed = () if source.success else (Finding(ExportFinding.FIT_FAILED, Severity.ERROR, values=values),)
        return Plant(source.model, source, failed)
    if isinstance(source, Model):
        return Plant(source)
    raise ModelError(f"{source!r} cannot be exported; give a fit (gb.fit, gb.load_fit, discovery.best) or a model")


def format_signals(names: Sequence[str], values: Sequence[float] | np.ndarray, units: Sequence[str]) -> str:
    """``x = 1e-05 m, u = 0.5 V``."""
    return ", ".join(f"{n} = {v:.6g} {format_unit(u)}".rstrip() for n, v, u in zip(names, values, units, strict=True))


def _version() -> str:
    try:
        return version("greybox-sysid")
    except PackageNotFoundError:
        return "(from its source)"
