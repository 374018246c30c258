/* With X(k) the exitance of light scattered more than once, Fourier transformed over the plane,
 *
 *   R(r) = 1 / (2 pi) Re int X(k) H0(kr) k dk,   k = s + i c, s from 0 to infinity,
 *
 * where 0 <= c < kappa, so that R keeps its digits where it decays as e^(-kappa r). X is
 * interpolated by Chebyshev polynomials on panels in s, which double in width up to K. Beyond,
 *
 *   X = (far + (b1 ln k + c1) / k + (b2 ln k + c2) / k^2) / k^2,
 *
 * where `far` is known from light that is scattered twice close to the source, and b and c are
 * fitted. There the path turns upwards, where H0 decays. What is left at K, where both meet, goes on as
 * k^-5 and k^-6, the next powers: a step there would be a wave in r of the wavenumber K, which counts
 * where R is small (on the finest grids it was 3e-3 of an R of 1e-12).
 *
 * `far`: light that is scattered twice and comes back to where it entered runs along a triangle.
 * The number of triangles of size l is in proportion to dl / l, so that R2(r) = far / (2 pi) ln(1 /
 * r) + ..., with
 *
 *   far = (2 pi a)^2 int_0^pi/2 T(mu) mu dtheta int_theta^pi p(cos t) p(-cos(t - theta)) dt,
 *
 * mu = cos(theta), theta the angle at which the light leaves, t the angle by which it is deflected
 * first. The light that leaves within a cone of angles has an X of its own, whose integral over theta
 * ends at the cone's edge.
 */
#include "core/transport/anisotropic.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/transport/bessel.h"
#include "core/transport/dense.h"
#include "core/transport/functions.h"
#include "core/transport/gauss.h"
#include "core/transport/halfspace.h"
#include "core/transport/single.h"

#define SINGLE_STEP 0.3
/* The tail is fitted to wavenumbers above this part of K. */
#define TAIL_FROM 0.3

/* ---- how finely ----------------------------------------------------------------------------- */

enum {
  TAIL_TERMS = 4,
  TIERS = 4,
  NODES_MAX = 16,
  PANELS_MAX = TRANSPORT_ANISOTROPIC_WAVENUMBERS_MAX / NODES_MAX,
  GRIDS = 2,
  FIT_POINTS_MAX = 3 * NODES_MAX,
  PARTS_MAX = TRANSPORT_ANISOTROPIC_ETAS_MAX * (1 + TRANSPORT_ANISOTROPIC_CONES_MAX),
};

/* Up to the wavenumber k_most, two expansions are averaged: the rules' own, and the one with an order
 * and a degree more. Their errors have opposite signs. */
struct tier {
  double k_most;
  halfspace_rules rules;
};

struct grid_rules {
  double moment_least; /* the series of the phase function ends at a moment as small as this */
  size_t moments_most;
  double floor;            /* least relative error that is stated */
  double margin[2];        /* stated errors over the grids' difference: below r = NEAR, beyond */
  double shift;            /* c / kappa */
  size_t nodes;            /* on each panel */
  struct tier tier[TIERS]; /* the last one's k_most is K */
};

static const struct grid_rules rules[] = {
    {1e-4,
     40,
     1e-3,
     {16, 3},
     0.80,
     8,
     {{0.3, {4, 9, 3}}, {1, {6, 10, 3}}, {3, {7, 12, 4}}, {6, {8, 14, 5}}}},
    {1e-4,
     48,
     6e-5,
     {16, 3},
     0.85,
     9,
     {{0.3, {5, 11, 4}}, {1, {7, 12, 4}}, {3, {9, 15, 5}}, {8, {10, 18, 6}}}},
    {1e-5,
     64,
     3e-5,
     {10, 3},
     0.88,
     10,
     {{0.3, {6, 13, 5}}, {1, {8, 14, 5}}, {4, {11, 17, 6}}, {12, {12, 23, 8}}}},
    {1e-6,
     96,
     1e-5,
     {2, 2},
     0.86,
     12,
     {{0.3, {6, 26, 8}}, {1, {8, 26, 8}}, {4, {10, 26, 8}}, {16, {12, 30, 8}}}},
};

/* ---- the medium ----------------------------------------------------------------------------- */

/* A medium after its phase function has been truncated. */
struct scaled {
  halfspace_medium medium;
  double moment[HALFSPACE_MOMENTS_MAX];
  double unit;   /* scaled mean free path in reduced mean free paths */
  double kappa;  /* per scaled mean free path */
  double single; /* albedo by which light scattered once is in proportion, per scaled path */
};

static double moment_at(const transport_phase *phase, size_t l) {
  if (phase->moments > 0) {
    return l < phase->moments ? phase->moment[l] : 0;
  }
  double power = 1;
  for (size_t i = 0; i < l; i++) {
    power *= phase->g;
  }
  return power;
}

