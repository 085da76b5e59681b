"""Limits and sizes of the app in the browser."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AppPolicy:
    """What the page may ask for, and how finely it draws."""

    stretches: int = 700
    """Stretches by which a long curve is drawn, each by its smallest and largest value: a redraw while a slider moves must be quick."""
    largest_request: int = 1_000_000
    """Bytes of a request that is no record: values of all constants take a few thousand."""
    token_bytes: int = 24
    """Random bytes of the token in the address: nobody guesses 192 bits."""
    heartbeat_seconds: float = 15.0
    """Seconds between signs of life on the stream of progress, so that a page that is gone is noticed."""
    grace_seconds: float = 3.0
    """Seconds in which a fit or a discovery that is told to end at once may do so by itself, before its process is killed."""
    most_undone: int = 100
    """Steps that can be taken back; each is a few values, but a fit among them holds its runs."""
    slider_ratio: float = 10.0
    """A slider of a positive constant reaches from its value over this to its value times this."""
    slider_reach: float = 3.0
    """A slider of any other constant reaches so many times its size to both sides."""


APP_POLICY = AppPolicy()
