"""The command's front: its sub-commands, its version, its help."""

from __future__ import annotations

import os
from pathlib import Path

import click

from greybox.base.extensions import ExtensionKind, load_extensions, reserve
from greybox.shell import check, command_line, compare, discover, fit, simulate, study, terminal
from greybox.shell.project_commands import DEMO, EFFECTS, EXTENSIONS, INIT, MODELS, SCHEMA

CORE: dict[str, study.Command] = {
    "fit": fit.FIT,
    "compare": compare.COMPARE,
    "discover": discover.DISCOVER,
    "simulate": simulate.SIMULATE,
    "check": check.CHECK,
    "models": MODELS,
    "effects": EFFECTS,
    "init": INIT,
    "schema": SCHEMA,
    "demo": DEMO,
    "extensions": EXTENSIONS,
}
reserve(ExtensionKind.COMMANDS, CORE)
# Every command by its name, in the order of the help: those of the core, then those of extensions.
COMMANDS: dict[str, study.Command] = {**CORE, **load_extensions(ExtensionKind.COMMANDS)}


def _print_version(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        from importlib.metadata import PackageNotFoundError, version

        try:
            click.echo(f"greybox {version('greybox-sysid')}")
        except PackageNotFoundError:
            click.echo("greybox (not installed: run from its source)")
        raise click.exceptions.Exit


# Where each shell looks for the completion of a command; zsh needs the folder in its list.
COMPLETION_FILES = {
    "bash": ".local/share/bash-completion/completions/greybox",
    "zsh": ".zfunc/_greybox",
    "fish": ".config/fish/completions/greybox.fish",
}


def _complete(ctx: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    """Print the script with which the current shell completes the command, or write it to where the shell finds it."""
    if not wanted or ctx.resilient_parsing:
        return
    from click.shell_completion import get_completion_class

    from greybox.base import write_file

    shell = Path(os.environ.get("SHELL", "bash")).name
    completion = get_completion_class(shell)
    if completion is None or shell not in COMPLETION_FILES:
        raise click.UsageError(f"there is no completion for the shell {shell}; known: {', '.join(COMPLETION_FILES)}")
    script = completion(ctx.command, {}, "greybox", "_GREYBOX_COMPLETE").source()
    if parameter.name == "show_completion":
        click.echo(script)
    else:
        file = write_file(Path.home() / COMPLETION_FILES[shell], script)
        more = "; add to ~/.zshrc: fpath+=~/.zfunc; autoload -Uz compinit; compinit" if shell == "zsh" else ""
        click.echo(f"{shell} completion written to {file}{more}; it works in the next shell")
    raise click.exceptions.Exit


app = terminal.CommandGroup(
    "greybox",
    commands={name: command_line.make_command(name, command, COMMANDS) for name, command in COMMANDS.items()},
    params=[
        click.Option([flag], is_flag=True, is_eager=True, expose_value=False, callback=callback, help=text)
        for flag, callback, text in (
            ("--version", _print_version, "Show the version and exit."),
            ("--install-completion", _complete, "Install completion for the current shell."),
            ("--show-completion", _complete, "Print the script that completes the command in the current shell."),
        )
    ],
    help="Grey-box identification: physical parameters with intervals from measured records.",
    epilog="Start with:\n\n\b\n  greybox demo\n  greybox models\n  greybox fit --help",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)


def run() -> None:
    """Run the command that ``sys.argv`` holds."""
    # The matrices are small: a pool of threads costs more than it does. Read when numpy is loaded, which is later.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    app(prog_name="greybox")
