"""A model with one set of constants, ready to run inputs: outputs, states and sensitivities over the record, from the compiled kernel."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from greybox.base import ModelError
from greybox.base.linear_algebra import eliminate
from greybox.data.experiment import Experiment
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.preparation import guess_initial_states, prepare_problem
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.extensions.design.problem import DesignProblem
from greybox.model import Model
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.record import Record
from greybox.simulation.records import to_record
from greybox.simulation.simulate import declared_initial_state


@dataclass(frozen=True, eq=False)
class PlantRun:
    """What a plant does under one input.

    ``outputs`` (N, ny) and ``states`` (N, nx); ``slopes`` (N, ny, L): of the outputs over their noise, along the free constants and the
    initial states that are estimated; NaN where an output is not measured. ``finite``: whether the run went through.
    """

    outputs: np.ndarray
    states: np.ndarray
    slopes: np.ndarray
    finite: bool

    @cached_property
    def information(self) -> np.ndarray:
        """Fisher's information (L, L) of the run."""
        rows = self.slopes.reshape(-1, self.slopes.shape[-1])
        rows = rows[np.isfinite(rows).all(axis=1)]
        # S'S of the slopes over the noise: white noise of known level.
        return rows.T @ rows


class SignalPlace(NamedTuple):
    """Where a run shows a signal: among its outputs (``kind`` 0) or states (1), in which ``column``."""

    kind: int
    column: int


