/* The instructions of the machine on lanes of one width: a function RUN on registers of LANE (LANE_U where they are only aligned as doubles
   are), with FUSE(a, b, c) for a * b + c. Operands are fetched before a loop over blocks begins: a store in it might change what lies in
   memory, for all that the compiler knows. */

#define A r[pc[2]]
#define B r[pc[3]]
#define C r[pc[4]]
#define E r[pc[6]]
#define AT(operand) (t + (long)pc[operand] * nb)
#define BLOCKS for (int b = 0; b < nb; b++)

INLINE void RUN(const int *pc, double *r, LANE *t, const double *const *in, const LANE_U *const *din, double *z, LANE_U *dz, const int nb)
{
    for (;;)
        switch (*pc) {
            VALUE_CASES
        case LOAD:
            r[pc[1]] = in[pc[2]][pc[3]], pc += 4;
            break;
        case LOAD_TANGENT: {
            LANE *to = AT(1);
            const LANE_U *from = din[pc[2]] + (long)pc[3] * nb;
            BLOCKS to[b] = from[b];
            pc += 4;
            break;
        }
        case STORE:
            z[pc[1]] = r[pc[2]], pc += 3;
            break;
        case STORE_TANGENT: {
            LANE_U *to = dz + (long)pc[1] * nb;
            const LANE *from = AT(2);
            BLOCKS to[b] = from[b];
            pc += 3;
            break;
        }
        case PICK: { /* one or the other, without arithmetic on the one not chosen: it may be infinite */
            LANE *to = AT(1);
            const LANE *from = A != 0 ? AT(3) : AT(4);
            BLOCKS to[b] = from[b];
            pc += 5;
            break;
        }
        case SUM_1: {
            LANE *to = AT(1);
            const LANE *x = AT(3);
            const double a = A;
            BLOCKS to[b] = a * x[b];
            pc += 4;
            break;
        }
        case SUM_2: {
            LANE *to = AT(1);
            const LANE *x = AT(3), *y = AT(5);
            const double a = A, c = C;
            BLOCKS to[b] = FUSE(c, y[b], a * x[b]);
            pc += 6;
            break;
        }
        case SUM_3: {
            LANE *to = AT(1);
            const LANE *x = AT(3), *y = AT(5), *w = AT(7);
            const double a = A, c = C, e = E;
            BLOCKS to[b] = FUSE(e, w[b], FUSE(c, y[b], a * x[b]));
            pc += 8;
            break;
        }
        case SUM_MORE: {
            LANE *to = AT(1);
            const int *first = pc + 3, *end = first + 2 * pc[2];
            int b = 0;
            /* Four blocks side by side: a term is looked up once for all of them, and none waits for the one before. */
            for (; b + 4 <= nb; b += 4) {
                const LANE *x = t + (long)first[1] * nb + b;
                double a = r[first[0]];
                LANE s0 = a * x[0], s1 = a * x[1], s2 = a * x[2], s3 = a * x[3];
                for (const int *term = first + 2; term < end; term += 2) {
                    x = t + (long)term[1] * nb + b, a = r[term[0]];
                    s0 = FUSE(a, x[0], s0), s1 = FUSE(a, x[1], s1), s2 = FUSE(a, x[2], s2), s3 = FUSE(a, x[3], s3);
                }
                to[b] = s0, to[b + 1] = s1, to[b + 2] = s2, to[b + 3] = s3;
            }
            for (; b < nb; b++) {
                LANE sum = r[first[0]] * t[(long)first[1] * nb + b];
                for (const int *term = first + 2; term < end; term += 2)
                    sum = FUSE(r[term[0]], t[(long)term[1] * nb + b], sum);
                to[b] = sum;
            }
            pc = end;
            break;
        }
        default:
            return;
        }
}

#undef A
#undef B
#undef C
#undef E
#undef AT
#undef BLOCKS
#undef RUN
#undef LANE
#undef LANE_U
#undef FUSE
