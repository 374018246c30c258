/* Evaluates prepared profiles. It calls the model's kernels where they exist, and otherwise uses
 * methods for all models: S, the pdf and 2 pi r R from R, sums of two models and their derivatives,
 * and single precision rounded from double.
 *
 * Arrays are processed in chunks that fit into the first-level cache; no value depends on where the
 * chunks are cut.
 */
#include <assert.h>
#include <float.h>
#include <math.h>
#include <string.h>

#include "core/kernels.h"
#include "core/paths.h"

#define CORE_REAL 64
#include "core/kernel.h"

enum { CHUNK = 256 };

static enum core_elementwise position(enum core_quantity quantity) {
  switch (quantity) {
#define POSITION(P, bit, IDENT, name, unit, SHAPE, about)                                          \
  CORE_IF_##SHAPE(case CORE_QUANTITY_##IDENT : return CORE_ELEMENTWISE_##IDENT;)
    CORE_EACH_QUANTITY(POSITION, )
  default:
    assert(!"an elementwise quantity");
    return CORE_ELEMENTWISE_COUNT;
  }
}

static size_t smaller(size_t a, size_t b) {
  return a < b ? a : b;
}

/* ---- double precision ------------------------------------------------------------------------ */

/* Returns ln(e^a + e^b) without overflow; a and b may be -infinity. */
static double ln_of_sum(double a, double b) {
  const double more = real_max(a, b);
  const double less = real_min(a, b);
  const double apart = more > -(double)INFINITY && less > -(double)INFINITY ? less - more : -1e3;
  return apart > -700 ? more + real_log(1 + real_exp(apart).exp, 0) : more;
}

/* Returns the cdf of a sum of two models. It is exactly 1 where the cdf of each part is 1, or 0 for
 * a part that scatters nothing, and below 1 elsewhere. Rounding the weighted sum would not ensure
 * that. */
static double whole(double sum, double first, double second) {
  const bool ended = real_max(first, second) >= 1 && (first >= 1 || !(first > 0)) &&
                     (second >= 1 || !(second > 0));
  return ended ? 1 : real_min(sum, REAL_BELOW_1);
}

static void add_chunk(const core_profile *profile, enum core_quantity quantity, size_t n,
                      const double *r, double *out) {
  double second[CHUNK];
  core_evaluate(&profile->parts[0], quantity, n, r, out);
  core_evaluate(&profile->parts[1], quantity, n, r, second);
  const bool shares = quantity == CORE_QUANTITY_CDF;
  const double share0 = shares ? profile->part_shares[0] : 1;
  const double share1 = shares ? profile->part_shares[1] : 1;
  for (size_t i = 0; i < n; i++) {
    const double sum = fma(share0, out[i], share1 * second[i]);
    out[i] = quantity == CORE_QUANTITY_LN_R  ? ln_of_sum(out[i], second[i])
             : quantity == CORE_QUANTITY_CDF ? whole(sum, out[i], second[i])
                                             : sum;
  }
}

/* Sets out[n] to the derivatives of ln R of a sum of two models: the mean of the parts'
 * derivatives, weighted by their R. n is at most CHUNK. */
static void average_chunk(const core_profile *profile, enum core_quantity quantity, size_t n,
                          const double *r, double *out) {
  double kept[CHUNK] = {0}, ln_R[2][CHUNK], second[CHUNK];
  for (size_t i = 0; i < n; i++) {
    kept[i] = real_max(r[i], 1e-280); /* at r = 0 both R may be infinite */
  }
  core_evaluate(&profile->parts[0], CORE_QUANTITY_LN_R, n, kept, ln_R[0]);
  core_evaluate(&profile->parts[1], CORE_QUANTITY_LN_R, n, kept, ln_R[1]);
  core_evaluate(&profile->parts[0], quantity, n, kept, out);
  core_evaluate(&profile->parts[1], quantity, n, kept, second);
  for (size_t i = 0; i < n; i++) {
    const double more = real_max(ln_R[0][i], ln_R[1][i]), less = real_min(ln_R[0][i], ln_R[1][i]);
    const bool both = less > -(double)INFINITY;
    /* ratio of the smaller R to the larger */
    const double lesser = both ? real_exp(less - more).exp : 0;
    const bool first_more = ln_R[0][i] >= ln_R[1][i];
    const double brighter = first_more ? out[i] : second[i],
                 darker = first_more ? second[i] : out[i];
    out[i] = fma(lesser / (1 + lesser), darker - brighter, brighter);
  }
}

