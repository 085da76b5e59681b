"""The contract of a plant: every kind against the same checks. A new kind adds itself to `tests.support.plant_cases`."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime, least_squares

import greybox as gb
from greybox.base.errors import DataError, ModelError
from greybox.base.units import parse_unit
from greybox.data.experiment import Experiment
from greybox.estimation.check import check
from greybox.estimation.optimum import restore_objective
from greybox.estimation.options import FitOptions
from greybox.estimation.profile_pairs import profile_pair
from greybox.estimation.score import score
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.uncertainty import bootstrap, profile
from greybox.show import text
from tests.support.plant_cases import CASES, PlantCase

# Seven kinds meet some forty checks: each check meets two or three of them with each change, and all at night.
pytestmark = pytest.mark.crossed(3)

FITTED: dict[str, tuple[PlantCase, gb.Fit]] = {}


@pytest.fixture(params=list(CASES))
def case(request) -> PlantCase:
    return known(request.param)[0]


@pytest.fixture(params=list(CASES))
def fitted(request) -> tuple[PlantCase, gb.Fit]:
    return known(request.param)


def known(name: str) -> tuple[PlantCase, gb.Fit]:
    if name not in FITTED:
        case = CASES[name]()
        FITTED[name] = case, gb.fit(case.plant, case.records, noise=case.noise)
    return FITTED[name]


def predicts(case: PlantCase) -> bool:
    return "filter" in case.abilities


def free_run(case: PlantCase) -> gb.Model:
    """The model without process noise, whose cost is one of free runs."""
    model = case.model
    return replace(model, states=tuple(replace(s, noise=0.0) for s in model.states)) if predicts(case) else model


def problem_of(case: PlantCase, records=None, **options):
    return prepare_problem(free_run(case), records or case.records, case.noise, FitOptions(**options))


def far_point(problem) -> np.ndarray:
    return problem.variables.here + 0.01 * np.random.default_rng(0).standard_normal(problem.variables.size)


# What it says of itself.


def test_signals_and_constants_have_names_units_bounds_and_starts(case):
    model = case.model
    for item in (*model.inputs, *model.outputs, *model.parameters, *model.states):
        parse_unit(item.unit)
    assert all(q.bounds[0] <= q.value <= q.bounds[1] for q in model.parameters)
    assert set(case.truth) <= {q.name for q in model.free_parameters} and case.model.title in str(model)


def test_it_runs_over_a_record_at_given_values(case):
    run = gb.simulate(free_run(case).start(**case.truth), case.records[0], initial=case.begin)
    for name, y in case.records[0].outputs.items():
        # A free run leaves process noise out.
        assert np.std(y - run.outputs[name]) < case.noise[name] * (50 if predicts(case) else 1.2)


def test_a_missing_input_and_foreign_outputs_are_refused(case):
    record = case.records[0]
    with pytest.raises(DataError, match="none of the outputs"):
        gb.fit(case.plant, Experiment("r", record.time, record.inputs, {"other": record.time}, record.hold))
    if case.model.inputs:
        with pytest.raises(DataError, match="has no input"):
            gb.fit(case.plant, Experiment("r", record.time, {"other": record.time}, record.outputs, record.hold))


def test_what_is_no_plant_is_refused():
    with pytest.raises(ModelError, match="neither a model nor a plant: it has no name, inputs"):
        gb.fit(object(), [])


def test_it_is_sent_to_another_process(case):
    again = pickle.loads(pickle.dumps(case.model))
    assert again.values == case.model.values and copy.deepcopy(case.model).title == case.model.title


# The cost and its slopes.


def test_residuals_are_measured_minus_run_over_the_noise(case):
    problem = problem_of(case)
    (r, _), record = problem.shooting().residuals(problem.variables.here)[0], case.records[0]
    y, _ = problem.shooting().simulate(problem.variables.here)[0]
    for j, o in enumerate(case.model.outputs):
        if o.name in record.outputs:
            np.testing.assert_allclose(
                r[:, j], (record.outputs[o.name] - y[:, j]) / case.noise[o.name], rtol=1e-9, atol=1e-9
            )


def test_gradient_and_slopes_are_those_of_differences(case):
    problem = problem_of(case)
    shooting, z = problem.shooting(), far_point(problem)
    value = shooting.evaluate(z)
    expected = approx_fprime(z, lambda at: shooting.evaluate(at).cost, 1e-6)
    np.testing.assert_allclose(value.gradient, expected, rtol=5e-3, atol=5e-3 * np.abs(expected).max())
    total = np.zeros((len(z), len(z)))
    for e, (r, slopes) in enumerate(shooting.residuals(z)):
        columns = problem.variables.columns(e)
        total[np.ix_(columns, columns)] += 2 * slopes[np.isfinite(r)].T @ slopes[np.isfinite(r)]
    np.testing.assert_allclose(value.hessian, total, rtol=1e-6, atol=1e-6 * np.abs(total).max())


def test_the_cost_of_two_records_is_the_sum(case):
    both, one, other = (problem_of(case, records) for records in (case.records, case.records[:1], case.records[1:]))
    costs = [p.shooting().evaluate(p.variables.here).cost for p in (both, one, other)]
    assert costs[0] == pytest.approx(costs[1] + costs[2], rel=1e-12)


def test_a_gap_counts_nothing(case):
    record = case.records[0]
    with_gap = {n: np.where((record.time > 1) & (record.time < 2), np.nan, y) for n, y in record.outputs.items()}
    problem, whole = problem_of(case, [record.with_outputs(with_gap)]), problem_of(case, [record])
    (r, _), (full, _) = (p.shooting().residuals(p.variables.here)[0] for p in (problem, whole))
    gap = np.isnan(next(iter(with_gap.values())))
    assert np.isnan(r[gap]).all()
    if not case.model.states or case.name == "pendulum":  # a state that is measured is guessed by its first readings
        np.testing.assert_allclose(r[~gap], full[~gap])
    assert gb.fit(case.plant, record.with_outputs(with_gap), noise=case.noise).success


def test_an_output_that_a_record_lacks_counts_nothing(case):
    if len(case.model.outputs) < 2:
        pytest.skip("one output")
    name, *_ = case.records[0].outputs
    record = case.records[0].with_outputs({name: case.records[0].outputs[name]})
    result = gb.fit(case.plant, [record, case.records[1]], noise=case.noise)
    assert result.success and set(result.traces[0].measured) == {name}


def test_noise_told_row_by_row_weighs_the_rows(case):
    if predicts(case):
        pytest.skip("a likelihood has one level for each output")
    louder = {
        n: np.where(np.arange(r.rows) % 2, 1.0, 100.0) * case.noise[n] for r in case.records[:1] for n in r.outputs
    }
    record = replace(case.records[0], noise=louder)
    half = {n: np.where(np.arange(record.rows) % 2, y, np.nan) for n, y in record.outputs.items()}
    weighed, without = (gb.fit(case.plant, r, noise=case.noise) for r in (record, case.records[0].with_outputs(half)))
    for name in case.truth:
        a, b = weighed.parameters[name], without.parameters[name]
        assert abs(a.value - b.value) < 0.1 * b.std


# The fit.


def test_the_constants_are_found(fitted):
    case, result = fitted
    assert result.success, result.solver.status_message
    for name, true in case.truth.items():
        estimate = result.parameters[name]
        assert abs(estimate.value - true) < 4 * estimate.std and estimate.unit == case.model.parameter(name).unit
        assert not estimate.at_bound and estimate.determined


def test_only_noise_is_left(fitted):
    case, result = fitted
    misfit = result.prediction.one_step if predicts(case) else result.misfit
    for name in case.noise:
        # One sample ahead what pushed the state since is left as well.
        assert 0.85 < misfit[name].noise_ratio < (2 if predicts(case) else 1.15)
        assert result.misfit[name].unit == {o.name: o.unit for o in case.model.outputs}[name]


def test_constants_and_intervals_are_those_of_scipy(fitted):
    case, result = fitted
    if predicts(case):
        pytest.skip("no sum of squares")
    problem = problem_of(case)
    shooting, variables = problem.shooting(), problem.variables

    def residual(z):
        return np.concatenate([r[np.isfinite(r)] for r, _ in shooting.residuals(z)])

    at = restore_objective(result).variables
    begun = variables.place_initial_states(variables.here, at.initial.guess)
    begun[: len(at.which)] = np.where(
        variables.logarithmic, np.log(at.base / variables.base), (at.base - variables.base) / variables.scale
    )
    found = least_squares(residual, begun, diff_step=1e-5, xtol=1e-12, ftol=1e-12)
    assert result.solver.cost == pytest.approx(2 * found.cost, rel=1e-6)
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    for k, name in enumerate(variables.names):
        value = variables.constants(found.x)[k]
        std = np.sqrt(covariance[k, k]) * (value if variables.logarithmic[k] else variables.scale[k])
        estimate = result.parameters[name]
        assert abs(estimate.value - value) < 0.05 * std
        assert estimate.std == pytest.approx(std, rel=0.1)


def test_a_start_at_the_optimum_stays(fitted):
    case, result = fitted
    again = gb.fit(result.model, case.records, noise=case.noise)
    for name in case.truth:
        assert abs(again.parameters[name].value - result.parameters[name].value) < 0.01 * result.parameters[name].std


def test_a_fixed_constant_stays_and_the_interval_of_the_rest_shrinks(fitted):
    case, result = fitted
    held, other = list(case.truth)[:2]
    fixed = gb.fit(case.model.fix(**{held: case.truth[held]}), case.records, noise=case.noise)
    assert fixed.parameters[held].value == case.truth[held] and fixed.parameters[held].fixed
    assert fixed.parameters[other].std <= result.parameters[other].std * 1.02


def test_a_bound_stops_a_constant_and_is_said(case):
    name, true = next(iter(case.truth.items()))
    model = case.model.start(**{name: 0.7 * true}).bound(**{name: (0.5 * true, 0.9 * true)})
    result = gb.fit(model, case.records, noise=case.noise)
    assert result.parameters[name].at_bound and result.parameters[name].value == pytest.approx(0.9 * true, rel=1e-3)


def test_a_prior_holds_a_constant(case):
    name, true = next(iter(case.truth.items()))
    std = known(case.name)[1].parameters[name].std
    mean = true + 6 * std
    result = gb.fit(case.model.prior(**{name: (mean, std)}), case.records, noise=case.noise)
    # As sure as the data: half way between both, to what the other constants give.
    assert result.parameters[name].value == pytest.approx(true + 3 * std, abs=2 * std)
    assert abs(result.constraints.priors[name].conflict) > 2


def test_a_tie_holds_exactly(case):
    given, by = list(case.truth)[:2]
    ratio = case.truth[given] / case.truth[by]
    unit = f"({case.model.parameter(given).unit})/({case.model.parameter(by).unit})"
    tied = case.model.tie(new=[gb.Parameter("ratio", unit, ratio, fixed=True)], **{given: f"ratio*{by}"})
    result = gb.fit(tied, case.records, noise=case.noise)
    assert result.success and given not in result.parameters
    assert result.constraints.tied[given].value == pytest.approx(ratio * result.parameters[by].value)
    assert abs(result.parameters[by].value - case.truth[by]) < 4 * result.parameters[by].std


def test_each_experiment_may_have_a_constant_of_its_own(case):
    name, true = next(iter(case.truth.items()))
    result = gb.fit(case.plant, case.records, noise=case.noise, per_experiment=[name])
    own = result.constraints.per_experiment[name]
    assert result.success and len(own) == 2
    assert all(abs(e.value - true) < 4 * e.std for e in own.values())


def test_an_operating_condition_takes_the_place_of_a_constant(case):
    name, true = next(iter(case.truth.items()))
    records = [replace(r, conditions={name: true}) for r in case.records]
    result = gb.fit(case.plant, records, noise=case.noise)
    other = list(case.truth)[1]
    assert (
        name not in result.uncertainty.free
        and abs(result.parameters[other].value - case.truth[other]) < 4 * result.parameters[other].std
    )


def test_outliers_do_not_pull_a_robust_fit(case):
    if predicts(case):
        pytest.skip("a likelihood has no loss")
    rng, spoiled = np.random.default_rng(3), []
    for record in case.records:
        hit = rng.uniform(size=record.rows) < 0.03
        spoiled.append(record.with_outputs({n: y + 60 * case.noise[n] * hit for n, y in record.outputs.items()}))
    robust = gb.fit(case.plant, spoiled, noise=case.noise, options=FitOptions(loss="huber"))
    for name, true in case.truth.items():
        assert abs(robust.parameters[name].value - true) < 5 * robust.parameters[name].std
    assert robust.robust.name and max(robust.robust.outliers.values()) == pytest.approx(0.03, abs=0.02)


def test_noise_that_nobody_tells_is_estimated(case):
    result = gb.fit(case.plant, case.records)
    for name, std in case.noise.items():
        assert 0.3 * std < result.noise.std[name] < 20 * std
    assert result.success and set(result.noise.sources) == set(case.noise)


def test_an_initial_state_is_estimated_where_it_can_be(fitted):
    case, result = fitted
    assert bool(result.traces[0].initial_state) == bool(case.begin)
    for name, value in case.begin.items():
        assert result.traces[0].initial_state[name] == pytest.approx(value, abs=0.005)


def test_at_rest_begins_at_the_declared_state(case):
    result = gb.fit(case.plant, case.records, noise=case.noise, options=FitOptions(at_rest=True))
    for trace in result.traces:
        assert all(value == 0 for value in trace.initial_state.values())


# After the fit.


def test_a_record_that_was_not_fitted_validates(case):
    one = gb.fit(case.plant, case.records[0], noise=case.noise, validation=case.records[1])
    again = gb.validate(one.model, case.records[1], noise=case.noise)
    for name in case.noise:
        ratio = one.validation.misfit[name].noise_ratio
        assert ratio == pytest.approx(again.misfit[name].noise_ratio, rel=1e-6) and ratio < (
            50 if predicts(case) else 1.3
        )


@pytest.mark.rest
def test_several_starts_end_at_one_optimum(case):
    if predicts(case):
        with pytest.raises(ModelError, match="do not determine process noise"):
            gb.multistart(case.plant, case.records, noise=case.noise, starts=2)
        return
    many = gb.multistart(case.plant, case.records, noise=case.noise, starts=3, factor=1.5, workers=1)
    assert many.best_optimum_count == 3 and len(many.best.starts) == 3


def test_the_journal_of_starts_knows_the_plant(case, tmp_path):
    if predicts(case):
        pytest.skip("one start")
    journal, name = tmp_path / "starts.jsonl", next(iter(case.truth))
    # At the truth of the others: no start is hopeless, so that none is searched from elsewhere again.
    model = case.model.fix(**{n: case.truth.get(n, value) for n, value in case.model.values.items() if n != name})
    for _ in range(2):
        gb.multistart(model, case.records[0], noise=case.noise, starts=2, factor=1.2, workers=1, journal=journal)
    assert len(journal.read_text().splitlines()) == 2


def test_a_profile_has_the_ends_of_the_interval(fitted):
    case, result = fitted
    name = next(iter(case.truth))
    low, high = profile(result, name).interval
    expected = result.parameters[name].interval
    assert low == pytest.approx(expected[0], abs=0.3 * result.parameters[name].std)
    assert high == pytest.approx(expected[1], abs=0.3 * result.parameters[name].std)


def test_a_bootstrap_draws_as_wide(fitted):
    case, result = fitted
    drawn = bootstrap(result, np.random.default_rng(0), replicates=200)
    for name in case.truth:
        low, high = drawn.interval[name]
        assert high - low == pytest.approx(4 * result.parameters[name].std, rel=0.4)


def test_residual_tests_pass(fitted):
    tests = gb.residual_tests(fitted[1])
    assert tests.tests and not any(t.alarm for t in tests.tests if t.kind == "whiteness")


def test_it_is_saved_and_read_without_loss(fitted, tmp_path):
    case, result = fitted
    again = gb.load_fit(result.save(tmp_path / "fit.json"), case.plant)
    assert again.parameters == result.parameters and again.solver.cost == result.solver.cost
    assert str(again) == str(result)
    # What is read back goes on: a profile runs the plant again.
    objective = restore_objective(again)
    assert objective.evaluate(objective.variables.here).cost == pytest.approx(result.solver.cost, rel=1e-6)


@pytest.mark.rest
def test_a_region_of_two_constants_lies_around_their_estimates(fitted):
    case, result = fitted
    one, other = list(case.truth)[:2]
    region = profile_pair(result, one, other)
    # Two constants at once: chi-square with two degrees of freedom, 2.448 standard deviations to either side.
    for name, width in ((one, np.ptp(region.values)), (other, region.upper.max() - region.lower.min())):
        assert width == pytest.approx(2 * 2.448 * result.parameters[name].std, rel=0.2)


def test_it_is_scored_in_the_free_run_and_ahead(fitted):
    result = fitted[1]
    scores = score(result, steps=(1,))
    for name, misfit in result.misfit.items():
        assert scores.outputs[name].rmse == misfit.rmse
        assert scores.outputs[name].ahead[1] < 1.1 * misfit.rmse


def test_noise_that_grows_with_the_signal_weighs_the_rows(case):
    if predicts(case):
        pytest.skip("a likelihood has one level for each output")
    growing = {name: gb.GrowingNoise(floor=std, share=0.0) for name, std in case.noise.items()}
    same, told = (gb.fit(case.plant, case.records, noise=noise) for noise in (case.noise, growing))
    for name in case.truth:
        assert told.parameters[name].value == pytest.approx(same.parameters[name].value, rel=1e-5)
        assert told.parameters[name].std == pytest.approx(same.parameters[name].std, rel=1e-3)


def test_the_order_of_the_records_is_no_matter(fitted):
    case, result = fitted
    turned = gb.fit(case.plant, case.records[::-1], noise=case.noise)
    assert turned.solver.cost == pytest.approx(result.solver.cost, rel=1e-6)


@pytest.mark.rest
def test_two_of_them_are_compared(fitted):
    case, result = fitted
    name = next(iter(case.truth))
    worse = gb.fit(case.model.fix(**{name: 1.3 * case.truth[name]}), case.records, noise=case.noise)
    compared = gb.compare({"right": result, "wrong": worse}, case.records[1])
    assert "right" in str(compared) and "wrong" in str(compared)


def test_it_is_checked_before_a_fit(fitted):
    """The standard deviations to expect at the estimates are those of the fit, as far as its residual is what was told."""
    case, result = fitted
    if predicts(case):
        pytest.skip("a check is one of free runs")
    checked = check(result.model, case.records, noise=case.noise)
    assert checked.complete and set(checked.constants) >= set(case.truth)
    # A check begins each record where the states are declared.
    for name, expected in () if any(case.begin.values()) else checked.constants.items():
        assert expected.std == pytest.approx(result.parameters[name].std, rel=0.15)
    if "equations" not in case.abilities:
        assert checked.structure is None and "run from outside" in text(checked, details=True)
        with pytest.raises(DataError, match="run from outside"):
            check(case.model)


@pytest.mark.rest
def test_an_effect_at_an_output_is_one_more_constant(case):
    """A reading that drifts by a known rate: the straight line is added by hand."""
    if predicts(case):
        pytest.skip("an effect of a filter is one of its model")
    if case.name == "frequency":
        with pytest.raises(ModelError, match="rests on equations: add sensor_drift to its model"):
            case.model + gb.effect("sensor_drift")
        return
    first = case.model.outputs[0].name
    rate, drifted = 0.0, []
    for record in case.records:
        rate = rate or 20 * case.noise[first] / (record.time[-1] - record.time[0])
        y = record.outputs[first] + rate * (record.time - record.time[0])
        drifted.append(record.with_outputs({**record.outputs, first: y}))
    result = gb.fit(case.model + gb.effect("sensor_drift"), drifted, noise=case.noise)
    assert result.success and result.model.effect_names == ("sensor_drift",)
    for name, true in {**case.truth, "rate": rate}.items():
        assert abs(result.parameters[name].value - true) < 4 * result.parameters[name].std


@pytest.mark.slow
def test_an_effect_at_an_output_is_found(case):
    """The drift of a sensor among two effects, and its constant: by the same search, with the same answer, whatever the plant is."""
    if case.name not in ("closed_form", "pendulum", "black_box", "fmu"):
        pytest.skip("searched in its equations")
    first, scale = case.model.outputs[0].name, 0.0
    drifted = []
    for record in case.records:
        scale = scale or 40 * case.noise[first] / (record.time[-1] - record.time[0])
        y = record.outputs[first] + scale * (record.time - record.time[0])
        drifted.append(record.with_outputs({**record.outputs, first: y}))
    candidates = [gb.effect("sensor_drift"), gb.effect("sensor_lag")]
    found = gb.discover(case.plant, drifted[0], validation=drifted[1], noise=case.noise, effects=candidates, workers=1)
    # A pendulum over four seconds does not tell its torque from its sensor.
    assert found.verdict in ("named", "partly") and [e["name"] for e in found.effects] == ["sensor_drift"]
    rate = found.best.parameters["rate"]
    assert abs(rate.value - scale) < 4 * rate.std and found.best.model.name == case.model.name
    assert gb.discovery.try_effect(found.base, "sensor_drift", validation=drifted[1]).is_needed


def test_each_record_is_fitted_by_itself(case):
    fleet = gb.fit_each(case.plant, case.records, noise=case.noise)
    assert len(fleet.records) == 2 and all(set(case.truth) <= set(r.parameters) for r in fleet.records)


def test_what_a_run_costs_is_told_where_it_has_a_price(fitted):
    case, result = fitted
    cost = result.solver.statistics
    if "equations" in case.abilities:
        assert "runs" not in cost and cost["passes"] > 0
    else:
        assert cost["runs"] > 0 and cost["failed_runs"] >= 0 and cost["simulation_equivalents"] > 0


def test_what_needs_equations_says_so(case, tmp_path):
    of_laws = case.plant, case.records[0]
    if "equations" in case.abilities:
        assert gb.linearise(free_run(case)).A.shape == (2, 2)
        return
    if "linear" in case.abilities:
        # What has no equations at all is linearised along a record.
        along = case.records[0] if case.name == "fmu" else None
        assert gb.linearise(case.model, along=along).A.shape == (2, 2)
    with pytest.raises(ModelError, match=r"acts inside|rests on equations"):
        case.model + gb.effect("coulomb_friction")
    for refused in (
        *([] if "linear" in case.abilities else [lambda: gb.linearise(case.model)]),
        lambda: case.model.with_process_noise("a"),
        lambda: gb.predict(gb.fit(case.plant, case.records[0], noise=case.noise), case.records[0]),
        lambda: gb.smooth(case.model, case.records[0], noise=case.noise),
        lambda: gb.design(case.model, limits={}, duration=1.0),
        lambda: gb.design(gb.fit(case.plant, case.records[0], noise=case.noise), duration=1.0),
        lambda: gb.discovery.localise_residual(gb.fit(case.plant, case.records[0], noise=case.noise)),
        lambda: gb.identifiability.analyse_structural_identifiability(case.model),
        *([] if case.name == "frequency" else [lambda: gb.export.to_python(case.model, tmp_path / "model.py")]),
        *([] if case.name == "frequency" else [lambda: gb.discover(*of_laws, validation=case.records[-1], laws=True)]),
    ):
        with pytest.raises(ModelError, match=rf"{case.model.name}[: ].*(run from outside|the model behind this plant)"):
            refused()


def test_a_run_that_fails_turns_the_search_back(case):
    if case.name != "pendulum":
        pytest.skip("it never fails")
    result = gb.fit(case.model.start(d=7.9), case.records, noise=case.noise)
    assert result.success and result.parameters["d"].value == pytest.approx(0.3, abs=4 * result.parameters["d"].std)
    stuck = gb.fit(case.model.start(d=9.0), case.records, noise=case.noise, options=FitOptions(other_starts=0))
    assert not stuck.success and "the bearing is stuck" in stuck.solver.status_message
