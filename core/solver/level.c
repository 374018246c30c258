/* `far`: light that is scattered twice and comes back to where it entered runs along a triangle.
 * The number of triangles of size l is in proportion to dl / l, so that R2(r) = far / (2 pi) ln(1 /
 * r) + ..., with
 *
 *   far = (2 pi a)^2 int_0^pi/2 T(mu) mu dtheta int_theta^pi p(cos t) p(-cos(t - theta)) dt,
 *
 * mu = cos(theta), theta the angle at which the light leaves, t the angle by which it is deflected
 * first. Light that leaves on the far side, where the beam arrives, has p(-cos t) in place of p(cos
 * t). The light that leaves within a cone of angles has its own X, whose integral over theta ends
 * at the cone's edge. */
#include "core/solver/level.h"

#include <math.h>

#include "core/transport/functions.h"
#include "core/transport/gauss.h"
#include "core/transport/single.h"

/* ---- how finely ---------------------------------------------------------------------------- */

const struct level solver_levels[SOLVER_LEVELS] = {
    {1e-4,
     30,
     {2e-3, 1e-3},
     0.80,
     8,
     {{0.3, {3, 7, 3}}, {1, {4, 8, 3}}, {3, {6, 9, 3}}, {4.5, {6, 10, 4}}}},
    {1e-4,
     40,
     {1.2e-3, 3e-4},
     0.80,
     8,
     {{0.3, {4, 9, 3}}, {1, {6, 10, 3}}, {3, {7, 12, 4}}, {5.5, {8, 14, 5}}}},
    {1e-4,
     48,
     {8e-4, 1.6e-4},
     0.85,
     9,
     {{0.3, {5, 11, 4}}, {1, {7, 12, 4}}, {3, {9, 15, 5}}, {6.5, {10, 18, 6}}}},
    {1e-5,
     64,
     {4e-4, 8e-5},
     0.85,
     10,
     {{0.3, {6, 13, 5}}, {1, {8, 14, 5}}, {3, {11, 18, 6}}, {8, {11, 22, 7}}}},
    {1e-5,
     80,
     {2e-4, SOLVER_NOT_FINEST},
     0.88,
     11,
     {{0.3, {7, 15, 5}}, {1, {9, 17, 6}}, {3, {12, 22, 7}}, {10, {13, 28, 9}}}},
    {1e-6,
     96,
     {SOLVER_LEAST_NEAR, SOLVER_LEAST},
     0.86,
     12,
     {{0.3, {8, 20, 8}}, {1, {10, 22, 8}}, {3, {13, 26, 8}}, {12, {15, 34, 10}}}},
};

size_t solver_first_level(double tolerance) {
  return tolerance < 2e-4 ? 2 : tolerance < 3e-3 ? 1 : 0;
}

/* The factor by which the next difference of grids falls is at least this much of the last one's. In
 * 12 media it was 0.6 or more of it wherever another grid reached the tolerance. */
#define GAIN_GROWS 0.6

bool solver_goes_on(size_t level, double worst, double before, double tolerance) {
  const double expected = isinf(before) ? 0 : worst * fmin(1, GAIN_GROWS * worst / before);
  return worst > tolerance &&
         (level + 1 < SOLVER_LEVELS || expected <= tolerance || tolerance <= CORE_TOLERANCE_FINEST);
}

bool solver_stops(const atomic_bool *stop) {
  return stop != NULL && atomic_load_explicit(stop, memory_order_relaxed);
}

/* ---- phase functions ----------------------------------------------------------------------- */

double solver_moment_at(const solver_phase *phase, size_t l) {
  if (phase->moments > 0) {
    return l < phase->moments ? phase->moment[l] : 0;
  }
  double power = 1;
  for (size_t i = 0; i < l; i++) {
    power *= phase->g;
  }
  return power;
}

/* Returns 4 pi p(cos), where p is the phase function, normalized to 1 over the sphere. */
double solver_phase_at(const solver_phase *phase, double cosine) {
  if (phase->moments == 0) {
    const double g = phase->g, base = 1 + g * g - 2 * g * cosine;
    return (1 - g) * (1 + g) / (base * sqrt(base));
  }
  double before = 0, here = 1, sum = 0;
  for (size_t l = 0; l < phase->moments; l++) {
    sum += (double)(2 * l + 1) * phase->moment[l] * here;
    const double next =
        ((double)(2 * l + 1) * cosine * here - (double)l * before) / (double)(l + 1);
    before = here;
    here = next;
  }
  return sum;
}

/* Where light is scattered back: the moments for each degree of the functions of angle, and
 * exitance_series.peak times 1 - |g|. */
#define SENT_BACK (-0.6) /* mean cosine below which that is */
#define MOMENTS_BACKWARD 1.5
#define PEAK_BACKWARD 1.6
#define PEAK_FROM (-0.75) /* mean cosine below which X has it */

bool solver_is_backward(const solver_phase *phase) {
  return solver_moment_at(phase, 1) < SENT_BACK;
}

expansion_rules solver_rules_at(const struct level *level, size_t tier, bool backward) {
  expansion_rules rules = level->tier[tier].rules;
  rules.degrees = level->tier[backward ? TIERS - 1 : tier].rules.degrees;
  return rules;
}

double solver_peak_at(const solver_phase *phase) {
  const double g = solver_moment_at(phase, 1);
  return g < PEAK_FROM ? PEAK_BACKWARD / (1 + g) : 0;
}

