/* X is interpolated by Chebyshev polynomials on panels in s, which double in width up to K. Beyond,
 *
 *   X = (far + (b1 ln k + c1) / k + (b2 ln k + c2) / k^2) / k^2,
 *
 * where `far` is known from light that is scattered twice close to the source, and b and c are
 * fitted. There the path turns upwards, where H0 decays. What is left at K, where both meet, goes on as
 * k^-5 and k^-6, the next powers: a step there would be a wave in r of the wavenumber K, which counts
 * where R is small (on the finest grids it was 3e-3 of an R of 1e-12).
 */
#include "core/transport/exitance.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/transport/bessel.h"
#include "core/transport/dense.h"
#include "core/transport/functions.h"
#include "core/transport/gauss.h"

/* The tail is fitted to wavenumbers above this part of K. */
#define TAIL_FROM 0.3

enum { TAIL_TERMS = EXITANCE_TAIL_TERMS };

/* ---- where it is known ---------------------------------------------------------------------- */

static double last_of(const exitance_grid *of) {
  return of->tier_end[EXITANCE_TIERS - 1];
}

void transport_exitance_place(exitance_grid *to, const core_isa *isa, double kappa, double share,
                              size_t nodes, const double tier_end[EXITANCE_TIERS]) {
  assert(nodes <= EXITANCE_NODES_MAX && share >= 0 && share < 1);
  *to = (exitance_grid){.isa = isa, .shift = share * kappa, .nodes = nodes};
  memcpy(to->tier_end, tier_end, sizeof to->tier_end);
  const double last = last_of(to);
  double begin = 0, end = fmin(last / 4, (1 - share) * kappa);
  while (begin < last) {
    assert(to->panels < EXITANCE_PANELS_MAX);
    to->panel[to->panels++] = (exitance_panel){begin, end};
    begin = end;
    end = 2 * end > 0.7 * last ? last : 2 * end;
  }
}

/* Returns s of a Chebyshev node. */
static double node_of(const exitance_grid *of, size_t panel, size_t i) {
  double sine, cosine;
  fn_sincos(FN_PI * ((double)i + 0.5) / (double)of->nodes, &sine, &cosine);
  const exitance_panel *at = &of->panel[panel];
  return 0.5 * (at->begin + at->end) - 0.5 * (at->end - at->begin) * cosine;
}

