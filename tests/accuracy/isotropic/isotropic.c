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
#include "tests/accuracy/isotropic/isotropic.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/transport/bessel.h"
#include "core/transport/decay.h"
#include "core/transport/functions.h"
#include "core/transport/single.h"
#include "tests/accuracy/isotropic/parts.h"

/* The rules are more accurate than the tolerance by this factor. */
#define FINER 200.0
/* lambda is this share of kappa, but at least LAMBDA_MIN. */
#define SHRINK 0.999
#define LAMBDA_MIN 9e-10
/* At the end of the reach, R is smaller than e^(-kappa r) by algebraic factors of up to
 * e^-DECAYS_MORE. */
#define DECAYS_MORE 10.0
/* largest mu: wavenumbers keep away from the imaginary axis, as parts.h demands */
#define MU_MAX 1.15
/* The code solves equations for k up to K_SOLVED and extrapolates X beyond that. */
#define K_SOLVED 2e4
/* The sum over wavenumbers ends at K_END. */
#define K_END 1e9
/* For radii below R_LIMIT the code uses the limit for r -> 0. */
#define R_LIMIT 1e-7
/* Equations with |k| below K_NEAR are NEAR_FINER times as accurate as others, but never finer than
 * ACCURACY_MIN: they alone determine R at large radii, where most of their sum cancels. */
#define K_NEAR 4.0
#define NEAR_FINER 300.0
#define ACCURACY_MIN 1e-13
/* The total needs only one wavenumber, which stands for 0. */
#define K_TOTAL 1e-15
#define TOTAL_ACCURACY 1e-14
#define SINGLE_STEP 0.27

enum { POINTS_MAX = 640 };

struct isotropic_solution {
  double albedo, multiple_total, total;
  single_rule single;
  /* The exitance of light scattered more than once, at the path's wavenumbers. */
  double far; /* limit of exitance times k^2 as k goes to infinity */
  size_t n;
  double complex k[POINTS_MAX], weighted[POINTS_MAX]; /* exitance times the rule's weight dk */
};

/* ---- the exitance --------------------------------------------------------------------------- */

struct path {
  double lambda, mu, step; /* step of y, which starts at 0 */
};

static double complex wavenumber(const struct path *path, size_t j, double complex *dk) {
  double complex sine, cosine;
  isotropic_sinhcosh(CMPLX((double)j * path->step, path->mu), &sine, &cosine);
  *dk = (j == 0 ? 0.5 : 1) * path->step * path->lambda * cosine;
  return path->lambda * sine;
}

/* Chooses mu and the step so that both errors are balanced: 2 pi mu / h = digits + decay_kept and 2
 * pi (pi / 2 - mu) / h >= digits. */
static struct path choose_path(double kappa, double accuracy, double reach) {
  const double digits = -fn_log(accuracy), decay_kept = reach + DECAYS_MORE;
  struct path path = {.lambda = fmax(SHRINK * kappa, LAMBDA_MIN)};
  path.mu = fmin(MU_MAX, 0.5 * FN_PI * (digits + decay_kept) / (2 * digits + decay_kept));
  path.step = 2 * FN_PI * path.mu / (digits + decay_kept);
  return path;
}

