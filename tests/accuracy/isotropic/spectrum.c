/* With X(k) the exitance of light scattered more than once, Fourier transformed over the plane,
 *
 *   R(r) = 1 / (2 pi) Re int X(k) H0(kr) k dk,     H0 = H0^(1).
 *
 * The path of k may be any that runs from the imaginary axis below i kappa to infinity in the first
 * quadrant: X is analytic there, and on that part of the axis X is real and H0 k dk is imaginary.
 * On the hyperbola
 *
 *   k = lambda sinh(y + i mu),   0 < mu < pi / 2,   lambda <= kappa,
 *
 * the integrand is even in y up to conjugation. It decays exponentially without oscillating, for
 * every r. It is analytic for all mu from 0 (the real axis) to pi / 2 (where the path wraps the cut
 * of X from i kappa upwards). So the trapezoidal rule with step h has the errors e^(-2 pi mu / h)
 * times R at r = 0 and e^(-2 pi (pi / 2 - mu) / h) times R at r (Lopez-Fernandez and Palencia 2004;
 * Weideman and Trefethen 2007 for the inverse Laplace transform). The energies are
 *
 *   int_r^inf 2 pi r' R dr' = -Re int X(k) r H1(kr) dk
 *   int_0^r   2 pi r' R dr' =  Re int X(k) [r H1(kr) + 2 i / (pi k)] dk
 *
 * The code uses w = -i k r, with H0(kr) = -2 i / pi K0(w), H1(kr) = -2 / pi K1(w), i / k = r / w.
 */
#include "tests/accuracy/isotropic/spectrum.h"

#include <math.h>
#include <stdlib.h>

#include "core/transport/bessel.h"
#include "core/transport/functions.h"

#define LN2 0.69314718055994530942
/* lambda is the largest LAMBDA_MAX 2^(-level / LEVELS_PER_OCTAVE) that is at most kappa. */
#define LAMBDA_MAX 0.97
#define LEVELS_PER_OCTAVE 4.0
/* At the end of the reach, R is smaller than e^(-kappa r) by algebraic factors of up to
 * e^-DECAYS_MORE. */
#define DECAYS_MORE 10.0
/* largest mu: wavenumbers keep away from the imaginary axis, as nodes.h demands */
#define MU_MAX 1.15
/* The code solves equations for k up to K_SOLVED and extrapolates X beyond that. */
#define K_SOLVED 2e4
/* The sum over wavenumbers ends at K_END. */
#define K_END 1e9
/* For radii below R_LIMIT the code uses the limit for r -> 0. */
#define R_LIMIT 1e-7

/* Equations with |k| below K_NEAR get rules NEAR_FINER times as accurate as others, but never finer
 * than ACCURACY_MIN. */
#define K_NEAR 4.0
#define NEAR_FINER 300.0
#define ACCURACY_MIN 1e-13

/* ---- wavenumbers ---------------------------------------------------------------------------- */

size_t isotropic_spectrum_level(double kappa) {
  const double octaves = -fn_log(fmax(kappa, 1e-30) / LAMBDA_MAX) / LN2;
  const double level = LEVELS_PER_OCTAVE * octaves;
  return level < SPECTRUM_LEVEL_MAX ? (size_t)fmax(0, ceil(level)) : SPECTRUM_LEVEL_MAX;
}

double isotropic_spectrum_lambda(size_t level, double shrink) {
  return shrink * LAMBDA_MAX * fn_exp(-LN2 / LEVELS_PER_OCTAVE * (double)level);
}

static double complex wavenumber(const spectrum_grid *grid, size_t j, double complex *dk) {
  double complex sine, cosine;
  isotropic_sinhcosh(CMPLX((double)j * grid->step, grid->mu), &sine, &cosine);
  *dk = (j == 0 ? 0.5 : 1) * grid->step * grid->lambda * cosine;
  return grid->lambda * sine;
}

/* Chooses mu and the step so that both errors are balanced: 2 pi mu / h = digits + decay_kept and 2
 * pi (pi / 2 - mu) / h >= digits. */
static void choose_contour(spectrum_grid *grid, const spectrum_rules *rules, double lambda) {
  const double digits = -fn_log(rules->accuracy);
  const double decay_kept = rules->reach_decays + DECAYS_MORE;
  grid->lambda = lambda;
  grid->mu = fmin(MU_MAX, 0.5 * FN_PI * (digits + decay_kept) / (2 * digits + decay_kept));
  grid->step = 2 * FN_PI * grid->mu / (digits + decay_kept);
  const double steps = fn_log(2 * K_SOLVED / grid->lambda) / grid->step;
  grid->n = steps < SPECTRUM_POINTS_MAX ? (size_t)steps : SPECTRUM_POINTS_MAX;
}

void isotropic_spectrum_rules(spectrum_rules *rules, double eta, double accuracy,
                              double reach_decays) {
  rules->accuracy = accuracy;
  rules->reach_decays = reach_decays;
  isotropic_nodes_rules(&rules->near, eta, fmax(ACCURACY_MIN, accuracy / NEAR_FINER));
  isotropic_nodes_rules(&rules->far, eta, accuracy);
}

spectrum_grid *isotropic_grid_new(const spectrum_rules *rules, double lambda) {
  spectrum_grid *grid = malloc(sizeof *grid);
  if (grid == NULL) {
    return NULL;
  }
  choose_contour(grid, rules, lambda);
  for (size_t j = 0; j < grid->n; j++) {
    double complex dk;
    const double complex k = wavenumber(grid, j, &dk);
    const nodes_rules *at_k = fn_abs(k) < K_NEAR ? &rules->near : &rules->far;
    if (!isotropic_equation_make(&grid->equations[j], at_k, k)) {
      grid->n = j;
      isotropic_grid_free(grid);
      return NULL;
    }
  }
  return grid;
}

