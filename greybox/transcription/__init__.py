"""From experiments and a discrete step to a cost with its derivatives."""

from greybox.transcription.records import record_of
from greybox.transcription.shooting import Evaluation, SingleShooting
from greybox.transcription.variables import InitialStates, Variables

__all__ = ["Evaluation", "InitialStates", "SingleShooting", "Variables", "record_of"]