/* Returns S / R = F_t(cos_in) F_t(cos_out) / (pi (1 - 2 C1(1 / eta))). */
static double S_per_R(const core_profile *profile) {
  const double eta = profile->medium.eta;
  const double lost = core_fresnel_moments(CORE_MOMENTS_EXACT, 1 / eta).one_minus_2c1;
  return core_fresnel_transmittance(eta, profile->cos_in) *
         core_fresnel_transmittance(eta, profile->cos_out) / (3.14159265358979323846 * lost);
}

/* A quantity that is R times up times `number`, and times r if by_radius. */
struct multiple {
  double up; /* a power of two, so that R up does not underflow */
  double number;
  bool by_radius;
};

static struct multiple multiple_of(const core_profile *profile, enum core_quantity quantity) {
  const double two_pi = 6.28318530717958647693, albedo = profile->albedo;
  if (quantity == CORE_QUANTITY_S) {
    return (struct multiple){1, S_per_R(profile), false};
  }
  if (quantity == CORE_QUANTITY_RING) {
    return (struct multiple){1, two_pi, true};
  }
  const double up = albedo < 0x1p-800 ? 0x1p200 : 1;
  return (struct multiple){up, albedo > 0 ? two_pi / (albedo * up) : 0, true};
}

/* Returns the quantity for R at r: 0 where R or the number is 0, even if r or R is infinite. r is
 * multiplied last because it may be subnormal. */
static inline double times_R(struct multiple of, double r, double R) {
  const double product = R * of.up * of.number;
  return product > 0 ? (of.by_radius ? r * product : product) : 0;
}

/* Returns the quantity where R is infinite: its limit at the source, where R is proportional to 1 /
 * r or to ln(1 / r). */
static double at_source(const core_profile *profile, const struct multiple *of) {
  const double r[2] = {1e-200, 0.5e-200};
  double R[2];
  core_evaluate(profile, CORE_QUANTITY_R, 2, r, R);
  return R[1] > 1.5 * R[0] ? times_R(*of, r[1], R[1]) : 0;
}

/* Replaces out[n], which holds R, by the quantity. */
static void multiply(const core_profile *profile, enum core_quantity quantity, size_t n,
                     const double *r, double *out) {
  const struct multiple of = multiple_of(profile, quantity);
  uint64_t infinite = 0;
  for (size_t i = 0; i < n; i++) {
    const double value = times_R(of, r[i], out[i]);
    out[i] = value;
    /* sets the highest bit if the value is infinite or NaN (0 times infinity) */
    infinite |= (real_to_bits(value) & (UINT64_MAX >> 1)) + (UINT64_C(1) << REAL_MANTISSA_BITS);
  }
  if (of.by_radius && infinite >> 63 != 0) {
    const double source = at_source(profile, &of);
    for (size_t i = 0; i < n; i++) {
      out[i] = out[i] < (double)INFINITY ? out[i] : source; /* a NaN comes from 0 times infinity */
    }
  }
}

void core_evaluate(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const double *r, double *out) {
  if ((quantity & CORE_MODULATED) != 0) {
    core_modulation_eval(profile, quantity, n, r, out);
    return;
  }
  if ((quantity & CORE_PATHS) != 0) {
    const core_profile *of = profile->paths != NULL ? profile->paths : profile;
    core_evaluate(of, CORE_QUANTITY_BY_SIGMA_A, n, r, out);
    core_paths_make(of, quantity, n, r, out);
    return;
  }
  if ((quantity & CORE_MULTIPLES) != 0) {
    for (size_t done = 0; done < n; done += CHUNK) {
      const size_t count = smaller(n - done, CHUNK);
      core_evaluate(profile, CORE_QUANTITY_R, count, r + done, out + done);
      multiply(profile, quantity, count, r + done, out + done);
    }
    return;
  }
  if (profile->parts == NULL) {
    if (profile->kernels->f64->evaluate[position(quantity)] != NULL) {
      core_run_kernel(profile, position(quantity), n, r, out);
    } else if (quantity == CORE_QUANTITY_T) { /* the model is of half spaces */
      memset(out, 0, n * sizeof *out);
    } else {
      assert(quantity == CORE_QUANTITY_TRANSFER);
      core_transfer(profile, n, r, out);
    }
    return;
  }
  for (size_t done = 0; done < n; done += CHUNK) {
    (core_wants_derivatives(quantity) ? average_chunk : add_chunk)(
        profile, quantity, smaller(n - done, CHUNK), r + done, out + done);
  }
}

