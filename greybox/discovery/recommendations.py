"""What to do next where something is missing that has no name: the next record, sensor or look at the rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from greybox.discovery import decision
from greybox.discovery.localisation import ResidualLocalisation
from greybox.discovery.residual_noise import KNOWN
from greybox.discovery.surrogate import Surrogate
from greybox.experiment import Experiment
from greybox.result import Fit

# A tone this close to a multiple of a mains frequency (Hz) may be the mains; multiples that are looked at.
MAINS, NEAR, MULTIPLES = (50.0, 60.0), 0.01, 6
# Share of the range of a curve by which a record must reach beyond it to count.
BEYOND = 0.1


def recommend_next_steps(
    base: Fit, look: ResidualLocalisation, surrogate: Surrogate | None, judges: Sequence[Experiment], nearest: str = ""
) -> tuple[str, ...]:
    """Sentences, the most promising first: for the ``base`` model, what it leaves over (``look``), and what stands in for that.

    ``nearest``: the look-alike, where it closes the larger part of the gap on the ``judges``.
    """
    further = f"go on with {nearest} and look for what takes a share of the rest (greybox discover --further; in Python further)"
    return (*([further] if nearest else []), *_sentences(base, look, surrogate, judges, bool(nearest)))


def recommend_noise_check(base: Fit) -> tuple[str, ...]:
    """What to check where nothing seems to be missing: a noise that was estimated too large hides what is."""
    units = {o.name: o.unit for o in base.model.outputs}
    sizes = [f"{base.noise.std[n]:.3g} {units[n]}".rstrip() + f" in {n}" for n in _guessed(base)]
    if not sizes:
        return ()
    return (
        f"check that the sensors have a noise of {', '.join(sizes)}: it was estimated from these records, and if it is less, something is"
        " missing; give it as a number, or as a quiet record",
    )


def _guessed(base: Fit) -> list[str]:
    """Outputs whose noise nobody has told."""
    return [name for name in base.misfit if base.noise.sources.get(name) not in KNOWN]


def _sentences(
    base: Fit, look: ResidualLocalisation, surrogate: Surrogate | None, judges: Sequence[Experiment], partly: bool
) -> Iterator[str]:  # fmt: skip
    enough = surrogate is not None and surrogate.explained_fraction >= decision.HELD_OUT
    if _guessed(base) and not enough:
        yield (
            f"give the noise of {', '.join(_guessed(base))} (a number, or a quiet record): it was estimated from these records and may"
            " hold part of what is missing"
        )
    if not look.missing:
        yield "what is missing hardly shows in the estimation records: learn from longer ones, or such that reach as far as the validation"
    beyond = [] if enough else _beyond(base, look, surrogate, judges)
    yield from beyond
    if surrogate is not None:
        yield from _of_tone(surrogate) if surrogate.tone is not None else _of_curve(surrogate)
    elif look.missing and not (beyond or partly):
        yield (
            "no curve over one variable explains it: record the same motion slowly and fast, and at two amplitudes; what differs then has"
            " a memory (play, hysteresis, creep, a part that moves by itself)"
        )
    unmeasured = [o.name for o in base.model.outputs if o.name not in base.misfit]
    if unmeasured and (len(look.where) > 1 or not enough):
        yield f"measure {' and '.join(unmeasured)} as well: that narrows down the place"


def _of_tone(surrogate: Surrogate) -> Iterator[str]:
    assert surrogate.tone is not None
    frequency = surrogate.tone.frequency
    mains = [f for f in MAINS for k in range(1, MULTIPLES) if abs(frequency - k * f) < NEAR * f]
    if mains:
        yield f"the mains have {mains[0]:.0f} Hz and its multiples: look at grounding, shields and the supply of drive and sensor first"
    else:
        yield "look for what turns or switches at this frequency near the rig; a record with the input at zero shows it alone"
    yield "if it stays, the model with the generator is what an observer or a notch needs to reject it"


def _beyond(
    base: Fit, look: ResidualLocalisation, surrogate: Surrogate | None, judges: Sequence[Experiment]
) -> list[str]:  # fmt: skip
    """What to say where the judging records reach beyond the range in which the signal, or the curve, is known."""
    region = surrogate.region if surrogate is not None else next(iter(look.dependences), None)
    signal = surrogate.signal if surrogate is not None else look.signal
    if region is None or signal is None or region.variable not in signal.variables:
        return []
    seen = [v for t in base.traces for v in _values(t.measured, t.inputs, region.variable)]
    judging = [v for e in judges for v in _values(e.outputs, e.inputs, region.variable)]
    if not seen or not judging:
        return []
    (low, high), (least, most) = ((np.nanmin(np.concatenate(v)), np.nanmax(np.concatenate(v))) for v in (seen, judging))
    if min(least - low, high - most) >= -BEYOND * (high - low):
        return []
    return [
        f"the validation records reach from {least:.3g} to {most:.3g} {region.unit} in {region.variable}, the estimation records from"
        f" {low:.3g} to {high:.3g} {region.unit} only: learn from records that cover the whole range"
    ]


def _values(
    outputs: Mapping[str, np.ndarray], inputs: Mapping[str, np.ndarray], name: str
) -> list[np.ndarray]:  # fmt: skip
    return [group[name] for group in (outputs, inputs) if name in group]


def _of_curve(surrogate: Surrogate) -> Iterator[str]:
    if surrogate.region.period is not None:
        yield "what repeats with the position comes from magnets, teeth, a thread or a bearing: the period tells which"
    elif "flat middle" in surrogate.shape or "bend" in surrogate.shape:
        yield "a curve that bends at a place comes from a stop, a contact or a guide that ends there: look at the rig at that position"
    if surrogate.explained_fraction >= decision.HELD_OUT:
        yield "go on with the model that has the curve, or read its law off the figure and write it as an effect of your own"
    else:
        yield (
            f"the curve is a part of it, what is left depends on more than {surrogate.variable}: record the same motion slowly and fast,"
            " and at two amplitudes"
        )
