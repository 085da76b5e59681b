"""`fit` by every transcription: the same constants, a default that picks by the model and says so, and words for what cannot be."""

from __future__ import annotations

import signal

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from greybox.base.errors import DataError, FitError, ModelError
from greybox.estimation.fit import fit
from greybox.estimation.options import FitOptions
from greybox.estimation.residuals import residual_tests
from greybox.estimation.result import load_fit
from greybox.estimation.transcription.problem import SolutionCode, TranscriptionReason
from greybox.estimation.uncertainty import profile
from greybox.estimation.validate import validate
from greybox.model.balance import Balance
from greybox.model.effects.catalogue import effect
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State
from greybox.simulation.simulate import simulate
from models.cascaded_tanks import cascaded_tanks
from models.emps import emps
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from tests.oracles.independent import experiment, linear_matrices, linear_record, multisine, rates_of, solved_record
from tests.support.oscillator import oscillator
from tests.support.published_plants import PREY

RANGE = (1e-3, 1e3)
LIFTED = ("multiple", "collocation-radau", "collocation-legendre")
ALL = ("automatic", "single", *LIFTED, "arcs")
# Where the two kinds of points go the same way one of them is enough for an ordinary run.
ONE_OF_EACH = ("multiple", "collocation-radau", pytest.param("collocation-legendre", marks=pytest.mark.slow))


def levitation() -> Model:
    """A ball under a magnet, linear about its gap: ``x'' = k x + b u``, unstable with exponent sqrt(k)."""
    return Model(
        "levitation",
        [State("x", "mm"), State("v", "mm/s")],
        [Input("u", "A")],
        [Output("x", "mm")],
        [Parameter("k", "1/s**2", 900.0, (1.0, 1e5)), Parameter("b", "mm/(s**2*A)", 400.0, (1.0, 1e5))],
        lambda x, u, p: [
            Balance("position", "mm/s", 1, "x", velocity=x.v),
            Balance("force", "mm/s**2", 1, "v", gap=p.k * x.x, current=p.b * u.u),
        ],
    )


def held_up(model: Model, rows: int, period: float, noise: dict[str, float] | None = None, seed: int = 1):
    """A linear plant that a controller holds up, stepped by its matrix exponential."""
    a, b, *_ = linear_matrices(model)
    step = expm(np.block([[a, b], [np.zeros((1, 3))]]) * period)
    push = multisine(np.random.default_rng(seed), rows, period, 1.0, 15.0, 0.4)
    x, u, y = np.array([0.1, 0.0]), [], []
    for k in range(rows):
        u.append(push[k] - 8.0 * x[0] - 0.2 * x[1])
        y.append([x[0]])
        x = (step @ np.append(x, u[-1]))[:2]
    return experiment(model, np.arange(rows) * period, np.array(u)[:, None], np.array(y), noise, seed)


def duffing_case():
    model = oscillator("duffing", 0.3, 4.0, 6.0, 2.0)
    u = multisine(np.random.default_rng(0), 300, 0.02, 0.05, 1.5, 3.0)
    data = solved_record(model, u, np.arange(300) * 0.02, [0.3, 0.0])
    return model, model.start(d=0.45, k=2.6, c=9.0, b=1.3), data, {"x": 1e-3}, False


def pneumatic_case():
    model = pneumatic_cylinder.free("V_total")
    t = np.arange(200) * 0.01
    u = 1.25 * np.cos(0.4 * np.pi * t) + 2.0 * np.cos(1.6 * np.pi * t) + 0.5 * np.sign(np.sin(9.1 * t))
    half = model.values["P_S"] / 2
    data = linear_record(model, u, 0.01, [0.0, 0.0, half, half])
    return model, model.start(**{q.name: 1.4 * q.value for q in model.free_parameters}), data, None, True


def actuator_case():
    model = micro_actuator.fix("M", "Ra")
    data = linear_record(model, multisine(np.random.default_rng(1), 50, 2.5e-4, 5, 800, 3.0), 2.5e-4)
    return (
        model,
        model.start(**{q.name: 1.3 * q.value for q in model.free_parameters}),
        data,
        {"x": 1e-7, "i": 1e-3},
        True,
    )


