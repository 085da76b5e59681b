"""Samples of the fitted parameters from their covariance, within their bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.errors import ModelError
from greybox.export.findings import ExportFinding
from greybox.export.plant import Plant
from greybox.export.policy import DEFAULT_FAMILY, FamilyPolicy
from greybox.findings import Finding, Severity
from greybox.linear_algebra import decompose_symmetric


@dataclass(frozen=True, eq=False)
class ParameterDistribution:
    """The parameters that vary: ``p(z) = centre moved by root @ z`` with ``z`` standard normal (n,).

    Attributes
    ----------
    p
        The fitted values of all parameters (np,).
    indices
        Which of these vary (k,).
    names
        Their names.
    logarithmic
        Which of these are drawn by their logarithm (k,).
    root
        Square root of the covariance (k, n).
    low, high
        Bounds (k,).
    findings
        What does not vary.
    """

    p: np.ndarray
    indices: np.ndarray
    names: tuple[str, ...]
    logarithmic: np.ndarray
    root: np.ndarray
    low: np.ndarray
    high: np.ndarray
    findings: tuple[Finding, ...]

    @property
    def dimensions(self) -> int:
        """How many independent directions there are."""
        return self.root.shape[1]

    def move(self, z: np.ndarray) -> np.ndarray:
        """Values (k,) of the parameters that vary, regardless of bounds."""
        centre, step = self.p[self.indices], self.root @ z
        with np.errstate(over="ignore"):
            factors = np.exp(np.clip(step / np.where(self.logarithmic, centre, 1.0), -50, 50))
        return np.where(self.logarithmic, centre * factors, centre + step)

    def is_within_bounds(self, values: np.ndarray) -> bool:
        """Whether values (k,) respect the bounds."""
        return bool(np.all((values >= self.low) & (values <= self.high)))

    def complete(self, values: np.ndarray) -> np.ndarray:
        """All parameters (np,) with these values (k,), held within their bounds."""
        p = self.p.copy()
        p[self.indices] = np.clip(values, self.low, self.high)
        return p

    def draw(self, generator: np.random.Generator, policy: FamilyPolicy = DEFAULT_FAMILY) -> np.ndarray:
        """All parameters (np,) of one draw."""
        for _ in range(policy.redraws):
            values = self.move(generator.standard_normal(self.dimensions))
            if self.is_within_bounds(values):
                break
        return self.complete(values)


def make_parameter_distribution(plant: Plant, policy: FamilyPolicy = DEFAULT_FAMILY) -> ParameterDistribution:
    """The fitted parameters of ``plant`` with their covariance.

    A parameter at its bound or one that the records do not determine has none: it stays where it is, which is a finding. Raises
    ModelError for a model without a fit, and where nothing varies.
    """
    fit, model = plant.fit, plant.model
    if fit is None:
        raise ModelError(f"{model.title} is not a fit: it has no covariance to draw from; give what gb.fit returns")
    free, covariance = fit.uncertainty.free, np.asarray(fit.uncertainty.covariance, float)
    of_model = np.array([n in model.values for n in free], bool)  # not a parameter of one experiment alone
    varies = np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0) & of_model
    names = tuple(n for n, v in zip(free, varies, strict=True) if v)
    fixed = [n for n, v in zip(free, varies, strict=True) if not v]
    if not names:
        raise ModelError(
            f"{model.title}: no fitted parameter has a covariance; fit records that determine at least one"
        )
    findings: tuple[Finding, ...] = ()
    if fixed:
        findings = (Finding(ExportFinding.PARAMETERS_NOT_DRAWN, Severity.WARNING, values={"parameters": fixed}),)
    block = covariance[np.ix_(varies, varies)]
    scale = np.sqrt(np.diag(block))
    order = list(model.values)
    parameters = [model.parameter(n) for n in names]
    return ParameterDistribution(
        plant.p,
        np.array([order.index(n) for n in names]),
        names,
        np.array([q.positive and s > policy.logarithmic_std * q.value for q, s in zip(parameters, scale, strict=True)]),
        decompose_symmetric(block).root[:, ::-1],  # least first: a seed draws what it always drew
        np.array([q.bounds[0] for q in parameters]),
        np.array([q.bounds[1] for q in parameters]),
        findings,
    )
