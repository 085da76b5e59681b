/* A pass over a record by ESDIRK steps whose length follows the error: states, and their tangents along W * NB lanes, at every row.
   The steps are those of the run without tangents; the tangents are the derivatives of just these steps, lengths held.
   TABLE[i * STAGES + j] are the coefficients of stage i, the last of which is the end of the step; GAMMA is their diagonal, LESS the weights of what
   the embedded method differs by. */

/* What depends on the constants alone is computed once. */
struct context {
    struct rates_once rates;
    struct jacobian_once jacobian;
#ifdef NB
    struct slopes_once slopes;
    const vu *dp;
#endif
    const double *p;
};

static void rates_of(const struct context *c, const double *x, const double *u, double *f)
{
    rates(&c->rates, x, u, c->p, f);
}

/* The entries of df/dx. */
static void jacobian_of(const struct context *c, const double *x, const double *u, double *entries)
{
    jacobian(&c->jacobian, x, u, c->p, entries);
}

static double larger(double a, double b)
{
    return a > b ? a : b;
}

/* I - scale J = L U: L below, U right of the diagonal, which is inverted. */
struct matrix {
    double m[NX][NX];
    int pivot[NX], is_ordered;
};

#ifdef ORDERED
/* By the entries alone, which the order PIVOTS keeps few: column PIVOTS[n] has those in rows BELOW, row PIVOTS[n] those in columns RIGHT.
   Whether no diagonal is small beside what it divides, each row measured by its largest entry. */
static int factorise_in_order(double scale, const double *entries, double (*m)[NX])
{
    double size[NX];
    for (int n = 0; n < NX; n++) {
        const int k = PIVOTS[n];
        m[k][k] = 1;
        for (int i = BELOW_START[n]; i < BELOW_START[n + 1]; i++)
            m[BELOW[i]][k] = 0;
        for (int l = RIGHT_START[n]; l < RIGHT_START[n + 1]; l++)
            m[k][RIGHT[l]] = 0;
    }
    for (int e = 0; e < NJ; e++)
        m[JACOBIAN_ROW[e]][JACOBIAN_COLUMN[e]] -= scale * entries[e];
    for (int i = 0; i < NX; i++)
        size[i] = fabs(m[i][i]);
    for (int e = 0; e < NJ; e++)
        size[JACOBIAN_ROW[e]] = larger(size[JACOBIAN_ROW[e]], fabs(m[JACOBIAN_ROW[e]][JACOBIAN_COLUMN[e]]));
    for (int n = 0; n < NX; n++) {
        const int k = PIVOTS[n];
        const double inverse = 1 / m[k][k], most = fabs(m[k][k]) / (SMALLEST_PIVOT * size[k]);
        if (!(most > 0) || !isfinite(inverse))
            return 0;
        m[k][k] = inverse;
        for (int i = BELOW_START[n]; i < BELOW_START[n + 1]; i++) {
            double *row = m[BELOW[i]];
            if (!(fabs(row[k]) <= most * size[BELOW[i]]))
                return 0;
            const double factor = row[k] *= inverse;
            for (int l = RIGHT_START[n]; l < RIGHT_START[n + 1]; l++)
                row[RIGHT[l]] -= factor * m[k][RIGHT[l]];
        }
    }
    return 1;
}
#endif

/* In any order, rows exchanged for the largest pivot. */
VECTORISED static int factorise_by_exchange(double scale, const double *entries, double (*m)[NX], int *pivot)
{
    memset(m, 0, NX * sizeof *m);
    for (int k = 0; k < NX; k++)
        m[k][k] = 1;
    for (int e = 0; e < NJ; e++)
        m[JACOBIAN_ROW[e]][JACOBIAN_COLUMN[e]] -= scale * entries[e];
    for (int k = 0; k < NX; k++) {
        int best = k;
        for (int i = k + 1; i < NX; i++)
            if (fabs(m[i][k]) > fabs(m[best][k]))
                best = i;
        pivot[k] = best;
        if (!(fabs(m[best][k]) > 0) || !isfinite(m[best][k]))
            return 0;
        if (best != k)
            for (int l = 0; l < NX; l++) {
                const double other = m[k][l];
                m[k][l] = m[best][l], m[best][l] = other;
            }
        const double inverse = m[k][k] = 1 / m[k][k];
        for (int i = k + 1; i < NX; i++) {
            if (m[i][k] == 0)
                continue;
            const double factor = m[i][k] *= inverse;
            for (int l = k + 1; l < NX; l++)
                m[i][l] -= factor * m[k][l];
        }
    }
    return 1;
}

/* Whether it can be solved. */
static int factorise(double scale, const double *entries, struct matrix *a)
{
#ifdef ORDERED
    if ((a->is_ordered = factorise_in_order(scale, entries, a->m)))
        return 1;
#endif
    return factorise_by_exchange(scale, entries, a->m, a->pivot);
}

