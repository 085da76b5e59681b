"""Golden text of every finding and check of a discovery, and of its results."""

import pytest

from greybox.base.values import Check, Finding
from greybox.discovery.claims import Depth
from greybox.discovery.false_names import FalseNameRate
from greybox.discovery.findings import DiscoveryCode as Code
from greybox.discovery.findings import DiscoveryRule as Rule
from greybox.discovery.holdout import HoldoutError
from greybox.discovery.localisation import MisfitTiming
from greybox.show.sentences.discovery import (
    constant_text,
    dependence_text,
    explained_share_text,
    false_names_text,
    shape_text,
    sites_text,
    surrogate_text,
    timing_text,
)
from greybox.show.sentences.wording import percent_text

STEP = {
    "variable": "v",
    "unit": "m/s",
    "share": 0.78,
    "shape": "step",
    "parity": "odd",
    "downwards": True,
    "position": None,
    "loop": 0.02,
    "has_loop": False,
    "tone": None,
    "period": None,
}
CURVE = {
    "site": "balance force",
    "variable": "x",
    "variable_unit": "m",
    "unit": "N",
    "closed": 0.9876,
    "shape": "flat_middle",
    "parity": "odd",
    "downwards": False,
    "position": 4e-5,
    "period": None,
    "amplitude": None,
    "tone": None,
    "beside": [],
    "levels": None,
}
FINDINGS = [
    (Code.NOTHING_MISSING, *("", {}), "No effect is missing: the plain model explains the records down to the noise."),
    (
        Code.PLAIN_UNSETTLED,
        *("", {}),
        "The plain model explains the records down to the noise, but its fit has not settled: whether an effect is missing is open.",
    ),
    (
        Code.PLAIN_WAS_STUCK,
        *("rig", {"before": 12.34, "after": 1.02, "bounded": False}),
        "rig: from its start values the plain model ends at 12.3 times the noise, from others at 1.02 times. What a fit from there leaves"
        " is another optimum and no missing effect: begin at the constants found here (shell: fit the model.py that is written), or take"
        " several starts (--starts 8).",
    ),
    (
        Code.EFFECT_NAMED,
        *("coulomb_friction", {}),
        "The plain model lacks coulomb_friction: with it, only noise is left.",
    ),
    (
        Code.EFFECTS_TIED,
        *("input_offset", {"share": 0.998, "output": "x", "rivals": ["constant_load"], "is_simplest": False}),
        "The plain model lacks one of these effects: input_offset; constant_load. The records cannot distinguish them.",
    ),
    (
        Code.EFFECTS_TIED,
        *("cubic_stiffness", {"share": 0.998, "output": "x", "rivals": ["bouc_wen_hysteresis"], "is_simplest": True}),
        "The plain model lacks one of these effects: cubic_stiffness; bouc_wen_hysteresis. The records cannot distinguish them;"
        " cubic_stiffness is the simplest.",
    ),
    (Code.UNKNOWN_EFFECT, *("", {}), "The model lacks an effect, and no effect of the catalogue is established."),
    (
        Code.NO_LOOK_ALIKE,
        *("cubic_stiffness", {}),
        "What follows the estimation records best, cubic_stiffness, does no better than the plain model on the validation records: the"
        " plain model is the answer.",
    ),
    (
        Code.WORSE_ON_TEST,
        *("cubic_stiffness", {}),
        "What follows the estimation and the validation records best, cubic_stiffness, does worse than the plain model on the test records:"
        " the plain model is the answer.",
    ),
    (
        Code.NEAREST_LOOK_ALIKE,
        *("cubic_stiffness", {}),
        "The nearest look-alike is cubic_stiffness.",
    ),
    (
        Code.HARDLY_VISIBLE,
        *("", {"misfit": 1.02, "bounded": False}),
        "The estimation records hardly show it: the misfit of the plain model there is 1.02 times the noise.",
    ),
    (
        Code.WITHIN_SENSOR_CLASS,
        *("h", {"size": 0.0039, "limit": 0.01}),
        "It may be a sensor that is off: what is missing is 0.39 % of the range of h, and a sensor is commonly off by up to 1 %.",
    ),
    (
        Code.MISSING_SIGNAL,
        *(
            "balance force",
            {"size": 0.00186, "unit": "N", "sites": ["balance force", "input u"], "variable": "v", "dependence": STEP},
        ),
        "The plain model lacks a signal of 0.00186 N rms at the force balance or the input u (these sensors cannot distinguish"
        " them). The signal is a function of v (explains 78 %): odd, a step at zero, downwards.",
    ),
    (
        Code.SURROGATE_FITTED,
        *("balance force", CURVE),
        "As a surrogate, a smooth curve over x (odd, with a flat middle up to about 4e-05 m) at the force balance takes away"
        " 98.8 % of the error on the validation records.",
    ),
    (
        Code.SURROGATE_FITTED,
        *("input u", CURVE | {"site": "input u", "variable": "u", "shape": "too_few_values", "levels": 4}),
        "As a surrogate, a curve of 4 levels over u (too few values to tell its shape) at the input u takes away 98.8 % of the error on the"
        " validation records.",
    ),
    (
        Code.LAW_ESTABLISHED,
        *("", {"laws": [{"equation": "-0.6*a*b", "site": "prey", "unit": "1/s"}], "rivals": []}),
        "The plain model lacks the term -0.6*a*b (1/s) in the prey balance. No law that is simpler or as simple does as well.",
    ),
    (
        Code.LAW_PROBABLE,
        *("", {"laws": [{"equation": "-0.3*abs(v)*v", "site": "force", "unit": "N"}], "rivals": []}),
        "The most probable law is -0.3*abs(v)*v (N) in the force balance; it is not established.",
    ),
    (
        Code.LAWS_TIED,
        *("", {"laws": [{"equation": "-0.2*x**3", "site": "force", "unit": "-"}], "rivals": ["0.9*sin(x)"]}),
        "The plain model lacks one of these laws: -0.2*x**3 in the force balance; 0.9*sin(x). The records cannot distinguish them.",
    ),
    (
        Code.LAW_LIKENESS,
        *(
            "-4.1e5*max(0, x - 0.121)",
            {
                "several": False,
                "kind": "stop",
                "size": -4.1e5,
                "size_unit": "N/m",
                "place": 0.121,
                "place_unit": "m",
                "variable": "x",
            },
        ),
        "It behaves as a stop or a threshold at x = 0.121 m with 4.1e+05 N/m.",
    ),
    (
        Code.LAW_RANGE,
        *("-0.6*a*b", {"range": {"a": [1.4, 3.9], "b": [0.9, 2.6]}, "units": {"a": "1", "b": "mol/m^3"}}),
        "-0.6*a*b was seen with a from 1.4 to 3.9 and b from 0.9 to 2.6 mol/m^3: beyond that it is a guess",
    ),
    (Code.NO_LAW, *("", {"terms": 300}), "No equation among 300 terms explains it."),
    (Code.LAW_TERMS_RANKED, *("", {"terms": 300}), "300 terms of equations ranked"),
    (
        Code.LEARNT_FROM_VALIDATION,
        *("", {}),
        "the constants of the estimation records alone do not hold on the validation records: the first half of these was fitted as"
        " well, and their second half judges",
    ),
    (
        Code.ERRORS_GROW,
        *("", {"rate": 4.75, "exponent": 47.5, "duration": 9.995, "longest": 0.631, "stretch": 0.211}),
        "the plain model is unstable: an error grows by e^47.5 over a record of 9.995 s. The records are searched in stretches of 0.21 s,"
        " each with first states of its own",
    ),
    (
        Code.ERRORS_GROW,
        *("", {"rate": 4.75, "exponent": 47.5, "duration": 9.995, "longest": 0.631, "stretch": 0.0}),
        "the plain model is unstable: an error grows by e^47.5 over a record of 9.995 s. Where something acts and what is claimed"
        " rests on free runs, which lose such a plant: take it for a guess, or cut the records (up to 0.63 s they are run freely)",
    ),
    (
        Code.TIME_OVER,
        *("", {"seconds": 60.0, "skipped": 12}),
        "from 60 s on, as asked, the search began no further fit: this is the best answer so far, and no effect of it is"
        " established; repeat the command to continue with its finished refits, or give it more time",
    ),
    (
        Code.STAGE_FAILED,
        *("weighing", {"reason": "the run overflows"}),
        "the answer could not be weighed against its rivals, so no name of an effect is certain: the run overflows",
    ),
    (Code.STAGE_FAILED, *("laws", {"reason": "no run"}), "no equation could be looked for: no run"),
    (Code.NOT_REACHED, *("cubic_stiffness", {}), "the time was over before it was tried"),
    (
        Code.REFIT_ELSEWHERE,
        *("rotor", {"status": "", "errors": [], "constants": {}}),
        "rotor: a fit of this model that begins at these constants does not end with success. The constants are those of the search;"
        " another fit may end elsewhere.",
    ),
    (
        Code.REFIT_ELSEWHERE,
        *("rotor", {"status": "stuck", "errors": [], "constants": {}}),
        "rotor: a fit of this model that begins at these constants does not end with success (no further progress: the search stopped"
        " before it met the convergence test). The constants are those of the search; another fit may end elsewhere.",
    ),
    (
        Code.REFIT_ELSEWHERE,
        "rotor",
        {
            "status": "converged",
            "errors": [{"records": "validation", "output": "w", "before": 0.0021, "after": 0.00189, "unit": "V"}],
            "constants": {"b": 0.51},
        },
        "rotor: the last fit had not settled. Another that begins at these constants (converged) changes the error of w on the validation"
        " records from 2.1 to 1.89 mV and b by 0.51 standard deviations.",
    ),
    (
        Code.REFIT_ELSEWHERE,
        *(
            "rotor",
            {"status": "converged", "errors": [], "constants": {"b": 0.5, "J": 2, "c": 0.2, "k": 0.3, "d": 0.1}},
        ),
        "rotor: the last fit had not settled. Another that begins at these constants (converged) changes J by 2 standard deviations, b by"
        " 0.5 standard deviations, k by 0.3 standard deviations and 2 further constants by less.",
    ),
    (
        Code.REFIT_ELSEWHERE,
        *("rotor", {"status": "", "errors": [], "constants": {}, "is_late": True}),
        "rotor: a fit that begins where the search ended was not done by the time limit, or within as long as the search took, so nobody"
        " knows whether the constants have settled. Fit the written model.",
    ),
    (
        Code.TEST_ERROR,
        *("x", {"before": 0.315, "after": 0.27, "unit": "V", "is_plain": False}),
        "on the test records, which took no part in the search, the error of x goes from 315 to 270 mV",
    ),
    (
        Code.TEST_ERROR,
        *("x", {"before": 0.315, "after": 0.315, "unit": "V", "is_plain": True}),
        "on the test records, which took no part in the search, the error of x is 315 mV",
    ),
    (
        Code.MISSING_ON_TEST,
        *("x", {"ratio": 129.4}),
        "the test records, which took no part in the search, contradict that only noise is left: the error of x there is 129 times the"
        " noise",
    ),
    (
        Code.DETECTION_LIMIT,
        *("cubic_stiffness", {"parameter": "K3", "limit": 1.234e8, "unit": "N/m^3"}),
        "cubic_stiffness is not detectable below K3 = 1.2e+08 N/m^3",
    ),
    (
        Code.CONTINUE_WITH_LOOK_ALIKE,
        *("coulomb_friction", {}),
        "continue with coulomb_friction, which follows the records better, but do not read its parameters as physics",
    ),
    (
        Code.STATE_NOISE,
        *("x, i", {"outputs": ["x", "i"]}),
        "give the noise of x, i (a number or a quiet record): these records show only what it is at most,"
        " and below that an effect may hide",
    ),
    (
        Code.CHECK_NOISE,
        *("x, i", {"std": [2e-7, 5e-3], "units": ["m", "A"], "outputs": ["x", "i"]}),
        "check that the sensor noise is 2e-07 m in x, 0.005 A in i: it was estimated from these records, and a smaller noise"
        " would mean that an effect is missing; give the noise as a number or as a quiet record",
    ),
    (
        Code.EXTEND_ESTIMATION_RECORDS,
        *("", {}),
        "use longer estimation records, or records with the range of the validation records: these hardly show the missing effect",
    ),
    (
        Code.SUSPECT_MAINS,
        *("", {"frequency": 100.02, "mains": 50.0}),
        "check grounding, shields and the supply of drive and sensor: the tone is at the mains frequency of 50 Hz or a multiple"
        " of it",
    ),
    (
        Code.SUSPECT_MACHINE,
        *("", {"frequency": 37.25}),
        "look for a rotating or switching machine at 37.25 Hz near the rig; a record with zero input shows the tone alone",
    ),
    (
        Code.USE_TONE_MODEL,
        *("", {"frequency": 37.25}),
        "if the tone remains, reject it with a notch filter, or with an observer that contains the model and its tone generator",
    ),
    (
        Code.SUSPECT_MEMORY,
        *("", {}),
        "record the same motion slowly and fast, and at two amplitudes: no function of one variable explains the missing signal,"
        " so the effect may have memory (play, hysteresis, creep, a part with its own motion)",
    ),
    (
        Code.LOOK_AT_STRETCH,
        *("run", {"start": 1.25, "end": 1.5, "share": 0.83, "time_share": 0.1}),
        "look at what happens from 1.25 to 1.5 s of run: 83 % of the misfit lies in 10 % of the time, so something acts then that the"
        " model does not have",
    ),
    (
        Code.TRACE_LOOP,
        *("x", {"loop": 0.4}),
        "record x up and down over its range, once slowly and once fast: the missing signal differs between the way up and the way down;"
        " a loop that stays when slow is play or hysteresis, one that shrinks is a lag or a loss that grows with speed",
    ),
    (
        Code.TRACE_CURVE,
        *("v", {"share": 0.87}),
        "record v slowly over its whole range: the missing signal is a function of it (explains 87 %), and there its curve shows by"
        " itself",
    ),
    (
        Code.SUSPECT_PERIODIC_PART,
        *("s", {"period": 0.01, "unit": "m"}),
        "look for magnets, teeth, a thread or a bearing with a period of 0.01 m: the missing signal is periodic in s",
    ),
    (
        Code.SUSPECT_CONTACT,
        *("x", {"position": 4e-5, "unit": "m"}),
        "inspect the rig where x is about 4e-05 m: the curve bends there, as with a stop, a contact or the end of a guide",
    ),
    (
        Code.USE_CURVE_MODEL,
        *("x", {}),
        "continue with the model that contains the curve, or take its law from the figure and write your own effect",
    ),
    (
        Code.VARY_SPEED_AND_AMPLITUDE,
        *("x", {}),
        "record the same motion slowly and fast, and at two amplitudes: the curve explains a part, and the rest depends on more than x",
    ),
    (
        Code.VARY_OTHER_VARIABLE,
        *("v", {"other": "x", "share": 0.42}),
        "record the same range of v at several levels of x: the curve over v explains a part, and the missing signal depends on x too"
        " (explains 42 %)",
    ),
    (
        Code.MEASURE_MORE,
        *("p_a, p_b", {"outputs": ["p_a", "p_b"]}),
        "measure p_a and p_b as well, to narrow down the site",
    ),
    (Code.BASELINE_FITTED, *("", {"misfit": 113.2, "bounded": False}), "plain model: misfit 113 times the noise"),
    (
        Code.BASELINE_FITTED,
        *("", {"misfit": 2.91, "bounded": True}),
        "plain model: misfit at least 2.91 times the noise",
    ),
    (
        Code.FIRST_EFFECT,
        *("coulomb_friction", {"before": 113.2, "after": 1.01, "bounded": False}),
        "coulomb_friction: misfit 113 -> 1.01 times the noise",
    ),
    (
        Code.FURTHER_EFFECT,
        *("coulomb_friction + backlash", {"before": 113.2, "after": 1.01, "bounded": False}),
        "coulomb_friction + backlash: misfit 1.01 times the noise",
    ),
    (
        Code.LEARNING_FROM_VALIDATION,
        *("", {}),
        "more than noise is left on the validation records: constants that are fitted to their first half as well are tried",
    ),
    (
        Code.EFFECTS_ESTABLISHED,
        *(
            "cubic_stiffness + input_offset + backlash",
            {
                "established": ["cubic_stiffness"],
                "others": {"input_offset": "probable", "backlash": "stand_in"},
                "left": ["judging", "test", "correlated"],
            },
        ),
        "Cubic stiffness is established; input offset is probable; backlash is only a stand-in for something else. More is missing: the"
        " validation and the test records show more than noise; what is left goes on from reading to reading, which the noise does"
        " not.",
    ),
    (
        Code.EFFECTS_ESTABLISHED,
        *("cubic_stiffness", {"established": ["cubic_stiffness"], "others": {}, "left": []}),
        "Cubic stiffness is established. Whether more is missing is not certain.",
    ),
    (
        Code.EFFECTS_PROBABLE,
        *(
            "coulomb_friction_at_load",
            {"probabilities": {"coulomb_friction_at_load": 0.892}, "others": ["input_offset"]},
        ),
        "No effect is established. The most probable is coulomb friction at load (89 %); input offset is only a stand-in for something"
        " else.",
    ),
    (
        Code.SEEN_THROUGH_RESPONSE,
        *("cart.fmu", {"share": 0.982}),
        "cart.fmu is run from outside: effects at its inputs were seen through a linear response that follows 98.2 % of its own, and"
        " those that were found are fitted with the plant itself",
    ),
    (
        Code.NO_INPUT_RESPONSE,
        *("cart.fmu", {}),
        "no effect at an input of cart.fmu was tried: no linear response to its inputs could be found",
    ),
    (
        Code.PLANT_DISAGREES,
        *("cart.fmu", {"ratios": {"x": 1.5}}),
        "cart.fmu itself errs otherwise than the model about its run, on which the effects were found: 1.5 times as much in x",
    ),
    (
        Code.PLANT_FAILS,
        *("cart.fmu", {"effects": "backlash"}),
        "cart.fmu itself does not run with backlash: their constants and errors are those of the model about its run",
    ),
    (Code.PLANT_RUNS, *("cart.fmu", {"runs": 63}), "cart.fmu was run 63 times over a record"),
    (
        Code.ERROR_REDUCED,
        *("y", {"before": None, "after": 0.31e-3, "unit": "V", "share": 1.0, "effects": ["coulomb_friction"]}),
        "On the validation records the run of the plain model goes astray; with coulomb friction the error in y is 310 µV.",
    ),
    (
        Code.ERROR_REDUCED,
        *(
            "y",
            {
                "before": 8.84e-3,
                "after": 0.31e-3,
                "unit": "V",
                "share": 0.965,
                "effects": ["band_limited_input", "cubic_stiffness", "input_offset"],
            },
        ),
        "The error in y on the validation records falls from 8.84 to 0.31 mV (96 % less) with band-limited input, cubic stiffness and"
        " input offset.",
    ),
    (
        Code.ERROR_LEFT,
        *(
            "y",
            {
                "rmse": 0.31e-3,
                "before": 8.84e-3,
                "unit": "V",
                "noise_ratio": 4.0,
                "sites": [],
                "dependence": None,
                "grows_with_amplitude": True,
            },
        ),
        "0.31 mV is left in y, 4 times the sensor noise: it grows with the amplitude.",
    ),
    (
        Code.CLAIM_ESTABLISHED,
        *(
            "x",
            {
                **{
                    "depth": 2,
                    "output": "x",
                    "site": "balance force",
                    "variables": ["v"],
                    "form": "static",
                    "family": [],
                },
                **{"name": "", "probability": 0.98, "grade": "established", "share": 0.93, "rival": "sensor_lag"},
            },
        ),
        "A static function of v acts at the force balance: 93 % of the error in x (98 % certain). The name is open.",
    ),
    (
        Code.SEPARATE_FROM_RIVAL,
        *("constant_load", {"rival": "asymmetric_friction", "advice": "Turn the rig over."}),
        "no record tells constant load from asymmetric friction: Turn the rig over.",
    ),
    (
        Code.SEPARATE_FROM_RIVAL,
        *("input_offset", {"rival": "constant_load", "advice": ""}),
        "record an experiment in which input offset and constant load differ (another amplitude, speed or direction; `greybox design` with"
        " `--goal discrimination` plans it): these records do not separate them",
    ),
    (
        Code.ERROR_REDUCED,
        *(
            "y",
            {"before": 0.517, "after": 0.125, "unit": "V", "share": 0.758, "effects": ["drive_lag", "fitted_curve"]},
        ),
        "The error in y on the validation records falls from 517 to 125 mV (76 % less) with drive lag and a fitted curve.",
    ),
    (
        Code.CONFIRM_ON_ANOTHER_RECORD,
        *("", {}),
        "continue with the extended model, and confirm it on a record with another amplitude or waveform",
    ),
    (
        Code.NO_PLACE,
        *("backlash", {"reason": "effect 'backlash' acts at 'force', which model 'm' does not have"}),
        "the model has no place for it: effect 'backlash' acts at 'force', which model 'm' does not have",
    ),
    (Code.EFFECT_PRESENT, *("backlash", {}), "the model contains it already"),
    (
        Code.NEEDS_UNIFORM_SAMPLING,
        *("band_limited_input", {}),
        "it needs uniform sampling, and these records are sampled unevenly: resample them to try it",
    ),
    (Code.NOT_A_CANDIDATE, *("backlash", {}), "the model lists the effects to try, and this is none of them"),
    (
        Code.TRIED_AS_OTHERS,
        *("asymmetric_friction", {"others": ["coulomb_friction", "constant_load"]}),
        "coulomb friction and constant load together are exactly the same",
    ),
    (Code.TRIED_AS_OTHERS, *("clock_skew", {"others": ["sensor_gain"]}), "sensor gain is exactly the same"),
    (
        Code.TAKEN_BY_CONSTANTS,
        *("input_gain", {"constants": ["J", "mgl"]}),
        "no record tells it from other values of J and mgl: fix or weigh one of them",
    ),
    (
        Code.USUAL_FIRST,
        "coulomb_friction + constant_load",
        {
            "by_records": ["bouc_wen_hysteresis", "second_mode + cogging"],
            "odds": 5.2,
            "share": 0.84,
            "best_share": 0.91,
            "best": "second_mode + cogging",
        },
        "By the records alone Bouc-Wen hysteresis or second mode and cogging; by what such rigs usually have, coulomb friction and constant"
        " load (5 to 1): over all records it takes 84 % of the error, the best of all (second mode and cogging) 91 %.",
    ),
    (
        Code.ASK_PART,
        "contact",
        {"yes": "coulomb_friction", "no": "quadratic_damping"},
        "Does anything rub or roll on what moves (bearing, guide, seal, gear, tyre)? If so, it is coulomb friction (--has contact); if"
        " not, quadratic damping (--lacks contact)",
    ),
    (Code.EFFECT_LEFT_OUT, *("backlash", {}), "left out as asked"),
    (
        Code.PART_MISSING,
        *("cogging", {"part": "voice_coil", "reason": "it has no input"}),
        "it needs voice coil, which the rig lacks (it has no input)",
    ),
    (
        Code.PART_MISSING,
        *("cogging", {"part": "magnets", "reason": "told"}),
        "it needs magnets, which the rig lacks",
    ),
    (
        Code.CANDIDATE_FAILED,
        *("transport_delay", {"reason": "unequal intervals"}),
        "it could not be fitted: unequal intervals",
    ),
    (
        Code.CANDIDATE_NOT_SIMULATED,
        *("backlash", {}),
        "the model with it cannot be simulated from any starting point",
    ),
]
CHECKS = {
    Rule.BASELINE_ABOVE_NOISE: "backlash: cost per sample of the plain model 18.2 > 20: no",
    Rule.VALIDATION_ABOVE_NOISE: "backlash: validation error over noise 18.2 > 20: no",
    Rule.VALIDATION_ONLY: "backlash: excess of the validation error over noise 18.2 >= 20: no",
    Rule.CRITERION_GAIN: "backlash: decrease of Schwarz's criterion 18.2 > 20: no",
    Rule.EXPLAINED_EXCESS: "backlash: decrease of the cost 18.2 >= 20: no",
    Rule.ONLY_NOISE_LEFT: "backlash: cost per sample, reduced to the noise 18.2 <= 20: no",
    Rule.CLEAN_RESIDUAL: "backlash: cost per sample 18.2 <= 20: no",
    Rule.SMALL_REMAINDER: "backlash: remaining excess cost 18.2 <= 20: no",
    Rule.WHITE_RESIDUAL: "backlash: excess autocorrelation of the residual 18.2 <= 20: no",
    Rule.HOLDOUT_GAP: "backlash: validation error of the plain model over noise 18.2 > 20: no",
    Rule.HOLDOUT_EXPLAINED: "backlash: share of the excess validation error explained 18.2 >= 20: no",
    Rule.HOLDOUT_PARTLY_EXPLAINED: "backlash: share of the excess validation error explained, down to the noise 18.2 >= 20: no",
    Rule.HOLDOUT_NOISE: "backlash: validation error of the extended model over noise 18.2 <= 20: no",
    Rule.VALIDATION_DECREASE: "backlash: validation misfit 18.2 <= 20: no",
    Rule.TEST_INCREASE: "backlash: increase over blocks of the test records, in standard errors 18.2 < 20: no",
    Rule.SETTLED: "backlash: fit repeated from its end, and ended there 18.2 >= 20: no",
    Rule.TEST_NOISE: "backlash: error on the test records over noise 18.2 <= 20: no",
    Rule.CONSISTENT_DECREASE: "backlash: decrease over blocks of the validation records, in standard errors 18.2 >= 20: no",
    Rule.WINS: "backlash: misfit over that of the set before 18.2 < 20: no",
    Rule.ESTABLISHED: "backlash: established, with probability 18.2 >= 20: no",
}


