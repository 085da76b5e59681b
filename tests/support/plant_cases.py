"""Plants of every kind with records of known constants, for the contract that all of them keep."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from itertools import pairwise
from math import sin
from pathlib import Path

import numpy as np
from scipy.integrate import odeint

from greybox.comparison.blackbox.polynomial import PolynomialModel
from greybox.comparison.frequency.fit_response import ResponsePlant
from greybox.comparison.frequency.response import FrequencyResponse
from greybox.data.experiment import Experiment
from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State
from greybox.simulation.plant import Plant, PlantRunError, as_model


@dataclass(frozen=True, eq=False)
class PlantCase:
    """A plant whose start values are off, two records, and the constants that made them.

    ``noise`` is what was added to them; ``begin`` a state with where every record begins, for plants that have some.
    """

    name: str
    plant: Model | Plant
    truth: Mapping[str, float]
    records: tuple[Experiment, ...]
    noise: Mapping[str, float]
    begin: Mapping[str, float] = field(default_factory=dict)
    abilities: frozenset[str] = field(default_factory=frozenset)

    @property
    def model(self) -> Model:
        """Its model."""
        return as_model(self.plant)


class Pendulum:
    """A damped pendulum with a torque, run by Runge-Kutta steps from row to row: a simulator that is not ours."""

    name = "pendulum"
    inputs = (Input("T", "N*m"),)
    outputs = (Output("angle", "rad"),)
    parameters = (Parameter("L", "m", 0.5, (0.05, 5.0)), Parameter("d", "1/s", 0.1, (0.0, 10.0)))
    states = (State("angle0", "rad", bounds=(-3.0, 3.0)),)

    def simulate(self, record: Experiment, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        stiffness, damping = 9.81 / values["L"], values["d"]
        if damping > 8.0:
            raise PlantRunError("the bearing is stuck")

        # Numbers of Python: an element of an array takes three times as long, and a fit runs it some thousand times.
        push, h = (record.inputs["T"] / values["L"] ** 2).tolist(), float(record.time[1] - record.time[0])
        angle, speed = values["angle0"], 0.0
        angles = [angle]
        for begin, end in pairwise(push):
            # Straight between the rows of the record, which lie evenly.
            middle = (begin + end) / 2
            a = begin - stiffness * sin(angle) - damping * speed
            v = speed + h / 2 * a
            b = middle - stiffness * sin(angle + h / 2 * speed) - damping * v
            w = speed + h / 2 * b
            c = middle - stiffness * sin(angle + h / 2 * v) - damping * w
            last = speed + h * c
            d = end - stiffness * sin(angle + h * w) - damping * last
            angle += h / 6 * (speed + 2 * v + 2 * w + last)
            speed += h / 6 * (a + 2 * b + 2 * c + d)
            angles.append(angle)
        return {"angle": np.array(angles)}


def swing_exactly(record: Experiment, length: float, damping: float, begin: float) -> np.ndarray:
    """The angle by scipy's `odeint`; the steps of `Pendulum` come within 1e-5 rad of it."""
    torque = record.inputs["T"] / length**2

    def rates(t, x):
        return x[1], -9.81 / length * sin(x[0]) - damping * x[1] + np.interp(t, record.time, torque)

    step = record.time[1] - record.time[0]
    return odeint(rates, (begin, 0.0), record.time, rtol=1e-9, atol=1e-10, hmax=step, tfirst=True)[:, 0]


