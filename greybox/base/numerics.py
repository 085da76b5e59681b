"""Numerical tolerances: where computation in double precision has to call something zero, equal or singular.

These are properties of the arithmetic, not decisions about models or data; decisions stand in the policies beside the code they steer.
"""

from __future__ import annotations

SMALLEST_TYPICAL_SIZE = 1e-3
"""Typical size, at least, of a state or input that is zero where it starts, in its unit."""

BALANCE_MET = 1e-9
"""A balance is met where its residual is below this share of its terms."""

BALANCE_MET_OF_MOVE = 1e-12
"""The same, as a share of the change of the balance over typical moves of the variables."""

FREE_POSITION = 1e-9
"""No rate depends on a position whose share of every row of the scaled Jacobian is below this."""

NEGLIGIBLE_MOVE = 1e-13
"""A change of a variable below this share of its typical size is a rounding error."""

CANCELLED_DERIVATIVE = 1e-15
"""A derivative whose contribution over a typical move is below this share of its row is what is left of terms that cancel."""

SAME_DERIVATIVE = 1e-9
"""Relative difference below which the derivatives on both sides of a kink are equal."""

REACHABILITY_RANK = 1e-10
"""A part of the reachable space below this share of the model's size is a rounding error."""

EARLIER_STATE = 1e-6
"""Of two states that tell a model equally well the later one is kept only if it tells it better by this share: rounding must not choose."""

INTEGRATING_POLE = 1e-9
"""A pole is at rest (0, or 1 in the z-plane) where its distance is below this share of the fastest one: such a mode integrates, has no
time constant and is not unstable."""

REAL_PART_ONLY = 1e-13
"""The imaginary part of an eigenvalue below this share of its size is zero."""

BALANCING_SWEEPS = 50
"""Most sweeps of the balancing of a matrix; it settles within a few."""

LARGEST_SCALING_EXPONENT = 200
"""Largest power of two in the scaling of a state."""

SAME_SAMPLING_TIME = 2e-3
"""Relative difference below which two sampling times are one: recorded time stamps are rounded."""

TIME_ROUNDING = 1e-9
"""Time stamps are written with rounding: interval lengths that differ by less than this share of themselves are one length, a row or a
delay may miss a whole number of intervals by this share of one, and a band may pass half the sampling frequency by it."""

COLLINEAR_COLUMNS = 1e-13
"""Smallest singular value of columns of unit length, over the square root of their number of rows, below which they are dependent."""

DEPENDENT_COLUMN_SHARE = 0.05
"""Columns whose share in a linear dependence is above this part of the largest are named as dependent."""

NEGLIGIBLE_SINGULAR_VALUE = 1e-13
"""Singular values below this share of the largest are rounding errors."""

FREE_RESPONSE_GROWTH = 1e8
"""Rows in which a free response has grown beyond this say nothing about the initial state in double precision."""

FADED_RESPONSE = 1e-17
"""A decaying response is over once it is below this share of its beginning."""

REFLECTED_ROOT_MARGIN = 1e-6
"""A root that is mirrored into the unit circle stays this far inside, so that its filter forgets."""

CONFINED_ROOT_MARGIN = 1e-9
"""An integrator's pole is held this far inside the unit circle: it must not leak over a long record."""

NEGLIGIBLE_JUMP = 1e-9
"""A step response whose first value is below this share of its final value does not jump."""

IMAGINARY_ROUNDING = 1e-6
"""Largest imaginary part of a matrix logarithm, relative to its largest entry, that is rounding."""

VANISHED_POLE = 1e-12
"""A pole of a sampled model whose size is below this is zero, as a delay has it: nothing of it is left after one sample."""

REAL_POLE = 1e-12
"""A pole whose imaginary part is below this is real."""

TINY = 1e-300
"""Smallest divisor: keeps a quotient finite where numerator and denominator vanish together."""

OFF_REST = 1e-3
"""Share of a velocity's size that an observer's first state is off rest: at rest the slope of a root of it is infinite."""

RANK_CUTOFF = 1e-12
"""Eigenvalues of an information or curvature matrix, its diagonal scaled to one, below this share of the largest are rounding: a product
of sensitivities whose entries are sums over long records, exact to some 1e-14."""

CERTAIN_INFORMATION = 1e-10
"""The same: above this they are information; between the two lies doubt. What decides only whether a part of the data, or an eliminated
first state, is seen at all takes this line."""

COLUMN_CUTOFF = 1e-11
"""Singular values of sensitivities, their columns scaled to length one, below this are rounding: they are not squared, but carry the
errors of an integration over thousands of steps."""

CERTAIN_COLUMN = 1e-8
"""The same: above this they are information; between the two lies doubt."""

DIRECTION_CUTOFF = 1e-9
"""Directions that are results of a decomposition themselves, of length one: entries below this are zero, and singular values below this
show that some of them depend on one another. Also the share of a slope that may stick out of a subspace."""

PUSH_OFF_BOUNDS = 1e-8
"""Distance from a bound, over its size or one, at which an interior-point search begins that is started on the bound."""

WRONG_MULTIPLIER = 1e-12
"""A slope against a bound below this share of the largest is rounding: the bound is not released."""