size_t solver_moments_kept(const solver_phase *phase, double least, size_t most, size_t degrees) {
  if (solver_is_backward(phase)) {
    most = (size_t)(MOMENTS_BACKWARD * (double)degrees);
  }
  while (most > 2 && fabs(solver_moment_at(phase, most - 1)) <= least) {
    most--;
  }
  return most;
}

double solver_truncate(expansion_medium *to, double *moment, const solver_phase *phase,
                       size_t count, double albedo) {
  /* Where moments change their signs, their peak is at the back. */
  const double first = solver_moment_at(phase, count), next = solver_moment_at(phase, count + 1);
  const double back = first * next < 0 ? fabs(first) : 0, forward = back > 0 ? 0 : fmax(0, first);
  const double smooth = 1 - forward - back, kept = 1 - albedo * forward;
  for (size_t l = 0; l < count; l++) {
    const double peak = forward + (l % 2 == 0 ? back : -back);
    moment[l] = (solver_moment_at(phase, l) - peak) / smooth;
  }
  *to = (expansion_medium){albedo * smooth / kept, count, moment, albedo * back};
  return kept;
}

double solver_beam_reflectance(double one, double other) {
  const double root = (one - other) / (one + other);
  return root * root;
}

/* ---- errors by two grids ------------------------------------------------------------------- */

/* A grid cuts off a phase function's moments from one on that is larger than this where its basis
 * does not resolve them. Its error is taken to be in proportion to the first of them. */
#define CUT_COUNTS 1e-3

double solver_shared_by_cuts(const solver_phase *phase, size_t fine, size_t coarse) {
  const double least = solver_moment_at(phase, fine), most = solver_moment_at(phase, coarse);
  return least > CUT_COUNTS && most > least ? fmax(1, least / (most - least)) : 1;
}

double solver_error_between(double margin, double fine, double coarse) {
  const double least = coarse > 0 ? 0 : 1; /* by which they differ */
  const double error = fine > 0 ? margin * fmax(fabs(1 - coarse / fine), least) : 1;
  return isfinite(error) ? error : (double)INFINITY;
}

double solver_error_near(const double error[SOLVER_ERROR_RADII], double r, size_t last) {
  enum { SIDE = 2 };
  const double place =
      fn_log(fmax(r, SOLVER_ERROR_LEAST) / SOLVER_ERROR_LEAST) / fn_log(SOLVER_ERROR_RATIO) + 0.5;
  const size_t middle = place < SOLVER_ERROR_RADII - 1 ? (size_t)place : SOLVER_ERROR_RADII - 1;
  double most = 0;
  for (size_t i = middle > SIDE ? middle - SIDE : 0; i <= middle + SIDE && i < SOLVER_ERROR_RADII;
       i++) {
    most = fmax(most, i <= middle || i <= last ? error[i] : 0);
  }
  return most;
}

#define NEAR 0.4 /* scaled mean free paths */
double solver_floor_at(const double floor[2], double unit, double eta, double r) {
  const double near = NEAR * fmax(1, unit), more = 2 * (eta - 1);
  return fmax(floor[1], floor[0] * fmax(1, more) * fmin(1, near / r));
}

/* ---- light that is scattered twice near the source ----------------------------------------- */

/* Returns arcsin(x) for 0 < x <= 1. */
static double arcsine(double x) {
  return cimag(fn_clog(CMPLX(sqrt((1 - x) * (1 + x)), x)));
}

/* Returns the integral over t from theta to pi of p(cos t) p(-cos(t - theta)) (4 pi)^2, with
 * `onwards` of p(-cos t) p(-cos(t - theta)). The panels halve towards both ends, where p may be
 * narrow. */
static double second_deflections(const solver_phase *phase, const gauss_rule *rule, double theta,
                                 bool onwards) {
  enum { HALVINGS = 9 };
  const double length = FN_PI - theta;
  double sum = 0, end = 0.5;
  for (size_t panel = 0; panel < HALVINGS; panel++) {
    const double begin = panel + 1 < HALVINGS ? end / 2 : 0;
    for (size_t i = 0; i < rule->n; i++) {
      const double x = length * (begin + (end - begin) * rule->x[i]);
      const double weight = length * (end - begin) * rule->weight[i];
      for (int side = 0; side < 2; side++) {
        double sine, first, second;
        fn_sincos(side == 0 ? theta + x : FN_PI - x, &sine, &first);
        fn_sincos(side == 0 ? x : length - x, &sine, &second);
        sum += weight * solver_phase_at(phase, onwards ? -first : first) *
               solver_phase_at(phase, -second);
      }
    }
    end = begin;
  }
  return sum;
}

double solver_far(double single, const solver_phase *phase, double eta, double edge, bool onwards) {
  enum { ANGLES = 40, DEFLECTIONS = 12 };
  gauss_rule angles, deflections;
  transport_gauss(&angles, ANGLES);
  transport_gauss(&deflections, DEFLECTIONS);
  const double most = edge < eta ? arcsine(edge / eta) : 0.5 * FN_PI;
  double sum = 0;
  for (size_t i = 0; i < angles.n; i++) {
    const double v = angles.x[i];
    double sine, mu;
    fn_sincos(most * (1 - v * v), &sine, &mu);
    const double mu_outside = sqrt(fmax(0, 1 - eta * eta * (1 - mu) * (1 + mu)));
    const double t = eta == 1 ? 1 : transport_transmittance(eta, mu, mu_outside);
    sum += 2 * v * most * angles.weight[i] * t * mu *
           second_deflections(phase, &deflections, most * (1 - v * v), onwards);
  }
  return 0.25 * single * single * sum;
}
