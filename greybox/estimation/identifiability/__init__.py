"""What can be determined: by a model's structure, by the given records, and by their inputs."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
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

__getattr__, __all__, __dir__ = lazy_face(__name__)
