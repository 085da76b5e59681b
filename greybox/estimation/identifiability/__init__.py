"""What can be determined: by a model's structure, by the given records, and by their inputs."""

from greybox.estimation.identifiability.combinations import OpenDirection
from greybox.estimation.identifiability.excitation import Excitation, analyse_excitation
from greybox.estimation.identifiability.practical import (
    ExpectedPrecision,
    PracticalIdentifiability,
    analyse_practical_identifiability,
    recommend_after_fit,
)
from greybox.estimation.identifiability.structural import (
    IdentifiabilityVerdict,
    StructuralIdentifiability,
    analyse_structural_identifiability,
)

__all__ = [
    "Excitation",
    "ExpectedPrecision",
    "IdentifiabilityVerdict",
    "OpenDirection",
    "PracticalIdentifiability",
    "StructuralIdentifiability",
    "analyse_excitation",
    "analyse_practical_identifiability",
    "analyse_structural_identifiability",
    "recommend_after_fit",
]
