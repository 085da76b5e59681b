"""What a joint has beside rigid bodies: the effects that are looked for, each a column of the regression of its torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    family
        Kinds of one family do nearly the same on many records.
    is_positive
        Whether a negative constant cannot be.
    """

    name: str
    words: str
    units: tuple[str, str]
    family: str
    is_positive: bool = True


VISCOUS = JointEffectKind("viscous_friction", "viscous friction", ("N*m*s/rad", "N*s/m"), "friction")
COULOMB = JointEffectKind("coulomb_friction", "dry friction", ("N*m", "N"), "dry")
STRIBECK = JointEffectKind("stribeck_friction", "a Stribeck rise of the friction near rest", ("N*m", "N"), "dry")
LOAD = JointEffectKind("load_dependent_friction", "friction that grows with the load", ("1", "1"), "dry")
OFFSET = JointEffectKind("torque_offset", "an offset of the torque", ("N*m", "N"), "sensor", is_positive=False)
INERTIA = JointEffectKind("motor_inertia", "inertia of the motor", ("kg*m^2", "kg"), "inertia")
GAIN = JointEffectKind("drive_gain", "a wrong gain of the drive", ("1", "1"), "sensor", is_positive=False)
LAG = JointEffectKind("torque_lag", "a delay between torque and motion", ("s", "s"), "sensor", is_positive=False)
KINDS = (VISCOUS, COULOMB, OFFSET, STRIBECK, LOAD, INERTIA, GAIN, LAG)
# The columns of a joint, in their order: the kinds, the Stribeck effect once for each width.
COLUMNS = (VISCOUS, COULOMB, OFFSET, *[STRIBECK] * len(STRIBECK_SHARES), LOAD, INERTIA, GAIN, LAG)


def effect_columns(dq: np.ndarray, ddq: np.ndarray, rigid: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """What each of `COLUMNS` adds to the torque of a joint at unit constant (N, C).

    Parameters
    ----------
    dq, ddq
        Its velocity and acceleration (N,).
    rigid, rate
        The torque of the rigid bodies (N,) as first estimated, and its change in a second.
    """
    sign, fastest = np.sign(dq), np.abs(dq).max(initial=0.0) or 1.0
    return np.column_stack(
        [
            dq,
            sign,
            np.ones_like(dq),
            # sign(v) exp(-(v / vs)^2) (Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994)
            *(sign * np.exp(-((dq / (share * fastest)) ** 2)) for share in STRIBECK_SHARES),
            # mu |load| sign(v) (Hamon, Gautier, Garrec, IROS 2010)
            np.abs(rigid) * sign,
            ddq,
            # tau = (1 + e) rigid
            rigid,
            # tau(t) = rigid(t - delay): to the first order -delay d rigid / dt
            -rate,
        ]
    )
