"""Schedules: a parameter that changes with an operating condition, such as a valve gain with the supply pressure."""

from __future__ import annotations

from collections.abc import Mapping

from greybox.base.errors import ModelError
from greybox.model.effect import Effect
from greybox.model.signals import Expression, NamedValues, Parameter


def schedule_effect(name: str, by: str, about: float, *, order: int = 1) -> Effect:
    """The effect by which a parameter follows an operating condition, as a polynomial about the condition's value ``about``::

        name (1 + c1 (by/about - 1) + c2 (by/about - 1)^2 ...)

    The coefficients ``c1`` (called ``<name>_<by>``), ``c2`` ... are free and have no unit: by which share the parameter changes where the
    condition doubles. Records under one condition alone do not determine them.

    Parameters
    ----------
    name
        The parameter. It keeps its meaning: it is the value at ``about``.
    by
        A parameter that the experiments give themselves (`Experiment.conditions`), or an input that was measured.
    about
        A usual value of ``by``, in its unit.
    order
        Of the polynomial.

    Returns
    -------
    Effect
        To be added to a model.

    Raises
    ------
    ModelError
        For ``about`` zero, and an order below one.
    """
    if about == 0:
        raise ModelError(f"schedule of {name} by {by}: about 0 is not a valid reference; give a typical value of {by}")
    if order < 1:
        raise ModelError(f"schedule of {name} by {by}: order {order}; give 1 for a straight line, 2 for a parabola")
    powers = range(1, order + 1)
    coefficients = {k: f"{name}_{by}" + (f"_{k}" if k > 1 else "") for k in powers}
    reference = f"{by}_ref"

    def used(x: NamedValues, u: NamedValues, p: NamedValues) -> Mapping[str, Expression]:
        away = (p[by] if by in p else u[by]) / p[reference] - 1
        return {name: p[name] * (1 + sum(p[coefficients[k]] * away**k for k in powers))}

    return Effect(
        f"{name}_by_{by}",
        "",
        [
            *(
                Parameter(coefficients[k], "1", 0.0, description=f"change of {name} with {by}, power {k}")
                for k in powers
            ),
            Parameter(reference, f"{{{by}}}", about, fixed=True, description=f"the {by} at which {name} holds"),
        ],
        on_parameter=used,
        equation=f"{name} (1 + {coefficients[1]} ({by}/{reference} - 1){' + ...' if order > 1 else ''})",
        amplitudes=tuple(coefficients.values()),
    )
