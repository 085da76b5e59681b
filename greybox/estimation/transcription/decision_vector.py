"""The decision vector of a fit: scaled constants, shared or of one experiment, each experiment's free initial states, noise levels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from greybox.base.errors import ModelError, is_slip_of, nearest
from greybox.base.numerics import AT_BOUND, ROUNDED_BOUND
from greybox.model import Model, Parameter
from greybox.simulation.free_run import SettledStart

# Operating conditions: constants that an experiment brings itself, such as the supply pressure it was run at.


def resolve_conditions(
    model: Model, conditions: Sequence[Mapping[str, float]], per_experiment: Sequence[str] = ()
) -> tuple[dict[int, float], ...]:
    """For each experiment its conditions, as position in ``system.p`` -> value.

    A condition is a parameter of the model with a value of its own in that experiment, in the parameter's unit, or something that the
    model does not speak of (a load, a temperature), by which the records are compared and which is left out here; experiments that
    do not name it keep the model's value. It is known, so it is not fitted.

    Parameters
    ----------
    model
        The model whose parameters are meant.
    conditions
        For each experiment name -> value.
    per_experiment
        Constants that each experiment has for itself: those may be given for some experiments only.

    Raises
    ------
    ModelError
        With all offenders: a name that the model does not have, a value that its bounds or the model's rules refuse, and a free
        constant that only some experiments give (for the others it would be fitted, and then it is no condition).
    """
    names = list(model.values)
    problems = []
    for e, given in enumerate(conditions):
        subject = f"experiment {e + 1} of {len(conditions)}"
        tied = {tie.name: tie for tie in model.ties}
        problems += [
            f"{subject}: condition {n!r} is tied in {model.title}, {tied[n]}; first untie({n!r})"
            for n in given
            if n in tied
        ]
        # What the model does not speak of (a load, a temperature) is what its records are compared by; a name that is nearly that of a
        # parameter is a mistake.
        mistaken = [n for n in given if n not in names and n not in tied and is_slip_of(n, names)]
        problems += [
            f"{subject}: condition {n!r} is not a parameter of {model.title}; {nearest(n, names)}" for n in mistaken
        ]
        try:
            model.start(**{n: v for n, v in given.items() if n in names})
        except ModelError as error:
            problems.append(f"{subject}, its conditions: {error}")
    for q in model.free_parameters:
        missing = [str(e + 1) for e, given in enumerate(conditions) if q.name not in given]
        if 0 < len(missing) < len(conditions) and q.name not in per_experiment:
            problems.append(
                f"condition {q.name!r} is free in the model but not given for experiment {', '.join(missing)}; give it for every"
                f" experiment, or fix it: model.fix({q.name}=...)"
            )
    if problems:
        raise ModelError("; ".join(problems))
    return tuple({names.index(n): float(v) for n, v in given.items() if n in names} for given in conditions)


def check_own_constants(model: Model, per_experiment: Sequence[str], experiments: int) -> None:
    """Refuse constants that cannot be each experiment's own: ModelError with all offenders, why, and what to do."""
    problems = []
    for name in per_experiment:
        try:
            quantity = model.parameter(name)
        except ModelError as error:
            problems.append(str(error))
            continue
        if quantity.fixed:
            problems.append(f"{name!r} is fixed at {quantity.value:g} {quantity.unit}; first free({name!r})")
    twice = sorted({n for n in per_experiment if list(per_experiment).count(n) > 1})
    problems += [f"{name!r} is named twice; name it once" for name in twice]
    if per_experiment and experiments < 2:
        problems.append("there is one experiment; a separate value for each experiment needs several")
    if problems:
        raise ModelError(f"own parameters: {'; '.join(problems)}")


def apply_conditions(p: np.ndarray, conditions: Mapping[int, float]) -> np.ndarray:
    """The parameters (np,) with those that an experiment gives replaced; ``p`` itself is left alone."""
    p = p.copy()
    p[list(conditions)] = list(conditions.values())
    return p


SHARED = -1
"""The owner of a constant that all experiments have in common."""


@dataclass(frozen=True)
class InitialStates:
    """How the records begin.

    A state that is not free has its declared start value, which may depend on the parameters.
    """

    guess: np.ndarray
    """Values to start from (experiments, nx)."""

    free: np.ndarray
    """Which states are estimated (nx,)."""

    scale: np.ndarray
    """What a step of one in ``z`` changes each state by (nx,)."""

    settled: SettledStart | None = None
    """Where the model comes to rest before each record, in the place of the declared start."""


