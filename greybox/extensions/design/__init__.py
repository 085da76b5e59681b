"""The next experiment: which record to take, within what the rig allows, and campaigns of such records."""

from greybox.extensions.design.campaign import Campaign, CampaignPlan, CampaignStatus, CampaignStep, run_campaign
from greybox.extensions.design.design import answer, design
from greybox.extensions.design.inputs import (
    Chirp,
    Multisine,
    PiecewiseConstant,
    Prbs,
    Steps,
    compress_multisine,
    crest_factor,
    staircase,
)
from greybox.extensions.design.limits import LimitPrediction
from greybox.extensions.design.policy import CampaignPolicy, DesignPolicy
from greybox.extensions.design.problem import CriterionName, DesignProblem, GoalName, SignalLimit
from greybox.extensions.design.result import Alternative, AlternativeKind, Design, PredictedConstant, PredictedDetection
from greybox.extensions.design.sampling_times import SamplingTimes, choose_sampling_times, weigh_optimally

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
