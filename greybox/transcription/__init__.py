"""From experiments and a discrete step to a cost with its derivatives, or to a program for a sparse solver."""

from greybox.transcription.arcs import cut_into_arcs, split_into_arcs
from greybox.transcription.collocation import Collocation
from greybox.transcription.conditions import apply_conditions, resolve_conditions
from greybox.transcription.decision_vector import DecisionVector, InitialStates
from greybox.transcription.findings import TranscriptionReason
from greybox.transcription.initialisation import (
    estimate_nodes,
    initialise_without_continuity,
    simulate_segments,
)
from greybox.transcription.multiple_shooting import (
    MultipleShooting,
    MultipleShootingResult,
    choose_segment_rows,
    place_segments,
)
from greybox.transcription.projected_initial_states import ProjectedShooting
from greybox.transcription.records import to_record
from greybox.transcription.select import (
    ProposedTranscription,
    TranscriptionProposal,
    estimate_error_growth,
    propose_transcription,
)
from greybox.transcription.simulation_error import Evaluation, SingleShooting

__all__ = [
    "Collocation",
    "DecisionVector",
    "Evaluation",
    "InitialStates",
    "MultipleShooting",
    "MultipleShootingResult",
    "ProjectedShooting",
    "ProposedTranscription",
    "SingleShooting",
    "TranscriptionProposal",
    "TranscriptionReason",
    "apply_conditions",
    "choose_segment_rows",
    "cut_into_arcs",
    "estimate_error_growth",
    "estimate_nodes",
    "initialise_without_continuity",
    "place_segments",
    "propose_transcription",
    "resolve_conditions",
    "simulate_segments",
    "split_into_arcs",
    "to_record",
]
