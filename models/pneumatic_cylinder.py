"""Pneumatic cylinder with a proportional valve, linear chain (isothermal, small motions about mid-stroke). SI units.

A voltage opens the valve, which fills one chamber and vents the other (eqs. 10.2, 10.4); the piston's motion
changes both volumes (eq. 10.3); the difference of the pressures drives the piston against viscous friction
(eqs. 10.6, 10.7)::

    s'    = v
    M v'  = A (p_a - p_b) - M f_v v
    p_a'  =   G u - (P_S A / V) v          G = P_a K2 P_S / (rho_a V)
    p_b'  = - G u + (P_S A / V) v

`p_a` and `p_b` are absolute and start at `P_S / 2`. With `P_AB = p_a - p_b` this is equation 10.5, and from `u`
to `s` equation 10.9: an integrator of gain `P_a K2 / (rho_a A)` and a pair of poles with `wn^2 = 2 P_S A^2 / (M V)`.
The sum `p_a + p_b` never changes. Equal areas on both sides; rod, dead volumes and hoses are not in it.

`f_v` is mass-normalised, in 1/s, as equations 10.7 to 10.9 need it (the paper's text before them has it in N
s/m). `K2` is the mass flow per volt and pascal of upstream pressure.

It is the plainest assembly of the parts in `models.pneumatic_parts`; `models.pneumatic_full` is the fullest.

What a record can tell: from `u` and `s` alone the integrator's gain, `wn` and `f_v`; slow tones show only the
gain and the lag `f_v / wn^2`. A measured pressure shows `A / M` and `P_S A / V` apart.

Source: Linear ARX modelling of pneumatic actuator system (book chapter 10), section 10.2, equations 10.1 to 10.9.
"""

from models.pneumatic_chambers import linear_chambers
from models.pneumatic_parts import pneumatic_chain
from models.pneumatic_pistons import viscous_piston
from models.pneumatic_valves import linear_valve

pneumatic_cylinder = pneumatic_chain(
    "pneumatic_cylinder",
    valve=linear_valve(),
    chambers=linear_chambers(),
    piston=viscous_piston(),
    description="double-acting cylinder with a proportional valve, linearised about mid-stroke",
    source="Linear ARX modelling of pneumatic actuator system (chapter 10), section 10.2, eqs. 10.2 to 10.9",
    candidates=(
        *("coulomb_friction", "stribeck_friction", "lugre_friction", "quadratic_damping"),
        *("constant_load", "return_spring"),
        *("chamber_leakage", "choked_flow", "supply_droop", "position_dependent_volume"),
        *("valve_dead_zone", "input_saturation", "soft_saturation", "valve_lag", "transport_delay", "input_offset"),
        *("backlash", "sensor_lag"),
        *("end_stop", "end_stops", "cogging", "gain_by_sign", "valve_hysteresis"),
    ),
)
