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

TINY = 1e-300


def split_at_standstill(system: System, one_step: IntegrationMethod) -> AdvanceFunction:
    """``advance(x, ua, ub, p, h)`` for a system with dry friction, from the smooth one-step method ``one_step(rate)``."""
    bodies = {d.state for d in system.dry}
    if len(bodies) > 1:
        names = ", ".join(d.effect for d in system.dry)
        raise ModelError(f"dry friction on two velocities at once ({names}) cannot be stepped yet; keep it on one")
    j = bodies.pop()
    slide, hold, free, static = _rates(system, j)

    def part(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX, direction: ca.SX, stuck: ca.SX) -> ca.SX:
        """One smooth piece: sliding in a given direction, or standing still."""

        def rate(x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
            return ca.if_else(stuck, hold(x, u, p), slide(x, u, p, direction))

        return one_step(rate)(x, ua, ub, p, h)

    def beyond(x: ca.SX, u: ca.SX, p: ca.SX, way: ca.SX) -> ca.SX:
        """At standstill: by how much the push one way exceeds what holds."""
        return way * free(x, u, p) - static(x, u, p)

    def advance(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
        v, way = x[j], ca.sign(free(x, ua, p))
        stuck = ca.logic_and(v == 0, beyond(x, ua, p, way) <= 0)
        direction = ca.if_else(v == 0, way, ca.sign(v))
        whole = part(x, ua, ub, p, h, direction, stuck)
        crossed = ca.logic_and(ca.logic_not(stuck), ca.logic_and(v != 0, direction * whole[j] <= 0))
        late = ca.sign(free(whole, ub, p))
        early, excess = beyond(x, ua, p, late), beyond(whole, ub, p, late)
        broken = ca.logic_and(stuck, excess > 0)

        stop = _crossing(v, h * slide(x, ua, p, direction)[j], whole[j], direction)
        # The push grows past what holds as a straight line, near enough: an error of h^2 in the time of leaving.
        leave = ca.fmin(ca.fmax(-early / ca.fmax(excess - early, TINY), 0), 1)
        share = ca.if_else(crossed, stop, ca.if_else(broken, leave, 1))
        meeting = ua + share * (ub - ua)
        at_rest = part(x, ua, meeting, p, share * h, direction, stuck)
        at_rest[j] = 0
        way = ca.if_else(broken, late, ca.sign(free(at_rest, meeting, p)))
        stays = ca.logic_and(crossed, beyond(at_rest, meeting, p, way) <= 0)
        after = part(at_rest, meeting, ub, p, (1 - share) * h, way, stays)
        after[j] = way * ca.fmax(way * after[j], 0)  # a second crossing within one step is a stop
        return ca.if_else(ca.logic_or(crossed, broken), after, whole)

    return advance


def _rates(system: System, j: int) -> tuple[ca.Function, ca.Function, ca.Function, ca.Function]:
    """Rates while sliding and while held, and at standstill the acceleration without friction and the most that holds it."""
    arguments = [system.x, system.u, system.p]
    one = ca.SX.sym("direction")

    def directed(value: ca.SX) -> ca.SX:
        return ca.substitute(system.rhs, system.direction, ca.repmat(value, len(system.dry), 1))

    held = directed(ca.SX(0))
    push = held[j]
    held[j] = 0
    static = ca.substitute(sum((d.static for d in system.dry), ca.SX(0)) / system.storages[j], system.x[j], 0)
    return (
        ca.Function("slide", [*arguments, one], [directed(one)]),
        ca.Function("hold", arguments, [held]),
        ca.Function("free", arguments, [push]),
        ca.Function("static", arguments, [static]),
    )


def _crossing(v: ca.SX, first: ca.SX, last: ca.SX, direction: ca.SX) -> ca.SX:
    """Share of the step after which the velocity is zero: root of the parabola through ``v``, its slope ``first`` and ``last``."""
    c0, c1 = ca.fabs(v), direction * first
    c2 = direction * last - c0 - c1
    root = ca.sqrt(ca.fmax(c1 * c1 - 4 * c2 * c0, TINY))
    return ca.fmin(ca.fmax(2 * c0 / ca.fmax(root - c1, TINY), 0), 1)