class Reaction:
    """``A -> B -> C`` in closed form (Box and Lucas 1959), with its own slopes: a plant without an input that costs nothing."""

    name = "reaction"
    cheap = True
    inputs = ()
    outputs = (Output("A", "mol/L"), Output("B", "mol/L"))
    parameters = (Parameter("k1", "1/s", 1.0, (0.01, 10.0)), Parameter("k2", "1/s", 0.1, (0.01, 10.0)))

    def simulate(self, record: Experiment, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        k1, k2, t = values["k1"], values["k2"], record.time
        return {"A": np.exp(-k1 * t), "B": k1 / (k1 - k2) * (np.exp(-k2 * t) - np.exp(-k1 * t))}

    def differentiate(
        self, record: Experiment, values: Mapping[str, float], names: Sequence[str], outputs: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        k1, k2, t = values["k1"], values["k2"], record.time
        first, second, apart = np.exp(-k1 * t), np.exp(-k2 * t), k1 - k2
        slopes = {
            "k1": (-t * first, -k2 / apart**2 * (second - first) + k1 / apart * t * first),
            "k2": (0 * t, k1 / apart**2 * (second - first) - k1 / apart * t * second),
        }
        return np.stack([np.column_stack(slopes[name]) for name in names], axis=2)


def move_oscillator(x, u, p):
    return [
        Balance("position", "m/s", 1.0, "x", speed=x.v),
        Balance("force", "N", p.M, "v", drive=u.F, spring=-p.K * x.x, damper=-p.B * x.v),
    ]


def oscillator() -> Model:
    """A mass on a spring, in equations."""
    return Model(
        "oscillator",
        [State("x", "m"), State("v", "m/s")],
        [Input("F", "N")],
        [Output("x", "m")],
        [
            Parameter("K", "N/m", 20.0, (0.1, 1e3)),
            Parameter("B", "N*s/m", 0.4, (0.01, 10.0)),
            Parameter("M", "kg", 1.0, fixed=True),
        ],
        move_oscillator,
    )


def drive(seed: int, rows: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Time and a smooth random input."""
    rng, time = np.random.default_rng(seed), step * np.arange(rows)
    return time, sum(rng.standard_normal() * np.sin(w * time + rng.uniform(0, 6)) for w in (0.7, 1.9, 3.3))


def add_noise(record: Experiment, noise: Mapping[str, float], seed: int) -> Experiment:
    """The record with white noise on its outputs."""
    rng = np.random.default_rng(seed)
    return record.with_outputs({n: y + noise[n] * rng.standard_normal(record.rows) for n, y in record.outputs.items()})


def make_pendulum() -> PlantCase:
    """The exact motion by scipy's `odeint`."""
    truth, noise, records = {"L": 0.7, "d": 0.3}, {"angle": 2e-3}, []
    for seed in (0, 1):
        time, torque = drive(seed, 80, 0.05)
        record = Experiment(f"r{seed}", time, {"T": 0.3 * torque}, {"angle": time}, "first")
        run = {"angle": swing_exactly(record, truth["L"], truth["d"], 0.05)}
        records.append(add_noise(record.with_outputs(run), noise, seed))
    return PlantCase("pendulum", Pendulum(), truth, tuple(records), noise, {"angle0": 0.05})


def make_reaction() -> PlantCase:
    truth, noise, records = {"k1": 0.7, "k2": 0.2}, {"A": 0.01, "B": 0.02}, []
    for seed in (0, 1):
        time = 0.1 * np.arange(100 + 20 * seed)
        record = Experiment(f"r{seed}", time, {}, {"A": time, "B": time})
        records.append(add_noise(record.with_outputs(Reaction().simulate(record, truth)), noise, seed))
    return PlantCase("closed_form", Reaction(), truth, tuple(records), noise)


def make_oscillator() -> PlantCase:
    """The exact motion by scipy's `lsim`."""
    from scipy.signal import lsim

    truth, noise, records = {"K": 30.0, "B": 1.5}, {"x": 1e-3}, []
    for seed in (0, 1):
        time, force = drive(seed, 200, 0.05)
        x = lsim(([[0, 1], [-30.0, -1.5]], [[0], [1]], [[1, 0]], [[0]]), force, time, interp=True)[1]
        records.append(add_noise(Experiment(f"r{seed}", time, {"F": force}, {"x": x}, "first"), noise, seed))
    return PlantCase("model", oscillator(), truth, tuple(records), noise, {"x": 0.0}, frozenset(["equations"]))


def make_filtered() -> PlantCase:
    """The same with process noise, so that the prediction error is minimised; simulated by many small Euler-Maruyama steps."""
    truth, noise, records = {"K": 30.0, "B": 1.5}, {"x": 1e-3}, []
    for seed in (0, 1):
        rng, parts = np.random.default_rng(seed), 50
        time, force = drive(seed, 300, 0.05)
        x, v, h, run = 0.0, 0.0, 0.05 / parts, []
        for k in range(len(time)):
            run.append(x)
            for j in range(parts):
                share = force[k] + (force[min(k + 1, len(time) - 1)] - force[k]) * j / parts
                x, v = x + h * v, v + h * (share - 30.0 * x - 1.5 * v) + 0.05 * np.sqrt(h) * rng.standard_normal()
        records.append(
            add_noise(Experiment(f"r{seed}", time, {"F": force}, {"x": np.array(run)}, "first"), noise, seed)
        )
    plant = oscillator().with_process_noise("v")
    return PlantCase("filter", plant, truth, tuple(records), noise, {"x": 0.0}, frozenset(["equations", "filter"]))


def make_fmu() -> PlantCase:
    """The oscillator as an FMU for co-simulation, its input held; the exact motion by scipy's `lsim`."""
    from scipy.signal import lsim

    from greybox.extensions.export import to_fmu
    from greybox.extensions.fmu.plant import read_fmu

    path = to_fmu(oscillator(), Path(tempfile.mkdtemp()) / "oscillator.fmu", dt=0.05)
    atexit.register(shutil.rmtree, path.parent, ignore_errors=True)
    truth, noise, records = {"K": 30.0, "B": 1.5}, {"x": 1e-3}, []
    for seed in (0, 1):
        time, force = drive(seed, 100, 0.05)
        x = lsim(([[0, 1], [-30.0, -1.5]], [[0], [1]], [[1, 0]], [[0]]), force, time, interp=False)[1]
        records.append(add_noise(Experiment(f"r{seed}", time, {"F": force}, {"x": x}), noise, seed))
    plant = read_fmu(path).with_values(["K", "B"])
    return PlantCase("fmu", plant, truth, tuple(records), noise, abilities=frozenset(["linear"]))


def make_frequency() -> PlantCase:
    """The oscillator over frequency; the exact response by scipy's `freqs`."""
    from scipy.signal import freqs

    truth, std, frequency = {"K": 30.0, "B": 1.5}, 1e-3, np.geomspace(0.2, 4.0, 60)
    exact, responses = freqs([1.0], [1.0, 1.5, 30.0], 2 * np.pi * frequency)[1], []
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        points = exact + std * (rng.standard_normal(60) + 1j * rng.standard_normal(60))
        both = np.full((60, 1, 1), 2 * std**2)
        responses.append(FrequencyResponse(frequency, points[:, None, None], ("F",), ("x",), both, name=f"r{seed}"))
    plant = ResponsePlant.of(oscillator(), responses)
    noise = dict.fromkeys((o.name for o in plant.outputs), std)
    return PlantCase("frequency", plant, truth, plant.records, noise, abilities=frozenset(["linear"]))


def make_black_box() -> PlantCase:
    """A difference equation of first order; the exact run by scipy's `lfilter`."""
    from scipy.signal import lfilter

    truth, noise, records = {"b1": 0.5, "f1": -0.8}, {"y": 2e-3}, []
    for seed in (0, 1):
        time, u = drive(seed, 150, 0.05)
        y = lfilter([0.0, 0.5], [1.0, -0.8], u)
        records.append(add_noise(Experiment(f"r{seed}", time, {"u": u}, {"y": y}), noise, seed))
    plant = PolynomialModel("output error", "y", ("u",), 0.05, (1,), ([0.0, 0.4],), f=([1.0, -0.6],))
    return PlantCase("black_box", plant, truth, tuple(records), noise, {"before_1": 0.0})


HAS_FMU = find_spec("fmpy") is not None and any(map(shutil.which, ("cc", "gcc", "clang")))
CASES = {
    "model": make_oscillator,
    "filter": make_filtered,
    "pendulum": make_pendulum,
    "closed_form": make_reaction,
    "frequency": make_frequency,
    "black_box": make_black_box,
}
CASES |= {"fmu": make_fmu} if HAS_FMU else {}
