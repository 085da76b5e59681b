"""The command's front: its sub-commands, its version, its help."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from greybox.extensions.app.command import app as browser_app
from greybox.extensions.changes.command import changed
from greybox.extensions.design.command import campaign, design
from greybox.extensions.export.command import export
from greybox.shell.check import check
from greybox.shell.compare import compare
from greybox.shell.discover import discover
from greybox.shell.fit import fit
from greybox.shell.project_commands import demo, effects, init, models, schema
from greybox.shell.simulate import simulate
from greybox.shell.terminal import CommandGroup, PlainCommand, exit_on_error

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


def format_examples(*lines: str) -> str:
    """The end of a command's help: lines to copy."""
    return "Examples:\n\n\b\n" + "\n".join(f"  {line}" for line in lines)


app.command(
    cls=PlainCommand,
    short_help="Fit a model's parameters to records.",
    epilog=format_examples(
        "greybox fit micro_actuator record.csv --fix M=0.01 --fix Ra=8 --validate other.csv",
        "greybox fit my/rig.py a.csv b.csv --start K=5000 --noise x=2e-7 --output results/rig",
        "greybox fit emps record.csv --effect coulomb_friction --hold first",
    ),
)(exit_on_error(fit))
app.command(
    cls=PlainCommand,
    short_help="Compare a physical model with black-box models.",
    epilog=format_examples(
        "greybox compare micro_actuator step.csv --validate chirp.csv --fix M=0.01 --at-rest",
        "greybox compare silverbox train.csv --validate test.csv --skip 50 --effects cubic_stiffness,cubic_stiffness+input_offset",
    ),
)(exit_on_error(compare))
app.command(
    cls=PlainCommand,
    short_help="Find the effect that a model lacks.",
    epilog=format_examples(
        "greybox discover micro_actuator train.csv --validate test.csv --fix M=0.01 --at-rest",
        "greybox discover emps train.csv --validate test.csv --effects coulomb_friction,constant_load",
    ),
)(exit_on_error(discover))
app.command(
    cls=PlainCommand,
    short_help="Design the next record within what the rig allows.",
    epilog=format_examples(
        "greybox design results/rig-fit/fit.json --limit u=-3:3 --limit x=-1e-4:1e-4 --duration 1",
        "greybox design results/rig-discover/discovery.json train.csv --goal discrimination --limit u=-3:3",
        "greybox design my/rig.py --noise x=2e-7 --limit u=-1:1 --rate u=100 --duration 0.5 --sampling-time 2.5e-4",
    ),
)(exit_on_error(design))
app.command(
    cls=PlainCommand,
    short_help="Design, measure, fit and discover in turn, in one folder.",
    epilog=format_examples(
        "greybox campaign my/rig.py --noise x=2e-7 --limit u=-1:1 --duration 0.5 --sampling-time 2.5e-4 --output rig",
        "greybox campaign my/rig.py ... --rig 'python play.py {input} {record}'",
    ),
)(exit_on_error(campaign))
app.command(
    cls=PlainCommand,
    short_help="Tell what has changed in a machine since its fit.",
    epilog=format_examples(
        "greybox changed results/rig-fit/fit.json today.csv",
        "greybox changed results/rig-fit/fit.json today.csv --validate today2.csv --model my/rig.py",
        "greybox changed results/rig-fit/fit.json machines/* --population",
        "greybox changed results/rig-fit/fit.json months/ --chart",
    ),
)(exit_on_error(changed))
app.command(
    cls=PlainCommand,
    short_help="Open a model and its records in the browser.",
    epilog=format_examples(
        "greybox app micro_actuator train.csv --validate test.csv --fix M=0.01 --at-rest",
        "greybox app my/rig.py",
        "greybox app study.toml",
    ),
)(exit_on_error(browser_app))
app.command(
    cls=PlainCommand,
    short_help="Export a fitted model for controller design, or as code.",
    epilog=format_examples(
        "greybox export results/micro_actuator-fit/fit.json --to mat --dt 2.5e-4 --delay 1e-4 --samples 100",
        "greybox export fit.json --to control --at u=1",
        "greybox export fit.json --to c --output firmware/plant.c",
    ),
)(exit_on_error(export))
app.command(
    cls=PlainCommand,
    short_help="Simulate a model and write a record.",
    epilog=format_examples(
        "greybox simulate micro_actuator --step 1 --duration 0.2 --sampling-time 2.5e-4",
        "greybox simulate micro_actuator --multisine 2 --band 5:800 --duration 1.5 --sampling-time 2.5e-4 \\",
        "    --noise x=2e-7 --noise i=5e-3 --seed 1 --output record.csv",
        "greybox simulate my/rig.py input.csv --set K=5000 --output simulated.csv",
    ),
)(exit_on_error(simulate))
app.command(
    cls=PlainCommand,
    short_help="Check a model before a fit: units, integration, identifiability.",
    epilog=format_examples("greybox check micro_actuator", "greybox check micro_actuator record.csv --fix M=0.01"),
)(exit_on_error(check))
app.command(
    cls=PlainCommand,
    short_help="List the models, or print one model.",
    epilog=format_examples("greybox models", "greybox models micro_actuator", "greybox models my/rig.py"),
)(exit_on_error(models))
app.command(
    cls=PlainCommand,
    short_help="List the effects, or where they act in a model.",
    epilog=format_examples("greybox effects", "greybox effects micro_actuator", "greybox effects my/rig.py --json"),
)(exit_on_error(effects))
app.command(
    cls=PlainCommand,
    short_help="Create a project with example files.",
    epilog=format_examples("greybox init my_rig", "cd my_rig && greybox models"),
)(exit_on_error(init))
app.command(
    cls=PlainCommand,
    short_help="Print the JSON Schema of what a command prints with --json.",
    epilog=format_examples("greybox schema fit", "greybox schema changed > changed.schema.json"),
)(exit_on_error(schema))
app.command(
    cls=PlainCommand,
    short_help="Run every step on a simulated actuator.",
    epilog=format_examples("greybox demo", "greybox demo --output somewhere"),
)(exit_on_error(demo))


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
