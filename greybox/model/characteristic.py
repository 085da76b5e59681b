"""A characteristic curve of unknown shape: straight pieces between given points, whose heights are parameters of the model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import casadi as ca
import numpy as np

from greybox.base import ModelError
from greybox.model.signals import Expression, NamedValues, Parameter


class CharacteristicTrend(StrEnum):
    """What is known of a curve's course."""

    ANY = "any"
    RISING = "rising"
    FALLING = "falling"


@dataclass(frozen=True)
class Characteristic:
    """A curve ``y = name(x)`` in a balance, to be fitted: the torque of a fan, the flow of a valve over its lift, a reading curve.

    Straight pieces join the points; beyond the first and the last one the outermost pieces go on. The heights at the points are parameters
    ``name_1 ... name_n``; of a rising or falling curve the first height and the rises ``name_rise_2 ...`` (or falls) from point to
    point, which cannot be negative. The places of the points are fixed parameters ``name_at_1 ...``.

    Parameters
    ----------
    name
        Begins the names of its parameters.
    unit
        Unit of its height, as text.
    over
        Unit of its argument, as text.
    at
        Places of the points in that unit, ascending, two at least.
    start
        Heights to start from, one a point.
    shape
        ``any``, ``rising`` or ``falling``.
    bounds
        Lowest and highest height, or the limits of the first one where the curve rises or falls.
    source, description
        As those of a `Parameter`.

    Raises
    ------
    ModelError
        For places that do not ascend, heights that do not go with them, their bounds or the shape.

    Examples
    --------
    >>> fan = Characteristic("fan", "N*m", over="rad/s", at=(0, 100, 200), start=(0, 0.1, 0.4), shape="rising")
    >>> [q.name for q in fan.parameters]
    ['fan_1', 'fan_rise_2', 'fan_rise_3', 'fan_at_1', 'fan_at_2', 'fan_at_3']

    Give a model ``parameters=[..., *fan.parameters]`` and write ``load=-fan(x.w, p)`` in a balance.
    """

    name: str
    unit: str
    over: str
    at: tuple[float, ...]
    start: tuple[float, ...]
    shape: CharacteristicTrend | str = CharacteristicTrend.ANY
    bounds: tuple[float, float] = (-math.inf, math.inf)
    source: str = "rough start of a curve that is fitted"
    description: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", tuple(map(float, self.at)))
        object.__setattr__(self, "start", tuple(map(float, self.start)))
        try:
            object.__setattr__(self, "shape", CharacteristicTrend(self.shape))
        except ValueError:
            shapes = ", ".join(CharacteristicTrend)
            raise ModelError(
                f"characteristic {self.name!r}: unknown shape {self.shape!r}; give one of {shapes}"
            ) from None
        if len(self.at) < 2 or not np.all(np.diff(self.at) > 0):
            raise ModelError(
                f"characteristic {self.name!r}: its points must ascend, two at least; at = {_listed(self.at)}"
            )
        if len(self.start) != len(self.at):
            raise ModelError(
                f"characteristic {self.name!r}: {len(self.start)} heights to start from for {len(self.at)} points; give one a point"
            )
        if self._direction and np.any(self._direction * np.diff(self.start) < 0):
            raise ModelError(f"characteristic {self.name!r}: start = {_listed(self.start)} is not {self.shape}")

    @property
    def _direction(self) -> float:
        """1 of a rising curve, -1 of a falling one, 0 of any other."""
        return {CharacteristicTrend.RISING: 1.0, CharacteristicTrend.FALLING: -1.0}.get(
            CharacteristicTrend(self.shape), 0.0
        )

    @property
    def parameters(self) -> list[Parameter]:
        """Its parameters, for the list of a model: heights (or first height and rises), then the places, which are fixed."""
        count = len(self.at)
        text = self.description or f"curve {self.name}"

        def height(k: int) -> Parameter:
            described = f"{text} at {self.at[k]:g} {self.over}"
            return Parameter(
                f"{self.name}_{k + 1}", self.unit, self.start[k], self.bounds, source=self.source, description=described
            )

        def change(k: int) -> Parameter:
            word = "rise" if self._direction > 0 else "fall"
            described = f"{text}: {word} from {self.at[k - 1]:g} to {self.at[k]:g} {self.over}"
            size = self._direction * (self.start[k] - self.start[k - 1])
            return Parameter(
                f"{self.name}_{word}_{k + 1}",
                self.unit,
                size,
                (0.0, math.inf),
                source=self.source,
                description=described,
            )

        # Rises that cannot be negative keep a monotonic curve so during a fit, without a constraint between heights.
        heights = [height(0), *(change(k) if self._direction else height(k) for k in range(1, count))]
        places = [
            Parameter(
                f"{self.name}_at_{k + 1}",
                self.over,
                place,
                fixed=True,
                source="chosen point of the curve",
                description=f"{text}: place of point {k + 1}",
            )
            for k, place in enumerate(self.at)
        ]
        return [*heights, *places]

    def __call__(self, argument: Expression, p: NamedValues) -> Expression:
        """The height at ``argument``, an expression of its unit; ``p`` are the parameters of the model."""
        count = len(self.at)
        places = [p[f"{self.name}_at_{k + 1}"] for k in range(count)]
        height = p[f"{self.name}_1"]
        for k in range(1, count):
            # How far the argument has come into the piece from point k - 1 to k: none before it, all of it behind. The outermost
            # pieces have no end, so that the curve goes on with their slope.
            within = argument - places[k - 1]
            if k > 1:
                within = ca.fmax(within, 0)
            if k < count - 1:
                within = ca.fmin(within, places[k] - places[k - 1])
            # y = y_1 + sum_k (y_k - y_k-1) (share of piece k that lies below the argument)
            height += self._change(k, p) * within / (places[k] - places[k - 1])
        return height

    def _change(self, k: int, p: NamedValues) -> Expression:
        """The change of the height from the point before to point ``k``."""
        if not self._direction:
            return p[f"{self.name}_{k + 1}"] - p[f"{self.name}_{k}"]
        word = "rise" if self._direction > 0 else "fall"
        return self._direction * p[f"{self.name}_{word}_{k + 1}"]


def _listed(values: Sequence[float]) -> str:
    return f"({', '.join(f'{value:g}' for value in values)})"
