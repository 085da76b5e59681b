"""Numerical tolerances: where computation in double precision has to call something zero, equal or singular.

These are properties of the arithmetic, not decisions about models or data; decisions stand in the policies beside the code they steer.
"""

from __future__ import annotations

TINY = 1e-300
"""Smallest divisor: keeps a quotient finite where numerator and denominator vanish together."""
