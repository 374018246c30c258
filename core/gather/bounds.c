/* Finds bounds from a profile's values. core/MODELS.md says what they bound.
 *
 * For an interval of distances, the cubic polynomial of the squared distance that interpolates R at
 * Chebyshev's points of the distance is compared with R at further points. Chebyshev's points of the
 * squared distance would be nearly twice as far off where the interval is wide.
 */
#include "core/gather/bounds.h"

#include <float.h>
#include <math.h>

enum { NODES = 4, CHECKS = 9, SAMPLES = NODES + CHECKS, EDGES = GATHER_BANDS + 1 };

/* The interval about a distance d is (1 - ratio) d to (1 + ratio) d. */
static const double ratios[GATHER_SPREADS + 1] = {0.0625, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75};

/* What the values between the samples may add, relative. */
#define MARGIN 1.3

/* cos((2 i + 1) pi / 8), and the places between and beside them. */
static const double nodes[NODES] = {0.92387953251128674, 0.38268343236508977, -0.38268343236508977,
                                    -0.92387953251128674};
static const double checks[CHECKS] = {
    1, 0.97, 0.70710678118654752, 0.55, 0, -0.55, -0.70710678118654752, -0.97, -1};

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

/* The bounds for one distance and ratio. R: at the nodes and checks. */
static gather_bound bound_of(double d, double ratio, const double *R) {
  /* Newton's form, in squared distances over d^2 */
  double s[SAMPLES], a[NODES];
  for (int i = 0; i < SAMPLES; i++) {
    const double relative = 1 + ratio * (i < NODES ? nodes[i] : checks[i - NODES]);
    s[i] = relative * relative;
  }
  for (int i = 0; i < NODES; i++) {
    a[i] = R[i];
  }
  for (int order = 1; order < NODES; order++) {
    for (int i = NODES - 1; i >= order; i--) {
      a[i] = (a[i] - a[i - 1]) / (s[i] - s[i - order]);
    }
  }
  double off = 0;
  for (int i = NODES; i < SAMPLES; i++) {
    const double cubic =
        a[0] + (s[i] - s[0]) * (a[1] + (s[i] - s[1]) * (a[2] + (s[i] - s[2]) * a[3]));
    off = fmax(off, fabs(cubic - R[i]));
  }
  return (gather_bound){.quartic = 2 * off / (ratio * ratio * ratio * ratio),
                        .cubic = fabs(a[3]) / (d * d * d) / (d * d * d)};
}

static double edge(const gather_bounds *bounds, size_t i) {
  const uint64_t bits = (uint64_t)(bounds->first + (int64_t)i) << 48;
  double value;
  memcpy(&value, &bits, sizeof value);
  return value;
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
  gather_bound before[GATHER_SPREADS + 1], after[GATHER_SPREADS + 1];
  for (size_t i = 0; i < EDGES; i++) {
    const double d = edge(bounds, i);
    double r[(GATHER_SPREADS + 1) * SAMPLES], R[(GATHER_SPREADS + 1) * SAMPLES];
    for (size_t k = 0; k <= GATHER_SPREADS; k++) {
      for (size_t j = 0; j < SAMPLES; j++) {
        r[k * SAMPLES + j] = d * (1 + ratios[k] * (j < NODES ? nodes[j] : checks[j - NODES]));
      }
    }
    evaluate(profile, (GATHER_SPREADS + 1) * SAMPLES, r, R);
    for (size_t k = 0; k <= GATHER_SPREADS; k++) {
      after[k] = bound_of(d, ratios[k], R + k * SAMPLES);
    }
    for (size_t k = 0; k < GATHER_SPREADS && i > 0; k++) {
      gather_bound *near = &bounds->near[i - 1][k];
      near->quartic = MARGIN * fmax(fmax(before[k].quartic, before[k + 1].quartic),
                                    fmax(after[k].quartic, after[k + 1].quartic));
      near->cubic = MARGIN * fmax(fmax(before[k].cubic, before[k + 1].cubic),
                                  fmax(after[k].cubic, after[k + 1].cubic));
    }
    memcpy(before, after, sizeof before);
  }
  return true;
}
