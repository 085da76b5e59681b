"""A model measured by its frequency responses, alone or beside records over time: a plant, so that `greybox.fit` fits it.

The model is linearised where the response was measured. Each complex point counts by its error over its standard deviation, its real and
its imaginary part as one reading each of a record over frequency; without a phase the magnitude is the reading, or its logarithm where its
error is a share of it. The search begins on the logarithm of the response, where a resonance in the wrong place still attracts, and ends on
the response itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from greybox.base.errors import DataError, GreyboxError, nearest
from greybox.comparison.frequency.response import FrequencyResponse
from greybox.data.experiment import Experiment, as_records
from greybox.estimation.fit import fit
from greybox.estimation.linear.exported_model import to_plant
from greybox.estimation.linear.linearise import linearise_at
from greybox.estimation.linear.operating_point import ModelFunctions, PointMemory
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State
from greybox.simulation.plant import PlantModel, PlantRunError

OperatingPoints = Mapping[str, float] | Sequence[Mapping[str, float]] | None

# Most evaluations of the search on the logarithm of the response, whose minimum is wide: resonances far from the data attract.
LOG_EVALUATIONS = 100


@dataclass(frozen=True, eq=False)
class ResponsePlant:
    """A model as its frequency responses show it (`greybox.simulation.plant.Plant`).

    A record of it is a response over frequency, by its name (`records`), or one over time, which the model is simulated over. What a point
    of a response without variance is known by is a share of its size: its parts are divided by that, or the logarithm of its magnitude is
    taken, and their noise is estimated.

    Attributes
    ----------
    equations
        The model.
    responses
        What was measured, each of a name of its own.
    points
        Operating point of each.
    over_time
        Whether there are records over time, too: then the initial states of the model are those of the plant.
    options
        How the model is simulated over time.

    Examples
    --------
    >>> plant = ResponsePlant.of(model, points)  # doctest: +SKIP
    >>> greybox.multistart(plant, plant.records)  # doctest: +SKIP
    """

    equations: Model
    responses: tuple[FrequencyResponse, ...]
    points: tuple[Mapping[str, float] | None, ...]
    over_time: bool = False
    options: FitOptions | None = None

    cheap = True

    @classmethod
    def of(
        cls,
        model: Model,
        responses: FrequencyResponse | Sequence[FrequencyResponse],
        at: OperatingPoints = None,
        *,
        over_time: bool = False,
        options: FitOptions | None = None,
    ) -> ResponsePlant:
        """That of a model and its responses; ``at`` as of `fit_frequency_response`.

        Raises DataError for signals that the model does not have, and operating points that are not one for each response.
        """
        group = (responses,) if isinstance(responses, FrequencyResponse) else tuple(responses)
        if not group:
            raise DataError("no frequency response; give at least one")
        points = [at] * len(group) if at is None or isinstance(at, Mapping) else list(at)
        if len(points) != len(group):
            raise DataError(
                f"at: {len(points)} operating points for {len(group)} responses; give one for each, or one for all"
            )
        for kind, known in (("inputs", model.inputs), ("outputs", model.outputs)):
            names = [s.name for s in known]
            for response, name in ((r, n) for r in group for n in getattr(r, kind) if n not in names):
                raise DataError(
                    f"{response.name}: model {model.title!r} has no {kind[:-1]} {name!r}; {nearest(name, names)}"
                )
        given = [r.name for r in group]
        numbered = [
            r if given.count(r.name) == 1 else replace(r, name=f"{r.name} {k + 1}") for k, r in enumerate(group)
        ]
        return cls(model, tuple(numbered), tuple(points), over_time, options)

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone: another process writes out its own functions."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def name(self) -> str:
        """That of the model."""
        return self.equations.name

    @property
    def description(self) -> str:
        """What it is, for people."""
        return "frequency responses of its equations"

    @property
    def identity(self) -> str:
        """The equations, and where they are linearised."""
        return f"{self.equations.system.free_run_expressions} {self.points}"

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Those of the records over time."""
        return tuple(self.equations.inputs) if self.over_time else ()

    @property
    def states(self) -> tuple[State, ...]:
        """Those of the records over time."""
        return self.equations.all_states if self.over_time else ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the model."""
        return self.equations.stated_parameters

    @cached_property
    def outputs(self) -> tuple[Output, ...]:
        """Real and imaginary part, or magnitude, of each channel that was measured, and the outputs of the records over time."""
        signals: list[Input | Output] = [*self.equations.inputs, *self.equations.outputs]
        units, parts = {s.name: s.unit or "1" for s in signals}, dict[str, str]()
        for response in self.responses:
            for (y, u), names in self._channels(response).items():
                unit = "1" if response.variance is None else f"({units[y]})/({units[u]})"
                parts |= dict.fromkeys(names, unit)
        over_time = [Output(o.name, o.unit) for o in self.equations.outputs] if self.over_time else []
        return (*over_time, *(Output(name, unit) for name, unit in parts.items()))

    @cached_property
    def model(self) -> PlantModel:
        """The model that states its signals and constants."""
        return replace(PlantModel.of(self), ties=self.equations.ties)

    @property
    def records(self) -> tuple[Experiment, ...]:
        """The responses as records over frequency in the place of time."""
        return tuple(self._to_record(response) for response in self.responses)

    def _to_record(self, response: FrequencyResponse) -> Experiment:
        outputs, noise = {}, {}
        size = self._size(response)
        # E|error|^2 = variance is shared by both parts: each has half of it. A magnitude alone has all of its own.
        std = None if response.variance is None else np.sqrt(response.variance / (1 + response.with_phase))
        for (y, u), names in self._channels(response).items():
            j, i = response.outputs.index(y), response.inputs.index(u)
            point = response.response[:, j, i] / size[:, j, i]
            for name, part in zip(names, self._parts(response, point), strict=True):
                outputs[name] = part
                if std is not None:
                    known = std[:, j, i]
                    noise[name] = np.where(np.isfinite(part), known, np.nanmax(known))
        inputs = {i.name: np.zeros(len(response.frequency)) for i in self.inputs}
        return Experiment(response.name, response.frequency, inputs, outputs, noise=noise)

    @staticmethod
    def _channels(response: FrequencyResponse) -> dict[tuple[str, str], tuple[str, ...]]:
        """Output and input -> names of what was measured of it (`_parts`); without variance shares of its size, or its logarithm."""
        kind = "" if response.variance is not None else "_share" if response.with_phase else "_log"
        parts = ("real", "imaginary") if response.with_phase else ("magnitude",)
        pairs = product(response.outputs, response.inputs)
        return {(y, u): tuple(f"{y}_per_{u}{kind}_{part}" for part in parts) for y, u in pairs}

    @staticmethod
    def _parts(response: FrequencyResponse, point: np.ndarray) -> tuple[np.ndarray, ...]:
        """What was measured of complex points (N,): real and imaginary part, or the magnitude, without variance its logarithm."""
        if response.with_phase:
            return point.real, point.imag
        # d ln |G| = d|G| / |G|: an error that is a share of the magnitude is one of its logarithm.
        return (np.log(np.abs(point)) if response.variance is None else np.abs(point),)

    @staticmethod
    def _size(response: FrequencyResponse) -> np.ndarray:
        """What the points (nf, ny, nu) are divided by; NaN where one without variance is zero."""
        size = np.abs(response.response)
        if response.variance is not None:
            return np.ones(size.shape)
        return np.where(size > 0, size if response.with_phase else 1.0, np.nan)

    @cached_property
    def _functions(self) -> ModelFunctions:
        return ModelFunctions(self.equations)

    @cached_property
    def _memories(self) -> list[PointMemory]:
        """The operating point of each response; those at the same point share it."""
        known: list[PointMemory] = []
        for at in self.points:
            known.append(next((m for m in known if m.at == at), None) or PointMemory(self._functions, at))
        return known

    def respond(self, response: FrequencyResponse, values: Mapping[str, float]) -> np.ndarray:
        """The model's response (nf, ny, nu) at the points of ``response``. Raises PlantRunError where it has none."""
        memory = self._memories[[r.name for r in self.responses].index(response.name)]
        p = np.array([values[name] for name in self.equations.values])
        try:
            point = memory.find(p)
            linear = linearise_at(to_plant(self.equations), self._functions, p, point, response.sampling_time or None)
            whole = linear.frequency_response(2 * np.pi * response.frequency)
        except (GreyboxError, np.linalg.LinAlgError) as error:
            raise PlantRunError(f"{self.equations.title} has no response there: {error}") from error
        rows, columns = (
            [[s.name for s in known].index(name) for name in names]
            for known, names in ((self.equations.outputs, response.outputs), (self.equations.inputs, response.inputs))
        )
        return whole[:, rows][:, :, columns]

    def simulate(self, record: Experiment, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Parts of the response (N,) at the frequencies of a record, or outputs over time. Raises PlantRunError."""
        nothing = dict.fromkeys((o.name for o in self.outputs), np.zeros(record.rows))
        response = next((r for r in self.responses if r.name == record.name), None)
        if response is None:
            return nothing | self._run_over_time(record, values)
        first, end = np.searchsorted(response.frequency, record.time[[0, -1]])
        size = np.nan_to_num(self._size(response), nan=1.0)
        point = (self.respond(response, values) / size)[first : end + 1]
        parts: dict[str, np.ndarray] = {}
        for (y, u), names in self._channels(response).items():
            each = point[:, response.outputs.index(y), response.inputs.index(u)]
            parts |= dict(zip(names, self._parts(response, each), strict=True))
        return nothing | parts

    @cached_property
    def _problems(self) -> dict[str, EstimationProblem]:
        return {}

    def _run_over_time(self, record: Experiment, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Outputs (N,) of the model itself, which is compiled once for each record."""
        if record.fingerprint not in self._problems:
            frozen = self.equations.fix(*self.equations.values)
            known = dict.fromkeys((o.name for o in frozen.outputs), 1.0)
            self._problems[record.fingerprint] = prepare_problem(frozen, record, known, self.options or FitOptions())
        problem = self._problems[record.fingerprint]
        start = np.array([[values[name] for name in problem.model.system.state_names]])
        variables = problem.variables.start_at({n: values[n] for n in self.equations.values})
        variables = replace(variables, initial=replace(variables.initial, guess=start))
        shooting = problem.shooting(variables)
        y = shooting.records[0].samples(shooting.simulate(variables.here)[0][0])
        return {o.name: y[:, j] for j, o in enumerate(problem.model.outputs)}

    def approach(
        self, records: Sequence[Experiment], values: Mapping[str, float], free: Sequence[str]
    ) -> Mapping[str, float]:
        """The constants at which the logarithm of the responses, magnitude and phase, is met best: its valley is wide."""
        bounds = {q.name: q.bounds for q in self.parameters}
        # A constant that is positive by its bounds is searched for by its logarithm.
        in_decades = [bounds[name][0] > 0 for name in free]

        def to_unknowns(each: Sequence[float]) -> np.ndarray:
            return np.array([np.log(v) if log else v for v, log in zip(each, in_decades, strict=True)])

        def to_values(z: np.ndarray) -> dict[str, float]:
            constants = {n: float(np.exp(v) if log else v) for n, v, log in zip(free, z, in_decades, strict=True)}
            return {n: float(np.clip(v, *bounds[n])) for n, v in constants.items()}

        def residual(z: np.ndarray) -> np.ndarray:
            parts = []
            for response in self.responses:
                fitted = self.respond(response, {**values, **to_values(z)})
                known = np.isfinite(response.response) & (np.abs(response.response) > 0)
                # ln(G / G_m) = ln |G / G_m| + i (phase difference)
                error = np.log(response.response[known] / fitted[known])
                parts += [error.real, error.imag] if response.with_phase else [error.real]
            whole = np.concatenate(parts)
            if not np.isfinite(whole).all():
                raise PlantRunError("the response is zero or not finite")
            return whole

        start = to_unknowns([values[name] for name in free])
        low, high = (to_unknowns([bounds[name][side] for name in free]) for side in (0, 1))
        try:
            end = least_squares(residual, np.clip(start, low, high), bounds=(low, high), max_nfev=LOG_EVALUATIONS)
        except PlantRunError:
            return {}
        return to_values(end.x)


def fit_frequency_response(
    model: Model,
    responses: FrequencyResponse | Sequence[FrequencyResponse],
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    at: OperatingPoints = None,
    noise: Mapping[str, float] | None = None,
    options: FitOptions | None = None,
) -> Fit:
    """Fit a model to frequency responses, and to records over time if there are any.

    It is `greybox.fit` with a `ResponsePlant`: profiles, bootstraps, several starts and priors are as of any fit. `greybox.linearise` and
    exports take its equations.

    Parameters
    ----------
    model
        The model with its start values; its free parameters are fitted.
    responses
        One or several responses; inputs and outputs are found by name.
    experiments
        Records over time that count as well, by their simulation error over its noise.
    at
        Operating point of the responses by name, see `linearise`; one for all, or one for each.
    noise
        Standard deviation of the outputs of the records; None estimates it.
    options
        How the records are simulated.

    Returns
    -------
    Fit
        Parameters with intervals; its records are the responses over frequency, then those over time.

    Raises
    ------
    DataError
        For signals that the model does not have, and where it has no free parameter.

    Examples
    --------
    >>> result = gb.frequency.fit_frequency_response(model, points)  # doctest: +SKIP
    >>> result.parameters["k"].interval  # doctest: +SKIP
    """
    if not model.free_parameters:
        raise DataError(f"{model.title} has no free parameter; free one")
    records = as_records(experiments)
    plant = ResponsePlant.of(model, responses, at, over_time=bool(records), options=options)
    if not records:
        return fit(plant, plant.records, options=options)
    over_time = fit(model, records, noise=noise, options=options)
    begin: list[dict[str, float]] = [{}] * len(plant.responses) + [dict(t.initial_state) for t in over_time.traces]
    start = plant.model.start(**{q.name: over_time.model.values[q.name] for q in model.free_parameters})
    return fit(start, [*plant.records, *records], noise=over_time.noise.std, initial=begin, options=options)