def levitation_case():
    model = levitation()
    return model, model.start(k=600.0, b=550.0), held_up(model, 250, 2e-3), {"x": 1e-3}, False


CASES = {
    "oscillating": duffing_case,
    "integrating": pneumatic_case,
    "stable": actuator_case,
    "unstable": levitation_case,
}


# Both kinds of points go one way but for their coefficients: of the second two plants are enough in the run of each change.
@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize(
    ("case", "transcription"),
    [
        pytest.param(
            *(case, way),
            marks=[pytest.mark.slow] * (way == "collocation-legendre" and case in ("stable", "integrating")),
        )
        for case in CASES
        for way in ALL
    ],
)
def test_the_same_fit_by_every_transcription_gives_the_same_constants(case, transcription):
    truth, start, data, noise, rest = CASES[case]()
    length = data.duration / 8 if transcription == "arcs" else 0.0
    # An arc begins where it begins: it is never at rest.
    options = FitOptions(at_rest=rest and not length, transcription=transcription, arc_length=length)
    found = fit(start, data, noise=noise, options=options)
    assert found.success, found.solver.status_message
    for q in truth.free_parameters:
        assert found.parameters[q.name].value == pytest.approx(q.value, rel=2e-6), q.name
        assert found.parameters[q.name].std > 0
    assert max(m.noise_ratio for m in found.misfit.values()) < 1e-2
    assert found.provenance.options["transcription"] == transcription
    assert bool(found.solver.strategy.values["reason"]) is (transcription == "automatic")
    assert found.solver.strategy.subject == found.solver.statistics["transcription"]


@pytest.mark.crossed(3)
@pytest.mark.parametrize("transcription", ["automatic", *ONE_OF_EACH])
def test_an_unstable_plant_has_traces_and_a_validation_that_follow_the_record(transcription):
    truth = levitation()
    noise = {"x": 2e-3}
    data, other = (held_up(truth, 350, 4e-3, noise, seed) for seed in (1, 2))
    start = truth.start(k=600.0, b=550.0)
    found = fit(start, data, noise=noise, validation=other, options=FitOptions(transcription=transcription))
    assert found.success, found.solver.status_message
    assert 0.9 < found.misfit["x"].noise_ratio < 1.1
    assert 0.8 < found.validation.misfit["x"].noise_ratio < 1.3
    for name, estimate in found.parameters.items():
        assert abs(estimate.value - truth.values[name]) < 3 * estimate.std < 0.1 * estimate.value
    # from its own initial state the model falls within the record: e^42 is more than the digits of a constant
    alone = simulate(found.model, data, initial=found.traces[0].initial_state).outputs["x"]
    assert not np.allclose(alone, data.outputs["x"], atol=10.0)
    assert np.allclose(found.traces[0].simulated["x"], data.outputs["x"], atol=6 * noise["x"])
    with pytest.raises(FitError, match="its simulation is not a free run"):
        profile(found, "k")
    with pytest.raises(FitError, match="its simulation is not a free run"):
        residual_tests(found)


@pytest.mark.parametrize(
    ("case", "transcription", "reason"),
    [
        ("unstable", "multiple", TranscriptionReason.UNSTABLE),
        ("integrating", "single", TranscriptionReason.INTEGRATING_GROWING),
        ("stable", "single", TranscriptionReason.STABLE),
    ],
)
def test_the_default_transcription_is_stated_with_its_reason(case, transcription, reason):
    _, start, data, noise, rest = CASES[case]()
    strategy = fit(start, data, noise=noise, options=FitOptions(at_rest=rest)).solver.strategy
    assert strategy.code == SolutionCode.SEARCH_STRATEGY and strategy.subject == transcription
    assert strategy.values["reason"] == reason


