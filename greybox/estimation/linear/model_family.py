"""A linear model with its uncertainty: a family of models drawn from the covariance of the parameters, and what they have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from greybox.base import TINY, Finding, ModelError, Printable, Severity, decompose_symmetric
from greybox.estimation.linear.exported_model import ExportedModel, ExportFinding, to_plant
from greybox.estimation.linear.linearisation import Linearisation, minimal_realisation
from greybox.estimation.linear.linearise import choose_point, linearise_at
from greybox.estimation.linear.operating_point import ModelFunctions
from greybox.estimation.result import Fit

# Samples of the fitted parameters from their covariance, within their bounds.


# How often a draw outside the bounds is repeated; what is left then is put on the bound.
FAMILY_REDRAWS = 100


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
            # value exp(step / value): the delta method backwards, positive whatever is drawn.
            factors = np.exp(np.clip(step / np.where(self.logarithmic, centre, 1.0), -50, 50))
        return np.where(self.logarithmic, centre * factors, centre + step)

    def is_within_bounds(self, values: np.ndarray) -> bool:
        """Whether values (k,) respect the bounds."""
        return bool(np.all((values >= self.low) & (values <= self.high)))

    def complete(self, values: np.ndarray) -> np.ndarray:
        """All parameters (np,) with these values (k,), held within their bounds."""
        p = self.p.copy()
        # Where no draw lay within the bounds the last one is put on them.
        p[self.indices] = np.clip(values, self.low, self.high)
        return p

    def draw(self, generator: np.random.Generator) -> np.ndarray:
        """All parameters (np,) of one draw."""
        for _ in range(FAMILY_REDRAWS):
            values = self.move(generator.standard_normal(self.dimensions))
            if self.is_within_bounds(values):
                break
        return self.complete(values)


# A positive parameter with a larger relative standard deviation is drawn by its logarithm: it would often come out negative. The others
# are not: where only a sum of parameters is well determined, logarithms would lose that.
LOGARITHMIC_STD = 0.25


def make_parameter_distribution(plant: ExportedModel) -> ParameterDistribution:
    """The fitted parameters of ``plant`` with their covariance.

    A parameter at its bound or one that the records do not determine has none: it stays where it is, which is a finding. Raises
    ModelError for a model without a fit, and where nothing varies.
    """
    fit, model = plant.fit, plant.model
    if fit is None:
        raise ModelError(f"{model.title} is not a fit: it has no covariance to draw from; give what gb.fit returns")
    free, covariance = fit.uncertainty.free, np.asarray(fit.uncertainty.covariance, float)
    of_model = np.array([n in model.values for n in free], bool)  # not a parameter of one experiment alone
    # Infinite: not determined; NaN: at its bound; neither has a spread to draw from.
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
        np.array([q.positive and s > LOGARITHMIC_STD * q.value for q, s in zip(parameters, scale, strict=True)]),
        decompose_symmetric(block).root[:, ::-1],  # least first: a seed draws what it always drew
        np.array([q.bounds[0] for q in parameters]),
        np.array([q.bounds[1] for q in parameters]),
        findings,
    )


WorstCaseCriterion = Callable[[Linearisation], float]


@dataclass(frozen=True)
class LinearisationSettings:
    """How each member of a family is linearised: the arguments of `linearise`, and whether it is reduced."""

    at: Mapping[str, float] | None = None
    dt: float | None = None
    method: str = "zoh"
    delay: float = 0.0
    minimal: bool = False


@dataclass(frozen=True, eq=False)
class WorstCase:
    """The worst case: ``value`` of the criterion, the ``model``, its ``parameters`` by name; ``nominal`` value of the criterion."""

    value: float
    nominal: float
    model: Linearisation
    parameters: Mapping[str, float]


# Searches for the worst case, from the worst of the draws.
WORST_CASE_STARTS = 5


@dataclass(frozen=True, eq=False)
class ModelFamily(Printable):
    """A nominal linear model and models drawn about it.

    Attributes
    ----------
    nominal
        The model with the fitted parameters.
    members
        The models that were drawn; the operating point is found for each from the same ``settings.at``.
    parameters
        Parameters (N, np) of the members, in the order of ``parameter_names``.
    parameter_names
        Names of all parameters.
    seed
        Seed of the draws.
    findings
        Which parameters do not vary.
    distribution
        What was drawn from.
    settings
        How each member was linearised.
    policy
        How members are drawn, and the worst case is sought.
    """

    nominal: Linearisation
    members: tuple[Linearisation, ...]
    parameters: np.ndarray
    parameter_names: tuple[str, ...]
    seed: int
    findings: tuple[Finding, ...]
    distribution: ParameterDistribution
    settings: LinearisationSettings
    _plant: ExportedModel
    _functions: ModelFunctions

    @property
    def poles(self) -> np.ndarray:
        """Poles (N, nx) of the members, each beside the pole of the nominal model that it belongs to (nearest in sum)."""
        from scipy.optimize import linear_sum_assignment  # slow to import, and a model alone does not need it

        nominal = self.nominal.poles
        rows = []
        for member in self.members:
            poles = member.poles
            # Pairs by least total distance: sorted by size, poles that pass one another would change places.
            _, order = linear_sum_assignment(np.abs(nominal[:, None] - poles[None, :]))
            rows.append(poles[order])
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
        nominal = self.nominal.frequency_response(omega)
        with np.errstate(divide="ignore", invalid="ignore"):
            # |G - G0| / |G0|
            errors = np.abs(self.frequency_response(omega) - nominal) / np.abs(nominal)
        return errors.max(axis=0)

    def worst(self, criterion: WorstCaseCriterion, level: float = 0.95) -> WorstCase:
        """The member of the confidence set of ``level`` for which ``criterion`` (a number, larger is worse) is largest.

        The set is the ellipsoid ``z'z <= chi2(level, n)`` of the parameters' covariance (in the logarithm of parameters drawn by it),
        cut off at their bounds. It is searched from the worst of random points on its surface.
        """
        from scipy.optimize import minimize  # slow to import, and a model alone does not need it

        distribution, starts = self.distribution, WORST_CASE_STARTS
        # z'z of n standard normal numbers is chi-square.
        radius = float(np.sqrt(chdtri(distribution.dimensions, 1 - level)))
        generator = np.random.default_rng(self.seed)

        def linearise_with(z: np.ndarray) -> Linearisation:
            p = distribution.complete(distribution.move(z))
            return _linearise_member(self._plant, self._functions, p, self.settings)

        surface = generator.standard_normal((max(len(self.members), 2 * starts), distribution.dimensions))
        # Uniform directions in z, on the surface: a monotonic criterion has its worst case there.
        surface *= radius / np.linalg.norm(surface, axis=1, keepdims=True)
        points = np.vstack([surface, np.zeros(distribution.dimensions)])
        values = np.array([criterion(linearise_with(z)) for z in points])
        best = points[np.argmax(values)]
        for start in points[np.argsort(-values)[:starts]]:
            # One search from each of the worst points: the criterion may have several maxima on the set.
            result = minimize(
                lambda z: -criterion(linearise_with(z)),
                start,
                method="SLSQP",
                constraints={"type": "ineq", "fun": lambda z: radius**2 - z @ z, "jac": lambda z: -2 * z},
            )
            # SLSQP may end a little outside of the ellipsoid.
            z = result.x * min(1.0, radius / max(float(np.linalg.norm(result.x)), TINY))
            if criterion(linearise_with(z)) > criterion(linearise_with(best)):
                best = z
        model = linearise_with(best)
        return WorstCase(float(criterion(model)), float(criterion(self.nominal)), model, model.parameters)


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
    """Draw linear models from the covariance of a fit's parameters, beside the nominal one.

    Parameters are drawn from a normal distribution; a positive one that is known to no better than a quarter by its logarithm; draws
    outside the bounds are drawn anew.

    Parameters
    ----------
    fit
        What `greybox.fit` gave.
    at
        The operating point, found anew for each draw; see `linearise`.
    number
        How many models are drawn, from 2.
    seed
        The same seed draws the same.
    dt, method, delay
        Sampling, as in `linearise`.
    minimal
        Whether states that no input reaches or no output shows are removed, the same from each member.

    Returns
    -------
    ModelFamily
        The nominal model and the members.

    Raises
    ------
    ModelError
        For a model without a fit, for fewer than two draws, and where the draws do not have the same states.

    Examples
    --------
    >>> family = gb.export.sample_family(fit, {"u": 0.5}, number=100)  # doctest: +SKIP
    >>> family.pole_bounds()  # doctest: +SKIP
    """
    if number < 2:
        raise ModelError(f"a family of {number}: give at least 2 models")
    plant = to_plant(fit)
    distribution, functions = make_parameter_distribution(plant), ModelFunctions(plant.model)
    generator = np.random.default_rng(seed)
    parameters = np.array([distribution.draw(generator) for _ in range(number)])
    settings = LinearisationSettings(choose_point(plant, functions, at)[0], dt, method, delay, minimal)
    nominal = _linearise_member(plant, functions, plant.p, settings)
    members = tuple(_linearise_member(plant, functions, p, settings) for p in parameters)
    different = next((member for member in members if member.state_names != nominal.state_names), None)
    if different is not None:
        raise ModelError(
            f"family of {plant.model.title}: the states differ from draw to draw, {', '.join(nominal.state_names)} and"
            f" {', '.join(different.state_names)}; leave minimal out; if the delay is a fitted parameter, leave dt out or fix the delay"
        )
    return ModelFamily(
        nominal,
        members,
        parameters,
        tuple(plant.model.values),
        seed,
        distribution.findings,
        distribution,
        settings,
        plant,
        functions,
    )


def _linearise_member(
    plant: ExportedModel, functions: ModelFunctions, p: np.ndarray, settings: LinearisationSettings
) -> Linearisation:
    model = linearise_at(plant, functions, p, settings.at, settings.dt, settings.method, settings.delay)
    return minimal_realisation(model) if settings.minimal else model
