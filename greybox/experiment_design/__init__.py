"""The next experiment: which record to take, within what the rig allows, and campaigns of such records."""

from greybox.experiment_design.campaign import Campaign, CampaignPlan, CampaignStatus, CampaignStep, run_campaign
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
from greybox.experiment_design.policy import CampaignPolicy, DesignPolicy
from greybox.experiment_design.problem import CriterionName, DesignProblem, GoalName, SignalLimit
from greybox.experiment_design.result import Alternative, AlternativeKind, Design, PredictedConstant, PredictedDetection
from greybox.experiment_design.sampling_times import SamplingTimes, choose_sampling_times, weigh_optimally

__all__ = [
    "Alternative",
    "AlternativeKind",
    "Campaign",
    "CampaignPlan",
    "CampaignPolicy",
    "CampaignStatus",
    "CampaignStep",
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
    "run_campaign",
    "staircase",
    "weigh_optimally",
]