@pytest.mark.rest
def test_a_stiff_plant_is_fitted_with_implicit_steps_and_says_so():
    """The spool settles within 0.1 ms, samples are 10 ms apart: an explicit step is stable with 90 of them in a sample."""
    model = Model(
        "stiff",
        [State("s", "m"), State("x", "m")],
        [Input("u", "m")],
        [Output("x", "m")],
        [
            Parameter("a", "1/s", 2.0, RANGE),
            Parameter("c", "1/m**2", 0.5, RANGE),
            Parameter("f", "1/s", 1e4, (1, 1e6), fixed=True),
            Parameter("g", "1/s", 1.0, fixed=True),
        ],
        lambda x, u, p: [
            Balance("spool", "m/s", 1, "s", command=p.f * u.u, back=-p.f * x.s, hardening=-p.f * p.c * x.s**3),
            Balance("slow", "m/s", 1, "x", inflow=p.g * x.s, decay=-p.a * x.x),
        ],
    )
    f, p, u = rates_of(model), np.array(list(model.values.values())), 1.5 * np.sin(0.08 * np.arange(80))
    x, y = np.zeros(2), []
    for value in u:
        y.append([x[1]])
        run = solve_ivp(lambda _, x, u=value: f(x, u, p), (0, 0.01), x, method="LSODA", rtol=1e-9, atol=1e-11)
        x = run.y[:, -1]
    data = experiment(model, np.arange(80) * 0.01, u[:, None], np.array(y), {"x": 1e-4})
    start = model.start(a=3.0, c=0.2)
    found = fit(start, data, noise={"x": 1e-4}, options=FitOptions(at_rest=True))
    assert (
        "ESDIRK" in found.discretisation.label
    )  # the input jumps in every row: Radau steps of one length would be many
    assert found.solver.strategy.values["reason"] == TranscriptionReason.STIFF_IMPLICIT
    explicit = fit(start, data, noise={"x": 1e-4}, options=FitOptions(at_rest=True, method="rk4"))
    points = fit(start, data, noise={"x": 1e-4}, options=FitOptions(at_rest=True, transcription="collocation-radau"))
    assert "three Radau points" in points.discretisation.label
    for name in ("a", "c"):
        std = explicit.parameters[name].std
        for other in (found, points):
            assert other.parameters[name].value == pytest.approx(explicit.parameters[name].value, abs=0.1 * std)
            assert other.parameters[name].std == pytest.approx(std, rel=0.02)


@pytest.mark.rest
@pytest.mark.parametrize("transcription", ONE_OF_EACH)
def test_intervals_and_own_constants_are_those_of_single_shooting(transcription):
    """Two days with a damping of their own, a prior on the stiffness: every transcription weighs them alike."""
    truth = oscillator("duffing", 0.3, 4.0, 6.0, 2.0)
    noise, records = {"x": 2e-3}, []
    for day, damping in enumerate((0.3, 0.5)):
        u = multisine(np.random.default_rng(day), 160, 0.02, 0.05, 1.5, 3.0)
        record = solved_record(truth.start(d=damping), u, np.arange(160) * 0.02, [0.3, 0.0], noise, day, f"day {day}")
        records.append(record)
    start = truth.start(d=0.4, k=3.0, c=7.0, b=1.6).prior(k=(4.1, 0.01))
    one, other = (
        fit(start, records, noise=noise, per_experiment=["d"], options=FitOptions(transcription=name))
        for name in ("single", transcription)
    )
    assert one.constraints.priors["k"].mean == 4.1
    for name, estimate in one.parameters.items():
        assert other.parameters[name].value == pytest.approx(estimate.value, abs=0.01 * estimate.std), name
        assert other.parameters[name].std == pytest.approx(estimate.std, rel=0.01), name
    for name, estimate in one.constraints.per_experiment["d"].items():
        assert other.constraints.per_experiment["d"][name].value == pytest.approx(
            estimate.value, abs=0.01 * estimate.std
        )
        assert other.constraints.per_experiment["d"][name].std == pytest.approx(estimate.std, rel=0.01)
    assert one.solver.cost == pytest.approx(other.solver.cost, rel=1e-6)
    assert other.misfit["x"].rmse == pytest.approx(one.misfit["x"].rmse, rel=1e-5)


def coloured(model, data, std, rho, seed):
    """The record with autoregressive noise of the first order."""
    rng, noise = np.random.default_rng(seed), np.zeros(data.rows)
    for k in range(data.rows):
        noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * rng.normal(0, std)
    return data.with_outputs({n: y + noise for n, y in data.outputs.items()})