/* b = M^-1 b, once for numbers and once for blocks of tangents. */
#define SOLVE_BY_EXCHANGE(NAME, TYPE, COUNT)                                                                                               \
    VECTORISED static void NAME(const struct matrix *a, TYPE *b)                                                                           \
    {                                                                                                                                      \
        for (int k = 0; k < NX; k++)                                                                                                       \
            for (int c = 0; c < COUNT; c++) {                                                                                              \
                const TYPE other = b[k * COUNT + c];                                                                                       \
                b[k * COUNT + c] = b[a->pivot[k] * COUNT + c], b[a->pivot[k] * COUNT + c] = other;                                         \
            }                                                                                                                              \
        for (int i = 0; i < NX; i++)                                                                                                       \
            for (int k = 0; k < i; k++)                                                                                                    \
                for (int c = 0; c < COUNT; c++)                                                                                            \
                    b[i * COUNT + c] -= a->m[i][k] * b[k * COUNT + c];                                                                     \
        for (int i = NX - 1; i >= 0; i--) {                                                                                                \
            for (int k = i + 1; k < NX; k++)                                                                                               \
                for (int c = 0; c < COUNT; c++)                                                                                            \
                    b[i * COUNT + c] -= a->m[i][k] * b[k * COUNT + c];                                                                     \
            for (int c = 0; c < COUNT; c++)                                                                                                \
                b[i * COUNT + c] *= a->m[i][i];                                                                                            \
        }                                                                                                                                  \
    }
#define SOLVE_IN_ORDER(NAME, TYPE, COUNT)                                                                                                  \
    static void NAME(const struct matrix *a, TYPE *b)                                                                                      \
    {                                                                                                                                      \
        for (int n = 0; n < NX; n++)                                                                                                       \
            for (int i = BELOW_START[n]; i < BELOW_START[n + 1]; i++)                                                                      \
                for (int c = 0; c < COUNT; c++)                                                                                            \
                    b[BELOW[i] * COUNT + c] -= a->m[BELOW[i]][PIVOTS[n]] * b[PIVOTS[n] * COUNT + c];                                         \
        for (int n = NX - 1; n >= 0; n--) {                                                                                                \
            const int k = PIVOTS[n];                                                                                                        \
            for (int l = RIGHT_START[n]; l < RIGHT_START[n + 1]; l++)                                                                      \
                for (int c = 0; c < COUNT; c++)                                                                                            \
                    b[k * COUNT + c] -= a->m[k][RIGHT[l]] * b[RIGHT[l] * COUNT + c];                                                       \
            for (int c = 0; c < COUNT; c++)                                                                                                \
                b[k * COUNT + c] *= a->m[k][k];                                                                                            \
        }                                                                                                                                  \
    }
SOLVE_BY_EXCHANGE(solve_by_exchange, double, 1)
#ifdef ORDERED
SOLVE_IN_ORDER(solve_in_order, double, 1)
#endif

static void solve(const struct matrix *a, double *b)
{
#ifdef ORDERED
    if (a->is_ordered) {
        solve_in_order(a, b);
        return;
    }
#endif
    solve_by_exchange(a, b);
}

/* What the error of a state is measured against: its present size, a small share of its largest, and a smaller one of the largest of the
   states in the same unit. Zero where none of them has moved yet. */
static void set_scales(const double *x, double *size, double *scale)
{
    double mates[NX];
    memset(mates, 0, sizeof mates);
    for (int i = 0; i < NX; i++) {
        size[i] = larger(fabs(x[i]), size[i]);
        mates[UNIT[i]] = larger(size[i], mates[UNIT[i]]);
    }
    for (int i = 0; i < NX; i++)
        scale[i] = fabs(x[i]) + FLOOR * larger(size[i], MATES * mates[UNIT[i]]);
}

/* Root mean square of the errors over what a step may make. A state that has no scale yet has that of its present rate over the step. */
static double measure(const double *error, const double *scale, const double *rate, double step, double tolerance)
{
    double sum = 0;
    for (int i = 0; i < NX; i++) {
        const double size = scale[i] > 0 ? scale[i] : FLOOR * step * fabs(rate[i]);
        if (size > 0) {
            const double part = error[i] / (tolerance * size);
            sum += part * part;
        } else if (!isfinite(error[i]))
            return INFINITY;
    }
    return sqrt(sum / NX);
}

#ifdef NB
SOLVE_BY_EXCHANGE(solve_lanes_by_exchange, v, NB)
#ifdef ORDERED
SOLVE_IN_ORDER(solve_lanes_in_order, v, NB)
#endif

