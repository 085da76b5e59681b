"""Other ways to learn more, on the scale of the designed record: other inputs, repetition, duration, sampling time, sensors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from greybox.base.numerics import TINY
from greybox.discovery.proposals import PROPOSAL_NEW_SENSOR_NOISE
from greybox.extensions.design.goals import Goal, GoalMaker
from greybox.extensions.design.inputs import play
from greybox.extensions.design.limits import LimitKeeper
from greybox.extensions.design.problem import DESIGN_MOST_ROWS, DesignProblem
from greybox.extensions.design.result import Alternative, AlternativeKind
from greybox.extensions.design.search import TriedInput, evaluate, kinds_of


def list_alternatives(
    question: DesignProblem,
    keeper: LimitKeeper,
    make_goal: GoalMaker,
    goal: Goal,
    tried: Sequence[TriedInput],
) -> tuple[Alternative, ...]:
    """What else could be done; ``tried`` inputs, of which the first is the design. Those that cannot be run are left out."""
    everything = [
        *_other_inputs(tried),
        *_more_time(question, make_goal, goal, tried),
        *_more_sensors(question, goal, tried[0]),
    ]
    return tuple(a for a in everything if np.isfinite(a.gain))


def _other_inputs(tried: Sequence[TriedInput]) -> Iterator[Alternative]:
    best = tried[0]
    for each in kinds_of(tried):
        if each.kind != best.kind:
            yield Alternative(AlternativeKind.INPUT, each.kind, float(np.exp(each.value - best.value)))


def _more_time(
    question: DesignProblem, make_goal: GoalMaker, goal: Goal, tried: Sequence[TriedInput]
) -> Iterator[Alternative]:
    best = tried[0]
    twice = evaluate(goal, best.inputs, 2.0)
    yield Alternative(AlternativeKind.REPEAT, "2", float(np.exp(twice - best.value)))
    if 2 * question.rows > DESIGN_MOST_ROWS:
        return
    # A shape that fills any duration: a refined input has its levels for this one only.
    general = next((t for t in tried if t.kind != "piecewise constant"), best)
    longer = replace(question, duration=2 * question.duration)
    value = evaluate(goal, play(longer, general.shapes, general.amplitude))
    yield Alternative(AlternativeKind.LONGER, f"{longer.duration:g}", float(np.exp(value - general.value)))
    step = question.sampling_time / 2
    finer = replace(question, sampling_time=step)
    fine_goal = make_goal(question.policy.search.refined_scenarios, step)
    coarse_goal = make_goal(question.policy.search.refined_scenarios, None)
    repeated = {name: np.repeat(u, 2)[: finer.rows] for name, u in best.inputs.items()}
    gain = evaluate(fine_goal, repeated) - evaluate(coarse_goal, best.inputs)
    yield Alternative(AlternativeKind.SAMPLE_FASTER, f"{step:g}", float(np.exp(gain)))


# Noise of a sensor that is not installed and not described, as a share of the largest value that it would show.
GOAL_NEW_SENSOR_NOISE: float = PROPOSAL_NEW_SENSOR_NOISE


def _more_sensors(question: DesignProblem, goal: Goal, best: TriedInput) -> Iterator[Alternative]:
    sensors: dict[str, float] = dict(question.sensors)
    outputs, _ = goal.plants[0].simulate(best.inputs)
    for j, output in enumerate(question.model.outputs):
        if output.name not in question.noise and output.name not in sensors:
            largest = float(np.abs(outputs[:, j]).max())
            sensors[output.name] = GOAL_NEW_SENSOR_NOISE * max(largest, TINY)
    for name, std in sensors.items():
        with_sensor = _with_plants(goal, {name: std})
        yield Alternative(AlternativeKind.SENSOR, name, float(np.exp(evaluate(with_sensor, best.inputs) - best.value)))


def _with_plants(goal: Goal, sensors: Mapping[str, float]) -> Goal:
    return replace(goal, plants=[plant.with_sensors(sensors) for plant in goal.plants])  # type: ignore[type-var]
