/* The coach's closed loop by hand, as a rival to railjax: the sampled balance logic, saturated creep, flange and sinusoidal track
 * of tests/reference.py, fixed-step RK4, one simulation in each lane of a vector, threads over vectors.
 *
 * Parameters come from tests/reference.py, and REAL is float or double (benchmarks/closed_loop.py compiles it). States in
 * the order of reference.py: y_c psi_c phi_c, y_b (2), psi_b (2), phi_b (2), y (4), psi (4), then their rates.
 */
#include <math.h>
#include "parameters.h" /* written by benchmarks/closed_loop.py */

#define ROOT __builtin_choose_expr(sizeof(REAL) == 4, sqrtf, sqrt)
#define SIN __builtin_choose_expr(sizeof(REAL) == 4, sinf, sin)

typedef REAL V __attribute__((vector_size(64)));
enum { LANES = 64 / sizeof(REAL), COORDINATES = 17, STATES = 2 * COORDINATES };

/* loops that the compiler turns into one instruction each, or into a call of the vector library */
#define EACH(expression) ({ V out; for (int n = 0; n < LANES; n++) out[n] = (expression); out; })
static inline V minimum(V a, REAL b) { return EACH(a[n] < b ? a[n] : b); }
static inline V maximum(V a, REAL b) { return EACH(a[n] > b ? a[n] : b); }
static inline V magnitude(V a) { return EACH(a[n] < 0 ? -a[n] : a[n]); }
static inline V root(V a) { return EACH(ROOT(a[n])); }
static inline V sine(V a) { return EACH(SIN(a[n])); }

static const int SIGN[2] = {1, -1};

static inline V secondary(const V *q, int bogie) {
  return q[0] + (REAL)H_CC * q[2] + SIGN[bogie] * (REAL)L * q[1] - q[3 + bogie] + (REAL)H_CB * q[7 + bogie];
}

/* x' at alignments eta; the dampers give |travel| held, N */
static inline void rate(const V *x, const V *eta, V slowness, const V *held, V *dx) {
  const V *q = x, *w = x + COORDINATES;
  V f[COORDINATES] = {};
  for (int j = 0; j < 2; j++) {
    const REAL side = SIGN[j];
    const V travel = secondary(q, j);
    const V lateral = (REAL)(2 * K_CY) * travel + held[j] * magnitude(travel);
    const V roll = (REAL)(2 * D_C * D_C * K_CZ) * (q[2] - q[7 + j]) + (REAL)(2 * D_C * D_C * C_CZ) * (w[2] - w[7 + j]);
    const V yaw = (REAL)(2 * D_C * D_C * K_CX) * (q[1] - q[5 + j]);
    f[0] -= lateral;
    f[1] -= side * (REAL)L * lateral + yaw;
    f[2] -= (REAL)H_CC * lateral + roll;
    f[3 + j] += lateral;
    f[5 + j] += yaw;
    f[7 + j] += roll - (REAL)H_CB * lateral - (REAL)(4 * D_O * D_O * K_OZ) * q[7 + j] - (REAL)(4 * D_O * D_O * C_OZ) * w[7 + j];
    for (int k = 0; k < 2; k++) {
      const int i = 2 * j + k, y = 9 + i, psi = 13 + i;
      const REAL arm = SIGN[k] * (REAL)A;
      const V pull = (REAL)(2 * K_OY) * (q[3 + j] + arm * q[5 + j] + (REAL)H_OB * q[7 + j] - q[y]);
      const V turn = (REAL)(2 * D_O * D_O * K_OX) * (q[5 + j] - q[psi]);
      f[3 + j] -= pull;
      f[5 + j] -= arm * pull + turn;
      f[7 + j] -= (REAL)H_OB * pull;
      const V relative = q[y] - eta[i], spin = w[psi] * slowness;
      const V along = (REAL)E * spin + (REAL)(CONICITY / R_0) * relative, across = w[y] * slowness - q[psi];
      const V force_x = (REAL)F_11 * along, force_y = (REAL)F_33 * across;
      const V linear = root(force_x * force_x + force_y * force_y) * (REAL)(1 / (MU * WHEEL_LOAD));
      const V u = maximum(linear, (REAL)1e-20), below = minimum(u, 3);
      const V factor = (1 + below * ((REAL)(-1.0 / 3) + below * (REAL)(1.0 / 27))) * (below / u);
      const V flange = (REAL)K_F * (maximum(relative - (REAL)DELTA, 0) + minimum(relative + (REAL)DELTA, 0));
      f[y] += pull - 2 * factor * (force_y + (REAL)F_12 * spin) - flange;
      f[psi] += turn + factor * (-2 * (REAL)E * force_x + (REAL)(2 * F_12) * across - (REAL)(2 * F_22) * spin);
    }
  }
  static const REAL mass[COORDINATES] = {M_C, I_CZ, I_CX, M_B, M_B, I_BZ, I_BZ, I_BX, I_BX, M_O, M_O, M_O, M_O, I_O, I_O, I_O, I_O};
  for (int k = 0; k < COORDINATES; k++) {
    dx[k] = w[k];
    dx[COORDINATES + k] = f[k] * (1 / mass[k]);
  }
}

