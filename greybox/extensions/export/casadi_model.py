"""The nonlinear model as CasADi functions and expressions: for optimal control with CasADi itself, do-mpc or acados."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from greybox.base import GreyboxError, ModelError, nearest, to_identifiers, write_file
from greybox.estimation.linear.exported_model import ExportedModel, to_plant
from greybox.estimation.result import Fit
from greybox.extensions.export import discrete_step
from greybox.extensions.export.target import ExportTarget
from greybox.model import Model


@dataclass(frozen=True, eq=False)
class _SymbolicModel:
    """Symbols of states, inputs and free parameters with their names; ``motion``: rates, or the states a sampling time later."""

    name: str
    x: ca.SX
    u: ca.SX
    p: ca.SX
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    motion: ca.SX
    y: ca.SX


def to_casadi(
    plant: Fit | Model, dt: float | None = None, *, free: Sequence[str] = (), substeps: int = 0
) -> ca.Function:
    """Convert a fit or model to a ``casadi.Function`` with the names ``x``, ``u``, ``p`` and ``dx`` (or ``x_next``), ``y``.

    Parameters
    ----------
    plant
        A fit, or a model at its present values.
    dt
        None: the continuous equations. Seconds: one sampling interval with held inputs, stepped as the library steps it, with dry
        friction that sticks, play and delays in it (earlier values of a delayed input are further states).
    free
        Parameters that stay arguments, in this order; the others are numbers in the function.
    substeps
        Integration steps in a sampling interval; 0 chooses.

    Returns
    -------
    casadi.Function
        ``(x (nx,), u (nu,), p (number of free parameters,)) -> (dx or x_next (nx,), y (ny,))``, in the model's order and units.

    Raises
    ------
    ModelError
        For continuous equations of a model with an effect that is more than a differential equation, and for unknown parameters.

    Examples
    --------
    >>> f = gb.export.to_casadi(fit, free=["M"])  # doctest: +SKIP
    >>> f(x=[0, 0, 0], u=[1.0], p=[0.01])["dx"]  # doctest: +SKIP
    """
    e = _write_equations(to_plant(plant), dt, free, substeps)
    names = ["x", "u", "p"], ["dx" if dt is None else "x_next", "y"]
    return ca.Function(e.name, [e.x, e.u, e.p], [ca.densify(e.motion), ca.densify(e.y)], *names)


def to_do_mpc(plant: Fit | Model, dt: float | None = None, *, free: Sequence[str] = (), substeps: int = 0) -> Any:
    """Convert a fit or model to a ``do_mpc.model.Model`` with signal names, set up and ready for its controllers and estimators.

    Parameters
    ----------
    plant
        A fit, or a model at its present values.
    dt
        None: a continuous model. Seconds: a discrete one, with dry friction that sticks, play and delays in it.
    free
        Parameters that stay parameters (``_p``); the others are numbers.
    substeps
        Integration steps in a sampling interval; 0 chooses.

    Returns
    -------
    do_mpc.model.Model
        Its expressions ``y_<output>`` are the outputs, which are its measurements as well.

    Raises
    ------
    GreyboxError
        Where do-mpc is not installed.
    ModelError
        As for `to_casadi`.

    Examples
    --------
    >>> controller = do_mpc.controller.MPC(gb.export.to_do_mpc(fit))  # doctest: +SKIP
    """
    e = _write_equations(to_plant(plant), dt, free, substeps)
    model_type = _import_optional("do_mpc.model", "do-mpc", "do-mpc").Model
    model = model_type("continuous" if dt is None else "discrete", "SX")
    groups = (("_x", e.states), ("_u", e.inputs), ("_p", e.parameters))
    # do-mpc makes its own symbols, which take the place of ours.
    symbols = [ca.vertcat(*[model.set_variable(kind, name) for name in names], ca.SX(0, 1)) for kind, names in groups]
    motion, y = ca.substitute([e.motion, e.y], [e.x, e.u, e.p], symbols)
    for k, name in enumerate(e.states):
        model.set_rhs(name, motion[k])
    for k, name in enumerate(e.outputs):
        # As a measurement for an estimator, and as an expression for a cost: do-mpc keeps them apart.
        model.set_meas(f"y_{name}", y[k], meas_noise=True)
        model.set_expression(f"y_{name}", y[k])
    model.setup()
    return model


def to_acados(plant: Fit | Model, dt: float | None = None, *, free: Sequence[str] = (), substeps: int = 0) -> Any:
    """Convert a fit or model to an ``acados_template.AcadosModel``.

    Parameters
    ----------
    plant
        A fit, or a model at its present values.
    dt
        None: explicit and implicit continuous equations. Seconds: ``disc_dyn_expr``, with dry friction that sticks, play and delays.
    free
        Parameters that stay parameters; the others are numbers.
    substeps
        Integration steps in a sampling interval; 0 chooses.

    Returns
    -------
    acados_template.AcadosModel
        With labels; ``cost_y_expr`` are the outputs, which a tracking cost may follow.

    Raises
    ------
    GreyboxError
        Where acados is not installed.
    ModelError
        As for `to_casadi`.

    Examples
    --------
    >>> ocp.model = gb.export.to_acados(fit)  # doctest: +SKIP
    """
    e = _write_equations(to_plant(plant), dt, free, substeps)
    model = _import_optional("acados_template", "acados_template", "").AcadosModel()
    model.name, model.x, model.u, model.p = e.name, e.x, e.u, e.p
    model.x_labels, model.u_labels, model.p_labels = list(e.states), list(e.inputs), list(e.parameters)
    model.cost_y_expr = e.y
    if dt is None:
        model.xdot = ca.SX.sym("xdot", e.x.numel())
        # f_impl(x, xdot, u) = xdot - f(x, u): acados' implicit integrators want the residual.
        model.f_expl_expr, model.f_impl_expr = e.motion, model.xdot - e.motion
    else:
        model.disc_dyn_expr = e.motion
    return model


def _import_optional(module: str, package: str, extra: str) -> Any:
    import importlib
    import warnings

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # do-mpc lists what else could be installed
            return importlib.import_module(module)
    except ModuleNotFoundError as error:
        how = f"pip install 'greybox-sysid[{extra}]'" if extra else "its own instructions (docs.acados.org)"
        raise GreyboxError(f"the package {package} is missing; install it with: {how}") from error


def _write_equations(plant: ExportedModel, dt: float | None, free: Sequence[str], substeps: int) -> _SymbolicModel:
    model, s = plant.model, plant.model.system
    names = list(s.parameter_names)
    for name in free:
        if name not in names:
            raise ModelError(f"{model.title} has no parameter {name!r}; {nearest(name, names)}")
    p = ca.SX.sym("p", len(free))
    # Free constants stay symbols, the others are numbers from here on.
    values = ca.vertcat(
        *[p[free.index(n)] if n in free else v for n, v in zip(names, plant.p, strict=True)], ca.SX(0, 1)
    )
    x, u = ca.SX.sym("x", s.x.numel()), ca.SX.sym("u", s.u.numel())
    state_names = list(s.state_names)
    if dt is None:
        discrete_step.refuse_discontinuous(model)
        motion, y = s.rhs_function(x, u, values), s.output_function(x, u, values)
    else:
        # How many earlier inputs are states would hang on a symbol.
        late = [name for name in free if name in discrete_step.find_delay_parameters(model)]
        if late:
            raise ModelError(f"{', '.join(late)}: a delay decides how many states there are; it cannot be free")
        # The exact hold has its constants in numbers; a free one must stay in the equations.
        step = discrete_step.make_discrete_step(plant, dt, substeps=substeps, method="rk4" if free else "automatic")
        x, nx, n = ca.SX.sym("x", s.x.numel() + step.past), s.x.numel(), step.step.substeps
        state_names += discrete_step.name_past_inputs(step)
        past = x[nx:]
        # The entries of the discrete matrices as numbers, or the constants themselves.
        q = ca.SX(ca.DM(step.coefficients())) if step.step.per_interval else values

        def row(share: float) -> ca.SX:
            return ca.vertcat(u, past, share, 0.0, step.dt) if step.past else u

        after = x[:nx]
        for k in range(n):
            after = step.step.advance(after, row(k / n), row((k + 1) / n), q, step.dt / n)
        if step.past:
            # The earlier inputs move back by one interval, and the present one joins them.
            after = ca.vertcat(after, u[step.late_input], past[: step.past - 1])
        motion, y = ca.cse(after), step.step.outputs(x[:nx], row(0.0), values)
    return _SymbolicModel(
        _to_function_name(model.name),
        x,
        u,
        p,
        tuple(to_identifiers(state_names)),
        tuple(to_identifiers(s.input_names)),
        tuple(to_identifiers(s.output_names)),
        tuple(to_identifiers(free)),
        motion,
        y,
    )


def _to_function_name(name: str) -> str:
    """As CasADi allows them: ASCII, a letter first, no two underscores side by side, and three words of its own."""
    plain = re.sub(r"[\W_]+", "_", name, flags=re.ASCII).strip("_")
    return plain if plain[:1].isalpha() and plain not in ("null", "jac", "hess") else f"model_{plain}"


TARGET = ExportTarget(
    "a CasADi function",
    ".casadi",
    lambda plant, path, **options: write_file(path, to_casadi(plant, **options).serialize()),
    options=frozenset(["dt", "substeps"]),
)
