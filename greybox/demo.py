"""The demonstration: a rig that is not there is measured, and its constants come back with their intervals."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from greybox.experiment import read_csv
from greybox.figures import fit_figure
from greybox.fitting import fit
from greybox.fitting.options import Report
from greybox.model import Model
from greybox.project import shipped
from greybox.result import Fit
from greybox.simulation import chirp, multisine, write_csv
from greybox.twin import twin
from greybox.units import tidy

MODEL = "micro_actuator"
SAMPLING_TIME, ROWS, CHECK_ROWS = 2.5e-4, 6000, 3000  # 4 kHz: 1.5 s to fit, 0.75 s to judge
BAND = (5.0, 800.0)  # Hz: from below the mechanism's resonance at 122 Hz to where the inductance shows
VOLTAGE = 2.0  # V, rms of the multisine and amplitude of the sweep
NOISE = {"x": 0.2e-6, "i": 5e-3}  # m, A
KNOWN = ("M", "Ra")  # weighed, and measured with a multimeter
OFF = 0.4  # the search starts this share above or below the truth
SEED = 20100


@dataclass(frozen=True)
class Demo:
    """What was done: ``fit``, ``truth`` and ``start`` of each free constant, files written, seconds in all."""

    fit: Fit
    truth: Mapping[str, float]
    start: Mapping[str, float]
    records: tuple[Path, ...]
    result: Path
    figures: tuple[Path, ...]
    seconds: float

    @property
    def deviations(self) -> dict[str, float]:
        """Error of each constant in its own standard deviations (NaN where the fit gives none)."""
        found = {name: self.fit.parameters[name] for name in self.truth}
        return {name: (e.value - self.truth[name]) / (e.std or np.nan) for name, e in found.items()}

    def __str__(self) -> str:
        rows = [["constant", "true", "start", "found", "std", "off by", "unit"]]
        for name, truth in self.truth.items():
            e = self.fit.parameters[name]
            std = "" if e.std is None else f"{e.std:.2g}"
            rows.append(
                [
                    name,
                    f"{truth:.6g}",
                    f"{self.start[name]:.4g}",
                    f"{e.value:.6g}",
                    std,
                    f"{abs(self.deviations[name]):.1f} std",
                    tidy(e.unit),
                ]
            )
        widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        table = ["  " + "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]
        judged = self.fit.validation
        misfit = [
            f"  {o}: {m.noise_ratio:.3f} x noise on the fitted record, {judged[o].noise_ratio:.3f} x noise on the other"
            for o, m in self.fit.misfit.items()
            if o in judged
        ]
        return "\n".join([*table, "", "misfit of the free run (1 = only noise is left)", *misfit])


def demo(directory: str | Path, *, report: Report | None = None, say: Callable[[str], None] | None = None) -> Demo:
    """Measure a simulated micro-motion actuator, fit it from a start 40 % off, and judge it on another record.

    The records come from `greybox.twin`, an integrator that the fit does not use, with white noise; they are written to
    ``directory`` as CSV and read back, as a user's would be. ``say`` is told, a line at a time, what happens next.
    """
    began, folder = time.perf_counter(), Path(directory)
    tell = say or (lambda _: None)
    model = shipped(MODEL)
    tell("measuring the rig (a simulation by CVODES, with sensor noise)")
    records = _measure(model, folder)
    known = model.fix(*KNOWN)
    truth = {q.name: q.value for q in known.free_parameters}
    start = {name: value * (1 + OFF * (-1) ** k) for k, (name, value) in enumerate(truth.items())}
    train, test = (read_csv(path, known) for path in records)
    tell(f"fitting {', '.join(truth)} from {train.rows} rows; {' and '.join(KNOWN)} are known")
    result = fit(known.start(**start), train, noise=NOISE, validation=test, report=report)
    saved = result.save(folder / "fit.json")
    tell("drawing")
    figures = fit_figure(result, folder)
    return Demo(result, truth, start, records, saved, tuple(figures), time.perf_counter() - began)


def _measure(model: Model, folder: Path) -> tuple[Path, Path]:
    """Two records of the rig: one to fit, one to judge."""
    generator = np.random.default_rng(SEED)
    (drive,) = (i.name for i in model.inputs)
    t = SAMPLING_TIME * np.arange(ROWS)
    inputs = {"multisine": multisine(t, *BAND, VOLTAGE, generator), "sweep": chirp(t[:CHECK_ROWS], *BAND, VOLTAGE)}
    paths = []
    for k, (name, u) in enumerate(inputs.items()):
        record = twin(model, {drive: u}, SAMPLING_TIME, NOISE, SEED + k, name=name)
        paths.append(write_csv(record, model, folder / f"{name}.csv"))
    return paths[0], paths[1]