/* Returns the phase function, normalized to 1 over the sphere, times 4 pi. */
static double phase_at(const transport_phase *phase, double cosine) {
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

/* Returns the rate at which diffuse light decays: 1 / kappa is the largest eigenvalue of the
 * symmetric tridiagonal matrix with l / sqrt(h_(l-1) h_l) beside its diagonal, h_l = (2 l + 1) (1 -
 * a g_l). Bisection, with the signs of Sturm's sequence. absorbed: 1 - a. */
static double decay_rate(const halfspace_medium *medium, double absorbed) {
  enum { TERMS = 600, STEPS = 60 };
  double low = 0, high = 1;
  for (int step = 0; step < STEPS; step++) {
    const double middle = 0.5 * (low + high); /* a candidate for kappa */
    /* pivots of (1 / middle) H - T, positive as long as 1 / middle is above all eigenvalues */
    double pivot = absorbed / middle;
    bool above = pivot > 0;
    for (size_t l = 1; l < TERMS && above; l++) {
      const double g = l < medium->moments ? medium->moment[l] : 0;
      pivot = (double)(2 * l + 1) * (1 - medium->albedo * g) / middle - (double)(l * l) / pivot;
      above = pivot > 0;
    }
    if (above) {
      low = middle;
    } else {
      high = middle;
    }
  }
  return low;
}

static void truncate_phase(struct scaled *to, double ratio, const transport_phase *phase,
                           double moment_least, size_t moments_most) {
  const double g = moment_at(phase, 1);
  /* In reduced mean free paths sigma_a + sigma_s (1 - g) is 1. */
  const double sigma_s = 1 / (1 + ratio) / (1 - g), sigma_t = ratio / (1 + ratio) + sigma_s;
  const double albedo = sigma_s / sigma_t;
  size_t count = 2;
  while (count < moments_most && fabs(moment_at(phase, count)) > moment_least) {
    count++;
  }
  /* An odd moment of a backward phase function is negative, and nothing is left out then. */
  const double forward = fmax(0, moment_at(phase, count));
  for (size_t l = 0; l < count; l++) {
    to->moment[l] = (moment_at(phase, l) - forward) / (1 - forward);
  }
  const double kept = 1 - albedo * forward;
  to->medium = (halfspace_medium){albedo * (1 - forward) / kept, count, to->moment};
  to->unit = 1 / (kept * sigma_t);
  to->single = albedo / kept;
  to->kappa = decay_rate(&to->medium, 1 - to->medium.albedo);
}

double transport_anisotropic_kappa(double albedo, double g) {
  enum { MOMENTS = 200 };
  assert(albedo > 0 && albedo <= 1 && fabs(g) <= 0.99);
  double moment[MOMENTS];
  moment[0] = 1;
  for (size_t l = 1; l < MOMENTS; l++) {
    moment[l] = g * moment[l - 1];
  }
  const double sigma_s = albedo / (1 - g), sigma_t = 1 - albedo + sigma_s;
  const halfspace_medium medium = {sigma_s / sigma_t, MOMENTS, moment};
  return sigma_t * decay_rate(&medium, (1 - albedo) / sigma_t);
}

/* ---- light that is scattered twice near the source -------------------------------------------- */

/* Returns arcsin(x) for 0 < x <= 1. */
static double arcsine(double x) {
  return cimag(fn_clog(CMPLX(sqrt((1 - x) * (1 + x)), x)));
}

/* Returns the integral over t from theta to pi of p(cos t) p(-cos(t - theta)) (4 pi)^2. The panels
 * halve towards both ends, where p may be narrow. */
static double second_deflections(const transport_phase *phase, const gauss_rule *rule,
                                 double theta) {
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
        sum += weight * phase_at(phase, first) * phase_at(phase, -second);
      }
    }
    end = begin;
  }
  return sum;
}

/* edge: the sine of the cone's edge outside, 1 for light of all angles. */
static double far_of(const struct scaled *scaled, const transport_phase *phase, double eta,
                     double edge) {
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
           second_deflections(phase, &deflections, most * (1 - v * v));
  }
  return 0.25 * scaled->single * scaled->single * sum;
}

/* ---- one grid ------------------------------------------------------------------------------- */

struct panel {
  double begin, end;
};

/* What is known of X for one boundary and the light of all angles or of one cone: a Chebyshev series in s
 * on each panel, and the tail beyond K. */
struct exitance {
  double complex term[PANELS_MAX][NODES_MAX];
  double far, tail[TAIL_TERMS];
  /* of X less the tail at K: its value, and its derivative by ln k plus five times the value */
  double complex step, bend;
};

struct grid {
  const core_isa *isa;
  const struct grid_rules *rules;
  struct scaled scaled;
  double shift; /* c */
  size_t panels;
  struct panel panel[PANELS_MAX];
  struct exitance *exitance; /* one for each boundary, then one for each boundary and cone */
};

/* The boundaries and cones of a solution. */
struct boundaries {
  size_t count;
  const double *etas;
  size_t cones;
  const double *sines;
};

/* Returns how many X there are. X number i is of the boundary i % count, and of light of all angles
 * for i < count, else of the cone i / count - 1. */
