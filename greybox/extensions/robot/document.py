"""The identification of a robot: what its joints have, how well each torque is followed, the base parameters."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from greybox.base import Finding, format_unit
from greybox.base import document as doc
from greybox.base.figure import Axis, Curve, Figure, Panel, Points, Role, Scale, Thinning
from greybox.discovery.decision import Grade
from greybox.extensions.robot.result import JointEffect, RigidVerdict, RobotCode, RobotIdentification
from greybox.extensions.robot.table import KINDS
from greybox.show.documents.tables import provenance_section, worst_first
from greybox.show.figures.figure import typeset_unit
from greybox.show.sentences import register, writes
from greybox.show.sentences.wording import count_noun, format_number, format_with_std, join_names, percent_text

# Of more joints the answer has the number, the table has the names.
NAMED_JOINTS = 3


def describe_robot(identified: RobotIdentification, *, command: str = "") -> doc.Document:
    """What is said of the identification of a robot; ``command`` is what was typed."""
    return doc.Document(
        f"{identified.robot}: {count_noun(len(identified.joints), 'joint')}",
        _answer(identified),
        doc.Tone.CAUTION
        if identified.effects or identified.verdict is not RigidVerdict.AS_DESCRIBED
        else doc.Tone.GOOD,
        [_joint_table(identified), *_constant_tables(identified)],
        worst_first(identified.findings),
        [_base_table(identified), _effect_table(identified)],
        f"What do the joints of {identified.robot} have beside rigid bodies, and which constants does the record carry?",
        doc.Later(lambda: [doc.FigureBlock(plot_torques(identified))]),
        doc.Later(_sections, identified, command),
        "robot",
    )


def _answer(identified: RobotIdentification) -> str:
    certain = [e for e in identified.effects if e.grade is Grade.ESTABLISHED]
    named = {words: [e.joint for e in certain if e.kind == kind] for kind, words in WORDS.items()}
    parts = [
        f"{words} at {join_names(joints) if len(joints) <= NAMED_JOINTS else count_noun(len(joints), 'joint')}"
        for words, joints in named.items()
        if joints
    ]
    lacks = join_names(parts) if parts else "nothing that is certain beside rigid bodies"
    carried = sum(not b.is_open for b in identified.base)
    rigid = {
        RigidVerdict.AS_DESCRIBED: f"the rigid bodies agree with {identified.source}",
        RigidVerdict.SCALED: f"the rigid bodies are a multiple of those of {identified.source}",
        RigidVerdict.OTHER: f"the rigid bodies are other than {identified.source} says",
    }
    if identified.payload is not None:
        low, high = identified.payload.mass_interval
        rigid[identified.verdict] = (
            f"a payload of {identified.payload.mass:.3g} kg ({low:.4g} to {high:.4g}) on {identified.payload.link}"
        )
    return f"{identified.robot}: {lacks}; {rigid[identified.verdict]}; {carried} of {len(identified.base)} base parameters are carried."


def _joint_table(identified: RobotIdentification, *, with_sizes: bool = True) -> doc.TableBlock:
    rows = []
    for joint in identified.joints:
        effects = [
            _say_effect(e) if with_sizes else WORDS[e.kind] for e in identified.effects if e.joint == joint.joint
        ]
        cells = (format_number(v, 3) for v in (joint.torque, joint.rigid, joint.final))
        rows.append([joint.joint, *cells, ", ".join(effects) or "nothing"])
    head = ["joint", "torque rms", "rigid leaves", "left", doc.REMARK]
    note = "Rms of each torque, of what rigid bodies leave of it, and of what is left with all effects, in N m or N."
    return doc.TableBlock("What each joint has beside rigid bodies", head, rows, note)


def _say_effect(effect: JointEffect) -> str:
    size = format_with_std(effect.value, effect.std) + ("" if effect.unit == "1" else f" {format_unit(effect.unit)}")
    return f"{WORDS[effect.kind]} {size}" + ("" if effect.grade is Grade.ESTABLISHED else " (probable)")


def _base_table(identified: RobotIdentification) -> doc.TableBlock:
    rows = [
        [
            b.name,
            format_with_std(b.value, b.std) + " open" * b.is_open,
            b.unit,
            format_number(b.described, 4),
            # A constant that carries nothing else stands for itself.
            "" if b.formula == b.name else b.formula,
        ]
        for b in identified.base
    ]
    return doc.TableBlock(
        "Base parameters", ["constant", "estimate", "unit", "described", doc.REMARK], rows,
        "With one standard error. The number is that of the joint; what else it carries stands behind it.",
    )  # fmt: skip


def _constant_tables(identified: RobotIdentification) -> list[doc.TableBlock]:
    if not identified.torque_constants:
        return []
    first = identified.torque_constants[0].joint
    rows = []
    for c in identified.torque_constants:
        ratio = f"{c.ratio:.4g} ({c.ratio_interval[0]:.4g} to {c.ratio_interval[1]:.4g})"
        rows.append([c.joint, format_with_std(c.value, c.std), format_unit(c.unit), ratio])
    note = "What one ampere gives at the joint, gear included. Ratios rest on the currents alone, with their 95 % intervals."
    return [doc.TableBlock("Torque constants", ["joint", "constant", "unit", f"ratio to {first}"], rows, note)]


def _effect_table(identified: RobotIdentification) -> doc.TableBlock:
    rows = []
    for e in identified.effects:
        size = [format_with_std(e.value, e.std), format_unit(e.unit), percent_text(e.share, 2)]
        rows.append([e.joint, WORDS[e.kind], *size, e.grade.replace("_", " ")])
    return doc.TableBlock(
        "Effects", ["joint", "effect", "estimate", "unit", "takes", "grade"], rows,
        "Takes: share of the rms error of its joint. Established: nothing else of the list imitates it on this record.",
    )  # fmt: skip


def _sections(identified: RobotIdentification, command: str) -> Iterator[doc.Section]:
    # The page has their sizes in a table of their own.
    tables = [_joint_table(identified, with_sizes=False), *[_effect_table(identified)] * bool(identified.effects)]
    yield doc.Section("joints", "Joint by joint", [*tables, *_constant_tables(identified)])
    yield doc.Section(
        "base", "Base parameters", [doc.FigureBlock(plot_base_parameters(identified)), _base_table(identified)]
    )
    if identified.findings:
        yield doc.Section("notes", "What to know", [doc.BulletList(worst_first(identified.findings))])
    yield provenance_section(command)


def plot_torques(identified: RobotIdentification) -> Figure:
    """Torque of each joint: measured, of the rigid bodies, with all effects."""
    labels = (("measured", Role.MEASURED), ("rigid bodies", Role.BASELINE), ("with all effects", Role.EXTENDED))
    count_all = np.isfinite(identified.torques[0]).any(axis=0)
    # Records follow one another: time goes on where the next one begins.
    steps = np.diff(identified.time, prepend=identified.time[0])
    time = identified.time[0] + np.cumsum(np.where(steps < 0, np.median(steps), steps))
    panels = []
    for joint, k in zip(identified.joints, np.flatnonzero(count_all), strict=True):
        curves = [
            Curve(time, torque[:, k], role, label, thinning=Thinning.ENVELOPE)
            for torque, (label, role) in zip(identified.torques, labels, strict=True)
        ]
        panels.append(Panel(joint.joint, tuple(curves), Axis("time", "s"), Axis(joint.joint, typeset_unit(joint.unit))))
    caption = "Each torque as measured, that of the rigid bodies, and with all effects, where the joint moves."
    return Figure("torques", tuple(panels), caption)


def plot_base_parameters(identified: RobotIdentification) -> Figure:
    """Each base parameter with its 95 % interval beside the description, kind by kind."""
    panels = []
    for unit in dict.fromkeys(b.unit for b in identified.base):
        each = [b for b in identified.base if b.unit == unit]
        names, bars = [b.name for b in each], np.array([(b.interval[1] - b.interval[0]) / 2 for b in each])
        series = (
            Points(names, np.array([b.described for b in each]), Role.BASELINE, "described", size=7, hollow=True),
            Points(names, np.array([b.value for b in each]), Role.EXTENDED, "identified", size=5, half_bars=bars),
        )
        shown = typeset_unit(unit.replace(" ", "*"))
        panels.append(Panel(shown, series, Axis(scale=Scale.CATEGORY), Axis("base parameter", shown)))
    caption = "The base parameters with their 95 % intervals, and what the description says."
    return Figure("base_parameters", tuple(panels), caption)


DOCUMENTS = {"RobotIdentification": describe_robot}
"""Class of a result -> the function that describes it."""


WORDS = {kind.name: kind.words for kind in KINDS}


@writes(RobotCode.JOINTS_BY_NAME)
def _by_name(finding: Finding) -> str:
    v = finding.values
    joints = join_names(v["joints"]) if len(v["joints"]) <= 6 else f"{v['joints'][0]} to {v['joints'][-1]}"
    units = f", in {join_names(v['units'])} as their names say" if v["units"] else ""
    return f"columns are taken by the names of the joints {joints}{units}" + (
        f"; {v['effort']!r} states no unit and is taken as a torque: where it is a current, --column 'JOINT [A]={v['effort']}' says so"
        if v["effort"]
        else ""
    )


@writes(RobotCode.OPEN_CONSTANTS)
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
        RobotCode.AXIS_HELD: "axis {subject} is not in the record and is taken to stand at zero: its link is a part of what carries it",
        RobotCode.AXIS_WITHOUT_ROWS: "axis {subject} hardly moves, or its torque is not measured: nothing is said of its friction",
        RobotCode.VELOCITY_LATE: lambda f: (
            f"measured velocities of {join_names(f.values['joints'])} are {1e3 * f.values['low']:.2g} to"
            f" {1e3 * f.values['high']:.2g} ms late behind the positions, as a filter does it: they are brought forward"
        ),
        RobotCode.READ_SELDOM: lambda f: (
            f"positions are new every {1e3 * f.values['step']:.3g} ms, and written more often: rows that repeat them are left out"
        ),
        RobotCode.LONG_MEMORY: "what is left of the torques remembers {memory:.3g} s, and {rows:.3g} s were recorded: the intervals may be"
        " too narrow; record ten times as long",
        RobotCode.RIVAL: lambda f: (
            f"{f.subject}: {WORDS[f.values['kind']]} is probable, and {WORDS[f.values['rival']]} would do nearly as well"
        ),
        RobotCode.SCALED: "the rigid bodies weigh {factor:.3g} times what {subject} says ({low:.3g} to {high:.3g}): the torques read so"
        " much too large, by the torque constants, or every mass is",
        RobotCode.NOT_FOLLOWED: "a quarter of the torque of {joints:and} or more is not followed: are its columns those of this joint, in"
        " these units, with this sign, and in the order of the axes?",
        RobotCode.GAIN: lambda f: (
            f"{f.subject} reads {f.values['gain']:.3g} times its torque if the other joints read right; were it these that read"
            f" {1 / f.values['gain']:.3g} times theirs, it would look the same, with masses and frictions {f.values['gain']:.3g} times"
            " those printed"
        ),
        RobotCode.TORQUE_LEVEL: lambda f: (
            "currents alone tell torque constants, masses and frictions but for one factor that all of them share: it is that at which"
            f" links weigh what {f.values['source']} says{' beside the payload' * bool(f.values['payload'])}; one known constant"
            " (--torque-constant JOINT=VALUE) or a record with a known payload (--payload RECORD=KG) closes it"
        ),
        RobotCode.CONSTANT_UNTOLD: "the record hardly tells what one ampere gives at {joints:and}: it is taken as described or as at the"
        " others, and what is said of friction there is in proportion; --torque-constant JOINT=VALUE states it",
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
