"""What a person has on the screen: a model with effects and constants, records, the last fit. Frozen: every step makes a new one.

Nothing in it knows of a page or a server.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from greybox.base import DataError, ModelError
from greybox.data.experiment import Experiment, find_usual_interval
from greybox.discovery.candidates import estimate_scales, generate_starting_points
from greybox.discovery.localisation import ResidualLocalisation, localise_residual
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate
from greybox.estimation.errors import compute_record_misfits
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Validation
from greybox.estimation.validate import validate
from greybox.model import Effect, Model, Parameter
from greybox.model.effects.scales import bound_delays

if TYPE_CHECKING:
    from greybox.discovery.result import Discovery

# Limits and sizes of the app in the browser.


# A slider of a positive constant reaches from its value over this to its value times this.
SLIDER_RATIO = 10.0
# A slider of any other constant reaches so many times its size to both sides.
SLIDER_REACH = 3.0


@dataclass(frozen=True)
class ValueRange:
    """Between which values a slider moves; ``logarithmic`` for constants that can only be positive."""

    low: float
    high: float
    logarithmic: bool

    @classmethod
    def around(cls, parameter: Parameter) -> ValueRange:
        """A range about the present value of a parameter, within its bounds."""
        value, (low, high) = parameter.value, parameter.bounds
        # A constant that can only be positive moves by factors.
        if parameter.positive:
            return cls(max(low, value / SLIDER_RATIO), min(high, value * SLIDER_RATIO), True)
        # Around zero the bounds are the only scale.
        if value == 0 and math.isfinite(low) and math.isfinite(high):
            return cls(low, high, False)
        # Zero has no size of its own: one unit to both sides.
        reach = SLIDER_REACH * abs(value) or 1.0
        return cls(max(low, value - reach), min(high, value + reach), False)

    def holds(self, value: float) -> bool:
        """Whether the slider can stand there."""
        return self.low <= value <= self.high


@dataclass(frozen=True, eq=False)
class LoadedRecord:
    """A record and the file it is from; one that ``validates`` is not fitted, but judges."""

    experiment: Experiment
    file: Path
    validates: bool = False


@dataclass(frozen=True, eq=False)
class Session:
    """A model beside its records.

    Parameters
    ----------
    model
        With its effects and the constants as they stand; a constant that is fixed stays in a fit.
    records
        What it is held against.
    noise, quiet, options, skip, beginning
        As `greybox.fit` takes them.
    columns
        Which column is which signal, where a record's headers do not say it; the same for all records.
    split
        Whether records are split where their time has gaps.
    ranges
        Range of each constant's slider.
    fit
        The last fit; ``is_fitted`` tells whether the constants are still its own.
    discovery, searched
        The last discovery, and the model that it began with.
    """

    model: Model
    records: tuple[LoadedRecord, ...] = ()
    noise: Mapping[str, float] = field(default_factory=dict)
    quiet: tuple[Experiment, ...] = ()
    options: FitOptions = field(default_factory=FitOptions)
    skip: int = 0
    beginning: int = 0
    columns: Mapping[str, str] = field(default_factory=dict)
    split: bool = False
    ranges: Mapping[str, ValueRange] = field(default_factory=dict)
    fit: Fit | None = None
    discovery: Discovery | None = None
    searched: Model | None = None

    def __post_init__(self) -> None:
        # A range stays while its value does not leave it: a slider must not jump under the hand.
        kept = {
            q.name: r
            for q in self.model.all_parameters
            if (r := self.ranges.get(q.name)) is not None and r.holds(q.value)
        }
        fresh = {q.name: ValueRange.around(q) for q in self.model.all_parameters if q.name not in kept}
        object.__setattr__(self, "ranges", kept | fresh)

    @property
    def estimation(self) -> tuple[Experiment, ...]:
        """The records that are fitted."""
        return tuple(r.experiment for r in self.records if not r.validates)

    @property
    def validation(self) -> tuple[Experiment, ...]:
        """The records that judge."""
        return tuple(r.experiment for r in self.records if r.validates)

    @property
    def is_fitted(self) -> bool:
        """Whether model and constants are those of the last fit."""
        fit = self.fit
        return fit is not None and fit.model.title == self.model.title and fit.model.values == self.model.values

    @property
    def model_to_fit(self) -> Model:
        """The model, its delays bounded as the records can show them."""
        return bound_delays(self.model, find_usual_interval(self.estimation)) if self.estimation else self.model

    def with_values(self, values: Mapping[str, float]) -> Session:
        """With other values of constants. Raises ModelError for unknown names and values outside their bounds."""
        return replace(self, model=self.model.start(**values))

    def with_fixed(self, name: str, fixed: bool) -> Session:
        """With a constant that a fit leaves as it is, or may change. Raises ModelError for an unknown name."""
        return replace(self, model=self.model.fix(name) if fixed else self.model.free(name))

    def with_effect(self, effect: Effect) -> Session:
        """With one effect more, so large that it is seen where a record says how large that is. Raises ModelError.

        Its other constants are as declared, so that a study with these start values repeats a fit.
        """
        if effect.name in {e.name for e in self.model.effects}:
            raise ModelError(f"effect {effect.name}: the model contains it already; take it out first")
        model = self.model + effect
        candidate = self._to_candidate(self.estimation[0]) if self.estimation else None
        # A run that overflows has no size: the effect starts as the catalogue has it.
        if candidate is None or not _runs_through(candidate):
            return replace(self, model=model)
        # At the amplitude where a discovery begins: large enough to be seen, small beside the motion.
        scales = estimate_scales(candidate)
        point = next(generate_starting_points(model, effect, candidate, self.model, scales, amplitudes=(1.0,)))
        values = {}
        for name, value in point.items():
            if name not in self.model.values:
                # In three digits, as a person would write it, where the bounds allow it.
                (low, high), rounded = model.parameter(name).bounds, float(f"{value:.3g}")
                values[name] = rounded if low <= rounded <= high else value
        return replace(self, model=model.start(**values))

    def without_effect(self, name: str) -> Session:
        """Without one of its effects. Raises ModelError where it has none of this name."""
        return replace(self, model=self.model.without(name))

    def with_part(self, name: str, known: str) -> Session:
        """Of a rig that ``has`` or ``lacks`` a part, or of which nothing is said. Raises ModelError for an unknown part or word."""
        if known not in ("has", "lacks", ""):
            raise ModelError(f"part {name}: {known!r}; say has, lacks or nothing")
        has, lacks = (tuple(n for n in of if n != name) for of in (self.model.has, self.model.lacks))
        model = replace(self.model, has=has, lacks=lacks)
        return replace(self, model=model.with_parts(**{known: (name,)}) if known else model)

    def with_records(self, records: Sequence[LoadedRecord]) -> Session:
        """With further records."""
        return replace(self, records=(*self.records, *records))

    def without_record(self, index: int) -> Session:
        """Without one of the records. Raises DataError where there is none."""
        self.record(index)
        return replace(self, records=(*self.records[:index], *self.records[index + 1 :]))

    def with_role(self, index: int, validates: bool) -> Session:
        """With one of the records fitted, or judging. Raises DataError where there is none."""
        # A record that judges was not fitted: one that moves over is judged, or fitted, from the next fit on.
        changed = replace(self.record(index), validates=validates)
        return replace(self, records=(*self.records[:index], changed, *self.records[index + 1 :]))

    def with_fit(self, fit: Fit) -> Session:
        """With the model and the constants of a fit."""
        return replace(self, model=fit.model, fit=fit, ranges={})

    def with_discovery(self, discovery: Discovery, searched: Model) -> Session:
        """With the model that a discovery goes on with, which began with the model ``searched``."""
        return replace(self.with_fit(discovery.extended), discovery=discovery, searched=searched)

    def record(self, index: int) -> LoadedRecord:
        """One of the records. Raises DataError where there is none."""
        if not 0 <= index < len(self.records):
            raise DataError(f"record {index + 1}: there are {len(self.records)}; load one first")
        return self.records[index]

    def simulate(self, index: int) -> Validation:
        """The free run over one of the records and its misfit: of the last fit where it is that, else as `greybox.validate` makes it."""
        record, fit = self.record(index).experiment, self.fit
        if fit is None:
            return self._run(record)
        if self.is_fitted:
            counted = max(self.skip, self.beginning)
            for trace, skip in [(t, 0) for t in fit.traces] + [(t, counted) for t in fit.validation.traces]:
                if trace.fingerprint == record.fingerprint:
                    return Validation(compute_record_misfits(fit, trace, skip), (trace,))
        return self._run(record).over(fit.noise)

    def localise(self, index: int) -> ResidualLocalisation:
        """Where, when and as a function of what the model falls short on one of the records, at its present constants."""
        candidate = self._to_candidate(self.record(index).experiment)
        if not _runs_through(candidate):
            return ResidualLocalisation.without_sites(candidate)
        return localise_residual(candidate)

    def _run(self, record: Experiment) -> Validation:
        return validate(self.model, record, noise=dict(self.noise), options=self.options)

    def _to_candidate(self, record: Experiment) -> FittedCandidate:
        """The model at its present constants as if they had been fitted to ``record``."""
        run = self._run(record).traces[0]
        problem = DiscoveryProblem(self.model, (record,), self.noise, self.quiet, self.options).prepare(self.model)
        states = self.model.system.state_names
        # The initial state of the free run: what the person sees is what is looked at.
        guess = np.array([[run.initial_state[name] for name in states]])
        variables = replace(problem.variables, initial=replace(problem.variables.initial, guess=guess))
        # Nothing is fitted: the residual and its slopes at the present constants.
        evaluation = problem.shooting(variables).evaluate(variables.here)
        return FittedCandidate(
            self.model, evaluation.cost, evaluation.count, variables.size, problem, variables, evaluation
        )


def _runs_through(candidate: FittedCandidate) -> bool:
    """Whether the run and its derivatives are finite to the end."""
    return bool(math.isfinite(candidate.cost) and candidate.evaluation.is_finite)
