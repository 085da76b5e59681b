"""Titles, questions, verdicts and notes of the pages that `greybox.report` writes."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from greybox.base.findings import Finding
from greybox.show.sentences.registry import Template, register
from greybox.show.sentences.wording import capitalise, count_noun, join_names, record_text


class PageText(StrEnum):
    """What pages say, page by page; what several of them say comes first."""

    LINEAR_VERDICT = "page_linear_verdict"
    RECORD = "page_record"
    RECORD_USE = "page_record_use"
    RECORD_FINDING = "page_record_finding"
    RECORDS = "page_records"
    SIGNALS = "page_signals"
    NOISE_SOURCE = "page_noise_source"
    NOT_DRAWN = "page_not_drawn"
    STATEMENT = "page_statement"
    ABOUT = "page_about"
    COMMAND = "page_command"
    COMPUTATION = "page_computation"
    OPTIONS = "page_options"
    POLICY_NOTE = "page_policy_note"
    VERSIONS = "page_versions"
    OPTIONS_AND_VERSIONS = "page_options_and_versions"

    FIT_TITLE = "page_fit_title"
    FIT_QUESTION = "page_fit_question"
    FIT_FAILED = "page_fit_failed"
    FIT_NUMBERS_OF_FAILURE = "page_fit_numbers_of_failure"
    RESIDUAL_IS_NOISE = "page_residual_is_noise"
    RESIDUAL_EXCEEDS_NOISE = "page_residual_exceeds_noise"
    NOISE_UNKNOWN = "page_noise_unknown"
    NOTHING_FITTED = "page_nothing_fitted"
    PARAMETERS_DETERMINED = "page_parameters_determined"
    PARAMETERS_OPEN = "page_parameters_open"
    VALIDATED = "page_validated"
    NOT_VALIDATED = "page_not_validated"
    PARAMETERS = "page_parameters"
    INTERVALS_SANDWICH = "page_intervals_sandwich"
    INTERVALS_LIKELIHOOD = "page_intervals_likelihood"
    INTERVALS_GAUSS_NEWTON = "page_intervals_gauss_newton"
    WOULD_DETERMINE = "page_would_determine"
    MOVE_TOGETHER = "page_move_together"
    MISFIT_FITTED = "page_misfit_fitted"
    MISFIT_ONE_STEP = "page_misfit_one_step"
    MISFIT_VALIDATION = "page_misfit_validation"
    MISFIT_BY_RECORD = "page_misfit_by_record"
    FIT_NOT_TESTED = "page_fit_not_tested"
    STATES_NOT_TESTED = "page_states_not_tested"
    TESTS_ALARM = "page_tests_alarm"
    TESTS_CLEAR = "page_tests_clear"
    TESTS = "page_tests"
    TESTS_NOTE = "page_tests_note"

    CHECK_TITLE = "page_check_title"
    CHECK_QUESTION = "page_check_question"
    CHECK_DOUBT = "page_check_doubt"
    CHECK_COMPLETE = "page_check_complete"
    CHECK_OPEN = "page_check_open"
    CHECK_REMEDY = "page_check_remedy"
    CHECK_PRECISION = "page_check_precision"
    CHECK_COMBINATIONS = "page_check_combinations"
    CHECK_DETERMINED = "page_check_determined"
    CHECK_UNDETERMINED = "page_check_undetermined"
    CHECK_REMEDIES = "page_check_remedies"
    CHECK_ASSUMED = "page_check_assumed"
    CHECK_NOISE = "page_check_noise"

    COMPARISON_TITLE = "page_comparison_title"
    COMPARISON_QUESTION = "page_comparison_question"
    COMPARISON_TRAINING = "page_comparison_training"
    COMPARISON_ERRORS = "page_comparison_errors"
    COMPARISON_LEGEND = "page_comparison_legend"
    COMPARISON_MODELS = "page_comparison_models"
    COMPARISON_MODELS_NOTE = "page_comparison_models_note"
    COMPARISON_SKIP = "page_comparison_skip"

    DISCOVERY_TITLE = "page_discovery_title"
    DISCOVERY_QUESTION = "page_discovery_question"
    DISCOVERY_EFFECT = "page_discovery_effect"
    DISCOVERY_NEXT = "page_discovery_next"
    DISCOVERY_ERRORS = "page_discovery_errors"
    DISCOVERY_PATH = "page_discovery_path"
    DISCOVERY_SITES = "page_discovery_sites"
    DISCOVERY_SITES_NOTE = "page_discovery_sites_note"
    DISCOVERY_RIVAL = "page_discovery_rival"
    DISCOVERY_ALL_CANDIDATES = "page_discovery_all_candidates"
    DISCOVERY_CANDIDATES = "page_discovery_candidates"
    DISCOVERY_CANDIDATES_NOTE = "page_discovery_candidates_note"
    DISCOVERY_PARAMETERS = "page_discovery_parameters"
    DISCOVERY_REFINEMENT = "page_discovery_refinement"

    DEMO_TITLE = "page_demo_title"
    DEMO_QUESTION = "page_demo_question"
    DEMO_PLAIN = "page_demo_plain"
    DEMO_TRUTH = "page_demo_truth"
    DEMO_PARAMETERS = "page_demo_parameters"

    EXPORT_TITLE = "page_export_title"
    EXPORT_QUESTION = "page_export_question"
    EXPORT_VERDICT = "page_export_verdict"
    EXPORT_WRITTEN = "page_export_written"
    EXPORT_OF_FAILED_FIT = "page_export_of_failed_fit"
    EXPORT_FILES = "page_export_files"
    EXPORT_CONTENT = "page_export_content"

    LINEAR_TITLE = "page_linear_title"
    LINEAR_QUESTION = "page_linear_question"
    LINEAR_POINT = "page_linear_point"
    LINEAR_POLES = "page_linear_poles"
    LINEAR_CHANNELS = "page_linear_channels"
    LINEAR_FAMILY = "page_linear_family"
    LINEAR_MATRIX = "page_linear_matrix"
    LINEAR_DIGITS = "page_linear_digits"
    LINEAR_OPERATING_POINT = "page_linear_operating_point"
    LINEAR_DELAYS = "page_linear_delays"
    LINEAR_PARAMETERS = "page_linear_parameters"

    SIMULATION_TITLE = "page_simulation_title"
    SIMULATION_QUESTION = "page_simulation_question"
    SIMULATION_OVERFLOW = "page_simulation_overflow"
    SIMULATION_RUN = "page_simulation_run"
    SIMULATION_NOISE = "page_simulation_noise"
    SIMULATION_RANGES = "page_simulation_ranges"
    SIMULATION_PARAMETERS = "page_simulation_parameters"

    DESIGN_TITLE = "page_design_title"
    DESIGN_QUESTION = "page_design_question"
    DESIGN_RECORD = "page_design_record"
    DESIGN_BRINGS = "page_design_brings"
    DESIGN_CONSTANTS = "page_design_constants"
    DESIGN_SEPARATION = "page_design_separation"
    DESIGN_DETECTION = "page_design_detection"
    DESIGN_LIMITS = "page_design_limits"
    DESIGN_ALTERNATIVES = "page_design_alternatives"
    DESIGN_SCALE = "page_design_scale"

    CHANGED_TITLE = "page_changed_title"
    CHANGED_QUESTION = "page_changed_question"
    CHANGED_COURSE = "page_changed_course"
    CHANGED_KIND = "page_changed_kind"
    CHANGED_CONSTANTS = "page_changed_constants"
    CHANGED_NOTE = "page_changed_note"
    CHANGED_POPULATION = "page_changed_population"
    CHANGED_MACHINES = "page_changed_machines"
    CHANGED_POINTS = "page_changed_points"

    CAMPAIGN_TITLE = "page_campaign_title"
    CAMPAIGN_QUESTION = "page_campaign_question"
    CAMPAIGN_STEPS = "page_campaign_steps"
    CAMPAIGN_WIDTHS = "page_campaign_widths"
    CAMPAIGN_FILES = "page_campaign_files"
    CAMPAIGN_STEP = "page_campaign_step"


SECTIONS: Mapping[str, str] = {
    "section_alternatives": "Alternatives",
    "section_behaviour": "Behaviour",
    "section_changes": "What changed",
    "section_checks": "Checks",
    "section_brings": "What it brings",
    "section_candidates": "Candidates",
    "section_data": "Data",
    "section_errors": "Errors",
    "section_expected": "What the records can determine",
    "section_extended": "The extended model",
    "section_files": "Files",
    "section_fit": "The fit",
    "section_further": "Further effects",
    "section_gap": "Error before and after",
    "section_input": "The input",
    "section_limits": "Limits",
    "section_localisation": "Localisation of the missing effect",
    "section_matrices": "Matrices",
    "section_misfit": "Measured and simulated",
    "section_missing": "The missing signal",
    "section_model": "The model",
    "section_models": "Models",
    "section_parameters": "Parameters",
    "section_parameters-before-after": "Parameters before and after",
    "section_physics": "The physical models",
    "section_plain": "The plain model",
    "section_point": "Operating point and parameters",
    "section_repeat": "How to repeat it",
    "section_residual": "Tests of the residual",
    "section_run": "The run",
    "section_runs": "Runs",
    "section_steps": "Experiments",
    "section_structure": "What any record could determine",
    "section_today": "Records and model of today",
    "section_truth": "Parameters and true values",
}
"""Titles of sections: ``section_`` and the name of the section."""


def _ratios(f: Finding) -> str:
    """``1.02 times the noise in x and 0.98 times the noise in i``; ``at least`` where the noise is only bounded."""
    bounded = f.values.get("at_least", ())
    ratios = f.values["ratios"].items()
    return join_names(
        [f"{'at least ' * (name in bounded)}{ratio:.3g} times the noise in {name}" for name, ratio in ratios]
    )


def _fit_question(f: Finding) -> str:
    v = f.values
    records = f"{count_noun(v['records'], 'record')} ({count_noun(v['rows'], 'row')})"
    fixed = f" {join_names(v['fixed'])} {'is' if len(v['fixed']) == 1 else 'are'} fixed." if v["fixed"] else ""
    if not v["free"]:
        return f"How well does the model follow {records}?{fixed}"
    return f"Which values of {join_names(v['free'])} make the model follow {records}?{fixed}"


def _determined(f: Finding) -> str:
    free, width = f.values["free"], f.values["widest"]
    if len(free) == 1:
        limit = "" if width is None else f"; its 95 % interval reaches {width:.2g} % to either side"
        return f"{free[0]} is determined{limit}."
    limit = "" if width is None else f"; the widest 95 % interval reaches {width:.2g} % to either side"
    return f"All {len(free)} fitted parameters are determined{limit}."


def _alarms(f: Finding) -> str:
    alarms, count = f.values["alarms"], f.values["tests"]
    return f"{alarms} of {count} tests {'raises' if alarms == 1 else 'raise'} an alarm: the residual contains more than noise."


def _comparison_question(f: Finding) -> str:
    records = (
        "records that no model was fitted to" if f.values["validation"] else "the records that they were fitted to"
    )
    models = count_noun(f.values["models"], "model")
    return (
        f"Which model of {join_names(f.values['outputs'])} is best? {models}, compared on the same rows of {records}."
    )


def _effect(f: Finding) -> str:
    look_alike = "The nearest look-alike is " if f.values["look_alike"] else ""
    return f"{look_alike}{f.subject} ({f.values['site']}): {join_names(f.values['parameters'])}."


def _simulation_run(f: Finding) -> str:
    v = f.values
    return (
        f"Free run over {count_noun(v['rows'], 'row')}, {v['duration']:.4g} s, sampled every {v['sampling_time']}; integrated by"
        f" {v['discretisation']}."
    )


def _linear_question(f: Finding) -> str:
    inputs, outputs = (join_names(f.values[key]) or "the states" for key in ("inputs", "outputs"))
    return f"How do small deviations of {inputs} change {outputs}? This model is for controller design."


def _linear_verdict(f: Finding) -> str:
    v = f.values
    states = count_noun(v["states"], "state")
    if v["dt"]:
        return f"A linear model with {states}, sampled every {v['dt']:g} s ({v['method']}); it is {v['stability']}."
    return f"A continuous linear model with {states}; it is {v['stability']}."


def _design_brings(f: Finding) -> str:
    v = f.values
    if v["pair"]:
        return f"With it, the wrong explanation of the pair hardest to tell apart, {v['pair']}, loses by {v['cost']:.3g} in the cost."
    if v["shares"]:
        shares = sorted(v["shares"].values())
        size = f"{shares[0]:.2g}" if len(shares) == 1 else f"{shares[0]:.2g} to {shares[-1]:.2g}"
        return f"With it, the intervals of {join_names(list(v['shares']))} shrink to {size} of what they are."
    known = f"With it, every constant is known to {100 * v['largest']:.2g} % or better"
    return f"{known} (standard deviation); {f.subject} is the least certain."


TEMPLATES: Mapping[str, Template] = {
    PageText.RECORD: lambda f: capitalise(record_text(f.subject)),
    PageText.RECORD_USE: lambda f: (
        f"{'Validation' if f.values['validation'] else 'Estimation'} {record_text(f.subject)}"
    ),
    PageText.RECORD_FINDING: "Record {text}",
    PageText.RECORDS: "Records",
    PageText.SIGNALS: "Signals over all records",
    PageText.NOISE_SOURCE: "Noise: {source}",
    PageText.NOT_DRAWN: lambda f: (
        f"The tables include {count_noun(f.values['records'], 'more record')} that {'is' if f.values['records'] == 1 else 'are'} not drawn."
    ),
    PageText.STATEMENT: "{text}",
    PageText.ABOUT: "{subject}: {text}",
    PageText.COMMAND: "In the shell",
    PageText.COMPUTATION: "How it was computed",
    PageText.OPTIONS: "Options",
    PageText.POLICY_NOTE: "Numbers of the policy that are not listed have their default values.",
    PageText.VERSIONS: "Versions",
    PageText.OPTIONS_AND_VERSIONS: "Options and versions",
    # The page of a fit
    PageText.FIT_TITLE: "Fit of {subject}",
    PageText.FIT_QUESTION: _fit_question,
    PageText.FIT_FAILED: "The fit did not succeed: {reason}.",
    PageText.FIT_NUMBERS_OF_FAILURE: (
        "The numbers below are those of the last point of the search. Use them only for diagnosis."
    ),
    PageText.RESIDUAL_IS_NOISE: lambda f: f"The model explains the estimation records: the residual is {_ratios(f)}.",
    PageText.RESIDUAL_EXCEEDS_NOISE: lambda f: (
        f"The model does not explain the estimation records: the residual is {_ratios(f)}. Either the model lacks an effect, which"
        " greybox discover searches for, or the noise is larger than assumed. Its parameters may be biased."
    ),
    PageText.NOISE_UNKNOWN: "The noise is not known, so the misfit cannot be judged.",
    PageText.NOTHING_FITTED: "No parameter was fitted.",
    PageText.PARAMETERS_DETERMINED: _determined,
    PageText.PARAMETERS_OPEN: lambda f: (
        f"The records do not determine {join_names(f.values['open'])}: the 95 % interval exceeds half the value."
    ),
    PageText.VALIDATED: lambda f: (
        f"On {count_noun(f.values['records'], 'validation record')} the residual is {_ratios(f)}."
    ),
    PageText.NOT_VALIDATED: "The fit was not validated. Give a second record to validate the parameters.",
    PageText.PARAMETERS: "Parameters with standard deviations and 95 % intervals",
    PageText.INTERVALS_SANDWICH: (
        "The residual is not white. The intervals allow for its colour, which widened them up to {widening:.3g} times."
    ),
    PageText.INTERVALS_LIKELIHOOD: "The intervals are from the information matrix of the likelihood; the innovations are white.",
    PageText.INTERVALS_GAUSS_NEWTON: "The intervals are from the Gauss-Newton covariance; the residual is white.",
    PageText.WOULD_DETERMINE: "How to determine the other parameters",
    PageText.MOVE_TOGETHER: "Correlation of the fitted parameters",
    PageText.MISFIT_FITTED: "Free run on the estimation records",
    PageText.MISFIT_ONE_STEP: "Prediction one sample ahead on the estimation records",
    PageText.MISFIT_VALIDATION: "Free run on the validation records",
    PageText.MISFIT_BY_RECORD: "Record by record",
    PageText.FIT_NOT_TESTED: "The fit did not succeed, so its residual was not tested.",
    PageText.STATES_NOT_TESTED: (
        "The residual was not tested: states that are estimated along the record absorb the missing effects."
    ),
    PageText.TESTS_ALARM: _alarms,
    PageText.TESTS_CLEAR: "None of {tests} tests raises an alarm: the residual shows nothing but noise.",
    PageText.TESTS: "Tests of the residual",
    PageText.TESTS_NOTE: "Each test raises a false alarm (p below {level:g}) in one of a hundred correct fits.",
    # The page of a check
    PageText.CHECK_TITLE: "Check of {subject}",
    PageText.CHECK_QUESTION: lambda f: (
        f"Can {join_names(f.values['free']) or 'the parameters'} be determined? This is checked before the fit."
    ),
    PageText.CHECK_DOUBT: "The check has no answer: {reason}",
    PageText.CHECK_COMPLETE: lambda f: (
        f"{'A record such as this one determines' if f.values['assumed'] else 'These records determine'} every free parameter, if the"
        " model is right."
    ),
    PageText.CHECK_OPEN: lambda f: (
        f"{'A record such as this one does' if f.values['assumed'] else 'These records do'} not determine {join_names(f.values['open'])}."
    ),
    PageText.CHECK_REMEDY: "Remedy: {text}",
    PageText.CHECK_PRECISION: "Expected standard deviations of a fit near the start values, if the model is right",
    PageText.CHECK_COMBINATIONS: "Combinations that the records determine",
    PageText.CHECK_DETERMINED: "Determined by any record",
    PageText.CHECK_UNDETERMINED: "Not determined by any record",
    PageText.CHECK_REMEDIES: "Remedies",
    PageText.CHECK_ASSUMED: "No records were given. The check uses a simulated one: {text}",
    PageText.CHECK_NOISE: lambda f: f"Noise: {join_names(f.values['sizes'])}; {f.values['source']}",
    # The page of a comparison
    PageText.COMPARISON_TITLE: "Comparison of grey-box and black-box models",
    PageText.COMPARISON_QUESTION: _comparison_question,
    PageText.COMPARISON_TRAINING: "On the estimation records",
    PageText.COMPARISON_ERRORS: lambda f: (
        f"{f.subject}, {'validation' if f.values['validation'] else 'estimation'} records, "
        + (
            f"{f.values['rows'][0]} rows"
            if len(f.values["rows"]) == 1
            else f"{join_names([str(n) for n in f.values['rows']])} rows: not the same for every model"
        )
    ),
    PageText.COMPARISON_LEGEND: "Click a name in the legend to hide that model; double-click to show it alone.",
    PageText.COMPARISON_MODELS: "Models",
    PageText.COMPARISON_MODELS_NOTE: (
        "Numbers: fitted parameters or coefficients. BIC: of the free run on the estimation records; lower is better."
    ),
    PageText.COMPARISON_SKIP: "The comparison omits the first {rows} rows of each record.",
    # The page of a discovery
    PageText.DISCOVERY_TITLE: "Effects that {subject} lacks",
    PageText.DISCOVERY_QUESTION: "Which effect, if any, does {subject} lack?",
    PageText.DISCOVERY_EFFECT: _effect,
    PageText.DISCOVERY_NEXT: "Next step: {text}",
    PageText.DISCOVERY_ERRORS: "Rms error of the free run on the validation records",
    PageText.DISCOVERY_PATH: "Misfit on the estimation records, one effect after the other",
    PageText.DISCOVERY_SITES: "Sites, likeliest first",
    PageText.DISCOVERY_SITES_NOTE: (
        "These sensors cannot distinguish the sites of one set. Gain: how much the signal raises the log-likelihood."
    ),
    PageText.DISCOVERY_RIVAL: "{subject} explains the records as well.",
    PageText.DISCOVERY_ALL_CANDIDATES: lambda f: f"All {count_noun(f.values['count'], 'candidate')}",
    PageText.DISCOVERY_CANDIDATES: "Candidates",
    PageText.DISCOVERY_CANDIDATES_NOTE: (
        "Behind: difference of Schwarz's criterion from that of the best candidate; 10 or more is decisive."
    ),
    PageText.DISCOVERY_PARAMETERS: "Parameters: those of the plain model absorb part of the missing effect",
    PageText.DISCOVERY_REFINEMENT: "Further effects, each with the share of the rms misfit that it removes",
    # The page of the demonstration
    PageText.DEMO_TITLE: "Demonstration: from the first fit to the controller",
    PageText.DEMO_QUESTION: (
        "A simulated micro-motion actuator has an effect that its model lacks. Does the program detect and identify the effect, and does"
        " the extended model have smaller errors?"
    ),
    PageText.DEMO_PLAIN: "In {subject}, the residual of the plain model is {ratio:.3g} times the noise.",
    PageText.DEMO_TRUTH: lambda f: (
        f"Every fitted parameter is within {f.values['deviation']:.1f} standard deviations of its true value:"
        f" {join_names(f.values['names'])}."
    ),
    PageText.DEMO_PARAMETERS: "Start values, estimates and true values",
    # The page of an export
    PageText.EXPORT_TITLE: "{subject} as {kind}",
    PageText.EXPORT_QUESTION: "The fitted model {subject}, for use outside this program.",
    PageText.EXPORT_VERDICT: "The nonlinear model with the fitted parameters, as {kind}.",
    PageText.EXPORT_WRITTEN: lambda f: (
        f"{count_noun(len(f.values['files']), 'file')} written: {', '.join(f.values['files'])}."
    ),
    PageText.EXPORT_OF_FAILED_FIT: "The fit did not succeed: do not use this export.",
    PageText.EXPORT_FILES: "Files",
    PageText.EXPORT_CONTENT: "Content of {subject}",
    # The page of a linear model
    PageText.LINEAR_TITLE: "{subject} as a linear model",
    PageText.LINEAR_QUESTION: _linear_question,
    PageText.LINEAR_VERDICT: _linear_verdict,
    PageText.LINEAR_POINT: lambda f: f"It holds for small deviations from {join_names(f.values['point'])}.",
    PageText.LINEAR_POLES: lambda f: "Poles (z)" if f.values["sampled"] else "Poles",
    PageText.LINEAR_CHANNELS: "Channels",
    PageText.LINEAR_FAMILY: lambda f: (
        f"{count_noun(f.values['models'], 'model')} drawn from the covariance of the parameters (seed {f.values['seed']}) show the"
        " uncertainty."
    ),
    PageText.LINEAR_MATRIX: "Matrix {subject}: effect of the columns on the rows",
    PageText.LINEAR_DIGITS: "Matrices with all digits",
    PageText.LINEAR_OPERATING_POINT: "Operating point",
    PageText.LINEAR_DELAYS: "Delays that the matrices do not include",
    PageText.LINEAR_PARAMETERS: "Parameters of the model",
    # The page of a simulation
    PageText.SIMULATION_TITLE: "Simulation of {subject}",
    PageText.SIMULATION_QUESTION: lambda f: (
        f"How does {f.subject} respond to {join_names(f.values['inputs']) or 'no input'}?"
    ),
    PageText.SIMULATION_OVERFLOW: "The run overflows {time:.4g} s after its start and ends there.",
    PageText.SIMULATION_RUN: _simulation_run,
    PageText.SIMULATION_NOISE: "The written outputs contain added white noise: {sizes}.",
    PageText.SIMULATION_RANGES: "Ranges of the signals",
    PageText.SIMULATION_PARAMETERS: "Parameters of this run",
    # The page of a design
    PageText.DESIGN_TITLE: "The next record of {subject}",
    PageText.DESIGN_QUESTION: "Which record of {subject} should be taken next, within what the rig allows?",
    PageText.DESIGN_RECORD: lambda f: (
        f"Play the {f.values['kind']} input of input.csv: {f.values['duration']:g} s, a row every {f.values['sampling_time']:g} s. It"
        " begins and ends at rest."
    ),
    PageText.DESIGN_BRINGS: _design_brings,
    PageText.DESIGN_CONSTANTS: "Standard deviation of each parameter now, and with this record",
    PageText.DESIGN_SEPARATION: "Cost by which the wrong explanation of each pair would lose, after a refit",
    PageText.DESIGN_DETECTION: "Smallest amount of each effect that is seen now, and with this record",
    PageText.DESIGN_LIMITS: "Limits, and what is predicted under every explanation with a margin for what is not known",
    PageText.DESIGN_ALTERNATIVES: "What could be done instead",
    PageText.DESIGN_SCALE: "Twice as much means intervals half as wide, explanations twice as far apart, or half the amount seen.",
    # The page of a change detection
    PageText.CHANGED_TITLE: "{subject}: {verdict}",
    PageText.CHANGED_QUESTION: lambda f: (
        f"Is {f.subject} what it was when it was fitted to {count_noun(f.values['records'], 'record')}?"
    ),
    PageText.CHANGED_COURSE: "When in {records} records has {subject} changed?",
    PageText.CHANGED_KIND: "Which of {machines} machines of the kind {subject} falls out?",
    PageText.CHANGED_CONSTANTS: "The constants in the fit and today",
    PageText.CHANGED_NOTE: "The intervals are those of the change and hold together; p is corrected for looking at all constants.",
    PageText.CHANGED_POPULATION: "What the machines have in common",
    PageText.CHANGED_MACHINES: "The machines, each with the standard deviation that its records leave",
    PageText.CHANGED_POINTS: "Where constants jump; p is corrected for all constants",
    # The page of a campaign
    PageText.CAMPAIGN_TITLE: "Campaign on {subject}",
    PageText.CAMPAIGN_QUESTION: "Which effects does the rig of {subject} have, and how precisely are its parameters known?",
    PageText.CAMPAIGN_STEPS: "The experiments, in their order",
    PageText.CAMPAIGN_WIDTHS: "Half width of the 95 % interval of each parameter after each experiment, over its value, and the value now",
    PageText.CAMPAIGN_FILES: "What the folder of each experiment holds: the input and why, the record, what was learnt from it",
    PageText.CAMPAIGN_STEP: "experiment {subject}",
    **SECTIONS,
}

register(TEMPLATES)