@pytest.mark.parametrize("transcription", ["multiple", "collocation-legendre"])
def test_coloured_noise_is_weighed_by_a_free_run_where_the_plant_allows(transcription):
    model = oscillator("duffing", 0.3, 4.0, 6.0, 2.0)
    u = multisine(np.random.default_rng(0), 300, 0.02, 0.05, 1.5, 3.0)
    data = coloured(model, solved_record(model, u, np.arange(300) * 0.02, [0.3, 0.0]), 2e-3, 0.9, 1)
    at_rest = experiment(model, np.arange(900) * 0.02, np.zeros((900, 1)), np.zeros((900, 1)))
    quiet = coloured(model, at_rest, 2e-3, 0.9, 2)
    start = model.start(d=0.4, k=3.0, c=7.0, b=1.6)
    one, other = (fit(start, data, quiet=quiet, options=FitOptions(transcription=n)) for n in ("single", transcription))
    assert one.noise.colour["x"]
    assert other.solver.strategy.values["completion"] == "free_run"
    for name, estimate in one.parameters.items():
        assert other.parameters[name].value == pytest.approx(estimate.value, abs=0.02 * estimate.std), name
        assert other.parameters[name].std == pytest.approx(estimate.std, rel=0.02), name


def test_coloured_noise_on_an_unstable_plant_is_left_to_the_intervals_and_said_so():
    truth = levitation()
    data = coloured(truth, held_up(truth, 400, 2e-3), 2e-3, 0.8, 1)
    still = experiment(truth, np.arange(800) * 2e-3, np.zeros((800, 1)), np.zeros((800, 1)))
    found = fit(truth.start(k=600.0, b=550.0), data, quiet=coloured(truth, still, 2e-3, 0.8, 2))
    assert found.success
    assert found.solver.strategy.values["completion"] == "white_noise"
    assert found.uncertainty.kind == "sandwich" and max(found.uncertainty.inflation.values()) > 1.2
    for name, estimate in found.parameters.items():
        assert abs(estimate.value - truth.values[name]) < 3 * estimate.std


def test_a_robust_loss_on_an_unstable_plant_is_refused_in_words():
    truth = levitation()
    with pytest.raises(ModelError, match=r"multiple shooting minimises plain squares.*a robust loss needs a free run"):
        fit(truth.start(k=700.0), held_up(truth, 600, 2e-3, {"x": 2e-3}), options=FitOptions(loss="huber"))


@pytest.mark.slow
def test_short_arcs_show_the_structure_of_the_drive_and_the_whole_record_what_drifts(shared_data):
    """The published drive: arcs of 0.1 s give the constants that inverse dynamics gives (95.1 kg, 203.5 N s/m, 20.4 N, 3.16 N)."""
    from greybox import read_csv

    train = read_csv(shared_data / "emps" / "train.csv", emps).window(0, 12000)
    rubbing = emps + effect("coulomb_friction") + effect("constant_load")
    short, long, whole = (fit(rubbing, train, options=FitOptions(arc_length=s)) for s in (0.1, 2.0, 0.0))
    known = {"M": 95.1, "Fv": 203.5, "Fc": 20.4, "F0": 3.16}
    for name, value in known.items():
        assert short.parameters[name].value == pytest.approx(value, rel=0.03), name
    far = {name: abs(whole.parameters[name].value / value - 1) for name, value in known.items()}
    assert far["Fv"] > 0.05 and far["Fc"] > 0.05  # the offset that a free run adds up over 25 s spoils the friction
    rmse = [f.misfit["q"].rmse for f in (short, long, whole)]
    assert rmse[0] < 1e-5 < 5e-4 < rmse[1] < rmse[2]
    assert short.solver.strategy.subject == "arcs" and short.solver.strategy.values["arc_length"] == 0.1
    bare = {s: fit(emps, train, options=FitOptions(arc_length=s)).parameters["M"].value for s in (0.1, 0.0)}
    assert (
        bare[0.1] == pytest.approx(95.1, rel=0.1) and bare[0.0] > 150
    )  # without dry friction the whole record says nothing
    for asked in (lambda: profile(short, "M"), lambda: residual_tests(short)):
        with pytest.raises(FitError, match="not a free run"):
            asked()