static size_t parts_of(const struct boundaries *of) {
  return of->count * (1 + of->cones);
}

/* Returns the sine of the largest angle outside. */
static double sine_of(const struct boundaries *of, size_t part) {
  return part < of->count ? 1
                          : of->sines[part / of->count - 1] * fmin(of->etas[part % of->count], 1);
}

struct transport_anisotropic {
  size_t count;
  size_t parts;
  size_t grids;        /* number of grids that were solved, 1 or GRIDS */
  single_rule *single; /* one for each part, with the phase function in its weights */
  struct grid grid[GRIDS];
};

static void place_panels(struct grid *to) {
  const double last = to->rules->tier[TIERS - 1].k_most;
  double begin = 0, end = fmin(last / 4, (1 - to->rules->shift) * to->scaled.kappa);
  to->panels = 0;
  while (begin < last) {
    assert(to->panels < PANELS_MAX);
    to->panel[to->panels++] = (struct panel){begin, end};
    begin = end;
    end = 2 * end > 0.7 * last ? last : 2 * end;
  }
}

/* Returns s of a Chebyshev node. */
static double node_of(const struct grid *of, size_t panel, size_t i) {
  double sine, cosine;
  fn_sincos(FN_PI * ((double)i + 0.5) / (double)of->rules->nodes, &sine, &cosine);
  const struct panel *at = &of->panel[panel];
  return 0.5 * (at->begin + at->end) - 0.5 * (at->end - at->begin) * cosine;
}

/* Replaces values at the nodes by the terms of a Chebyshev series. */
static void find_terms(const struct grid *of, double complex *values) {
  const size_t n = of->rules->nodes;
  double complex term[NODES_MAX];
  for (size_t j = 0; j < n; j++) {
    term[j] = 0;
    for (size_t i = 0; i < n; i++) {
      double sine, cosine;
      fn_sincos(FN_PI * (double)j * ((double)i + 0.5) / (double)n, &sine, &cosine);
      /* the nodes are in ascending order: x_i = -cos */
      term[j] += values[i] * (j % 2 == 0 ? cosine : -cosine);
    }
    term[j] *= (j == 0 ? 1.0 : 2.0) / (double)n;
  }
  memcpy(values, term, n * sizeof *values);
}

static double complex series_at(const struct grid *of, const struct exitance *at, size_t panel,
                                double s) {
  const struct panel *p = &of->panel[panel];
  const double x = (2 * s - p->begin - p->end) / (p->end - p->begin);
  double complex one = 0, two = 0;
  for (size_t j = of->rules->nodes; j-- > 1;) {
    const double complex next = at->term[panel][j] + 2 * x * one - two;
    two = one;
    one = next;
  }
  return at->term[panel][0] + x * one - two;
}

/* Sets terms to what the coefficients of the tail are multiplied by at k. */
static void tail_terms(double complex k, double complex *terms) {
  const double complex inverse = fn_inverse(k), logarithm = fn_clog(k);
  const double complex inverse3 = inverse * inverse * inverse;
  terms[0] = logarithm * inverse3;
  terms[1] = inverse3;
  terms[2] = logarithm * inverse3 * inverse;
  terms[3] = inverse3 * inverse;
}

/* Normal equations of least squares, with one right side or two. */
enum { UNKNOWNS_MAX = 16, RIGHT_SIDES = 2 };
struct equations {
  dense normal, right;
  double memory[UNKNOWNS_MAX * (UNKNOWNS_MAX + 8)] __attribute__((aligned(64)));
};

static void begin_equations(struct equations *to, const core_isa *isa, size_t unknowns) {
  double *next = to->memory;
  memset(to->memory, 0, sizeof to->memory);
  to->normal = transport_dense_at(isa, &next, unknowns, unknowns, false);
  to->right = transport_dense_at(isa, &next, unknowns, RIGHT_SIDES, false);
}

/* Adds an equation whose unknowns are multiplied by terms[]. */
static void add_equation(struct equations *to, double weight, const double *terms,
                         const double right[RIGHT_SIDES]) {
  for (size_t row = 0; row < to->normal.rows; row++) {
    const double factor = weight * terms[row];
    for (size_t column = 0; column < to->normal.columns; column++) {
      to->normal.re[row * to->normal.stride + column] += factor * terms[column];
    }
    for (size_t side = 0; side < RIGHT_SIDES; side++) {
      to->right.re[row * to->right.stride + side] += factor * right[side];
    }
  }
}

/* Returns unknown i for each right side, after the equations have been solved. */
static const double *unknown(const struct equations *of, size_t i) {
  return of->right.re + i * of->right.stride;
}

/* Fits the tail to X at the nodes with s above a part of K, by least squares. Returns false if the
 * normal equations are singular. */
