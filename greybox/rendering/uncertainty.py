"""Profiles in plain text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from greybox.rendering.registry import renders

if TYPE_CHECKING:
    from greybox.uncertainty import Profile


@renders("Profile")
def write_profile(profile: Profile) -> str:
    """``K: 7000 N/m, 95 % by profile likelihood [6988, 7012]``; sides that the data leave open are marked."""
    sides = [
        f"{v:.5g}{' (open)' if is_open else ''}"
        for v, is_open in zip(profile.interval, profile.open_sides, strict=True)
    ]
    return f"{profile.name}: {profile.best:.5g} {profile.unit}, 95 % by profile likelihood [{sides[0]}, {sides[1]}]"
