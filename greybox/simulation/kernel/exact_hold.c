/* Coefficients of the exact hold, with tangents: the first rows [Phi, G1, G2] of exp([[A h, B h, 0], [0, 0, I], [0, 0, 0]]), by Taylor's
   series for a 2^s-th of the interval and squaring s times (Moler and Van Loan 2003, methods 1 and 3). The ramp block of 2^-j of an
   interval is 2^-j I, so that only the first rows are carried: columns of Phi, of G1 for the inputs and the constant, of G2 for the inputs.
   States are first measured in units in which rows and columns of A h are of like size (balancing, Parlett and Reinsch 1969): every
   squaring that this saves would cost half a digit. */

#define COLUMNS (NX + 2 * NU + 1)
#define GIVEN (NX + NU + 1)
#define TERMS 18 /* 1 / 19! is below rounding where the norm is below one */
#define SWEEPS 6

/* z = share * a y; a (NX, NX), y and z (NX, COLUMNS), column by column. */
static void product(CONTEXT double share, const double *a, const v *da, const double *y, const v *dy, double *z, v *dz)
{
    for (int j = 0; j < COLUMNS; j++)
        for (int i = 0; i < NX; i++) {
            double total = 0;
            v slope[NB];
            for (int b = 0; b < NB; b++)
                slope[b] = zero;
            for (int k = 0; k < NX; k++) {
                total = FMA(a[k * NX + i], y[j * NX + k], total);
                for (int b = 0; b < NB; b++) {
                    slope[b] = FMA_LANES(a[k * NX + i], dy[(j * NX + k) * NB + b], slope[b]);
                    slope[b] = FMA_LANES(y[j * NX + k], da[(k * NX + i) * NB + b], slope[b]);
                }
            }
            z[j * NX + i] = share * total;
            for (int b = 0; b < NB; b++)
                dz[(j * NX + i) * NB + b] = share * slope[b];
        }
}

/* Columns of y from number `to` on += share * columns of z from number `from` on. */
INLINE void add(CONTEXT double share, int columns, const double *z, const v *dz, int from, double *y, v *dy, int to)
{
    for (int i = 0; i < columns * NX; i++) {
        y[to * NX + i] = FMA(share, z[from * NX + i], y[to * NX + i]);
        for (int b = 0; b < NB; b++)
            dy[(to * NX + i) * NB + b] = FMA_LANES(share, dz[(from * NX + i) * NB + b], dy[(to * NX + i) * NB + b]);
    }
}

/* Units of the states, powers of two, in which rows and columns of a h are alike, or small. */
static void balance(CONTEXT const double *a, double h, double *unit)
{
    for (int i = 0; i < NX; i++)
        unit[i] = 1;
    for (int n = 0; n < SWEEPS * NX; n++) {
        const int i = n % NX;
        double row = 1, column = 1;
        int exponent;
        for (int j = 0; j < NX; j++)
            if (j != i) {
                row += fabs(a[j * NX + i] * h) * unit[j] / unit[i];
                column += fabs(a[i * NX + j] * h) * unit[i] / unit[j];
            }
        frexp(sqrt(row / column), &exponent);
        if (row < INFINITY && column < INFINITY)
            unit[i] = ldexp(unit[i], exponent - 1);
    }
}

/* Rows of q (lengths, NQ) and dq (lengths, NQ, W * NB) for each of the lengths. */
EXPORT void hold(CONTEXT long lengths, const double *h, const double *p, const vu *dp, double *q, double *dq)
{
    ROUTINE(generator, once);
    double ab[NX * GIVEN], unit[NX], a[NX * NX], term[NX * COLUMNS], next[NX * COLUMNS], sum[NX * COLUMNS];
    v dab[NX * GIVEN * NB], da[NX * NX * NB], dterm[NX * COLUMNS * NB], dnext[NX * COLUMNS * NB], dsum[NX * COLUMNS * NB];

    prepare_generator(&once, p, dp);
    generator(&once, p, dp, ab, dab);
    for (long l = 0; l < lengths; l++) {
        double norm = 0;
        int squarings = 0;
        balance(PASS ab, h[l], unit);
        for (int j = 0; j < NX; j++) {
            double column = 0;
            for (int i = 0; i < NX; i++)
                column += fabs(ab[j * NX + i] * h[l]) * unit[j] / unit[i];
            norm = norm > column ? norm : column;
        }
        frexp(norm, &squarings);
        squarings = squarings < 0 || !(norm < INFINITY) ? 0 : squarings;
        double ramp = ldexp(1.0, -squarings);

        memset(term, 0, sizeof term), memset(dterm, 0, sizeof dterm);
        for (int i = 0; i < NX * GIVEN; i++) {
            const double share = h[l] * ramp * (i < NX * NX ? unit[i / NX] : 1) / unit[i % NX];
            term[i] = share * ab[i];
            for (int b = 0; b < NB; b++)
                dterm[i * NB + b] = share * dab[i * NB + b];
        }
        memcpy(a, term, sizeof a), memcpy(da, dterm, sizeof da);
        memcpy(sum, term, sizeof sum), memcpy(dsum, dterm, sizeof dsum);
        for (int i = 0; i < NX; i++)
            sum[i * NX + i] += 1;
        for (int k = 2; k <= TERMS; k++) {
            product(PASS 1.0 / k, a, da, term, dterm, next, dnext);
            if (k == 2)
                add(PASS ramp / 2, NU, term, dterm, NX, next, dnext, GIVEN);
            memcpy(term, next, sizeof next), memcpy(dterm, dnext, sizeof dnext);
            add(PASS 1, COLUMNS, term, dterm, 0, sum, dsum, 0);
        }
        for (int s = 0; s < squarings; s++, ramp *= 2) {
            product(PASS 1, sum, dsum, sum, dsum, next, dnext);
            add(PASS 1, COLUMNS - NX, sum, dsum, NX, next, dnext, NX);
            add(PASS ramp, NU, sum, dsum, NX, next, dnext, GIVEN);
            memcpy(sum, next, sizeof next), memcpy(dsum, dnext, sizeof dnext);
        }
        for (int i = 0; i < NQ; i++) {
            const double share = unit[i % NX] / (i < NX * NX ? unit[i / NX] : 1);
            q[l * NQ + i] = share * sum[i];
            for (int b = 0; b < NB; b++)
                dsum[i * NB + b] *= share;
        }
        memcpy(dq + l * NQ * W * NB, dsum, sizeof dsum);
    }
}
