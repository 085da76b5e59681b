"""The terms that a balance may lack, as formulas in the model's names, simplest first.

A term is an amplitude times a product of factors: powers of variables, at most one function of a variable with a constant of its own
(a saturation, a threshold, a ratio), trigonometric functions of what is an angle or has no unit. The amplitude has the unit that makes the
term one of its balance; constants of shape have the unit of their variable. Each product is written in one way only, so no two terms of the
list are equal up to algebra.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import casadi as ca
import numpy as np

from greybox.base.units import ONE, parse_unit
from greybox.base.values import ReadOnly
from greybox.model import Effect, Model
from greybox.model.effect import formula_effect
from greybox.model.expressions.text import evaluate_formula, list_formula_names, number_text
from greybox.model.signals import Parameter

LAW = "law"
"""Name of the effect that a law is; a second one is ``law_2``."""
CONSTANT = "1"


@dataclass(frozen=True)
class Factor:
    """A function of one variable, or of the difference of two, in a product.

    Parameters
    ----------
    text
        The formula; ``{c}`` stands for the constant of shape.
    variables
        The names in it.
    complexity
        How much it adds to a term's complexity.
    power
        By which power of the variable's unit its own unit is known.
    shape_power
        The same of the constant of shape; None for a factor without one.
    is_threshold
        Whether that constant is a place in the range of the variable, not a scale.
    signed
        Whether the constant may be negative.
    """

    text: str
    variables: tuple[str, ...]
    complexity: int
    power: float
    shape_power: float | None = None
    is_threshold: bool = False
    signed: bool = False


@dataclass(frozen=True)
class ConstantNames:
    """What the constants of a law are called: its amplitude, its constant of shape, its time constant."""

    amplitude: str = "k"
    shape: str = "c"
    lag: str = "T"

    @classmethod
    def beside(cls, variables: Iterable[str]) -> ConstantNames:
        """Names that no variable has."""
        taken = set(variables)
        return cls(*(n if n not in taken else f"{n}_law" for n in ("k", "c", "T")))


# Where constants of shape are tried, in multiples of the variable's rms: a term changes little between neighbours.
SHAPE_PLACES: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0)
# Where thresholds are tried, as quantiles of the variable.
THRESHOLD_PLACES: tuple[float, ...] = (0.15, 0.35, 0.5, 0.65, 0.85)


@dataclass(frozen=True)
class LawTerm:
    """A product of factors at a balance, times an amplitude, with memory where ``has_memory``.

    ``units`` are those of the variables by name, ``site_unit`` that of the balance, ``constants`` what its constants are called.
    """

    site: str
    factors: tuple[Factor, ...]
    units: tuple[tuple[str, str], ...]
    site_unit: str
    constants: ConstantNames
    has_memory: bool = False

    @cached_property
    def complexity(self) -> int:
        """Variables, functions and constants that it takes to write it down; 1 is a constant."""
        return 1 + sum(f.complexity for f in self.factors) + 2 * self.has_memory

    @cached_property
    def shape(self) -> Factor | None:
        """The factor that has a constant of its own."""
        return next((f for f in self.factors if f.shape_power is not None), None)

    @cached_property
    def variables(self) -> tuple[str, ...]:
        """Names of the variables in it."""
        return tuple(dict.fromkeys(v for f in self.factors for v in f.variables))

    @cached_property
    def product(self) -> str:
        """The formula without its amplitude."""
        return "*".join(f.text.format(c=self.constants.shape) for f in self.factors) or CONSTANT

    @property
    def formula(self) -> str:
        """The formula: ``k*x**2*tanh(v/c)``."""
        name = self.constants.amplitude
        return name if not self.factors else f"{name}*{self.product}"

    @cached_property
    def product_unit(self) -> str:
        """Unit of the product as text."""
        return _unit_text([(dict(self.units)[f.variables[0]], f.power) for f in self.factors if f.power])

    @property
    def amplitude_unit(self) -> str:
        """Unit of the amplitude: that of the balance over that of the product."""
        if not parse_unit(self.product_unit).dimensions and parse_unit(self.product_unit) == ONE:
            return self.site_unit
        return f"{_bracketed(self.site_unit)}/{_bracketed(self.product_unit)}"

    @property
    def shape_unit(self) -> str:
        """Unit of the constant of shape."""
        if self.shape is None:
            return "1"
        return _unit_text([(dict(self.units)[self.shape.variables[0]], self.shape.shape_power or 0.0)])

    def evaluate(self, values: Mapping[str, np.ndarray], shape: float) -> np.ndarray:
        """The product (K,) along variables (K,) by name."""
        names = list(values)
        symbols = {name: ca.SX.sym(name) for name in (*names, self.constants.shape)}
        expression = evaluate_formula("law", self.product, _Symbols(symbols))
        function = ca.Function("term", [ca.vertcat(*symbols.values())], [expression])
        rows = np.vstack([*(values[n] for n in names), np.full(len(values[names[0]]), shape)])
        return np.asarray(function(rows).full()).ravel()

    def shape_starts(self, values: Mapping[str, np.ndarray]) -> tuple[float, ...]:
        """Where its constant of shape is tried; one number without meaning where it has none."""
        if self.shape is None:
            return (1.0,)
        v = values[self.shape.variables[0]]
        if self.shape.is_threshold:
            return tuple(float(np.quantile(v, q)) for q in THRESHOLD_PLACES)
        size = float(np.sqrt(np.mean(v**2))) or 1.0
        scales = tuple((p * size) ** (self.shape.shape_power or 0.0) for p in SHAPE_PLACES)
        return (*scales, *(-s for s in scales)) if self.shape.signed else scales

    def shape_bounds(self, values: Mapping[str, np.ndarray]) -> tuple[float, float]:
        """Within what its constant of shape makes a difference on the records."""
        if self.shape is None:
            return (-np.inf, np.inf)
        v = values[self.shape.variables[0]]
        if self.shape.is_threshold:
            return (float(v.min()), float(v.max()))
        size = float(np.sqrt(np.mean(v**2))) or 1.0
        power = self.shape.shape_power or 0.0
        low, high = sorted(((1e-3 * size) ** power, (1e3 * size) ** power))
        return (-high, high) if self.shape.signed else (low, high)

    def to_effect(
        self, name: str, amplitude: float, shape: float, lag: float, bounds: tuple[float, float], duration: float
    ) -> Effect:
        """The term as an effect with these start values; ``duration`` of the record in seconds bounds its memory."""
        parameters = [
            Parameter(self.constants.amplitude, self.amplitude_unit, amplitude, description="amplitude of the law")
        ]
        if self.shape is not None:
            start = float(np.clip(shape, *bounds))
            parameters.append(
                Parameter(self.constants.shape, self.shape_unit, start, bounds, description="its constant of shape")
            )
        if self.has_memory:
            limits = (1e-4 * duration, 10 * duration)
            parameters.append(
                Parameter(
                    self.constants.lag, "s", float(np.clip(lag, *limits)), limits, description="its time constant"
                )
            )
        lag_unit = self.product_unit if self.has_memory else None
        return formula_effect(
            name,
            self.site,
            self.formula,
            parameters,
            amplitude=self.constants.amplitude,
            lag=self.constants.lag,
            lag_unit=lag_unit,
            source="law of the records",
        )


class _Symbols(dict):
    """Symbols by name, as a formula asks for them."""

    @property
    def names(self) -> list[str]:
        """Every name."""
        return list(self)


# Largest complexity of a term that is tried with memory.
MEMORY_COMPLEXITY = 2


def list_terms(model: Model, sites: Sequence[tuple[str, str]], values: Mapping[str, np.ndarray]) -> list[LawTerm]:
    """The terms that may act at balances, simplest first.

    Parameters
    ----------
    model
        The plain model: its states and inputs are the variables.
    sites
        Name and unit of each balance.
    values
        Variable -> what it was along the records (K,): signs and ranges decide which functions have a meaning.
    """
    units = {s.name: s.unit for s in model.all_states} | {i.name: i.unit for i in model.inputs}
    names = [n for n in units if n in values and float(np.ptp(values[n])) > 0]
    products = list(_list_products(names, units, values))
    texts, constants = tuple(units.items()), ConstantNames.beside(units)
    terms = [LawTerm(site, factors, texts, unit, constants) for site, unit in sites for factors in products]
    memory = [replace(t, has_memory=True) for t in terms if 1 < t.complexity <= 1 + MEMORY_COMPLEXITY]
    return sorted((*terms, *memory), key=lambda t: t.complexity)


# Degree of the largest product of several variables.
MOST_DEGREE = 3
# Highest power of one variable alone.
MOST_POWER = 5


def _list_products(
    names: Sequence[str], units: Mapping[str, str], values: Mapping[str, np.ndarray]
) -> Iterator[tuple[Factor, ...]]:
    monomials = list(_list_monomials(names))
    yield ()
    yield from monomials
    yield from ((_power(n, p),) for n in names for p in range(MOST_DEGREE + 1, MOST_POWER + 1))
    short = [(), *(m for m in monomials if _degree(m) == 1)]
    plain = {n: _list_plain_functions(n, units[n], values[n]) for n in names}
    shaped = {n: _list_shaped_functions(n, values[n]) for n in names}
    for n in names:
        for function in (*plain[n], *shaped[n]):
            for m in (
                short if function.shape_power is not None else (*short, *(m for m in monomials if _degree(m) == 2))
            ):
                if not _is_repeated(function, m):
                    yield (*m, function)
    angles = [f for n in names for f in plain[n] if f.text.startswith(("sin", "cos"))]
    for one, other in itertools.combinations(angles, 2):
        yield (one, other)
    for one in angles:
        if one.text.startswith("sin"):
            yield (one, replace(one, text=one.text))  # its square
    alike = [(a, b) for a, b in itertools.combinations(names, 2) if parse_unit(units[a]) == parse_unit(units[b])]
    for a, b in alike:
        difference = Factor(f"({a} - {b})", (a, b), 2, 1)
        yield (difference,)
        yield from ((_power(n, 1), difference) for n in names if n not in (a, b))
        yield (Factor(f"({a} - {b})**3", (a, b), 4, 3),)
        yield (Factor(f"abs({a} - {b})*({a} - {b})", (a, b), 4, 2),)
        if _is_number(units[a]):
            yield (Factor(f"sin({a} - {b})", (a, b), 3, 0),)


def _list_monomials(names: Sequence[str]) -> Iterator[tuple[Factor, ...]]:
    for degree in range(1, MOST_DEGREE + 1):
        for chosen in itertools.combinations_with_replacement(names, degree):
            powers = {n: chosen.count(n) for n in dict.fromkeys(chosen)}
            yield tuple(_power(n, p) for n, p in powers.items())


def _power(name: str, power: int) -> Factor:
    return Factor(name if power == 1 else f"{name}**{power}", (name,), power, power)


# Least size of a variable over its largest from which one over it is a term: beyond that it is singular within the record.
LEAST_RECIPROCAL = 0.05


def _list_plain_functions(name: str, unit: str, v: np.ndarray) -> list[Factor]:
    """Functions of a variable without a constant."""
    functions = []
    if v.min() < 0 < v.max():
        functions += [
            Factor(f"abs({name})", (name,), 2, 1),
            Factor(f"abs({name})*{name}", (name,), 3, 2),
            Factor(f"sign({name})", (name,), 2, 0),
            Factor(f"sign({name})*sqrt(abs({name}))", (name,), 4, 0.5),
        ]
    elif v.min() >= 0:
        functions.append(Factor(f"sqrt({name})", (name,), 2, 0.5))
    if np.abs(v).min() > LEAST_RECIPROCAL * np.abs(v).max():
        functions += [Factor(f"(1/{name})", (name,), 2, -1), Factor(f"(1/{name}**2)", (name,), 3, -2)]
    if _is_number(unit):
        functions += [Factor(f"sin({name})", (name,), 2, 0), Factor(f"cos({name})", (name,), 2, 0)]
    return functions


def _list_shaped_functions(name: str, v: np.ndarray) -> list[Factor]:
    """Functions of a variable with one constant."""
    n, variables = name, (name,)
    functions = [
        Factor(f"exp({{c}}*{n})", variables, 4, 0, -1, signed=True),
        Factor(f"sin({n}/{{c}})", variables, 4, 0, 1),
        Factor(f"cos({n}/{{c}})", variables, 4, 0, 1),
        Factor(f"max(0, {n} - {{c}})", variables, 4, 1, 1, is_threshold=True),
        Factor(f"max(0, {{c}} - {n})", variables, 4, 1, 1, is_threshold=True),
        Factor(f"({n}**2/({{c}}**2 + {n}**2))", variables, 5, 0, 1),
        Factor(f"({n}/({{c}}**2 + {n}**2))", variables, 5, -1, 1),
        Factor(f"(1/(1 + ({n}/{{c}})**2))", variables, 5, 0, 1),
        Factor(f"({n}**4/({{c}}**4 + {n}**4))", variables, 6, 0, 1),
        Factor(f"(1/(1 + ({n}/{{c}})**4))", variables, 6, 0, 1),
    ]
    if v.min() >= 0:
        return [
            Factor(f"({n}/({{c}} + {n}))", variables, 4, 0, 1),
            Factor(f"(1/({{c}} + {n}))", variables, 4, -1, 1),
            Factor(f"log(1 + {n}/{{c}})", variables, 5, 0, 1),
            *functions,
        ]
    return [
        Factor(f"tanh({n}/{{c}})", variables, 4, 0, 1),
        Factor(f"({n}/({{c}} + abs({n})))", variables, 5, 0, 1),
        *functions,
    ]


def _is_repeated(function: Factor, monomial: Sequence[Factor]) -> bool:
    """Whether the product is written in another way already: ``x*(1/x)``, ``x*abs(x)``, ``x*1/(c + x)``."""
    same = next((m for m in monomial if m.variables == function.variables), None)
    if same is None:
        return False
    text = function.text
    return text.startswith(("(1/", "abs(", "sign(", "max(")) or (
        text.startswith("(") and "**2 + " in text and function.power < 0
    )


def _degree(monomial: Sequence[Factor]) -> int:
    return sum(f.complexity for f in monomial)


def _is_number(unit: str) -> bool:
    """Whether a quantity of the unit is the argument of a sine: a number or an angle."""
    return unit.strip() in ("", "-", "1") or parse_unit(unit) == parse_unit("rad")


def _bracketed(unit: str) -> str:
    return unit if unit.replace("^", "").isalnum() else f"({unit})"


def _unit_text(powers: Sequence[tuple[str, float]]) -> str:
    """``m^2*(m/s)`` of ``[("m", 2), ("m/s", 1)]``; powers of one unit are collected."""
    total: dict[str, float] = {}
    for unit, power in powers:
        if unit.strip() not in ("", "-", "1"):
            total[unit] = total.get(unit, 0.0) + power
    parts = [_bracketed(u) if p == 1 else f"{_bracketed(u)}^{p:g}" for u, p in total.items() if p]
    return "*".join(parts) or "1"


# A law in a model: an effect whose formula is its name in all that is claimed of it.


def is_law(name: str) -> bool:
    """Whether an effect of this name is a term of an equation that a search has composed."""
    return name.partition("_")[0] == LAW


def claimed_name(effect: Effect) -> str:
    """What an effect is called where something is claimed of it: a law by its formula, any other by its name."""
    if not is_law(effect.name):
        return effect.name
    called = _call_law(effect.equation, bool(effect.states))
    # A second branch of a law is called after it.
    return re.sub(rf"^{LAW}(_\d+)?", lambda _: called, effect.name)


def _call_law(formula: str, has_memory: bool) -> str:
    return f"lag({formula})" if has_memory else formula


def write_effect(model: Model, effect: Effect) -> str:
    """A law with its constants as numbers (``-0.6*a*b``); of any other effect its name."""
    if not is_law(effect.name):
        return effect.name
    text, values = effect.equation, own_values(model, effect)
    for inner, value in values.items():
        number = number_text(value)
        text = re.sub(rf"\b{re.escape(inner)}\b", f"({number})" if value < 0 else number, text)
    if text.startswith("(-"):  # the amplitude, which comes first
        text = text[1:].replace(")", "", 1)
    return f"lag({text}, {number_text(list(values.values())[-1])})" if effect.states else text


def own_values(model: Model, effect: Effect) -> dict[str, float]:
    """The constants of an effect of ``model`` by its own names."""
    return {q.name: model.values[model.names_of(effect.name)[q.name]] for q in effect.parameters}


# What a law behaves as, where the field has a word for it.


class LikenessKind(StrEnum):
    """Words for shapes that are met in every field."""

    BIAS = "bias"
    """A constant."""
    LINEAR = "linear"
    """Proportional to a variable."""
    HARDENING = "hardening"
    """An odd power of the balance's own variable against or with it."""
    QUADRATIC_DRAG = "quadratic_drag"
    """``|v| v``."""
    DRY_FRICTION = "dry_friction"
    """``sign(v)``, or a ``tanh`` that is steep."""
    STOP = "stop"
    """Nothing up to a place, then proportional to how far beyond."""
    SATURATION = "saturation"
    """``x/(c + x)`` and its relatives: proportional at first, constant in the end."""
    SWITCH = "switch"
    """A Hill function: little below a place, constant above."""
    MASS_ACTION = "mass_action"
    """A product of two variables."""
    CROWDING = "crowding"
    """The square of a variable in its own balance."""
    PERIODIC = "periodic"
    """A sine or a cosine."""
    MEMORY = "memory"
    """Any of these through a lag."""