REDUNDANT_VARIANCE = 1e-8
"""Directions of lagged signals with less than this share of the largest variance are copies of one another."""

OVERFLOWING_CURVATURE = 1e100
"""Second derivative beyond which the next step overflows, although the value itself is still finite."""

SAME_ERROR = 1e-9
"""Relative difference of two errors that is lost in the rounding of the runs that they are of."""

SAME_DIRECTION = 1e-9
"""Largest difference of two unit vectors that rounding explains: they are the same direction."""

INDEPENDENT_FORMULA = 1e-3
"""The same for formulas that noisy records determine: nearly parallel ones say the same."""

EXPONENT_AGREEMENT = 1e-5
"""Agreement of exponents with whole numbers."""

CANCELLED_RESPONSE = 1e-9
"""A response this small beside the terms that make it up is zero but for rounding."""

OPEN_DIRECTION_ENTRY = 1e-3
"""A constant whose entry in a direction without information, of length one, is larger has no finite standard deviation."""

MAD_TO_STD = 1.482602218505602
"""Standard deviation of normal values over the median of their sizes."""

PERIOD_CLOSURE = 1e-9
"""Two stretches of an input may be a period apart where the energy of their difference is below this share of the input's."""

SWITCH_EDGE = 1e-11
"""A comparison, ``|a|``, ``min`` or ``max`` is at its edge where its two sides differ by less than this share of their size."""

SWITCH_EDGE_OF_MOVE = 1e-13
"""The same, as a share of the change of the difference over a typical move of the variables: covers an operand that is itself zero."""

SWITCH_PROBE = 1e-6
"""How far from an edge, relative to the variables, a function is evaluated to find out on which side a direction leads."""

STATE_BOUND_MARGIN = 1e-9
"""A state with a physical bound is held this far inside it in the equations, in the unit of the state: ``sqrt(level)`` keeps a slope."""

LOST_IN_ROUNDING = 1e-13
"""A predicted decrease below this share of the cost cannot be told from the rounding error of a sum over a long record."""

SUM_TO_ONE_WEIGHT = 1e3
"""Weight of the equation that makes the weights of a convex combination add up to one, beside gradients of size one."""

PHI_SERIES_BELOW = 0.5
PHI_SERIES_TERMS = 14
"""Below this argument the exponential's remainders ``phi_k`` cancel in their closed form; so many terms of their series then reach
full precision (``0.5^14 / 14!`` is below 1e-15)."""

AT_BOUND = 1e-6
"""A value this close to its bound, as a share of its range or scale, lies on it."""

UNSEEN_INFORMATION = 1e-8
"""A direction of first states with less than this share of the information of the best known one is taken to be as wide as this says."""

PRIOR_INFORMATION_CUTOFF = 1e-6
"""A prior without which the data leave less than this share of the information says all that is known: the rest is rounding."""

NORMAL_QUADRATURE_POINTS = 4001
NORMAL_QUADRATURE_WIDTH = 9.0
"""Points and half width, in standard deviations, of a sum that stands for an expectation over the normal distribution."""

FREE_STATE_CURVATURE = 1e-10
"""A step of a segment's state along directions that no sample shows is held back by this share of the mean curvature."""

ROUNDED_BOUND = 1e-9
"""``exp(log(bound))`` is not the bound: a constant within this share of it is set to it."""

CONSTANT_STATE = 1e-12
"""A state whose range is below this share of its size never moves."""

REFERENCE_TOLERANCE = 1e-9
"""Relative and absolute tolerance of the independent simulation, absolute for states divided by their size: far below any noise."""

LARGEST_VALUE = 1e100
"""Measured numbers are smaller in any unit. The square of a larger one, over the variance of a noise and summed, can overflow."""

SMALLEST_VALUE = 1e-100
"""A measured signal that never exceeds it has no squares to speak of."""

ROWS_AT_A_TIME = 100_000
"""Rows of a record that are looked at together where each step of a computation needs arrays of its own: they stay in the cache, and a
long record is in memory a few times only."""

NUMBERS_AT_A_TIME = 4_000_000
"""Numbers that one Fourier transform of several columns, or one call of the interpreted kernel, may hold: a limit of memory alone."""

SIEVE_ROWS = 500
"""Rows of a long record by whose values the lags are sieved that may be its period: most lags are gone after a few of them."""

FEWEST_SIEVED = 50
"""Lags that are few enough to be compared row by row."""

ALGEBRAIC_NEWTON_STEPS = 10
"""Newton steps to a state whose balance stores nothing: from a start value of the right size the error squares with each."""

ALGEBRAIC_HALVINGS = 4
"""Halvings of such a step until its residual falls."""

RELATION_MET = 1e-6
"""A relation is met where its terms add up to less than this share of the largest of them."""

RANK_OF_EXACT_RECORDS = 1e-9
"""Singular values of data matrices below this share of the largest are rounding: records without noise have dependent rows."""

NEARLY_NORMAL = 1e6
"""Degrees of freedom from which Student's distribution is the normal one to all digits that matter."""

BISECTIONS = 100
"""Halvings of an interval that find a root to the last digit."""

MEDIAN_OF_RANGE = 0.9539
"""Median of the absolute difference of two standard normal numbers."""
