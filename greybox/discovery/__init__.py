"""Where model and data disagree, which effect is missing, and whether one may say so."""

from greybox.discovery.dependence import Dependence
from greybox.discovery.effect_signal import EffectSignal
from greybox.discovery.effect_test import EffectTest, drop_effect, try_effect
from greybox.discovery.holdout_error import HoldoutError
from greybox.discovery.localisation import RankedSite, ResidualLocalisation, ResidualSignal, localise_residual
from greybox.discovery.misfit_windows import MisfitWindow
from greybox.discovery.pipeline import discover
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.discovery.refinement import Refinement, RefinementStep, refine
from greybox.discovery.residual_spectrum import ResidualSpectrum, estimate_residual_spectrum
from greybox.discovery.result import Discovery, RankedCandidate
from greybox.discovery.surrogate import Surrogate, SurrogateTone

__all__ = [
    "CandidateFit",
    "Dependence",
    "Discovery",
    "DiscoveryProblem",
    "EffectSignal",
    "EffectTest",
    "HoldoutError",
    "MisfitWindow",
    "RankedCandidate",
    "RankedSite",
    "Refinement",
    "RefinementStep",
    "ResidualLocalisation",
    "ResidualSignal",
    "ResidualSpectrum",
    "Surrogate",
    "SurrogateTone",
    "discover",
    "drop_effect",
    "estimate_residual_spectrum",
    "localise_residual",
    "refine",
    "try_effect",
]
