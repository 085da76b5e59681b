"""The demonstration: a simulated rig has an effect that its model lacks; discovery identifies the effect, and the error shrinks."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from greybox.base import Printable
from greybox.base.extensions import ExtensionKind, load_extension
from greybox.comparison.blackbox import BlackBoxKind, best_black_boxes
from greybox.comparison.compare import ComparedModel, compare
from greybox.comparison.result import Comparison, save_comparison
from greybox.data import Experiment, read_csv
from greybox.data.signals import chirp, multisine
from greybox.discovery.pipeline import discover
from greybox.discovery.result import Discovery
from greybox.estimation import Fit, FitOptions
from greybox.estimation.fit import fit
from greybox.estimation.linear.linearisation import Linearisation
from greybox.estimation.linear.linearise import linearise
from greybox.model import Model
from greybox.model.effects.catalogue import effect
from greybox.shell.project import find_shipped_model
from greybox.show.figures.pictures import draw_fit, draw_gap
from greybox.simulation.simulate import simulate_twin, write_csv

# The names of the two physical models in the comparison.
PLAIN, EXTENDED = "plain model", "extended model"

Say = Callable[[str], None]


# The rig of the demonstration and how it is measured.
# The shipped model that is fitted.
MODEL = "micro_actuator"
# The effect that the rig has and the model lacks ...
HIDDEN = "cubic_stiffness"
# ... with its parameters: at full stroke the hinges push back by an eighth more than a straight spring would (N/m^3).
STRENGTH: Mapping[str, float] = {"K3": 5e9}
# Seconds: 4 kHz resolves the electrical time constant of 60 us by the held input alone, and is a usual rate.
SAMPLING_TIME = 2.5e-4
# Rows of the estimation record (0.2 s) and of the validation record (0.1 s).
ROWS, VALIDATION_ROWS = 800, 400
# Hz: from below the mechanism's resonance at 122 Hz to where the inductance shows.
BAND = (5.0, 400.0)
# Volt: rms of the multisine and amplitude of the sweep.
VOLTAGE = 2.0
# Standard deviation of the noise of each output, in m and A.
NOISE: Mapping[str, float] = {"x": 0.2e-6, "i": 5e-3}
# Constants that are fixed: weighed, and measured with a multimeter.
KNOWN = ("M", "Ra")
# The start values are off by this share of the truth, upwards and downwards in turn.
START_ERROR = 0.4
# Seed of the multisine's phases and of the noise.
SEED = 20100
# The black boxes beside the physical models.
BLACK_BOXES = (BlackBoxKind.ARX, BlackBoxKind.OUTPUT_ERROR)


@dataclass(frozen=True)
class Demo(Printable):
    """What was done, step by step.

    ``truth`` of the rig's parameters, the hidden effect's included; ``start`` of the search. ``plain``: the model's own fit;
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
    def arguments(self) -> str:
        """What the commands take that repeat it: the model, the records, and what was known."""
        first, second = self.records
        known = " ".join(f"--fix {name}={self.fit.parameters[name].value:g}" for name in KNOWN)
        noise = " ".join(f"--noise {name}={std:g}" for name, std in NOISE.items())
        return f"{MODEL} {first} --validate {second} {known} {noise} --at-rest"

    @property
    def deviations(self) -> dict[str, float]:
        """Error of each parameter that was found in its own standard deviations (NaN where the fit gives none)."""
        common = {name: self.fit.parameters[name] for name in self.truth if name in self.fit.parameters}
        return {name: (e.value - self.truth[name]) / (e.std or np.nan) for name, e in common.items()}


