"""Linear models about an operating point; what has no derivative there is named, and so is what replaces it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from greybox.base import Finding, ModelError, Severity, format_unit
from greybox.base.numerics import CANCELLED_DERIVATIVE, SAME_DERIVATIVE, TINY
from greybox.data.experiment import Experiment
from greybox.estimation.linear.exported_model import ExportedModel, ExportFinding, format_signals, to_plant
from greybox.estimation.linear.linearisation import Linearisation
from greybox.estimation.linear.operating_point import ModelFunctions, OperatingPoint, solve_operating_point
from greybox.estimation.linear.sampling import sample
from greybox.estimation.result import Fit
from greybox.model import Model
from greybox.simulation.free_run import differentiate_equations
from greybox.simulation.plant import CanLinearise, Plant, PlantModel
from greybox.simulation.simulate import declared_initial_state, simulate

# Derivatives where they differ by side: dry friction at standstill, the edge of a dead zone, a valve that is just shut.


@dataclass(frozen=True)
class OneSidedDerivatives:
    """Jacobians of the rates (nx, nx + nu) and of the outputs (ny, nx + nu), and what was chosen where there was a choice."""

    rates: np.ndarray
    outputs: np.ndarray
    findings: tuple[Finding, ...]


def differentiate_one_sided(functions: ModelFunctions, z: np.ndarray, p: np.ndarray) -> OneSidedDerivatives:
    """Jacobians at ``z``, of each variable on the side where they are larger; dry friction at standstill without its jump."""
    jacobian, kinks = _differentiate(functions, z, p)
    findings, names = [], functions.names
    # What replaces dry friction.
    for k, (push, static) in functions.holding(z, p).items():
        if static == 0:
            continue
        effects = [d.effect for d in functions.system.dry if d.state == k]
        balance = next(b for b in functions.system.balances if b.state == names[k])
        values: dict[str, Any] = {
            "effects": effects,
            "state": names[k],
            "level": static,
            "held": abs(push),
            "unit": format_unit(balance.unit),
        }
        findings.append(Finding(ExportFinding.FRICTION_LEFT_OUT, Severity.WARNING, " and ".join(effects), values))
    # Kinks: an effect without which one is gone is the one that makes it.
    for column, side in kinks:
        responsible = []
        for effect in functions.model.effects:
            reduced = ModelFunctions(functions.model.without(effect.name))
            if names[column] not in reduced.names:
                continue
            reduced_z = np.array([z[names.index(name)] for name in reduced.names])
            reduced_p = np.array(list(reduced.model.values.values()))
            kinked = [c for c, _ in _differentiate(reduced, reduced_z, reduced_p)[1]]
            if reduced.names.index(names[column]) not in kinked:
                responsible.append(effect.name)
        values = {
            "effects": responsible,
            "model": functions.model.name,
            "variable": names[column],
            "value": float(z[column]),
            "unit": format_unit(functions.units[column]),
            "side": "above" if side > 0 else "below",
        }
        findings.append(Finding(ExportFinding.KINK, Severity.WARNING, names[column], values))
    return OneSidedDerivatives(jacobian[: functions.nx], jacobian[functions.nx :], tuple(findings))


def _differentiate(functions: ModelFunctions, z: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Jacobian (nx + ny, nx + nu), and the variables in which it differs by side with the side (1 or -1) that was taken."""
    sizes, at_rest = functions.sizes(z, p), [k for k in functions.bodies if z[k] == 0]
    direction = functions.direction(z)
    if not at_rest:
        return _differentiate_by_column(functions, z, p, sizes, direction)
    # Friction jumps at standstill: its derivative is the mean of those while sliding either way, from which the jump is left out.
    results = []
    for way in (1, -1):
        sliding = np.where([d.state in at_rest for d in functions.system.dry], way, direction)
        results.append(_differentiate_by_column(functions, z, p, sizes, sliding, dict.fromkeys(at_rest, way)))
    (forward, kinks), (backward, _) = results
    # (df/dv|+ + df/dv|-) / 2: a level that falls with the velocity has opposite slopes either way, and the jump
    # itself none.
    return (forward + backward) / 2, kinks


