/* X is interpolated by Chebyshev polynomials on panels, straight pieces of a path in the complex
 * plane that double in width up to K. Beyond, with q = sqrt(1 + k^2), the scale of light that is
 * not scattered,
 *
 *   X = (far + (b1 ln(1 + q) + c1) / q + (b2 ln(1 + q) + c2) / q^2) / q^2,
 *
 * where `far` is known from light that is scattered twice close to the source, and b and c are
 * fitted. If light is scattered back in a narrow peak, far / k^2 holds from far above K on, because what
 * comes back nearly along the beam falls as powers of d = p / (p + k), p being `peak`; then
 *
 *   X = far / q^2 + c1 d^2 / q + c2 d / q^2 + c3 d^3 + c4 / q^3.
 *
 * There the path turns upwards, where H0 decays. What is left at K, where both meet, goes
 * on as k^-5 and k^-6: a step there would be a wave in r of the wavenumber K, which counts where R
 * is small. */
#include "core/solver/exitance.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/solver/dense.h"
#include "core/transport/bessel.h"
#include "core/transport/functions.h"
#include "core/transport/gauss.h"

/* The tail is fitted to wavenumbers above this share of K. */
#define TAIL_FROM 0.4

/* The distance, as a share of the last panel, over which a slope is computed. */
#define NEARBY 1e-3

/* Im k to which the path rises: it damps large wavenumbers, except for r near the source. */
#define RISE 0.5
#define RISE_MOST 0.35

/* The first panel's width if nothing is absorbed, when X has no scale below 1. */
#define WIDTH_WHITE 0.03

enum { TAIL_TERMS = EXITANCE_TAIL_TERMS };

/* ---- where it is known ---------------------------------------------------------------------- */

static double last_of(const exitance_grid *of) {
  return of->tier_end[EXITANCE_TIERS - 1];
}

void solver_exitance_place(exitance_grid *to, const core_isa *isa, double kappa, double share,
                           double scale, size_t nodes, const double tier_end[EXITANCE_TIERS]) {
  assert(nodes <= EXITANCE_NODES_MAX && share >= 0 && share < 1);
  const double low = share * kappa, high = fmax(low, RISE_MOST * scale);
  *to = (exitance_grid){.isa = isa, .nodes = nodes, .point = {CMPLX(0, low)}};
  memcpy(to->tier_end, tier_end, sizeof to->tier_end);
  const double last = last_of(to);
  const double width = kappa > 0 ? fmin(last / 4, (1 - share) * kappa) : WIDTH_WHITE * scale;
  double end = fmax(width, ldexp(last, EXITANCE_PANELS_SPARE - EXITANCE_PANELS_MAX));
  while (creal(to->point[to->panels]) < last) {
    assert(to->panels < EXITANCE_PANELS_MAX);
    to->point[++to->panels] = CMPLX(end, fmin(low + RISE * end, high));
    end = 2 * end > 0.7 * last ? last : 2 * end;
  }
}

double complex solver_exitance_wavenumber(const exitance_grid *of, size_t node) {
  double sine, cosine;
  fn_sincos(FN_PI * ((double)(node % of->nodes) + 0.5) / (double)of->nodes, &sine, &cosine);
  const double complex *at = &of->point[node / of->nodes];
  return 0.5 * (at[0] + at[1]) - 0.5 * (at[1] - at[0]) * cosine;
}

/* Replaces values at Chebyshev nodes by the coefficients of the Chebyshev series. */
static void find_terms(const exitance_grid *of, double complex *values) {
  const size_t n = of->nodes;
  double complex term[EXITANCE_NODES_MAX];
  for (size_t j = 0; j < n; j++) {
    term[j] = 0;
    for (size_t i = 0; i < n; i++) {
      double sine, cosine;
      fn_sincos(FN_PI * (double)j * ((double)i + 0.5) / (double)n, &sine, &cosine);
      /* nodes ascend: x_i = -cos */
      term[j] += values[i] * (j % 2 == 0 ? cosine : -cosine);
    }
    term[j] *= (j == 0 ? 1.0 : 2.0) / (double)n;
  }
  memcpy(values, term, n * sizeof *values);
}

/* Returns X at the position x in a panel, 0 to 1, or beside it. */
static double complex series_at(const exitance_grid *of, const exitance_series *at, size_t panel,
                                double complex x) {
  double complex one = 0, two = 0;
  for (size_t j = of->nodes; j-- > 1;) {
    const double complex next = at->term[panel][j] + (4 * x - 2) * one - two;
    two = one;
    one = next;
  }
  return at->term[panel][0] + (2 * x - 1) * one - two;
}

