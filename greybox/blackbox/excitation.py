"""Whether a record's inputs can carry the coefficients that a structure asks for."""

from __future__ import annotations

from collections.abc import Sequence

from greybox.blackbox.sampled_data import SampledData

WORDS = {0: "it never moves", 1: "a constant or a step", 2: "one sine"}


def find_weak_excitation(data: SampledData, needed: int, nb: Sequence[int]) -> tuple[str, ...]:
    """A sentence for each input whose order of persistent excitation is below the ``needed`` number of coefficients.

    The order is 1 for a constant or a step and 2 for each sine; each carries one coefficient. Several inputs share the
    ``needed`` coefficients, so that each is only asked for its own ``nb`` there.
    """
    from greybox.identifiability import analyse_excitation  # which loads a solver that a black-box model does not need

    seen = [analyse_excitation(experiment) for experiment in data.experiments]
    notes = []
    for i, name in enumerate(data.inputs):
        asked = min(needed if len(data.inputs) == 1 else nb[i], max(s.limit for s in seen))
        found = max(s.orders[name] for s in seen)
        if found < asked:
            what = WORDS.get(found, f"as {found // 2} sines are" if found % 2 == 0 else "")
            notes.append(
                f"input {name!r} is persistently exciting of order {found}{f' ({what})' if what else ''}, the structure asks for"
                f" {asked}: what is beyond rests on transients and noise; take a smaller structure or a richer input"
            )
    return tuple(notes)
