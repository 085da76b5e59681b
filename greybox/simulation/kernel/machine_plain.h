/* The routines of the machine as a simulation calls them: without tangents. */
#define prepare_advance(c, x, ua, ub, q, h) execute(c, (c)->routine->once, (c)->routine->run_once, (const double *[]){x, ua, ub, q, h}, 0, 0, 0)
#define advance(c, x, ua, ub, q, h, z) execute(c, (c)->routine->each, (c)->routine->run_each, (const double *[]){x, ua, ub, q, h}, 0, z, 0)
#define prepare_outputs(c, x, u, p) execute(c, (c)->routine->once, (c)->routine->run_once, (const double *[]){x, u, p}, 0, 0, 0)
#define outputs(c, x, u, p, z) execute(c, (c)->routine->each, (c)->routine->run_each, (const double *[]){x, u, p}, 0, z, 0)