@pytest.mark.parametrize(("code", "subject", "values", "text"), FINDINGS)
def test_each_finding_has_its_sentence(code, subject, values, text):
    assert str(Finding(code, subject=subject, values=values)) == text


def test_every_code_and_rule_is_covered():
    assert {code for code, *_ in FINDINGS} == set(Code)
    assert set(CHECKS) == set(Rule)


@pytest.mark.parametrize(("rule", "text"), CHECKS.items())
def test_each_check_has_its_line(rule, text):
    assert str(Check(rule, 18.2, 20.0, False, "backlash")) == text


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({}, "odd, a step at zero, downwards"),
        ({"downwards": False}, "odd, a step at zero"),
        ({"shape": "too_few_values", "downwards": False}, "too few values to tell its shape"),
        ({"shape": "straight", "downwards": False}, "no shape beyond a straight line"),
        ({"shape": "flat_middle", "position": 0.6, "downwards": False}, "odd, with a flat middle up to about 0.6 m/s"),
        ({"shape": "cubic", "downwards": False}, "odd, growing faster than proportionally"),
        ({"shape": "odd_square", "downwards": False}, "odd, growing with the square"),
        ({"shape": "square", "downwards": False}, "even, growing with the square"),
        ({"shape": "kink", "downwards": False}, "even, with a kink at zero"),
        ({"shape": "bend", "position": 0.5}, "a bend at 0.5 m/s"),
        ({"shape": "curved"}, "curving downwards"),
        ({"shape": "curved", "downwards": False}, "curving upwards"),
        ({"shape": "periodic", "period": 0.31}, "periodic, every 0.31 m/s"),
        ({"shape": "tone", "downwards": False}, "a tone"),
        ({"shape": "unnamed"}, "odd in shape"),
        ({"shape": "unnamed", "parity": "neither"}, "of no simple shape"),
    ],
)
def test_each_shape_has_its_words(change, text):
    assert shape_text(STEP | change) == text


