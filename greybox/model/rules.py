"""Rules: what physics demands of several constants together, and of what a sensor may show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.errors import DataError, ModelError, nearest
from greybox.model.signals import NamedValues
from greybox.units import format_unit

SHOWN = 5  # rows named in a message before "and 40 more"


@dataclass(frozen=True)
class Rule:
    """Something that must hold, beyond the bounds of one constant: ``margin`` is positive where it does.

    Without ``output`` it concerns the constants, ``margin(p)`` is a number in ``unit`` and the rule is checked whenever
    a model is made: ``Rule("supply above ambient", "Pa", lambda p: p.P_S - p.P_a, "give P_S in absolute pressure")``.

    With ``output`` it concerns that measured signal, ``margin(value, p)`` takes and returns arrays (N,), and the rule
    is checked against records: ``Rule("piston within its stroke", "m", lambda s, p: p.stroke / 2 - abs(s), ..., "s")``.
    Gaps (NaN) pass. ``remedy`` says what to do.
    """

    name: str
    unit: str
    margin: Callable[..., Any]
    remedy: str
    output: str = ""


def check_constants(title: str, rules: Sequence[Rule], p: NamedValues) -> None:
    """Refuse constants that break a rule: ModelError with every broken one, the values it speaks of and the remedy."""
    broken = []
    for rule in rules:
        if rule.output:
            continue
        seen = _Seen(p)
        margin = float(rule.margin(seen))
        if not margin > 0:
            broken.append(f"{rule.name}: {seen.said} {_missed(margin, rule.unit)}; {rule.remedy}")
    if broken:
        raise ModelError(f"model {title!r} breaks a rule: {'; '.join(broken)}")


def check_measured(title: str, rules: Sequence[Rule], measured: Mapping[str, np.ndarray], p: NamedValues) -> None:
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
            shown = ", ".join(str(row + 1) for row in rows[:SHOWN])
            rest = f" and {len(rows) - SHOWN} more" if len(rows) > SHOWN else ""
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


def _missed(margin: float, unit: str) -> str:
    return f"({margin:.4g} {format_unit(unit)}, must be above 0)"


class _Seen:
    """Constants that remember which of them a rule asked for, so that the message can name them."""

    def __init__(self, p: NamedValues) -> None:
        self._p, self._asked = p, dict[str, float]()

    def __getattr__(self, name: str) -> float:
        self._asked[name] = float(self._p[name])
        return self._asked[name]

    @property
    def said(self) -> str:
        return ", ".join(f"{name} = {value:.6g}" for name, value in self._asked.items())