/* Replaces values at the nodes by the terms of a Chebyshev series. */
static void find_terms(const exitance_grid *of, double complex *values) {
  const size_t n = of->nodes;
  double complex term[EXITANCE_NODES_MAX];
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

static double complex series_at(const exitance_grid *of, const exitance_series *at, size_t panel,
                                double s) {
  const exitance_panel *p = &of->panel[panel];
  const double x = (2 * s - p->begin - p->end) / (p->end - p->begin);
  double complex one = 0, two = 0;
  for (size_t j = of->nodes; j-- > 1;) {
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
static bool fit_tail(const exitance_grid *of, exitance_series *at, const double complex *values) {
  const size_t nodes = of->nodes;
  const double last = last_of(of);
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

static double complex tail_at(const exitance_series *at, double complex k) {
  const double complex inverse = fn_inverse(k);
  double complex terms[TAIL_TERMS], sum = at->far * inverse * inverse;
  tail_terms(k, terms);
  for (size_t i = 0; i < TAIL_TERMS; i++) {
    sum += at->tail[i] * terms[i];
  }
  return sum;
}

/* Returns the derivative of the tail by k. */
static double complex tail_slope(const exitance_series *at, double complex k) {
  const double complex inverse = fn_inverse(k), logarithm = fn_clog(k);
  const double complex inverse3 = inverse * inverse * inverse;
  return inverse3 * (-2 * at->far +
                     inverse * (at->tail[0] * (1 - 3 * logarithm) - 3 * at->tail[1] +
                                inverse * (at->tail[2] * (1 - 4 * logarithm) - 4 * at->tail[3])));
}

/* Sets what is left at K, the end of the last panel, from the series there. */
static void join_tail(const exitance_grid *of, exitance_series *at) {
  const exitance_panel *last = &of->panel[of->panels - 1];
  const double complex k = CMPLX(last->end, of->shift), *term = at->term[of->panels - 1];
  double complex value = 0, slope = 0;
  for (size_t j = 0; j < of->nodes; j++) {
    value += term[j];
    slope += (double)(j * j) * term[j];
  }
  at->step = value - tail_at(at, k);
  at->bend = k * (slope * 2 / (last->end - last->begin) - tail_slope(at, k)) + 5 * at->step;
}

/* Returns X on the way upwards from K. */
static double complex beyond(const exitance_series *at, double complex k_last, double complex k) {
  const double complex q = k_last * fn_inverse(k), q2 = q * q;
  return tail_at(at, k) + q2 * q2 * q * (at->step + at->bend * (1 - q));
}

double complex transport_exitance_wavenumber(const exitance_grid *of, size_t node) {
  return CMPLX(node_of(of, node / of->nodes, node % of->nodes), of->shift);
}

size_t transport_exitance_end(const exitance_grid *of, size_t tier) {
  const size_t nodes = of->panels * of->nodes;
  size_t node = tier + 1 < EXITANCE_TIERS ? 0 : nodes;
  while (node < nodes && !(fn_abs(transport_exitance_wavenumber(of, node)) > of->tier_end[tier])) {
    node++;
  }
  return node;
}

/* Errors of two tiers differ, so that X would have a small step where a tier ends, and R a wave of that
 * wavenumber: for g = 0.95, sigma_a 50 sigma_s' and eta 2.2 it is 1e-3 of R = 1e-10 on the finest grids.
 * The step is fitted together with a polynomial in ln s through k^2 X at the nodes on both sides, and
 * added to the values of the lower tiers in proportion to k^4, as their errors grow with k. Returns false
 * if the equations are singular. */
static bool join_tier(const exitance_grid *of, size_t tier, double complex *values) {
  enum { SIDE = 8, POLYNOMIALS = 9, UNKNOWNS = POLYNOMIALS + 1 };
  const size_t end = transport_exitance_end(of, tier);
  if (end < SIDE || end + SIDE > of->panels * of->nodes) {
    return true;
  }
  const double first = fn_log(creal(transport_exitance_wavenumber(of, end - SIDE)));
  const double last = fn_log(creal(transport_exitance_wavenumber(of, end + SIDE - 1)));
  const double end2 = fn_norm2(transport_exitance_wavenumber(of, end));
  struct equations equations;
  begin_equations(&equations, of->isa, UNKNOWNS);
  for (size_t node = end - SIDE; node < end + SIDE; node++) {
    const double complex k = transport_exitance_wavenumber(of, node);
    const double k2 = fn_norm2(k), z = 2 * (fn_log(creal(k)) - first) / (last - first) - 1;
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
    const double share = fn_norm2(transport_exitance_wavenumber(of, node)) / end2;
    values[node] += share * share * CMPLX(step[0], step[1]);
  }
  return true;
}

bool transport_exitance_make(exitance_series *to, const exitance_grid *of, double far,
                             double complex *values) {
  bool ok = true;
  for (size_t tier = EXITANCE_TIERS - 1; tier-- > 0 && ok;) {
    ok = join_tier(of, tier, values);
  }
  to->far = far;
  if (!ok || !fit_tail(of, to, values)) {
    return false;
  }
  for (size_t panel = 0; panel < of->panels; panel++) {
    memcpy(to->term[panel], values + panel * of->nodes, of->nodes * sizeof *values);
    find_terms(of, to->term[panel]);
  }
  join_tail(of, to);
  return true;
}

/* ---- the way back --------------------------------------------------------------------------- */

enum { RULE_NODES = 12 };

/* Returns X H0(kr) k, with H0(kr) = -2 i / pi K0(-i k r). */
static double complex weighted(double complex exitance, double complex k, double r) {
  return exitance * k * CMPLX(0, -2 / FN_PI) * transport_bessel_k(CMPLX(0, -r) * k).k0;
}

/* Returns the integral over s of one interval of a panel. */
static double interval(const exitance_grid *of, const exitance_series *at, const gauss_rule *rule,
                       size_t panel, double begin, double end, double r) {
  double sum = 0;
  for (size_t i = 0; i < rule->n; i++) {
    const double s = begin + (end - begin) * rule->x[i];
    sum += rule->weight[i] * creal(weighted(series_at(of, at, panel, s), CMPLX(s, of->shift), r));
  }
  return sum * (end - begin);
}

double transport_exitance_at(const exitance_series *at, const exitance_grid *of, double r) {
  enum { HALVINGS = 12, DOUBLINGS = 200 };
  gauss_rule rule;
  transport_gauss(&rule, RULE_NODES);
  double sum = 0;
  for (size_t panel = 0; panel < of->panels; panel++) {
    const exitance_panel *p = &of->panel[panel];
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
