"""The next experiment: which record to take, within what the rig allows."""

from greybox.experiment_design.design import answer, design
from greybox.experiment_design.inputs import (
    Chirp,
    Multisine,
    PiecewiseConstant,
    Prbs,
    Steps,
    compress_multisine,
    crest_factor,
    staircase,
)
from greybox.experiment_design.limits import LimitPrediction
from greybox.experiment_design.policy import DesignPolicy
from greybox.experiment_design.problem import CriterionName, DesignProblem, GoalName, SignalLimit
from greybox.experiment_design.result import Alternative, AlternativeKind, Design, PredictedConstant, PredictedDetection
from greybox.experiment_design.sampling_times import SamplingTimes, choose_sampling_times, weigh_optimally

__all__ = [
    "Alternative",
    "AlternativeKind",
    "Chirp",
    "CriterionName",
    "Design",
    "DesignPolicy",
    "DesignProblem",
    "GoalName",
    "LimitPrediction",
    "Multisine",
    "PiecewiseConstant",
    "Prbs",
    "PredictedConstant",
    "PredictedDetection",
    "SamplingTimes",
    "SignalLimit",
    "Steps",
    "answer",
    "choose_sampling_times",
    "compress_multisine",
    "crest_factor",
    "design",
    "staircase",
    "weigh_optimally",
]