static bool fit_tail(const struct grid *of, struct exitance *at, const double complex *values) {
  const size_t nodes = of->rules->nodes;
  const double last = of->rules->tier[TIERS - 1].k_most;
  struct equations equations;
  begin_equations(&equations, of->isa, TAIL_TERMS);
  for (size_t i = 0; i < of->panels * nodes; i++) {
    const double s = node_of(of, i / nodes, i % nodes);
    if (s < TAIL_FROM * last) {
      continue;
    }
    const double complex k = CMPLX(s, of->shift), inverse = fn_inverse(k);
    double complex terms[TAIL_TERMS];
    tail_terms(k, terms);
    const double complex rest = values[i] - at->far * inverse * inverse;
    const double weight = s * s * s * s * s * s;
    double re[TAIL_TERMS], im[TAIL_TERMS];
    for (size_t j = 0; j < TAIL_TERMS; j++) {
      re[j] = creal(terms[j]);
      im[j] = cimag(terms[j]);
    }
    add_equation(&equations, weight, re, (double[]){creal(rest), 0});
    add_equation(&equations, weight, im, (double[]){cimag(rest), 0});
  }
  const bool ok = transport_dense_solve(&equations.normal, &equations.right);
  for (size_t i = 0; i < TAIL_TERMS && ok; i++) {
    at->tail[i] = unknown(&equations, i)[0];
  }
  return ok;
}

static double complex tail_at(const struct exitance *at, double complex k) {
  const double complex inverse = fn_inverse(k);
  double complex terms[TAIL_TERMS], sum = at->far * inverse * inverse;
  tail_terms(k, terms);
  for (size_t i = 0; i < TAIL_TERMS; i++) {
    sum += at->tail[i] * terms[i];
  }
  return sum;
}

/* Returns the derivative of the tail by k. */
static double complex tail_slope(const struct exitance *at, double complex k) {
  const double complex inverse = fn_inverse(k), logarithm = fn_clog(k);
  const double complex inverse3 = inverse * inverse * inverse;
  return inverse3 * (-2 * at->far +
                     inverse * (at->tail[0] * (1 - 3 * logarithm) - 3 * at->tail[1] +
                                inverse * (at->tail[2] * (1 - 4 * logarithm) - 4 * at->tail[3])));
}

/* Sets what is left at K, the end of the last panel, from the series there. */
static void join_tail(const struct grid *of, struct exitance *at) {
  const struct panel *last = &of->panel[of->panels - 1];
  const double complex k = CMPLX(last->end, of->shift), *term = at->term[of->panels - 1];
  double complex value = 0, slope = 0;
  for (size_t j = 0; j < of->rules->nodes; j++) {
    value += term[j];
    slope += (double)(j * j) * term[j];
  }
  at->step = value - tail_at(at, k);
  at->bend = k * (slope * 2 / (last->end - last->begin) - tail_slope(at, k)) + 5 * at->step;
}

/* Returns X on the way upwards from K. */
static double complex beyond(const struct exitance *at, double complex k_last, double complex k) {
  const double complex q = k_last * fn_inverse(k), q2 = q * q;
  return tail_at(at, k) + q2 * q2 * q * (at->step + at->bend * (1 - q));
}

/* Solves the wavenumbers of the nodes from *next on that belong to one tier. values:
 * [part][node of all panels]. Returns false if memory runs out or an equation is singular. */
static bool solve_tier(struct grid *of, const struct tier *tier, const struct boundaries *by,
                       double complex **values, size_t *next) {
  const size_t nodes = of->rules->nodes;
  const double last = of->rules->tier[TIERS - 1].k_most;
  halfspace *expansion[2] = {NULL, NULL};
  bool ok = true;
  for (size_t i = 0; i < 2 && ok; i++) {
    halfspace_rules at = tier->rules;
    at.orders += i;
    at.degrees += i;
    expansion[i] = transport_halfspace_new(of->isa, &at, &of->scaled.medium, by->etas, by->count,
                                           by->sines, by->cones);
    ok = expansion[i] != NULL;
  }
  for (; *next < of->panels * nodes && ok; ++*next) {
    const double s = node_of(of, *next / nodes, *next % nodes);
    if (fn_abs(CMPLX(s, of->shift)) > tier->k_most && tier->k_most < last) {
      break;
    }
    for (size_t i = 0; i < 2 && ok; i++) {
      halfspace_exitance exitance[TRANSPORT_ANISOTROPIC_ETAS_MAX];
      ok = transport_halfspace_solve(expansion[i], CMPLX(s, of->shift), of->scaled.kappa, exitance);
      for (size_t eta = 0; eta < by->count && ok; eta++) {
        values[eta][*next] += 0.5 * (exitance[eta].all - exitance[eta].single);
        for (size_t cone = 0; cone < by->cones; cone++) {
          values[(cone + 1) * by->count + eta][*next] += 0.5 * exitance[eta].cone[cone];
        }
      }
    }
  }
  transport_halfspace_free(expansion[0]);
  transport_halfspace_free(expansion[1]);
  return ok;
}

/* Returns k of a node by its position in all panels. */
static double complex wavenumber_of(const struct grid *of, size_t node) {
  return CMPLX(node_of(of, node / of->rules->nodes, node % of->rules->nodes), of->shift);
}

