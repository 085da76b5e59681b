/* One pass over a record with its tangents: residuals r = (measured - y) * weight, their Jacobian J = dr along W * NB lanes, and the
   sums of a Gauss-Newton step. Memory does not grow with n. Returns the first sample whose state or output is not finite, else -1.
   sums: squares and counts (NY each), gradient J'r (W * NB), J'J (W * NB, W * NB), one after the other, or NULL;
   h holds the length of each interval (n - 1), or of all of them (1) where `is_even`.
   residual (n, NY), jacobian (n, NY, kept) are written where something was measured, or NULL: the first `kept` lanes, the others are
   padding.
   is_linear (NU) is 1 for an input that is linear between rows, 0 for a held one. SUBSTEPS is the argument of that name, or a constant
   where the caller knows it, as ALL_HELD is: a linear model's pass then takes a third less time. */

/* gn += e' e of the `seen` rows of e (seen, NB), above the diagonal: two rows of gn by two blocks at a time stay in registers. An entry is
   added up in the order of the rows, as it is one by one. */
static void add_products(CONTEXT int seen, const v *e, v *gn)
{
    for (int j = 0; j < W * NB; j += 2)
        for (int b = j / W; b < NB; b += 2) {
            const int second = b + 1 < NB ? b + 1 : b;
            v a0 = gn[j * NB + b], a1 = gn[(j + 1) * NB + b], c0 = gn[j * NB + second], c1 = gn[(j + 1) * NB + second];
            const double *lane = (const double *)e + j;
            for (const v *row = e; row < e + seen * NB; row += NB, lane += W * NB) {
                const double l0 = lane[0], l1 = lane[1];
                a0 = FMA_LANES(l0, row[b], a0), a1 = FMA_LANES(l1, row[b], a1);
                c0 = FMA_LANES(l0, row[second], c0), c1 = FMA_LANES(l1, row[second], c1);
            }
            gn[j * NB + b] = a0, gn[(j + 1) * NB + b] = a1, gn[j * NB + second] = c0, gn[(j + 1) * NB + second] = c1;
        }
}

/* Entries of the outputs' tangents up to which each output is added by itself. */
#define FEW_ENTRIES 32
#define IS_SMALL (NY * NB < FEW_ENTRIES)

EXPORT long sums(CONTEXT long n, int substeps, int is_even, int kept, const double *is_linear, const double *u, const double *measured, const double *h, const int *row,
                 const double *q, const vu *dq, const double *p, const vu *dp, const double *x0, const vu *dx0,
                 const double *weight, double *sums, double *residual, double *jacobian)
{
    double x[NX], next[NX], y[NY], ua[AT_LEAST_ONE(NU)], ub[AT_LEAST_ONE(NU)], sq[NY], count[NY], lane[W * NB];
    v dx[NX * NB], dnext[NX * NB], dy[NY * NB], all[NY * NB], g[NB], gn[W * NB * NB];
    double length = NAN;
    long last = -1;
    ROUTINE(advance, once);
    ROUTINE(outputs, once_outputs);

    for (int i = 0; i < NY; i++)
        sq[i] = count[i] = 0;
    for (int b = 0; b < NB; b++)
        g[b] = zero;
    for (int i = 0; i < W * NB * NB; i++)
        gn[i] = zero;
    memcpy(x, x0, sizeof x);
    memcpy(dx, dx0, sizeof dx);
    prepare_outputs(&once_outputs, x, (const vu *)dx, u, p, dp);
    for (long k = 0; k < n; k++) {
        const double *u0 = u + k * NU, *u1 = u0 + NU;
        outputs(&once_outputs, x, (const vu *)dx, u0, p, dp, y, dy);
        double poison = 0; /* 0 * infinity and 0 * NaN are NaN */
        for (int i = 0; i < NX; i++)
            poison += 0 * x[i];
        for (int i = 0; i < NY; i++)
            poison += 0 * y[i];
        if (poison != 0)
            return k;
        int seen = 0;
        for (int i = 0; i < NY; i++) {
            const double r = (measured[k * NY + i] - y[i]) * weight[i];
            if (r != r) /* a gap */
                continue;
            v *const e = all + (IS_SMALL ? 0 : seen++ * NB);
            for (int b = 0; b < NB; b++)
                e[b] = -weight[i] * dy[i * NB + b];
            sq[i] = FMA(r, r, sq[i]);
            count[i] += 1;
            if (sums) {
                for (int b = 0; b < NB; b++)
                    g[b] = FMA_LANES(r, e[b], g[b]);
                memcpy(lane, e, sizeof lane);
                for (int j = 0; IS_SMALL && j < W * NB; j++)
                    for (int b = j / W; b < NB; b++)
                        gn[j * NB + b] = FMA_LANES(lane[j], e[b], gn[j * NB + b]);
            }
            if (residual)
                residual[k * NY + i] = r;
            if (jacobian)
                memcpy(jacobian + (k * NY + i) * kept, e, kept * sizeof *jacobian);
        }
        if (sums && !IS_SMALL)
            add_products(PASS seen, all, gn);
        if (k + 1 == n)
            break;
        const long l = row ? row[k] : 0;
        const double step = h[is_even ? 0 : k] / SUBSTEPS;
        const double *ql = q + l * NQ;
        const vu *dql = dq + l * NQ * NB;
        if (l != last || step != length) {
            last = l, length = step;
            prepare_advance(&once, x, (const vu *)dx, u0, u0, ql, dql, &length);
        }
        for (int j = 0; j < SUBSTEPS; j++) {
            for (int i = 0; i < NU; i++) {
                const double ramp = ALL_HELD ? 0 : is_linear[i] * (u1[i] - u0[i]);
                ua[i] = ALL_HELD ? u0[i] : u0[i] + ramp * j / SUBSTEPS;
                ub[i] = ALL_HELD ? u0[i] : u0[i] + ramp * (j + 1) / SUBSTEPS;
            }
            advance(&once, x, (const vu *)dx, ua, ub, ql, dql, &length, next, dnext);
            memcpy(x, next, sizeof x);
            memcpy(dx, dnext, sizeof dx);
        }
    }
    if (sums) {
        double *matrix = sums + 2 * NY + W * NB;
        memcpy(sums, sq, sizeof sq);
        memcpy(sums + NY, count, sizeof count);
        memcpy(sums + 2 * NY, g, sizeof g);
        memcpy(matrix, gn, sizeof gn);
        for (int i = 0; i < W * NB; i++)
            for (int j = 0; j < i; j++)
                matrix[i * W * NB + j] = matrix[j * W * NB + i];
    }
    return -1;
}
