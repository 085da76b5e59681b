"""Effects that act as one term of a balance, hidden in rigs and everyday plants, and what that term is.

The records come from the twins of `fits.studies.hidden_cases` and `fits.studies.plant_cases`, which know nothing
of greybox. The catalogue is switched
off, so that every effect is a stranger; most of them it does not hold in this form anyway.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from fits.studies.hidden_cases import Case
from fits.studies.hidden_cases import make as make_rig
from fits.studies.plant_cases import make as make_plant
from greybox.model.expressions.text import evaluate_formula

Values = Mapping[str, np.ndarray]
Constants = Mapping[str, float]
RIGS = ("micro_actuator", "pneumatic_cylinder")
ROWS, POINTS = 1200, 400
ALIKE = 0.9
"""Cosine between a law and the true term, what the plain model's own terms can do taken off both, from which they are of one family."""
STEADY = {"Ta": 20.0}
"""What hardly moves in these records: a law that leaves it out is none the worse."""


@dataclass(frozen=True)
class HiddenTerm:
    """What an effect adds to a balance.

    ``value`` of the variables, the effect's constants and the plant's; ``plain`` are the plain model's own terms in these variables.
    ``lagged``: the term acts through a lag.
    """

    plant: str
    effect: str
    site: str
    variables: tuple[str, ...]
    value: Callable[[Values, Constants, Constants], np.ndarray]
    plain: tuple[Callable[[Values], np.ndarray], ...]
    lagged: bool = False

    @property
    def name(self) -> str:
        """Of the case."""
        return f"{self.plant} {self.effect}"


def _odd_power(variable: str, constant: str, power: float) -> Callable[[Values, Constants, Constants], np.ndarray]:
    return lambda z, e, _: -e[constant] * np.sign(z[variable]) * np.abs(z[variable]) ** power


def _linear(variable: str) -> Callable[[Values], np.ndarray]:
    return lambda z: z[variable]


def _term(
    plant: str,
    effect: str,
    site: str,
    variable: str,
    value: Callable[[Values, Constants, Constants], np.ndarray],
    lagged: bool = False,
    plain: Callable[[Values], np.ndarray] | None = None,
) -> HiddenTerm:
    beside = () if lagged else (plain or _linear(variable),)
    return HiddenTerm(plant, effect, site, (variable,), value, beside, lagged)


def _magnet(variable: str) -> Callable[[Values, Constants, Constants], np.ndarray]:
    return lambda z, e, _: -e["F"] * np.exp(-(((z[variable] - e["x0"]) / e["w"]) ** 2))


def _warmth(variable: str) -> Callable[[Values, Constants, Constants], np.ndarray]:
    return lambda z, e, _: e["F"] * e["per_speed"] * np.abs(z[variable])


def _outflow(z: Values) -> np.ndarray:
    return np.sqrt(np.maximum(z["h1"], 0.0))


def _loss(z: Values) -> np.ndarray:
    return z["T"] - STEADY["Ta"]


def _stop(z: Values, e: Constants, _: Constants) -> np.ndarray:
    return -e["kc"] * (z["x"] - np.clip(z["x"], -e["gap"], e["gap"]))


