/* One sampling interval with the input held: SUBSTEPS steps of the model, each with everything in it (friction that sticks, play,
   relaxing states). The PAST latest values of input number LATE, one for each interval, are kept beside the state. */

static void fill(double *row, const double *u, const double *past, double share, double length)
{
    for (int i = 0; i < NU; i++)
        row[i] = u[i];
    for (int i = 0; i < PAST; i++)
        row[NU + i] = past[i] == UNKNOWN ? u[LATE] : past[i];
    if (PAST) { /* how much of the interval has gone by, no ramp, how long it is */
        row[COLUMNS - 3] = share;
        row[COLUMNS - 2] = 0;
        row[COLUMNS - 1] = length;
    }
}

static void interval(double *x, double *past, const double *u, const double *q, double length)
{
    struct advance_once once;
    double begin[COLUMNS], end[COLUMNS], next[NX + 1];
    const double h = length / SUBSTEPS;

    for (int i = 0; i < PAST; i++)
        if (past[i] == UNKNOWN) /* before the first step the input was what it is in it */
            past[i] = u[LATE];
    fill(begin, u, past, 0, length);
    prepare_advance(&once, x, begin, begin, q, &h);
    for (int j = 0; j < SUBSTEPS; j++) {
        fill(begin, u, past, (double)j / SUBSTEPS, length);
        fill(end, u, past, (double)(j + 1) / SUBSTEPS, length);
        advance(&once, x, begin, end, q, &h, next);
        for (int i = 0; i < NX; i++)
            x[i] = next[i];
    }
    for (int i = PAST - 1; i > 0; i--)
        past[i] = past[i - 1];
    if (PAST)
        past[0] = u[LATE];
}

static void read_sensors(const double *x, const double *past, const double *u, const double *p, double length, double *y)
{
    struct sensors_once once;
    double row[COLUMNS];

    fill(row, u, past, 0, length);
    prepare_sensors(&once, x, row, p);
    sensors(&once, x, row, p, y);
}
