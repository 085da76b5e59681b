"""From records of a rig with hidden friction to controllers, and what these do on that rig: what both rigs' studies share.

1. Two records of the rig (`fits.studies.rig_twins`: its own equations, its own integrator); the friction is in neither model nor words.
2. The plain model is fitted; `discover` names what it lacks; black boxes are scanned on the same record.
3. One rule (`fits.control.design`) makes a controller of each: LQR with integral action and observer.
4. Each runs on the rig, friction and all, and on rigs drawn from what the records leave open (`greybox.export.sample_family`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import control
import numpy as np

import greybox as gb
from fits.control.design import Compensation, Design, Margins, Weights, channel, closest, design, margins, with_force
from fits.control.loop import Moves, Run, Verdict, closed_loop, judged
from fits.studies.rig_twins import Actuator, Cylinder, Effects, simulate
from greybox.comparison.blackbox.best_models import best_black_boxes

FAMILY, FAMILY_SEED, LEVEL = 12, 0, 0.95
GENTLER = (2.0, 4.0)
FINE = 10  # steps of the rig in each sampling time
RIGS = {"micro_actuator": Actuator, "pneumatic_cylinder": Cylinder}
BLACK, PLAIN, KNOWING, COMPENSATED = (
    "black box",
    "grey-box without the effect",
    "grey-box with it, uncompensated",
    "grey-box with it, compensated",
)


@dataclass(frozen=True)
class Setting:
    """A rig, what is hidden in it, how it is recorded, and what is asked of its controller.

    ``model`` with the constants of the rig; ``start``: with what the user knows and guesses; ``hidden``: effects of the rig;
    ``inputs``: seed -> voltage (N,); ``noise`` of the outputs, the controlled one first; ``candidates``: effects that may be missing;
    ``limit`` of the voltage; ``slow``, ``rate`` of the friction's compensation (`Compensation`); ``mass``: name of the constant;
    ``shown``: unit of tables and figures, and its size.
    """

    model: gb.Model
    start: gb.Model
    hidden: Effects
    inputs: Callable[[int], np.ndarray]
    sampling_time: float
    noise: Mapping[str, float]
    candidates: tuple[str, ...]
    moves: Moves
    weights: Weights
    limit: float
    slow: float
    rate: float
    mass: str
    shown: tuple[str, float]

    @property
    def output(self) -> str:
        """What is controlled."""
        return next(iter(self.noise))

    @property
    def truth(self) -> dict[str, float]:
        """Constants of the rig."""
        return dict(self.model.values)

    def record(self, seed: int) -> gb.Experiment:
        """A record of the rig with the input, and the noise, of this seed."""
        u, name = self.inputs(seed), self.start.name
        rows = np.array(simulate(name, self.truth, self.hidden, u.tolist(), self.sampling_time, FINE))
        shaken = rows + np.array(list(self.noise.values())) * np.random.default_rng(seed).standard_normal(rows.shape)
        outputs = dict(zip(self.noise, shaken.T, strict=True))
        return gb.Experiment(f"{name} {seed}", self.sampling_time * np.arange(len(u)), {"u": u}, outputs)

    def rig(self, constants: Mapping[str, float] | None = None, effects: Effects | None = None) -> Any:
        """The rig itself, or one with other ``constants`` and ``effects``."""
        base = self.truth if constants is None else {**self.truth, **{n: constants[n] for n in self.truth}}
        return RIGS[self.start.name](base, self.hidden if effects is None else effects)


@dataclass(frozen=True, eq=False)
class Spread:
    """A design over the family: ``verdicts`` on its nonlinear members and their ``positions`` (members, N), and the ``worst`` distance
    from -1 over the whole confidence set (negative: unstable)."""

    verdicts: tuple[Verdict, ...]
    positions: np.ndarray
    worst: float


@dataclass(frozen=True, eq=False)
class Study:
    """Designs by name with their runs on the rig, what these amount to, margins on the rig, and the spread over the family.

    ``gentler``: verdicts of the same designs with the voltage counted that many times more, so that no design loses by the weights.
    """

    setting: Setting
    discovery: gb.discovery.Discovery
    black: Any
    designs: Mapping[str, Design]
    runs: Mapping[str, Run]
    verdicts: Mapping[str, Verdict]
    margins: Mapping[str, Margins]
    spread: Mapping[str, Spread]
    gentler: Mapping[float, Mapping[str, Verdict]]


def study(setting: Setting) -> Study:
    """Everything, from the records to the closed loops."""
    estimation, validation = setting.record(1), setting.record(2)
    effects = [gb.effect(name) for name in setting.candidates]
    discovery = gb.discover(setting.start, estimation, validation=validation, noise=setting.noise, effects=effects)
    scans = best_black_boxes(estimation, output=setting.output, kinds=("arx", "output error"))
    black = min(scans.values(), key=lambda scan: scan.chosen.free_run).best
    designs = designs_of(setting, discovery.base.model, discovery.best.model, black)
    runs = {name: run_of(setting, made) for name, made in designs.items()}
    true = gb.export.to_state_space(channel(gb.linearise(setting.model, dt=setting.sampling_time), setting.output))
    gentler = {}
    for factor in GENTLER:
        other = replace(setting, weights=replace(setting.weights, effort=factor * setting.weights.effort))
        softer = designs_of(other, discovery.base.model, discovery.best.model, black)
        gentler[factor] = {name: judged(run_of(other, made), setting.moves) for name, made in softer.items()}
    return Study(
        setting,
        discovery,
        black,
        designs,
        runs,
        {name: judged(run, setting.moves) for name, run in runs.items()},
        {name: margins(made, true) for name, made in designs.items()},
        spread_of(setting, discovery.best, designs),
        gentler,
    )


def run_of(setting: Setting, made: Design, rig: Any = None, seed: int = 0) -> Run:
    """``made`` on the rig itself, or on another ``rig``."""
    return closed_loop(rig or setting.rig(), made, setting.moves, setting.noise[setting.output], seed, FINE)


def designs_of(setting: Setting, plain: gb.Model, best: gb.Model, black: Any) -> dict[str, Design]:
    """The four controllers, all by the same rule."""
    alone, (knowing, friction) = grey_plant(setting, plain)[0], grey_plant(setting, best)
    plants = {
        BLACK: (black_plant(black), None),
        PLAIN: (alone, None),
        KNOWING: (knowing, None),
        COMPENSATED: (knowing, friction),
    }
    return {name: design(name, plant, setting.weights, setting.limit, met) for name, (plant, met) in plants.items()}


def grey_plant(setting: Setting, model: gb.Model) -> tuple[Any, Compensation]:
    """From `u` to the controlled output, minimal and sampled; with it what its friction needs to be compensated."""
    linear = with_force(gb.export.minimal_realisation(gb.linearise(model)), "v", model.values[setting.mass])
    sampled = gb.export.sample(linear, setting.sampling_time)
    row = sampled.output_names.index(setting.output)
    plant = control.ss(sampled.A, sampled.B[:, :1], sampled.C[[row]], sampled.D[[row], :1], setting.sampling_time)
    speed = np.array([float(name == "v") for name in sampled.state_names])
    return plant, Compensation(level_of(model), speed, sampled.B[:, 1], setting.slow, setting.rate)


def level_of(model: gb.Model) -> Callable[[float], float]:
    """Friction of steady sliding [N] over the speed [m/s], as the model's effects have it; zero without any."""
    p = model.values
    low, high, speed = p.get("Fc", 0.0), p.get("Fs", p.get("Fc", 0.0)), p.get("vs", 1.0)
    return lambda v: low + (high - low) * float(np.exp(-((v / speed) ** 2)))


