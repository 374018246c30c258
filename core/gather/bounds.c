/* Finds bounds from a profile's values. core/MODELS.md says what they bound.
 *
 * For an interval of squared distances, the cubic polynomial that interpolates R at Chebyshev's
 * points is compared with R at further points.
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
  double a[NODES]; /* Chebyshev coefficients of the cubic polynomial */
  for (int j = 0; j < NODES; j++) {
    a[j] = 0;
    for (int i = 0; i < NODES; i++) {
      const double x = nodes[i];
      const double value = j == 0 ? 1 : j == 1 ? x : j == 2 ? 2 * x * x - 1 : x * (4 * x * x - 3);
      a[j] += (j == 0 ? 0.25 : 0.5) * value * R[i];
    }
  }
  double off = 0;
  for (int i = 0; i < CHECKS; i++) {
    const double x = checks[i];
    const double cubic = a[0] + a[1] * x + a[2] * (2 * x * x - 1) + a[3] * x * (4 * x * x - 3);
    off = fmax(off, fabs(cubic - R[NODES + i]));
  }
  const double half = 2 * d * d * ratio; /* of the interval of squared distances */
  return (gather_bound){.quartic = 2 * off / (ratio * ratio * ratio * ratio),
                        .cubic = fabs(4 * a[3]) / (half * half * half)};
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
      const double middle = 1 + ratios[k] * ratios[k], half = 2 * ratios[k];
      for (size_t j = 0; j < SAMPLES; j++) {
        r[k * SAMPLES + j] = d * sqrt(middle + half * (j < NODES ? nodes[j] : checks[j - NODES]));
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
