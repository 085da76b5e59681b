"""An observer of a fitted model: its Kalman filter, extended where the model is nonlinear, as what runs beside a controller.

It is the library's own filter (`greybox.simulation.filtering.kalman_filter`) with its numbers in it: at each sample the prediction is
corrected by the measurements that are there, then moved over one interval with the input held. C, FMU and Python are written from the same
step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.base import ModelError, nearest, to_identifier
from greybox.base.numerics import LARGEST_VALUE
from greybox.estimation import Fit, FitOptions
from greybox.estimation.linear.exported_model import ExportedModel, to_plant
from greybox.estimation.predictor import (
    CorrectionKind,
    FixedParameterModel,
    identify_correction,
    restore_integration_options,
)
from greybox.extensions.export.discrete_step import DiscreteStep, SteppedSignals, make_discrete_step
from greybox.extensions.export.target import read_template
from greybox.model import Input, Model, Output, State, docstring
from greybox.model.expressions.operations import OPERATIONS
from greybox.simulation.filtering import kalman_filter as kalman
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.tape import Tape, read_tape

NONE = np.empty(0, int)


class ObserverRun(NamedTuple):
    """A run over N samples: states (N, nx) and covariance (N, nx, nx), of each sample after its measurements and before them."""

    estimate: np.ndarray
    covariance: np.ndarray
    predicted: np.ndarray
    predicted_covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class Observer:
    """A Kalman filter with its numbers, sampled every ``dt`` seconds.

    Parameters
    ----------
    plant
        The model with its process noise, and the fit behind it.
    dt
        Sampling time in seconds.
    noise
        Output -> standard deviation of its sensor.
    process_noise
        State -> intensity, in its unit over root seconds.
    corrected
        One sample as a step whose outputs are the states after the measurements, and their standard deviations.
    predicted
        The same whose outputs are those before: known when the sample begins.
    """

    plant: ExportedModel
    dt: float
    noise: Mapping[str, float]
    process_noise: Mapping[str, float]
    corrected: DiscreteStep
    predicted: DiscreteStep
    correct_function: ca.Function

    @property
    def advance_function(self) -> ca.Function:
        """``(z, [u; y]) -> z`` one sample later."""
        z, w = ca.SX.sym("z", len(self.start)), ca.SX.sym("w", len(self.corrected.signals.inputs))
        return ca.Function("advance", [z, w], [self.corrected.step.advance(z, w, w, ca.SX(0, 1), self.dt)])

    @property
    def start(self) -> np.ndarray:
        """First state: the plant's states at rest and the lower triangle of their covariance."""
        return self.corrected.x0

    def correct(self, z: np.ndarray, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The state after the measurements ``y`` (ny,), NaN for one that is missing, with the input ``u`` (nu,)."""
        return np.asarray(self.correct_function(z, np.concatenate([u, y]))).ravel()

    def advance(self, z: np.ndarray, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The prediction for the next sample, from the one of this sample, its input and its measurements."""
        return self.corrected.advance(z, np.empty(0), np.concatenate([u, y]))

    def split(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States (nx,) and their covariance (nx, nx)."""
        nx = len(self.plant.model.all_states)
        return z[..., :nx], kalman.to_symmetric_arrays(z[..., nx:], nx)

    def run(self, inputs: np.ndarray, measured: np.ndarray) -> ObserverRun:
        """Run over inputs (N, nu) and measurements (N, ny), NaN where there is none.

        Parameters
        ----------
        inputs
            Inputs of the plant, held from sample to sample.
        measured
            Outputs of the plant.

        Returns
        -------
        ObserverRun
            Estimates and predictions with their covariance.
        """
        z, corrected, predicted = self.start, [], []
        for u, y in zip(inputs, measured, strict=True):
            # z is the prediction for this sample: corrected by its measurements for the estimate, moved on for the next one.
            predicted.append(z)
            corrected.append(self.correct(z, u, y))
            z = self.advance(z, u, y)
        return ObserverRun(*self.split(np.array(corrected)), *self.split(np.array(predicted)))


def design_observer(
    plant: Fit | Model,
    dt: float | None = None,
    *,
    noise: Mapping[str, float] | None = None,
    process_noise: Mapping[str, float] | None = None,
    initial_std: Mapping[str, float] | None = None,
    substeps: int = 0,
) -> Observer:
    """Make the Kalman filter of a fit or model, extended where it is nonlinear.

    Parameters
    ----------
    plant
        A fit, or a model at its present values.
    dt
        Sampling time in seconds; None takes that of the fitted records.
    noise
        Output -> standard deviation of its sensor; None takes the noise of the fit.
    process_noise
        State -> intensity of the white noise that drives it, in its unit over root seconds. None takes the model's
        own; of a fit without any,
        the most likely one for its records, as `greybox.predict` finds it.
    initial_std
        State -> standard deviation of its first value. None: all are as uncertain as process noise makes them in one interval.
    substeps
        Integration steps in a sampling interval; 0 chooses.

    Returns
    -------
    Observer
        To be run, or given to `to_c`, `to_fmu` and `to_python`.

    Raises
    ------
    ModelError
        Where no process noise or no sensor noise is known, for unknown names, and for a model with a delayed input.

    Examples
    --------
    >>> observer = gb.export.design_observer(fit, process_noise={"v": 0.5})  # doctest: +SKIP
    >>> gb.export.to_c(observer, "observer.c")  # doctest: +SKIP
    """
    source = to_plant(plant)
    source, noise = _find_noise(source, noise, process_noise)
    model = source.model
    outputs = [o.name for o in model.outputs]
    _check_names(model, noise, outputs, "output")
    missing = [name for name in outputs if name not in noise]
    if missing:
        raise ModelError(
            f"{model.title}: the noise of {', '.join(missing)} is not known; give noise={{{missing[0]!r}: <std>}}"
        )
    interval = make_discrete_step(source, dt, substeps=substeps)
    if interval.past:
        raise ModelError(
            f"{model.title} has a delayed input; an observer of it is not written: take the delay out, or shift the input"
        )
    nx, ny, nu = len(model.all_states), len(outputs), len(model.inputs)
    system, step = interval.model.system, interval.step
    # The filter's constants: those of the model, then the deviations of its sensors.
    pn = np.append(interval.p, [noise[name] for name in outputs])
    filter_step = kalman.make_filter_step(system, step)
    # Constants and noise are numbers from here on: what runs beside a controller has nothing to compute them from.
    q = ca.SX(ca.DM(filter_step.coefficients(pn, np.array([interval.dt]), NONE)[0][0]))
    z, w = ca.SX.sym("z", nx + nx * (nx + 1) // 2), ca.SX.sym("w", nu + ny)
    u, reading = w[:nu], w[nu:]
    present = ca.fabs(reading) <= LARGEST_VALUE  # not for NaN
    # NaN would pass through a product with zero: the reading itself is put to zero.
    y = ca.if_else(present, reading, 0.0)

    def row(share: float) -> ca.SX:
        return ca.vertcat(u, y, present, share)

    following, n = z, step.substeps
    for k in range(n):
        # All substeps written out, the correction in the first: the same instructions as in the library's filter.
        following = filter_step.advance(following, row(k / n), row((k + 1) / n), q, interval.dt / n)
    correction = _make_correction(step, nx, nu, ny, len(interval.p))
    after = correction(z, u, y, present, ca.DM(interval.p), ca.DM(pn[len(interval.p) :]))
    # z = [x; P], of the symmetric P the lower triangle column by column.
    start = np.append(interval.x0, kalman.to_lower_triangle_array(_first_covariance(interval, initial_std)))
    signals = _name_signals(model)

    def make_interval(state: ca.SX) -> DiscreteStep:
        # std_i = sqrt(P_ii)
        spread = ca.sqrt(ca.vertcat(*[kalman.to_symmetric(state[nx:], nx)[i, i] for i in range(nx)]))
        advance = ca.Function(
            "advance",
            [z, w, ca.SX.sym("ub", nu + ny), ca.SX.sym("q", 0), ca.SX.sym("h")],
            [ca.cse(ca.densify(following))],
        )
        read = ca.Function("outputs", [z, w, ca.SX.sym("p", 0)], [ca.cse(ca.densify(ca.vertcat(state[:nx], spread)))])
        # Constants are numbers in it: there are no coefficients to compute from them.
        whole = Step(
            f"Kalman filter, {step.label}", advance, read, lambda p, h, k: (np.zeros((1, 0)), np.zeros((1, 0, len(k))))
        )
        begin = ca.Function("start", [ca.SX.sym("p", 0)], [ca.SX(ca.DM(start))])
        measurements = tuple(i.name for i in signals.inputs[nu:])
        return DiscreteStep(interval.model, whole, interval.dt, np.empty(0), start, signals, begin, measurements)

    correct = ca.Function("correct", [z, w], [ca.cse(ca.densify(after))])
    intensities = {name: float(v) for name, v in model.noise_intensities.items()}
    return Observer(source, interval.dt, dict(noise), intensities, make_interval(after), make_interval(z), correct)


def _make_correction(step: Step, nx: int, nu: int, ny: int, constants: int) -> ca.Function:
    """``(z, u, y, present, p, noise) -> z`` after the measurements."""
    sizes = (nx + nx * (nx + 1) // 2, nu, ny, ny, constants, ny)
    names = ("z", "u", "y", "present", "p", "noise")
    z, u, y, present, p, noise = symbols = [ca.SX.sym(name, size) for name, size in zip(names, sizes, strict=True)]
    row = kalman.FilterRow(u, y, present, ca.SX(0))
    moments, _ = kalman.correct_by_measurement(
        step, kalman.Moments(z[:nx], kalman.to_symmetric(z[nx:], nx)), row, p, noise
    )
    return ca.Function("correct", symbols, [ca.vertcat(moments.x, kalman.to_lower_triangle(moments.P))])


def _find_noise(
    plant: ExportedModel, noise: Mapping[str, float] | None, process_noise: Mapping[str, float] | None
) -> tuple[ExportedModel, dict[str, float]]:
    """The plant with its process noise, and the noise of its sensors."""
    fit, model = plant.fit, plant.model
    known = dict(noise) if noise is not None else dict(fit.noise.std) if fit is not None else {}
    if process_noise is not None:
        _check_names(model, process_noise, [s.name for s in model.all_states], "state")
        return ExportedModel(model.with_process_noise(**process_noise), fit, plant.findings), known
    # What the model states goes before what records show.
    if any(model.noise_intensities.values()):
        return plant, known
    if fit is not None and fit.traces:
        options: FitOptions = restore_integration_options(fit)
        # The most likely intensities for the residual of the fit, as a prediction takes them.
        correction = identify_correction(FixedParameterModel(model, known, options), [t.experiment for t in fit.traces])
        if correction.kind is CorrectionKind.ESTIMATED_KALMAN_FILTER:
            return ExportedModel(correction.model, fit, plant.findings), dict(
                correction.noise
            ) if noise is None else known
        why = "and its records show none"
    else:
        why = "and there are no records to estimate it from"
    state = model.all_states[-1].name
    raise ModelError(
        f"{model.title} has no process noise, {why}: a filter without it would not correct the states; give"
        f" process_noise={{{state!r}: <intensity>}} (shell: --process-noise {state}=VALUE)"
    )


def _check_names(model: Model, given: Mapping[str, float], names: list[str], kind: str) -> None:
    for name, value in given.items():
        if name not in names:
            raise ModelError(f"{model.title} has no {kind} {name!r}; {nearest(name, names)}")
        if not (np.isfinite(value) and value > 0):
            raise ModelError(f"{kind} {name!r}: noise of {value}; give a number above 0")


def _first_covariance(interval: DiscreteStep, initial_std: Mapping[str, float] | None) -> np.ndarray:
    """Covariance (nx, nx) of the first states."""
    system, step, dt = interval.model.system, interval.step, interval.dt
    names = [s.name for s in interval.model.all_states]
    nx = len(names)
    if initial_std is not None:
        _check_names(interval.model, initial_std, names, "state")
        # Independent of each other; a state that is not named is known exactly.
        return np.diag([initial_std.get(name, 0.0) ** 2 for name in names])
    if step.per_interval:
        # Q of one interval, exactly: integral of Phi W Phi' over it.
        lower = kalman.discretise_process_noise(system)(interval.p, np.array([dt]), NONE)[0][0]
        return kalman.to_symmetric_arrays(lower, nx)
    u, q, h = ca.SX.sym("u", step.advance.size1_in(1)), ca.SX.sym("q", step.advance.size1_in(3)), ca.SX.sym("h")
    # Of a Runge-Kutta step: through the same substeps as the state.
    noise = ca.Function("noise", [system.x, u, q, system.p, h], [kalman.compute_interval_noise(step, system, u, q, h)])
    return np.asarray(noise(interval.x0, 0, interval.coefficients(), interval.p, dt))


def _name_signals(model: Model) -> SteppedSignals:
    """Inputs of the plant and its measurements in, states and their covariance kept, estimates and their deviations out."""
    states = list(model.all_states)
    measured = tuple(
        Input(f"measured_{o.name}", o.unit, description=f"measurement of {o.name}, NaN if missing")
        for o in model.outputs
    )
    spread = tuple(Output(f"std_{s.name}", s.unit, description=f"standard deviation of {s.name}") for s in states)
    estimates = tuple(Output(s.name, s.unit, description=f"estimate of {s.name}") for s in states)
    covariances = tuple(
        State(f"P_{a.name}_{b.name}", f"({a.unit})*({b.unit})", description=f"covariance of {a.name} and {b.name}")
        for j, b in enumerate(states)
        for a in states[j:]
    )
    return SteppedSignals(
        f"{model.title}, observer",
        f"{model.name}_observer",
        f"Kalman filter of {model.title}",
        (*model.inputs, *measured),
        (*estimates, *spread),
        (*states, *covariances),
    )


def refuse_sampling(dt: float | None, substeps: int) -> None:
    """Raise ModelError where a sampling time is given for an observer, which has one."""
    if dt is not None or substeps:
        raise ModelError("an observer has its sampling time; give dt and substeps to design_observer")


# An observer as a Python class that needs NumPy alone.

GATE = "({1} if {0} else 0.0)"
"""A value where a condition holds, else zero, also where the value is no number."""


def write_observer_class(observer: Observer) -> str:
    """The text of the file."""
    signals, model = observer.corrected.signals, observer.plant.model
    noise = [f"sensor {n}: {v:.6g}" for n, v in observer.noise.items()]
    noise += [f"process {n}: {v:.6g} per root second" for n, v in observer.process_noise.items() if v]
    filtered = f"Kalman filter of {signals.title.removesuffix(', observer')}, sampled every {observer.dt:g} s."
    origin = [list(observer.plant.origin()), ["Standard deviations of the noise:", *noise]]
    return read_template(
        "observer_class.txt",
        about="\n".join(docstring(f"{filtered} Generated by greybox.", origin)),
        title="".join(part.capitalize() for part in to_identifier(signals.name).split("_")),
        dt=repr(observer.dt),
        states=tuple(s.name for s in model.all_states),
        inputs=tuple(i.name for i in model.inputs),
        measurements=tuple(o.name for o in model.outputs),
        start=observer.start.tolist(),
        nx=len(model.all_states),
        correct=_write_function("_correct", read_tape(observer.correct_function)),
        advance=_write_function("_advance", read_tape(observer.advance_function)),
    )


def _write_function(name: str, tape: Tape) -> str:
    """``def name(z, w)``, one line for each instruction."""
    lines = [f"def {name}(z, w):"]
    texts: dict[int, str] = {}
    for kind, k in tape.order:
        node = tape.nodes[k]
        if kind != "node":
            continue
        # A negative number in brackets: it may stand behind a minus or a power.
        if node.op == ca.OP_CONST:
            texts[k] = f"({node.number!r})" if (node.number or 0.0) < 0 else repr(node.number)
        elif node.op == ca.OP_INPUT:
            texts[k] = f"{'zw'[node.args[0]]}[{node.args[1]}]"
        else:
            template = GATE if node.op == ca.OP_IF_ELSE_ZERO else OPERATIONS[node.op].numpy or OPERATIONS[node.op].c
            lines.append(f"    t{k} = {template.format(*(texts[a] for a in node.args))}")
            texts[k] = f"t{k}"
    return "\n".join([*lines, f"    return [{', '.join(texts[node] for node, _ in tape.outputs[0])}]"])
