/* The four loops of an adjoint over all samples of a record: one row after the other; what CasADi generates before them is called by its
   own interface. */
typedef long long whole;
void run_forward(whole n, whole nX, whole nu, const double* u, const double* c, double* X, whole* iw, double* w) {
  for (whole k = 0; k < n; ++k) {
    const double* arg[64] = {X + k * nX, u + k * nu, c};
    double* res[64] = {X + (k + 1) * nX};
    forward(arg, res, iw, w, 0);
  }
}
void run_backward(whole n, whole nX, whole nu, const double* X, const double* u, const double* c, const double* added,
                  double* costate, double* along, whole* iw, double* w) {
  for (whole k = n - 1; k >= 0; --k) {
    const double* arg[64] = {costate + (k + 1) * nX, X + k * nX, u + k * nu, c, added + k * nX};
    double* res[64] = {costate + k * nX, along + k * nu};
    backward(arg, res, iw, w, 0);
  }
}
void run_outputs(whole n, whole nX, whole nu, whole ny, const double* X, const double* u, const double* d, double* y,
                 whole* iw, double* w) {
  for (whole k = 0; k < n; ++k) {
    const double* arg[64] = {X + k * nX, u + k * nu, d};
    double* res[64] = {y + k * ny};
    outputs(arg, res, iw, w, 0);
  }
}
void run_outputs_back(whole n, whole nX, whole nu, whole ny, const double* X, const double* u, const double* d,
                      const double* b, double* at_x, double* at_u, whole* iw, double* w) {
  for (whole k = 0; k < n; ++k) {
    const double* arg[64] = {X + k * nX, u + k * nu, d, b + k * ny};
    double* res[64] = {at_x + k * nX, at_u + k * nu};
    outputs_back(arg, res, iw, w, 0);
  }
}
