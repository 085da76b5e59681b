/* Simulation without sensitivities. `is_linear` (NU) is 1 for an input that is linear between rows, 0 for a held one. Rows of y (n, NY) and x (n, NX) are written where the pointers are not NULL. */

EXPORT void simulate(CONTEXT long n, int substeps, int is_even, const double *is_linear, const double *u, const double *h, const int *row,
                     const double *q, const double *p, const double *x0, double *y_out, double *x_out)
{
    double x[NX], next[NX], y[NY], ua[AT_LEAST_ONE(NU)], ub[AT_LEAST_ONE(NU)];
    double length = NAN;
    long last = -1;
    ROUTINE(advance, once);
    ROUTINE(outputs, once_outputs);

    memcpy(x, x0, sizeof x);
    prepare_outputs(&once_outputs, x, u, p);
    for (long k = 0; k < n; k++) {
        const double *u0 = u + k * NU, *u1 = u0 + NU;
        if (y_out) {
            outputs(&once_outputs, x, u0, p, y);
            memcpy(y_out + k * NY, y, sizeof y);
        }
        if (x_out)
            memcpy(x_out + k * NX, x, sizeof x);
        if (k + 1 == n)
            break;
        const long r = row ? row[k] : 0;
        const double step = h[is_even ? 0 : k] / substeps;
        const double *qr = q + r * NQ;
        if (r != last || step != length) {
            last = r, length = step;
            prepare_advance(&once, x, u0, u0, qr, &length);
        }
        for (int j = 0; j < substeps; j++) {
            for (int i = 0; i < NU; i++) {
                const double ramp = is_linear[i] * (u1[i] - u0[i]);
                ua[i] = u0[i] + ramp * j / substeps;
                ub[i] = u0[i] + ramp * (j + 1) / substeps;
            }
            advance(&once, x, ua, ub, qr, &length, next);
            memcpy(x, next, sizeof x);
        }
    }
}
