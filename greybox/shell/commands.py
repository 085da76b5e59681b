"""The command's front: its sub-commands, its version, its help."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from greybox.base.extensions import ExtensionKind, load_extensions
from greybox.shell.check import check
from greybox.shell.compare import compare
from greybox.shell.discover import discover
from greybox.shell.fit import fit
from greybox.shell.project_commands import demo, effects, extensions, init, models, schema
from greybox.shell.simulate import simulate
from greybox.shell.terminal import Command, CommandGroup, PlainCommand, exit_on_error

app = typer.Typer(
    name="greybox",
    cls=CommandGroup,
    help="Grey-box identification: physical parameters with intervals from measured records.",
    epilog="Start with:\n\n\b\n  greybox demo\n  greybox models\n  greybox fit --help",
    no_args_is_help=True,
    # Plain text: a message stays on one line, and nothing heavy is imported for --help.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)


OWN = (
    Command(
        fit,
        "Fit a model's parameters to records.",
        (
            "greybox fit micro_actuator record.csv --fix M=0.01 --fix Ra=8 --validate other.csv",
            "greybox fit my/rig.py a.csv b.csv --start K=5000 --noise x=2e-7 --output results/rig",
            "greybox fit emps record.csv --effect coulomb_friction --hold first",
        ),
    ),
    Command(
        compare,
        "Compare a physical model with black-box models.",
        (
            "greybox compare micro_actuator step.csv --validate chirp.csv --fix M=0.01 --at-rest",
            "greybox compare silverbox train.csv --validate test.csv --skip 50 --effects cubic_stiffness,cubic_stiffness+input_offset",
        ),
    ),
    Command(
        discover,
        "Find the effect that a model lacks.",
        (
            "greybox discover micro_actuator train.csv --validate test.csv --fix M=0.01 --at-rest",
            "greybox discover emps train.csv --validate test.csv --effects coulomb_friction,constant_load",
        ),
    ),
    Command(
        simulate,
        "Simulate a model and write a record.",
        (
            "greybox simulate micro_actuator --step 1 --duration 0.2 --sampling-time 2.5e-4",
            "greybox simulate micro_actuator --multisine 2 --band 5:800 --duration 1.5 --sampling-time 2.5e-4 \\",
            "    --noise x=2e-7 --noise i=5e-3 --seed 1 --output record.csv",
            "greybox simulate my/rig.py input.csv --set K=5000 --output simulated.csv",
        ),
    ),
    Command(
        check,
        "Check a model before a fit: units, integration, identifiability.",
        (
            "greybox check micro_actuator",
            "greybox check micro_actuator record.csv --fix M=0.01",
        ),
    ),
    Command(
        models,
        "List the models, or print one model.",
        (
            "greybox models",
            "greybox models micro_actuator",
            "greybox models my/rig.py",
        ),
    ),
    Command(
        effects,
        "List the effects, or where they act in a model.",
        (
            "greybox effects",
            "greybox effects micro_actuator",
            "greybox effects my/rig.py --json",
        ),
    ),
    Command(
        init,
        "Create a project with example files.",
        (
            "greybox init my_rig",
            "cd my_rig && greybox models",
        ),
    ),
    Command(
        schema,
        "Print the JSON Schema of what a command prints with --json.",
        (
            "greybox schema fit",
            "greybox schema changed > changed.schema.json",
        ),
    ),
    Command(
        demo,
        "Run every step on a simulated actuator.",
        (
            "greybox demo",
            "greybox demo --output somewhere",
        ),
    ),
    Command(
        extensions,
        "List what extensions add to the program.",
        ("greybox extensions", "greybox extensions --json"),
    ),
)
"""The commands of the core, in the order of the help; those of extensions follow."""


def _add(name: str, command: Command) -> None:
    lines = "\n".join(f"  {line}" for line in command.examples)
    epilog = f"Examples:\n\n\b\n{lines}"  # lines to copy
    app.command(name, cls=PlainCommand, short_help=command.short_help, epilog=epilog)(exit_on_error(command.run))


for _own in OWN:
    _add(_own.run.__name__, _own)
for _name, _command in load_extensions(ExtensionKind.COMMANDS).items():
    _add(_name, _command)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            typer.echo(f"greybox {version('greybox-sysid')}")
        except PackageNotFoundError:
            typer.echo("greybox (not installed: run from its source)")
        raise typer.Exit


@app.callback()
def _front(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Options before the sub-command."""


def run() -> None:
    """Run the command that ``sys.argv`` holds."""
    # The matrices are small: a pool of threads costs more than it does. Read when numpy is loaded, which is later.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    app(prog_name="greybox")