static void rates_along(const struct context *c, const double *x, const v *dx, const double *u, double *f, v *df)
{
    slopes(&c->slopes, x, (const vu *)dx, u, c->p, c->dp, f, df);
}

/* dK of a stage: (I - h GAMMA J) dK = J V + df/dp dp, with J at the stage itself. Its own matrix costs less than iterations by that of the
   step, each of which runs through all lanes. */
static void solve_stage(const struct context *c, const double *x, const v *base, double scale, const double *u, v *dk)
{
    static _Thread_local struct matrix a;
    double f[NX], entries[AT_LEAST_ONE(NJ)];
    rates_along(c, x, base, u, f, dk);
    jacobian_of(c, x, u, entries);
    if (!factorise(scale, entries, &a)) {
        for (int i = 0; i < NX * NB; i++)
            dk[i] = zero + NAN;
        return;
    }
#ifdef ORDERED
    if (a.is_ordered) {
        solve_lanes_in_order(&a, dk);
        return;
    }
#endif
    solve_lanes_by_exchange(&a, dk);
}
#endif

/* n rows; `tolerance` of a step relative to each state; carry (1 + NX): the length of the next step, 0 to choose it, and the largest
   size of each state so far. xs (n, NX), dxs (n, NX, W * NB). work: steps, steps refused, Jacobians, factorisations. Returns the first
   row that was not reached, else -1. */
