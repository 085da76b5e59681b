"""From experiments and a discrete step to a cost with its derivatives, or to a program for a sparse solver, and to its solution."""

from greybox.transcription.collocation import Collocation
from greybox.transcription.conditions import apply_conditions, resolve_conditions
from greybox.transcription.decision_vector import DecisionVector, InitialStates, NoiseLevels, Point
from greybox.transcription.findings import SolutionCode, TranscriptionReason
from greybox.transcription.multiple_shooting import MultipleShooting, MultipleShootingResult
from greybox.transcription.options import SolverOptions, Transcription
from greybox.transcription.problem import EstimationProblem, prepare_problem
from greybox.transcription.projected_initial_states import ProjectedShooting
from greybox.transcription.records import to_record
from greybox.transcription.segments import SegmentedProblem, split_into_arcs
from greybox.transcription.select import estimate_error_growth, propose_transcription, select_transcription
from greybox.transcription.simulation_error import Evaluation, SingleShooting
from greybox.transcription.solution import Solution
from greybox.transcription.solve import solve

__all__ = [
    "Collocation",
    "DecisionVector",
    "EstimationProblem",
    "Evaluation",
    "InitialStates",
    "MultipleShooting",
    "MultipleShootingResult",
    "NoiseLevels",
    "Point",
    "ProjectedShooting",
    "SegmentedProblem",
    "SingleShooting",
    "Solution",
    "SolutionCode",
    "SolverOptions",
    "Transcription",
    "TranscriptionReason",
    "apply_conditions",
    "estimate_error_growth",
    "prepare_problem",
    "propose_transcription",
    "resolve_conditions",
    "select_transcription",
    "solve",
    "split_into_arcs",
    "to_record",
]