static double square_of(double complex k) {
  return creal(k) * creal(k) + cimag(k) * cimag(k);
}

/* Returns the first node that does not belong to this tier or to one below. */
static size_t end_of_tier(const struct grid *of, size_t tier) {
  const size_t nodes = of->panels * of->rules->nodes;
  size_t node = 0;
  while (node < nodes && !(fn_abs(wavenumber_of(of, node)) > of->rules->tier[tier].k_most)) {
    node++;
  }
  return node;
}

/* Errors of two tiers differ, so that X would have a small step where a tier ends, and R a wave of that
 * wavenumber: for g = 0.95, sigma_a 50 sigma_s' and eta 2.2 it is 1e-3 of R = 1e-10 on the finest grids.
 * The step is fitted together with a polynomial in ln s through k^2 X at the nodes on both sides, and
 * added to the values of the lower tiers in proportion to k^4, as their errors grow with k. Returns false
 * if the equations are singular. */
static bool join_tier(const struct grid *of, size_t tier, double complex *values) {
  enum { SIDE = 8, POLYNOMIALS = 9, UNKNOWNS = POLYNOMIALS + 1 };
  const size_t end = end_of_tier(of, tier);
  if (end < SIDE || end + SIDE > of->panels * of->rules->nodes) {
    return true;
  }
  const double first = fn_log(creal(wavenumber_of(of, end - SIDE)));
  const double last = fn_log(creal(wavenumber_of(of, end + SIDE - 1)));
  const double end2 = square_of(wavenumber_of(of, end));
  struct equations equations;
  begin_equations(&equations, of->isa, UNKNOWNS);
  for (size_t node = end - SIDE; node < end + SIDE; node++) {
    const double complex k = wavenumber_of(of, node);
    const double k2 = square_of(k), z = 2 * (fn_log(creal(k)) - first) / (last - first) - 1;
    double terms[UNKNOWNS] = {1, z};
    for (size_t j = 2; j < POLYNOMIALS; j++) {
      terms[j] = 2 * z * terms[j - 1] - terms[j - 2];
    }
    terms[POLYNOMIALS] = node < end ? -k2 * (k2 / end2) * (k2 / end2) : 0;
    add_equation(&equations, 1, terms,
                 (double[]){k2 * creal(values[node]), k2 * cimag(values[node])});
  }
  if (!transport_dense_solve(&equations.normal, &equations.right)) {
    return false;
  }
  const double *step = unknown(&equations, POLYNOMIALS);
  for (size_t node = 0; node < end; node++) {
    const double share = square_of(wavenumber_of(of, node)) / end2;
    values[node] += share * share * CMPLX(step[0], step[1]);
  }
  return true;
}

/* X at all nodes that a caller keeps: [part][TRANSPORT_ANISOTROPIC_WAVENUMBERS_MAX]. */
struct kept {
  double complex *exitances;
  bool known; /* whether they are given, else they are set */
};

/* kept: NULL, or where X is kept. */
static bool solve_grid(struct grid *to, const core_isa *isa, const struct grid_rules *by,
                       double ratio, const transport_phase *phase,
                       const struct boundaries *boundaries, const struct kept *kept) {
  const size_t parts = parts_of(boundaries);
  to->isa = isa;
  to->rules = by;
  truncate_phase(&to->scaled, ratio, phase, by->moment_least, by->moments_most);
  to->shift = by->shift * to->scaled.kappa;
  place_panels(to);
  to->exitance = calloc(parts, sizeof *to->exitance);
  double complex *values[PARTS_MAX];
  const size_t nodes = to->panels * by->nodes;
  values[0] = calloc(nodes * parts, sizeof **values);
  bool ok = to->exitance != NULL && values[0] != NULL;
  for (size_t part = 1; part < parts; part++) {
    values[part] = values[0] + part * nodes;
  }
  const bool known = kept != NULL && kept->known;
  size_t next = 0;
  for (size_t tier = 0; tier < TIERS && ok && !known; tier++) {
    ok = solve_tier(to, &by->tier[tier], boundaries, values, &next);
  }
  for (size_t part = 0; part < parts && ok && kept != NULL; part++) {
    double complex *at = kept->exitances + part * TRANSPORT_ANISOTROPIC_WAVENUMBERS_MAX;
    memcpy(known ? values[part] : at, known ? at : values[part], nodes * sizeof *at);
  }
  for (size_t part = 0; part < parts && ok; part++) {
    struct exitance *at = &to->exitance[part];
    at->far = far_of(&to->scaled, phase, boundaries->etas[part % boundaries->count],
                     sine_of(boundaries, part));
    for (size_t tier = TIERS - 1; tier-- > 0 && ok;) {
      ok = join_tier(to, tier, values[part]);
    }
    ok = ok && fit_tail(to, at, values[part]);
    for (size_t panel = 0; panel < to->panels; panel++) {
      memcpy(at->term[panel], values[part] + panel * by->nodes, by->nodes * sizeof **values);
      find_terms(to, at->term[panel]);
    }
    join_tail(to, at);
  }
  free(values[0]);
  return ok;
}