def run_demo(
    directory: str | Path,
    *,
    say: Say | None = None,
    report: Callable[[int], None] | None = None,
    pictures: bool = False,
) -> Demo:
    """Measure a simulated micro-motion actuator whose spring hardens, and let the program find that out.

    The records come from `simulate_twin`, an integrator that the fits do not use, with white noise; they are written to
    ``directory`` as CSV and read back, as a user's would be. The model that is fitted knows nothing of the hardening, and its
    start values are 40 % off.

    Parameters
    ----------
    directory
        Folder for the records and results.
    say
        Called with a line of text before each step.
    report
        Called with the number of refits of the discovery that are done.
    pictures
        Also write figures as PNG, SVG and PDF.
    """
    began, folder = time.perf_counter(), Path(directory)
    tell = say or (lambda _: None)
    model = find_shipped_model(MODEL)
    rig = (model + effect(HIDDEN)).start(**STRENGTH)
    tell(f"measuring the rig (simulated by CVODES, with noise); it hides {HIDDEN}")
    records = _measure(rig, folder)
    known = model.fix(*KNOWN)
    truth = {q.name: q.value for q in rig.fix(*KNOWN).free_parameters}
    start = {q.name: q.value * (1 + START_ERROR * (-1) ** k) for k, q in enumerate(known.free_parameters)}
    train, test = (read_csv(path, known) for path in records)
    options = FitOptions(at_rest=True)
    tell(f"1. fit: {', '.join(start)} from {train.rows} rows; {' and '.join(KNOWN)} are known")
    plain = fit(known.start(**start), train, noise=NOISE, validation=test, options=options)
    tell("2. discover: which effect of the catalogue explains the residual?")
    discovery = discover(
        known.start(**start),
        train,
        validation=test,
        noise=NOISE,
        options=options,
        on_message=lambda s: tell(f"   {s}"),
        on_refit=report,
    )
    tell("3. compare with black boxes, which need no physics")
    comparison = _compare(plain, discovery.best, train, test)
    tell("4. export the state space")
    plant = linearise(discovery.best)
    files = {
        plain.save(folder / "plain.json"): "the fit of the plain model",
        discovery.best.save(folder / "fit.json"): "the fit with the effect, for greybox export",
        discovery.save(folder / "discovery.json"): "the missing effect, and the evidence",
        save_comparison(comparison, folder / "compare.json"): "the comparison with black boxes",
        load_extension(ExtensionKind.EXPORTS, "control").write(
            plant, folder / "plant_ss.py"
        ): "the state space for python-control",
    }
    if pictures:
        gap = _draw_gap(plain, discovery.best, comparison, folder)
        files |= dict.fromkeys(gap, "the error before and after")
        files |= dict.fromkeys(draw_fit(discovery.best, folder), "measured and simulated")
    seconds = time.perf_counter() - began
    return Demo(truth, start, plain, discovery, comparison, plant, records, files, seconds)


def _compare(plain: Fit, best: Fit, train: Experiment, test: Experiment) -> Comparison:
    """Both physical models and the best black boxes of the displacement, on the record that none of them saw."""
    scans = best_black_boxes(train, output="x", kinds=BLACK_BOXES, at_rest=True, units={"x": "m", "u": "V"})
    models: dict[str, ComparedModel] = {PLAIN: plain, EXTENDED: best}
    models |= {str(kind): [scan.best] for kind, scan in scans.items()}
    return compare(models, test, training=train)


def _draw_gap(plain: Fit, best: Fit, comparison: Comparison, folder: Path) -> list[Path]:
    """The picture of the gap, on the validation record."""
    noise = NOISE["x"]
    black = [e.name for e in comparison.entries if e.kind == "black"]
    order = [PLAIN, *black, EXTENDED]
    added = "".join(f" + {e.name}" for e in best.model.effects)
    names = {PLAIN: PLAIN, EXTENDED: PLAIN + added if added else EXTENDED, **{n: f"{n} (black box)" for n in black}}
    ratios = {names[n]: comparison[n].validation["x"].rmse / noise for n in order}
    return draw_gap(
        plain.validation.traces[0],
        best.validation.traces[0],
        output="x",
        unit="m",
        noise=noise,
        ratios=ratios,
        names=(names[PLAIN], names[EXTENDED]),
        path=folder / "gap",
    )


def _measure(rig: Model, folder: Path) -> tuple[Path, Path]:
    """Two records of the rig: one to estimate from, one to judge by."""
    generator = np.random.default_rng(SEED)
    (drive,) = (i.name for i in rig.inputs)
    t = SAMPLING_TIME * np.arange(ROWS)
    inputs = {"multisine": multisine(t, *BAND, VOLTAGE, generator), "sweep": chirp(t[:VALIDATION_ROWS], *BAND, VOLTAGE)}
    paths = []
    for k, (name, u) in enumerate(inputs.items()):
        record = simulate_twin(rig, {drive: u}, SAMPLING_TIME, NOISE, SEED + k, name=name)
        paths.append(write_csv(record, rig, folder / f"{name}.csv"))
    return paths[0], paths[1]
