"""What a joint has beside rigid bodies: the effects that are looked for, each a column of the regression of its torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.extensions.robot.description import Joint, JointKind

# Shares of the largest speed of a joint that are tried as the width of the Stribeck effect.
STRIBECK_SHARES = (0.03, 0.08, 0.2)


@dataclass(frozen=True)
class JointEffectKind:
    """One kind of effect.

    Parameters
    ----------
    name
        As findings and files call it.
    words
        As sentences call it.
    units
        Of its constant for a revolute and a prismatic joint.
    is_positive
        Whether a negative constant cannot be.
    """

    name: str
    words: str
    units: tuple[str, str]
    is_positive: bool = True

    def unit_at(self, joint: Joint) -> str:
        """Unit of its constant at a joint."""
        return self.units[joint.kind is JointKind.PRISMATIC]


VISCOUS = JointEffectKind("viscous_friction", "viscous friction", ("N*m*s/rad", "N*s/m"))
COULOMB = JointEffectKind("coulomb_friction", "dry friction", ("N*m", "N"))
STRIBECK = JointEffectKind("stribeck_friction", "a Stribeck rise of the friction near rest", ("N*m", "N"))
LOAD = JointEffectKind("load_dependent_friction", "friction that grows with the load", ("1", "1"))
OFFSET = JointEffectKind("torque_offset", "an offset of the torque", ("N*m", "N"), is_positive=False)
INERTIA = JointEffectKind("motor_inertia", "inertia of the motor", ("kg*m^2", "kg"))
GAIN = JointEffectKind("drive_gain", "a wrong gain of the drive", ("1", "1"), is_positive=False)
LAG = JointEffectKind("torque_lag", "a delay between torque and motion", ("s", "s"), is_positive=False)
# How far the width of a Stribeck effect is off, as a change of its logarithm: no effect, but fitted beside it.
WIDTH = JointEffectKind("stribeck_width", "the width of the Stribeck rise", ("1", "1"), is_positive=False)
KINDS = (VISCOUS, COULOMB, OFFSET, STRIBECK, LOAD, INERTIA, GAIN, LAG)
# The columns of a joint, in their order: the kinds, the Stribeck effect once for each width that is tried.
COLUMNS = (VISCOUS, COULOMB, OFFSET, *[STRIBECK] * len(STRIBECK_SHARES), WIDTH, LOAD, INERTIA, GAIN, LAG)


def effect_columns(
    dq: np.ndarray, ddq: np.ndarray, rigid: np.ndarray, rate: np.ndarray, width: float = np.nan, rise: float = 0.0
) -> np.ndarray:
    """What each of `COLUMNS` adds to the torque of a joint at unit constant (N, C).

    Parameters
    ----------
    dq, ddq
        Its velocity and acceleration (N,).
    rigid, rate
        The torque of the rigid bodies (N,) as first estimated, and its change in a second.
    width, rise
        Of the Stribeck effect where they are known; else several widths are tried.
    """
    sign, fastest = np.sign(dq), np.abs(dq).max(initial=0.0) or 1.0
    # sign(v) exp(-(v / vs)^2) (Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994)
    widths = [share * fastest for share in STRIBECK_SHARES] if np.isnan(width) else [width]
    raised = np.zeros((len(dq), len(STRIBECK_SHARES) + 1))
    raised[:, : len(widths)] = sign[:, None] * np.exp(-((dq[:, None] / np.array(widths)) ** 2))
    if not np.isnan(width):
        # d / d ln(vs)
        raised[:, -1] = 2 * rise * (dq / width) ** 2 * raised[:, 0]
    return np.column_stack(
        [
            dq,
            sign,
            np.ones_like(dq),
            raised,
            # mu |load| sign(v) (Hamon, Gautier, Garrec, IROS 2010)
            np.abs(rigid) * sign,
            ddq,
            # tau = (1 + e) rigid
            rigid,
            # tau(t) = rigid(t - delay): to the first order -delay d rigid / dt
            -rate,
        ]
    )