void core_eval_f64(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const double *r, double *out) {
  assert(profile->evaluator == CORE_EVALUATOR_F64);
  core_evaluate(profile, quantity, n, r, out);
}

/* ---- single precision ------------------------------------------------------------------------ */

/* Evaluates in double precision and rounds to single. For profiles without kernels in single
 * precision. */
static void widely(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const float *r, float *out) {
  double wide_r[CHUNK];
  double wide_out[CHUNK];
  for (size_t done = 0; done < n; done += CHUNK) {
    const size_t count = smaller(n - done, CHUNK);
    for (size_t i = 0; i < count; i++) {
      wide_r[i] = (double)r[done + i];
    }
    core_evaluate(profile, quantity, count, wide_r, wide_out);
    for (size_t i = 0; i < count; i++) {
      /* A cdf below 1 must not round to 1. */
      const bool less = quantity == CORE_QUANTITY_CDF && wide_out[i] < 1;
      const float rounded = (float)wide_out[i];
      out[done + i] = less && rounded >= 1 ? 1 - FLT_EPSILON / 2 : rounded;
    }
  }
}

/* Makes paths from the derivatives of the kernels in single precision. */
static void narrow_paths(const core_profile *profile, enum core_quantity quantity, size_t n,
                         const float *r, float *out) {
  core_eval_f32(profile, CORE_QUANTITY_BY_SIGMA_A, n, r, out);
  for (size_t i = 0; i < n; i++) {
    const double wide_r = (double)r[i];
    double value = (double)out[i];
    core_paths_make(profile, quantity, 1, &wide_r, &value);
    out[i] = (float)value;
  }
}

void core_eval_f32(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const float *r, float *out) {
  assert(profile->evaluator != CORE_EVALUATOR_F64);
  core_kernel_f32 *const *kernels =
      core_is_narrow(profile) ? profile->kernels->f32->evaluate : NULL;
  if ((quantity & CORE_MODULATED) != 0 ||
      ((quantity & CORE_PATHS) != 0 && profile->paths != NULL)) {
    widely(profile, quantity, n, r, out);
  } else if ((quantity & CORE_PATHS) != 0) {
    (kernels != NULL && profile->lut == NULL ? narrow_paths : widely)(
        profile->lut != NULL ? profile->source : profile, quantity, n, r, out);
  } else if (kernels != NULL && kernels[position(quantity)] != NULL) {
    core_run_f32(profile->kernels->f32, kernels[position(quantity)], core_coefficients_f32(profile),
                 n, r, out);
  } else if (profile->source == NULL && core_is_narrow(profile) && quantity == CORE_QUANTITY_T) {
    memset(out, 0, n * sizeof *out);
  } else if (kernels != NULL && (quantity & CORE_MULTIPLES) != 0) {
    const struct multiple of = multiple_of(profile, quantity);
    core_run_f32(profile->kernels->f32, kernels[CORE_ELEMENTWISE_R], core_coefficients_f32(profile),
                 n, r, out);
    for (size_t i = 0; i < n; i++) {
      out[i] = (float)times_R(of, (double)r[i], (double)out[i]);
    }
  } else {
    /* Quantities that the table lacks come from the profile that it was made from. */
    assert(profile->lut == NULL || profile->source != NULL);
    widely(profile->lut != NULL ? profile->source : profile, quantity, n, r, out);
  }
}

void core_eval_any(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const double *r, double *out) {
  float narrow_r[CORE_EVAL_ANY_MAX], value[CORE_EVAL_ANY_MAX];
  assert(n <= CORE_EVAL_ANY_MAX);
  narrow_r[0] = 0; /* GCC warns of an array that may have no elements */
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, quantity, n, r, out);
    return;
  }
  for (size_t i = 0; i < n; i++) {
    narrow_r[i] = (float)r[i];
  }
  core_eval_f32(profile, quantity, n, narrow_r, value);
  for (size_t i = 0; i < n; i++) {
    out[i] = (double)value[i];
  }
}