/* Sets terms[] to the factors of the tail's coefficients at k, and returns 1 / q^2. */
static double complex tail_terms(double peak, double complex k, double complex *terms) {
  const double complex q = fn_csqrt(1 + k * k), inverse = fn_inverse(q);
  if (peak > 0) {
    const double complex d = peak * fn_inverse(peak + k);
    terms[0] = inverse * d * d;
    terms[1] = inverse * inverse * d;
    terms[2] = d * d * d;
    terms[3] = inverse * inverse * inverse;
    return inverse * inverse;
  }
  terms[1] = inverse * inverse * inverse;
  terms[0] = fn_clog(1 + q) * terms[1];
  terms[2] = terms[0] * inverse;
  terms[3] = terms[1] * inverse;
  return inverse * inverse;
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
  to->normal = solver_dense_at(isa, &next, unknowns, unknowns, false);
  to->right = solver_dense_at(isa, &next, unknowns, RIGHT_SIDES, false);
}

/* Adds an equation: the sum of terms[i] times unknown i, for each right side. */
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

/* Returns unknown i for each right side. The equations have been solved. */
static const double *unknown(const struct equations *of, size_t i) {
  return of->right.re + i * of->right.stride;
}

/* Fits the tail by least squares to X at nodes above TAIL_FROM K. Returns false if the normal
 * equations are singular. */
static bool fit_tail(const exitance_grid *of, exitance_series *at, const double complex *values) {
  struct equations equations;
  begin_equations(&equations, of->isa, TAIL_TERMS);
  for (size_t i = 0; i < of->panels * of->nodes; i++) {
    const double complex k = solver_exitance_wavenumber(of, i);
    if (creal(k) < TAIL_FROM * last_of(of)) {
      continue;
    }
    double complex terms[TAIL_TERMS];
    const double complex rest = values[i] - at->far * tail_terms(at->peak, k, terms);
    const double k2 = fn_norm2(k);
    double re[TAIL_TERMS], im[TAIL_TERMS];
    for (size_t j = 0; j < TAIL_TERMS; j++) {
      re[j] = creal(terms[j]);
      im[j] = cimag(terms[j]);
    }
    add_equation(&equations, k2 * k2 * k2, re, (double[]){creal(rest), 0});
    add_equation(&equations, k2 * k2 * k2, im, (double[]){cimag(rest), 0});
  }
  const bool ok = solver_dense_solve(&equations.normal, &equations.right);
  for (size_t i = 0; i < TAIL_TERMS && ok; i++) {
    at->tail[i] = unknown(&equations, i)[0];
  }
  return ok;
}

/* Returns X at a wavenumber beyond K. */
static double complex beyond(const exitance_series *at, double complex last, double complex k) {
  const double complex ratio = last * fn_inverse(k), ratio2 = ratio * ratio;
  double complex terms[TAIL_TERMS], sum = at->far * tail_terms(at->peak, k, terms);
  for (size_t i = 0; i < TAIL_TERMS; i++) {
    sum += at->tail[i] * terms[i];
  }
  return sum + ratio2 * ratio2 * ratio * (at->step + at->bend * (1 - ratio));
}

size_t solver_exitance_end(const exitance_grid *of, size_t tier) {
  size_t panel = tier + 1 < EXITANCE_TIERS ? 0 : of->panels;
  while (panel < of->panels &&
         fn_abs(0.5 * (of->point[panel] + of->point[panel + 1])) <= of->tier_end[tier]) {
    panel++;
  }
  return panel * of->nodes;
}

static void set_terms(exitance_series *to, const exitance_grid *of, const double complex *values) {
  for (size_t panel = 0; panel < of->panels; panel++) {
    memcpy(to->term[panel], values + panel * of->nodes, of->nodes * sizeof *values);
    find_terms(of, to->term[panel]);
  }
}

bool solver_exitance_make(exitance_series *to, const exitance_grid *of, double far, double peak,
                          const double complex *smooth, const double complex *values) {
  *to = (exitance_series){.far = far, .peak = peak};
  if (!fit_tail(of, to, smooth)) {
    return false;
  }
  set_terms(to, of, smooth);
  const double complex last = of->point[of->panels];
  const double complex before = last - NEARBY * (last - of->point[of->panels - 1]);
  const double complex end = beyond(to, last, last);
  to->step = series_at(of, to, of->panels - 1, 1) - end;
  to->bend = series_at(of, to, of->panels - 1, 1 - NEARBY) - beyond(to, last, before);
  to->bend *= last * fn_inverse(before - last);
  if (values != smooth) {
    set_terms(to, of, values);
    to->step = series_at(of, to, of->panels - 1, 1) - end;
  }
  return true;
}

/* ---- the way back --------------------------------------------------------------------------- */

