"""The sentences of fits: one golden text for each template."""

from __future__ import annotations

import pytest

from greybox.base.values import Finding
from greybox.data.noise.noise_model import AutoRegression
from greybox.estimation.findings import EstimationCode
from greybox.estimation.predictor import CorrectionKind, PredictionCorrection
from greybox.estimation.result_parts import SolverReport

POINT = [{"name": "level", "value": "-0.1", "unit": "m"}, {"name": "pump", "value": "0.1", "unit": "m/s"}]
PLACE = {"experiment": 2, "time": 0.5, "row": 6, "point": POINT}
TERM = {
    "kind": "term",
    "name": "outflow",
    "balance": "volume",
    "formula": "k*sqrt(level)",
    "value": "nan",
    "unit": "m/s",
}
NOISE = {"states": ["v"], "balances": ["force"], "unit": "m/s^1.5", "upper_limit": 0.0002}
ONE, TWO = {"parameters": ["K"]}, {"parameters": ["K", "B"]}

GOLDEN = [
    (
        "noise_shared",
        "run 2",
        {"other": "run 1", "shared": 0.93, "judges": False},
        "run 2 and run 1 seem to be one measurement: what the model leaves of them agrees like one noise (correlation 0.93); then its"
        " data count twice, and intervals are too narrow; leave one out",
    ),
    (
        "noise_shared",
        "run 2",
        {"other": "run 1", "shared": 0.93, "judges": True},
        "run 2 and run 1 seem to be one measurement: what the model leaves of them agrees like one noise (correlation 0.93); then it"
        " cannot validate the model; use another record",
    ),
    (
        "input_before_open",
        "run 1",
        {"seconds": 21.3, "first": 330.0, "unit": "K", "input": "Tin", "until": 21.3},
        "record run 1 begins in motion, and for 21.3 s it shows what Tin was before: taken is its first value, 330 K; state another"
        " with --before Tin=VALUE (before=), or begin at --from 21.3, from where the record knows it",
    ),
    (
        "no_freedom",
        "",
        {"readings": 3, "unknowns": 3},
        "3 readings for 3 constants and first states: nothing is left that would tell the noise, so no interval can be given; tell the"
        " noise (--noise), or record more rows",
    ),
    ("misfit_ratio", "x", {"ratio": 1.2, "without_outliers": False}, "misfit 1.20 times the noise in x"),
    (
        "misfit_ratio",
        "x",
        {"ratio": 1.3, "without_outliers": False, "least_ratio": 1.2},
        "misfit at least 1.2 times the noise in x",
    ),
    (
        "misfit_ratio",
        "x",
        {"ratio": 1.2, "without_outliers": True},
        "misfit 1.20 times the noise in x, outliers excluded",
    ),
    (
        "prediction_ratio",
        "x",
        {"one_step": 1.0, "free_run": 7.5},
        "prediction error 1 times the noise in x one step ahead, simulation error 7.5 times",
    ),
    (
        "filter_not_finite",
        "",
        {"experiment": 2},
        "the Kalman filter diverges in experiment 2: its values are not finite",
    ),
    (
        "term_not_finite",
        "outflow",
        {**PLACE, **TERM},
        "the simulation of experiment 2 fails at t = 0.5 s (row 6): the term 'outflow' of balance 'volume' (k*sqrt(level)) is nan"
        " m/s at level = -0.1 m, pump = 0.1 m/s",
    ),
    (
        "term_not_finite",
        "volume",
        {**PLACE, **TERM, "kind": "storage", "formula": "1/A", "value": "inf", "unit": ""},
        "the simulation of experiment 2 fails at t = 0.5 s (row 6): the inverse storage of balance 'volume' (1/A) is inf at level"
        " = -0.1 m, pump = 0.1 m/s",
    ),
    (
        "term_not_finite",
        "y",
        {**PLACE, **TERM, "kind": "output", "name": "y", "formula": "x" * 81},
        "the simulation of experiment 2 fails at t = 0.5 s (row 6): the output 'y' is nan m/s at level = -0.1 m, pump = 0.1 m/s",
    ),
    (
        "term_not_finite",
        "x",
        {**PLACE, **TERM, "kind": "start", "name": "x"},
        "the simulation of experiment 2 fails at t = 0.5 s (row 6): the initial value of state 'x' is nan at level = -0.1 m, pump"
        " = 0.1 m/s",
    ),
    (
        "states_diverge",
        "level",
        PLACE,
        "the simulation of experiment 2 fails at t = 0.5 s (row 6): the states diverge, although every term is"
        " finite; the largest is 'level', at level = -0.1 m, pump = 0.1 m/s",
    ),
    (
        "sensitivity_not_finite",
        "",
        {"experiment": 2},
        "the simulation of experiment 2 succeeds, but its sensitivity to the parameters is not finite: a term has an infinite"
        " slope, as sqrt has at 0; set a bound on the state in this term, or rewrite the term with a finite slope",
    ),
    (
        "plant_run_failed",
        "pump",
        {"experiment": 2, "reason": "the run failed (division by zero)"},
        "pump does not run over experiment 2 from its start values (the run failed (division by zero)): give others"
        " (model.start(...), shell: --start)",
    ),
    (
        "model_does_not_follow",
        "",
        {"best_fit": {"x": 12.0, "i": -45.6}},
        "the model follows only 12 % of x, -46 % of i (best fit; 100 % is a perfect fit, 0 % a constant): do not use these parameters;"
        " check the units and signs of the columns, the fixed parameters, and whether this is the right model",
    ),
    (
        "direction_undetermined",
        "",
        {"direction": {"Kf": 1.0}},
        "not determined by these data: Kf has no influence on the measured outputs, or none that free initial states could not have",
    ),
    (
        "direction_undetermined",
        "",
        {"direction": {"Kf": 1.0, "La": 0.5}},
        "not determined by these data: Kf, La can change together without changing the outputs: fix one of them, or measure another output",
    ),
    (
        "direction_undetermined",
        "",
        {
            "direction": {"a": 1.0, "b": 1.0},
            "directions": [{"a": 1.0, "b": 1.0}],
            "free": 3,
            "determined": [
                {"text": "a - b", "value": 1.2695, "std": 0.0021, "interval": [1.2654, 1.2736], "unit": "V"}
            ],
        },
        "not determined by these data: a, b can change together without changing the outputs: fix one of them, or measure another output;"
        " determined: a - b = 1.2695 +- 0.0021 V, 95 % interval [1.2654, 1.2736]",
    ),
    (
        "direction_undetermined",
        "",
        {"direction": {f"p{k}": 1.0 for k in range(20)}, "directions": [{"p1": 1.0}] * 9, "free": 22, "determined": []},
        "not determined by these data: 20 of 22 constants share 9 free directions: fix 9 of them, or measure other outputs",
    ),
    (
        "direction_undetermined",
        "",
        {"direction": dict.fromkeys("abc", 1.0), "directions": [{"a": 1.0}] * 2, "free": 4, "determined": []},
        "not determined by these data: a, b, c share 2 free directions: fix 2 of them, or measure other outputs",
    ),
    (
        "limited_from_bound",
        "c",
        {"limit": 0.0503, "unit": "1/s", "is_upper": True},
        "c is at its lower bound; the records set an upper limit of 0.0503 1/s (95 %)",
    ),
    (
        "limited_from_bound",
        "c",
        {"limit": None, "unit": "1/s", "is_upper": False},
        "c is at its upper bound, and the records set no lower limit to it",
    ),
    ("stopped_by_bound", "", TWO, "stopped by a bound: K, B; widen the bound, or add the effect that the model lacks"),
    (
        "narrowed_by_bound",
        "p5",
        {"growth": {"p4": 9.83}},
        "p5 is at its bound and counts as exactly known there; with it free, the intervals would be wider: p4 9.8 times",
    ),
    (
        "narrowed_by_bound",
        "p5, p6",
        {"growth": {"p3": 2.41, "p4": None}},
        "p5, p6 are at their bounds and count as exactly known there; with them free, the intervals would be wider: p3 2.4 times and p4"
        " would not be determined",
    ),
    ("parameter_undetermined", "", TWO, "not determined (the 95 % interval exceeds half the value): K, B"),
    (
        "nothing_to_explain",
        "",
        {"best_fit": {"y": -0.372}},
        "the records move no more than their noise (best fit -0.37 % of y): a constant output does as well, and the parameters mean"
        " nothing; use an input that moves the plant",
    ),
    (
        "other_start_taken",
        "",
        {"drawn": 60, "searched": 6, "stands": False, "before": {"y": -0.002}, "after": {"y": 98.72}},
        "the search from the model's own start values explains nothing of y (best fit -0.00 % of y); of 60 other starts the 6 most"
        " promising were searched, and the best follows 98.72 % of y",
    ),
    (
        "other_start_taken",
        "",
        {"drawn": 60, "searched": 6, "trouble": "stands", "before": {"y": 40.0}, "after": {"y": 98.72}},
        "the search from the model's own start values stands where it began (best fit 40.00 % of y); of 60 other starts the 6 most"
        " promising were searched, and the best follows 98.72 % of y",
    ),
    (
        "other_start_taken",
        "",
        {"drawn": 60, "searched": 6, "trouble": "lost_constants", "before": {"y": 82.5}, "after": {"y": 98.72}},
        "the search from the model's own start values ended where some of its constants change nothing (best fit 82.50 % of y); of 60"
        " other starts the 6 most promising were searched, and the best follows 98.72 % of y",
    ),
    (
        "no_start_helps",
        "",
        {"drawn": 60, "searched": 6, "best_fit": {"y": -0.002}},
        "the fit explains nothing of y from the model's own start values and from 6 others: its free run is hardly better than a"
        " constant output (best fit -0.00 % of y); give start values nearer to physical ones, and check units, signs and bounds",
    ),
    (
        "no_start_helps",
        "",
        {"drawn": 60, "searched": 0, "best_fit": {}},
        "no start helps: the model cannot be simulated from any of 60 other starts either; give start values nearer to physical ones, and"
        " check units, signs and bounds",
    ),
    (
        "misfit_above_noise",
        "",
        {"ratios": {"x": 2.0}},
        "the misfit exceeds the noise: the model is incomplete, and its parameters may be biased",
    ),
    (
        "misfit_above_difference_noise",
        "",
        {"ratios": {"x": 2.0}},
        "the misfit exceeds the noise estimated from differences of the records: the model is incomplete, or the noise is"
        " coloured (a quiet record shows which)",
    ),
    (
        "parameter_not_constant",
        "",
        {
            "shifts": [
                {
                    "name": "K",
                    "unit": "N/m",
                    "before": 10.0,
                    "after": 12.0,
                    "deviations": 4.0,
                    "parts": ["experiment:'day 1'", "experiment:'day 2'"],
                }
            ]
        },
        "not constant: between experiment 'day 1' and experiment 'day 2', K changes from 10 to 12 N/m (4 standard"
        " deviations by the noise alone); it compensates for an effect that the model lacks, or the plant changes",
    ),
    (
        "parameter_not_constant",
        "",
        {
            "shifts": [
                {
                    "name": "K",
                    "unit": "N/m",
                    "before": 10.0,
                    "after": 12.0,
                    "deviations": 4.0,
                    "parts": ["first_half:1", "second_half:1"],
                },
                {
                    "name": "B",
                    "unit": "N*s/m",
                    "before": 2.0,
                    "after": 1.0,
                    "deviations": 213.4,
                    "parts": ["first_half:1", "second_half:1"],
                },
            ]
        },
        "not constant: between the first half of the record and the second half of the record, K changes from 10 to 12 N/m (4"
        " standard deviations by the noise alone), B changes from 2 to 1 N*s/m (210 standard deviations by the noise alone); "
        "they compensate for an effect that the model lacks, or the plant changes",
    ),
    (
        "parameter_not_constant",
        "",
        {
            "shifts": [
                {
                    "name": "K",
                    "unit": "N/m",
                    "before": None,
                    "after": None,
                    "deviations": 35.0,
                    "parts": ["experiment:'a'", "experiment:'b'"],
                }
            ]
        },
        "not constant: between experiment 'a' and experiment 'b', K differs (35 standard deviations by the noise alone); it compensates"
        " for an effect that the model lacks, or the plant changes",
    ),
    (
        "residual_correlated",
        "",
        {"outputs": ["x"], "inflation": 3.0},
        "the residual of x is correlated from sample to sample: the intervals allow for it and are up to 3 times as wide as for white"
        " noise",
    ),
    (
        "innovations_correlated",
        "",
        {"inflation": 3.0},
        "the innovations are correlated from sample to sample: the model or its noise model is incomplete; the intervals allow"
        " for it and are up to 3 times as wide as for white innovations",
    ),
    (
        "innovations_correlated",
        "",
        {"inflation": 1.02},
        "the innovations are correlated from sample to sample: the model or its noise model is incomplete; the intervals allow for it",
    ),
    (
        "integration_too_coarse",
        "",
        {"outputs": ["x", "i"]},
        "the integration error exceeds a tenth of the noise in x, i: increase the number of substeps",
    ),
    (
        "input_course_contradicted",
        "u",
        {"courses": {"u": "first"}, "odds": 91.2, "changes": {"tau": [0.468, 0.4993, 13.7], "K": [1.968, 1.998, 9.8]}},
        "the records fit better with input u straight between its rows, with tau = 0.4993 for 0.468 (14 standard deviations), K = 1.998"
        " for 1.968 (9.8 standard deviations): read the records with"
        " hold={'u': 'first'} (shell: --interpolate u=first) and fit anew",
    ),
    (
        "input_course_contradicted",
        "u",
        {"courses": {"u": "zero"}, "odds": 40.0, "changes": {}},
        "the records fit better with input u held between its rows: read the records with"
        " hold={'u': 'zero'} (shell: --interpolate u=zero) and fit anew",
    ),
    (
        "input_course_contradicted",
        "P and Ta",
        {"courses": {"P": "zero", "Ta": "first"}, "odds": 40.0, "changes": {}},
        "the records fit better with input P held between its rows, and Ta straight between its rows: read the records with"
        " hold={'P': 'zero', 'Ta': 'first'} (shell: --interpolate P=zero --interpolate Ta=first) and fit anew",
    ),
    (
        "input_course_open",
        "u",
        # As files of earlier versions have it.
        {"course": "first", "odds": 1.5, "changes": {"tau": [0.47, 0.5, 4.06]}},
        "the records do not tell how input u moves between its rows, and it matters: with u straight between its rows they would give"
        " tau = 0.5 for 0.47 (4.1 standard deviations); if it moves so, read the records with"
        " hold={'u': 'first'} (shell: --interpolate u=first) and fit anew",
    ),
    (
        "input_course_open",
        "u",
        {"courses": {"u": "zero"}, "odds": None, "changes": {}},
        "how input u moves between its rows may matter, and could not be compared with u held between its rows; if it moves so,"
        " read the records with hold={'u': 'zero'} (shell: --interpolate u=zero) and fit anew",
    ),
    (
        "start_in_first_row",
        "run",
        {"states": ["v", "T"], "time": 0.5},
        "record run begins at 0.5 s, and the start of v, T is taken to hold there; where it holds at 0 s, begin the record with a row at"
        " 0 s without a reading",
    ),
    (
        "input_noise_counted",
        "",
        {"levels": {"u": [0.0123, "V"]}, "counted": ["K", "tau"]},
        "input u (about 0.012 V) was measured with noise: the intervals of K, tau count it",
    ),
    (
        "input_noise_biases",
        "",
        {"levels": {"u": [0.0123, "V"], "d": [2.0, "1"]}, "changes": {"K": [1.9, 2.0, 1.24]}},
        "inputs u (about 0.012 V) and d (about 2) were measured with noise, which the fit takes for movement: without it, about K = 2"
        " for 1.9 (1.2 standard deviations); smooth the input over a few rows, or take what drives it",
    ),
    (
        "step_moves_parameters",
        "",
        {"shifts": {"K": 0.25}},
        "with half the integration step the parameters change by more than a tenth of their standard deviation (K by 0.25 standard"
        " deviations): increase the number of substeps",
    ),
    (
        "validation_beyond_range",
        "x",
        {"low": -1e-4, "high": 1e-4, "least": -3e-4, "most": 3e-4, "unit": "m", "share": 0.4},
        "use estimation records that cover the whole range: the validation records reach from -0.0003 to 0.0003 m in x, the"
        " estimation records only from -0.0001 to 0.0001 m (40 % of the validation rows lie beyond)",
    ),
    (
        "validation_error_larger",
        "x",
        {"ratio": 2.5},
        "the simulation error in x is 2.5 times that on the estimation records: a free run accumulates small errors of force and"
        " offset, above all if the plant integrates, and parameters change from day to day; validate on shorter records as well",
    ),
    (
        "prior_conflict",
        "K",
        {"deviations": 3.1},
        "the prior of K and the data disagree by 3.1 standard deviations: one of them, or the model, is wrong",
    ),
    (
        "prior_conflict",
        "K",
        {"deviations": 3.1, "factor": 1.2076, "factor_std": 0.0055},
        "the prior of K and the data disagree by 3.1 standard deviations (the data say 1.2076 +- 0.0055 times its value): one of them,"
        " or the model, is wrong",
    ),
    (
        "prior_conflict",
        "K",
        {"deviations": 31.0, "factor": 57.3, "factor_std": 0.1, "units": "degrees and radians"},
        "the prior of K and the data disagree by 31 standard deviations (the data say 57.30 +- 0.10 times its value: degrees and radians"
        " mistaken?): one of them, or the model, is wrong",
    ),
    (
        "gain_is_unit_factor",
        "sensor_gain",
        {
            **{"kind": "output", "signal": "w", "factor": 0.10472},
            **{"factor_std": 2e-5, "units": "minutes and seconds"},
        },
        "the output w reads 0.104720 +- 0.000020 times the value of the model: minutes and seconds mistaken?",
    ),
    (
        "gain_is_unit_factor",
        "input_gain",
        {**{"kind": "input", "signal": "tau", "factor": 9.807}, **{"factor_std": 0.01, "units": "newton and more"}},
        "9.807 +- 0.010 times the input tau of the record acts: newton and more mistaken?",
    ),
    (
        "residual_of_steps",
        "q",
        {"step": 0.0174533, "share": 0.93},
        "the reading q has steps of 0.0175, which by themselves make 93 % of the mean square of its residual: no model does much better",
    ),
    (
        "residual_of_jitter",
        "x",
        {"jitter": 3.5e-4, "share": 0.8, "usual_step": 0.01},
        "the residual of x grows with the rate at which it moves, as with time stamps that are off by 0.00035 s (standard deviation,"
        " 3.5 % of the step): that makes 80 % of its mean square",
    ),
    (
        "priors_off_alike",
        "",
        {"parameters": ["J", "mgl"], "factor": 1.19, "inputs": ["tau"]},
        "the data say 1.19 times the prior values of J and mgl alike, as a gain of the input tau, or of a sensor does that is off by this"
        " factor: add the effect input_gain or sensor_gain and fit again",
    ),
    (
        "values_by_record",
        "Fc",
        {
            **{"kind": "proportional", "condition": "load", "levels": [1.0, 6.1], "at": [0.1, 0.61], "ratio": 6.1},
            **{"share": 0.99, "also": ["day"], "unit": "N", "records": 4},
        },
        "Fc grows in proportion to load: 6.1 times at 6.1 times the load (0.1 to 0.61 N at 1 to 6.1); in these records day tells as much",
    ),
    (
        "values_by_record",
        "Kw",
        {
            **{"kind": "linear", "condition": "voltage", "levels": [0.0, 3.21], "at": [60.0, 300.0], "ratio": 5.0},
            **{"share": 0.9, "also": [], "unit": "N", "records": 10},
        },
        "Kw grows with voltage: 5 times from 0 to 3.21 (60 to 300 N)",
    ),
    (
        "condition_of_records",
        "load",
        {},
        "load is no constant of the model: constants that each record has for itself are held against it",
    ),
    ("held_by_prior", "", ONE, "determined by its prior: K; the data add little or nothing"),
    ("held_by_prior", "", TWO, "determined by their priors: K, B; the data add little or nothing"),
    (
        "tied_outside_bounds",
        "Kv",
        {"value": 3.0, "unit": "V*s/m", "low": "0", "high": "2"},
        "the tied parameter Kv is outside its bounds: 3 V*s/m, bounds [0, 2] V*s/m",
    ),
    (
        "mean_of_experiments",
        "",
        ONE,
        "each experiment has its own value of K: the fitted model has the mean, and a validation uses the mean",
    ),
    (
        "robust_loss_outliers",
        "",
        {"loss": "huber:1.345", "shares": {"x": 0.031}},
        "robust loss (huber:1.345): 3.1 % of x count as outliers",
    ),
    (
        "robust_loss_outliers",
        "",
        {"loss": "huber:1.345", "shares": {}},
        "robust loss (huber:1.345): no sample counts as an outlier",
    ),
    (
        "too_many_outliers",
        "",
        {"outputs": ["x"]},
        "too many samples of x count as outliers: the model is incomplete, or the noise is larger than assumed",
    ),
    (
        "constant_output_excluded",
        "",
        {"outputs": ["v"]},
        "excluded: v is constant, so its noise cannot be estimated (the sensor may be dead); give its noise to include it",
    ),
    (
        "process_noise_zero",
        "noise_v",
        NOISE,
        "process noise on v (noise_v): zero, below 0.0002 m/s^1.5 at 95 %; these records show no deviation from the balance"
        " 'force'",
    ),
    (
        "process_noise_not_significant",
        "noise_v",
        {**NOISE, "p_value": 0.2},
        "process noise on v (noise_v): not significant (p = 0.2), below 0.0002 m/s^1.5 at 95 %; these records show no certain"
        " deviation from the balance 'force'",
    ),
    (
        "process_noise_significant",
        "noise_v",
        {
            **NOISE,
            "upper_limit": None,
            "intensity": 0.3,
            "ratio": 42.0,
            "period": 0.1,
            "sizes": [{"size": 0.95, "unit": "N"}],
        },
        "process noise on v (noise_v = 0.3 m/s^1.5): significant (likelihood ratio 42); the balance 'force' lacks an effect, or a"
        " random disturbance acts there, of 0.95 N averaged over one sample of 0.1 s",
    ),
    ("noise_colour_ignored", "", {}, "the noise is coloured, but a fit with process noise assumes white noise"),
    (
        "constant_by_record",
        "T0",
        {"value": 273.15, "stated": 0.0, "unit": "K"},
        "T0 is taken as 273.15 K by what the record shows; fix it (--fix T0=VALUE) where you know it",
    ),
    (
        "starts_not_begun",
        "",
        {"left": 12, "starts": 20, "seconds": 60.0},
        "12 of 20 starts were not finished within 60 s; repeat the command to continue with them",
    ),
    (
        "relation_not_met",
        "node",
        {"share": 0.0123, "state": "z"},
        "the balance node stores nothing, and its terms miss zero by 0.012 of the largest: give z a start value of the right size,"
        " and bounds",
    ),
    (
        "starts",
        "",
        {"counts": [3, 2, 1], "ratios": [1.0, 3.4, 9.0], "without_result": 1},
        "3 of 7 starts ended at the best optimum, 2 at a worse one (misfit 3.4 times as large), 1 at a worse one (misfit 9 times as large),"
        " 1 without a result",
    ),
    (
        "starts",
        "",
        {"counts": [1] * 6, "ratios": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "without_result": 0},
        "1 of 6 starts ended at the best optimum, 1 at a worse one (misfit 2 times as large), 1 at a worse one (misfit 3 times as large),"
        " 1 at a worse one (misfit 4 times as large), 2 at still worse ones (from 5 times as large)",
    ),
]


