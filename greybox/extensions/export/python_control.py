"""Hand-over to python-control: linear models with signal names, and the nonlinear model, continuous or sampled."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.base import Finding, ModelError, Severity, nearest, to_identifier, to_identifiers
from greybox.estimation.linear.exported_model import ExportFinding, to_plant
from greybox.estimation.linear.linearisation import Linearisation, minimal_realisation
from greybox.estimation.linear.linearise import linearise
from greybox.estimation.linear.transfer_channel import extract_channel
from greybox.estimation.result import Fit
from greybox.extensions.export import discrete_step
from greybox.model import Model
from greybox.simulation.kernel.c_compiler import GreyboxWarning

FORMS = ("state_space", "transfer_function", "nonlinear")


def to_control(
    plant: Fit | Model | Linearisation,
    at: Mapping[str, float] | None = None,
    *,
    dt: float | None = None,
    method: str = "zoh",
    delay: float = 0.0,
    form: str = "state_space",
    minimal: bool = False,
    pade: int = 4,
) -> Any:
    """Convert a fit, a model or a linear model to a system of python-control, with signal names.

    Parameters
    ----------
    plant
        A fit, a model at its present values, or a `Linearisation`, whose operating point and sampling stay as they are.
    at
        The operating point: states and inputs by name, in the model's units; see `linearise`.
    dt, method, delay
        Sampling, as in `linearise`.
    form
        ``state_space``, ``transfer_function``, or ``nonlinear``: a ``control.NonlinearIOSystem``, for which ``at``, ``method``,
        ``delay`` and ``minimal`` do not apply (see `to_nonlinear_system`).
    minimal
        Whether states that no input reaches or no output shows are removed.
    pade
        Order in which the delay of a continuous model is approximated.

    Returns
    -------
    control.StateSpace, control.TransferFunction or control.NonlinearIOSystem
        Linear systems carry their `Linearisation` as the attribute ``linearisation``: units, operating point, findings. Findings (no
        equilibrium, what replaces dry friction, a sampling time that is too long) are given as warnings.

    Raises
    ------
    ModelError
        For unknown names, and for options that do not apply.

    Examples
    --------
    >>> system = gb.export.to_control(fit, {"u": 0.5}, dt=1e-3)  # doctest: +SKIP
    >>> system.linearisation.output_units  # doctest: +SKIP
    """
    if form not in FORMS:
        raise ModelError(f"unknown form {form!r}; {nearest(form, FORMS)}")
    # Options that would change nothing are refused, not ignored.
    given = (("at", at), ("delay", delay), ("minimal", minimal), ("method", method != "zoh"), ("dt", dt is not None))
    if isinstance(plant, Linearisation):
        unused = [name for name, value in given if value and name != "minimal"]
        if unused or form == "nonlinear":
            what = ", ".join(unused) or "form='nonlinear'"
            raise ModelError(
                f"{what} cannot be given for a linear model, which is used unchanged; give a fit or a model"
            )
        linear = plant
    elif form == "nonlinear":
        unused = [name for name, value in given if value and name != "dt"]
        if unused:
            raise ModelError(
                f"{', '.join(unused)} cannot be given with form='nonlinear'; leave them out, or use another form"
            )
        _warn(to_plant(plant).findings)
        return to_nonlinear_system(plant, dt)
    else:
        linear = linearise(plant, at, dt=dt, method=method, delay=delay)
        _warn(linear.findings)
    reduced = minimal_realisation(linear) if minimal else linear
    return to_state_space(reduced, pade) if form == "state_space" else to_transfer_function(reduced, pade)


def _warn(findings: tuple[Finding, ...]) -> None:
    for finding in findings:
        warnings.warn(str(finding), GreyboxWarning, stacklevel=3)


# ---- Linear models ----


def to_state_space(model: Linearisation, pade: int = 4) -> Any:
    """Convert a linear model to a ``control.StateSpace`` with signal names.

    Parameters
    ----------
    model
        A linear model, continuous or sampled.
    pade
        A delay of a continuous model is not in its matrices: it becomes a Pade approximation of this order, whose states come last.

    Returns
    -------
    control.StateSpace
        Its attribute ``linearisation`` is ``model``, with units, operating point and findings.

    Raises
    ------
    ModelError
        For an order outside 1 to 10.

    Examples
    --------
    >>> system = gb.export.to_state_space(gb.linearise(model))  # doctest: +SKIP
    """
    import control

    finite = approximate_delays(model, pade) if model.delay.any() else model
    system = control.StateSpace(
        finite.A,
        finite.B,
        finite.C,
        finite.D,
        finite.dt,
        states=to_identifiers(finite.state_names),
        inputs=to_identifiers(finite.input_names),
        outputs=to_identifiers(finite.output_names),
        name=to_identifier(finite.name),
        # States keep their names and number, also where nothing reaches them: the model says which they are.
        remove_useless_states=False,
    )
    system.linearisation = model
    return system


def to_transfer_function(model: Linearisation, pade: int = 4) -> Any:
    """Convert a linear model to a ``control.TransferFunction`` with signal names, each channel cancelled by itself.

    Parameters
    ----------
    model
        A linear model, continuous or sampled.
    pade
        Order of the Pade approximation of a delay, as in `to_state_space`.

    Returns
    -------
    control.TransferFunction
        One numerator and denominator for each channel; its attribute ``linearisation`` is ``model``.

    Raises
    ------
    ModelError
        For an order outside 1 to 10.

    Examples
    --------
    >>> system = gb.export.to_transfer_function(gb.linearise(model))  # doctest: +SKIP
    """
    import control

    finite = approximate_delays(model, pade) if model.delay.any() else model
    # Channel by channel: a pole that one channel does not see is cancelled there and stays elsewhere.
    rows = [[extract_channel(finite, o, i) for i in finite.input_names] for o in finite.output_names]

    def each(of: str) -> list[list[np.ndarray]]:
        return [[getattr(channel, of) for channel in row] for row in rows]

    system = control.TransferFunction(
        each("numerator"),
        each("denominator"),
        finite.dt,
        inputs=to_identifiers(finite.input_names),
        outputs=to_identifiers(finite.output_names),
        name=to_identifier(finite.name),
    )
    system.linearisation = model
    return system


# Highest order of a Pade approximation; beyond it the coefficients lose all digits.
LARGEST_PADE_ORDER = 10


def approximate_delays(model: Linearisation, order: int) -> Linearisation:
    """A continuous ``model`` with its delays as Pade approximations of this ``order``, and a note up to which frequency they hold."""
    import control
    from scipy.signal import tf2ss  # half a second to import

    if not 1 <= order <= LARGEST_PADE_ORDER:
        raise ModelError(f"order {order} of a Pade approximation: give 1 to {LARGEST_PADE_ORDER}")
    # Of a delay of one second; another delay only changes the unit of time.
    fraction = control.pade(1.0, order)
    unit, reach = tf2ss(*fraction), _find_pade_reach(*fraction)
    A, B, C, D = model.A, model.B.copy(), model.C, model.D.copy()
    names, units, findings = list(model.state_names), list(model.state_units), list(model.findings)
    for j, seconds in enumerate(model.delay):
        if not seconds:
            continue
        # P(s T): time in units of the delay divides A and B by it.
        # d = P(infinity) = (-1)^order.
        a, b, c, d = unit[0] / seconds, unit[1] / seconds, unit[2], float(unit[3][0, 0])
        corner = np.zeros((len(a), len(A)))
        # u_late = c x_d + d u enters where u did: B_j c beside A, B_j d in its own column.
        A = np.block([[A, np.outer(B[:, j], c)], [corner, a]])
        # y = C x + D_j (c x_d + d u)
        C = np.hstack([C, np.outer(D[:, j], c)])
        D[:, j] *= d
        B = np.vstack([B, np.zeros((len(a), B.shape[1]))])
        B[:, j] *= d
        # The chain itself is driven by the input as it is.
        B[-len(a) :, j] = b.ravel()
        names += [f"{model.input_names[j]}_late_{i + 1}" for i in range(len(a))]
        units += [model.input_units[j]] * len(a)
        values = {"delay": float(seconds), "order": order, "limit": reach / seconds}
        findings.append(Finding(ExportFinding.DELAY_APPROXIMATED, Severity.NOTE, model.input_names[j], values))
    extra = len(A) - len(model.A)
    return replace(
        model,
        A=A,
        B=B,
        C=C,
        D=D,
        state_names=tuple(names),
        state_units=tuple(units),
        delay=np.zeros_like(model.delay),
        x0=np.append(model.x0, np.zeros(extra)),
        rates=np.append(model.rates, np.zeros(extra)),
        findings=tuple(findings),
    )


# Radians by which the phase of an approximation may be wrong where it is said to hold.
PADE_PHASE = np.deg2rad(1.0)


def _find_pade_reach(numerator: Sequence[float], denominator: Sequence[float]) -> float:
    """Largest ``w delay`` up to which a Pade approximation of ``exp(-s)`` has the phase of the delay, ``-w``, to within `PADE_PHASE`.

    Its gain is that of a delay everywhere: one.
    """
    # It leaves the delay before its own phase ends: an order n turns by 180 n degrees in all.
    w = np.linspace(0.0, np.pi * len(denominator), 20_001)
    phase = np.unwrap(np.angle(np.polyval(numerator, 1j * w) / np.polyval(denominator, 1j * w)))
    return float(w[np.argmax(np.abs(phase + w) > PADE_PHASE)])


# ---- The nonlinear model ----


def to_nonlinear_system(plant: Fit | Model, dt: float | None = None, *, substeps: int = 0) -> Any:
    """Convert a fit or model to a ``control.NonlinearIOSystem`` with signal names.

    Parameters
    ----------
    plant
        A fit, or a model at its present values.
    dt
        None: the continuous equations. Seconds: one sampling interval with held inputs, stepped as the library steps it, with dry
        friction that sticks, play and delays in it (earlier values of a delayed input are states ``u_1, u_2, ...``).
    substeps
        Integration steps in a sampling interval; 0 chooses.

    Returns
    -------
    control.NonlinearIOSystem
        Its ``params`` are the model's parameters by name, without those of a delay.

    Raises
    ------
    ModelError
        For a continuous system of a model with an effect that is more than a differential equation; it names the effect.

    Examples
    --------
    >>> system = gb.export.to_nonlinear_system(fit, 1e-3)  # doctest: +SKIP
    """
    import control

    source = to_plant(plant)
    model, s = source.model, source.model.system
    nx, nu = s.x.numel(), s.u.numel()
    # Constants that may be changed, under names that control systems allow: a delay decides how many states there are.
    named = dict(zip(to_identifiers(s.parameter_names), map(float, source.p), strict=True))
    late = discrete_step.find_delay_parameters(model)
    free = {name: v for (name, v), true in zip(named.items(), s.parameter_names, strict=True) if true not in late}
    step = None if dt is None else discrete_step.make_discrete_step(source, dt, substeps=substeps)
    if step is None:
        discrete_step.refuse_discontinuous(model)

    def given(x: Any, u: Any, params: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        p = np.array([params.get(name, value) for name, value in named.items()])
        return np.asarray(x, float).ravel(), np.asarray(u, float).ravel()[:nu], p

    def update(t: float, x: Any, u: Any, params: Mapping[str, float]) -> np.ndarray:
        x, u, p = given(x, u, params)
        if step is None:
            return s.rhs_function(x[:nx], u, p).full().ravel()
        after = step.advance(x[:nx], x[nx:], u, p)
        # The earlier inputs move back by one sample.
        return np.concatenate([after, u[[step.late_input]], x[nx:-1]]) if step.past else after

    def read(t: float, x: Any, u: Any, params: Mapping[str, float]) -> np.ndarray:
        x, u, p = given(x, u, params)
        if step is None:
            return s.output_function(x[:nx], u, p).full().ravel()
        return step.outputs(x[:nx], x[nx:], u, p)

    return control.NonlinearIOSystem(
        update,
        read,
        inputs=to_identifiers(s.input_names),
        outputs=to_identifiers(s.output_names),
        states=to_identifiers([*s.state_names, *(discrete_step.name_past_inputs(step) if step else [])]),
        params=free,
        name=to_identifier(model.title),
        **({"dt": step.dt} if step else {}),
    )