/* ---- solutions ------------------------------------------------------------------------------ */

/* Puts the phase function into the weights of light that was scattered once, which leaves at the
 * cosine mu = (E^2 - 1) / (E^2 + 1). */
static void weigh_single(single_rule *rule, const transport_phase *phase) {
  for (size_t i = 0; i < rule->n; i++) {
    const double e2 = rule->rate[i] * rule->rate[i];
    rule->weight[i] *= phase_at(phase, -(e2 - 1) / (e2 + 1));
  }
}

static const core_fault no_fault = {NULL, NULL, 0};
static const core_fault memory_fault = {CORE_FIELD_MEMORY, "enough for the solution", 0};

static core_fault check(double ratio, const transport_phase *phase, const double *etas,
                        size_t count) {
  if (!(ratio >= 1e-6 && ratio <= 100)) {
    return (core_fault){"sigma_a_ratio", "1e-6 to 100", 0};
  }
  const bool is_series = phase->moments != 0;
  if (is_series ? phase->moments < 2 || phase->moments > TRANSPORT_PHASE_MOMENTS_MAX ||
                      phase->moment[0] != 1 || !(fabs(phase->moment[1]) <= 0.99)
                : !(fabs(phase->g) <= 0.99)) {
    return (core_fault){"phase", "a mean cosine from -0.99 to 0.99", 0};
  }
  if (count < 1 || count > TRANSPORT_ANISOTROPIC_ETAS_MAX) {
    return (core_fault){"eta", "1 to 32 of them", 0};
  }
  for (size_t i = 0; i < count; i++) {
    if (!(etas[i] >= TRANSPORT_ETA_MIN && etas[i] <= TRANSPORT_ETA_MAX)) {
      return (core_fault){"eta", "0.25 to 4", i};
    }
  }
  return no_fault;
}

static core_fault solve(transport_anisotropic **solution, const core_isa *isa, double sigma_a_ratio,
                        const transport_phase *phase, const struct boundaries *boundaries,
                        transport_effort effort, size_t grids, const struct kept *kept) {
  *solution = NULL;
  const core_fault fault = check(sigma_a_ratio, phase, boundaries->etas, boundaries->count);
  if (fault.field != NULL) {
    return fault;
  }
  transport_anisotropic *made = calloc(1, sizeof *made);
  if (made == NULL) {
    return memory_fault;
  }
  made->count = boundaries->count;
  made->parts = parts_of(boundaries);
  made->grids = grids;
  made->single = malloc(made->parts * sizeof *made->single);
  bool ok = made->single != NULL;
  for (size_t i = 0; i < made->parts && ok; i++) {
    transport_single_rule(&made->single[i], boundaries->etas[i % made->count],
                          sine_of(boundaries, i), SINGLE_STEP);
    weigh_single(&made->single[i], phase);
  }
  for (size_t i = 0; i < grids && ok; i++) {
    ok = solve_grid(&made->grid[i], isa, &rules[effort + 1 - i], sigma_a_ratio, phase, boundaries,
                    kept);
  }
  if (!ok) {
    transport_anisotropic_free(made);
    return memory_fault;
  }
  *solution = made;
  return no_fault;
}

core_fault transport_anisotropic_solve(transport_anisotropic **solution, const core_isa *isa,
                                       double sigma_a_ratio, const transport_phase *phase,
                                       const double *etas, size_t count, transport_effort effort) {
  const struct boundaries boundaries = {.count = count, .etas = etas};
  return solve(solution, isa, sigma_a_ratio, phase, &boundaries, effort, GRIDS, NULL);
}

core_fault transport_anisotropic_solve_once(transport_anisotropic **solution, const core_isa *isa,
                                            double sigma_a_ratio, const transport_phase *phase,
                                            const double *etas, size_t count,
                                            transport_effort effort) {
  const struct boundaries boundaries = {.count = count, .etas = etas};
  return solve(solution, isa, sigma_a_ratio, phase, &boundaries, effort, 1, NULL);
}

core_fault transport_anisotropic_solve_kept(transport_anisotropic **solution, const core_isa *isa,
                                            double sigma_a_ratio, const transport_phase *phase,
                                            const double *etas, size_t count,
                                            transport_effort effort, double complex *exitances,
                                            bool known) {
  const struct boundaries boundaries = {.count = count, .etas = etas};
  const struct kept kept = {exitances, known};
  return solve(solution, isa, sigma_a_ratio, phase, &boundaries, effort, 1, &kept);
}

core_fault transport_anisotropic_solve_cones(transport_anisotropic **solution, const core_isa *isa,
                                             double sigma_a_ratio, const transport_phase *phase,
                                             const double *etas, size_t count, const double *sines,
                                             size_t cones, transport_effort effort, bool once) {
  *solution = NULL;
  if (cones > TRANSPORT_ANISOTROPIC_CONES_MAX) {
    return (core_fault){"sine", "0 to 8 of them", 0};
  }
  for (size_t i = 0; i < cones; i++) {
    if (!(sines[i] > 0 && sines[i] <= 1)) {
      return (core_fault){"sine", "above 0, up to 1", i};
    }
  }
  const struct boundaries boundaries = {count, etas, cones, sines};
  return solve(solution, isa, sigma_a_ratio, phase, &boundaries, effort, once ? 1 : GRIDS, NULL);
}

