"""Pneumatic cylinder with a proportional valve, the whole chain (eqs. 10.1, 10.3, 10.6). SI units, absolute pressures.

Flow after ISO 6358 through a valve whose opening grows as a power of the voltage, choked or not; volumes that change
with the position, with dead volumes; a rod on side B; polytropic gas; leakage (none until set); viscous friction; end
caps. See `models.pneumatic_valves`, `pneumatic_chambers` and `pneumatic_pistons` for the equations of each part.

    s'   = v
    M v' = A_A p_a - A_B p_b - (A_A - A_B) P_a - M f_v v
    p_a' = n [ (P_a / rho_a) m_a - p_a A_A v ] / (V_dA + A_A (stroke / 2 + s))
    p_b' = n [ (P_a / rho_a) m_b + p_b A_B v ] / (V_dB + A_B (stroke / 2 - s))

with `m = +- C (|u| / u_ref)^q P_u rho_a phi(P_d / P_u)`, from the supply into one chamber and out of the other.

Where it becomes the linear chain: equal areas, `q = 1`, `n = 1`, small motions about mid-stroke with both pressures
near some `p0`. The linear chain has that pressure in the place of `P_S / 2` and, since filling A and venting B both
drive the piston, ::

    K2 = C rho_a [ P_S phi(p0 / P_S) + p0 phi(P_a / p0) ] / (2 p0)       f_v = f_v

Both flows are equal at the pressure to which repeated strokes lead, `P_S phi(p0 / P_S) = p0 phi(P_a / p0)` (with a
choked exhaust `p0 = P_S phi(p0 / P_S)`, about `0.8 P_S`), and there `K2 = C rho_a phi(P_a / p0)`.

What a record can tell: with a choked exhaust the speed is `P_a C(u) / A` whatever the supply, so position shows `C` and
`q`, and the lag of the gas spring; `b` shows where an exhaust is not choked, in pressures best.

Source: Linear ARX modelling of pneumatic actuator system (book chapter 10), section 10.2, equations 10.1 to 10.6.
"""

from models.pneumatic_chambers import gas_chambers
from models.pneumatic_parts import pneumatic_chain
from models.pneumatic_pistons import viscous_piston
from models.pneumatic_valves import iso6358_valve

pneumatic_full = pneumatic_chain(
    "pneumatic_full",
    valve=iso6358_valve("power"),
    chambers=gas_chambers("rod", polytropic=True, leakage=True),
    piston=viscous_piston(end_stops=True),
    description="double-acting cylinder with a proportional valve, ISO 6358 flow and moving volumes",
    source="Linear ARX modelling of pneumatic actuator system (chapter 10), section 10.2, eqs. 10.1, 10.3, 10.6",
)