static inline void aligned(V wavenumber, V distance, REAL amplitude, V *eta) {
  for (int i = 0; i < 4; i++) eta[i] = amplitude * sine(wavenumber * (distance + (SIGN[i / 2] * (REAL)L + SIGN[i % 2] * (REAL)A)));
}

/* r.m.s. lateral acceleration of the car body (m/s^2) of `count` simulations, all wheelsets off by `offset` (m) at the start */
void run(int count, int steps, REAL dt, REAL amplitude, REAL wavelength, REAL offset, const REAL *speeds, const REAL *alphas, REAL *rms) {
#pragma omp parallel for schedule(dynamic)
  for (int first = 0; first < count; first += LANES) {
    V x[STATES] = {}, k1[STATES], k2[STATES], k3[STATES], k4[STATES], at[STATES], eta[4], middle[4], held[2], sum = {}, speed, alpha;
    for (int n = 0; n < LANES; n++) {
      const int lane = first + n < count ? first + n : count - 1;
      speed[n] = speeds[lane];
      alpha[n] = alphas[lane];
    }
    const V slowness = 1 / speed, wavenumber = (V){} + (REAL)(2 * M_PI) / wavelength;
    for (int i = 0; i < 4; i++) x[9 + i] += offset;
    aligned(wavenumber, (V){}, amplitude, eta);
    for (int step = 0; step < steps; step++) {
      for (int j = 0; j < 2; j++) { /* the controller decides once a step */
        const V travel = secondary(x, j), velocity = secondary(x + COORDINATES, j);
        held[j] = (REAL)(2 * K_CY) * alpha * EACH(travel[n] * velocity[n] < 0 ? (velocity[n] > 0 ? (REAL)1 : (REAL)-1) : (REAL)0);
      }
      rate(x, eta, slowness, held, k1);
      sum += k1[COORDINATES] * k1[COORDINATES];
      aligned(wavenumber, speed * ((step + (REAL)0.5) * dt), amplitude, middle);
      aligned(wavenumber, speed * ((step + 1) * dt), amplitude, eta);
      for (int k = 0; k < STATES; k++) at[k] = x[k] + dt / 2 * k1[k];
      rate(at, middle, slowness, held, k2);
      for (int k = 0; k < STATES; k++) at[k] = x[k] + dt / 2 * k2[k];
      rate(at, middle, slowness, held, k3);
      for (int k = 0; k < STATES; k++) at[k] = x[k] + dt * k3[k];
      rate(at, eta, slowness, held, k4);
      for (int k = 0; k < STATES; k++) x[k] += dt / 6 * (k1[k] + 2 * (k2[k] + k3[k]) + k4[k]);
    }
    for (int n = 0; n < LANES && first + n < count; n++) rms[first + n] = sqrt(sum[n] / steps);
  }
}
