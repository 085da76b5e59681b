"""Draws of the fitted constants from their covariance, within their bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.errors import ModelError
from greybox.export.plant import Plant

# Draws outside the bounds are drawn anew, this many times; what is left then is put on the bound.
REDRAWS = 100
# Scaled eigenvalues of a covariance below this are rounding errors.
FLAT = 1e-12
# A positive constant with a larger relative deviation is drawn by its logarithm, as it would often come out negative. The others
# are not: where only a sum of constants is determined well, logarithms would lose that.
RELATIVE = 0.25


@dataclass(frozen=True, eq=False)
class ParameterDistribution:
    """The constants that vary: ``p(z) = centre moved by root @ z`` with ``z`` standard normal (n,).

    ``which`` (k,): their numbers among all constants; ``by_factor`` (k,): those that move by a factor; ``root`` (k, n); ``low``, ``high``
    (k,) bounds. ``notes``: what does not vary.
    """

    p: np.ndarray
    which: np.ndarray
    names: tuple[str, ...]
    by_factor: np.ndarray
    root: np.ndarray
    low: np.ndarray
    high: np.ndarray
    notes: tuple[str, ...]

    @property
    def dimensions(self) -> int:
        """How many independent directions there are."""
        return self.root.shape[1]

    def moved(self, z: np.ndarray) -> np.ndarray:
        """Values (k,) of the constants that vary, bounds not looked at."""
        centre, step = self.p[self.which], self.root @ z
        with np.errstate(over="ignore"):
            factors = np.exp(np.clip(step / np.where(self.by_factor, centre, 1.0), -50, 50))
        return np.where(self.by_factor, centre * factors, centre + step)

    def inside(self, values: np.ndarray) -> bool:
        """Whether values (k,) respect the bounds."""
        return bool(np.all((values >= self.low) & (values <= self.high)))

    def whole(self, values: np.ndarray) -> np.ndarray:
        """All constants (np,) with these values (k,), held within their bounds."""
        p = self.p.copy()
        p[self.which] = np.clip(values, self.low, self.high)
        return p

    def draw(self, generator: np.random.Generator) -> np.ndarray:
        """All constants (np,) of one draw."""
        for _ in range(REDRAWS):
            values = self.moved(generator.standard_normal(self.dimensions))
            if self.inside(values):
                break
        return self.whole(values)


def make_parameter_distribution(plant: Plant) -> ParameterDistribution:
    """The fitted constants of ``plant`` with their covariance.

    A constant at its bound or one that the records do not determine has none: it stays where it is, which the notes say. Raises
    ModelError for a model without a fit, and where nothing varies.
    """
    fit, model = plant.fit, plant.model
    if fit is None:
        raise ModelError(f"{model.title} is no fit: it has no covariance to draw from; give what gb.fit returns")
    covariance = np.asarray(fit.uncertainty.covariance, float)
    own = np.array([n in model.values for n in fit.uncertainty.free], bool)  # not the constant of one experiment alone
    known = np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0) & own
    names = tuple(n for n, k in zip(fit.uncertainty.free, known, strict=True) if k)
    idle = [n for n, k in zip(fit.uncertainty.free, known, strict=True) if not k]
    if not names:
        raise ModelError(f"{model.title}: no fitted constant has a covariance; fit with records that determine some")
    notes = [
        f"{', '.join(idle)}: no covariance (at a bound, or not determined by the records); kept at the fitted value"
    ] * bool(idle)
    block = covariance[np.ix_(known, known)]
    scale = np.sqrt(np.diag(block))
    values, vectors = np.linalg.eigh(block / np.outer(scale, scale))
    some = values > FLAT * values.max()
    root = scale[:, None] * vectors[:, some] * np.sqrt(values[some])
    order = list(model.values)
    chosen = [model.parameter(n) for n in names]
    by_factor = np.array([q.positive and s > RELATIVE * q.value for q, s in zip(chosen, scale, strict=True)])
    return ParameterDistribution(
        plant.p, np.array([order.index(n) for n in names]), names, by_factor, root,
        np.array([q.bounds[0] for q in chosen]), np.array([q.bounds[1] for q in chosen]), tuple(notes),
    )  # fmt: skip
