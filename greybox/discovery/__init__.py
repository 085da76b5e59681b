"""Where model and data disagree, which effect is missing, and whether one may say so."""

from greybox.discovery.candidates import family_of
from greybox.discovery.claims import Claim, Depth
from greybox.discovery.curve_shape import CurveShape, Dependence, Parity, ShapeKind
from greybox.discovery.decision import Grade, Verdict
from greybox.discovery.effect_signal import EffectSignal, RemainingError
from greybox.discovery.effect_test import EffectTest, drop_effect, try_effect
from greybox.discovery.execution import SearchFailure, SearchStage
from greybox.discovery.false_names import FalseNameRate
from greybox.discovery.holdout import HoldoutError
from greybox.discovery.localisation import (
    MisfitWindow,
    RankedSite,
    ResidualLocalisation,
    ResidualSignal,
    ResidualSpectrum,
    estimate_residual_spectrum,
    localise_residual,
)
from greybox.discovery.pipeline import discover
from greybox.discovery.policy import DiscoveryPolicy, SelectionPolicy
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate
from greybox.discovery.result import Discovery, RankedCandidate, load_discovery
from greybox.discovery.search import SelectionStep, StepKind
from greybox.discovery.surrogate import Surrogate, SurrogateTone

__all__ = [
    "Claim",
    "CurveShape",
    "Dependence",
    "Depth",
    "Discovery",
    "DiscoveryPolicy",
    "DiscoveryProblem",
    "EffectSignal",
    "EffectTest",
    "FalseNameRate",
    "FittedCandidate",
    "Grade",
    "HoldoutError",
    "MisfitWindow",
    "Parity",
    "RankedCandidate",
    "RankedSite",
    "RemainingError",
    "ResidualLocalisation",
    "ResidualSignal",
    "ResidualSpectrum",
    "SearchFailure",
    "SearchStage",
    "SelectionPolicy",
    "SelectionStep",
    "ShapeKind",
    "StepKind",
    "Surrogate",
    "SurrogateTone",
    "Verdict",
    "discover",
    "drop_effect",
    "estimate_residual_spectrum",
    "family_of",
    "load_discovery",
    "localise_residual",
    "try_effect",
]
