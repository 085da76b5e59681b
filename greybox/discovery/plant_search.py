"""A search at a plant that is run from outside: effects at its inputs and outputs, found on a model about its run, fitted with itself.

The plant is fitted and run; about that run a model stands for it (`greybox.simulation.local_model`), exact there and of first order
around it, which is searched as any other. What is found is fitted with the plant, so that its constants and errors are those of the plant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from greybox.base import DataError, Finding, ModelError, Severity
from greybox.data.experiment import Experiment, stack_signals
from greybox.discovery.decision import Verdict
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import ValidationSet, compare_holdout_errors
from greybox.discovery.result import Discovery, quote_test_error
from greybox.estimation import Fit, FitOptions, Trace
from greybox.estimation.fit import fit
from greybox.model import Effect, Model
from greybox.model.effects.catalogue import applicable_effects
from greybox.model.parts import read_parts
from greybox.simulation.local_model import build_local_model, extend_record
from greybox.simulation.plant import LinearResponse, PlantModel, find_straight
from greybox.simulation.plant_kernel import PlantKernel


@dataclass(frozen=True, eq=False)
class PlantView:
    """A fitted plant as a search sees it.

    Parameters
    ----------
    model
        What stands for it, with the effects that are its user's.
    response
        The linear answer to its inputs in that; None where effects at inputs cannot be seen through one.
    estimation, validation, test
        The records with what the model takes from runs of the plant.
    runs
        Runs of one record that this took.
    """

    model: Model
    response: LinearResponse | None
    estimation: tuple[Experiment, ...]
    validation: tuple[Experiment, ...]
    test: tuple[Experiment, ...]
    runs: int

    @property
    def seen(self) -> frozenset[str]:
        """Inputs and outputs of the plant at which effects can be seen."""
        inputs = {i.name for i in self.model.inputs} - self.model.auxiliary if self.response is not None else set()
        return frozenset(inputs | {o.name for o in self.model.outputs})


def view_plant(result: Fit, effects: Sequence[str] | None = None, test: Sequence[Trace] = ()) -> PlantView:
    """A fitted plant with its records as a search sees it; of effects that it has, the run is one with them.

    Parameters
    ----------
    result
        A fit of a plant without equations.
    effects
        Those of its effects that the model has, too; None for all.
    test
        Runs over records that take no part in a search.

    Raises
    ------
    PlantRunError
        Where the plant does not run over a record.
    """
    from greybox.comparison.input_response import estimate_linear_response

    model = result.model
    assert isinstance(model, PlantModel)
    bare = replace(model, effects=())
    assert isinstance(bare, PlantModel)
    kernel, behind = PlantKernel(bare), PlantKernel(model)
    traces, others = result.traces, result.validation.traces
    longest = behind.drive_experiment(max(traces, key=lambda t: len(t.time)).experiment)
    local = build_local_model(bare, estimate_linear_response(kernel, longest))

    def extend(trace: Trace) -> Experiment:
        """The record with the run of the plant over the inputs as they reached it."""
        driven, known = behind.drive_experiment(trace.experiment), None
        # Between the rows of the record there may be finer ones.
        rows = slice(None, None, (driven.rows - 1) // (len(trace.time) - 1))
        run = {name: y[rows] for name, y in kernel.run_experiment(driven, trace.initial_state).items()}
        slopes = kernel.differentiate_experiment(driven, trace.initial_state)[rows]
        if local.response is not None:
            applied = stack_signals([driven.inputs[i.name] for i in bare.inputs], driven.rows)
            known = local.response.run(driven.time, applied, find_straight(driven, bare.inputs))[rows]
        return extend_record(trace.experiment, local, run, slopes, known)

    about = local.model
    for effect in model.effects:
        about = about + effect if effects is None or effect.name in effects else about
    about = about.start(**_translate(model, about)).with_parts(has=model.has, lacks=model.lacks)
    estimation, validation, tests = (tuple(map(extend, group)) for group in (traces, others, test))
    return PlantView(about, local.response, estimation, validation, tests, kernel.runs)


def _translate(model: Model, other: Model) -> dict[str, float]:
    """The constants that two models share, as they are in ``model``, by their names in ``other``: effects may name theirs otherwise."""
    shared = {q.name: model.values[q.name] for q in other.parameters if q.name in model.values and not q.fixed}
    for name in other.effect_names:
        if name in model.effect_names:
            names, others = model.names_of(name), other.names_of(name)
            shared |= {others[n]: model.values[names[n]] for n in names if names[n] in model.values}
    return {name: value for name, value in shared.items() if name in other.values}


def fit_with_plant(
    base: Fit, about: Model, estimation: Experiment | Sequence[Experiment], options: FitOptions, **fitting: Any
) -> Fit | None:
    """The plant of a fit with the effects of a model that stood for it, from their constants there on; None where it does not run so.

    Parameters
    ----------
    base
        The fit of the plant without them; it is what comes back where there are none.
    about
        The model about its run, fitted.
    estimation, options, fitting
        As of `greybox.fit`.
    """
    extended = base.model
    for effect in about.effects:
        extended = extended if effect.name in base.model.effect_names else extended + effect
    if extended is base.model:
        return base
    start = {n: v for n, v in _translate(about, extended).items() if not extended.parameter(n).fixed}
    # It begins near: no part of the records comes before the whole.
    result = fit(extended.start(**start), estimation, options=replace(options, progressive=False), **fitting)
    return result if result.traces and np.isfinite(result.solver.cost) else None


# Relative difference of two errors below which the plant errs as its local model does.
AGREEMENT = 0.01


def search_plant(
    model: PlantModel,
    estimation: Experiment | Sequence[Experiment],
    search: Callable[..., Discovery],
    *,
    effects: Sequence[Effect] | None,
    options: FitOptions,
    test: ValidationSet,
    fitting: Mapping[str, Any],
) -> Discovery:
    """Find which effect a plant lacks at its inputs and outputs.

    Parameters
    ----------
    model
        The plant.
    estimation
        Records to fit to.
    search
        ``search(model, estimation, **options)``: `greybox.discover` of a model with equations.
    effects
        The only candidates, instead of the catalogue.
    options
        Of every fit.
    test
        Records that take no part in the search.
    fitting
        Further arguments of `greybox.fit`: the validation records, the noise.

    Returns
    -------
    Discovery
        The answer, its fits those of the plant.

    Raises
    ------
    DataError
        Where the plant does not run over the records.
    """
    if model.equations is not None:
        raise ModelError(f"{model.title} rests on equations: search its model with records over time")
    base = fit(model, estimation, options=options, **fitting)
    if not base.traces or not np.isfinite(base.solver.cost):
        raise DataError(f"{model.title} does not run over these records: {base.solver.status_message}")

    def look(view: PlantView) -> tuple[Discovery, Fit]:
        """The answer about a run, and the plant with the effects of that; in its place the model about the run where it does not run."""
        parts = read_parts(model)
        possible = [e for e in applicable_effects(model) if not parts.missing(e)]
        listed = [e for e in possible if (model + e).bound_effects[-1].site in view.seen]
        answer = search(
            view.model,
            view.estimation,
            validation=view.validation,
            test=view.test,
            effects=listed if effects is None else effects,
            options=replace(options, at_rest=True),
        )
        return answer, fit_with_plant(base, answer.best.model, estimation, options, **fitting) or answer.best

    def run_test(result: Fit) -> Fit:
        """A fit with its runs over the test records in the place of those over the validation records."""
        return replace(result, validation=test.run(result.model, result.noise.std, options)) if test else result

    tested = run_test(base)
    view = view_plant(base, test=tested.validation.traces if test else ())
    answer, best = look(view)
    runs = _count(base) + view.runs + (_count(best) if best is not base else 0)
    is_run = best is not base and best is not answer.best
    if is_run and answer.verdict is not Verdict.NAMED and not _agrees(answer.best, best):
        # About the constants of the plant alone the local model was not exact enough to tell what is left.
        view = view_plant(best, base.model.effect_names, run_test(best).validation.traces if test else ())
        again, better = look(view)
        runs += view.runs + (_count(better) if better is not base else 0)
        if better is not base and better is not again.best:
            answer, best = again, better
    # The error on the test records is that of the plant.
    kept = [f for f in answer.findings if f.code != DiscoveryCode.TEST_ERROR]
    findings = [*kept, *_remarks(model, view, answer, best, runs)]
    holdout = compare_holdout_errors(base, best)
    answer = replace(answer, base=base, best=best, holdout=holdout, findings=tuple(findings))
    if not test or not isinstance(best.model, PlantModel):
        return answer
    return quote_test_error(answer, tested, tested if best is base else run_test(best))


def _agrees(local: Fit, plant: Fit) -> bool:
    """Whether the plant errs as the local model says."""
    return all(
        abs(m.rmse - local.misfit[name].rmse) <= AGREEMENT * local.misfit[name].rmse
        for name, m in plant.misfit.items()
        if name in local.misfit
    )


def _count(result: Fit) -> int:
    return int(result.solver.statistics.get("runs", 0))


def _remarks(model: PlantModel, view: PlantView, answer: Discovery, best: Fit, runs: int) -> list[Finding]:
    """How the effects were seen, whether the plant errs as was expected, and what it took."""
    findings = []
    if model.inputs and view.response is None:
        findings.append(Finding(DiscoveryCode.NO_INPUT_RESPONSE, Severity.WARNING, model.title))
    elif view.response is not None:
        values = {"share": min(view.response.explained.values())}
        findings.append(Finding(DiscoveryCode.SEEN_THROUGH_RESPONSE, subject=model.title, values=values))
    if best is answer.best:
        effects = " + ".join(e for e in best.model.effect_names if e not in model.effect_names)
        findings.append(Finding(DiscoveryCode.PLANT_FAILS, Severity.WARNING, model.title, {"effects": effects}))
    elif answer.best.model.effects and not _agrees(answer.best, best):
        errors = {n: m.rmse / answer.best.misfit[n].rmse for n, m in best.misfit.items() if n in answer.best.misfit}
        findings.append(Finding(DiscoveryCode.PLANT_DISAGREES, Severity.WARNING, best.model.title, {"ratios": errors}))
    return [*findings, Finding(DiscoveryCode.PLANT_RUNS, subject=model.title, values={"runs": runs})]
