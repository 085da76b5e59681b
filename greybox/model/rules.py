"""Rules: what physics demands of several constants together, and of what a sensor may show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.errors import DataError, ModelError, nearest
from greybox.model.signals import NamedValues
from greybox.units import format_unit


@dataclass(frozen=True)
class Rule:
    """Something that must hold beyond the bounds of one parameter: of several parameters together, or of a measured output.

    Parameters
    ----------
    name
        What must hold, as the message says it.
    unit
        Of the margin.
    margin
        Positive where the rule holds. Without an output ``margin(p)`` is a number, and the rule is checked whenever a model is made. With
        one ``margin(value, p)`` takes and returns arrays (N,), and the rule is checked against records; gaps (NaN) pass.
    remedy
        What to do where it is broken.
    output
        Name of the measured output that it is about; empty for a rule about parameters.

    Examples
    --------
    >>> absolute = Rule("supply above ambient", "Pa", lambda p: p.P_S - p.P_a, "give P_S in absolute pressure")
    >>> inside = Rule("piston within its stroke", "m", lambda s, p: p.stroke / 2 - abs(s), "check the zero of the sensor", "s")
    """

    name: str
    unit: str
    margin: Callable[..., Any]
    remedy: str
    output: str = ""


def check_constants(title: str, rules: Sequence[Rule], p: NamedValues) -> None:
    """Refuse parameters that break a rule: ModelError with every broken one, its values and the remedy."""
    broken = []
    for rule in rules:
        if rule.output:
            continue
        recorder = _AccessRecorder(p)
        margin = float(rule.margin(recorder))
        if not margin > 0:
            missed = f"({margin:.4g} {format_unit(rule.unit)}, must be above 0)"
            broken.append(f"{rule.name}: {recorder.listing} {missed}; {rule.remedy}")
    if broken:
        raise ModelError(f"model {title!r} breaks a rule: {'; '.join(broken)}")


def check_measured(
    title: str, rules: Sequence[Rule], measured: Mapping[str, np.ndarray], p: NamedValues, rows_shown: int = 5
) -> None:
    """Refuse measured signals, name -> (N,), that break a rule: DataError with rows, worst value and the remedy."""
    broken = []
    for rule in rules:
        if rule.output not in measured:
            continue
        value = np.asarray(measured[rule.output], float)
        with np.errstate(invalid="ignore"):
            margin = np.broadcast_to(rule.margin(value, p), value.shape)
            rows = np.flatnonzero(~(margin > 0) & np.isfinite(value))
        if len(rows):
            worst = rows[np.argmin(margin[rows])]
            shown = ", ".join(str(row + 1) for row in rows[:rows_shown])
            rest = f" and {len(rows) - rows_shown} more" if len(rows) > rows_shown else ""
            broken.append(
                f"output {rule.output!r} breaks the rule '{rule.name}' at row{'s' * (len(rows) > 1)} {shown}{rest}"
                f" (row {worst + 1}: {value[worst]:.6g} {format_unit(rule.unit)}); {rule.remedy}"
            )
    if broken:
        raise DataError(f"{title}: {'; '.join(broken)}")


def check_outputs_known(title: str, rules: Sequence[Rule], outputs: Sequence[str]) -> None:
    """Refuse a rule about an output that the model does not have."""
    for rule in rules:
        if rule.output and rule.output not in outputs:
            raise ModelError(
                f"model {title!r}: rule {rule.name!r} is about an unknown output; {nearest(rule.output, outputs)}"
            )


class _AccessRecorder:
    """Parameters that remember which of them a rule asked for, so that the message can name them."""

    def __init__(self, p: NamedValues) -> None:
        self._p, self._values = p, dict[str, float]()

    def __getattr__(self, name: str) -> float:
        self._values[name] = float(self._p[name])
        return self._values[name]

    @property
    def listing(self) -> str:
        """``P_S = 5e5, P_a = 6e5``."""
        return ", ".join(f"{name} = {value:.6g}" for name, value in self._values.items())