@pytest.mark.parametrize(("code", "subject", "values", "text"), GOLDEN)
def test_a_finding_reads_as_follows(code: str, subject: str, values: dict[str, object], text: str) -> None:
    assert str(Finding(code, subject=subject, values=values)) == text


def test_every_code_of_a_fit_has_a_golden_text() -> None:
    assert {code for code, *_ in GOLDEN} == set(EstimationCode)


def test_a_status_names_its_likely_causes_and_the_misfit() -> None:
    ratio = Finding("misfit_ratio", subject="x", values={"ratio": 1.0, "without_outliers": False})
    assert str(SolverReport("converged", True, 1.0, details=(ratio,))) == "converged; misfit 1.00 times the noise in x"
    failure = Finding("filter_not_finite", values={"experiment": 1})
    assert str(SolverReport("no_start", False, float("inf"), details=(failure,))) == (
        "the model cannot be simulated from the start values. Likely causes, most likely first: (1) start values far from physical ones;"
        " (2) an unstable model over a long record; (3) a missing bound (for example on a level, which cannot be negative)."
        " The Kalman filter diverges in experiment 1: its values are not finite"
    )


class Line:
    """What a correction needs of its model."""

    noisy_states = ("v",)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("none_white", "none: the simulation error is white"),
        ("none_zero", "none: the process noise is zero"),
        ("autoregression", "autoregression of the simulation error (x AR(1))"),
        ("kalman_filter", "Kalman filter, process noise on v"),
        ("estimated_kalman_filter", "Kalman filter, process noise estimated on v"),
    ],
)
def test_a_correction_says_how_it_corrects(kind: str, text: str) -> None:
    colours = {"x": AutoRegression((0.5,)), "y": AutoRegression()}
    assert str(PredictionCorrection(Line(), {}, CorrectionKind(kind), colours)) == text
