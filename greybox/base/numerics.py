"""Numerical tolerances: where computation in double precision has to call something zero, equal or singular.

These are properties of the arithmetic, not decisions about models or data; decisions stand in the policies beside the code they steer.
"""

from __future__ import annotations

# Typical size, at least, of a state or input that is zero where it starts, in its unit.
SMALLEST_TYPICAL_SIZE = 1e-3

# A balance is met where its residual is below this share of its terms.
BALANCE_MET = 1e-9

# A balance is met as well where its residual is below this share of its change over typical moves of the variables.
BALANCE_MET_OF_MOVE = 1e-12

# No rate depends on a position whose share of every row of the scaled Jacobian is below this.
FREE_POSITION = 1e-9

# A change of a variable below this share of its typical size is a rounding error.
NEGLIGIBLE_MOVE = 1e-13

# A derivative whose contribution over a typical move is below this share of its row is what is left of terms that cancel.
CANCELLED_DERIVATIVE = 1e-15

# Relative difference below which the derivatives on both sides of a kink are equal.
SAME_DERIVATIVE = 1e-9

# A part of the reachable space below this share of the model's size is a rounding error.
REACHABILITY_RANK = 1e-10

# Of two states that tell a model equally well the later one is kept only if it tells it better by this share: rounding must not choose.
EARLIER_STATE = 1e-6

# A pole is at rest (0, or 1 in the z-plane) where its distance is below this share of the fastest one: such a mode integrates, has no time
# constant and is not unstable.
INTEGRATING_POLE = 1e-9

# The imaginary part of an eigenvalue below this share of its size is zero.
REAL_PART_ONLY = 1e-13

# Most sweeps of the balancing of a matrix; it settles within a few.
BALANCING_SWEEPS = 50

# Largest power of two in the scaling of a state.
LARGEST_SCALING_EXPONENT = 200

# Relative difference below which two sampling times are one: recorded time stamps are rounded.
SAME_SAMPLING_TIME = 2e-3

# Time stamps are written with rounding: interval lengths that differ by less than this share of themselves are one length, a row or a delay
# may miss a whole number of intervals by this share of one, and a band may pass half the sampling frequency by it.
TIME_ROUNDING = 1e-9

# Smallest singular value of columns of unit length, over the square root of their number of rows, below which they are dependent.
COLLINEAR_COLUMNS = 1e-13

# Columns whose share in a linear dependence is above this part of the largest are named as dependent.
DEPENDENT_COLUMN_SHARE = 0.05

# Singular values below this share of the largest are rounding errors.
NEGLIGIBLE_SINGULAR_VALUE = 1e-13

# Rows in which a free response has grown beyond this say nothing about the initial state in double precision.
FREE_RESPONSE_GROWTH = 1e8

# A decaying response is over once it is below this share of its beginning.
FADED_RESPONSE = 1e-17

# A root that is mirrored into the unit circle stays this far inside, so that its filter forgets.
REFLECTED_ROOT_MARGIN = 1e-6

# An integrator's pole is held this far inside the unit circle: it must not leak over a long record.
CONFINED_ROOT_MARGIN = 1e-9

# Largest imaginary part of a matrix logarithm, relative to its largest entry, that is rounding.
IMAGINARY_ROUNDING = 1e-6

# A pole of a sampled model whose size is below this is zero, as a delay has it: nothing of it is left after one sample.
VANISHED_POLE = 1e-12

# A pole whose imaginary part is below this is real.
REAL_POLE = 1e-12

# Smallest divisor: keeps a quotient finite where numerator and denominator vanish together, and where the divisor alone does.
TINY = 1e-100

# Share of a velocity's size that an observer's first state is off rest: at rest the slope of a root of it is infinite.
OFF_REST = 1e-3

# Eigenvalues of an information or curvature matrix, its diagonal scaled to one, below this share of the largest are rounding: a product of
# sensitivities whose entries are sums over long records, exact to some 1e-14.
RANK_CUTOFF = 1e-12

# Eigenvalues above this share of the largest are information; between the two lies doubt. What decides only whether a part of the data,
# or an eliminated first state, is seen at all takes this line.
CERTAIN_INFORMATION = 1e-10

# Singular values of sensitivities, their columns scaled to length one, below this are rounding: they are not squared, but carry the errors
# of an integration over thousands of steps.
COLUMN_CUTOFF = 1e-11

# Singular values above this are information; between the two lies doubt.
CERTAIN_COLUMN = 1e-8

# Directions that are results of a decomposition themselves, of length one: entries below this are zero, and singular values below this show
# that some of them depend on one another. Also the share of a slope that may stick out of a subspace.
DIRECTION_CUTOFF = 1e-9

# Distance from a bound, over its size or one, at which an interior-point search begins that is started on the bound.
PUSH_OFF_BOUNDS = 1e-8

# A slope against a bound below this share of the largest is rounding: the bound is not released.
WRONG_MULTIPLIER = 1e-12

# Directions of lagged signals with less than this share of the largest variance are copies of one another.
REDUNDANT_VARIANCE = 1e-8