void transport_anisotropic_free(transport_anisotropic *solution) {
  if (solution != NULL) {
    for (size_t i = 0; i < GRIDS; i++) {
      free(solution->grid[i].exitance);
    }
    free(solution->single);
    free(solution);
  }
}

/* ---- the way back --------------------------------------------------------------------------- */

enum { RULE_NODES = 12 };

/* Returns X H0(kr) k, with H0(kr) = -2 i / pi K0(-i k r). */
static double complex weighted(double complex exitance, double complex k, double r) {
  return exitance * k * CMPLX(0, -2 / FN_PI) * transport_bessel_k(CMPLX(0, -r) * k).k0;
}

/* Returns the integral over s of one interval of a panel. */
static double interval(const struct grid *of, const struct exitance *at, const gauss_rule *rule,
                       size_t panel, double begin, double end, double r) {
  double sum = 0;
  for (size_t i = 0; i < rule->n; i++) {
    const double s = begin + (end - begin) * rule->x[i];
    sum += rule->weight[i] * creal(weighted(series_at(of, at, panel, s), CMPLX(s, of->shift), r));
  }
  return sum * (end - begin);
}

/* Returns R of light scattered more than once, per squared scaled mean free path. */
static double multiple_at(const struct grid *of, size_t eta, double r) {
  enum { HALVINGS = 12, DOUBLINGS = 200 };
  const struct exitance *at = &of->exitance[eta];
  gauss_rule rule;
  transport_gauss(&rule, RULE_NODES);
  double sum = 0;
  for (size_t panel = 0; panel < of->panels; panel++) {
    const struct panel *p = &of->panel[panel];
    const double width = p->end - p->begin;
    const double periods = ceil(width * r / (2 * FN_PI));
    const size_t parts = periods < 1 ? 1 : (size_t)periods;
    for (size_t i = 0; i < parts; i++) {
      double begin = p->begin + width * (double)i / (double)parts;
      const double end = p->begin + width * (double)(i + 1) / (double)parts;
      /* The Hankel function H0(kr) is not smooth at k = 0, so the interval that begins there is cut
       * in halves, the lower one again and again. */
      for (size_t halving = HALVINGS; begin == 0 && halving > 0; halving--) {
        const double next = end * fn_exp(-0.69314718055994531 * (double)(halving - 1));
        const double from = halving == HALVINGS ? 0 : next / 2;
        sum += interval(of, at, &rule, panel, from, next, r);
      }
      if (begin > 0) {
        sum += interval(of, at, &rule, panel, begin, end, r);
      }
    }
  }
  /* From K the path runs upwards: k = K + i (c + t). */
  const double last = of->panel[of->panels - 1].end;
  double begin = 0, end = 0.5 * fmin(last, 1 / r);
  for (size_t i = 0; i < DOUBLINGS && begin * r < 45; i++) {
    for (size_t node = 0; node < rule.n; node++) {
      const double t = begin + (end - begin) * rule.x[node];
      const double complex k = CMPLX(last, of->shift + t);
      sum += (end - begin) * rule.weight[node] *
             creal(CMPLX(0, 1) * weighted(beyond(at, CMPLX(last, of->shift), k), k, r));
    }
    begin = end;
    end *= 2;
  }
  return sum / (2 * FN_PI);
}

static double reduced_single(const transport_anisotropic *of, const struct grid *grid, size_t eta,
                             double r) {
  const double unit = grid->scaled.unit;
  return grid->scaled.single * transport_single_at(&of->single[eta], r / unit).r / (unit * unit);
}

double transport_anisotropic_single_at(const transport_anisotropic *solution, size_t eta,
                                       double r) {
  return reduced_single(solution, &solution->grid[0], eta, r);
}

static double value_at(const transport_anisotropic *of, const struct grid *grid, size_t eta,
                       double r) {
  const double unit = grid->scaled.unit;
  return reduced_single(of, grid, eta, r) + multiple_at(grid, eta, r / unit) / (unit * unit);
}

/* Near the source two grids share more of their errors: at 1152 values of 64 media (reference.csv, by the
 * finest grids) the normal ones were up to 6.7 times, and the quick ones up to 11 times as far off as
 * they differ from the next coarser ones. */
#define NEAR 0.3

/* The grids' difference changes its sign here and there as r grows. The error estimate is therefore
 * made from the largest relative difference at r and at its two neighbours. It is at least `floor`,
 * since the two grids share a part of their errors: comparisons with the solver for isotropic
 * scattering found up to a third of it. */
