"""An effect: a value that changes a model. ``model + effect`` is a new model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from greybox.model.balance import Balance
from greybox.signals import Expression, Named, Parameter, State

Equation = Callable[[Named, Named, Named], Expression]
Terms = Callable[[Named, Named, Named], "Expression | Mapping[str, Expression]"]
Transform = Callable[[Expression, Named, Named, Named], Expression]


@dataclass(frozen=True)
class DryFriction:
    """Friction that sticks: magnitudes (not negative) while sliding and the most it holds at standstill.

    The integrator treats it exactly (no smoothing): see `greybox.integrators.dry`.
    """

    sliding: Expression
    static: Expression


@dataclass(frozen=True)
class Effect:
    """A physical effect that a model may lack. With its amplitude parameters at zero it changes nothing.

    Every function is called as ``f(x, u, p)`` with names and roles of the model, its own parameters and states included:

    ``terms``       adds to balances: one expression for the balance ``site``, or ``{balance: expression}``
    ``dry``         dry friction on the balance ``site``, as `DryFriction`
    ``balances``    balances of the effect's own ``states``
    ``on_input``    ``f(value, x, u, p)``: the input on its way in
    ``on_output``   ``f(value, x, u, p)``: the output on its way out
    ``on_parameter``  ``{parameter: expression}`` used in its place

    ``site`` is the name of a balance, or ``input`` (the drive) or ``sensor`` (the main output). Units may refer to the
    model: ``"{force}/{displacement}**3"`` is N/m^3 on a rig in newton and metre.

    ``parents`` are effects that this one contains as a special case; ``parity`` is its symmetry in the variable it
    depends on (even, odd, linear, slow); ``tells_apart`` says which experiment separates it from its look-alikes.
    """

    name: str
    site: str
    parameters: Sequence[Parameter]
    terms: Terms | None = None
    dry: Callable[[Named, Named, Named], DryFriction] | None = None
    states: Sequence[State] = ()
    balances: Callable[[Named, Named, Named], list[Balance]] | None = None
    on_input: Transform | None = None
    on_output: Transform | None = None
    on_parameter: Callable[[Named, Named, Named], Mapping[str, Expression]] | None = None
    equation: str = ""
    parents: Sequence[str] = ()
    parity: str = ""
    tells_apart: str = ""
    source: str = ""
