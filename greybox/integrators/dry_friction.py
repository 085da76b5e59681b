"""Dry friction that sticks: the step is split where the velocity crosses zero.

While it slides, friction is ``-level * direction`` with a direction that does not change; where the velocity reaches zero the
step ends there, and the body either stays (the applied force is at most the static level) or leaves in the direction of the
applied force; a body at rest leaves at the moment at which that force passes the static level. No smoothing width, no creep
at standstill; the times of stopping and leaving are smooth functions of the parameters, so the step can be differentiated.
"""

from __future__ import annotations

import casadi as ca

from greybox.errors import ModelError
from greybox.integrators.step import AdvanceFunction, IntegrationMethod
from greybox.model.system import System
from greybox.numerics import TINY


def split_at_standstill(system: System, one_step: IntegrationMethod) -> AdvanceFunction:
    """``advance(x, ua, ub, p, h)`` for a system with dry friction, from the smooth one-step method ``one_step(rate)``."""
    bodies = {d.state for d in system.dry}
    if len(bodies) > 1:
        names = ", ".join(d.effect for d in system.dry)
        raise ModelError(f"dry friction on two velocities at once ({names}) is not supported; use it on one")
    j = bodies.pop()
    slide, hold, free, static = _make_rate_functions(system, j)

    def step_piece(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX, direction: ca.SX, is_stuck: ca.SX) -> ca.SX:
        """One smooth piece: sliding in a given direction, or standing still."""

        def rate(x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
            return ca.if_else(is_stuck, hold(x, u, p), slide(x, u, p, direction))

        return one_step(rate)(x, ua, ub, p, h)

    def compute_excess(x: ca.SX, u: ca.SX, p: ca.SX, push_direction: ca.SX) -> ca.SX:
        """At standstill: by how much the push in one direction exceeds the static level."""
        return push_direction * free(x, u, p) - static(x, u, p)

    def advance(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
        v, push_direction = x[j], ca.sign(free(x, ua, p))
        is_stuck = ca.logic_and(v == 0, compute_excess(x, ua, p, push_direction) <= 0)
        direction = ca.if_else(v == 0, push_direction, ca.sign(v))
        end = step_piece(x, ua, ub, p, h, direction, is_stuck)
        has_crossed = ca.logic_and(ca.logic_not(is_stuck), ca.logic_and(v != 0, direction * end[j] <= 0))
        leaving_direction = ca.sign(free(end, ub, p))
        early_excess, late_excess = (
            compute_excess(x, ua, p, leaving_direction),
            compute_excess(end, ub, p, leaving_direction),
        )
        leaves = ca.logic_and(is_stuck, late_excess > 0)

        stop_share = _crossing_share(v, h * slide(x, ua, p, direction)[j], end[j], direction)
        # The push is taken to grow in a straight line, which leaves an error of order h^2 in the time of leaving.
        leave_share = ca.fmin(ca.fmax(-early_excess / ca.fmax(late_excess - early_excess, TINY), 0), 1)
        share = ca.if_else(has_crossed, stop_share, ca.if_else(leaves, leave_share, 1))
        u_at_event = ua + share * (ub - ua)
        at_rest = step_piece(x, ua, u_at_event, p, share * h, direction, is_stuck)
        at_rest[j] = 0
        push_direction = ca.if_else(leaves, leaving_direction, ca.sign(free(at_rest, u_at_event, p)))
        stays_at_rest = ca.logic_and(has_crossed, compute_excess(at_rest, u_at_event, p, push_direction) <= 0)
        rest_of_step = step_piece(at_rest, u_at_event, ub, p, (1 - share) * h, push_direction, stays_at_rest)
        # A second crossing within one step is a stop.
        rest_of_step[j] = push_direction * ca.fmax(push_direction * rest_of_step[j], 0)
        return ca.if_else(ca.logic_or(has_crossed, leaves), rest_of_step, end)

    return advance


def _make_rate_functions(system: System, j: int) -> tuple[ca.Function, ca.Function, ca.Function, ca.Function]:
    """Rates while sliding and while held, and at standstill the acceleration without friction and the most that holds it."""
    arguments = [system.x, system.u, system.p]
    direction = ca.SX.sym("direction")

    def rhs_with_direction(value: ca.SX) -> ca.SX:
        return ca.substitute(system.rhs, system.direction, ca.repmat(value, len(system.dry), 1))

    held = rhs_with_direction(ca.SX(0))
    free_acceleration = held[j]
    held[j] = 0
    static_limit = ca.substitute(sum((d.static for d in system.dry), ca.SX(0)) / system.storages[j], system.x[j], 0)
    return (
        ca.Function("slide", [*arguments, direction], [rhs_with_direction(direction)]),
        ca.Function("hold", arguments, [held]),
        ca.Function("free", arguments, [free_acceleration]),
        ca.Function("static", arguments, [static_limit]),
    )


def _crossing_share(v: ca.SX, first: ca.SX, last: ca.SX, direction: ca.SX) -> ca.SX:
    """Share of the step after which the velocity is zero: root of the parabola through ``v``, its slope ``first`` and ``last``."""
    c0, c1 = ca.fabs(v), direction * first
    c2 = direction * last - c0 - c1
    root = ca.sqrt(ca.fmax(c1 * c1 - 4 * c2 * c0, TINY))
    return ca.fmin(ca.fmax(2 * c0 / ca.fmax(root - c1, TINY), 0), 1)