EXPORT long integrate(long n, int is_even, double tolerance, const double *is_linear, const double *u, const double *h, const double *p,
                      const double *x0, const double *dp_lanes, const double *dx0_lanes, double *carry, double *xs, double *dxs,
                      long *work)
{
    static _Thread_local struct matrix a;
    double j[AT_LEAST_ONE(NJ)], x[NX], k[STAGES][NX], stage[STAGES][NX], base[NX], trial[NX], error[NX], ui[STAGES][AT_LEAST_ONE(NU)], scale[NX];
    double *const size = carry + 1;
    double next = carry[0], factored = NAN, before = 1;
    int jacobian_is_fresh = 0, has_jacobian = 0;
    long steps_left = MOST_STEPS + STEPS_AN_INTERVAL * n;
#ifdef NB
    v dx[NX * NB], dk[STAGES][NX * NB], moved[NX * NB];
#endif
    struct context c;
    c.p = p;
    memcpy(x, x0, sizeof x);
    prepare_rates(&c.rates, x, u, p);
    prepare_jacobian(&c.jacobian, x, u, p);
#ifdef NB
    c.dp = (const vu *)dp_lanes;
    memcpy(dx, dx0_lanes, sizeof dx);
    prepare_slopes(&c.slopes, x, (const vu *)dx, u, p, c.dp);
#endif
    set_scales(x, size, scale);
    for (long row = 0; row < n; row++) {
        memcpy(xs + row * NX, x, sizeof x);
#ifdef NB
        memcpy(dxs + row * NX * NB * W, dx, sizeof dx);
#endif
        if (row + 1 == n)
            break;
        const double *u0 = u + row * NU, *u1 = u0 + NU, length = h[is_even ? 0 : row];
        double done = 0;
        /* Where the input jumps the rate does, too: the last stage of the step before is not the first of this. */
        rates_of(&c, x, u0, k[0]);
#ifdef NB
        rates_along(&c, x, dx, u0, k[0], dk[0]);
#endif
        double state = 0, rate = 0;
        for (int i = 0; i < NX; i++)
            if (scale[i] > 0)
                state += pow(x[i] / scale[i], 2), rate += pow(k[0][i] / scale[i], 2);
        /* Where all is at zero the steps before tell nothing. */
        if (!(next > 0) || !(state > 0))
            next = state > 0 && rate > 0 ? fmax(FIRST_SHARE * sqrt(state / rate), FIRST_STEP * length) : FIRST_SHARE * length;
        jacobian_is_fresh = 0, has_jacobian = 0;
        while (done < length) {
            const double left = length - done;
            /* The last two steps of an interval are equally long: no tiny one is left over. */
            const double step = next >= left ? left : 2 * next > left ? left / 2 : next;
            if (steps_left-- <= 0 || !(step > SMALLEST_STEP * length))
                return row + 1;
            if (!has_jacobian) {
                jacobian_of(&c, x, u0, j); /* input inside the interval moves the Jacobian little */
                has_jacobian = jacobian_is_fresh = 1, factored = NAN, work[2]++;
            }
            if (GAMMA * step != factored) {
                factored = factorise(GAMMA * step, j, &a) ? GAMMA * step : NAN;
                work[3]++;
            }
            int is_good = factored == GAMMA * step, is_slow = 0;
            for (int s = 0; s < STAGES; s++)
                for (int i = 0; i < NU; i++)
                    ui[s][i] = u0[i] + is_linear[i] * (u1[i] - u0[i]) * (done + NODES[s] * step) / length;
            memcpy(stage[0], x, sizeof x);
            for (int s = 1; s < STAGES && is_good; s++) {
                for (int i = 0; i < NX; i++) {
                    base[i] = x[i];
                    for (int l = 0; l < s; l++)
                        base[i] += step * TABLE[s * STAGES + l] * k[l][i];
                    stage[s][i] = base[i] + GAMMA * step * k[s - 1][i];
                }
                double last = INFINITY;
                int iteration = 0;
                for (is_good = 0; iteration < MOST_ITERATIONS && !is_good; iteration++) {
                    rates_of(&c, stage[s], ui[s], k[s]);
                    for (int i = 0; i < NX; i++)
                        trial[i] = base[i] + GAMMA * step * k[s][i] - stage[s][i];
                    solve(&a, trial);
                    for (int i = 0; i < NX; i++)
                        stage[s][i] += trial[i];
                    const double change = measure(trial, scale, k[0], step, tolerance), ratio = change / last;
                    if (!(change < INFINITY) || ratio > DIVERGING)
                        break;
                    is_slow |= ratio < INFINITY && ratio > SLOW;
                    /* What is left after this change: a geometric series. */
                    is_good = iteration ? change * fmin(ratio / (1 - fmin(ratio, 0.9)), 1) <= NEWTON_SHARE : change <= NEWTON_SHARE * NEWTON_SHARE;
                    last = change;
                }
                /* From the stage itself: f would multiply what the iteration left by the stiffness. */
                for (int i = 0; i < NX; i++)
                    k[s][i] = (stage[s][i] - base[i]) / (GAMMA * step);
            }
            double wrong = INFINITY;
            if (is_good) {
                for (int i = 0; i < NX; i++) {
                    error[i] = 0;
                    for (int s = 0; s < STAGES; s++)
                        error[i] += step * LESS[s] * k[s][i];
                }
                /* A stiff mode, which the method damps, is no error. */
                solve(&a, error);
                wrong = measure(error, scale, k[0], step, tolerance);
            }
            if (!(wrong <= 1)) {
                work[1]++;
                if (!is_good && !jacobian_is_fresh) {
                    has_jacobian = 0; /* the same step with a Jacobian of its own */
                    continue;
                }
                next = step * (wrong < INFINITY ? fmax(0.2, SAFETY * pow(wrong, -1 / ORDER)) : 0.25);
                continue;
            }
            work[0]++;
#ifdef NB
            for (int s = 1; s < STAGES; s++) {
                for (int i = 0; i < NX * NB; i++) {
                    moved[i] = dx[i];
                    for (int l = 0; l < s; l++)
                        moved[i] += step * TABLE[s * STAGES + l] * dk[l][i];
                }
                solve_stage(&c, stage[s], moved, GAMMA * step, ui[s], dk[s]);
            }
            for (int i = 0; i < NX * NB; i++)
                dx[i] = moved[i] + GAMMA * step * dk[STAGES - 1][i];
            memcpy(dk[0], dk[STAGES - 1], sizeof dk[0]);
#endif
            memcpy(x, stage[STAGES - 1], sizeof x);
            memcpy(k[0], k[STAGES - 1], sizeof k[0]);
#ifdef LIMITED
            /* A state that would leave its bounds stops there, and forgets all slopes (a tank that has run empty). */
            int is_stopped = 0;
            for (int i = 0; i < NX; i++)
                if (x[i] < LOW[i] || x[i] > HIGH[i]) {
                    x[i] = x[i] < LOW[i] ? LOW[i] : HIGH[i], is_stopped = 1;
#ifdef NB
                    for (int b = 0; b < NB; b++)
                        dx[i * NB + b] = zero;
#endif
                }
            if (is_stopped) {
                rates_of(&c, x, ui[STAGES - 1], k[0]);
#ifdef NB
                rates_along(&c, x, dx, ui[STAGES - 1], k[0], dk[0]);
#endif
            }
#endif
            set_scales(x, size, scale);
            /* Proportional and integral: errors of neighbouring steps damp one another. */
            const double growth = SAFETY * pow(fmax(wrong, 1e-10), -0.7 / ORDER) * pow(before, 0.4 / ORDER);
            before = fmax(wrong, 1e-4);
            done = step == left ? length : done + step;
            if (step == next || growth < 1)
                next = growth > KEPT_GROWTH || growth < 1 ? step * fmin(fmax(growth, 0.2), 6) : step;
            else if (growth * step > next) /* cut short by the end of the interval */
                next = fmin(growth, 6) * step;
            has_jacobian = !is_slow && !IS_FRESH_EACH_STEP;
            jacobian_is_fresh = 0;
        }
    }
    carry[0] = next;
    return -1;
}
