/* Finds bounds from a profile's values. core/MODELS.md says what they bound.
 *
 * At each edge of a band, a polynomial of the squared distance interpolates R close by. Its first
 * four terms are the cubic polynomial, from which R is off by g (s - r^2)^4 at further distances.
 */
#include "core/gather/bounds.h"

#include <float.h>
#include <math.h>

enum {
  NODES = 6,
  SIDE = 2 * GATHER_SPREADS - 1, /* distances on either side */
  SAMPLES = NODES + 2 * SIDE,
  EDGES = GATHER_BANDS + 1
};

/* What the values between the samples may add, relative. */
#define MARGIN 1.05

/* cos((2 i + 1) pi / 12) */
static const double nodes[NODES] = {0.96592582628906829,  0.70710678118654752,
                                    0.25881904510252076,  -0.25881904510252076,
                                    -0.70710678118654752, -0.96592582628906829};

static void evaluate(const core_profile *profile, size_t n, const double *r, double *R) {
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, CORE_QUANTITY_R, n, r, R);
    return;
  }
  for (size_t i = 0; i < n; i++) {
    const float narrow = (float)r[i];
    float value;
    core_eval_f32(profile, CORE_QUANTITY_R, 1, &narrow, &value);
    R[i] = (double)value;
  }
}

static double edge(const gather_bounds *bounds, size_t i) {
  const uint64_t bits = (uint64_t)(bounds->first + (int64_t)i) << 48;
  double value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

static double finite_or_infinite(double value) {
  return value <= DBL_MAX ? value : (double)INFINITY;
}

/* The relative differences of the samples from the distance of an edge. */
static double difference(size_t sample) {
  if (sample < NODES) {
    return nodes[sample] / GATHER_SPREADS_PER_ONE;
  }
  const size_t i = (sample - NODES) / 2 + 2;
  return ((sample - NODES) % 2 == 0 ? 0.5 : -0.5) * (double)i / GATHER_SPREADS_PER_ONE;
}

/* Sets the bounds at the edge i. */
static void set_near(gather_bounds *bounds, const core_profile *profile, size_t edge_index) {
  const double d = edge(bounds, edge_index);
  double r[SAMPLES], R[SAMPLES], s[SAMPLES], a[NODES];
  for (size_t i = 0; i < SAMPLES; i++) {
    const double off = difference(i);
    r[i] = d * (1 + off);
    s[i] = off * (2 + off); /* over d^2, less 1 */
  }
  evaluate(profile, SAMPLES, r, R);
  memcpy(a, R, sizeof a);
  for (size_t order = 1; order < NODES; order++) { /* Newton's form */
    for (size_t i = NODES - 1; i >= order; i--) {
      a[i] = (a[i] - a[i - 1]) / (s[i] - s[i - order]);
    }
  }
  for (size_t first = NODES - 1; first-- > 0;) { /* powers of s */
    for (size_t i = first; i < NODES - 1; i++) {
      a[i] -= a[i + 1] * s[first];
    }
  }
  /* From d^8 to d^4, and from d^6 to d, rounded up */
  const double to_quartic = (1 + 0x1p-20) / (d * d) / (d * d);
  double least = a[4], most = a[4];
  for (size_t i = NODES; i < SAMPLES; i++) {
    const double cubic = a[0] + s[i] * (a[1] + s[i] * (a[2] + s[i] * a[3]));
    const double g = (R[i] - cubic) / (s[i] * s[i] * s[i] * s[i]);
    least = fmin(least, g);
    most = fmax(most, g);
    const size_t spread = ((i - NODES) / 2 + 1) / 2;
    const double largest = fmax(fabs(least), fabs(most));
    const double same = least > 0 ? least : most < 0 ? -most : 0;
    gather_near *near = &bounds->near[spread];
    near->cubic[edge_index] = finite_or_infinite(MARGIN * fabs(a[3]) * to_quartic / d);
    near->same[edge_index] = same / MARGIN * to_quartic;
    near->range[edge_index] = finite_or_infinite(
        (MARGIN * (same > 0 ? largest : most - least) - same / MARGIN) * to_quartic);
  }
}

static void set_tops(gather_bounds *bounds, const core_profile *profile, double floor) {
  for (size_t i = 0; i < EDGES; i++) {
    const double d = edge(bounds, i);
    evaluate(profile, 1, &d, &bounds->R[i]);
  }
  double most = 0;
  for (size_t i = EDGES; i-- > 0;) {
    most = fmax(most, bounds->R[i] * (1 + 0x1p-10));
    bounds->top[i] = most > floor ? most : 0;
  }
  const double none = 0;
  double zero;
  evaluate(profile, 1, &none, &zero);
  bounds->zero = fmax(most, zero * (1 + 0x1p-10));
}

bool gather_bounds_prepare(gather_bounds *bounds, const core_profile *profile) {
  const bool narrow = profile->evaluator != CORE_EVALUATOR_F64;
  if (profile->evaluator == CORE_EVALUATOR_LUT) {
    profile = profile->source;
    if (profile == NULL) {
      return false;
    }
  }
  int exponent;
  frexp(profile->scale_mm, &exponent);
  bounds->first = (int64_t)(1023 + exponent - 13) << 4;
  bounds->least_mm = edge(bounds, 0);
  bounds->most_mm = edge(bounds, GATHER_BANDS);
  /* R that single precision loses by underflow */
  set_tops(bounds, profile, narrow ? 16 * 0x1p-149 : 0);
  memset(bounds->near, 0, sizeof bounds->near);
  for (size_t i = 0; i < EDGES; i++) {
    set_near(bounds, profile, i);
  }
  return true;
}