enum { RULE_NODES = 12 };

/* Contributions that have decayed by more than e to this power are neglected. */
#define DECAYS_MOST 45

/* A panel with more periods of H0 than this is gone around. The first one has fewer, or all of it has
 * decayed. */
#define PERIODS_MOST 512

/* Returns X H0(kr) k, with H0(kr) = -2 i / pi K0(-i k r). */
static double complex weighted(double complex exitance, double complex k, double r) {
  return exitance * k * CMPLX(0, -2 / FN_PI) * transport_bessel_k(CMPLX(0, -r) * k).k0;
}

/* Adds the integral over one interval of a panel, whose ends are positions in it, 0 to 1, and that
 * of the integrand's modulus. */
static void add_interval(double *sum, double *size, const exitance_grid *of,
                         const exitance_series *at, const gauss_rule *rule, size_t panel,
                         double begin, double end, double r) {
  const double complex first = of->point[panel], way = of->point[panel + 1] - first;
  double complex part = 0;
  double modulus = 0;
  for (size_t i = 0; i < rule->n; i++) {
    const double x = begin + (end - begin) * rule->x[i];
    const double complex here = weighted(series_at(of, at, panel, x), first + x * way, r);
    part += rule->weight[i] * here;
    modulus += rule->weight[i] * fn_abs(here);
  }
  *sum += creal(part * way) * (end - begin);
  *size += modulus * fn_abs(way) * (end - begin) / (2 * FN_PI);
}

/* Returns the same integral as of all intervals of a panel, on a path that goes up from its begin, where
 * H0 decays, and comes down to its end: there its series goes on. */
static double around_panel(const exitance_grid *of, const exitance_series *at,
                           const gauss_rule *rule, size_t panel, double r) {
  const double complex way = of->point[panel + 1] - of->point[panel];
  double sum = 0;
  for (size_t side = 0; side < 2; side++) {
    const double complex corner = of->point[panel + side];
    for (double begin = 0, end = 0.5 / r; begin * r < DECAYS_MOST; begin = end, end *= 2) {
      for (size_t i = 0; i < rule->n; i++) {
        const double complex up = CMPLX(0, begin + (end - begin) * rule->x[i]);
        const double complex X = series_at(of, at, panel, (double)side + up * fn_inverse(way));
        const double part = creal(CMPLX(0, 1) * weighted(X, corner + up, r));
        sum += (side == 0 ? part : -part) * (end - begin) * rule->weight[i];
      }
    }
  }
  return sum;
}

double solver_exitance_at(const exitance_series *at, const exitance_grid *of, double r,
                          double *size) {
  enum { HALVINGS = 12, DOUBLINGS = 200 };
  gauss_rule rule;
  transport_gauss(&rule, RULE_NODES);
  double sum = 0;
  *size = 0;
  for (size_t panel = 0; panel < of->panels; panel++) {
    const double complex from = of->point[panel], way = of->point[panel + 1] - from;
    if (r * cimag(from - of->point[0]) > DECAYS_MOST) {
      return sum / (2 * FN_PI);
    }
    const double periods = ceil(fn_abs(way) * r / (2 * FN_PI));
    if (periods > PERIODS_MOST) {
      double modulus = 0;
      add_interval(&modulus, size, of, at, &rule, panel, 0, 1, r);
      sum += around_panel(of, at, &rule, panel, r);
      continue;
    }
    const size_t parts = periods < 1 ? 1 : (size_t)periods;
    for (size_t i = 0; i < parts; i++) {
      double begin = (double)i / (double)parts, end = (double)(i + 1) / (double)parts;
      /* H0(kr) is not smooth at k = 0, so the first interval is halved repeatedly towards 0. */
      for (size_t halving = 0; panel + i == 0 && halving < HALVINGS; halving++) {
        add_interval(&sum, size, of, at, &rule, panel, end / 2, end, r);
        end /= 2;
      }
      add_interval(&sum, size, of, at, &rule, panel, begin, end, r);
    }
  }
  /* Beyond K the path is parallel to the imaginary axis. */
  const double complex last = of->point[of->panels];
  double begin = 0, end = 0.5 * fmin(last_of(of), 1 / r);
  for (size_t i = 0; i < DOUBLINGS && begin * r < DECAYS_MOST; i++) {
    for (size_t node = 0; node < rule.n; node++) {
      const double complex k = last + CMPLX(0, begin + (end - begin) * rule.x[node]);
      sum += (end - begin) * rule.weight[node] *
             creal(CMPLX(0, 1) * weighted(beyond(at, last, k), k, r));
    }
    begin = end;
    end *= 2;
  }
  return sum / (2 * FN_PI);
}
