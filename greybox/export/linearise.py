"""Linear models about an operating point; what has no slope there is named, and so is what stands in its place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from greybox.errors import ModelError
from greybox.export.linearisation import Linearisation
from greybox.export.model_functions import ModelFunctions
from greybox.export.one_sided_derivatives import OneSidedDerivatives, differentiate_one_sided
from greybox.export.operating_point import OperatingPoint, solve_operating_point
from greybox.export.plant import Plant, to_plant
from greybox.export.sampling import sample
from greybox.model import Model
from greybox.result import Fit
from greybox.units import format_unit

# Of the sum of a row: what is left of terms that cancel.
ROUNDING = 1e-15


def linearise(
    plant: Fit | Model,
    at: Mapping[str, float] | None = None,
    *,
    dt: float | None = None,
    method: str = "zoh",
    delay: float = 0.0,
) -> Linearisation:
    """The linear model of a fit (or of a model at its present values) about an operating point, continuous or sampled.

    ``at``: states and inputs by name, in the model's units; what it leaves out is solved for, see `find_operating_point`. ``dt``: sampling
    time in seconds (None: continuous), ``method`` ``zoh`` (exact for a held input) or ``tustin``, ``delay`` seconds by which every input
    arrives late besides what the model says itself, fractions of a sample included.

    What has no slope at the point is said in `Linearisation.notes`, with what was used in its place: dry friction at standstill is
    left out (it acts as a disturbance up to its level), play is taken as closed, at a kink (the edge of a dead zone) the side with
    the larger slope is used. So is a point that lies far outside the records of the fit.

    Raises ModelError for unknown names, where there is no equilibrium, and where a slope is not finite.
    """
    source = to_plant(plant)
    linear = linearise_at(source, ModelFunctions(source.model), source.p, at, dt, method, delay)
    inputs, outputs = (
        {n: float(v) for n, v in zip(names, values, strict=True)}
        for names, values in ((linear.input_names, linear.u0), (linear.output_names, linear.y0))
    )
    return replace(linear, notes=(*linear.notes, *source.unseen(inputs, outputs)))


def linearise_at(
    plant: Plant, equations: ModelFunctions, p: np.ndarray, at: Mapping[str, float] | None,
    dt: float | None = None, method: str = "zoh", delay: float = 0.0,
) -> Linearisation:  # fmt: skip
    """`linearise` with ``equations`` made already, at the constants ``p`` (np,): what a family of models repeats."""
    point = solve_operating_point(equations, p, at)
    continuous = _about(plant, equations, p, point).late(delay)
    return continuous if dt is None else sample(continuous, dt, method)


def _about(plant: Plant, equations: ModelFunctions, p: np.ndarray, point: OperatingPoint) -> Linearisation:
    model, s, nx = plant.model, equations.system, equations.nx
    sides = differentiate_one_sided(equations, point.z, p)
    rates, outputs, closed = _closed(equations, sides, point.z, p)
    sizes = equations.sizes(point.z, p)
    rates, outputs = _rounded(rates, sizes), _rounded(outputs, sizes)
    rated = np.flatnonzero(equations.rated)
    delay = np.zeros(equations.nu)
    for d in s.delays:
        delay[d.column] += equations.seconds(d, p)
    states = [model.all_states[k] for k in rated]
    linear = Linearisation(
        name=model.title,
        A=rates[np.ix_(rated, rated)], B=rates[rated, nx:], C=outputs[:, rated], D=outputs[:, nx:],
        state_names=tuple(x.name for x in states), input_names=s.input_names, output_names=s.output_names,
        state_units=tuple(format_unit(x.unit) for x in states), input_units=tuple(format_unit(i.unit) for i in model.inputs),
        output_units=tuple(format_unit(o.unit) for o in model.outputs),
        x0=point.z[rated], u0=point.z[nx:], y0=np.array(list(point.outputs.values())),
        rates=np.array([point.rates[x.name] for x in states]), delay=delay,
        parameters=dict(zip(s.parameter_names, map(float, p), strict=True)),
    )  # fmt: skip
    notes = (*plant.notes, *point.notes, *sides.notes, *closed, *_without_effect(equations, linear, point, p))
    return Linearisation(**{**vars(linear), "notes": notes})


def _rounded(slopes: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Slopes without those that a typical move of their variable would lose in the rounding error of the row."""
    moves = np.abs(slopes * sizes)
    lost = np.isfinite(moves) & (moves <= ROUNDING * np.nansum(moves, axis=1, keepdims=True, where=np.isfinite(moves)))
    return np.where(lost, 0.0, slopes)


def _closed(
    equations: ModelFunctions, sides: OneSidedDerivatives, z: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Slopes with the states that are set after each step put in as functions of the others: play taken as closed."""
    rates, outputs, notes = sides.rates, sides.outputs, []
    for k, update in enumerate(equations.system.updates):
        slope, name = _engaged(equations, k, z, p), equations.names[update.state]
        if slope is None:
            raise ModelError(
                f"effect {update.effect!r} cannot be linearised: its state {name!r} depends on its own past wherever it is; leave the"
                f" effect out with model.without({update.effect!r}), or export the sampled nonlinear model"
            )
        rates = rates + np.outer(rates[:, update.state], slope)
        outputs = outputs + np.outer(outputs[:, update.state], slope)
        notes.append(
            f"{update.effect} cannot be linearised ({name} stays or moves with the rest): used instead is {name} moving with it all the"
            " time, as in a large motion one way"
        )
    return rates, outputs, notes


def _engaged(equations: ModelFunctions, k: int, z: np.ndarray, p: np.ndarray) -> np.ndarray | None:
    """Slope (nx + nu,) of what a state is set to, where that does not depend on the state itself; None if it always does."""
    state = equations.system.updates[k].state
    far = 1e6 * (1.0 + np.abs(z).max(initial=0.0))
    for shift in (-far, far):
        there = z.copy()
        there[state] += shift
        slope = equations.update_slopes(there, p)[k]
        if slope[state] == 0:
            return slope
    return None


def _without_effect(
    equations: ModelFunctions, linear: Linearisation, point: OperatingPoint, p: np.ndarray
) -> list[str]:
    """Inputs that move nothing at this point, with the effect that keeps them from it."""
    notes = []
    for j, name in enumerate(linear.input_names):
        if linear.B[:, j].any() or linear.D[:, j].any():
            continue
        guilty = [e.name for e in equations.model.effects if _input_acts(equations.model.without(e.name), point, j)]
        why = f" ({', '.join(guilty)})" if guilty else ""
        value = point.inputs[name]
        unit = format_unit(equations.model.inputs[j].unit)
        notes.append(
            f"input {name!r} has no effect at {name} = {value:.6g} {unit}{why}: the linear model has no gain from it; choose a point with"
            f" another {name}"
        )
    return notes


def _input_acts(model: Model, point: OperatingPoint, column: int) -> bool:
    reduced = ModelFunctions(model)
    everything = {**point.states, **point.inputs}
    z = np.array([everything[name] for name in reduced.names])
    found = differentiate_one_sided(reduced, z, np.array(list(model.values.values())))
    return bool(found.rates[:, reduced.nx + column].any() or found.outputs[:, reduced.nx + column].any())