# Second derivative beyond which the next step overflows, although the value itself is still finite.
OVERFLOWING_CURVATURE = 1e100

# Relative difference of two errors that is lost in the rounding of the runs that they are of.
SAME_ERROR = 1e-9

# Largest difference of two unit vectors that rounding explains: they are the same direction.
SAME_DIRECTION = 1e-9

# Largest difference of the unit vectors of two formulas that noisy records determine: nearly parallel ones say the same.
INDEPENDENT_FORMULA = 1e-3

# Agreement of exponents with whole numbers.
EXPONENT_AGREEMENT = 1e-5

# A response this small beside the terms that make it up is zero but for rounding.
CANCELLED_RESPONSE = 1e-9

# A constant whose entry in a direction without information, of length one, is larger has no finite standard deviation.
OPEN_DIRECTION_ENTRY = 1e-3

# Standard deviation of normal values over the median of their sizes.
MAD_TO_STD = 1.482602218505602

# Two stretches of an input may be a period apart where the energy of their difference is below this share of the input's.
PERIOD_CLOSURE = 1e-9

# A comparison, ``|a|``, ``min`` or ``max`` is at its edge where its two sides differ by less than this share of their size.
SWITCH_EDGE = 1e-11

# An edge as a share of the change of the difference over a typical move of the variables: covers an operand that is itself zero.
SWITCH_EDGE_OF_MOVE = 1e-13

# How far from an edge, relative to the variables, a function is evaluated to find out on which side a direction leads.
SWITCH_PROBE = 1e-6

# A state with a physical bound is held this far inside it in the equations, in the unit of the state: ``sqrt(level)`` keeps a slope.
STATE_BOUND_MARGIN = 1e-9

# A predicted decrease below this share of the cost cannot be told from the rounding error of a sum over a long record.
LOST_IN_ROUNDING = 1e-13

# Weight of the equation that makes the weights of a convex combination add up to one, beside gradients of size one.
SUM_TO_ONE_WEIGHT = 1e3

# Below this argument the exponential's remainders ``phi_k`` cancel in their closed form; so many terms of their series then reach full
# precision (``0.5^14 / 14!`` is below 1e-15).
PHI_SERIES_BELOW = 0.5
PHI_SERIES_TERMS = 14

# A value this close to its bound lies on it: a share of itself where its logarithm is searched for, else of the step that changes the
# cost by about itself.
AT_BOUND = 1e-6

# A direction of first states with less than this share of the information of the best known one is taken to be as wide as this says.
UNSEEN_INFORMATION = 1e-8

# A prior without which the data leave less than this share of the information says all that is known: the rest is rounding.
PRIOR_INFORMATION_CUTOFF = 1e-6

# Points and half width, in standard deviations, of a sum that stands for an expectation over the normal distribution.
NORMAL_QUADRATURE_POINTS = 4001
NORMAL_QUADRATURE_WIDTH = 9.0

# A step of a segment's state along directions that no sample shows is held back by this share of the mean curvature.
FREE_STATE_CURVATURE = 1e-10

# ``exp(log(bound))`` is not the bound: a constant within this share of it is set to it.
ROUNDED_BOUND = 1e-9

# A state whose range is below this share of its size never moves.
CONSTANT_STATE = 1e-12

# Relative and absolute tolerance of the independent simulation, absolute for states divided by their size: far below any noise.
REFERENCE_TOLERANCE = 1e-9

# Measured numbers are smaller in any unit. The square of a larger one, over the variance of a noise and summed, can overflow.
LARGEST_VALUE = 1e100

# A measured signal that never exceeds it has no squares to speak of.
SMALLEST_VALUE = 1e-100

# Rows of a record that are looked at together where each step of a computation needs arrays of its own: they stay in the cache, and a long
# record is in memory a few times only.
ROWS_AT_A_TIME = 100_000

# Numbers that one Fourier transform of several columns, or one call of the interpreted kernel, may hold: a limit of memory alone.
NUMBERS_AT_A_TIME = 4_000_000

# Rows of a long record by whose values the lags are sieved that may be its period: most lags are gone after a few of them.
SIEVE_ROWS = 500

# Lags that are few enough to be compared row by row.
FEWEST_SIEVED = 50

# Newton steps to a state whose balance stores nothing: from a start value of the right size the error squares with each.
ALGEBRAIC_NEWTON_STEPS = 10

# Halvings of such a step until its residual falls.
ALGEBRAIC_HALVINGS = 4

# A relation is met where its terms add up to less than this share of the largest of them.
RELATION_MET = 1e-6

# Singular values of data matrices below this share of the largest are rounding: records without noise have dependent rows.
RANK_OF_EXACT_RECORDS = 1e-9

# Degrees of freedom from which Student's distribution is the normal one to all digits that matter.
NEARLY_NORMAL = 1e6

# Halvings of an interval that find a root to the last digit.
BISECTIONS = 100

# Median of the absolute difference of two standard normal numbers.
MEDIAN_OF_RANGE = 0.9539
