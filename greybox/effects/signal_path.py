"""Signal path: what the drive and the sensor do to a signal on its way in and out."""

from __future__ import annotations

from greybox.model import Effect
from greybox.signals import Expression, Named, Parameter


def _offset(value: Expression, x: Named, u: Named, p: Named) -> Expression:
    return value + p.u0


input_offset = Effect(
    "input_offset",
    site="input",
    parameters=[
        Parameter(
            "u0",
            "{input}",
            0.0,
            source="amplitude, absent until fitted",
            description="offset between the recorded and the acting input, either sign",
        )
    ],
    on_input=_offset,
    equation="u + u0",
    parity="even",
    tells_apart=(
        "For a linear spring an input offset and a constant load give the same displacement record. Disconnect the"
        " drive: the load stays, the offset goes; or measure the current at rest, which only the offset moves."
    ),
    source="amplifier and converter offset",
)

SIGNAL_PATH: tuple[Effect, ...] = (input_offset,)
