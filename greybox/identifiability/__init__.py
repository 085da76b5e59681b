"""What can be determined: by a model's structure, by the records at hand, and by the input that drove them."""

from greybox.identifiability.after import missing_knowledge
from greybox.identifiability.directions import Direction
from greybox.identifiability.excitation import Excitation, excitation
from greybox.identifiability.identifiability import Identifiability, identifiability
from greybox.identifiability.practical import Expected, Practical, practical

__all__ = [
    "Direction", "Excitation", "Expected", "Identifiability", "Practical", "excitation", "identifiability",
    "missing_knowledge", "practical",
]  # fmt: skip
