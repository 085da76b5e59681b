"""The selection alone: the cost of every set of effects in, the expected path out. Nothing is simulated and nothing is fitted."""

from collections.abc import Sequence

import pytest

from greybox.discovery.execution import RefitJob
from greybox.discovery.policy import DiscoveryPolicy, SearchBudget
from greybox.discovery.problem import FittedCandidate, noise_cost_limit
from greybox.discovery.selection import StepKind, StepwiseSelection
from tests.support.fake_candidates import COUNT, FakeProblem, costs, leaves_noise, toy_effect

NOISE = 1000.0  # a thousand samples of noise
LIMIT = 1000 * noise_cost_limit(COUNT)


def select(table, effects, policy=None, correct_shape=None, autocorrelation=leaves_noise):
    """The selection over a table of costs, and the effects that it ends with."""
    problem = FakeProblem(table)
    selection = StepwiseSelection(
        problem,
        effects,
        scales=None,
        policy=policy or DiscoveryPolicy(),
        on_message=lambda text: None,
        measure_autocorrelation=autocorrelation,
        correct_shape=correct_shape or (lambda *_: None),
    )
    return selection, selection.select()


def path(selection):
    """Kind, effects and outcome of every step."""
    return [(step.kind, frozenset(step.effects), step.accepted) for step in selection.steps]


A, B, C = toy_effect("a"), toy_effect("b"), toy_effect("c")
PARENT, CHILD, GRANDCHILD = toy_effect("parent"), toy_effect("child", "parent"), toy_effect("grandchild", "child")


@pytest.mark.parametrize(
    ("table", "selected"),
    [
        (costs(NOISE, a=NOISE - 3), ()),  # nothing is missing
        (costs(9000, a=8500), ()),  # a look-alike that explains next to nothing
        (costs(9000, a=NOISE, b=3000), ("a",)),
        (costs(9000, a=2000, b=3000, a__b=NOISE), ("a", "b")),
        (costs(9000, a=2000, b=3000, a__b=1990), ("a",)),  # a second one that gains too little
        (costs(9000, a=3000, b=4000, c=5000, a__b=2000, a__b__c=NOISE), ("a", "b", "c")),
    ],
    ids=["complete", "look-alike", "single", "pair", "no second", "triple"],
)
def test_effects_are_added_while_they_explain_enough(table, selected):
    selection, best = select(table, [A, B, C])
    assert set(best.effects) == set(selected)
    assert path(selection)[0][0] is StepKind.ADD


def test_two_effects_that_only_explain_together_are_found():
    table = costs(9000, a=4000, b=8000, c=8100, a__b=3900, a__c=3900, b__c=NOISE)
    _, best = select(table, [A, B, C])
    assert set(best.effects) == {"b", "c"}


def test_no_more_effects_than_the_budget_allows():
    table = costs(9000, a=5000, b=6000, a__b=3000, a__b__c=1000)
    policy = DiscoveryPolicy(budget=SearchBudget(most_effects=2))
    _, best = select(table, [A, B, C], policy)
    assert set(best.effects) == {"a", "b"}


def test_a_further_effect_must_beat_a_correction_of_the_shape():
    table = costs(9000, a=2000, b=3000, a__b=NOISE)

    def correct_shape(problem, fit, scales):
        return problem.refit_best(fit.model + toy_effect("a_second_branch"), [])

    selection, best = select(
        table | {frozenset({"a", "a_second_branch"}): NOISE - 5}, [A, B], correct_shape=correct_shape
    )
    assert best.effects == ("a",)
    assert selection.shape_corrections[frozenset({"a"})].effects == ("a", "a_second_branch")
    assert path(selection)[-1][0] is StepKind.CORRECT_SHAPE
    selection, best = select(
        table | {frozenset({"a", "a_second_branch"}): NOISE + 40}, [A, B], correct_shape=correct_shape
    )
    assert set(best.effects) == {"a", "b"}
    assert (StepKind.CORRECT_SHAPE, frozenset({"a", "a_second_branch"}), False) in path(selection)


ONE_AT_A_TIME = DiscoveryPolicy(budget=SearchBudget(beam_width=1))


def test_an_effect_that_the_others_make_unnecessary_is_dropped():
    table = costs(9000, a=3000, b=5000, c=5000, a__b=2500, a__c=2600, b__c=1010, a__b__c=1005)
    selection, best = select(table, [A, B, C], ONE_AT_A_TIME)
    assert set(best.effects) == {"b", "c"}
    assert (StepKind.ADD, frozenset({"a", "b", "c"}), True) in path(selection)
    assert (StepKind.DROP, frozenset({"b", "c"}), True) in path(selection)


def test_an_effect_is_swapped_for_a_better_one():
    table = costs(9000, a=3000, b=4000, c=4500, a__b=1600, a__c=2500, b__c=1100)
    policy = DiscoveryPolicy(budget=SearchBudget(beam_width=1, most_effects=2))
    selection, best = select(table, [A, B, C], policy)
    assert set(best.effects) == {"b", "c"}
    assert (StepKind.SWAP, frozenset({"b", "c"}), True) in path(selection)


def test_a_second_effect_is_replaced_by_its_child_where_structure_is_left():
    table = costs(9000, a=3000, parent=4000, child=3950, a__parent=2000, a__child=NOISE)
    _, best = select(table, [A, PARENT, CHILD])
    assert set(best.effects) == {"a", "child"}


@pytest.mark.parametrize(
    ("parent", "child", "name"),
    [
        (NOISE + 8, NOISE, "parent"),  # less than ten in cost: the simpler one keeps the name
        (1300.0, NOISE, "child"),
        (1000 * LIMIT / COUNT + 60, NOISE, "child"),  # where only the child leaves noise, ten counts and no share
    ],
)
def test_the_simpler_member_of_a_family_keeps_the_name_unless_the_richer_is_clearly_better(parent, child, name):
    _, best = select(costs(1e6, parent=parent, child=child), [PARENT, CHILD])
    assert best.effects == (name,)


