/* Computes bounds on how a profile R(r) varies with distance, from samples of R.
 * core/gather/loops.h defines the bounded numbers g and c.
 *
 * At each edge d of a band of distances, a polynomial in s = (r / d)^2 - 1 interpolates R near d.
 * Its terms up to s^3 are the cubic polynomial p. Elsewhere g is (R - p) / s^4, evaluated at the
 * samples. */
#include "core/gather/bounds.h"

#include <float.h>
#include <math.h>

#include "core/lut/lut.h"

enum { NODES = 6, EDGES = GATHER_BANDS + 1 };

/* The index of the sample at the first edge, and the number of samples from one edge to the
 * next. */
enum {
  FIRST_SAMPLE = 2 << CORE_LUT_OCTAVE_SAMPLES_LOG2,
  SAMPLE_STRIDE = (1 << CORE_LUT_OCTAVE_SAMPLES_LOG2) / 16
};
_Static_assert(FIRST_SAMPLE + SAMPLE_STRIDE * (EDGES - 1) +
                       (1 << CORE_LUT_OCTAVE_SAMPLES_LOG2) * 7 / 8 <
                   CORE_LUT_SAMPLES,
               "7/4 of it");

/* Enlarges the bounds, because R is known only at the samples. */
#define MARGIN 1.05

/* Chebyshev's nodes cos((2 i + 1) pi / 12). Node 1 stands for a relative distance of
 * NODES_REACH. */
static const double nodes[NODES] = {0.96592582628906829,  0.70710678118654752,
                                    0.25881904510252076,  -0.25881904510252076,
                                    -0.70710678118654752, -0.96592582628906829};
#define NODES_REACH 0.125

typedef struct samples {
  double r[CORE_LUT_SAMPLES];
  double R[CORE_LUT_SAMPLES];
} samples;

static double finite_or_infinite(double value) {
  return value <= DBL_MAX ? value : (double)INFINITY;
}

/* Returns (r / d)^2 - 1 for the distance r of a sample. */
static double squared(const samples *of, size_t sample, double d) {
  const double off = (of->r[sample] - d) / d;
  return off * (2 + off);
}

/* Sets a[NODES] to the coefficients, in ascending powers of s = (r / d)^2 - 1, of the polynomial
 * through the samples nearest to Chebyshev's nodes. `at`: the index of the sample at d. */
static void interpolate(const samples *of, size_t at, double *a) {
  const double d = of->r[at];
  double s[NODES];
  for (size_t i = 0; i < NODES; i++) {
    const double r = d * (1 + nodes[i] * NODES_REACH);
    size_t sample = at;
    while (of->r[sample] < r) {
      sample++;
    }
    while (of->r[sample] > r) {
      sample--;
    }
    s[i] = squared(of, sample, d);
    a[i] = of->R[sample];
  }
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
}

/* Widens the range [*least, *most] of g to include g at a sample. Skips samples closer to d than d
 * / GATHER_SPREADS_PER_ONE, where rounding would dominate. */
static void widen(const samples *of, size_t sample, double d, const double *a, double *least,
                  double *most) {
  const double s = squared(of, sample, d);
  if (fabs(of->r[sample] - d) * GATHER_SPREADS_PER_ONE >= d) {
    const double cubic = a[0] + s * (a[1] + s * (a[2] + s * a[3]));
    const double g = (of->R[sample] - cubic) / (s * s * s * s);
    *least = fmin(*least, g);
    *most = fmax(*most, g);
  }
}

/* Sets the bounds near an edge, for every spread. */
static void set_near(gather_bounds *bounds, const samples *of, size_t edge) {
  const size_t at = FIRST_SAMPLE + SAMPLE_STRIDE * edge;
  const double d = of->r[at];
  double a[NODES];
  interpolate(of, at, a);
  /* Converts from powers of s to lengths: g r^4 has the factor 1 / d^4, with a margin for
   * rounding. */
  const double to_quartic = (1 + 0x1p-20) / (d * d) / (d * d);
  double least = a[4], most = a[4];
  size_t low = at, high = at;
  for (size_t spread = 0; spread < GATHER_SPREADS; spread++) {
    const double off = (double)(spread + 1) / GATHER_SPREADS_PER_ONE;
    while (of->r[low] > d * (1 - off)) {
      widen(of, --low, d, a, &least, &most);
    }
    while (of->r[high] < d * (1 + off)) {
      widen(of, ++high, d, a, &least, &most);
    }
    const double largest = fmax(fabs(least), fabs(most));
    const double same = least > 0 ? least : most < 0 ? -most : 0;
    gather_near *near = &bounds->near[spread];
    near->cubic[edge] = finite_or_infinite(MARGIN * fabs(a[3]) * to_quartic / d);
    near->same[edge] = same / MARGIN * to_quartic;
    near->range[edge] = finite_or_infinite(
        (MARGIN * (same > 0 ? largest : most - least) - same / MARGIN) * to_quartic);
  }
}

static void set_tops(gather_bounds *bounds, const samples *of, double floor) {
  double most = 0;
  for (size_t i = EDGES; i-- > 0;) {
    bounds->R[i] = of->R[FIRST_SAMPLE + SAMPLE_STRIDE * i];
    most = fmax(most, bounds->R[i] * (1 + 0x1p-10));
    bounds->top[i] = most > floor ? most : 0;
  }
  bounds->zero = fmax(most, of->R[CORE_LUT_SAMPLES - 1] * (1 + 0x1p-10));
}

void gather_bounds_prepare(gather_bounds *bounds, const core_profile *profile) {
  samples of;
  core_lut_samples(profile, of.r, of.R);
  bounds->least_mm = of.r[FIRST_SAMPLE];
  bounds->most_mm = of.r[FIRST_SAMPLE + SAMPLE_STRIDE * GATHER_BANDS];
  uint64_t bits;
  memcpy(&bits, &bounds->least_mm, sizeof bits);
  bounds->first = (int64_t)(bits >> 48);
  /* Single precision may lose R up to this value by underflow. */
  set_tops(bounds, &of, profile->evaluator != CORE_EVALUATOR_F64 ? 16 * 0x1p-149 : 0);
  memset(bounds->near, 0, sizeof bounds->near);
  for (size_t i = 0; i < EDGES; i++) {
    set_near(bounds, &of, i);
  }
}
