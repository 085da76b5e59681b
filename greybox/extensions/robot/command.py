"""`greybox robot`."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from greybox.shell import inputs, options
from greybox.shell.study import Answer, Command, Option, Study
from greybox.shell.study_values import Numbers, Quantity, Switch
from greybox.shell.terminal import write_report


class RobotStudy(Study):
    """The options of `greybox robot`."""

    # A table: an option is a row or two.
    # fmt: off
    known_to = Option(Quantity(), "--known-to SHARE", "known_to",
        "How well ROBOT is known: 0.1 takes its constants to be right to 10 %. [default: not at all]")
    design = Option(Switch(), "--design", "design",
        "Also design the motion to record next, a Fourier series inside the limits of ROBOT.")
    torque_constants = Option(Numbers("JOINT=VALUE", "elbow=2.5"), "--torque-constant JOINT=VALUE", "torque_constants",
        "What one ampere gives at a joint, gear included, in N m/A or N/A. [default: fitted]")
    payloads = Option(Numbers("RECORD=KG", "loaded.csv=2.5"), "--payload RECORD=KG", "payloads",
        "Mass in kg that is fixed to the last link in this record alone: it tells the level of currents.")
    physical = Option(Switch(), "--physical", "physical", "Also look for constants of each link that a body can have.")
    # fmt: on


def robot(study: RobotStudy) -> Answer:
    """Tell what the joints of ROBOT have beside rigid bodies, and which of its constants RECORDS carry.

    The base parameters are fitted to the torques by weighed least squares with intervals that hold for coloured noise; each joint is
    searched for viscous, dry, Stribeck and load-dependent friction, an offset, the motor's inertia, a wrong gain and a delay, and the last
    link for a payload. Columns are q1, tau1, q2, tau2 ... in the order of the axes, i1 ... for currents in place of torques, and dq1 ...
    where velocities were measured; or they are called by the names of joints, shoulder.position, effort_shoulder ...
    Writes DIR/robot.json, DIR/report.html, a page for the browser, and two models that other commands take: DIR/motion.py runs, is
    linearised and exported; the export of DIR/torques.py is a controller's feed-forward. --design writes DIR/next_motion.csv, the motion
    that makes the intervals of the base parameters narrowest beside RECORDS, and says by how much.

    Exit code 0: there is an answer. 2: bad input, nothing was written.
    """
    from greybox.base import format_json, to_json_data
    from greybox.data.findings import RecordCode
    from greybox.extensions.export.python_model import to_python
    from greybox.extensions.robot.design import design_motion
    from greybox.extensions.robot.identify import identify_robot
    from greybox.extensions.robot.logs import read_joint_logs
    from greybox.extensions.robot.model import robot as read_plant
    from greybox.extensions.robot.model import robot_model
    from greybox.extensions.robot.result import RobotIdentification

    plant = read_plant(study.source)
    folder = inputs.result_folder(study, plant.name)
    logs = read_joint_logs(plant, study.estimation, **{"split": study.split_holes, **inputs.layout_of(study)})
    # Few robots measure velocities; what has no torque is said of the axis; a coarse encoder stands still where its joint turns back.
    silent = {RecordCode.OUTPUT_NOT_MEASURED, RecordCode.OUTPUT_CONSTANT}
    notes = [[f for f in log.findings if (f.code, f.subject[:1]) != (RecordCode.SENSOR_SATURATED, "q")] for log in logs]
    inputs.print_record_notes(
        replace(log, findings=tuple(f for f in each if f.code not in silent))
        for log, each in zip(logs, notes, strict=True)
    )
    identified = identify_robot(
        plant.robot,
        logs,
        prior=study.known_to or math.inf,
        physical=study.physical,
        torque_constants=study.torque_constants,
        payloads={Path(name).stem: mass for name, mass in study.payloads.items()},
    )
    saved = identified.save(folder / "robot.json")
    models = [
        to_python(robot_model(plant.robot, identified, inverse=inverse), folder / f"{name}.py")
        for name, inverse in (("motion", False), ("torques", True))
    ]
    answer: RobotIdentification | str = identified
    text, kept = saved.read_text(encoding="utf-8"), f"the answer is in {saved}"
    if study.design:
        noise = {joint.joint: joint.final for joint in identified.joints}
        # As many rows a second as the first log has.
        rate = (logs[0].rows - 1) / float(logs[0].time[-1] - logs[0].time[0])
        designed = design_motion(plant.robot, logs, noise=noise, rate=rate)
        models.append(designed.write_csv(folder / "next_motion.csv"))
        answer, kept = str(designed), f"the motion is in {models[-1]}"
        text = format_json(to_json_data(designed.to_data()))
    return Answer(
        answer,
        lambda _: text,
        [saved, *models],
        lambda: write_report(identified, folder / "report.html"),
        kept=kept,
        # What holds in another motion as well is the robot's own; the notes say which motion settles what is open.
        next=study.then(
            "robot", study.source, *study.estimation, "NEXT_MOTION_LOG.csv" if study.design else "ANOTHER_MOTION.csv"
        ),
    )


ROBOT = Command(
    robot,
    "Identify a robot: base parameters, and what each joint lacks.",
    (
        Study.source.but(usage="ROBOT", help="The robot: a URDF or an MJCF file."),
        Study.estimation.but(
            usage="RECORDS", help="Joint logs: CSV, MAT, MCAP and others, headers 'name [unit]'.", required=True
        ),
        *(RobotStudy.torque_constants, RobotStudy.payloads),
        *(RobotStudy.known_to, RobotStudy.physical, RobotStudy.design),
        *(Study.columns, Study.headers, Study.sampling_time, Study.read_limit),
        *(Study.first_time, Study.last_time, Study.split_holes),
        Study.output.but(help="Folder for the results. [default: results/ROBOT-robot]"),
        *options.SHOWING,
    ),
    (
        "greybox robot arm.urdf log.csv",
        "greybox robot arm.urdf monday.csv tuesday.csv --column 'q1 [deg]=joint_1_position' --output results/arm",
    ),
    (options.LAYOUT,),
    study=RobotStudy,
)

PRINTS = {"robot": ("greybox.extensions.robot.result:RobotIdentification",)}
"""Command -> types of what it prints with ``--json``."""
