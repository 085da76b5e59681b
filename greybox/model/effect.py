"""An effect: a value that changes a model. ``model + effect`` is a new model."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from greybox.base import ModelError, nearest
from greybox.model.balance import Balance
from greybox.model.expressions.text import evaluate_formula, list_formula_names
from greybox.model.parts import Occurrence
from greybox.model.signals import Expression, NamedValues, Parameter, State

# In the place of a balance's name: all of them.
EVERY_BALANCE = "*"

Equation = Callable[[NamedValues, NamedValues, NamedValues], Expression]
Terms = Callable[[NamedValues, NamedValues, NamedValues], "Expression | Mapping[str, Expression]"]
Transform = Callable[[Expression, NamedValues, NamedValues, NamedValues], Expression]

# Parameters of effects: amplitudes, absent until fitted, and the constants that give an effect its shape.

ABSENT = "amplitude, absent until fitted"
ROUGH = "rough, until the data say better"
# Sources of values that nobody has told.
GUESSES = frozenset((ABSENT, ROUGH))


def amplitude_parameter(
    name: str, unit: str, description: str, low: float = -math.inf, high: float = math.inf
) -> Parameter:
    """A parameter that is zero where the effect is absent, of either sign unless ``low`` says otherwise."""
    return Parameter(name, unit, 0.0, (low, high), source=ABSENT, description=description)


def shape_parameter(
    name: str, unit: str, value: float, bounds: tuple[float, float], description: str, source: str = ROUGH
) -> Parameter:
    """A parameter that gives an effect its shape, or an amplitude whose neutral value is not zero."""
    return Parameter(name, unit, value, bounds, source=source, description=description)


def fixed_parameter(name: str, unit: str, value: float, bounds: tuple[float, float], description: str) -> Parameter:
    """A parameter that is not to be found: a side, or what keeps an equation smooth."""
    return replace(shape_parameter(name, unit, value, bounds, description), fixed=True)


def geometric_grid(low: float, high: float, count: int) -> list[float]:
    """``count`` values from ``low`` to ``high`` with equal ratios."""
    return [float(value) for value in np.geomspace(low, high, count)]


@dataclass(frozen=True)
class DryFriction:
    """Friction that sticks. The integrators treat it exactly, without smoothing (`greybox.simulation.integrators.dry_friction`).

    Parameters
    ----------
    sliding
        Magnitude of the friction while the body slides, in the unit of the balance; not negative.
    static
        The most that it holds at standstill.

    Examples
    --------
    ``dry=lambda x, u, p: DryFriction(sliding=p.Fc, static=p.Fs)`` of an `Effect`.
    """

    sliding: Expression
    static: Expression


@dataclass(frozen=True)
class Effect:
    """A physical effect that a model may lack: ``model + effect`` is a new model. With its amplitude parameters at zero it changes nothing.

    An effect states what it changes in functions, each called as ``f(x, u, p)`` with names and roles of the model, its own parameters and
    states included. It sees what it changes as it comes to it: in ``balances`` and ``update`` the input and the state are those before its
    own ``on_input`` and ``on_state``, and ``x.sensor`` is the output at its site (for any other site the main one) before its own
    ``on_output``. The start of one of its states may be a function of ``p.sensor``, the main output at rest.

    Parameters
    ----------
    name
        What results, files and the command line call it.
    site
        Where it acts: ``force`` (the balance of a velocity), the name of a balance, of an input or an output, the role of an input
        (``drive``, ``valve``), ``input``, ``sensor`` (an output), ``pressure`` or ``store`` (the balance of a pressure, of a pressure or
        a level). Where a model has several it is the first; see `greybox.model.sites`.
    parameters, states
        Its own. Units may refer to the model: ``"{force}/{displacement}**3"`` is N/m^3 on a rig in newton and metre. A state that may be
        fast is declared ``State(..., relaxing=True)``.
    terms
        Adds to balances: one expression for the balance ``site``, or ``{balance: expression}``.
    dry
        Dry friction on the balance ``site``, as `DryFriction`.
    balances
        Balances of the effect's own states, a list.
    update
        ``{state: expression}`` for own states without a balance, set after each substep (play): the expression sees the other states
        and the input at the end of the substep, and its own state as it was before.
    delay
        Seconds by which the input at the site arrives late, from parameters alone. Whatever else acts on the input acts on the delayed
        one; before the first row of a record the input is what the record is told of it (`Experiment.before`), else its
        first value.
    on_input, on_output
        ``f(value, x, u, p)``: the input on its way in, the output on its way out.
    on_parameter, on_state
        ``{name: expression}`` used in the place of parameters or states, by the model and by the other effects.
    on_term
        ``{balance: {term: expression}}`` in the place of terms of that name.
    on_storage
        ``{balance: factor}`` on what the balance stores; ``EVERY_BALANCE`` in the place of its name means all that store something.
    hold
        What the inputs do between samples, in the place of what the experiment says: ``zero``, ``first`` or ``band-limited`` (see
        `greybox.Experiment`).
    late
        Rows by which a record has the input at the site later than it acted; negative where it is written early.
    equation
        The equation in one line, for tables.
    parents
        Names of effects that this one contains as a special case; where they are candidates it is tried after them.
    approaches
        Names of simpler effects of another kind that this one approaches as its constants grow or vanish. It is tried beside them, and
        is no rival of theirs.
    stands_for
        Names of effects that together say exactly the same: where all of them are candidates this one is not, as no record could tell.
    parity
        Its symmetry in the variable it depends on: even, odd, linear, slow.
    needs
        Names of parts (`greybox.model.parts`), one of which a rig must have for it; none where any rig may have it.
    occurs
        How usual it is on a rig that may have it; an effect of one's own is there because somebody expects it.
    occurs_with
        Part -> how usual it is on a rig with that part, the first that is there counts.
    tells_apart
        Which experiment separates it from its look-alikes.
    source
        Where the equation is from.
    amplitudes
        Names of the parameters that at zero, or at their ``neutral`` value, leave the effect absent; none for one that replaces a law.
        Where they are not given they are those of `amplitude_parameter` and the ``neutral`` ones.
    neutral
        Amplitude -> the value at which it is absent, where that is not zero.
    probe
        ``f(scales)``: the amplitudes that vanish at zero, where the effect is visible but small. `greybox.effects.Scales` are those of a
        record.
    grid
        ``f(scales)``: start values of the shape parameters, and of amplitudes with a neutral value, the faintest first.
    limits
        ``f(scales)``: bounds that only the record can give.
    from_parent
        ``f(values, scales)``: start values from those of a fitted parent, by the parent's own names.

    Examples
    --------
    A spring that hardens, on every model that has a ``force`` balance and a displacement:

    >>> hardening = Effect(
    ...     "hardening",
    ...     "force",
    ...     [Parameter("K3", "{force}/{displacement}**3", 0.0)],
    ...     terms=lambda x, u, p: -p.K3 * x.displacement**3,
    ...     equation="-K3 x^3",
    ...     amplitudes=("K3",),
    ... )
    """

    name: str
    site: str
    parameters: Sequence[Parameter]
    terms: Terms | None = None
    dry: Callable[[NamedValues, NamedValues, NamedValues], DryFriction] | None = None
    states: Sequence[State] = ()
    balances: Callable[[NamedValues, NamedValues, NamedValues], list[Balance]] | None = None
    update: Callable[[NamedValues, NamedValues, NamedValues], Mapping[str, Expression]] | None = None
    delay: Equation | None = None
    on_input: Transform | None = None
    on_output: Transform | None = None
    on_parameter: Callable[[NamedValues, NamedValues, NamedValues], Mapping[str, Expression]] | None = None
    on_state: Callable[[NamedValues, NamedValues, NamedValues], Mapping[str, Expression]] | None = None
    on_term: Callable[[NamedValues, NamedValues, NamedValues], Mapping[str, Mapping[str, Expression]]] | None = None
    on_storage: Callable[[NamedValues, NamedValues, NamedValues], Mapping[str, Expression]] | None = None
    hold: str = ""
    late: int = 0
    equation: str = ""
    parents: Sequence[str] = ()
    approaches: Sequence[str] = ()
    stands_for: Sequence[str] = ()
    parity: str = ""
    needs: Sequence[str] = ()
    occurs: Occurrence = Occurrence.COMMON
    occurs_with: Mapping[str, Occurrence] = field(default_factory=dict)
    tells_apart: str = ""
    source: str = ""
    amplitudes: Sequence[str] = ()
    neutral: Mapping[str, float] = field(default_factory=dict)
    probe: Callable[[Any], Mapping[str, float]] | None = None
    grid: Callable[[Any], Mapping[str, Sequence[float]]] | None = None
    limits: Callable[[Any], Mapping[str, tuple[float, float]]] | None = None
    from_parent: Callable[[Mapping[str, float], Any], list[Mapping[str, float]]] | None = None

    def __post_init__(self) -> None:
        if not self.amplitudes:
            names = (q.name for q in self.parameters if q.source == ABSENT or q.name in self.neutral)
            object.__setattr__(self, "amplitudes", tuple(names))

    @property
    def is_of_record(self) -> bool:
        """Whether it says how a record holds an input, and nothing of the plant."""
        return bool(self.hold or self.late)

    def smoothed(self, speed: float) -> Effect:
        """The same with dry friction that creeps and does not stick: ``-sliding tanh(v / vt)``, with no step at standstill.

        For bodies whose standstill cannot be told from one balance: the joints of an arm, which push one another through its inertias.

        Parameters
        ----------
        speed
            ``vt`` in the unit of the velocity at its site: below it the friction is viscous.

        Returns
        -------
        Effect
            A new effect; the same one where it has no dry friction.

        Examples
        --------
        ``arm + gb.effect("coulomb_friction_at_joint_2").smoothed(0.01)``
        """
        dry, beside = self.dry, self.terms
        if dry is None:
            return self

        def terms(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression | Mapping[str, Expression]:
            friction = -dry(x, u, p).sliding * ca.tanh(x.velocity / p.vt)
            added = beside(x, u, p) if beside else 0
            if isinstance(added, Mapping):
                return {**added, self.site: added.get(self.site, 0) + friction}
            return added + friction

        width = fixed_parameter("vt", "{velocity}", speed, (0.0, math.inf), "speed below which the friction is viscous")
        return replace(self, dry=None, terms=terms, parameters=(*self.parameters, width))


# What an effect may bring besides terms: states that are set after each step, delays, and states that relax.


@dataclass(frozen=True)
class StateUpdate:
    """State number ``state`` becomes ``value(x, u, p)`` after each substep, ``x`` and ``u`` at its end."""

    effect: str
    state: int
    value: ca.SX


@dataclass(frozen=True)
class InputDelay:
    """Input number ``column`` arrives ``seconds`` (an expression of the parameters) late, at most ``longest`` seconds."""

    effect: str
    column: int
    seconds: ca.SX
    longest: float


def collect_updates(
    effect: str, updates: Mapping[str, Expression], model_names: Mapping[str, str], states: Sequence[str]
) -> list[StateUpdate]:
    """The states that an effect sets; ``model_names`` leads from its names to the model's.

    Raises ModelError for a state that is not the effect's own.
    """
    others = [name for name in updates if model_names.get(name) not in states]
    if others:
        own_states = [inner for inner, name in model_names.items() if name in states]
        raise ModelError(
            f"effect {effect!r} sets {others[0]!r}, which is not a state of its own; {nearest(others[0], own_states)}"
        )
    return [StateUpdate(effect, list(states).index(model_names[name]), ca.SX(value)) for name, value in updates.items()]


def build_delay(
    effect: str, seconds: Expression, site: str, inputs: Sequence[str], ranges: Mapping[str, tuple[float, ...]]
) -> InputDelay:
    """The delay of an input, with the longest one that the ``ranges`` of the parameters allow: bounds, or the value of a fixed one.

    Raises ModelError for a site that is no input, an expression of states or inputs, and a delay that may be negative or
    has no upper bound.
    """
    if site not in inputs:
        raise ModelError(f"effect {effect!r} delays {site!r}, which is not an input; {nearest(site, inputs)}")
    value = ca.SX(seconds)
    symbols = ca.symvar(value)
    others = [s.name() for s in symbols if s.name() not in ranges]
    if others:
        raise ModelError(
            f"effect {effect!r}: its delay changes with {others[0]!r}; a delay may depend on parameters alone"
        )
    delay = ca.Function("seconds", [ca.vertcat(*symbols)], [value])
    corners = [float(delay(list(corner))) for corner in itertools.product(*(ranges[s.name()] for s in symbols))]
    low, high = min(corners), max(corners)
    if not (low >= 0 and high < ca.inf):
        names = ", ".join(s.name() for s in symbols)
        raise ModelError(
            f"effect {effect!r}: within the bounds of {names} its delay runs from {low:g} to {high:g} s; bound it between 0 and the"
            " longest delay that is possible"
        )
    return InputDelay(effect, list(inputs).index(site), value, high)


def find_relaxing_states(model: str, states: Sequence[State], rhs: ca.SX, x: ca.SX) -> tuple[int, ...]:
    """Numbers of the states declared ``relaxing``. Raises ModelError where a rate is not linear in its own state."""
    numbers = [k for k, s in enumerate(states) if s.relaxing]
    for k in numbers:
        # |z| is allowed: it is linear on either side of zero.
        if not ca.jacobian(ca.jacobian(rhs[k], x[k]), x[k]).is_zero():
            raise ModelError(
                f"model {model!r}: the rate of the relaxing state {states[k].name!r} is not linear in it; write it as alpha - beta z"
                " or leave out relaxing=True"
            )
    return tuple(numbers)


# Name of the state of a formula with memory.
LAGGED = "lagged"


def formula_effect(
    name: str,
    site: str,
    formula: str,
    parameters: Sequence[Parameter],
    *,
    amplitude: str = "k",
    lag: str = "T",
    lag_unit: str | None = None,
    source: str = "",
) -> Effect:
    """An effect that adds a formula to a balance.

    Parameters
    ----------
    name, site
        As of `greybox.model.Effect`.
    formula
        What acts there, in the names of the model's states and inputs and of ``parameters``, with ``+ - * / **``, ``abs``, ``sign``,
        ``exp``, ``tanh``, ``sqrt``, ``sin``, ``cos``, ``max`` and ``min``.
    parameters
        The constants in it, with units.
    amplitude
        The constant that multiplies the formula: with it at zero the effect is absent.
    lag, lag_unit
        Of a formula with memory the constant that is its time constant, and the unit of the formula without its amplitude, which then acts
        through a lag of first order. No unit is no memory.
    source
        Where it is from.

    Returns
    -------
    Effect
        Like one of the catalogue.

    Raises
    ------
    ModelError
        For text that is no formula, and for an amplitude that is not among the parameters.

    Examples
    --------
    >>> drag = formula_effect("drag", "force", "k*abs(v)*v", [Parameter("k", "N*s^2/m^2", -0.3)])
    >>> drag.equation
    'k*abs(v)*v'
    """
    subject, constants = f"effect {name!r}", [q.name for q in parameters]
    if amplitude not in constants:
        raise ModelError(
            f"{subject}: no parameter {amplitude!r} to multiply the formula; {nearest(amplitude, constants)}"
        )
    list_formula_names(subject, formula)  # refuses text that is none
    values = {q.name: q.value for q in parameters}
    shapes = [q for q in parameters if q.name not in (amplitude,) and not q.fixed]
    start = values[amplitude] or 1.0

    def inner(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return evaluate_formula(subject, formula, _Names(x, u, p))

    def through_lag(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return p[amplitude] * x[LAGGED]

    def memory(x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
        # What the amplitude multiplies: a formula with memory begins with it, ``k*v**2``.
        undelayed = evaluate_formula(subject, formula.removeprefix(f"{amplitude}*"), _Names(x, u, p))
        return [Balance(f"{name}_memory", lag_unit or "1", p[lag], LAGGED, arriving=undelayed, leaving=-x[LAGGED])]

    has_memory = lag_unit is not None
    return Effect(
        name,
        site,
        tuple(parameters),
        terms=through_lag if has_memory else inner,
        states=(State(LAGGED, lag_unit, relaxing=True),) if lag_unit is not None else (),
        balances=memory if has_memory else None,
        equation=formula,
        amplitudes=(amplitude,),
        probe=_constant({amplitude: start}),
        grid=_constant({q.name: (q.value,) for q in shapes}) if shapes else None,
        source=source or "stated as a formula",
    )


class _Names:
    """States, inputs and parameters under one roof; an effect's own constants come first."""

    def __init__(self, x: NamedValues, u: NamedValues, p: NamedValues) -> None:
        self._groups = (p, x, u)

    def __contains__(self, name: str) -> bool:
        return any(name in group for group in self._groups)

    def __getitem__(self, name: str) -> Any:
        return next(group for group in self._groups if name in group)[name]

    @property
    def names(self) -> list[str]:
        """Every name that can be asked for."""
        return [name for group in self._groups for name in group.names]


def _constant(values: Mapping[str, Any]) -> Callable[[Any], Mapping[str, Any]]:
    return lambda scales: values
