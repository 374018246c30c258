/* Finds radii with a given cdf. Models that have a kernel for it use that kernel. For all others
 * Newton's method is applied to ln(cdf / (1 - cdf)) over ln r, inside a bracket that shrinks with
 * every step.
 *
 * The steps for a number do not depend on its neighbours, so the bits do not depend on how an array
 * is cut. The numbers of a chunk are evaluated together until each of them has converged.
 */
#include <assert.h>
#include <math.h>

#include "core/kernels.h"

#define CORE_REAL 64
#include "core/kernel.h"

enum {
  CHUNK = 64,
  STEPS_MAX = 400, /* halving ln r over all doubles takes fewer steps */
};

/* The least u; a smaller one is raised to it. The radius is close to 0 there for every model. */
#define SMALL_U 1e-300

/* A step in ln r of at most this size is the last one, because Newton's method squares the error.
 */
#define LAST_STEP 1e-8

struct search {
  double u;
  double x;    /* the current radius */
  double low;  /* cdf(low) < u */
  double high; /* u <= cdf(high) */
  bool arrived;
};

static double logit(double u) {
  return real_log(u / real_max(1 - u, 0x1p-53), 0);
}

/* Makes a step of Newton's method from x. cdf and density: at x. */
static void step_newton(struct search *s, double cdf, double density) {
  const double excess = cdf > 0 ? logit(cdf) - logit(s->u) : -700;
  s->low = cdf < s->u ? s->x : s->low;
  s->high = cdf < s->u ? s->high : s->x;
  const double outside = real_max(1 - cdf, 0x1p-53);
  const double newton = -excess * (cdf * outside) / (s->x * density);
  const double bounded = newton > -6 && newton < 6 ? newton : excess < 0 ? 6.0 : -6.0;
  const real_exp_values factor = real_exp(-fabs(bounded));
  double next = bounded < 0 ? s->x * factor.exp : s->x / factor.exp;
  const bool last = fabs(newton) <= LAST_STEP && fabs(excess) <= sqrt(LAST_STEP);
  /* At the root, rounding decides whether x becomes `low` or `high`, so the last step is not
   * required to lie between them. */
  if (!last && !(next > s->low && next < s->high)) {
    const bool bracketed = s->low > 0 && s->high < (double)INFINITY;
    next = bracketed ? sqrt(s->low) * sqrt(s->high) : next;
  }
  const bool narrow = s->high <= s->low * (1 + 4 * 0x1p-52);
  s->arrived = last || narrow || next > 1e300 || next < 1e-300;
  s->x = next;
}

static void invert_chunk(const core_profile *profile, size_t n, const double *u, double *r) {
  struct search search[CHUNK];
  double cdf[CHUNK];
  double pdf[CHUNK];
  for (size_t i = 0; i < n; i++) {
    search[i] = (struct search){.u = real_max(u[i], SMALL_U),
                                .x = profile->scale_mm,
                                .high = (double)INFINITY,
                                .arrived = !(u[i] > 0 && u[i] < 1)};
  }
  bool all = false;
  for (int count = 0; count < STEPS_MAX && !all; count++) {
    for (size_t i = 0; i < n; i++) {
      r[i] = search[i].x;
    }
    core_evaluate(profile, CORE_QUANTITY_CDF, n, r, cdf);
    core_evaluate(profile, CORE_QUANTITY_PDF, n, r, pdf);
    all = true;
    for (size_t i = 0; i < n; i++) {
      if (!search[i].arrived) {
        step_newton(&search[i], cdf[i], pdf[i]);
        all = all && search[i].arrived;
      }
    }
  }
  for (size_t i = 0; i < n; i++) {
    r[i] = u[i] > 0 ? (u[i] < 1 ? search[i].x : (double)INFINITY) : 0;
  }
}

static void invert_cdf(const core_profile *profile, size_t n, const double *u, double *r) {
  for (size_t done = 0; done < n; done += CHUNK) {
    const size_t count = n - done < CHUNK ? n - done : CHUNK;
    if (profile->albedo > 0) {
      invert_chunk(profile, count, u + done, r + done);
    }
    for (size_t i = 0; i < count && !(profile->albedo > 0); i++) {
      r[done + i] = 0;
    }
  }
}

static void sample(const core_profile *profile, size_t n, const double *u, double *r) {
  if (profile->parts == NULL && profile->kernels->f64->sample != NULL) {
    core_run_f64(profile->kernels->f64, profile->kernels->f64->sample,
                 profile->table != NULL ? profile->table : profile->coefficients.f64, n, u, r);
  } else {
    invert_cdf(profile, n, u, r);
  }
}

void core_sample_f64(const core_profile *profile, size_t n, const double *u, double *r) {
  assert(profile->evaluator == CORE_EVALUATOR_F64);
  sample(profile, n, u, r);
}

void core_sample_f32(const core_profile *profile, size_t n, const float *u, float *r) {
  assert(profile->evaluator != CORE_EVALUATOR_F64);
  if (core_is_narrow(profile)) {
    core_run_f32(profile->kernels->f32, profile->kernels->f32->sample,
                 core_coefficients_f32(profile), n, u, r);
    return;
  }
  double wide_u[CHUNK];
  double wide_r[CHUNK];
  for (size_t done = 0; done < n; done += CHUNK) {
    const size_t count = n - done < CHUNK ? n - done : CHUNK;
    for (size_t i = 0; i < count; i++) {
      wide_u[i] = (double)u[done + i];
    }
    sample(profile, count, wide_u, wide_r);
    for (size_t i = 0; i < count; i++) {
      r[done + i] = (float)wide_r[i];
    }
  }
}