@dataclass(frozen=True, eq=False)
class PlantScenario:
    """One of the explanations at one set of constants.

    Parameters
    ----------
    model
        With the constants.
    weight
        One over the noise of each output (ny,), zero where there is no sensor.
    measured
        Which outputs are measured (ny,).
    earlier
        Information (n, n) about the scaled constants from the records that were taken, their priors included.
    problem, template
        The estimation problem that is laid out, and the record whose inputs are replaced.
    number
        Which explanation of the question it is.
    """

    model: Model
    weight: np.ndarray
    measured: np.ndarray
    earlier: np.ndarray
    problem: EstimationProblem
    template: Experiment
    number: int = 0

    @property
    def variables(self) -> DecisionVector:
        """The scaled constants."""
        return self.problem.variables

    @property
    def count(self) -> int:
        """Number of free constants."""
        return len(self.variables.which)

    def locate(self, signals: Iterable[str]) -> dict[str, SignalPlace]:
        """Where a run shows each of these signals; without those that this explanation does not have as an output or a state."""
        named = {s.name: SignalPlace(1, k) for k, s in enumerate(self.model.all_states)}
        named |= {o.name: SignalPlace(0, k) for k, o in enumerate(self.model.outputs)}
        return {name: named[name] for name in signals if name in named}

    def make_record(self, inputs: Mapping[str, np.ndarray]) -> Record:
        """The record with these inputs, by name (N,), as the step reads it; its outputs are zero where there is a sensor."""
        rows = len(next(iter(inputs.values())))
        step = self.template.sampling_time or 0.0
        if self._laid_out.rows_per_sample > 1:  # band-limited: filled in between samples
            outputs = {n: np.zeros(rows) for n in self.template.outputs}
            experiment = Experiment("designed", step * np.arange(rows), inputs, outputs, self.template.hold)
            record = to_record(self.model, experiment)
        else:
            u = np.column_stack([inputs[i.name] for i in self.model.inputs])
            y = np.tile(np.where(self.measured, 0.0, np.nan), (rows, 1))
            shape = np.full(rows - 1, step), np.zeros(rows - 1, np.int32), np.array([step])
            record = Record(u, y, *shape, self._laid_out.is_linear)
        return record.read_by(self.problem.step)

    @cached_property
    def _laid_out(self) -> Record:
        return to_record(self.model, self.template)

    @cached_property
    def point(self) -> KernelPoint:
        """What the kernel needs at the present constants: the same for every input."""
        return replace(self.problem, records=(self._laid_out,)).shooting().at(self.variables.here, 0)

    def simulate(self, inputs: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (N, ny) and states (N, nx) under these inputs; not finite from where the run overflows."""
        record, point = self.make_record(inputs), self.point
        y, x = self.problem.kernel.simulate(record, point.q, point.p, point.x0)
        return record.samples(y), record.samples(x)

    def run(self, inputs: Mapping[str, np.ndarray]) -> PlantRun:
        """Outputs, states and sensitivities under these inputs."""
        record, point = self.make_record(inputs), self.point
        weight = np.where(self.weight > 0, self.weight, 1.0)
        _, slopes = self.problem.kernel.residuals(record, point, weight)
        y, x = self.problem.kernel.simulate(record, point.q, point.p, point.x0)
        y, x, slopes = (record.samples(v) for v in (y, x, slopes))
        finite = bool(np.isfinite(y).all() and np.isfinite(x).all() and np.isfinite(slopes[:, self.measured]).all())
        # The kernel's residual is measured minus simulated: the slope of the output has the other sign.
        slopes = np.where(self.measured[None, :, None], -slopes, np.nan)
        return PlantRun(y, x, slopes, finite)

    def at(self, z: np.ndarray) -> PlantScenario:
        """The same plant at other scaled constants (n,); they are kept within their bounds."""
        variables = self.variables
        whole = np.concatenate([z, np.zeros(variables.size - self.count)])
        low, high = variables.bounds()
        whole = np.clip(whole, low, high)
        model = self.model.start(**dict(zip(variables.names, variables.constants(whole).tolist(), strict=True)))
        moved = replace(variables, model=model, fixed=variables.parameters(whole), base=variables.constants(whole))
        return replace(self, model=model, problem=replace(self.problem, model=model, variables=moved))

    def with_sensors(self, std: Mapping[str, float]) -> PlantScenario:
        """The same plant with the noise of further sensors, by output."""
        names = [o.name for o in self.model.outputs]
        weight, measured = self.weight.copy(), self.measured.copy()
        for name, level in std.items():
            weight[names.index(name)], measured[names.index(name)] = 1 / level, True
        template = self.template.with_outputs(
            {n: np.zeros(self.template.rows) for n, m in zip(names, measured, strict=True) if m}
        )
        return replace(self, weight=weight, measured=measured, template=template)


def make_plant(question: DesignProblem, model: Model, number: int = 0, step: float | None = None) -> PlantScenario:
    """``model`` as a plant that answers ``question``; ``step``: another sampling time than the question's."""
    period = question.sampling_time if step is None else step
    noise = question.noise_model()
    # Readings before anything moves are ones that a record may have, where zero may be none (an absolute pressure).
    u, p = [question.rest(i.name) for i in model.inputs], list(model.values.values())
    y = np.asarray(model.system.output_function(declared_initial_state(model), u, p)).ravel()
    at_rest = {o.name: float(v) for o, v in zip(model.outputs, y, strict=True) if o.name in question.noise}
    rows = 2
    template = Experiment(
        "designed",
        period * np.arange(rows),
        {i.name: np.full(rows, question.rest(i.name)) for i in model.inputs},
        {name: np.full(rows, value) for name, value in at_rest.items()},
        question.hold,
    )
    # The estimation problem of one record that begins in the declared state, its initial state estimated where a fit would.
    options = question.options
    problem = prepare_problem(model, template, noise, replace(options.integration, at_rest=True))
    declared = guess_initial_states(model, problem.records, True)
    free = np.array([not options.at_rest or s.free_start for s in model.all_states], bool)
    variables = DecisionVector.of(model, replace(declared, free=free))
    if problem.step.past is not None and len(variables.names) == 0:
        raise ModelError(f"{model.title}: no free constant")
    # Priors count once: they are in ``earlier``.
    problem = replace(problem, variables=_without_priors(variables))
    names = [o.name for o in model.outputs]
    measured = np.array([name in question.noise for name in names])
    weight = np.where(measured, 1 / np.where(measured, noise.std, 1.0), 0.0)
    earlier = information_of_records(question, model, problem.variables)
    return PlantScenario(model, weight, measured, earlier, problem, template, number)


def _without_priors(variables: DecisionVector) -> DecisionVector:
    """The unknowns with priors that are infinitely wide."""
    return replace(variables, prior=np.column_stack([variables.prior[:, 0], np.full(len(variables.prior), np.inf)]))


def information_of_records(question: DesignProblem, model: Model, like: DecisionVector) -> np.ndarray:
    """Information (n, n) about the constants, scaled as ``like`` has them: from the records that were taken, and their priors."""
    n = len(like.which)
    prior = np.zeros((n, n))
    known = DecisionVector.of(model, like.initial)
    if known.has_prior.any():
        _, _, curvature = known.penalty(known.here)
        prior[np.diag_indices(n)] += np.where(known.has_prior, curvature / 2, 0.0)
    if not question.earlier:
        return prior
    # A rough level for sensors that are no longer there: the spread of their reading.
    known_outputs = {o.name for o in question.model.outputs}
    others = {
        name: float(max(np.nanstd(values), 1e-300))
        for e in question.earlier
        for name, values in e.outputs.items()
        if name in known_outputs and name not in question.noise
    }
    problem = prepare_problem(model, question.earlier, question.noise_model(others), question.options.integration)
    # Priors were added above.
    problem = replace(problem, variables=_without_priors(problem.variables))
    evaluation = problem.shooting(problem.variables).evaluate(problem.variables.here)
    if not np.isfinite(evaluation.cost):
        return prior
    whole = evaluation.hessian / 2
    kept, states = np.arange(n), np.arange(n, len(whole))
    # First states of earlier records were unknown, too.
    reduced = (eliminate(whole, kept, states) @ whole)[:, :n] if len(states) else whole
    return prior + (reduced + reduced.T) / 2


# Standard deviation of the logarithm of each free constant where no record has been taken: a data sheet's 20 %.
ASSUMED_SPREAD = 0.2
# Largest change of a drawn constant, in its logarithm or as a share of its value: what is not determined at all is not drawn at a
# thousand times its value.
LARGEST_DEVIATION = 0.7
# Seed of random phases, levels and constants: the same question has the same answer.
INPUT_SEARCH_SEED = 1
# What is known without data, as a standard deviation of the logarithm of a constant: its order of magnitude (a factor of ten). Keeps
# criteria finite where a constant is not determined.
GOAL_PRIOR_SPREAD = 2.302585092994046


def draw_plants(plant: PlantScenario, question: DesignProblem, count: int) -> list[PlantScenario]:
    """``plant`` at constants drawn from what is known of them; none where nothing is uncertain.

    What is known is the information of earlier records with the assumed spread of a data sheet where there are none.
    """
    n = plant.count
    if not n or not count:
        return []
    spread = GOAL_PRIOR_SPREAD if question.earlier else ASSUMED_SPREAD
    # A normal prior adds 1 / spread^2 on the diagonal.
    information = plant.earlier + np.eye(n) / spread**2
    values, vectors = np.linalg.eigh(information)
    # Covariance V L^-1 V' has the root V L^(-1/2); no direction is wider than the prior.
    root = vectors / np.sqrt(np.maximum(values, 1 / spread**2))
    # One antithetic pair after the other: few draws, and their mean is the best constants.
    generator = np.random.default_rng(INPUT_SEARCH_SEED)
    half = [root @ generator.standard_normal(n) for _ in range(-(-count // 2))]
    draws = [sign * z for z in half for sign in (1, -1)][:count]
    return [plant.at(np.clip(z, -LARGEST_DEVIATION, LARGEST_DEVIATION)) for z in draws]


def list_plants(question: DesignProblem) -> tuple[list[PlantScenario], list[list[PlantScenario]]]:
    """Each explanation at its best constants, and at constants drawn for it."""
    plants = [make_plant(question, model, k) for k, model in enumerate(question.models)]
    return plants, [draw_plants(plant, question, question.policy.scenarios) for plant in plants]
