"""The data of a page: which records, what they hold, and their fingerprints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.model import Model
from greybox.plots.scaling import scale_to_prefix
from greybox.rendering.english import join_names, phrase
from greybox.rendering.reports import PageText
from greybox.reports.page import PageTable, Section
from greybox.reports.typography import format_range
from greybox.result import Fit, Trace
from greybox.simulation import Simulation

HEAD = ["record", "use", "rows", "duration", "sampling time", "missing values", "fingerprint"]


def records_section(fitted: Sequence[Trace], validation: Sequence[Trace], fit: Fit) -> Section:
    """Names, lengths, gaps and fingerprints of the records, and what their columns hold."""
    rows = [*(_record(t, "fitted") for t in fitted), *(_record(t, "validation") for t in validation)]
    note = phrase(PageText.NOISE_SOURCE, source=fit.noise.source)
    records = PageTable(phrase(PageText.RECORDS), HEAD, rows, note)
    return Section("data", [records, _signals([*fitted, *validation], fit)])


def hidden_states(run: Simulation) -> dict[str, np.ndarray]:
    """The states of a run that no output of the same name shows already."""
    return {
        name: values
        for name, values in run.states.items()
        if name not in run.outputs or not np.array_equal(run.outputs[name], values)
    }


def _record(trace: Trace, use: str) -> list[str]:
    missing = {name: int(np.isnan(v).sum()) for name, v in trace.measured.items()}
    gaps = join_names([f"{count} of {name}" for name, count in missing.items() if count])
    return [
        trace.name,
        use,
        str(len(trace.time)),
        f"{trace.time[-1] - trace.time[0]:.6g} s",
        format_sampling_time(trace.time),
        gaps or "none",
        trace.fingerprint[:12],
    ]


def format_sampling_time(time: np.ndarray) -> str:
    """The sampling time, or its range where it varies."""
    steps = np.diff(time)
    if not len(steps):
        return ""
    even = float(np.ptp(steps)) < 1e-6 * float(steps.mean())
    return f"{float(steps.mean()):.6g} s" if even else f"{float(steps.min()):.4g} to {float(steps.max()):.4g} s"


def signal_units(model: Model) -> dict[str, str]:
    """Unit of each output and input."""
    return {o.name: o.unit for o in model.outputs} | {i.name: i.unit for i in model.inputs}


def _signals(traces: Sequence[Trace], fit: Fit) -> PageTable:
    rows = []
    for use, signals in (("input", fit.model.inputs), ("measured", fit.model.outputs)):
        for signal in signals:
            groups = [t.inputs if use == "input" else t.measured for t in traces]
            values = [np.asarray(g[signal.name]) for g in groups if signal.name in g]
            std = fit.noise.std.get(signal.name) if use == "measured" else None
            every = np.concatenate(values) if values else np.array([])
            factor, unit = scale_to_prefix(signal.unit, every)
            noise = f"{factor * std:.3g} {unit}" if std is not None and np.isfinite(std) else ""
            limits = f"{format_range(factor * every)} {unit}" if values else "not recorded"
            rows.append([signal.name, use, limits, noise])
    return PageTable(phrase(PageText.SIGNALS), ["signal", "use", "from … to", "noise (std)"], rows)
