"""The numbers that steer a fit reach the code that they steer, and stay with the result."""

from __future__ import annotations

import json

import numpy as np
import pytest

from greybox.comparison.compare import compare
from greybox.comparison.result import save_comparison
from greybox.data.noise.noise_model import NoisePolicy
from greybox.discovery.problem import DiscoveryProblem
from greybox.estimation.check import check
from greybox.estimation.fit import fit
from greybox.estimation.optim.minimisation import GaussNewtonPolicy, GradientSamplingPolicy, MinimisationPolicy
from greybox.estimation.optimum import restore_problem
from greybox.estimation.options import (
    DEFAULT_POLICY,
    EstimationPolicy,
    FitOptions,
    StepRefinementPolicy,
    TranscriptionPolicy,
)
from greybox.estimation.predictor import restore_integration_options
from greybox.estimation.result import load_fit
from greybox.estimation.uncertainty import BootstrapPolicy, ProfilePolicy, bootstrap, profile
from greybox.simulation.integrators.discretisation import DiscretisationPolicy
from models.micro_actuator import micro_actuator
from tests.oracles.independent import linear_record, multisine

PLANT = micro_actuator.fix("M", "La", "Ra", "Kf")
CHANGED = EstimationPolicy(
    noise=NoisePolicy(max_order=3),
    discretisation=DiscretisationPolicy(eigenvalue_step=0.3),
    transcription=TranscriptionPolicy(max_segments=20, max_error_growth=30.0),
    minimisation=MinimisationPolicy(
        max_shortenings=5,
        damped=GaussNewtonPolicy(max_steps=20),
        sampling=GradientSamplingPolicy(radii=(1e-2, 1e-3)),
    ),
)


@pytest.fixture(scope="module")
def data():
    push = multisine(np.random.default_rng(3), 400, 2.5e-4, 5, 800, 3.0)
    return linear_record(PLANT, push, 2.5e-4, noise={"x": 1e-7}, seed=3)


def fitted(data, policy=DEFAULT_POLICY, model=PLANT, **choices):
    return fit(model, data, options=FitOptions(at_rest=True, policy=policy, **choices))


def test_a_number_of_the_noise_policy_reaches_the_estimate_of_the_noise() -> None:
    clean = linear_record(PLANT, np.sin(np.arange(400) * 0.02), 2.5e-4)
    usual, coarse = (
        fitted(clean, EstimationPolicy(noise=NoisePolicy(min_relative_level=level))) for level in (1e-6, 1e-1)
    )
    for name in usual.noise.std:
        assert coarse.noise.std[name] > 10 * usual.noise.std[name]


def test_a_number_of_the_discretisation_policy_reaches_the_choice_of_substeps(data) -> None:
    # As they are chosen: half the steps would move constants here, and shorter ones would follow.
    as_chosen = StepRefinementPolicy(halvings=0)
    usual, fine = (
        fitted(
            data,
            EstimationPolicy(discretisation=DiscretisationPolicy(eigenvalue_step=step), step_refinement=as_chosen),
            method="rk4",
        )
        for step in (0.5, 0.02)
    )
    assert fine.solver.statistics["substeps"] >= 5 * usual.solver.statistics["substeps"]


def test_a_number_of_the_transcription_policy_reaches_the_segments_the_loss_and_the_choice(data) -> None:
    few = TranscriptionPolicy(usual_rows=100)
    segments = [
        fitted(data, EstimationPolicy(transcription=policy), transcription="multiple").solver.strategy.values[
            "segments"
        ]
        for policy in (TranscriptionPolicy(), few)
    ]
    assert segments == [20, 4]
    tolerant = EstimationPolicy(huber_threshold=3.0)
    assert fitted(data, tolerant, loss="huber").robust.name.startswith("huber, 3 ")
    strict = TranscriptionPolicy(max_error_growth=1e-300)
    used = [
        fitted(data, EstimationPolicy(transcription=policy)).solver.statistics["transcription"]
        for policy in (TranscriptionPolicy(), strict)
    ]
    assert used == ["single", "multiple"]


def test_a_number_of_the_minimisation_policy_reaches_the_search(data) -> None:
    start = PLANT.start(**{q.name: q.value * 5 for q in PLANT.free_parameters})
    usual, hasty = (
        fitted(data, EstimationPolicy(minimisation=MinimisationPolicy(max_shortenings=count)), start, progressive=False)
        for count in (10, 0)
    )
    assert (hasty.solver.statistics["iterations"], hasty.solver.statistics["passes"]) != (
        usual.solver.statistics["iterations"],
        usual.solver.statistics["passes"],
    )


def test_the_policy_in_the_file_of_a_fit_is_that_of_the_fit(data, tmp_path) -> None:
    found = fitted(data, CHANGED)
    path = tmp_path / "fit.json"
    found.save(path)
    stored = json.loads(path.read_text(encoding="utf-8"))["options"]["policy"]
    assert stored["minimisation"]["damped"]["max_steps"] == 20
    assert EstimationPolicy.from_data(stored) == CHANGED
    loaded = load_fit(path, PLANT)
    assert restore_problem(loaded).policy == CHANGED
    assert restore_integration_options(loaded).policy == CHANGED
    problem = DiscoveryProblem.from_fit(loaded)
    assert problem.prepare(problem.model).policy == CHANGED


def test_an_older_file_has_the_usual_numbers_and_one_of_tomorrow_is_read_as_far_as_it_is_known() -> None:
    assert FitOptions.from_data({}).policy == DEFAULT_POLICY
    assert EstimationPolicy.from_data({"reporting": {"prior_conflict": 2.0}}).noise == NoisePolicy()
    stored = FitOptions(policy=CHANGED).to_data()["policy"]
    stored["noise"]["of_tomorrow"] = 1.0
    stored["minimisation"]["damped"]["of_tomorrow"] = 1.0
    assert EstimationPolicy.from_data({**stored, "group_of_tomorrow": {"number": 1.0}}) == CHANGED


def test_profile_and_bootstrap_keep_the_numbers_they_went_by(data) -> None:
    found = fitted(data)
    brief = ProfilePolicy(tolerance=0.1)
    assert profile(found, "K", policy=brief).policy is brief
    blocks = BootstrapPolicy(correlation_times=3.0)
    assert bootstrap(found, np.random.default_rng(0), replicates=20, policy=blocks).policy is blocks


@pytest.mark.rest
def test_check_and_comparison_store_the_options_of_the_estimation(data, tmp_path) -> None:
    options = FitOptions(at_rest=True, policy=CHANGED)
    assert check(PLANT, data, options=options).as_dict()["options"] == options.to_data()
    found = fit(PLANT, data, options=options)
    for given, stored in ((options, options.to_data()), (None, None)):
        path = save_comparison(compare([found], data, options=given), tmp_path / "compare.json")
        written = json.loads(path.read_text(encoding="utf-8"))
        assert written["options"] == stored
        assert written["policy"]["scan"]
