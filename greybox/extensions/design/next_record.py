"""`design`: what is known of a plant and what its rig allows in, the next record out."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from greybox.base import TINY, DataError, Finding, FitError, ModelError, Severity, nearest
from greybox.data.experiment import Experiment
from greybox.data.input_course import Hold
from greybox.data.noise.noise_model import DETECTION_RATIO, NEW_SENSOR_NOISE, BoundDirection
from greybox.data.signals import SignalLimit
from greybox.discovery.candidates import estimate_scales, generate_starting_points
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.result import Discovery
from greybox.estimation import Fit, FitOptions
from greybox.estimation.fit import fit
from greybox.estimation.identifiability.structural import analyse_structural_identifiability
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.extensions.design import goals
from greybox.extensions.design.inputs import MARGIN_RESERVE, LimitKeeper, fit_into_limits, largest_usage, play
from greybox.extensions.design.plant import ASSUMED_SPREAD, GOAL_PRIOR_SPREAD, PlantScenario, list_plants
from greybox.extensions.design.problem import (
    DESIGN_MOST_ROWS,
    DESIGN_POLICY,
    Alternative,
    AlternativeKind,
    CriterionName,
    Design,
    DesignCode,
    DesignPolicy,
    DesignProblem,
    GoalName,
    PredictedConstant,
    PredictedDetection,
    range_of_inputs,
)
from greybox.extensions.design.search import TriedInput, evaluate, find_bands, flat_multisine, kinds_of, search_inputs
from greybox.model import Model
from greybox.model.effects.catalogue import effect
from greybox.model.effects.scales import AMPLITUDE_GRID, tailor_to_record
from greybox.simulation.plant import as_model, is_plant

# What a design begins with: a model, a fit or a discovery, and rivals fitted to the same records.

Source = Model | Fit | Discovery


def list_explanations(
    source: Source, rivals: Sequence[str | Model], plain: Fit | None
) -> tuple[tuple[Model, ...], Fit | None]:
    """The explanations that a source and named rivals give, the best one first, and its fit, where there are records.

    ``source``, ``rivals`` and ``plain`` are those of `design`.

    Raises
    ------
    ModelError, DataError
        For a rival that cannot be made or fitted.
    """
    source = as_model(source) if is_plant(source) else source
    given = [r for r in rivals if isinstance(r, Model)]
    named = [r for r in rivals if isinstance(r, str)]
    if isinstance(source, Model):
        source.require_equations("a design")
        if named:
            raise DataError(
                f"rival {named[0]!r}: a rival is fitted to records first, and there are none; give records or a fit"
            )
        return (source, *given), None
    if isinstance(source, Discovery):
        best, base = source.best, source.base
        named = ["+".join(effects) for effects in source.alternatives] + named
    elif isinstance(source, Fit):
        best, base = source, plain or source
    else:
        raise ModelError(f"design: {type(source).__name__} is no model, fit or discovery; give one of them")
    best.model.require_equations("a design")
    if not best.success:
        raise FitError(
            f"the fit of {best.model.title} did not end at an optimum; repeat it before a record is designed"
        )
    # To the same records: a rival that explains them worse from a bad start would look easy to tell apart.
    fitted = [fit_rival(base, name) for name in dict.fromkeys(named)]
    # Each set of effects once, the first of it.
    distinct: dict[str, Model] = {}
    for model in (best.model, *given, *fitted):
        distinct.setdefault(model.title, model)
    return tuple(distinct.values()), best


def fit_rival(plain: Fit, text: str) -> Model:
    """The plain model with effects, ``a+b``, fitted to the records of its fit.

    Raises
    ------
    ModelError
        For an effect that has no place in it, or that cannot be fitted.
    """
    names = [part.strip() for part in text.split("+") if part.strip() not in ("", "none")]
    problem = DiscoveryProblem.from_fit(plain)
    candidate = problem.to_candidate(plain)
    scales = estimate_scales(candidate)
    for name in names:
        entry = tailor_to_record(effect(name), scales)
        extended = candidate.model + entry
        starts = [
            extended.values,
            *generate_starting_points(extended, entry, candidate, plain.model, scales, AMPLITUDE_GRID),
        ]
        refitted = problem.refit_best(extended, starts, like=candidate)
        if refitted is None:
            raise ModelError(f"rival {text!r}: {extended.title} cannot be fitted to the records; leave it out")
        candidate = refitted
    return candidate.model


def expect_noise(known: Fit) -> dict[str, float]:
    """Standard deviations of the noise that the next record will have, by output.

    A ceiling that the records of a fit have is no level: the noise is part of the error, which often lies far below it.
    """
    levels = {name: float(std) for name, std in known.noise.std.items()}
    errors = {name: m.rmse for name, m in known.misfit.items() if m.direction is BoundDirection.AT_MOST}
    return levels | {name: min(levels[name], rmse) for name, rmse in errors.items() if name in levels and rmse > 0}


def fit_explanation(plain: Fit, text: str) -> Fit:
    """The plain model with effects, ``a+b``, as a fit to the records of its fit. Raises ModelError as `fit_rival` does."""
    model = fit_rival(plain, text)
    options = FitOptions.from_data(plain.provenance.options)
    records = [t.experiment for t in plain.traces]
    return fit(model, records, noise=dict(plain.noise.std), options=replace(options, progressive=False))


def design(
    source: Source,
    *,
    limits: Mapping[str, SignalLimit | tuple[float, float]] | None = None,
    duration: float | None = None,
    sampling_time: float | None = None,
    goal: str = "precision",
    criterion: str = "D",
    constants: Sequence[str] = (),
    rivals: Sequence[str | Model] = (),
    plain: Fit | None = None,
    effects: Sequence[str] = (),
    noise: Mapping[str, float] | None = None,
    sensors: Mapping[str, float] | None = None,
    hold: Hold = "zero",
    options: FitOptions | None = None,
    policy: DesignPolicy = DESIGN_POLICY,
) -> Design:
    """Design the next record: an input within the limits of the rig that brings most for a goal.

    Every kind of input is tried at the largest amplitude that keeps all limits, under every explanation and for constants drawn from
    what is known of them; the best ones are then improved sample by sample. The information of the records that were taken counts.

    Parameters
    ----------
    source
        A model (nothing was measured yet), a `Fit`, or a `Discovery`, whose alternatives are rivals.
    limits
        Signal (input, output or state) -> ``(low, high)`` or `SignalLimit` with a rate, in the model's units. An input without one
        gets the range that it had in the records.
    duration, sampling_time
        Of the record in seconds; those of the longest earlier record where left out.
    goal
        ``precision``: narrow intervals. ``discrimination``: rivals apart. ``detection``: small amounts of effects that may hide.
    criterion
        For precision: ``D`` (volume of the confidence region), ``A`` (mean variance), ``E`` (worst combination).
    constants
        For precision: those that count; all free ones where empty.
    rivals
        For discrimination: effects of the plain model joined by ``+`` (``none``: the plain model), or models.
    plain
        The fit of the plain model that ``rivals`` extend, where ``source`` is the fit of another one.
    effects
        For detection: effects that may hide; all that have a place where empty.
    noise
        Standard deviation of each sensor, by output; those of the fit where left out.
    sensors
        Standard deviation of sensors that could be added, by output of the model.
    hold
        What the generator does between samples: ``zero`` holds, ``first`` and ``band-limited`` cannot jump.
    options
        How records are fitted; ``at_rest`` matters.
    policy
        The decision numbers.

    Returns
    -------
    Design
        The input as an experiment, and what it should bring.

    Raises
    ------
    DataError, ModelError
        For limits that cannot be met, a goal that nothing can reach, and a question that lacks something.

    Examples
    --------
    >>> plan = design(fit, limits={"u": (-3, 3), "x": (-1e-4, 1e-4)}, duration=1.0)  # doctest: +SKIP
    >>> plan.predicted["K"].std_after  # doctest: +SKIP
    0.8
    """
    began = time.perf_counter()
    models, best = list_explanations(source, rivals, plain)
    for name, choices in ((goal, GoalName), (criterion, CriterionName)):
        if name not in list(choices):
            raise ModelError(f"design: {name!r} is unknown; {nearest(name, list(map(str, choices)))}")
    earlier: tuple[Experiment, ...] = ()
    known_noise: dict[str, float] = {}
    stds: dict[str, float] = {}
    findings: list[Finding] = []
    if best is not None:
        earlier = tuple(t.experiment for t in best.traces)
        options = options or FitOptions.from_data(best.provenance.options)
        known_noise = expect_noise(best)
        stds = {name: float(e.std) for name, e in best.parameters.items() if e.std is not None and not e.fixed}
        # A model that does not follow the records does not foresee where the rig goes: limits that it keeps are none of the rig.
        faults = [{"fault": str(f)} for f in best.findings if f.severity is Severity.ERROR]
        findings += [Finding(DesignCode.MODEL_FALLS_SHORT, Severity.WARNING, values=fault) for fault in faults]
    merged = {n: v if isinstance(v, SignalLimit) else SignalLimit(*v) for n, v in (limits or {}).items()}
    for name, seen in range_of_inputs(models[0], earlier).items():
        limit = merged.get(name, SignalLimit())
        if not np.isfinite([limit.low, limit.high]).all():
            # A rate that was given stays; the range comes from the records.
            merged[name] = replace(seen, rate=limit.rate)
            values = {"low": seen.low, "high": seen.high}
            findings.append(Finding(DesignCode.RANGE_FROM_RECORDS, subject=name, values=values))
    longest = max(earlier, key=lambda e: e.duration, default=None)
    question = DesignProblem(
        models,
        merged,
        # Its last interval included; zero where there is no record: the question says what is missing.
        duration or (longest.rows * float(np.median(longest.intervals)) if longest else 0.0),
        sampling_time or (longest.sampling_time if longest else None) or 0.0,
        {**known_noise, **(noise or {})},
        earlier,
        GoalName(goal),
        CriterionName(criterion),
        tuple(constants),
        tuple(effects),
        dict(sensors or {}),
        stds,
        hold=hold,
        options=options or FitOptions(),
        policy=policy,
    )
    return replace(answer(question, extra=findings), seconds=time.perf_counter() - began)


def answer(question: DesignProblem, *, extra: Sequence[Finding] = ()) -> Design:
    """The design that answers a question.

    Parameters
    ----------
    question
        Models, limits, earlier records, goal.
    extra
        Findings to put first.

    Returns
    -------
    Design
        As `design` gives it.

    Raises
    ------
    DataError, ModelError
        As `design` does.
    """
    began = time.perf_counter()
    plants, draws = list_plants(question)
    keeper = LimitKeeper(question, plants, draws)
    hidden: list[goals.HiddenEffect] = []
    if question.goal is GoalName.DETECTION:
        _, bands = find_bands(question)
        shape = {name: flat_multisine(bands[-1], question.policy) for name in question.driven}
        # Effects are made ready by the size of things in a run that the limits allow.
        _, inputs, _ = fit_into_limits(keeper, shape)
        hidden = goals.list_hidden_effects(question, plants[0], inputs)

    def make_goal(count: int, step: float | None) -> goals.Goal:
        if question.goal is GoalName.PRECISION:
            return goals.make_precision(question, count, step)
        if question.goal is GoalName.DISCRIMINATION:
            return goals.make_discrimination(question, count, step)
        return goals.make_detection(question, hidden, count, step)

    tried = search_inputs(question, keeper, make_goal)
    best = tried[0]
    if not np.isfinite(best.value):
        raise DataError(
            f"{question.model.title}: under every input that keeps the limits the model overflows or brings nothing for"
            f" {question.goal}; give other limits or another goal"
        )
    final = make_goal(question.policy.scenarios, None)
    predicted = predict_constants(question, plants[0], best)
    separation: dict[str, float] = {}
    if isinstance(final, goals.Discrimination):
        pairs = goals.closest_pairs(final, final.separations([plant.run(best.inputs) for plant in final.plants]))
        titles = [m.title for m in question.models]
        separation = {f"{titles[a]} | {titles[b]}": float(cost) for (a, b), cost in sorted(pairs.items())}
    detection = _detections(hidden, final, best) if isinstance(final, goals.Detection) else {}
    findings = [*extra, *_findings(question, best, predicted, separation)]
    experiment = Experiment("designed", question.time, best.inputs, {}, question.hold)
    return Design(
        question.goal,
        question.criterion,
        question.models,
        experiment,
        best.kind,
        predicted,
        separation,
        detection,
        best.limits,
        list_alternatives(question, make_goal, final, tried),
        tuple(findings),
        question.policy,
        time.perf_counter() - began,
    )


# Share of that spread from which a predicted standard deviation says that the records do not determine a constant.
UNDETERMINED_SHARE = 0.3


def predict_constants(question: DesignProblem, plant: PlantScenario, best: TriedInput) -> dict[str, PredictedConstant]:
    """Standard deviation of every free constant before and after the record, at the best constants."""
    spread, n = GOAL_PRIOR_SPREAD, plant.count
    goal = goals.Precision([plant], np.arange(n), question.criterion)
    # (M + I / s^2)^-1 with the order of magnitude s that is known anyway
    before = np.linalg.inv(plant.earlier + np.eye(n) / spread**2) if question.earlier else None
    after = goal.covariance(0, plant.run(best.inputs))
    constants = {}
    for k, name in enumerate(plant.variables.names):
        variables: DecisionVector = plant.variables
        # Relative, back into the unit.
        size = abs(float(variables.spans[k]))
        if before is not None:
            # The fit to the earlier records knows more of their residual than the noise of the sensors: its colour, and what the model does
            # not explain. It will be in the next record as well. A residual that is whiter than white by chance narrows nothing.
            size *= max(1.0, question.stds.get(name, 0.0) / (size * float(np.sqrt(before[k, k]))))
        stds = []
        for covariance in (before, after):
            std = np.inf if covariance is None else float(np.sqrt(covariance[k, k]))
            # As wide as what is known without data: the records say nothing.
            stds.append(size * std if std < UNDETERMINED_SHARE * spread else None)
        constants[name] = PredictedConstant(float(variables.base[k]), stds[0], stds[1], variables.quantities[k].unit)
    return constants


def _detections(
    hidden: Sequence[goals.HiddenEffect], goal: goals.Detection, best: TriedInput
) -> dict[str, PredictedDetection]:
    """For each effect the smallest amount that would be seen, before and after the record."""
    result = {}
    first = {plant.number: k for k, plant in reversed(list(enumerate(goal.plants)))}
    for number, each in enumerate(hidden):
        k = first[number]
        plant = goal.plants[k]
        size = DETECTION_RATIO * abs(float(plant.variables.spans[goal.positions[k]]))
        known = plant.earlier.any()
        before = goal.amplitude_std(k, None) if known else np.inf
        after = goal.amplitude_std(k, plant.run(best.inputs))
        # A tenth of what the amplitude's own prior allows: as large an amount is that prior's, not the record's.
        largest = 0.1 * GOAL_PRIOR_SPREAD / np.sqrt(goals.LEAST_PRIOR)
        amounts = [float(size * s) if s < largest else None for s in (before, after)]
        result[each.name] = PredictedDetection(each.amplitude, amounts[0], amounts[1], each.unit)
    return result


# Cost by which the wrong one of two explanations must lose, beyond chance, for the record to decide.
DECIDING_COST = 20.0


def _findings(
    question: DesignProblem,
    best: TriedInput,
    predicted: Mapping[str, PredictedConstant],
    separation: Mapping[str, float],
) -> Iterator[Finding]:
    if not question.earlier:
        yield Finding(DesignCode.NO_EARLIER_RECORD, values={"spread": ASSUMED_SPREAD})
    usage, ruling = largest_usage(best.limits)
    inputs = {i.name for i in question.model.inputs}
    if ruling not in inputs and usage > 1 - 5 * MARGIN_RESERVE:
        yield Finding(DesignCode.LIMIT_RULES, subject=ruling)
    open_constants = [n for n, c in predicted.items() if c.std_after is None]
    if open_constants:
        # What would part constants that stay in combinations: a sensor, or something that is known.
        try:
            structure = analyse_structural_identifiability(
                question.model, list(question.noise), at_rest=question.options.at_rest
            )
            remedies = [str(finding) for finding in structure.recommendations]
        except DataError:  # a model that overflows wherever it is looked at
            remedies = []
        yield Finding(
            DesignCode.CONSTANT_NOT_DETERMINED,
            Severity.WARNING,
            ", ".join(open_constants),
            {"constants": open_constants, "remedies": remedies},
        )
    for pair, cost in separation.items():
        if cost < DECIDING_COST:
            values = {"cost": cost, "limit": DECIDING_COST}
            yield Finding(DesignCode.WOULD_NOT_DECIDE, Severity.WARNING, pair, values)


def list_alternatives(
    question: DesignProblem, make_goal: goals.GoalMaker, goal: goals.Goal, tried: Sequence[TriedInput]
) -> tuple[Alternative, ...]:
    """What else could be done; ``tried`` inputs, of which the first is the design. Those that cannot be run are left out."""
    best, policy = tried[0], question.policy
    # What each brings over the design, as a difference of the goal's logarithms: the best of each other kind of input first.
    gains = [(AlternativeKind.INPUT, t.kind, t.value - best.value) for t in kinds_of(tried) if t.kind != best.kind]
    # The same record again.
    gains.append((AlternativeKind.REPEAT, "2", evaluate(goal, best.inputs, 2.0) - best.value))
    if 2 * question.rows <= DESIGN_MOST_ROWS:
        # A shape that fills any duration: a refined input has its levels for this one only.
        general = next((t for t in tried if t.kind != "piecewise constant"), best)
        longer = replace(question, duration=2 * question.duration)
        value = evaluate(goal, play(longer, general.shapes, general.amplitude))
        gains.append((AlternativeKind.LONGER, f"{longer.duration:g}", value - general.value))
        # The same input with twice the samples, both with as many draws.
        finer = replace(question, sampling_time=question.sampling_time / 2)
        repeated = {name: np.repeat(u, 2)[: finer.rows] for name, u in best.inputs.items()}
        fine, coarse = (make_goal(policy.refined_scenarios, step) for step in (finer.sampling_time, None))
        gain = evaluate(fine, repeated) - evaluate(coarse, best.inputs)
        gains.append((AlternativeKind.SAMPLE_FASTER, f"{finer.sampling_time:g}", gain))
    # A further sensor: those that were named, and one of the usual noise at each output that has none.
    sensors: dict[str, float] = dict(question.sensors)
    outputs, _ = goal.plants[0].simulate(best.inputs)
    for j, output in enumerate(question.model.outputs):
        if output.name not in question.noise and output.name not in sensors:
            sensors[output.name] = NEW_SENSOR_NOISE * max(float(np.abs(outputs[:, j]).max()), TINY)
    for name, std in sensors.items():
        plants = [plant.with_sensors({name: std}) for plant in goal.plants]
        with_sensor = replace(goal, plants=plants)  # type: ignore[type-var]
        gains.append((AlternativeKind.SENSOR, name, evaluate(with_sensor, best.inputs) - best.value))
    alternatives = [Alternative(kind, text, float(np.exp(gain))) for kind, text, gain in gains]
    return tuple(a for a in alternatives if np.isfinite(a.gain))
