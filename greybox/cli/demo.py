"""`greybox demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from greybox.cli import options as o
from greybox.cli.guard import INTERRUPTED, UNSUCCESSFUL, note, stop
from greybox.cli.interrupt import held
from greybox.cli.progress import meter


def demo(
    output: Annotated[
        Path, typer.Option("--output", metavar="DIR", help="Folder for records, fit.json and figures.")
    ] = Path("results/demo"),
) -> None:
    """Measure a simulated micro-motion actuator, find its constants from a start 40 % off, and judge them.

    The rig is simulated by an integrator that the fit does not use, with the noise of a displacement sensor and a
    current probe. Two of its constants are known. Takes about ten seconds.
    """
    from greybox.demo import KNOWN, MODEL, NOISE
    from greybox.demo import demo as run

    folder = o.writable_folder(output)
    with held() as interrupt, meter("fit", interrupt) as report:
        found = run(folder, report=report, say=note)
    if interrupt.asked or found.fit.status == "interrupted":
        stop(f"interrupted; the best point so far is in {found.result}", INTERRUPTED)
    typer.echo(f"\n{found.fit.equations}\n\n{found}\n")
    typer.echo(f"{found.seconds:.1f} s; status: {found.fit.meaning}")
    typer.echo(f"figures: {', '.join(map(str, found.figures))}\nfit:     {found.result}")
    first, second = found.records
    known = " ".join(f"--fix {name}={found.fit.parameters[name].value:g}" for name in KNOWN)
    noise = " ".join(f"--noise {name}={std:g}" for name, std in NOISE.items())
    typer.echo(f"\nthe same on these records:\n  greybox fit {MODEL} {first} --validate {second} {known} {noise}")
    if not found.fit.success:
        raise typer.Exit(UNSUCCESSFUL)
