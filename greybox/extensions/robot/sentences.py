"""What is said of a robot: which axes were held, which constants are open, what imitates what."""

from __future__ import annotations

from greybox.base import Finding
from greybox.extensions.robot.joint_effects import KINDS
from greybox.extensions.robot.result import RobotCode
from greybox.show.sentences.registry import register
from greybox.show.sentences.wording import join_names, percent_text

WORDS = {kind.name: kind.words for kind in KINDS}


def _open(finding: Finding) -> str:
    v = finding.values
    names = (
        join_names(v["names"])
        if len(v["names"]) <= 6
        else f"{join_names(v['names'][:5])} and {len(v['names']) - 5} more"
    )
    return f"the record hardly tells {names}: {v['motion']}"


register(
    {
        RobotCode.AXIS_HELD: (
            "axis {subject} is not in the record and is taken to stand at zero: its link is a part of what carries it"
        ),
        RobotCode.AXIS_WITHOUT_ROWS: "axis {subject} hardly moves, or its torque is not measured: nothing is said of its friction",
        RobotCode.LONG_MEMORY: lambda f: (
            f"what is left of the torques remembers {f.values['memory']:.3g} s, and {f.values['rows']:.3g} s were recorded: the intervals"
            " may be too narrow; record ten times as long"
        ),
        RobotCode.OPEN_CONSTANTS: _open,
        RobotCode.RIVAL: lambda f: (
            f"{f.subject}: {WORDS[f.values['kind']]} is probable, and {WORDS[f.values['rival']]} would do nearly as well"
        ),
        RobotCode.SCALED: lambda f: (
            f"the rigid bodies weigh {f.values['factor']:.3g} times what {f.subject} says ({f.values['low']:.3g} to {f.values['high']:.3g})"
            ": the torques read so much too large, by the torque constants, or every mass is"
        ),
        RobotCode.PHYSICAL: lambda f: (
            "links whose mass is nowhere negative follow the torques"
            + (
                f" with {percent_text(f.values['increase'], 2)} more error"
                if f.values["increase"] > 1e-4
                else " as well"
            )
        ),
    }
)