transport_number transport_anisotropic_at(const transport_anisotropic *solution, size_t eta,
                                          double r) {
  static const double neighbour[] = {1, 0.75, 1.3};
  assert(eta < solution->count && r >= 0);
  if (r == 0) {
    return (transport_number){INFINITY, INFINITY};
  }
  if (isinf(r)) {
    return (transport_number){0, 0};
  }
  if (solution->grids == 1) {
    return (transport_number){fmax(value_at(solution, &solution->grid[0], eta, r), 0), (double)NAN};
  }
  double value = 0, error = 0;
  for (size_t i = 0; i < sizeof neighbour / sizeof neighbour[0]; i++) {
    const double fine = value_at(solution, &solution->grid[0], eta, r * neighbour[i]);
    const double coarse = value_at(solution, &solution->grid[1], eta, r * neighbour[i]);
    value = i == 0 ? fmax(fine, 0) : value;
    error = fmax(error, fine > 0 ? fabs(1 - coarse / fine) : 1);
  }
  const struct grid_rules *by = solution->grid[0].rules;
  error = fmax(by->margin[r >= NEAR] * error, by->floor);
  return (transport_number){value, error * value};
}

transport_number transport_anisotropic_share_at(const transport_anisotropic *solution, size_t eta,
                                                size_t cone, double r) {
  const size_t part = solution->count * (1 + cone) + eta;
  assert(eta < solution->count && part < solution->parts && r > 0 && r < (double)INFINITY);
  double share[GRIDS] = {(double)NAN, (double)NAN};
  for (size_t i = 0; i < solution->grids; i++) {
    const struct grid *grid = &solution->grid[i];
    share[i] = value_at(solution, grid, part, r) / value_at(solution, grid, eta, r);
  }
  return (transport_number){share[0], fabs(share[0] - share[1])};
}

/* ---- totals --------------------------------------------------------------------------------- */

/* Moments of light that is scattered once are left out below this. */
#define MOMENT_LEAST 1e-13

/* Enters a value of grid i: the first grid's is the value, and the next one's difference from it is
 * the error. */
static void enter(transport_number *to, size_t i, double value) {
  *to = i == 0 ? (transport_number){value, 0}
               : (transport_number){to->value, fabs(to->value - value)};
}

/* Sets moment[] to the moments of the true phase function, except those that are negligible, and
 * returns their number. */
static size_t find_moments(const transport_phase *phase,
                           double moment[TRANSPORT_PHASE_MOMENTS_MAX]) {
  size_t count = 0;
  double power = 1;
  while (count < TRANSPORT_PHASE_MOMENTS_MAX &&
         (phase->moments > 0 ? count < phase->moments : fabs(power) > MOMENT_LEAST)) {
    moment[count] = phase->moments > 0 ? phase->moment[count] : power;
    power *= phase->g;
    count++;
  }
  return count;
}

core_fault transport_anisotropic_totals(transport_totals *totals, const core_isa *isa,
                                        double sigma_a_ratio, const transport_phase *phase,
                                        const double *etas, size_t count) {
  const core_fault fault = check(sigma_a_ratio, phase, etas, count);
  if (fault.field != NULL) {
    return fault;
  }
  static const struct {
    halfspace_rules rules;
    double moment_least;
    size_t moments_most;
  } by[GRIDS] = {{{0, 72, 3}, 1e-8, 250}, {{0, 56, 3}, 1e-7, 220}};
  double moment[TRANSPORT_PHASE_MOMENTS_MAX], once[TRANSPORT_ANISOTROPIC_ETAS_MAX];
  const size_t moments = find_moments(phase, moment);
  for (size_t eta = 0; eta < count; eta++) {
    once[eta] = transport_single_diffuse(etas[eta], moments, moment);
  }
  for (size_t i = 0; i < GRIDS; i++) {
    struct scaled scaled;
    truncate_phase(&scaled, sigma_a_ratio, phase, by[i].moment_least, by[i].moments_most);
    halfspace *expansion =
        transport_halfspace_new(isa, &by[i].rules, &scaled.medium, etas, count, NULL, 0);
    halfspace_exitance exitance[TRANSPORT_ANISOTROPIC_ETAS_MAX];
    double single[TRANSPORT_ANISOTROPIC_ETAS_MAX];
    const bool ok = expansion != NULL &&
                    transport_halfspace_solve(expansion, 0, scaled.kappa, exitance) &&
                    transport_halfspace_diffuse_single(expansion, single);
    transport_halfspace_free(expansion);
    if (!ok) {
      return memory_fault;
    }
    for (size_t eta = 0; eta < count; eta++) {
      single_rule rule;
      transport_single_rule(&rule, etas[eta], 1, SINGLE_STEP);
      weigh_single(&rule, phase);
      enter(&totals[eta].normal, i,
            creal(exitance[eta].all - exitance[eta].single) +
                scaled.single * transport_single_at(&rule, INFINITY).within);
      enter(&totals[eta].diffuse, i,
            creal(exitance[eta].diffuse) - single[eta] + scaled.single * once[eta]);
    }
  }
  return no_fault;
}
