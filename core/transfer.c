/* The transfer function R(f) of models without a closed form: the Hankel transform of R(r),
 *
 *   R(f) = int_0^inf 2 pi r R(r) J0(k r) dr = 2 pi int r^2 R(r) J0(k r) d ln r,  k = 2 pi f
 *
 * by the trapezoidal rule in ln r. Its nodes are powers of 2^(1 / STEPS) whatever the frequency is,
 * so that all frequencies of a call share the values of R. The nodes resolve r^2 R, a smooth
 * function of ln r. They do not resolve J0, which oscillates ever faster. What they do not resolve
 * contributes nothing to the integral, and is filtered out of J0: this is a digital filter for
 * Hankel transforms (Johansen, Sorensen 1979, "Fast Hankel transforms"); core/filter.h holds it.
 *
 * R(f) is summed for frequencies where k, too, is a power of 2^(1 / STEPS), because J0 is then
 * needed at such powers only. In between it is interpolated in ln k.
 *
 * The error was measured against closed forms: less than 1e-9 of the albedo.
 */
#include <assert.h>
#include <limits.h>
#include <math.h>

#include "core/filter.h"
#include "core/kernels.h"
#include "core/paths.h"

#define CORE_REAL 64
#include "core/kernel.h"

#define PI 3.14159265358979323846
#define LN2 0.69314718055994530942
/* R(f) is the albedo where k times the profile's scale is below this. For the largest eta R(r)
 * reaches to 1e13 mean free paths. */
#define SLOWEST 1e-30
#define FASTEST 1e100 /* R(f) is 0 where k times the scale is above this */

enum {
  STEPS = CORE_FILTER_STEPS,
  WAVES = CORE_FILTER_WAVES,
  /* the sum begins this many steps below k r = 1 and below the profile's scale */
  NEAR = 38 * STEPS,
  /* number of steps by which it begins earlier, as long as energy is left there */
  NEARER = 8 * STEPS,
  NEAREST = 10, /* how often it may begin earlier */
  /* the largest number of steps from the first node to NEAR / k */
  ONES = 102 * STEPS + NEAREST * NEARER,
  POINTS = 16, /* points of the interpolation in ln k */
  LANES = 8,   /* partial sums */
  NODES = 4096,
  SUMS = 1024,
};

/* Returns 2^(i / STEPS). */
static double power(int i) {
  static const double roots[STEPS] = {
      1,
      1.0594630943592952646,
      1.1224620483093729814,
      1.1892071150027210667,
      1.2599210498948731648,
      1.3348398541700343648,
      1.4142135623730950488,
      1.4983070768766814988,
      1.5874010519681994748,
      1.6817928305074290861,
      1.7817974362806786095,
      1.8877486253633869932,
  };
  const int octave = i >= 0 ? i / STEPS : -((STEPS - 1 - i) / STEPS);
  return ldexp(roots[i - octave * STEPS], octave);
}

/* What the frequencies of a call share, to compute it once. It does not change any value. */
struct shared {
  const core_profile *profile;
  /* wave[i]: the filtered J0 at k r = 2^((i - ONES - NEAR) / STEPS) */
  double wave[ONES + NEAR + WAVES];
  double energy[NODES]; /* energy[i]: 2 pi h r^2 R at r = 2^((base + i) / STEPS), see is_faint() */
  int base;
  int first, end;   /* nodes from first to end - 1 have their energy */
  int least;        /* the first node at which R matters for small k */
  double sum[SUMS]; /* cache of R(f) at k = 2^(m / STEPS), at index m modulo SUMS */
  int sum_of[SUMS]; /* the m of each cached sum */
};

/* Returns the node below which energy is negligible. Single scattering has much of its energy close
 * to the source if g is near -1. */
static int first_node(const core_profile *profile) {
  int node = (int)floor(real_log(profile->scale_mm, 0) * (STEPS / LN2)) - NEAR;
  for (int i = 0; i < NEAREST; i++) {
    const double r = power(node);
    double cdf;
    core_run_kernel(profile, CORE_ELEMENTWISE_CDF, 1, &r, &cdf);
    if (cdf <= 1e-11) {
      break;
    }
    node -= NEARER;
  }
  return node;
}

static void begin_transform(struct shared *shared, const core_profile *profile) {
  shared->profile = profile;
  for (int i = 0; i < ONES + NEAR; i++) {
    shared->wave[i] = 1;
  }
  for (int i = 0; i < NEAR; i++) {
    const double t = power(i - NEAR), quarter = 0.25 * t * t;
    for (int n = 9; n > 0; n--) {
      shared->wave[ONES + i] = 1 - quarter / (n * n) * shared->wave[ONES + i];
    }
  }
  for (int i = 0; i < WAVES; i++) {
    shared->wave[ONES + NEAR + i] = core_filter[i];
  }
  for (int i = 0; i < SUMS; i++) {
    shared->sum_of[i] = INT_MIN;
  }
  shared->base = shared->first = shared->end = 0;
  shared->least = first_node(profile);
}

/* Returns whether R may have underflowed where its energy matters. The energy then comes from ln R
 * and is divided by the albedo. */