@dataclass(frozen=True)
class NoiseLevels:
    """Noise that is estimated with the rest, ``level * exp(z)``: a likelihood has it among its unknowns."""

    level: np.ndarray
    """Standard deviation of each output's noise at ``z = 0`` (ny,)."""

    estimated: np.ndarray
    """For which outputs it is estimated (ny,)."""

    least: np.ndarray
    """Where it is not followed any further down (ny,)."""

    greatest: float
    """The largest logarithm of its ratio to ``level``."""


# Damped steps follow a quadratic model over a factor ``e^4.6``, a hundred, of a positive constant. Farther away it promises what is not
# there: as a rate leaves the record its slope dies away, and the step to where nothing is gained grows without end.
MAX_LOG_CHANGE = 4.6


class Point(NamedTuple):
    """The parts of a point ``z``, or of a gradient there, as views: what is written into a part stands in ``z``."""

    parameters: np.ndarray
    """The free constants, scaled (nf,)."""

    initial_states: np.ndarray
    """The free initial states, scaled (experiments, states)."""

    noise_levels: np.ndarray
    """Logarithms of the estimated noise over its level (k,)."""


class PointSlices(NamedTuple):
    """Where the parts of a `Point` stand in ``z``, in a gradient, and in the rows and columns of a matrix."""

    parameters: slice
    initial_states: slice
    noise_levels: slice


