"""From links and hinges of the micro-motion actuator to lumped mass, damping, stiffness (eqs. 5 to 7). SI units.

One quarter of the mechanism is a four-bar linkage in the pseudo-rigid-body model: a first link of mass `m1` and
moment of inertia `I1` turns about hinge 1 with its mass centre at `beta1 r1`; hinge 2 at its end carries the
moving link and a quarter of the coil, together `m2`, which only translate along x. At `theta1 = 90 deg`::

    dx = -r1 dtheta1,    dtheta2 = -dtheta1,    omega2 = -omega1

`theta2` is relative to link 1 (the paper's velocity of `m2` contains `omega1 + omega2`, the moving link's own
rate, which is zero). So hinge 2 bends by `-dtheta1`, as much as hinge 1, and stores and dissipates as much for
the same constants::

    M = m1 beta1^2 + I1 / r1^2 + m2        B = (B1 + B2) / r1^2        K = (K1 + K2) / r1^2        (one quarter)

The paper prints `M = {m1 [(beta1 r1)^2 + I1] + m2 r1^2} / r1^2`, whose `m1 I1` has not the unit of the rest,
and `B = B1 / r1^2`, `K = K1 / r1^2`, because its hinge 2 bends by `dtheta1 + dtheta2 = 0`: half the stiffness
and damping for equal hinges. Both forms are here; `as_printed` is for comparing with the paper, `corrected` for
everything else. The lumped values identified from a record do not depend on which one is right. The whole
device is four quarters side by side.

Source: Y.-L. Wang, Micro motion actuator of compliant mechanism for parameter estimation, section 4.2,
equations 5, 6, 7.
"""

from dataclasses import dataclass

QUARTERS = 4  # symmetry of the device, figure 2


@dataclass(frozen=True)
class Geometry:
    """One quarter of the mechanism, with the paper's symbols.

    `m1` mass of the first link [kg], `m2` mass of the moving link with a quarter of the coil [kg], `I1` moment
    of inertia of the first link about its mass centre [kg m^2], `beta1` where that centre lies along the link
    [-], `r1` length of the first link between its hinges [m], `B1`, `B2` damping of the hinges [N m s/rad],
    `K1`, `K2` stiffness of the hinges [N m/rad].
    """

    m1: float
    m2: float
    I1: float
    beta1: float
    r1: float
    B1: float
    B2: float
    K1: float
    K2: float


@dataclass(frozen=True)
class Lumped:
    """Lumped constants of equation 9: `M` [kg], `B` [N s/m], `K` [N/m]."""

    M: float
    B: float
    K: float


# Assumed, plausible: a 20 mm link whose polyethylene hinges and masses give the defaults of `micro_actuator`
# (K1 = K2 = 0.295 N m/rad is a hinge modulus of about 0.9 GPa; M = 0.010 kg and B = 0.2691 N s/m shared out).
PLAUSIBLE = Geometry(
    m1=0.6e-3, m2=2.3e-3, I1=2.0e-8, beta1=0.5, r1=0.020, B1=1.3455e-5, B2=1.3455e-5, K1=0.294775, K2=0.294775
)


def corrected(g: Geometry) -> Lumped:
    """`M`, `B`, `K` of one quarter, from energies with consistent units and both hinges bending."""
    return Lumped(
        M=g.m1 * g.beta1**2 + g.I1 / g.r1**2 + g.m2,  # eq. 5, I1 outside the bracket of m1
        B=(g.B1 + g.B2) / g.r1**2,  # eq. 6 with the relative rate omega2 = -omega1
        K=(g.K1 + g.K2) / g.r1**2,  # eq. 7 with the relative angle dtheta2 = -dtheta1
    )


def as_printed(g: Geometry) -> Lumped:
    """`M`, `B`, `K` of one quarter exactly as equations 5 to 7 print them (`M` adds kg to kg^2: numbers only in SI)."""
    return Lumped(
        M=(g.m1 * ((g.beta1 * g.r1) ** 2 + g.I1) + g.m2 * g.r1**2) / g.r1**2,
        B=g.B1 / g.r1**2,
        K=g.K1 / g.r1**2,
    )


def whole_device(quarter: Lumped) -> Lumped:
    """Four quarters moving together: the `M`, `B`, `K` of `models.micro_actuator`."""
    return Lumped(QUARTERS * quarter.M, QUARTERS * quarter.B, QUARTERS * quarter.K)
