"""The demonstration: a rig that is not there hides an effect from its model; the effect is found, named and closes the gap."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from greybox.blackbox import BlackBoxKind, best_black_boxes
from greybox.comparison import Comparison, compare, save_comparison
from greybox.comparison.compare import ComparedModel
from greybox.discovery import Discovery, discover
from greybox.effects import effect
from greybox.estimation import FitOptions, fit
from greybox.experiment import Experiment, read_csv
from greybox.export import Linearisation, linearise
from greybox.export.linear_files import write_control
from greybox.model import Model
from greybox.plots import draw_fit, draw_gap
from greybox.project import find_shipped_model
from greybox.result import Estimate, Fit
from greybox.result.summary import format_table, format_with_std
from greybox.signals import chirp, multisine
from greybox.simulation import write_csv
from greybox.twin import simulate_twin
from greybox.units import format_unit

MODEL, HIDDEN = "micro_actuator", "cubic_stiffness"
STRENGTH = {"K3": 5e9}  # N/m^3: at full stroke the hinges push back by an eighth more than a straight spring would
SAMPLING_TIME, ROWS, CHECK_ROWS = 2.5e-4, 1200, 600  # 4 kHz: 0.3 s to learn from, 0.15 s to judge
BAND = (5.0, 400.0)  # Hz: from below the mechanism's resonance at 122 Hz to where the inductance shows
VOLTAGE = 2.0  # V, rms of the multisine and amplitude of the sweep
NOISE = {"x": 0.2e-6, "i": 5e-3}  # m, A
KNOWN = ("M", "Ra")  # weighed, and measured with a multimeter
START_ERROR = 0.4  # the search starts this share above or below the truth
SEED = 20100
BLACK = (BlackBoxKind.ARX, BlackBoxKind.OUTPUT_ERROR)
PLAIN, EXTENDED = "plain model", "with what was found"

Say = Callable[[str], None]


@dataclass(frozen=True)
class Demo:
    """What was done, step by step.

    ``truth`` of the rig's constants, the hidden effect's included; ``start`` of the search. ``plain``: the model's own fit;
    ``discovery``: what it lacks; ``comparison`` with black boxes on the other record; ``plant``: matrices of the extended model.
    ``records`` as files; ``files`` that were written beside them -> what they are; ``seconds`` in all.
    """

    truth: Mapping[str, float]
    start: Mapping[str, float]
    plain: Fit
    discovery: Discovery
    comparison: Comparison
    plant: Linearisation
    records: tuple[Path, ...]
    files: Mapping[Path, str]
    seconds: float

    @property
    def fit(self) -> Fit:
        """The model with the effect that was found."""
        return self.discovery.best

    @property
    def deviations(self) -> dict[str, float]:
        """Error of each constant that was found in its own standard deviations (NaN where the fit gives none)."""
        found = {name: self.fit.parameters[name] for name in self.truth if name in self.fit.parameters}
        return {name: (e.value - self.truth[name]) / (e.std or np.nan) for name, e in found.items()}

    def __str__(self) -> str:
        return "\n".join(
            [
                self.constants,
                "",
                self.discovery.story,
                *self._gaps(),
                "",
                *map(str, self.comparison.verdict[:1]),
                "",
                str(self.plant),
            ]
        )

    def _gaps(self) -> list[str]:
        return [
            f"  {o}: misfit on the other record {g.before:.3g} -> {g.after:.3g} {format_unit(g.unit)} (noise {g.floor:.3g})"
            for o, g in self.discovery.gap.items()
        ]

    @property
    def constants(self) -> str:
        """Each constant beside the truth: with the model as it was, and with the effect that was found."""
        rows = []
        for name, truth in self.truth.items():
            e = self.fit.parameters.get(name)
            before = self.plain.parameters.get(name)
            rows.append([
                name, f"{truth:.5g}", f"{self.start[name]:.4g}" if name in self.start else "", format_estimate(before), format_estimate(e),
                f"{abs(self.deviations[name]):.1f} std" if e else "", format_unit(e.unit) if e else "",
            ])  # fmt: skip
        head = ["constant", "true", "start", PLAIN, EXTENDED, "off by", "unit"]
        return "\n".join(format_table(head, rows))


def format_estimate(e: Estimate | None) -> str:
    """``value +- std``; empty where a model lacks the constant."""
    return "" if e is None else format_with_std(e.value, e.std or 0.0)


def run_demo(directory: str | Path, *, say: Say | None = None, report: Callable[[int], None] | None = None) -> Demo:
    """Measure a simulated micro-motion actuator whose spring hardens, and let the program find that out.

    The records come from `greybox.twin`, an integrator that the fits do not use, with white noise; they are written to
    ``directory`` as CSV and read back, as a user's would be. The model that is fitted knows nothing of the hardening and
    starts 40 % off. ``say`` is told, a line at a time, what happens next; ``report`` how many refits of the
    discovery are done.
    """
    began, folder = time.perf_counter(), Path(directory)
    tell = say or (lambda _: None)
    model = find_shipped_model(MODEL)
    rig = (model + effect(HIDDEN)).start(**STRENGTH)
    tell(f"measuring the rig (a simulation by CVODES, with sensor noise); it hides {HIDDEN}, which the model lacks")
    records = _measure(rig, folder)
    known = model.fix(*KNOWN)
    truth = {q.name: q.value for q in rig.fix(*KNOWN).free_parameters}
    start = {q.name: q.value * (1 + START_ERROR * (-1) ** k) for k, q in enumerate(known.free_parameters)}
    train, test = (read_csv(path, known) for path in records)
    options = FitOptions(at_rest=True)
    tell(f"1. fit: {', '.join(start)} from {train.rows} rows; {' and '.join(KNOWN)} are known")
    plain = fit(known.start(**start), train, noise=NOISE, validation=test, options=options)
    tell(f"   in x it is off by {plain.misfit['x'].noise_ratio:.0f} times the noise: the model lacks something")
    tell("2. discover: which effect of the catalogue would close that gap?")
    found = discover(
        known.start(**start),
        train,
        validation=test,
        noise=NOISE,
        options=options,
        say=lambda s: tell(f"   {s}"),
        report=report,
    )
    tell("3. compare with black boxes, which need no physics")
    compared = _compared(plain, found.best, train, test)
    tell("4. export the state space, draw")
    plant = linearise(found.best)
    files = {
        plain.save(folder / "plain.json"): "the fit of the model as it was",
        found.best.save(folder / "fit.json"): "the fit with the effect, for greybox export",
        found.save(folder / "discovery.json"): "what is missing, and the evidence",
        save_comparison(compared, folder / "compare.json"): "beside the black boxes",
        write_control(plant, folder / "plant_ss.py"): "the state space for python-control",
    }
    files |= dict.fromkeys(_gap(plain, found.best, compared, folder), "the gap before and after")
    files |= dict.fromkeys(draw_fit(found.best, folder), "measured and simulated")
    return Demo(truth, start, plain, found, compared, plant, records, files, time.perf_counter() - began)


def _compared(plain: Fit, best: Fit, train: Experiment, test: Experiment) -> Comparison:
    """Both physical models and the best ARX and output-error model of the displacement, on the record that none of them saw."""
    boxes = best_black_boxes(train, output="x", kinds=BLACK, at_rest=True, units={"x": "m", "u": "V"})
    models: dict[str, ComparedModel] = {PLAIN: plain, EXTENDED: best}
    models |= {str(kind): [scan.best] for kind, scan in boxes.items()}
    return compare(models, test, training=train)


def _gap(plain: Fit, best: Fit, compared: Comparison, folder: Path) -> list[Path]:
    """The picture of the gap, on the record that was not used."""
    noise = NOISE["x"]
    black = [e.name for e in compared.entries if e.kind == "black"]
    order = [PLAIN, *black, EXTENDED]
    added = "".join(f" + {e.name}" for e in best.model.effects)
    names = {PLAIN: PLAIN, EXTENDED: PLAIN + added if added else EXTENDED, **{n: f"{n} (black box)" for n in black}}
    ratios = {names[n]: compared[n].validation["x"].rmse / noise for n in order}
    return draw_gap(
        plain.validation.traces[0], best.validation.traces[0], output="x", unit="m", noise=noise, ratios=ratios,
        names=(names[PLAIN], names[EXTENDED]), path=folder / "gap",
    )  # fmt: skip


def _measure(rig: Model, folder: Path) -> tuple[Path, Path]:
    """Two records of the rig: one to learn from, one to judge by."""
    generator = np.random.default_rng(SEED)
    (drive,) = (i.name for i in rig.inputs)
    t = SAMPLING_TIME * np.arange(ROWS)
    inputs = {"multisine": multisine(t, *BAND, VOLTAGE, generator), "sweep": chirp(t[:CHECK_ROWS], *BAND, VOLTAGE)}
    paths = []
    for k, (name, u) in enumerate(inputs.items()):
        record = simulate_twin(rig, {drive: u}, SAMPLING_TIME, NOISE, SEED + k, name=name)
        paths.append(write_csv(record, rig, folder / f"{name}.csv"))
    return paths[0], paths[1]
