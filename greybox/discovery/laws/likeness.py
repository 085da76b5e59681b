"""What a law behaves as, where the field has a word for it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from greybox.discovery.laws.equation import law_values
from greybox.discovery.laws.terms import LawTerm
from greybox.model import Model


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


def find_likeness(model: Model, name: str, term: LawTerm) -> Likeness | None:
    """The word for a law; None where there is none."""
    kind = _kind_of(model, term)
    if kind is None:
        return None
    values = law_values(model, name)
    place = values.get(term.constants.shape) if term.shape is not None else None
    variable = term.shape.variables[0] if term.shape is not None else (term.variables or ("",))[0]
    unit = term.shape_unit if place is not None else ""
    return Likeness(kind, values[term.constants.amplitude], term.amplitude_unit, place, unit, variable)


def _kind_of(model: Model, term: LawTerm) -> LikenessKind | None:
    if term.has_memory:
        return LikenessKind.MEMORY
    texts = [f.text for f in term.factors]
    state = next((b.state for b in model.system.balances if b.name == term.site), "")
    if not texts:
        return LikenessKind.BIAS
    if len(texts) == 2 and all(f.text == f.variables[0] for f in term.factors):
        return LikenessKind.MASS_ACTION
    shape = term.shape.text if term.shape is not None else ""
    if len(texts) == 1 and shape.startswith("max"):
        return LikenessKind.STOP
    if shape.startswith("tanh") and len(texts) == 1:
        return LikenessKind.DRY_FRICTION
    if "/({c} + " in shape and term.shape is not None and term.shape.power == 0:
        return LikenessKind.SATURATION
    if "**2/({c}**2" in shape or "**4/({c}**4" in shape:
        return LikenessKind.SWITCH
    if len(texts) > 1:
        return None
    text, variable = texts[0], term.factors[0].variables[0]
    if text == variable:
        return LikenessKind.LINEAR
    if text == f"{variable}**2" and variable == state:
        return LikenessKind.CROWDING
    if text in (f"{variable}**3", f"{variable}**5"):
        return LikenessKind.HARDENING
    if text == f"abs({variable})*{variable}":
        return LikenessKind.QUADRATIC_DRAG
    if text == f"sign({variable})":
        return LikenessKind.DRY_FRICTION
    return LikenessKind.PERIODIC if text.startswith(("sin(", "cos(")) else None