@pytest.mark.rest
def test_arcs_with_coloured_noise_are_searched_with_their_initial_states():
    model = micro_actuator.fix("M", "Ra")
    noise = {"x": 2e-7, "i": 5e-3}
    data = linear_record(model, multisine(np.random.default_rng(1), 1200, 2.5e-4, 5, 800, 3.0), 2.5e-4, noise=noise)
    start = model.start(**{q.name: 1.2 * q.value for q in model.free_parameters})
    options = FitOptions(arc_length=0.045)
    plain = fit(start, data, noise=noise, options=options)
    coloured_too = fit(start, data, noise=noise, colour="residual", options=options)
    assert plain.success and coloured_too.success
    for name, estimate in plain.parameters.items():
        if estimate.std:
            assert coloured_too.parameters[name].value == pytest.approx(estimate.value, abs=estimate.std), name
    with pytest.raises(
        ModelError, match=r"arcs of 0\.00075 s: 400 of them have \d+ unknowns together.*take longer arcs"
    ):
        fit(start, data, noise=noise, options=FitOptions(arc_length=7.5e-4, loss="huber"))
    robust = fit(start, data, noise=noise, options=FitOptions(arc_length=0.045, loss="huber"))
    assert robust.robust.name.startswith("huber") and robust.solver.statistics["transcription"] == "arcs"
    with pytest.raises(DataError, match="an arc needs at least 3"):
        fit(start, data, noise=noise, options=FitOptions(arc_length=3e-4))


def test_collocation_holds_states_within_their_bounds_and_says_where():
    """A lower tank that the model would empty: the level stays at zero, and the result counts the samples."""
    t = np.arange(80) * 4.0
    u = np.where(t < 100, 3.0, 0.0)
    data = solved_record(cascaded_tanks, u, t, [3.0, 3.0], {o.name: 0.02 for o in cascaded_tanks.outputs})
    drained = data.with_outputs({n: np.minimum(y, 6.0) - 2.5 for n, y in data.outputs.items()})
    noise = {o.name: 0.02 for o in cascaded_tanks.outputs}
    # The model cannot follow, so that other starts would be searched as well: they say nothing of the bounds.
    options = FitOptions(transcription="collocation-radau", substeps=1, other_starts=0)
    found = fit(cascaded_tanks, drained, noise=noise, options=options)
    held = [s for s in cascaded_tanks.states if np.isfinite(s.bounds[0])]
    assert held
    assert found.solver.strategy.values["held_samples"] > 0
    for trace in found.traces:
        for state in held:
            if state.name in trace.simulated:
                assert trace.simulated[state.name].min() >= state.bounds[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"transcription": "multipel"}, "unknown transcription 'multipel'; did you mean 'multiple'"),
        ({"transcription": "arcs"}, "transcription 'arcs' needs their length: give arc_length, in seconds"),
        ({"transcription": "single", "arc_length": 1.0}, "arc_length 1 s: transcription 'single' has no arcs"),
        ({"arc_length": -1.0}, "arc_length -1.0 s: give a positive number of seconds"),
        ({"arc_length": float("nan")}, "arc_length nan s: give a positive number"),
        ({"hessian": "exakt"}, "unknown Hessian 'exakt'; did you mean 'exact'"),
        ({"hessian": "exact"}, "hessian 'exact': transcription 'automatic' has none; take 'collocation-radau'"),
    ],
)
def test_choices_that_do_not_exist_or_contradict_each_other_are_refused(options, message):
    with pytest.raises(ModelError, match=message):
        FitOptions(**options)


def test_what_are_no_options_is_refused_in_words():
    _, start, data, noise, _ = duffing_case()
    for wrong, message in (
        (
            {"at_rest": True},
            r"options: \{'at_rest': True\} is not a FitOptions; write options=FitOptions\(at_rest=True\)",
        ),
        ("multiple", "options: 'multiple' is not a FitOptions; write options=FitOptions"),
    ):
        with pytest.raises(ModelError, match=message):
            fit(start, data, noise=noise, options=wrong)
        with pytest.raises(ModelError, match=message):
            validate(start, data, noise=noise, options=wrong)


def test_dry_friction_by_collocation_is_refused_in_words():
    data = linear_record(emps, np.sin(np.arange(60)), 1e-3)
    with pytest.raises(ModelError, match="coulomb_friction sticks or switches; use single or multiple shooting"):
        fit(emps + effect("coulomb_friction"), data, options=FitOptions(transcription="collocation-radau"))