/* The asymptote X k^2 = far + (b ln k + c) / k, which fit_asymptote() fits at three wavenumbers. */
struct asymptote {
  double complex far, b, c;
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

static void solve_spectrum(isotropic_solution *to, double eta, double kappa, double tolerance,
                           double reach) {
  const double accuracy = tolerance / FINER, near = fmax(ACCURACY_MIN, accuracy / NEAR_FINER);
  const struct path path = choose_path(kappa, accuracy, reach);
  const double steps = fn_log(2 * K_SOLVED / path.lambda) / path.step;
  const size_t solved = steps < POINTS_MAX ? (size_t)steps : POINTS_MAX;
  double complex exitance[POINTS_MAX], dk;
  /* With almost no absorption, at the smallest lambda, the path would begin on the cut of X, at a
   * distance of 1e-9 from 0. Near 0 X is linear in k, and only its real part counts at the path's
   * beginning. So the code extrapolates X at the first wavenumber from the next two. */
  const bool cut_through = kappa < path.lambda;
  for (size_t j = solved; j-- > 0;) {
    const double complex k = to->k[j] = wavenumber(&path, j, &dk);
    exitance[j] =
        j == 0 && cut_through
            ? creal(exitance[1] -
                    (exitance[2] - exitance[1]) * fn_inverse(to->k[2] - to->k[1]) * to->k[1])
            : isotropic_exitance(eta, fn_abs(k) < K_NEAR ? near : accuracy, k, to->albedo, kappa);
    to->weighted[j] = exitance[j] * dk;
  }
  const struct asymptote fit =
      fit_asymptote(to->k, exitance, solved, (size_t)(1 + 1.1 / path.step));
  to->far = creal(fit.far);
  to->n = solved;
  for (size_t j = solved; j < POINTS_MAX && !(fn_abs(to->k[j - 1]) > K_END); j++) {
    to->k[j] = wavenumber(&path, j, &dk);
    to->weighted[j] = asymptote_at(&fit, to->k[j]) * dk;
    to->n = j + 1;
  }
}

isotropic_solution *isotropic_solve(double eta, double albedo, double tolerance, double reach) {
  isotropic_solution *solution = calloc(1, sizeof *solution);
  assert(solution != NULL && eta >= 0.25 && eta <= 4 && albedo >= 0 && albedo <= 1);
  if (albedo > 0) {
    const double kappa = transport_kappa(albedo);
    solution->albedo = albedo;
    transport_single_rule(&solution->single, eta, 1, SINGLE_STEP);
    solution->multiple_total =
        creal(isotropic_exitance(eta, TOTAL_ACCURACY, K_TOTAL, albedo, kappa));
    solution->total = solution->multiple_total +
                      albedo * transport_single_at(&solution->single, (double)INFINITY).within;
    solve_spectrum(solution, eta, kappa, tolerance, reach);
  }
  return solution;
}

void isotropic_free(isotropic_solution *of) {
  free(of);
}

double isotropic_total(const isotropic_solution *of) {
  return of->total;
}

/* ---- the way back --------------------------------------------------------------------------- */

/* Light scattered more than once, at a radius: R, and the energies within the radius, accurate for
 * small ones, and beyond it, accurate for large ones. */
struct multiple {
  double R, within, beyond;
};

static struct multiple sum_at(const isotropic_solution *of, double r) {
  struct multiple sum = {0, 0, 0};
  for (size_t j = 0; j < of->n; j++) {
    const bessel_k k = transport_bessel_k(CMPLX(0, -r) * of->k[j]);
    sum.R += cimag(of->weighted[j] * of->k[j] * k.k0) / (FN_PI * FN_PI);
    sum.within += creal(of->weighted[j] * k.pole_less_k1) * (2 * r / FN_PI);
    sum.beyond += creal(of->weighted[j] * k.k1) * (2 * r / FN_PI);
  }
  return sum;
}

/* Since X -> far / k^2 for large k, R(r) - R(r0) -> far / (2 pi) ln(r0 / r) as r and r0 go to 0. */
static struct multiple multiple_at(const isotropic_solution *of, double r) {
  struct multiple values = sum_at(of, fmax(r, R_LIMIT));
  if (r < R_LIMIT) {
    const double slope = of->far / (2 * FN_PI), energy = values.within + values.beyond;
    values.R += slope * (fn_log(R_LIMIT) - fn_log(r));
    values.within = FN_PI * r * r * (values.R + 0.5 * slope);
    values.beyond = energy - values.within;
  }
  return values;
}

/* Far away the energy beyond r is small and more accurate, so it is subtracted from the total. */
isotropic_values isotropic_at(const isotropic_solution *of, double r) {
  if (of->albedo == 0) {
    return (isotropic_values){0, 0, 0};
  }
  const single_values single = transport_single_at(&of->single, r);
  const struct multiple multiple = multiple_at(of, r);
  const double within =
      multiple.beyond < multiple.within ? of->multiple_total - multiple.beyond : multiple.within;
  return (isotropic_values){of->albedo * single.r + fmax(0, multiple.R), of->albedo * single.r,
                            of->albedo * single.within + fmax(0, within)};
}