static bool is_faint(const core_profile *profile) {
  return profile->albedo < 1e-200;
}

static void fill_energies(struct shared *shared, int first, int end) {
  enum { CHUNK = 256 };
  const bool faint = is_faint(shared->profile);
  const double ln_albedo = real_log(real_max(shared->profile->albedo, 0x1p-1074) * 0x1p200, -200);
  double r[CHUNK], R[CHUNK];
  for (int done = first; done < end; done += CHUNK) {
    const int n = end - done < CHUNK ? end - done : CHUNK;
    for (int i = 0; i < n; i++) {
      r[i] = power(done + i);
    }
    core_run_kernel(shared->profile, faint ? CORE_ELEMENTWISE_LN_R : CORE_ELEMENTWISE_R, (size_t)n,
                    r, R);
    for (int i = 0; i < n; i++) {
      const double squared =
          faint ? real_exp_signed(R[i] + 2 * real_log(r[i], 0) - ln_albedo) : r[i] * R[i] * r[i];
      shared->energy[done + i - shared->base] = 2 * PI * LN2 / STEPS * squared;
    }
  }
}

/* Computes the energies of nodes first to end - 1, at most NODES. Discards others if there is no
 * room for all. */
static void cover(struct shared *shared, int first, int end) {
  const int low = first < shared->first ? first : shared->first;
  const int high = end > shared->end ? end : shared->end;
  if (shared->first == shared->end || low < shared->base || high > shared->base + NODES) {
    shared->base = first - (NODES - (end - first)) / 2;
    shared->first = first;
    shared->end = end;
    fill_energies(shared, first, end);
    return;
  }
  fill_energies(shared, low, shared->first);
  fill_energies(shared, shared->end, high);
  shared->first = low;
  shared->end = high;
}

/* Returns R(f) at k = 2^(m / STEPS). */
static double sum_at(struct shared *shared, int m) {
  const int at = (m % SUMS + SUMS) % SUMS;
  if (shared->sum_of[at] == m) {
    return shared->sum[at];
  }
  const int end = WAVES - m, least = shared->least < -NEAR - m ? shared->least : -NEAR - m;
  const int first = end - (end - least + LANES - 1) / LANES * LANES;
  assert(first + m >= -(ONES + NEAR));
  cover(shared, first, end);
  const double *energy = &shared->energy[first - shared->base];
  const double *wave = &shared->wave[first + m + ONES + NEAR];
  double lanes[LANES] = {0};
  for (int i = 0; i < end - first; i += LANES) {
    for (int lane = 0; lane < LANES; lane++) {
      lanes[lane] = fma(energy[i + lane], wave[i + lane], lanes[lane]);
    }
  }
  double sum = 0;
  for (int lane = 0; lane < LANES; lane++) {
    sum += lanes[lane];
  }
  shared->sum[at] = sum;
  shared->sum_of[at] = m;
  return sum;
}

/* Returns R(f) by Lagrange's polynomial through the POINTS nearest values. */
static double transform(struct shared *shared, double k) {
  const double place = real_log(k, 0) * (STEPS / LN2), start = floor(place) - (POINTS / 2 - 1);
  double value = 0;
  for (int i = 0; i < POINTS; i++) {
    double weight = 1;
    for (int j = 0; j < POINTS; j++) {
      weight *= j == i ? 1 : (place - start - j) / (i - j);
    }
    value = fma(weight, sum_at(shared, (int)start + i), value);
  }
  return value;
}

void core_transfer(const core_profile *profile, size_t n, const double *f, double *out) {
  struct shared shared;
  const double unit = is_faint(profile) ? profile->albedo : 1;
  begin_transform(&shared, profile);
  for (size_t i = 0; i < n; i++) {
    const double k = 2 * PI * f[i], scaled = k * profile->scale_mm;
    out[i] = scaled <= SLOWEST                         ? profile->albedo
             : scaled < FASTEST && profile->albedo > 0 ? real_max(transform(&shared, k), 0) * unit
                                                       : 0;
  }
}

static bool transforms(const core_profile *profile, unsigned wanted) {
  return (wanted & CORE_AT_FREQUENCIES) != 0 &&
         (profile->parts != NULL || profile->lut != NULL ||
          profile->kernels->f64->evaluate[CORE_ELEMENTWISE_TRANSFER] == NULL);
}

/* Evaluations of R for all frequencies of a call, of which modulated light takes one for each node and 64
 * frequencies. */
#define CALL_COST 1000.0

double core_radius_cost(const core_profile *profile, unsigned wanted) {
  const core_profile *derives =
      core_wants_derivatives(wanted) && profile->source != NULL ? profile->source : profile;
  const unsigned nodes = (wanted & CORE_MODULATED) != 0 ? CORE_MODULATION_NODES_MAX : 0;
  return derives->cost * (1 + nodes) +
         (transforms(profile, wanted) ? 60 + nodes * (60 + CALL_COST / 64 * profile->cost) : 0) +
         20 * nodes;
}

double core_call_cost(const core_profile *profile, unsigned wanted) {
  return transforms(profile, wanted) ? CALL_COST * profile->cost : 0;
}
