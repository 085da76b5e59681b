"""The demonstration: a rig that is not there hides an effect from its model; it is found, named and closes the gap."""

from greybox.demo.story import EXTENDED, HIDDEN, KNOWN, MODEL, NOISE, PLAIN, STRENGTH, Demo, demo

__all__ = ["EXTENDED", "HIDDEN", "KNOWN", "MODEL", "NOISE", "PLAIN", "STRENGTH", "Demo", "demo"]
