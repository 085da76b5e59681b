"""First guesses of states along a record, from its own samples and the start values of the constants."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from greybox.transcription.arcs import cut_at_rows, slice_rows
from greybox.transcription.projected_initial_states import ProjectedShooting
from greybox.transcription.single_shooting import SingleShooting


def estimate_nodes(single: SingleShooting, cuts: Sequence[Sequence[int]]) -> list[np.ndarray]:
    """States (segments + 1, nx) of each record at its ``cuts`` (first rows of the segments and, at the end, the number of rows).

    A state that is an output is taken as measured to begin with, a hidden one from the end of the segment before; then both are
    estimated from the samples of the segment, with the constants at their start values. A short segment, which a wrong
    constant cannot spoil much, acts as an observer. The state at the end is a copy of the one before it.
    """
    return to_nodes(single, cuts, estimate_arc_states(single, cuts))


def estimate_arc_states(single: SingleShooting, cuts: Sequence[Sequence[int]]) -> ProjectedShooting:
    """The records cut in arcs, with the initial state of each estimated in turn."""
    arcs = cut_at_rows(single, cuts)
    projected = ProjectedShooting(arcs.shooting)
    projected.carry(arcs.starts_record)
    return projected


def to_nodes(single: SingleShooting, cuts: Sequence[Sequence[int]], projected: ProjectedShooting) -> list[np.ndarray]:
    """The present initial states of the arcs as nodes of each record; states that begin as declared do so."""
    v, initial = single.variables, projected.variables.initial
    found = initial.guess + initial.scale * projected.own
    nodes, at, tied = [], 0, ~v.initial.free
    for e, places in enumerate(cuts):
        own = found[at : at + len(places) - 1]
        own[0, tied] = v.initial.guess[e, tied]
        nodes.append(np.vstack([own, own[-1:]]))
        at += len(own)
    return nodes


def simulate_segments(
    single: SingleShooting, z: np.ndarray, e: int, cuts: Sequence[int], nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (N, ny) and states (N, nx) of record ``e``, each segment run from its own node."""
    p = single.variables.parameters(z, e)
    q, *_ = single.at(z, p, e)
    pieces = [slice_rows(single.records[e], a, b) for a, b in pairwise(cuts)]
    runs = [single.kernel.simulate(each, q, p, node) for each, node in zip(pieces, nodes, strict=False)]
    return np.concatenate([y for y, _ in runs]), np.concatenate([x for _, x in runs])