def _differentiate_by_column(
    functions: ModelFunctions,
    z: np.ndarray,
    p: np.ndarray,
    sizes: np.ndarray,
    direction: np.ndarray,
    decided: dict[int, int] | None = None,
) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Jacobian column by column; ``decided`` are the sides of variables that leave no choice."""
    switches = functions.switches(direction)
    edges = switches.edges(z, sizes, p)
    jacobian = switches.jacobian(edges, z, np.zeros(len(z)), p)[1]
    if not len(edges):
        return jacobian, []
    jacobian, kinks = jacobian.copy(), []
    # Rows of a column have units of their own: each counts by what a typical move changes in it.
    weight = 1 / np.maximum(np.abs(jacobian * sizes).sum(axis=1), TINY)
    for column in range(len(z)):
        move = np.zeros(len(z))
        move[column] = sizes[column]
        above, below = (switches.jacobian(edges, z, side * move, p)[1][:, column] for side in (1, -1))
        if decided and column in decided:
            jacobian[:, column] = above if decided[column] > 0 else below
            continue
        # Derivatives from both sides: the same expressions at a point moved along one variable, with only its
        # switches thrown.
        differs = np.abs(above - below) > SAME_DERIVATIVE * np.maximum(np.abs(above), np.abs(below))
        # The larger one, which does not understate what the variable does.
        larger = 1 if np.linalg.norm(weight * above) >= np.linalg.norm(weight * below) else -1
        jacobian[:, column] = above if larger > 0 else below
        if differs.any():
            kinks.append((column, larger))
    return jacobian, kinks


# A point further outside the records than this share of their range is reported.
OPERATING_POINT_EXTRAPOLATION = 0.5


def linearise(
    plant: Fit | Model | Plant,
    at: Mapping[str, float] | None = None,
    *,
    along: Experiment | None = None,
    dt: float | None = None,
    method: str = "zoh",
    delay: float = 0.0,
) -> Linearisation:
    """Linearise a fit, or a model at its present values, about an operating point; a plant without equations about a run.

    What has no derivative at the point is among the findings, with what replaces it: dry friction at standstill is left out (it
    acts as a disturbance up to its level), play is taken as closed, and at a kink (the edge of a dead zone) the side with the larger
    derivative is used. So is a point that lies far outside the records of the fit.

    Parameters
    ----------
    plant
        A fit, a model, or a plant.
    at
        States and inputs by name, in the model's units; what it leaves out is solved for, see `find_operating_point`. None: inputs of
        zero; of a fit that was not there, or whose inputs act by products, their means in its records, or where these begin.
    along
        The record along which a plant without equations is run, one that can linearise (`greybox.simulation.plant.CanLinearise`), such as
        an FMU; None: the longest of the fit.
    dt
        Sampling time in seconds; None: continuous.
    method
        ``zoh`` (exact for a held input) or ``tustin``.
    delay
        Seconds by which every input arrives late besides what the model says itself, fractions of a sample included.

    Returns
    -------
    Linearisation
        Matrices with names and units, the operating point, and findings.

    Raises
    ------
    ModelError
        For unknown names, a state outside its bounds, where there is no equilibrium, where a derivative is not finite, and for a plant
        that cannot be linearised.

    Examples
    --------
    >>> linear = gb.linearise(fit, {"u": 0.5}, dt=1e-3)  # doctest: +SKIP
    >>> linear.poles  # doctest: +SKIP
    """
    source = to_plant(plant, with_equations=False)
    if isinstance(source.model, PlantModel):
        linear = _linearise_run(source, source.model, at, along).with_delay(delay)
        return linear if dt is None else sample(linear, dt, method)
    if along is not None:
        raise ModelError(f"{source.model.title} has equations: it is linearised about a point; give at=, not along=")
    functions = ModelFunctions(source.model)
    point, chosen = choose_point(source, functions, at)
    linear = linearise_at(source, functions, source.p, point, dt, method, delay)
    inputs, outputs = (
        {n: float(v) for n, v in zip(names, values, strict=True)}
        for names, values in ((linear.input_names, linear.u0), (linear.output_names, linear.y0))
    )
    outside = source.find_extrapolation(inputs, outputs, OPERATING_POINT_EXTRAPOLATION)
    if point and chosen:
        outside = (Finding(chosen, Severity.NOTE, values={"inputs": dict(point)}), *outside)
    return replace(linear, findings=(*linear.findings, *outside))


# A point that nobody asked for may lie outside the records by this share of their range: noise and a rounded end, no more.
CHOSEN_POINT_EXTRAPOLATION = 0.05


def choose_point(
    source: ExportedModel, functions: ModelFunctions, at: Mapping[str, float] | None
) -> tuple[Mapping[str, float] | None, ExportFinding | None]:
    """``at``; where nothing is asked for, a point of the fit's records at which the plant rests, and how it was chosen.

    Inputs of zero come first. Where inputs act by products they come last: without any input such a model has no gain (a valve that is
    shut, a supply without pressure), and it may have no state either.

    Raises
    ------
    ModelError
        Where inputs act by products and the plant rests at none of these points.
    """
    if at or source.fit is None or not source.recorded_inputs:
        return at, None
    recorded = source.recorded_inputs
    means = {name: float(np.mean(np.concatenate(values))) for name, values in recorded.items()}
    begins = [
        {name: float(v[0]) for name, v in zip(recorded, each, strict=True)}
        for each in zip(*recorded.values(), strict=True)
    ]
    points = [(means, ExportFinding.ABOUT_THE_MEANS), *((b, ExportFinding.ABOUT_THE_BEGINNING) for b in begins)]
    _, b, _, d = differentiate_equations(functions.system)
    by_products = ca.depends_on(ca.vertcat(ca.vec(b), ca.vec(d)), functions.z)
    candidates = [*points, (None, None)] if by_products else [(None, None), *points]
    for point, chosen in candidates:
        try:
            linear = linearise_at(source, functions, source.p, point)
        except ModelError:  # the plant does not come to rest there, or has no finite slope
            continue
        inputs = dict(zip(linear.input_names, map(float, linear.u0), strict=True))
        outputs = dict(zip(linear.output_names, map(float, linear.y0), strict=True))
        if not source.find_extrapolation(inputs, outputs, CHOSEN_POINT_EXTRAPOLATION):
            return point, chosen
    if not by_products:
        return at, None
    raise ModelError(
        f"{source.model.title} rests at no point of its records: not at the means of the inputs, nor where they begin, nor without"
        f" inputs; {source.propose_point()}"
    )


def _linearise_run(
    source: ExportedModel, model: PlantModel, at: Mapping[str, float] | None, along: Experiment | None
) -> Linearisation:
    """The answer of a plant without equations to small changes of its inputs along a record, about the means of its run."""
    if not isinstance(model.plant, CanLinearise):
        model.require_equations("a linearisation")
    if at:
        raise ModelError(f"{model.title} is run from outside: it is linearised along a record; give along=, not at=")
    record = along or max(
        (t.experiment for t in (source.fit.traces if source.fit else ())), key=lambda e: e.rows, default=None
    )
    if record is None:
        raise ModelError(f"{model.title} is run from outside: it is linearised along a record; give along=")
    start = dict(zip(model.system.state_names, declared_initial_state(model).tolist(), strict=True))
    response = model.plant.linearise(record, {**model.values, **model.tied_values, **start})
    if response is None:
        raise ModelError(
            f"{model.title}: no linear system follows its answer to small changes of the inputs along {record.name}"
        )
    run, order = simulate(model, record).outputs, len(response.A)
    share = min(response.explained.values(), default=1.0)
    return Linearisation(
        name=model.title,
        A=response.A,
        B=response.B,
        C=response.C,
        D=response.D,
        state_names=tuple(f"response_{k + 1}" for k in range(order)),
        input_names=tuple(i.name for i in model.inputs),
        output_names=tuple(o.name for o in model.outputs),
        state_units=("1",) * order,
        input_units=tuple(format_unit(i.unit) for i in model.inputs),
        output_units=tuple(format_unit(o.unit) for o in model.outputs),
        x0=np.zeros(order),
        u0=np.array([float(np.mean(record.inputs[i.name])) for i in model.inputs]),
        y0=np.array([float(np.mean(run[o.name])) for o in model.outputs]),
        rates=np.zeros(order),
        delay=np.zeros(len(model.inputs)),
        parameters=dict(model.values),
        findings=(*source.findings, Finding(ExportFinding.ABOUT_A_RUN, subject=record.name, values={"share": share})),
    )


def linearise_at(
    plant: ExportedModel,
    functions: ModelFunctions,
    p: np.ndarray,
    at: Mapping[str, float] | OperatingPoint | None,
    dt: float | None = None,
    method: str = "zoh",
    delay: float = 0.0,
) -> Linearisation:
    """`linearise` with the ``functions`` of the model made already, at the parameters ``p`` (np,): what a family of models repeats.

    ``at`` may be the operating point itself.
    """
    point = at if isinstance(at, OperatingPoint) else solve_operating_point(functions, p, at)
    model, system, nx = plant.model, functions.system, functions.nx
    try:
        with np.errstate(over="raise"):
            derivatives = differentiate_one_sided(functions, point.z, p)
    except FloatingPointError as error:
        raise ModelError(
            f"linear model of {model.title}: no finite slope at {format_signals(functions.names, point.z, functions.units)} (a root at"
            f" zero, a division by zero); {plant.propose_point()}"
        ) from error
    rates, outputs, closed = _close_play(functions, derivatives, point.z, p)
    # After play is closed: its slopes may cancel against others.
    sizes = functions.sizes(point.z, p)
    rates, outputs = _remove_cancelled(rates, sizes), _remove_cancelled(outputs, sizes)
    rated = np.flatnonzero(functions.rated)
    late = np.zeros(functions.nu)
    for d in system.delays:
        late[d.column] += functions.seconds(d, p)
    states = [model.all_states[k] for k in rated]
    linear = Linearisation(
        name=model.title,
        A=rates[np.ix_(rated, rated)],
        B=rates[rated, nx:],
        C=outputs[:, rated],
        D=outputs[:, nx:],
        state_names=tuple(x.name for x in states),
        input_names=system.input_names,
        output_names=system.output_names,
        state_units=tuple(format_unit(x.unit) for x in states),
        input_units=tuple(format_unit(i.unit) for i in model.inputs),
        output_units=tuple(format_unit(o.unit) for o in model.outputs),
        x0=point.z[rated],
        u0=point.z[nx:],
        y0=np.array(list(point.outputs.values())),
        rates=np.array([point.rates[x.name] for x in states]),
        delay=late,
        parameters=dict(zip(system.parameter_names, map(float, p), strict=True)),
        is_exact=system.linear,
    )
    idle = _find_idle_inputs(functions, linear, point)
    linear = replace(linear, findings=(*plant.findings, *point.findings, *derivatives.findings, *closed, *idle))
    linear = linear.with_delay(delay)
    return linear if dt is None else sample(linear, dt, method)


def _remove_cancelled(jacobian: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """The Jacobian without entries that a typical move of their variable would lose in the rounding error of the row."""
    # Terms of a row add up: what is below the rounding error of their sum is what cancellation left.
    moves = np.abs(jacobian * sizes)
    finite = np.isfinite(moves)
    row = np.nansum(moves, axis=1, keepdims=True, where=finite)
    return np.where(finite & (moves <= CANCELLED_DERIVATIVE * row), 0.0, jacobian)


def _close_play(
    functions: ModelFunctions, derivatives: OneSidedDerivatives, z: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[Finding]]:
    """Jacobians with the states that are set after each step expressed by the others: play taken as closed."""
    rates, outputs, findings = derivatives.rates, derivatives.outputs, []
    for k, update in enumerate(functions.system.updates):
        # Far on either side play is engaged: there w = s -+ gap, whose slope does not hold w itself.
        far, name, slope = 1e6 * (1.0 + np.abs(z).max(initial=0.0)), functions.names[update.state], None
        for shift in (-far, far):
            shifted = z.copy()
            shifted[update.state] += shift
            slopes = functions.update_slopes(shifted, p)[k]
            if slope is None and slopes[update.state] == 0:
                slope = slopes
        if slope is None:
            raise ModelError(
                f"effect {update.effect!r} cannot be linearised: its state {name!r} depends on its own past at every operating point; leave"
                f" the effect out with model.without({update.effect!r}), or export the sampled nonlinear model"
            )
        # w+ = g' z: dx/dt = f_x x + f_w w becomes (f_x + f_w g') x.
        rates = rates + np.outer(rates[:, update.state], slope)
        outputs = outputs + np.outer(outputs[:, update.state], slope)
        values = {"state": name}
        findings.append(Finding(ExportFinding.PLAY_CLOSED, Severity.WARNING, update.effect, values))
    return rates, outputs, findings


def _find_idle_inputs(functions: ModelFunctions, linear: Linearisation, point: OperatingPoint) -> list[Finding]:
    """Inputs that move nothing at this point, with the effects that keep them from it."""
    findings = []
    for j, name in enumerate(linear.input_names):
        if linear.B[:, j].any() or linear.D[:, j].any():
            continue
        effects, known = [], {**point.states, **point.inputs}
        for effect in functions.model.effects:
            reduced = ModelFunctions(functions.model.without(effect.name))
            z = np.array([known[n] for n in reduced.names])
            derivatives = differentiate_one_sided(reduced, z, np.array(list(reduced.model.values.values())))
            k = reduced.nx + j
            if derivatives.rates[:, k].any() or derivatives.outputs[:, k].any():
                effects.append(effect.name)
        values = {
            "value": float(point.inputs[name]),
            "unit": format_unit(functions.model.inputs[j].unit),
            "effects": effects,
        }
        findings.append(Finding(ExportFinding.INPUT_WITHOUT_EFFECT, Severity.WARNING, name, values))
    return findings
