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
        staircase,
    )
    from greybox.extensions.design.next_record import answer, design
    from greybox.extensions.design.problem import (
        Alternative,
        AlternativeKind,
        CampaignPolicy,
        CriterionName,
        Design,
        DesignPolicy,
        DesignProblem,
        GoalName,
        LimitPrediction,
        PredictedConstant,
        PredictedDetection,
    )
    from greybox.extensions.design.search import SamplingTimes, choose_sampling_times, weigh_optimally

__getattr__, __all__, __dir__ = lazy_face(__name__)
