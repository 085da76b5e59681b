"""The command `greybox`: a small file for each of its commands, heavy imports only where a command needs them."""

from greybox.cli.app import app, main

__all__ = ["app", "main"]