TERMS = (
    _term("stage", "quintic_stiffness", "force", "x", _odd_power("x", "K5", 5)),
    _term("micro_actuator", "power_damping", "force", "v", _odd_power("v", "c", 0.6)),
    _term("rotary_drive", "power_damping", "torque", "w", _odd_power("w", "c", 0.6)),
    _term("tanks", "linear_leak", "upper_tank", "h1", lambda z, e, _: -e["k"] * z["h1"], plain=_outflow),
    _term("pneumatic_cylinder", "power_damping", "force", "v", _odd_power("v", "c", 0.6)),
    _term("two_mass", "power_damping", "motor_torque", "w1", _odd_power("w1", "c", 0.6)),
    _term("stage", "magnet", "force", "x", _magnet("x")),
    _term("cylinder", "root_leak", "flow", "pL", _odd_power("pL", "c", 0.5)),
    _term("micro_actuator", "quintic_stiffness", "force", "x", _odd_power("x", "K5", 5)),
    _term(
        "thermal",
        "radiation",
        "heat",
        "T",
        lambda z, e, _: -e["s"] * ((z["T"] + 273.15) ** 4 - (STEADY["Ta"] + 273.15) ** 4),
        plain=_loss,
    ),
    _term("rotary_drive", "cubic_damping", "torque", "w", _odd_power("w", "B3", 3)),
    _term("stage", "power_damping", "force", "v", _odd_power("v", "c", 0.6)),
    HiddenTerm(
        "tanks",
        "pump_back_pressure",
        "upper_tank",
        ("u", "h1"),
        lambda z, e, p: -p["kp"] * e["c"] * z["u"] * z["h1"],
        (_linear("u"), _outflow),
    ),
    _term("micro_actuator", "thermal_drive", "force", "v", _warmth("v"), lagged=True),
    _term("cylinder", "power_damping", "force", "v", _odd_power("v", "c", 0.6)),
    _term(
        "thermal",
        "convection",
        "heat",
        "T",
        lambda z, e, _: -e["c"] * np.sign(z["T"] - STEADY["Ta"]) * np.abs(z["T"] - STEADY["Ta"]) ** 1.25,
        plain=_loss,
    ),
    _term("rotary_drive", "creeping_friction", "torque", "w", lambda z, e, _: -e["Fc"] * np.tanh(z["w"] / e["vr"])),
    _term("cylinder", "end_stop", "force", "x", _stop),
    _term("stage", "cubic_damping", "force", "v", _odd_power("v", "B3", 3)),
    _term("two_mass", "cubic_damping", "motor_torque", "w1", _odd_power("w1", "B3", 3)),
)
"""20 cases: 5 on the two rigs, 15 on six plants."""


def make_case(term: HiddenTerm, seed: int) -> Case:
    """The records of one."""
    if term.plant in RIGS:
        return make_rig(seed, "foreign", ROWS, (term.effect,), term.plant)
    return make_plant(seed, "foreign", term.plant, ROWS, (term.effect,))


def is_family(term: HiddenTerm, case: Case, laws: list[dict]) -> bool:
    """Whether the laws act on the balance of the true term, in its variables, with its shape over the range that was seen."""
    if not laws or any(law["site"] != term.site or ("memory" in law) != term.lagged for law in laws):
        return False
    ranges = {name: limits for law in laws for name, limits in law["range"].items()}
    if set(ranges) - set(STEADY) != set(term.variables):
        return False
    generator = np.random.default_rng(1)
    values = {name: generator.uniform(*limits, POINTS) for name, limits in ranges.items()}
    values |= {name: np.full(POINTS, value) for name, value in STEADY.items()}
    true = term.value(values, case.effects[term.effect], case.base)
    of_laws = np.sum([_evaluate(law, values) for law in laws], axis=0)
    if term.plain:
        columns = np.column_stack([one(values) for one in term.plain])
        true, of_laws = (z - columns @ np.linalg.lstsq(columns, z, rcond=None)[0] for z in (true, of_laws))
    size = float(np.linalg.norm(true) * np.linalg.norm(of_laws))
    return bool(size > 0 and float(true @ of_laws) > ALIKE * size)


class _Known(dict):
    @property
    def names(self) -> list[str]:
        return list(self)


def _evaluate(law: dict, values: Values) -> np.ndarray:
    symbols = {name: ca.SX.sym(name) for name in values}
    constants = {name: constant["value"] for name, constant in law["parameters"].items()}
    expression = evaluate_formula("law", law["formula"], _Known(symbols | constants))
    function = ca.Function("law", [ca.vertcat(*symbols.values())], [expression])
    return np.asarray(function(np.vstack(list(values.values()))).full()).ravel()