def test_a_share_of_the_gain_is_allowed_where_both_members_leave_more_than_noise():
    # 0.3 % of what the child gains is 2700 here.
    _, best = select(costs(1e6, parent=102_600, child=100_000), [PARENT, CHILD])
    assert best.effects == ("parent",)
    _, best = select(costs(1e6, parent=103_000, child=100_000), [PARENT, CHILD])
    assert best.effects == ("child",)


def test_children_are_tried_after_their_parents_and_only_of_those_that_lead():
    others = [toy_effect(f"other_{k}") for k in range(6)]
    table = costs(9000, parent=8000, child=NOISE, **{f"other_{k}": 2000 + k for k in range(6)})
    selection, best = select(table, [*others, PARENT, CHILD])
    assert best.effects != ("child",)
    assert frozenset({"child"}) not in selection.fits
    selection, best = select(table | {frozenset({"parent"}): 1500.0}, [*others, PARENT, CHILD])
    assert best.effects == ("child",)


def test_every_generation_is_reached():
    table = costs(1e6, parent=50_000, child=20_000, grandchild=NOISE)
    _, best = select(table, [PARENT, CHILD, GRANDCHILD])
    assert best.effects == ("grandchild",)


def test_rivals_are_of_the_same_size_within_the_tie_and_no_relatives():
    table = costs(9000, a=1000, b=1008, c=1012, parent=1001, child=999.5)
    selection, _ = select(table, [A, B, C, PARENT, CHILD])
    a = selection.fits[frozenset({"a"})]
    names = {fit.effects[0] for fit in selection.find_rivals(a)}
    assert names == {"b", "parent", "child"}  # c is 12 behind
    parent = selection.fits[frozenset({"parent"})]
    assert "child" not in {fit.effects[0] for fit in selection.find_rivals(parent)}
    checks = selection.tie_checks(a, selection.find_rivals(a))
    assert {check.subject for check in checks} == names


@pytest.mark.parametrize(
    ("cubic", "name"),
    [
        (NOISE + 20, "cubic"),  # ln(1000) = 6.9 for each constant: 6 behind, a tie
        (NOISE + 30, "hysteresis"),  # 16 behind
        (NOISE - 1, "cubic"),
    ],
)
def test_of_equals_without_kinship_the_simplest_is_the_answer(cubic, name):
    """A hysteresis of three constants follows whatever a cubic spring does; the other one is told as a rival."""
    hysteresis = toy_effect("hysteresis", constants=3)
    selection, best = select(costs(1e6, cubic=cubic, hysteresis=NOISE), [hysteresis, toy_effect("cubic")])
    assert best.effects == (name,)
    assert len(selection.find_rivals(best)) == (cubic == NOISE + 20)
    if cubic == NOISE + 20:
        assert path(selection)[-1] == (StepKind.SIMPLIFY, frozenset({"cubic"}), True)
        assert selection.steps[-1].checks


def test_a_baseline_stuck_in_a_wrong_place_is_no_false_alarm():
    class Stuck(FakeProblem):
        """Refitted from the constants of an extended model, the plain one is as good as that."""

        def refit_best(self, model, starts, *_, **__):
            fit = self._fit(model)
            if not model.effects:
                object.__setattr__(fit, "cost", NOISE)
            return fit

    problem = Stuck(costs(9000, a=NOISE))
    selection = StepwiseSelection(
        problem, [A], None, DiscoveryPolicy(), lambda text: None, measure_autocorrelation=leaves_noise
    )
    best = selection.select()
    assert best.effects == ()
    assert best.cost == NOISE
    assert path(selection) == [(StepKind.ADD, frozenset({"a"}), False)]


def test_structure_in_the_residual_alone_asks_for_another_effect():
    table = costs(9000, a=LIMIT - 5, b=5000, a__b=LIMIT - 80)
    _, best = select(table, [A, B])
    assert best.effects == ("a",)  # only noise is left
    selection, _ = select(table, [A, B], autocorrelation=lambda fit, lags: 1.0)
    assert (StepKind.ADD, frozenset({"a", "b"}), False) in path(selection)  # tried, and not enough


def test_every_step_has_its_checks():
    selection, _ = select(costs(9000, a=2000, b=3000, a__b=NOISE), [A, B])
    assert all(step.checks for step in selection.steps)
    first = selection.steps[0]
    assert [str(check.rule) for check in first.checks] == ["criterion_gain", "explained_excess"]


class _StuckProblem(FakeProblem):
    """Its refits from starting points end in a bad minimum; only from where the smaller model ended do they find the way."""

    def plan_refit(self, model, starts, *plan, **options):
        return RefitJob(model, tuple(starts), 1, 1)

    def refit_all(self, jobs: Sequence[RefitJob]) -> list[FittedCandidate | None]:
        return [self._refit(job) for job in jobs]

    def _refit(self, job: RefitJob) -> FittedCandidate:
        fit = self._fit(job.model)
        if job.starts != (dict(self.model.values),):
            object.__setattr__(fit, "cost", 1e6)
        return fit


def test_a_model_with_an_effect_more_never_ends_above_the_model_without():
    selection = StepwiseSelection(
        _StuckProblem(costs(9000, a=NOISE, b=9000)),
        [A, B],
        scales=None,
        policy=DiscoveryPolicy(),
        on_message=lambda text: None,
        measure_autocorrelation=leaves_noise,
        correct_shape=lambda *_: None,
    )
    assert selection.select().effects == ("a",)
    assert all(fit.cost <= 9000 for fit in selection.single_effects)