void isotropic_grid_free(spectrum_grid *of) {
  if (of != NULL) {
    for (size_t j = 0; j < of->n; j++) {
      isotropic_equation_free(&of->equations[j]);
    }
    free(of);
  }
}

/* ---- the exitance --------------------------------------------------------------------------- */

/* The asymptote X k^2 = far + (b ln k + c) / k, which fit_asymptote() fits at three wavenumbers. */
struct asymptote {
  double complex far;
  double complex b;
  double complex c;
};

static struct asymptote fit_asymptote(const double complex *k, const double complex *exitance,
                                      size_t n, size_t apart) {
  double complex value[3], ln_by_k[3], by_k[3];
  for (size_t i = 0; i < 3; i++) {
    const double complex at = k[n - 1 - i * apart];
    value[i] = exitance[n - 1 - i * apart] * at * at;
    by_k[i] = fn_inverse(at);
    ln_by_k[i] = fn_clog(at) * by_k[i];
  }
  const double complex l1 = ln_by_k[1] - ln_by_k[0], l2 = ln_by_k[2] - ln_by_k[0];
  const double complex k1 = by_k[1] - by_k[0], k2 = by_k[2] - by_k[0];
  const double complex v1 = value[1] - value[0], v2 = value[2] - value[0];
  const double complex inverse_determinant = fn_inverse(l1 * k2 - l2 * k1);
  struct asymptote fit;
  fit.b = (v1 * k2 - v2 * k1) * inverse_determinant;
  fit.c = (l1 * v2 - l2 * v1) * inverse_determinant;
  fit.far = value[0] - fit.b * ln_by_k[0] - fit.c * by_k[0];
  return fit;
}

static double complex asymptote_at(const struct asymptote *fit, double complex k) {
  const double complex by_k = fn_inverse(k);
  return (fit->far + (fit->b * fn_clog(k) + fit->c) * by_k) * by_k * by_k;
}

bool isotropic_spectrum_make(spectrum *to, const spectrum_grid *grid, isotropic_work *work,
                             double albedo, double kappa) {
  double complex exitance[SPECTRUM_POINTS_MAX];
  double complex dk;
  /* With almost no absorption, at the smallest lambda, the path would begin on the cut of X, at a
   * distance of 1e-9 from 0. */
  const bool cut_through = kappa < grid->lambda;
  for (size_t j = 0; j < grid->n; j++) {
    to->k[j] = wavenumber(grid, j, &dk);
    if (!(j == 0 && cut_through) &&
        !isotropic_equation_solve(&grid->equations[j], work, albedo, kappa, &exitance[j])) {
      return false;
    }
    to->weighted[j] = exitance[j] * dk;
  }
  if (cut_through) {
    /* Near 0 X is linear in k, and only its real part counts at the path's beginning. So the code
     * extrapolates X at the first wavenumber from the next two. */
    const double complex slope = (exitance[2] - exitance[1]) * fn_inverse(to->k[2] - to->k[1]);
    wavenumber(grid, 0, &dk);
    to->weighted[0] = creal(exitance[1] - slope * to->k[1]) * dk;
  }
  const struct asymptote fit =
      fit_asymptote(to->k, exitance, grid->n, (size_t)(1 + 1.1 / grid->step));
  to->lambda = grid->lambda;
  to->far = creal(fit.far);
  to->n = grid->n;
  for (size_t j = grid->n; j < SPECTRUM_POINTS_MAX; j++) {
    to->k[j] = wavenumber(grid, j, &dk);
    to->weighted[j] = asymptote_at(&fit, to->k[j]) * dk;
    to->n = j + 1;
    if (fn_abs(to->k[j]) > K_END) {
      break;
    }
  }
  return true;
}

/* ---- the way back --------------------------------------------------------------------------- */

static spectrum_values sum_at(const spectrum *of, double r) {
  spectrum_values sum = {0, 0, 0, 0};
  double size = 0;
  for (size_t j = 0; j < of->n; j++) {
    const double complex w = CMPLX(0, -r) * of->k[j];
    const bessel_k k = transport_bessel_k(w);
    const double complex r_term = of->weighted[j] * of->k[j] * k.k0;
    sum.r += cimag(r_term);
    size += fabs(creal(r_term)) + fabs(cimag(r_term));
    sum.within += creal(of->weighted[j] * k.pole_less_k1);
    sum.beyond += creal(of->weighted[j] * k.k1);
  }
  sum.r /= FN_PI * FN_PI;
  sum.r_rounding = 0x1p-48 * size / (FN_PI * FN_PI);
  sum.within *= 2 * r / FN_PI;
  sum.beyond *= 2 * r / FN_PI;
  return sum;
}

/* Since X -> far / k^2 for large k, R(r) - R(r0) -> far / (2 pi) ln(r0 / r) as r and r0 go to 0. */
spectrum_values isotropic_spectrum_at(const spectrum *of, double r) {
  if (r >= R_LIMIT) {
    return sum_at(of, r);
  }
  spectrum_values values = sum_at(of, R_LIMIT);
  const double slope = of->far / (2 * FN_PI);
  const double energy = values.within + values.beyond;
  values.r += slope * (fn_log(R_LIMIT) - fn_log(r));
  values.within = FN_PI * r * r * (values.r + 0.5 * slope);
  values.beyond = energy - values.within;
  return values;
}
