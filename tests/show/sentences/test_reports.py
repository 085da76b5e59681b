"""The words of pages: one golden text for each template."""

from __future__ import annotations

import pytest

from greybox.show.sentences.pages import SECTIONS
from greybox.show.sentences.pages import PageText as T
from greybox.show.sentences.registry import sentence
from greybox.show.sentences.wording import as_sentence, count_noun, join_names, phrase

GOLDEN = [
    (phrase(T.RECORD, "a"), "Record a"),
    (phrase(T.RECORD_USE, "a", validation=True), "Validation record a"),
    (phrase(T.RECORD_USE, "a", validation=False), "Estimation record a"),
    (phrase(T.RECORD_FINDING, text="a: output 'x' has 3 gaps"), "Record a: output 'x' has 3 gaps"),
    (phrase(T.RECORDS), "Records"),
    (phrase(T.SIGNALS), "Signals over all records"),
    (phrase(T.NOISE_SOURCE, source="given"), "Noise: given"),
    (phrase(T.NOT_DRAWN, records=1), "The tables include 1 more record that is not drawn."),
    (phrase(T.NOT_DRAWN, records=4), "The tables include 4 more records that are not drawn."),
    (phrase(T.STATEMENT, text="as it was said"), "as it was said"),
    (phrase(T.ABOUT, "arx", text="as it was said"), "arx: as it was said"),
    (phrase(T.COMMAND), "In the shell"),
    (phrase(T.COMPUTATION), "How it was computed"),
    (phrase(T.OPTIONS), "Options"),
    (phrase(T.POLICY_NOTE), "Numbers of the policy that are not listed have their default values."),
    (phrase(T.VERSIONS), "Versions"),
    (phrase(T.OPTIONS_AND_VERSIONS), "Options and versions"),
    (phrase(T.FIT_TITLE, "rig"), "Fit of rig"),
    (
        phrase(T.FIT_QUESTION, free=["K", "B"], records=2, rows=700, fixed=["M"]),
        "Which values of K and B make the model follow 2 records (700 rows)? M is fixed.",
    ),
    (
        phrase(T.FIT_QUESTION, free=[], records=1, rows=1, fixed=["M", "Ra"]),
        "How well does the model follow 1 record (1 row)? M and Ra are fixed.",
    ),
    (phrase(T.FIT_FAILED, reason="stopped after 1 iteration"), "The fit did not succeed: stopped after 1 iteration."),
    (
        phrase(T.FIT_NUMBERS_OF_FAILURE),
        "The numbers below are those of the last point of the search. Use them only for diagnosis.",
    ),
    (
        phrase(T.RESIDUAL_IS_NOISE, ratios={"x": 0.989, "i": 1.1}),
        "The model explains the estimation records: the residual is 0.989 times the noise in x and 1.1 times the noise in i.",
    ),
    (
        phrase(T.RESIDUAL_IS_NOISE, ratios={"x": 0.905, "i": 1.1}, at_least=["x"]),
        "The model explains the estimation records: the residual is at least 0.905 times the noise in x and 1.1 times the noise in i.",
    ),
    (
        phrase(T.RESIDUAL_EXCEEDS_NOISE, ratios={"x": 113.0}),
        (
            "The model does not explain the estimation records: the residual is 113 times the noise in x. Either the model lacks"
            " an effect, which greybox discover searches for, or the noise is larger than assumed. Its parameters may be biased."
        ),
    ),
    (phrase(T.NOISE_UNKNOWN), "The noise is not known, so the misfit cannot be judged."),
    (phrase(T.NOTHING_FITTED), "No parameter was fitted."),
    (phrase(T.PARAMETERS_DETERMINED, free=["K"], widest=None), "K is determined."),
    (
        phrase(T.PARAMETERS_DETERMINED, free=["K", "B"], widest=0.912),
        "All 2 fitted parameters are determined; the widest 95 % interval reaches 0.91 % to either side.",
    ),
    (
        phrase(T.PARAMETERS_OPEN, open=["K", "B"]),
        "The records do not determine K and B: the 95 % interval exceeds half the value.",
    ),
    (
        phrase(T.VALIDATED, records=2, ratios={"x": 1.0}),
        "On 2 validation records the residual is 1 times the noise in x.",
    ),
    (
        phrase(T.NOT_VALIDATED),
        "The fit was not validated. Give a second record to validate the parameters.",
    ),
    (phrase(T.PARAMETERS), "Parameters with standard deviations and 95 % intervals"),
    (
        phrase(T.INTERVALS_SANDWICH, widening=3.21),
        "The residual is not white. The intervals allow for its colour, which widened them up to 3.21 times.",
    ),
    (
        phrase(T.INTERVALS_LIKELIHOOD),
        "The intervals are from the information matrix of the likelihood; the innovations are white.",
    ),
    (phrase(T.INTERVALS_GAUSS_NEWTON), "The intervals are from the Gauss-Newton covariance; the residual is white."),
    (phrase(T.WOULD_DETERMINE), "How to determine the other parameters"),
    (phrase(T.MOVE_TOGETHER), "Correlation of the fitted parameters"),
    (phrase(T.MISFIT_FITTED), "Free run on the estimation records"),
    (phrase(T.MISFIT_ONE_STEP), "Prediction one sample ahead on the estimation records"),
    (phrase(T.MISFIT_VALIDATION), "Free run on the validation records"),
    (phrase(T.MISFIT_BY_RECORD), "Record by record"),
    (phrase(T.FIT_NOT_TESTED), "The fit did not succeed, so its residual was not tested."),
    (
        phrase(T.STATES_NOT_TESTED),
        "The residual was not tested: states that are estimated along the record absorb the missing effects.",
    ),
    (
        phrase(T.TESTS_ALARM, alarms=1, tests=14),
        "1 of 14 tests raises an alarm: the residual contains more than noise.",
    ),
    (phrase(T.TESTS_ALARM, alarms=3, tests=14), "3 of 14 tests raise an alarm: the residual contains more than noise."),
    (phrase(T.TESTS_CLEAR, tests=14), "None of 14 tests raises an alarm: the residual shows nothing but noise."),
    (phrase(T.TESTS), "Tests of the residual"),
    (
        phrase(T.TESTS_NOTE, level=0.01),
        "Each test raises a false alarm (p below 0.01) in one of a hundred correct fits.",
    ),
    (phrase(T.CHECK_TITLE, "rig"), "Check of rig"),
    (phrase(T.CHECK_QUESTION, free=["K", "B"]), "Can K and B be determined? This is checked before the fit."),
    (phrase(T.CHECK_QUESTION, free=[]), "Can the parameters be determined? This is checked before the fit."),
    (phrase(T.CHECK_DOUBT, reason="the record is empty"), "The check has no answer: the record is empty"),
    (
        phrase(T.CHECK_COMPLETE, assumed=True),
        "A record such as this one determines every free parameter, if the model is right.",
    ),
    (phrase(T.CHECK_COMPLETE, assumed=False), "These records determine every free parameter, if the model is right."),
    (phrase(T.CHECK_OPEN, open=["K"], assumed=True), "A record such as this one does not determine K."),
    (phrase(T.CHECK_OPEN, open=["K"], assumed=False), "These records do not determine K."),
    (phrase(T.CHECK_REMEDY, text="fix K"), "Remedy: fix K"),
    (phrase(T.CHECK_PRECISION), "Expected standard deviations of a fit near the start values, if the model is right"),
    (phrase(T.CHECK_COMBINATIONS), "Combinations that the records determine"),
    (phrase(T.CHECK_DETERMINED), "Determined by any record"),
    (phrase(T.CHECK_UNDETERMINED), "Not determined by any record"),
    (phrase(T.CHECK_REMEDIES), "Remedies"),
    (
        phrase(T.CHECK_ASSUMED, text="a multisine of 1 V"),
        "No records were given. The check uses a simulated one: a multisine of 1 V",
    ),
    (phrase(T.CHECK_NOISE, sizes=["x 0.2 µm", "i 5 mA"], source="given"), "Noise: x 0.2 µm and i 5 mA; given"),
    (phrase(T.COMPARISON_TITLE), "Comparison of grey-box and black-box models"),
    (
        phrase(T.COMPARISON_QUESTION, models=3, outputs=["x", "i"], validation=True),
        "Which model of x and i is best? 3 models, compared on the same rows of records that no model was fitted to.",
    ),
    (
        phrase(T.COMPARISON_QUESTION, models=1, outputs=["x"], validation=False),
        "Which model of x is best? 1 model, compared on the same rows of the records that they were fitted to.",
    ),
    (phrase(T.COMPARISON_TRAINING), "On the estimation records"),
    (phrase(T.COMPARISON_ERRORS, "x", validation=True, rows=[290]), "x, validation records, 290 rows"),
    (phrase(T.COMPARISON_LEGEND), "Click a name in the legend to hide that model; double-click to show it alone."),
    (phrase(T.COMPARISON_MODELS), "Models"),
    (
        phrase(T.COMPARISON_MODELS_NOTE),
        "Numbers: fitted parameters or coefficients. BIC: of the free run on the estimation records; lower is better.",
    ),
    (phrase(T.COMPARISON_SKIP, rows=20), "The comparison omits the first 20 rows of each record."),
    (phrase(T.DISCOVERY_TITLE, "rig"), "Effects that rig lacks"),
    (phrase(T.DISCOVERY_QUESTION, "rig"), "Which effect, if any, does rig lack?"),
    (
        phrase(T.DISCOVERY_EFFECT, "creep", site="force", parameters=["K3 = 5", "c = 1 s"], look_alike=False),
        "creep (force): K3 = 5 and c = 1 s.",
    ),
    (
        phrase(T.DISCOVERY_EFFECT, "creep", site="force", parameters=["K3 = 5"], look_alike=True),
        "The nearest look-alike is creep (force): K3 = 5.",
    ),
    (phrase(T.DISCOVERY_NEXT, text="record at two amplitudes"), "Next step: record at two amplitudes"),
    (phrase(T.DISCOVERY_ERRORS), "Rms error of the free run on the validation records"),
    (phrase(T.DISCOVERY_PATH), "Misfit on the estimation records, one effect after the other"),
    (phrase(T.DISCOVERY_SITES), "Sites, likeliest first"),
    (
        phrase(T.DISCOVERY_SITES_NOTE),
        "These sensors cannot distinguish the sites of one set. Gain: how much the signal raises the log-likelihood.",
    ),
    (phrase(T.DISCOVERY_RIVAL, "creep"), "creep explains the records as well."),
    (phrase(T.DISCOVERY_ALL_CANDIDATES, count=12), "All 12 candidates"),
    (phrase(T.DISCOVERY_CANDIDATES), "Candidates"),
    (
        phrase(T.DISCOVERY_CANDIDATES_NOTE),
        "Behind: difference of Schwarz's criterion from that of the best candidate; 10 or more is decisive.",
    ),
    (phrase(T.DISCOVERY_PARAMETERS), "Parameters: those of the plain model absorb part of the missing effect"),
    (phrase(T.DISCOVERY_REFINEMENT), "Further effects, each with the share of the rms misfit that it removes"),
    (phrase(T.DEMO_TITLE), "Demonstration: from the first fit to the controller"),
    (
        phrase(T.DEMO_QUESTION),
        (
            "A simulated micro-motion actuator has an effect that its model lacks. Does the program detect and identify the"
            " effect, and does the extended model have smaller errors?"
        ),
    ),
    (phrase(T.DEMO_PLAIN, "x", ratio=98.76), "In x, the residual of the plain model is 98.8 times the noise."),
    (
        phrase(T.DEMO_TRUTH, deviation=1.23, names=["K", "B"]),
        "Every fitted parameter is within 1.2 standard deviations of its true value: K and B.",
    ),
    (phrase(T.DEMO_PARAMETERS), "Start values, estimates and true values"),
    (phrase(T.EXPORT_TITLE, "rig", kind="C"), "rig as C"),
    (phrase(T.EXPORT_QUESTION, "rig"), "The fitted model rig, for use outside this program."),
    (phrase(T.EXPORT_VERDICT, kind="C"), "The nonlinear model with the fitted parameters, as C."),
    (phrase(T.EXPORT_WRITTEN, files=["a.c", "a.h"]), "2 files written: a.c, a.h."),
    (phrase(T.EXPORT_OF_FAILED_FIT), "The fit did not succeed: do not use this export."),
    (phrase(T.EXPORT_FILES), "Files"),
    (phrase(T.EXPORT_CONTENT, "a.c"), "Content of a.c"),
    (phrase(T.LINEAR_TITLE, "rig"), "rig as a linear model"),
    (
        phrase(T.LINEAR_QUESTION, inputs=["u"], outputs=["x", "i"]),
        "How do small deviations of u change x and i? This model is for controller design.",
    ),
    (
        phrase(T.LINEAR_QUESTION, inputs=[], outputs=["x"]),
        "How do small deviations of the states change x? This model is for controller design.",
    ),
    (
        phrase(T.LINEAR_VERDICT, dt=None, method="", states=3, stability="stable"),
        "A continuous linear model with 3 states; it is stable.",
    ),
    (
        phrase(T.LINEAR_VERDICT, dt=0.001, method="zoh", states=1, stability="unstable"),
        "A linear model with 1 state, sampled every 0.001 s (zoh); it is unstable.",
    ),
    (phrase(T.LINEAR_POINT, point=["x = 0 m", "u = 1 V"]), "It holds for small deviations from x = 0 m and u = 1 V."),
    (phrase(T.LINEAR_POLES, sampled=True), "Poles (z)"),
    (phrase(T.LINEAR_POLES, sampled=False), "Poles"),
    (phrase(T.LINEAR_CHANNELS), "Channels"),
    (
        phrase(T.LINEAR_FAMILY, models=8, seed=1),
        "8 models drawn from the covariance of the parameters (seed 1) show the uncertainty.",
    ),
    (phrase(T.LINEAR_MATRIX, "A"), "Matrix A: effect of the columns on the rows"),
    (phrase(T.LINEAR_DIGITS), "Matrices with all digits"),
    (phrase(T.LINEAR_OPERATING_POINT), "Operating point"),
    (phrase(T.LINEAR_DELAYS), "Delays that the matrices do not include"),
    (phrase(T.LINEAR_PARAMETERS), "Parameters of the model"),
    (phrase(T.SIMULATION_TITLE, "rig"), "Simulation of rig"),
    (phrase(T.SIMULATION_QUESTION, "rig", inputs=["u"]), "How does rig respond to u?"),
    (phrase(T.SIMULATION_QUESTION, "rig", inputs=[]), "How does rig respond to no input?"),
    (phrase(T.SIMULATION_OVERFLOW, time=0.25), "The run overflows 0.25 s after its start and ends there."),
    (
        phrase(T.SIMULATION_RUN, rows=50, duration=0.5, sampling_time="0.01 s", discretisation="exact hold"),
        "Free run over 50 rows, 0.5 s, sampled every 0.01 s; integrated by exact hold.",
    ),
    (phrase(T.SIMULATION_NOISE, sizes="x 2e-07 m"), "The written outputs contain added white noise: x 2e-07 m."),
    (phrase(T.SIMULATION_RANGES), "Ranges of the signals"),
    (phrase(T.SIMULATION_PARAMETERS), "Parameters of this run"),
    (phrase(T.CAMPAIGN_TITLE, "rig"), "Campaign on rig"),
    (
        phrase(T.CAMPAIGN_QUESTION, "rig"),
        "Which effects does the rig of rig have, and how precisely are its parameters known?",
    ),
    (phrase(T.CAMPAIGN_STEPS), "The experiments, in their order"),
    (
        phrase(T.CAMPAIGN_WIDTHS),
        "Half width of the 95 % interval of each parameter after each experiment, over its value, and the value now",
    ),
    (
        phrase(T.CAMPAIGN_FILES),
        "What the folder of each experiment holds: the input and why, the record, what was learnt from it",
    ),
    (phrase(T.CAMPAIGN_STEP, "2"), "experiment 2"),
    (phrase(T.CHANGED_TITLE, "rig", verdict="changed"), "rig: changed"),
    (phrase(T.CHANGED_QUESTION, "rig", records=2), "Is rig what it was when it was fitted to 2 records?"),
    (phrase(T.CHANGED_COURSE, "rig", records=12), "When in 12 records has rig changed?"),
    (phrase(T.CHANGED_KIND, "rig", machines=9), "Which of 9 machines of the kind rig falls out?"),
    (phrase(T.CHANGED_CONSTANTS), "The constants in the fit and today"),
    (
        phrase(T.CHANGED_NOTE),
        "The intervals are those of the change and hold together; p is corrected for looking at all constants.",
    ),
    (phrase(T.CHANGED_POPULATION), "What the machines have in common"),
    (phrase(T.CHANGED_MACHINES), "The machines, each with the standard deviation that its records leave"),
    (phrase(T.CHANGED_POINTS), "Where constants jump; p is corrected for all constants"),
    (phrase(T.DESIGN_TITLE, "rig"), "The next record of rig"),
    (
        phrase(T.DESIGN_QUESTION, "rig"),
        "Which record of rig should be taken next, within what the rig allows?",
    ),
    (
        phrase(T.DESIGN_RECORD, kind="PRBS", duration=0.5, sampling_time=0.001),
        "Play the PRBS input of input.csv: 0.5 s, a row every 0.001 s. It begins and ends at rest.",
    ),
    (
        phrase(T.DESIGN_BRINGS, "B", pair="", cost=None, shares={}, largest=0.021),
        "With it, every constant is known to 2.1 % or better (standard deviation); B is the least certain.",
    ),
    (
        phrase(T.DESIGN_BRINGS, "B", pair="", cost=None, shares={"B": 0.61, "K": 0.2}, largest=0.021),
        "With it, the intervals of B and K shrink to 0.2 to 0.61 of what they are.",
    ),
    (
        phrase(T.DESIGN_BRINGS, "", pair="friction / creep", cost=35.2, shares={}, largest=None),
        "With it, the wrong explanation of the pair hardest to tell apart, friction / creep, loses by 35.2 in the cost.",
    ),
    (phrase(T.DESIGN_CONSTANTS), "Standard deviation of each parameter now, and with this record"),
    (phrase(T.DESIGN_SEPARATION), "Cost by which the wrong explanation of each pair would lose, after a refit"),
    (phrase(T.DESIGN_DETECTION), "Smallest amount of each effect that is seen now, and with this record"),
    (
        phrase(T.DESIGN_LIMITS),
        "Limits, and what is predicted under every explanation with a margin for what is not known",
    ),
    (phrase(T.DESIGN_ALTERNATIVES), "What could be done instead"),
    (
        phrase(T.DESIGN_SCALE),
        "Twice as much means intervals half as wide, explanations twice as far apart, or half the amount seen.",
    ),
]


@pytest.mark.parametrize(("item", "text"), GOLDEN, ids=[item.code for item, _ in GOLDEN])
def test_a_page_says(item, text: str) -> None:
    assert sentence(item) == text


def test_every_text_of_pages_is_here() -> None:
    assert {item.code for item, _ in GOLDEN} == set(T)


def test_sections_have_short_titles() -> None:
    for code, title in SECTIONS.items():
        assert code.startswith("section_") and len(title) < 40 and not title.endswith(".")


def test_lists_counts_and_capitals_are_those_of_english() -> None:
    assert [join_names(names) for names in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == [
        "",
        "a",
        "a and b",
        "a, b and c",
    ]
    assert [count_noun(n, "record") for n in (0, 1, 2)] == ["0 records", "1 record", "2 records"]
    # A name at the beginning stays as it is.
    given = ["nothing is missing", "cubic_stiffness is", "x is large", "Done!", ""]
    assert [as_sentence(text) for text in given] == [
        "Nothing is missing.",
        "cubic_stiffness is.",
        "x is large.",
        "Done!",
        "",
    ]