def black_plant(black: Any) -> Any:
    """A black box as a state space whose states are of the size between input and output, which the Riccati equations like."""
    s = control.ss(black.to_control())
    size = np.sqrt(np.linalg.norm(s.C) / np.linalg.norm(s.B))
    return control.ss(s.A, s.B * size, s.C / size, s.D, s.dt)


def spread_of(setting: Setting, best: gb.Fit, designs: Mapping[str, Design]) -> dict[str, Spread]:
    """Each design over the rigs that the records leave open."""
    family = gb.export.sample_family(best, number=FAMILY, seed=FAMILY_SEED, dt=setting.sampling_time)
    rigs = [setting.rig(member.parameters, effects_of(best, member.parameters)) for member in family.members]
    spread = {}
    for name, made in designs.items():
        near = closest(made, setting.output, setting.sampling_time)
        runs = [run_of(setting, made, rig, seed) for seed, rig in enumerate(rigs)]
        spread[name] = Spread(
            tuple(judged(run, setting.moves) for run in runs),
            np.array([run.position for run in runs]),
            -family.worst(lambda member, near=near: -near(member), LEVEL).value,
        )
    return spread


def effects_of(fit: gb.Fit, values: Mapping[str, float]) -> Effects:
    """The effects of a fit's model as a rig takes them, with these ``values`` of its constants."""
    return {
        bound.effect.name: {
            parameter.name: values[bound.model_names[parameter.name]] for parameter in bound.effect.parameters
        }
        for bound in fit.model.bound_effects
    }