@pytest.mark.rest
def test_the_exact_hessian_ends_where_gauss_newton_does():
    truth, start, data, noise, _ = duffing_case()
    found = fit(start, data, noise=noise, options=FitOptions(transcription="collocation-radau", hessian="exact"))
    assert found.success
    for q in truth.free_parameters:
        assert found.parameters[q.name].value == pytest.approx(q.value, rel=1e-6)


def test_ctrl_c_ends_a_search_over_segments_with_the_best_point_so_far():
    _, start, data, noise, _ = levitation_case()
    seen = []

    def report(progress):
        seen.append(progress)
        signal.raise_signal(signal.SIGINT)

    found = fit(start, data, noise=noise, report=report)
    assert found.status == "interrupted" and not found.success
    assert len(seen) == 1 and seen[0].noise_ratio > 0


def test_a_fit_over_segments_is_saved_and_loaded(tmp_path):
    truth, start, data, noise, _ = levitation_case()
    found = fit(start, data, noise=noise)
    again = load_fit(found.save(tmp_path / "fit.json"), truth)
    assert again.solver.statistics["transcription"] == "multiple"
    assert again.solver.statistics["free_run"] is found.solver.statistics["free_run"]
    np.testing.assert_array_equal(again.traces[0].simulated["x"], found.traces[0].simulated["x"])
    assert again.model.values == found.model.values


def test_a_start_that_cannot_be_simulated_in_any_segment_says_so():
    model = Model(
        "explosive",
        [State("x", "m", 1.0)],
        [Input("u", "m")],
        [Output("x", "m")],
        [Parameter("a", "1/s/m", 50.0, (1e-3, 1e3))],
        lambda x, u, p: [Balance("growth", "m/s", 1, "x", square=p.a * x.x * x.x)],
    )
    t = np.arange(100) * 0.1
    data = experiment(model, t, np.ones((100, 1)), 2 + np.cos(t)[:, None])
    for options in (FitOptions(transcription="multiple", other_starts=0), FitOptions(arc_length=2.0, other_starts=0)):
        found = fit(model, data, noise={"x": 0.1}, options=options)
        assert found.status == "no_start" and not found.success


def test_noise_free_records_get_a_step_that_leaves_no_digits_behind():
    """The published predator and prey, noise-free: given as loud or not at all, the constants come back to 1e-7."""
    prey = PREY.start(beta=0.5, delta=0.5)
    truth = prey.start(beta=0.7, delta=0.35)
    data = solved_record(truth, np.zeros((11, 0)), np.arange(11.0), [1.0, 1.0])
    for noise in ({"x1": 0.1, "x2": 0.2}, None):
        found = fit(prey, data, noise=noise)
        for name, value in (("beta", 0.7), ("delta", 0.35)):
            assert found.parameters[name].value == pytest.approx(value, rel=1e-7)
        assert max(found.discretisation.error.values()) < 1e-4
    coarse = fit(prey, data, noise={"x1": 0.1, "x2": 0.2}, options=FitOptions(substeps=4))
    assert coarse.parameters["beta"].value != pytest.approx(0.7, rel=1e-6)


def test_a_fit_never_ends_above_where_it_began():
    """Part of a record may lead away: over its first tenth the spring was twice as stiff as over the rest, where the search begins."""
    time = 0.05 * np.arange(4000)
    u = np.repeat(np.random.default_rng(0).normal(size=200), 20)
    spring = oscillator("spring", 0.1, 4.0, 1e-3, 1.0).fix("d", "c", "b")
    stiff, soft = (simulate(spring.start(k=k), {"time": time, "u": u}).outputs["x"] for k in (8.0, 4.0))
    x = np.where(time < time[400], stiff, soft) + 0.01 * np.random.default_rng(1).normal(size=4000)
    record = experiment(spring, time, u[:, None], x[:, None])
    grown, whole = (
        fit(spring, record, noise={"x": 0.01}, options=FitOptions(at_rest=True, progressive=progressive))
        for progressive in (True, False)
    )
    assert len(grown.solver.strategy.values["shares"]) > 1
    assert grown.parameters["k"].value == pytest.approx(whole.parameters["k"].value, rel=1e-6)
    assert grown.parameters["k"].value == pytest.approx(4.0, rel=0.01)
