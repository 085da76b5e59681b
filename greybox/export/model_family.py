"""A linear model with its uncertainty: a family of models drawn from the covariance of the constants, and what they have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from greybox.errors import ModelError
from greybox.export.linearisation import Linearisation
from greybox.export.linearise import linearise_at
from greybox.export.model_functions import ModelFunctions
from greybox.export.parameter_samples import ParameterDistribution, make_parameter_distribution
from greybox.export.plant import Plant, to_plant
from greybox.result import Fit
from greybox.result.summary import format_table

WorstCaseCriterion = Callable[[Linearisation], float]
LinearisationSettings = tuple[
    Mapping[str, float] | None, float | None, str, float, bool
]  # at, dt, method, delay, minimal
ERROR_GRID = 200  # frequencies up to the bandwidth at which the family is compared with the nominal model
STARTS = 5  # of the search for the worst case, from the worst of the draws


@dataclass(frozen=True, eq=False)
class WorstCase:
    """The worst case: ``value`` of the criterion, the ``model``, its ``parameters`` by name; ``nominal`` value of the criterion."""

    value: float
    nominal: float
    model: Linearisation
    parameters: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class ModelFamily:
    """``nominal`` and the ``members`` drawn about it (with the generator's ``seed``); ``constants`` (N, np) of the members by ``names``.

    ``about``: the operating point found for each member from the same ``at``; ``notes`` say which constants do not vary.
    """

    nominal: Linearisation
    members: tuple[Linearisation, ...]
    constants: np.ndarray
    names: tuple[str, ...]
    seed: int
    notes: tuple[str, ...]
    _plant: Plant
    _equations: ModelFunctions
    _cloud: ParameterDistribution
    _how: LinearisationSettings

    @property
    def poles(self) -> np.ndarray:
        """Poles (N, nx) of the members, each beside the pole of the nominal model that it belongs to (nearest in sum)."""
        from scipy.optimize import linear_sum_assignment  # slow to import, and a model alone does not need it

        home = self.nominal.poles
        rows = []
        for member in self.members:
            own = member.poles
            _, order = linear_sum_assignment(np.abs(home[:, None] - own[None, :]))
            rows.append(own[order])
        return np.array(rows)

    def pole_bounds(self, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Intervals (nx, 2) of the real parts and of the sizes of the imaginary parts that hold the share ``level`` of each pole."""
        ends = [(1 - level) / 2, (1 + level) / 2]
        poles = self.poles
        return np.quantile(poles.real, ends, axis=0).T, np.quantile(np.abs(poles.imag), ends, axis=0).T

    def frequency_response(self, omega: np.ndarray) -> np.ndarray:
        """Complex responses (N, nw, ny, nu) of the members at the angular frequencies ``omega`` (nw,) in rad/s."""
        return np.array([member.frequency_response(omega) for member in self.members])

    def bounds(self, omega: np.ndarray, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest gain (nw, ny, nu) at each frequency that the share ``level`` of the members lies between."""
        size = np.abs(self.frequency_response(omega))
        rest = (1 - level) / 2
        low, high = np.quantile(size, [rest, 1 - rest], axis=0)
        return low, high

    def relative_error(self, omega: np.ndarray) -> np.ndarray:
        """Largest ``|G - G0| / |G0|`` over the members (nw, ny, nu): the radius of a multiplicative uncertainty that covers them."""
        home = self.nominal.frequency_response(omega)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = np.abs(self.frequency_response(omega) - home) / np.abs(home)
        return away.max(axis=0)

    def worst(self, criterion: WorstCaseCriterion, level: float = 0.95) -> WorstCase:
        """The member of the confidence set of ``level`` for which ``criterion`` (a number, larger is worse) is largest.

        The set is the ellipsoid ``z'z <= chi2(level, n)`` of the constants' covariance (in the logarithm of constants drawn by it), cut
        off at their bounds. It is searched from the worst of random points on its surface.
        """
        from scipy.optimize import minimize  # slow to import, and a model alone does not need it

        cloud, radius = self._cloud, float(np.sqrt(chdtri(self._cloud.dimensions, 1 - level)))
        generator = np.random.default_rng(self.seed)

        def at(z: np.ndarray) -> Linearisation:
            return self._member(cloud.whole(cloud.moved(z)))

        surface = generator.standard_normal((max(len(self.members), 2 * STARTS), cloud.dimensions))
        surface *= radius / np.linalg.norm(surface, axis=1, keepdims=True)
        points = np.vstack([surface, np.zeros(cloud.dimensions)])
        values = np.array([criterion(at(z)) for z in points])
        best = points[np.argmax(values)]
        for start in points[np.argsort(-values)[:STARTS]]:
            found = minimize(
                lambda z: -criterion(at(z)), start, method="SLSQP",
                constraints={"type": "ineq", "fun": lambda z: radius**2 - z @ z, "jac": lambda z: -2 * z},
            )  # fmt: skip
            z = found.x * min(1.0, radius / max(float(np.linalg.norm(found.x)), 1e-300))
            if criterion(at(z)) > criterion(at(best)):
                best = z
        model = at(best)
        return WorstCase(float(criterion(model)), float(criterion(self.nominal)), model, model.parameters)

    def _member(self, p: np.ndarray) -> Linearisation:
        return _member(self._plant, self._equations, p, self._how)

    def __str__(self) -> str:
        """How far poles, gains and frequency responses spread."""
        home, (real, imag) = self.nominal.poles, self.pole_bounds()
        rows = [
            [
                f"{home[k].real:.6g}{home[k].imag:+.6g}j" if home[k].imag else f"{home[k].real:.6g}",
                f"[{real[k][0]:.6g}, {real[k][1]:.6g}]",
                f"[{imag[k][0]:.6g}, {imag[k][1]:.6g}]" if home[k].imag else "",
            ]
            for k in np.flatnonzero(home.imag >= 0)
        ]
        errors = []
        for row, output in enumerate(self.nominal.output_names):
            for column, name in enumerate(self.nominal.input_names):
                gains = [member.channel(output, name).gain for member in self.members]
                low, high = np.quantile(gains, [0.025, 0.975])
                rows.append([f"gain {name} -> {output}", f"[{low:.6g}, {high:.6g}]", ""])
                errors += self._error_line(row, column)
        head = (
            f"{len(self.members)} models drawn from the covariance of {', '.join(self._cloud.names)} (seed {self.seed})"
        )
        lines = [head, *format_table(["pole", "real part, 95 %", "imaginary part, 95 %"], rows), *errors]
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    def _error_line(self, row: int, column: int) -> list[str]:
        """How far the members' responses are from the nominal one within the bandwidth of a channel, if it has one."""
        channel = self.nominal.channel(self.nominal.output_names[row], self.nominal.input_names[column])
        if not np.isfinite(channel.bandwidth):
            return []
        omega = channel.bandwidth * np.geomspace(1e-3, 1, ERROR_GRID)
        largest = self.relative_error(omega)[:, row, column].max()
        return [
            f"  response {channel.input} -> {channel.output} up to {channel.bandwidth:.6g} rad/s: within {100 * largest:.3g} % of the"
            " nominal one"
        ]


def sample_family(
    fit: Fit,
    at: Mapping[str, float] | None = None,
    *,
    number: int = 100,
    seed: int = 0,
    dt: float | None = None,
    method: str = "zoh",
    delay: float = 0.0,
    minimal: bool = False,
) -> ModelFamily:
    """``number`` linear models drawn from the covariance of a fit's constants, and the nominal one; the same ``seed`` draws the same.

    Constants are drawn from a normal distribution; a positive one that is known to no better than a quarter by its logarithm; draws
    outside the bounds are drawn anew. The operating point is found for each draw from the same ``at``; the other arguments are those
    of `linearise`; ``minimal`` takes the same states out of each.

    Raises ModelError for a model without a fit, for fewer than two draws, and where the draws do not have the same states.
    """
    if number < 2:
        raise ModelError(f"a family of {number}: give at least 2 models")
    plant = to_plant(fit)
    cloud, equations = make_parameter_distribution(plant), ModelFunctions(plant.model)
    generator = np.random.default_rng(seed)
    constants = np.array([cloud.draw(generator) for _ in range(number)])
    how = (at, dt, method, delay, minimal)
    nominal = _member(plant, equations, plant.p, how)
    members = tuple(_member(plant, equations, p, how) for p in constants)
    odd = next((member for member in members if member.state_names != nominal.state_names), None)
    if odd is not None:
        raise ModelError(
            f"family of {plant.model.title}: the states differ from draw to draw, {', '.join(nominal.state_names)} and"
            f" {', '.join(odd.state_names)}; leave minimal out, or, where the delay is a fitted constant, dt, or fix the delay"
        )
    return ModelFamily(
        nominal, members, constants, tuple(plant.model.values), seed, cloud.notes, plant, equations, cloud, how
    )


def _member(plant: Plant, equations: ModelFunctions, p: np.ndarray, how: LinearisationSettings) -> Linearisation:
    at, dt, method, delay, minimal = how
    model = linearise_at(plant, equations, p, at, dt, method, delay)
    return model.minimal() if minimal else model