@dataclass(frozen=True)
class Likeness:
    """What a law behaves as: ``place`` and ``size`` are its constant of shape and its amplitude, with their units."""

    kind: LikenessKind
    size: float
    size_unit: str
    place: float | None = None
    place_unit: str = ""
    variable: str = ""


# What formulas behave as, the first that fits; ``k`` and ``c`` stand for the constants, ``s`` for the balance's own state.
KINDS: tuple[tuple[str, LikenessKind], ...] = (
    (r"k", LikenessKind.BIAS),
    (r"k\*\w+\*\w+", LikenessKind.MASS_ACTION),
    (r"k\*max\(.*\)", LikenessKind.STOP),
    (r"k\*(tanh\(\w+/c\)|sign\(\w+\))", LikenessKind.DRY_FRICTION),
    (r".*\((\w+)/\(c \+ (abs\(\1\)|\1)\)\)", LikenessKind.SATURATION),
    (r".*\*\*([24])/\(c\*\*\1.*", LikenessKind.SWITCH),
    (r"k\*\w+", LikenessKind.LINEAR),
    (r"k\*s\*\*2", LikenessKind.CROWDING),
    (r"k\*\w+\*\*[35]", LikenessKind.HARDENING),
    (r"k\*abs\((\w+)\)\*\1", LikenessKind.QUADRATIC_DRAG),
    (r"k\*(sin|cos)\(\w+(/c)?\)", LikenessKind.PERIODIC),
)