def test_a_dependence_says_its_share_loop_and_tone():
    assert dependence_text(STEP) == "a function of v (explains 78 %): odd, a step at zero, downwards"
    loop = dependence_text(STEP | {"has_loop": True, "loop": 0.2})
    assert loop.endswith(", with a loop (direction adds 20 %)")
    alone = dependence_text(STEP | {"has_loop": True, "loop": 0.2, "share": 0.004})
    assert alone == "a loop over v: another value on its way up than on its way down (explains 20 %)"
    assert (
        dependence_text(STEP | {"tone": 50.0}) == "a tone of 50 Hz that does not depend on the motion (explains 78 %)"
    )


@pytest.mark.parametrize(
    ("established", "won", "more"),
    [
        (0, "none of 20 draws (at most 14 %, with 95 % confidence).", ""),
        (
            *(6, "6 of 20 draws (at most 51 %, with 95 % confidence)."),
            " That is more often than an established claim may be wrong: beyond the place nothing here is more than probable.",
        ),
    ],
)
def test_signals_without_meaning_say_how_often_they_won(established, won, more):
    assert false_names_text(FalseNameRate("coulomb_friction", Depth.NAME, 20, established, 24)) == (
        "In the place of coulomb friction the best of 24 signals without meaning, made from these records, would have been"
        f" established in {won}{more}"
    )


