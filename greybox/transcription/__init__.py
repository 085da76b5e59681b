"""From experiments and a discrete step to a cost with its derivatives, or to a program for a sparse solver."""

from greybox.transcription.arcs import arcs_of, cut
from greybox.transcription.collocation import Collocation
from greybox.transcription.conditions import conditions_of, under
from greybox.transcription.guess import guess_nodes, run_pieces
from greybox.transcription.multiple import End, Lifted, MultipleShooting, rows_of_segment
from greybox.transcription.pick import Pick, growth_of, pick
from greybox.transcription.projected import ProjectedShooting
from greybox.transcription.records import record_of
from greybox.transcription.relax import relaxed_start
from greybox.transcription.shooting import Evaluation, SingleShooting
from greybox.transcription.variables import InitialStates, Variables

__all__ = [
    "Collocation", "End", "Evaluation", "InitialStates", "Lifted", "MultipleShooting", "Pick", "ProjectedShooting", "SingleShooting",
    "Variables", "arcs_of", "conditions_of", "cut", "growth_of", "guess_nodes", "pick", "record_of", "relaxed_start",
    "rows_of_segment", "run_pieces", "under",
]  # fmt: skip
