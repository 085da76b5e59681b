"""The next experiment: which record to take, within what the rig allows, and campaigns of such records."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.data.signals import SignalLimit
    from greybox.extensions.design.campaign import Campaign, CampaignPlan, CampaignStatus, CampaignStep, run_campaign
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
    from greybox.extensions.design.next_record import answer, design
    from greybox.extensions.design.policy import CampaignPolicy, DesignPolicy
    from greybox.extensions.design.problem import CriterionName, DesignProblem, GoalName
    from greybox.extensions.design.result import (
        Alternative,
        AlternativeKind,
        Design,
        PredictedConstant,
        PredictedDetection,
    )
    from greybox.extensions.design.sampling_times import SamplingTimes, choose_sampling_times, weigh_optimally

__getattr__, __all__ = lazy_face(
    __name__,
    {
        "greybox.data.signals": ("SignalLimit",),
        "greybox.extensions.design.campaign": (
            "Campaign",
            "CampaignPlan",
            "CampaignStatus",
            "CampaignStep",
            "run_campaign",
        ),
        "greybox.extensions.design.next_record": ("answer", "design"),
        "greybox.extensions.design.inputs": (
            "Chirp",
            "Multisine",
            "PiecewiseConstant",
            "Prbs",
            "Steps",
            "compress_multisine",
            "crest_factor",
            "staircase",
        ),
        "greybox.extensions.design.limits": ("LimitPrediction",),
        "greybox.extensions.design.policy": ("CampaignPolicy", "DesignPolicy"),
        "greybox.extensions.design.problem": ("CriterionName", "DesignProblem", "GoalName"),
        "greybox.extensions.design.result": (
            "Alternative",
            "AlternativeKind",
            "Design",
            "PredictedConstant",
            "PredictedDetection",
        ),
        "greybox.extensions.design.sampling_times": ("SamplingTimes", "choose_sampling_times", "weigh_optimally"),
    },
)