@dataclass(frozen=True)
class DecisionVector:
    """Map between the optimiser's numbers ``z`` and physical ones.

    A constant that can only be positive is ``value * exp(z)``, another one ``value + scale * z``; an initial state is
    ``guess + scale * z``. ``z = 0`` is the start. ``conditions`` are the constants that an experiment brings itself (position in
    ``system.p`` -> value, one mapping for each experiment or none at all): they take the place of the model's and are not fitted.

    A constant may have a value of its own in each experiment: then it stands in ``names`` once for each of them, as ``B (day 1)``,
    and ``owner`` says for which; without an experiment it counts with the mean of these values (the geometric one where positive).
    ``groups``: to which experiment each record belongs, where records are pieces of experiments. ``prior`` (nf, 2): mean and
    standard deviation of what is known of each constant without the records; infinite where nothing is.
    """

    model: Model

    names: tuple[str, ...]
    """What each free constant is called."""

    which: np.ndarray
    """Position of each free constant in ``system.p`` (nf,)."""

    owner: np.ndarray
    """The experiment whose own constant it is, `SHARED` for one of all (nf,)."""

    logarithmic: np.ndarray
    """Whether it is scaled as ``base * exp(z)`` (nf,)."""

    base: np.ndarray
    """Its value at ``z = 0`` (nf,)."""

    scale: np.ndarray
    """What a step of one in ``z`` changes it by, where it is not logarithmic (nf,)."""

    low: np.ndarray
    high: np.ndarray
    """Its bounds (nf,)."""

    prior: np.ndarray
    """Mean and standard deviation of what is known of it without the records (nf, 2)."""

    fixed: np.ndarray
    """Values of all parameters at the start (np,)."""

    initial: InitialStates
    groups: tuple[int, ...]
    conditions: tuple[Mapping[int, float], ...] = ()
    noise: NoiseLevels | None = None

    @classmethod
    def of(
        cls,
        model: Model,
        initial: InitialStates,
        conditions: Sequence[Mapping[str, float]] = (),
        per_experiment: Sequence[str] = (),
        experiments: Sequence[str] = (),
    ) -> DecisionVector:
        """The free constants of ``model`` at their present values, and the free initial states.

        Parameters
        ----------
        model
            The model.
        initial
            How the records begin.
        conditions
            For each experiment name -> value of the constants that it brings itself.
        per_experiment
            Constants that each experiment has for itself, but for those that bring them as a condition.
        experiments
            Names of the experiments, which become part of the names of their own constants.

        Raises
        ------
        ModelError
            For conditions or own constants that do not go with the model, see `resolve_conditions` and `check_own_constants`.
        """
        count = len(initial.guess)
        resolved = resolve_conditions(model, conditions, per_experiment)
        check_own_constants(model, per_experiment, count)
        # Position in ``system.p`` and owner of each free constant; a condition is not fitted in the experiment that brings it.
        given, places = {k for each in resolved for k in each}, []
        for k, q in enumerate(model.all_parameters):
            if not q.fixed and q.name in per_experiment:
                places += [(k, e) for e in range(count) if not resolved or k not in resolved[e]]
            elif not q.fixed and k not in given:
                places.append((k, SHARED))
        free = [model.all_parameters[k] for k, _ in places]
        base = np.array([q.value for q in free], float)
        titles = make_unique(experiments or [f"experiment {e + 1}" for e in range(count)])
        owners = [e for _, e in places]
        return cls(
            model=model,
            names=tuple(
                q.name if e == SHARED else f"{q.name} ({titles[e]})" for q, e in zip(free, owners, strict=True)
            ),
            which=np.array([k for k, _ in places], int),
            owner=np.array(owners, int),
            logarithmic=np.array([q.positive for q in free], bool),
            base=base,
            scale=np.where(base == 0, 1.0, np.abs(base)),
            low=np.array([q.bounds[0] for q in free], float),
            high=np.array([q.bounds[1] for q in free], float),
            prior=np.array([q.prior or (0.0, np.inf) for q in free], float).reshape(-1, 2),
            fixed=np.array([q.value for q in model.all_parameters], float),
            initial=initial,
            groups=tuple(range(count)),
            conditions=resolved,
        )

    @property
    def experiments(self) -> int:
        """Number of experiments."""
        return len(self.initial.guess)

    @cached_property
    def free_states(self) -> np.ndarray:
        """Numbers of the initial states that are estimated in each experiment."""
        return np.flatnonzero(self.initial.free)

    @property
    def size(self) -> int:
        """Length of ``z``."""
        return self.slices.noise_levels.stop

    @property
    def here(self) -> np.ndarray:
        """The present point, ``z = 0``."""
        return np.zeros(self.size)

    @cached_property
    def slices(self) -> PointSlices:
        """Where the parts of a point stand in ``z``."""
        parameters = len(self.which)
        states = parameters + self.experiments * len(self.free_states)
        size = states + (0 if self.noise is None else int(self.noise.estimated.sum()))
        return PointSlices(slice(0, parameters), slice(parameters, states), slice(states, size))

    def split(self, z: np.ndarray) -> Point:
        """The parts of ``z`` (size,)."""
        parameters, states, noise = (z[part] for part in self.slices)
        return Point(parameters, states.reshape(self.experiments, -1), noise)

    @property
    def labels(self) -> tuple[str, ...]:
        """What each entry of ``z`` stands for."""
        states = self.model.system.state_names
        return (
            *self.names,
            *(f"{states[j]}(0) of experiment {e + 1}" for e in range(self.experiments) for j in self.free_states),
            *(f"noise of {self.model.outputs[j].name}" for j in self.estimated_noise),
        )

    @cached_property
    def estimated_noise(self) -> np.ndarray:
        """Numbers of the outputs whose noise is estimated with the rest."""
        return np.flatnonzero(() if self.noise is None else self.noise.estimated)

    @property
    def quantities(self) -> tuple[Parameter, ...]:
        """The parameter that each free constant is."""
        everything = self.model.all_parameters
        return tuple(everything[k] for k in self.which)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on ``z``; initial states have their state's physical bounds."""
        span = np.where(self.logarithmic, 1.0, self.scale)
        with np.errstate(divide="ignore", invalid="ignore"):
            # z = ln(bound / base), or (bound - base) / scale.
            low = np.where(self.logarithmic, np.log(self.low / self.base), (self.low - self.base) / span)
            high = np.where(self.logarithmic, np.log(self.high / self.base), (self.high - self.base) / span)
        states = self.model.all_states
        for e in range(self.experiments):
            edges = np.array([states[j].bounds for j in self.free_states]).reshape(-1, 2)
            # States are in z as well: (bound - guess) / scale.
            guess, scale = self.initial.guess[e, self.free_states], self.initial.scale[self.free_states]
            low = np.concatenate([low, (edges[:, 0] - guess) / scale])
            high = np.concatenate([high, (edges[:, 1] - guess) / scale])
        if self.noise is None:
            return low, high
        # A level starts within its bounds, whatever the estimate of it says.
        floor = np.minimum(np.log(self.noise.least / self.noise.level)[self.estimated_noise], 0.0)
        return np.concatenate([low, floor]), np.concatenate([high, np.full(len(floor), self.noise.greatest)])

    @property
    def reach(self) -> np.ndarray:
        """Longest change of each entry of ``z`` (size,) in one damped step."""
        rest = np.full(self.size - len(self.which), np.inf)
        return np.concatenate([np.where(self.logarithmic, MAX_LOG_CHANGE, np.inf), rest])

    def constants(self, z: np.ndarray) -> np.ndarray:
        """The free constants (nf,) at ``z``, clipped to their bounds (an optimiser may overstep them by a hair)."""
        step = z[self.slices.parameters]
        with np.errstate(over="ignore", invalid="ignore"):
            # p = base e^z stays positive; p = base + scale z may change its sign.
            grown = self.base * np.exp(np.where(self.logarithmic, step, 0.0))
            free = np.where(self.logarithmic, grown, self.base + self.scale * step)
            # exp(ln(bound)) misses the bound by rounding: whoever stands there must see it.
            near = ROUNDED_BOUND * np.abs(free)
            below, above = free - self.low <= near, self.high - free <= near
        return np.where(below, self.low, np.where(above, self.high, free)) if below.any() or above.any() else free

    def parameters(self, z: np.ndarray, experiment: int | None = None) -> np.ndarray:
        """All parameters (np,) at ``z``.

        With ``experiment`` under the conditions of that one and with its own constants, else as the model has them.
        """
        free, p = self.constants(z), self.fixed.copy()
        shared = self.owner == SHARED
        p[self.which[shared]] = free[shared]
        if shared.all():
            return apply_conditions(p, self.conditions[experiment]) if self.conditions and experiment is not None else p
        if experiment is None:
            for place in np.unique(self.which[~shared]):
                same_parameter = (self.which == place) & ~shared
                p[place] = average_own_values(free[same_parameter], bool(self.logarithmic[same_parameter][0]))
            return p
        own_constants = self.owner == self.groups[experiment]
        p[self.which[own_constants]] = free[own_constants]
        return apply_conditions(p, self.conditions[experiment]) if self.conditions else p

    def slopes(self, p: np.ndarray, experiment: int) -> np.ndarray:
        """d p / d z of the free constants (nf,) at the parameters ``p`` of an experiment; zero for what belongs to another one."""
        # dp/dz = base e^z = p, or scale.
        return np.where(self.is_foreign(experiment), 0.0, np.where(self.logarithmic, p[self.which], self.scale))

    @property
    def spans(self) -> np.ndarray:
        """Change of each free constant (nf,) with its ``z`` at ``z = 0``."""
        return np.where(self.logarithmic, self.base, self.scale)

    @property
    def units(self) -> np.ndarray:
        """Physical size of a step of one in each entry of ``z`` (size,); of a logarithmic one, in its logarithm."""
        states = np.tile(self.initial.scale[self.free_states], self.experiments)
        return np.concatenate([np.where(self.logarithmic, 1.0, self.scale), states, np.ones(len(self.estimated_noise))])

    def is_foreign(self, experiment: int) -> np.ndarray:
        """Which free constants (nf,) are another experiment's own."""
        return (self.owner != SHARED) & (self.owner != self.groups[experiment])

    def penalty(self, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """What the priors add to the cost at ``z``, its slope (nf,) and its curvature (nf,): one more squared residual each."""
        free = self.constants(z)
        # ((p - mean) / std)^2 with its slope along z; of the curvature the Gauss-Newton part.
        deviation = (free - self.prior[:, 0]) / self.prior[:, 1]
        slope = np.where(self.logarithmic, free, self.scale) / self.prior[:, 1]
        return float(deviation @ deviation), 2 * deviation * slope, 2 * slope**2

    @cached_property
    def has_prior(self) -> np.ndarray:
        """Which free constants (nf,) have a prior."""
        return np.isfinite(self.prior[:, 1])

    def columns(self, experiment: int) -> np.ndarray:
        """Which entries of ``z`` concern one experiment (other experiments' own constants among them, without any influence)."""
        parts = self.split(np.arange(self.size))
        return np.concatenate([parts.parameters, parts.initial_states[experiment], parts.noise_levels])

    def compute_initial_state(self, z: np.ndarray, p: np.ndarray, experiment: int) -> tuple[np.ndarray, np.ndarray]:
        """Initial state (nx,) of one experiment and its slopes (nx, L) along `columns`."""
        # The declared start and its slope along the free constants, unless that is constant.
        x0, slope = self.model.system.constant_start, None
        if self.initial.settled is not None:
            x0, slope = self.initial.settled.at(p, self.groups[experiment], self.which)
        elif x0 is None:
            x0, slope = (np.asarray(value) for value in self.model.system.start_function(p))
            slope = slope[:, self.which]
        x0 = np.array(x0).ravel()
        n, free = len(self.which), self.free_states
        dx0 = np.zeros((len(x0), n + len(free) + len(self.estimated_noise)))
        if slope is not None:
            dx0[:, :n] = slope * self.slopes(p, experiment)
        # An estimated state is guess + scale z; the declared one and its slope give way.
        scaled_states = self.split(z).initial_states[experiment]
        x0[free] = self.initial.guess[experiment, free] + self.initial.scale[free] * scaled_states
        dx0[free, :n] = 0.0
        dx0[free, n + np.arange(len(free))] = self.initial.scale[free]
        return x0, dx0

    def noise_levels(self, z: np.ndarray) -> np.ndarray:
        """Standard deviation of each output's noise (ny,) at ``z``, where it is among the unknowns."""
        assert self.noise is not None  # only a likelihood asks for it
        level = self.noise.level.copy()
        # sigma = level e^z: a level cannot change its sign.
        level[self.estimated_noise] *= np.exp(self.split(z).noise_levels)
        return level

    def place_initial_states(self, z: np.ndarray, states: np.ndarray) -> np.ndarray:
        """``z`` (size,) with other initial states (experiments, nx), of which the free ones count."""
        z, free = z.copy(), self.free_states
        self.split(z).initial_states[:] = (states - self.initial.guess)[:, free] / self.initial.scale[free]
        return z

    def rescale(self, cost: float, curvature: np.ndarray) -> DecisionVector:
        """Linear scales chosen so that a step of one in ``z`` changes the cost by about itself.

        ``curvature`` (size,) is the diagonal of the Gauss-Newton matrix at ``z = 0``. Entries without influence keep their scale, and so
        do those whose influence is lost in rounding: along these each scale would be larger than the last, without end.
        """
        seen = curvature > np.finfo(float).eps ** 2 * curvature.max(initial=0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            # cost = c z^2 for a step of sqrt(cost / c) in the old z: that is one in the new.
            factor = np.sqrt(cost / curvature)
        factor = np.where(seen & np.isfinite(factor) & (factor > 0), factor, 1.0)
        parts = self.split(factor)
        scale = np.where(self.logarithmic, self.scale, self.scale * parts.parameters)
        states = self.initial.scale.copy()
        # One scale for a state in all experiments: the geometric mean of theirs.
        states[self.free_states] *= np.exp(np.log(parts.initial_states).mean(axis=0))
        return replace(self, scale=scale, initial=replace(self.initial, scale=states))

    def with_logarithms(self) -> DecisionVector:
        """The same variables with the logarithm of every constant that lies above zero and may become as small and as large as it likes.

        A step of any length leaves it positive; zero itself is reached in the limit.
        """
        open_above_zero = (self.low == 0) & (self.base > 0) & np.isposinf(self.high)
        return replace(self, logarithmic=self.logarithmic | open_above_zero)

    def with_scales_of(self, other: DecisionVector) -> DecisionVector:
        """The same variables with the logarithms of ``other`` alone; the step of one of any other constant is its size."""
        is_turned = self.logarithmic & ~other.logarithmic & (self.base > 0)
        return replace(self, logarithmic=other.logarithmic, scale=np.where(is_turned, self.base, self.scale))

    def recentre(self, z: np.ndarray) -> DecisionVector:
        """The same variables with ``z = 0`` at the given point."""
        p = self.parameters(z)
        guess = np.array([self.compute_initial_state(z, self.parameters(z, e), e)[0] for e in range(self.experiments)])
        noise = self.noise and replace(self.noise, level=self.noise_levels(z))
        return replace(self, base=self.constants(z), fixed=p, initial=replace(self.initial, guess=guess), noise=noise)

    def with_values(self, values: Mapping[str, float]) -> DecisionVector:
        """The same variables with other values of some constants at ``z = 0``, by their labels in ``names``."""
        base = np.array([values.get(name, value) for name, value in zip(self.names, self.base, strict=True)])
        changed = replace(self, base=base)
        return replace(changed, fixed=changed.parameters(changed.here))

    def start_at(self, values: Mapping[str, float]) -> DecisionVector:
        """The same variables with other values of some parameters of the model at ``z = 0``, free or not; a step of one is their size."""
        fixed, names = self.fixed.copy(), self.model.system.parameter_names
        for name, value in values.items():
            fixed[names.index(name)] = value
        base = fixed[self.which]
        scale = np.where(base == 0, self.scale, np.abs(base))
        return replace(self, fixed=fixed, base=base, scale=scale)

    def hold(self, held: np.ndarray) -> DecisionVector:
        """The same variables with some constants (nf,) no longer free: they are as in ``fixed``, or as the conditions have them."""
        keep = ~held
        names = tuple(np.array(self.names, object)[keep])
        arrays = ("which", "owner", "logarithmic", "base", "scale", "low", "high", "prior")
        return replace(self, names=names, **{name: getattr(self, name)[keep] for name in arrays})

    @property
    def active(self) -> np.ndarray:
        """Which free constants lie on a bound at ``z = 0`` (nf,)."""
        # In units in which the records tell them apart, not in shares of a range that may be decades wider than what they tell.
        low, high = (edges[: len(self.which)] for edges in self.bounds())
        return (low >= -AT_BOUND) | (high <= AT_BOUND)


class ExperimentView:
    """The entries of ``z`` of one experiment: constants (the shared ones and its own), then its free initial states.

    ``columns`` (L,): where they stand in ``z``; ``square``: the same as an index of a matrix. What does not change from point to
    point is laid out once, because a pass over a short record takes less time than laying it out.
    """

    def __init__(self, variables: DecisionVector, experiment: int) -> None:
        v, n = variables, len(variables.which)
        self.variables, self.experiment = v, experiment
        self.constants = np.flatnonzero(~v.is_foreign(experiment))
        self.which, self.logarithmic, self.scale = (
            v.which[self.constants],
            v.logarithmic[self.constants],
            v.scale[self.constants],
        )
        self.states = v.free_states
        self.state_columns = v.split(np.arange(v.size)).initial_states[experiment]
        self.columns = np.concatenate([self.constants, self.state_columns])
        self.square = np.ix_(self.columns, self.columns)
        self.used_directions = np.concatenate([self.constants, n + np.arange(len(self.states))])
        self.fixed = apply_conditions(v.fixed, v.conditions[experiment]) if v.conditions else v.fixed
        self.constant_places = self.which, np.arange(len(self.constants))
        self.empty_slopes = np.zeros((len(self.fixed), len(self.columns)))
        start = None if v.initial.settled else v.model.system.constant_start
        self.start: np.ndarray | None = None
        if start is not None:
            guess, scale = v.initial.guess[experiment, self.states], v.initial.scale[self.states]
            start_values = start.copy()
            start_values[self.states] = guess
            self.start, self.state_scale = start_values, scale
            self.start_slope = np.zeros((len(start), len(self.columns)))
            self.start_slope[self.states, len(self.constants) + np.arange(len(self.states))] = scale

    def spread(self, slopes: np.ndarray) -> np.ndarray:
        """Slopes (..., L) along all of `DecisionVector.columns`: those along the own constants of other experiments are zero."""
        n = len(self.variables.which)
        if len(self.constants) == n:
            return slopes
        result = np.zeros((*slopes.shape[:-1], n + len(self.states)))
        result[..., self.used_directions] = slopes
        return result

    def at(self, z: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Parameters (np,), their slopes (np, L), first state (nx,), its slopes (nx, L).

        ``free`` are `DecisionVector.constants` at ``z``, which all experiments share.
        """
        p, dp = self.fixed.copy(), self.empty_slopes.copy()
        p[self.which] = free[self.constants]
        # dp/dz, in the columns of this experiment alone.
        dp[self.constant_places] = np.where(self.logarithmic, p[self.which], self.scale)
        if self.start is None:
            x0, dx0 = self.variables.compute_initial_state(z, p, self.experiment)
            return p, dp, x0, dx0[:, self.used_directions]
        x0 = self.start.copy()
        x0[self.states] += self.state_scale * z[self.state_columns]
        return p, dp, x0, self.start_slope


def average_own_values(values: np.ndarray, positive: bool) -> float:
    """The mean of the own values of a constant, the geometric one where it is positive."""
    return float(np.exp(np.mean(np.log(values)))) if positive else float(np.mean(values))


def make_unique(names: Sequence[str]) -> list[str]:
    """Names with a number where one comes again: ``record``, ``record 2``."""
    result: list[str] = []
    for name in names:
        count = sum(other == name for other in names[: len(result)])
        result.append(f"{name} {count + 1}" if count else name)
    return result


def find_measured_states(variables: DecisionVector) -> dict[int, int]:
    """States that are themselves an output: position of the state -> position of the output."""
    system = variables.model.system
    outputs = [system.outputs[j] for j in range(system.outputs.numel())]
    columns = {y.name(): j for j, y in enumerate(outputs) if y.is_symbolic()}
    return {k: columns[name] for k, name in enumerate(system.state_names) if name in columns}