@dataclass(frozen=True, eq=False)
class Law(ReadOnly):
    """One term of the answer as an equation.

    Parameters
    ----------
    name, site
        The effect in the model that it is, and the balance that it acts on.
    equation
        The term with its constants as numbers, in the names of the model, as SymPy reads it.
    formula
        The same with its constants by name.
    unit
        Unit of the balance.
    seen
        Variable -> least and largest value in the records: beyond that range the law is a guess.
    units
        Their units.
    likeness
        What it behaves as, where that has a name.
    memory
        Unit of what passes through its lag; empty for a law without memory.
    """

    name: str
    site: str
    equation: str
    formula: str
    unit: str
    seen: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]
    likeness: Likeness | None = None
    memory: str = ""

    @property
    def claimed(self) -> str:
        """What it is called where something is claimed of it."""
        return _call_law(self.formula, bool(self.memory))


def describe_laws(model: Model, ranges: Mapping[str, tuple[float, float]]) -> tuple[Law, ...]:
    """The laws that a model holds; ``ranges``: variable -> least and largest value of each state and input in the records."""
    units = {s.name: s.unit for s in model.all_states} | {i.name: i.unit for i in model.inputs}
    laws = []
    for effect in (e for e in model.effects if is_law(e.name)):
        used = list_formula_names(effect.name, effect.equation)
        seen = {name: ranges[name] for name in used if name in ranges}
        balance = next(b for b in model.system.balances if b.name == effect.site)
        laws.append(
            Law(
                effect.name,
                effect.site,
                write_effect(model, effect),
                effect.equation,
                balance.unit,
                seen,
                {name: units[name] for name in seen},
                _find_likeness(model, effect, balance.state, list(seen)),
                effect.states[0].unit if effect.states else "",
            )
        )
    return tuple(laws)


def _find_likeness(model: Model, effect: Effect, state: str, variables: Sequence[str]) -> Likeness | None:
    """The word for a law; None where there is none."""
    values = own_values(model, effect)
    names = ConstantNames.beside([*(s.name for s in model.all_states), *(i.name for i in model.inputs)])
    # In the letters of `KINDS`: a variable of such a name has its own letter.
    letters = {names.amplitude: "k", names.shape: "c"} | {v: f"v_{k}" for k, v in enumerate(variables)} | {state: "s"}
    text = re.sub(r"[A-Za-z_][\w.]*", lambda name: letters.get(name[0], name[0]), effect.equation)
    kind = next((kind for pattern, kind in KINDS if re.fullmatch(pattern, text)), None)
    kind = LikenessKind.MEMORY if effect.states else kind
    if kind is None:
        return None
    units = {q.name: q.unit for q in effect.parameters}
    place = values.get(names.shape)
    # A function with a constant stands last in its product.
    return Likeness(
        kind, values[names.amplitude], units[names.amplitude], place, units.get(names.shape, ""), ("", *variables)[-1]
    )