def test_sites_that_cannot_be_told_apart_are_alternatives():
    assert sites_text(["balance force"]) == "the force balance"
    either = "the sensor of x or the input u"
    assert sites_text(["sensor of x", "input u"]) == either
    # Why there are several is told once, where they are first.
    assert sites_text(["sensor of x", "input u"], explained=True) == f"{either} (these sensors cannot distinguish them)"
    assert sites_text([]) == "no particular site"


def test_a_misfit_has_its_time():
    assert timing_text(None) == "nowhere above the noise"
    assert timing_text(MisfitTiming(1.0, 1.0, ())) == "throughout the records"
    few = timing_text(MisfitTiming(0.81, 0.1, (("a", 2.0, 3.0),)))
    assert few == "81 % of it in 10 % of the time: 2 to 3 s of a"
    many = timing_text(MisfitTiming(0.81, 0.1, tuple(("a", 2.0 * k, 2.0 * k + 1) for k in range(6))))
    assert many.endswith("6 to 7 s of a and 2 more stretches")


def test_a_tone_names_its_sites_and_amplitude():
    tone = {"frequency": 50.0, "std": 0.01, "amplitude": {"a": 0.05}, "beginning": 0.083, "alike": ["sensor of x"]}
    values = CURVE | {"tone": tone, "variable": "time", "shape": "tone"}
    assert surrogate_text(values) == (
        "a tone of 50.00 Hz at the force balance (or the sensor of x: these records cannot distinguish them), with an amplitude of 0.05 N,"
        " takes away 98.8 % of the error on the validation records (amplitude and phase there are estimated from the first 0.083 s)"
    )


def test_errors_and_steps_fit_on_a_line():
    assert str(HoldoutError(6.43e-7, 1.02e-7, 1e-7, "m")) == "6.43e-07 -> 1.02e-07 m (noise 1e-07)"
    assert str(HoldoutError(2.0, 1.0, 0.3, "V", is_floor_known=False)) == "2 -> 1 V"
    assert explained_share_text(0.988) == "takes away 98.8 % of the error"
    assert explained_share_text(-0.1) == "takes away none of the error"


@pytest.mark.parametrize(
    ("share", "text"), [(0.123, "12 %"), (0.9951, "99.5 %"), (0.996, "99.6 %"), (1.0, "100 %"), (12.345, "1234 %")]
)
def test_a_share_is_never_written_as_a_power_of_ten(share: float, text: str) -> None:
    assert percent_text(share, 2) == text


def test_a_constant_that_is_a_pure_number_has_no_unit():
    assert constant_text("mu", {"value": 0.0, "std": None, "unit": "1"}) == "mu = 0"
    assert constant_text("Fc", {"value": 0.05, "std": 0.001, "unit": "N"}) == "Fc = 0.05 +- 0.001 N"
