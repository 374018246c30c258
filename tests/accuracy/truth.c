/* truth: is every stated error true?
 *
 *   truth [--seconds N | --rounds N] [--seed N] [--model ID | --odd] [--workers N]
 *
 * A round draws, for every model, a medium, moments and parameters from the whole domain, more
 * often from the usual part of it. The program compares each evaluator's values at random radii
 * with the model's formula and their difference with the error that the profile states:
 *
 * - f64 and f32 at a few radii with the formula in 113 bits, or in 64 bits where it is an integral
 *   (tests/accuracy/forms.c; one of 24 radii in 113 bits);
 * - f32, lut, and an f64 to whose request a tolerance was added, at many radii with f64 at its
 *   tightest tolerance, which the first comparison checks in the same round. A value that differs
 *   by more than 0.9 of its stated error is compared with the formula itself.
 *
 * Two models have no formula: `transport` is compared with itself at its own tolerance, and
 * the stated errors of both are added (test_transport_g.c and test_derivative.c compare it with solutions);
 * `gaussians` is compared with the model that it was fitted to. Path lengths and derivatives are
 * compared with those of the formula's series, and modulated light with the formula continued from 36
 * absorptions; that of `transport`, with g = 0, with tests/accuracy/isotropic/ continued from 12. Half
 * spaces of any g are compared with layers that they are cut into; with --odd, rounds have nothing but
 * layers at the limits of what is taken. Besides values the rounds check
 * samples (core_sample), inversions (invert_albedo), that a cdf never falls once it is 1, that a range
 * states no less than a radius in it, and the stated errors of models against solutions of transport.
 *
 * Before the rounds it replays tests/accuracy/known.csv: values that were once further off than
 * their profile stated, and what a round is too rare to meet. A row has the request, its right value
 * and how far off that may be; `cos` is both cos_in and cos_out.
 *
 * Each processor runs rounds of its own. The program prints its seed, how many values of each class
 * it compared, and each class's largest error as a share of what was stated. Its exit status is 1
 * if one was larger than stated. The same seed and number of rounds give the same comparisons.
 */
#include <assert.h>
#include <complex.h>
#include <float.h>
#include <getopt.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "core/kernels.h"
#include "core/ruler.h"
#include "core/splitmix.h"
#include "tests/accuracy/forms.h"
#include "tests/accuracy/inversion.h"
#include "tests/accuracy/isotropic/isotropic.h"

/* ---- random numbers ------------------------------------------------------------------------------ */

static size_t below(uint64_t *state, size_t limit) {
  return (size_t)(core_splitmix(state) % limit);
}

static double between(uint64_t *state, double low, double high) {
  return low + (high - low) * core_splitmix_f64(state);
}

static double log_between(uint64_t *state, double low, double high) {
  return exp(between(state, log(low), log(high)));
}

static int by_size(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* ---- what is counted ---------------------------------------------------------------------------- */

/* The classes of checks: the elementwise quantities, then those below. */
enum check {
  ALBEDO = CORE_ELEMENTWISE_COUNT,
  CDF_END, /* a cdf stays 1 */
  SAMPLE,
  INVERSION,
  MODEL_ERROR,
  TOLERANCE, /* a table states no more than was asked for */
  RANGE,     /* more radii state no less */
  LAYERS,    /* equal layers are their half space */
  ODD_LAYERS,
  PATH_LENGTH,
  DPF,
  TIME,
  PHASE,
  MODULATION,
  PHASE_F,
  MODULATION_F,
  CHECKS
};

/* The quantities of these checks, from PATH_LENGTH on. */
static const enum core_quantity lights[CHECKS - PATH_LENGTH] = {
    CORE_QUANTITY_PATH,       CORE_QUANTITY_DPF,     CORE_QUANTITY_TIME,        CORE_QUANTITY_PHASE,
    CORE_QUANTITY_MODULATION, CORE_QUANTITY_PHASE_F, CORE_QUANTITY_MODULATION_F};

static const char *const check_names[CHECKS] = {
#define NAME_OF(P, bit, IDENT, name, unit, SHAPE, about)                                           \
  CORE_IF_##SHAPE([CORE_ELEMENTWISE_##IDENT] = name, )
    CORE_EACH_QUANTITY(NAME_OF, )[ALBEDO] = "albedo",
    [CDF_END] = "cdf stays 1",
    [SAMPLE] = "sample",
    [INVERSION] = "inversion",
    [MODEL_ERROR] = "model error",
    [TOLERANCE] = "tolerance",
    [RANGE] = "range",
    [LAYERS] = "layers",
    [ODD_LAYERS] = "odd layers",
    [PATH_LENGTH] = "path",
    [DPF] = "dpf",
    [TIME] = "time",
    [PHASE] = "phase",
    [MODULATION] = "modulation",
    [PHASE_F] = "phase_f",
    [MODULATION_F] = "modulation_f"};

static const enum core_quantity quantities[CORE_ELEMENTWISE_COUNT] = {
#define QUANTITY_OF(P, bit, IDENT, name, unit, SHAPE, about)                                       \
  CORE_IF_##SHAPE([CORE_ELEMENTWISE_##IDENT] = CORE_QUANTITY_##IDENT, )
    CORE_EACH_QUANTITY(QUANTITY_OF, )};

#define ID(id, ...) id,
static const unsigned models[] = {CORE_EACH_MODEL(ID, ID)};

/* FINE is f64 at its tightest tolerance. */
enum evaluator { F64, F32, LUT, FINE, EVALUATORS };

static const unsigned evaluator_ids[EVALUATORS] = {CORE_EVALUATOR_F64, CORE_EVALUATOR_F32,
                                                   CORE_EVALUATOR_LUT, CORE_EVALUATOR_F64};
static const char *const evaluator_names[EVALUATORS] = {"f64", "f32", "lut", "f64"};

enum { MODELS = sizeof models / sizeof models[0], SHOWN = 3 };

struct class {
  unsigned long long values, by_form, violations; /* by_form: of these, compared with the formula */
  double worst;                                   /* error over what was stated */
};

/* Shared by all workers; each writes its own counts. */
struct worker {
  struct class classes[MODELS][EVALUATORS][CHECKS];
};

static struct worker *worker;
static unsigned long long *rounds_begun;
static unsigned long long round_now;

static double now_s(void) {
  struct timespec now;
  timespec_get(&now, TIME_UTC);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* ---- a subject ---------------------------------------------------------------------------------- */

/* A model, a medium and a request's parameters, prepared by each evaluator. */
struct subject {
  size_t model; /* its position in the list */
  enum form_family family;
  enum core_moments moments;
  core_medium medium;
  core_parameters parameters;
  bool ready[EVALUATORS];
  core_profile profiles[EVALUATORS];
  core_radii_range judged; /* where FINE may judge a model without a formula */
  form_model form;
  bool derivatives; /* whether the profiles have them */
};

static void print_subject(const struct subject *s) {
  const core_medium *m = &s->medium;
  printf("  --sigma-a %.17g --sigma-s %.17g --g %.17g --eta %.17g moments %d", m->sigma_a_per_mm,
         m->sigma_s_per_mm, m->g, m->eta, (int)s->moments);
  for (const core_choice *p = core_parameter_list; p->name != NULL; p++) {
    if (!isnan(s->parameters.value[p->id])) {
      printf(" %s %.17g", p->name, s->parameters.value[p->id]);
    }
  }
  printf(" --model %u, round %llu\n", models[s->model], round_now);
}

static const char *model_name(size_t model) {
  return core_choice_by_id(core_models, models[model])->name;
}

/* Counts a check. share: the error over what was stated. */
static void count(const struct subject *s, enum evaluator evaluator, int check, bool good,
                  double share, double at, double value, double truth) {
  struct class *class = &worker->classes[s->model][evaluator][check];
  class->values++;
  class->worst = share > class->worst ? share : class->worst;
  if (!good && class->violations++ < SHOWN) {
    printf("%s %s %s at %.17g: %.17g, not %.17g: %.3f of what is stated\n", model_name(s->model),
           evaluator_names[evaluator], check_names[check], at, value, truth, share);
    print_subject(s);
    fflush(stdout);
  }
}

/* ---- comparing ---------------------------------------------------------------------------------- */

/* Compares a value with the truth, which may itself be off by `unsure`. */
static void compare(const struct subject *s, enum evaluator e, int check, double r, double value,
                    quad truth, quad unsure) {
  if (!isnan(truth)) {
    const double share = form_share(&s->form, &s->profiles[e], check, r, value, truth, unsure);
    count(s, e, check, share <= 1, share, r, value, (double)truth);
  }
}

static void evaluate(const core_profile *profile, enum core_quantity quantity, size_t n,
                     const double *r, double *out) {
  enum { MOST = 2048 };
  static float narrow_r[MOST], narrow_out[MOST];
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, quantity, n, r, out);
    return;
  }
  assert(n <= MOST);
  for (size_t i = 0; i < n; i++) {
    narrow_r[i] = (float)r[i];
  }
  core_eval_f32(profile, quantity, n, narrow_r, narrow_out);
  for (size_t i = 0; i < n; i++) {
    out[i] = (double)narrow_out[i];
  }
}

/* Whether ln R is finite at this radius: only up to so many mean free paths. */
static bool has_ln_R(const struct subject *s, enum evaluator e, double r) {
  const double far = e == F64 || e == FINE ? 1e100 : 1e12;
  return r * (double)s->form.part[0].sigma_t_prime < far;
}

enum { EXACT_MOST = 64, DENSE = 448, RADII = EXACT_MOST + DENSE };

struct values {
  size_t count;
  double r[RADII], f[RADII]; /* f: frequencies, for the transfer function */
  double of[EVALUATORS][CORE_ELEMENTWISE_COUNT][RADII];
};

/* Returns the radius, or the frequency, that values of a quantity are evaluated at. */
static double place(const struct values *values, size_t i, int q) {
  return q == CORE_ELEMENTWISE_TRANSFER ? values->f[i] : values->r[i];
}

static bool is_derivative(int q) {
  return q == CORE_ELEMENTWISE_BY_SIGMA_A || q == CORE_ELEMENTWISE_BY_SIGMA_S;
}

static bool is_narrow(double r) {
  return r == (double)(float)r;
}

/* Compares all values at a radius with the formula, or only those of one quantity and evaluator. */
static void compare_exactly(const struct subject *s, const struct values *values, size_t i,
                            form_values at, int only_evaluator, int only_quantity) {
  for (int e = 0; e < EVALUATORS; e++) {
    for (int q = 0; q < CORE_ELEMENTWISE_COUNT; q++) {
      const double r = place(values, i, q);
      const bool wanted = (only_evaluator < 0 || (e == only_evaluator && q == only_quantity)) &&
                          s->ready[e] && (e == F64 || e == FINE || is_narrow(r)) &&
                          form_promises(&s->form, q, r);
      const quad truth = wanted ? form_truth(&s->form, at, q, r) : (quad)NAN;
      if (!isnan(truth) && (q != CORE_ELEMENTWISE_LN_R || isinf(truth) || has_ln_R(s, e, r))) {
        compare(s, e, q, r, values->of[e][q][i], truth, 0);
        worker->classes[s->model][e][q].by_form++;
      }
    }
  }
}

/* ---- many radii at once ------------------------------------------------------------------------- */

/* Compares a value with FINE's. Returns false if that does not decide. */
static bool is_near(const struct subject *s, const struct values *values, size_t i,
                    enum evaluator e, int q) {
  const double r = place(values, i, q);
  const double value = values->of[e][q][i], fine = values->of[FINE][q][i];
  if (!isfinite(value) || !isfinite(fine)) {
    return false;
  }
  const double share = form_share(&s->form, &s->profiles[e], q, r, value, (quad)fine, 0);
  if (!(share <= 0.9)) {
    return false;
  }
  count(s, e, q, true, share, r, value, fine);
  return true;
}

/* Compares with FINE where a model has no formula. */
static void compare_with_fine(const struct subject *s, const struct values *values, size_t i,
                              enum evaluator e, int q) {
  const double r = place(values, i, q);
  const quad fine = (quad)values->of[FINE][q][i];
  const bool is_R = q == CORE_ELEMENTWISE_R || q == CORE_ELEMENTWISE_S;
  const bool judged =
      q == CORE_ELEMENTWISE_TRANSFER || (r >= s->judged.least_mm && r <= s->judged.most_mm &&
                                         fabsf128(fine) > 1e-280Q && !isinf(fine));
  if ((s->family == FORM_FIT && !is_R) || !judged) {
    return;
  }
  compare(s, e, q, r, values->of[e][q][i], fine,
          form_allowed(&s->profiles[FINE], q, r, fabsf128(fine)));
}

/* Whether a transform has no form: that of `beam`, alone or in a sum. */
static bool is_beam_transfer(const struct subject *s, int q) {
  return q == CORE_ELEMENTWISE_TRANSFER && isnan(s->form.albedo);
}

static void compare_densely(const struct subject *s, const struct values *values, size_t from) {
  for (size_t i = from; i < values->count; i++) {
    for (int e = F64; e <= LUT; e++) {
      /* f64 at its tightest tolerance is no judge of itself */
      const bool itself = e == F64 && s->ready[F64] &&
                          s->profiles[F64].numerical_error == s->profiles[FINE].numerical_error;
      for (int q = 0; s->ready[e] && !itself && q < CORE_ELEMENTWISE_COUNT; q++) {
        const double r = place(values, i, q);
        const bool by_fine = !s->form.known || is_beam_transfer(s, q);
        const bool asked = form_promises(&s->form, q, r) && (e == F64 || is_narrow(r)) &&
                           (q != CORE_ELEMENTWISE_LN_R || has_ln_R(s, e, r)) && !is_derivative(q);
        if (asked && by_fine) {
          compare_with_fine(s, values, i, e, q);
        } else if (asked && !is_near(s, values, i, e, q)) {
          compare_exactly(s, values, i, form_at(&s->form, values->r[i], true), e, q);
        }
      }
    }
  }
}

/* Compares a value of light with the truth and what is stated. */
static void compare_light(const struct subject *s, enum evaluator e, int check, double x,
                          quad truth, quad unsure) {
  const core_profile *profile = &s->profiles[e];
  const enum core_quantity quantity = lights[check - PATH_LENGTH];
  double value;
  evaluate(profile, quantity, 1, &x, &value);
  const core_stated_errors stated =
      core_profile_errors(profile, quantity, (core_radii_range){x, x});
  const double allowed = stated.numerical + stated.numerical_per_mm * x;
  const double off = (double)fmaxf128(fabsf128((quad)value - truth) - unsure, 0);
  if (allowed < (double)INFINITY && (double)unsure < 0.1 * allowed) {
    const bool overflows = e != F64 && e != FINE && isinf(value) && (quad)value * truth > 0 &&
                           fabsf128(truth) + (quad)allowed > (quad)FLT_MAX;
    const double share = off > 0 && !overflows ? off / (allowed + 4 * DBL_MIN) : 0;
    count(s, e, check, share <= 1, share, x, value, (double)truth);
    worker->classes[s->model][e][check].by_form++;
  }
}

/* Compares path lengths and derivatives with the formula's, where R has not underflowed. If all lengths
 * are as much shorter as sigma_a and sigma_s are larger, R is larger by the square. */
static void compare_derivatives(const struct subject *s, const struct values *values,
                                size_t radii) {
  for (size_t i = 0; i < radii; i++) {
    const double r = values->r[i];
    const form_values at = form_at(&s->form, r, false);
    quad unsure = 0;
    const quad path =
        r > 0 && form_promises(&s->form, CORE_ELEMENTWISE_SLOPE, r)
            ? form_path(models[s->model], s->moments, &s->medium, &s->parameters, r, &unsure)
            : (quad)NAN;
    const quad by_sigma_a = -path * (quad)s->medium.sigma_a_per_mm;
    const quad by[2] = {by_sigma_a, 2 - (quad)r * at.slope / at.R - by_sigma_a};
    for (int e = 0; e < EVALUATORS && !isnan(by[1]) && !isinf(by[1]); e++) {
      const core_profile *profile = &s->profiles[e];
      if (!s->ready[e] || (e != F64 && e != FINE && !is_narrow(r))) {
        continue;
      }
      for (int check = PATH_LENGTH; check <= TIME; check++) {
        const quad times = check == DPF    ? 1 / (quad)r
                           : check == TIME ? (quad)profile->path_index / 0.299792458Q
                                           : 1;
        compare_light(s, e, check, r, times * path, times * unsure);
      }
      for (int of_s = 0; of_s < 2; of_s++) {
        const int q = of_s ? CORE_ELEMENTWISE_BY_SIGMA_S : CORE_ELEMENTWISE_BY_SIGMA_A;
        const double value = values->of[e][q][i];
        const double stated = profile->derivative_error + profile->derivative_error_per_mm * r;
        const quad off = fabsf128((quad)value - by[of_s]) - unsure * (quad)s->medium.sigma_a_per_mm;
        const double share = off > 0 ? (double)off / stated : 0;
        count(s, e, q, share <= 1, share, r, value, (double)by[of_s]);
        worker->classes[s->model][e][q].by_form++;
      }
    }
  }
}

/* Once the cdf is 1 it stays 1. */
static void check_end(const struct subject *s, enum evaluator e, uint64_t *random) {
  enum { STEPS = 128 };
  const core_profile *profile = &s->profiles[e];
  const double factor = 1 + log_between(random, 1e-6, 1);
  double r[STEPS], cdf[STEPS], most = 0;
  r[0] = fmin(profile->scale_mm * log_between(random, 0.1, 30), 1e38);
  for (int i = 1; i < STEPS; i++) {
    r[i] = fmin(r[i - 1] * factor, 1e38);
  }
  evaluate(profile, CORE_QUANTITY_CDF, STEPS, r, cdf);
  for (int i = 0; i < STEPS; i++) {
    const bool good = cdf[i] <= 1 && (most < 1 || cdf[i] == 1);
    count(s, e, CDF_END, good, 0, r[i], cdf[i], most);
    most = fmax(most, cdf[i]);
  }
}

/* A range states no less of any quantity than a radius in it, which may be the edge of a band. */
static void check_range(const struct subject *s, enum evaluator e, const core_profile *profile,
                        uint64_t *random) {
  const double mfp_mm = 1 / core_sigma_t_prime(&profile->medium);
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    const double mfp = below(random, 4) ? log_between(random, 1e-3, 1e3)
                                        : core_error_edges_mfp[below(random, CORE_ERROR_BANDS)];
    const double r = mfp * mfp_mm;
    const core_radii_range range = {below(random, 3) ? r / log_between(random, 1, 100) : r,
                                    below(random, 3) ? r * log_between(random, 1, 100) : r};
    const core_stated_errors all = core_profile_errors(profile, quantity->id, range),
                             one = core_profile_errors(profile, quantity->id,
                                                       (core_radii_range){r, r});
    count(s, e, RANGE,
          one.numerical <= all.numerical && one.numerical_per_mm <= all.numerical_per_mm, 0, r,
          all.numerical, one.numerical);
  }
}

/* ---- samples and inversions ---------------------------------------------------------------------- */

/* The cdf at a sampled radius is the number that it was sampled for, and more of that is never a
 * smaller radius, but for rounding: where little is left beyond r, that of 1 - u. */
static void check_samples(const struct subject *s, enum evaluator e, uint64_t *random) {
  enum { SAMPLES = 64 };
  const core_profile *profile = &s->profiles[e], *fine = &s->profiles[FINE];
  const double epsilon = e == F64 ? DBL_EPSILON : (double)FLT_EPSILON;
  double u[SAMPLES], r[SAMPLES], low[SAMPLES], high[SAMPLES], cdf_low[SAMPLES], cdf_high[SAMPLES];
  float narrow_u[SAMPLES], narrow_r[SAMPLES];
  for (int i = 0; i < SAMPLES; i++) {
    const size_t kind = below(random, 5);
    u[i] = i == 0               ? 0
           : i == 1             ? 1
           : kind == 0          ? log_between(random, 1e-30, 0.5)
           : kind == 1          ? 1 - log_between(random, 1.2e-7, 0.5)
           : kind == 2 && i > 2 ? fmin(u[i - 1] * (1 + epsilon), 1)
                                : between(random, 0, 1);
    u[i] = e == F64 ? u[i] : (double)(float)u[i];
  }
  qsort(u, SAMPLES, sizeof u[0], by_size);
  for (int i = 0; i < SAMPLES; i++) {
    narrow_u[i] = (float)u[i];
  }
  if (e == F64) {
    core_sample_f64(profile, SAMPLES, u, r);
  } else {
    core_sample_f32(profile, SAMPLES, narrow_u, narrow_r);
    for (int i = 0; i < SAMPLES; i++) {
      r[i] = (double)narrow_r[i];
    }
  }
  count(s, e, SAMPLE, r[0] == 0 && (isinf(r[SAMPLES - 1]) || profile->albedo == 0), 0, 0, r[0], 0);
  for (int i = 1; i < SAMPLES; i++) {
    const double slack = s->family == FORM_DIPOLE ? 64 * epsilon / fmax(1 - u[i], epsilon) : 1;
    const bool back = slack < 1 && r[i] < r[i - 1] * (1 - slack);
    count(s, e, SAMPLE, !back, 0, u[i], r[i], r[i - 1]);
  }
  const double off = e == LUT ? profile->numerical_error : 0;
  for (int i = 0; i < SAMPLES; i++) {
    low[i] = r[i] / (1 + off);
    high[i] = r[i] * (1 + off);
  }
  core_eval_f64(fine, CORE_QUANTITY_CDF, SAMPLES, low, cdf_low);
  core_eval_f64(fine, CORE_QUANTITY_CDF, SAMPLES, high, cdf_high);
  for (int i = 0; i < SAMPLES; i++) {
    const bool inside = r[i] > (e == F64 ? DBL_MIN : (double)FLT_MIN) &&
                        r[i] < (e == F64 ? 1e300 : (double)FLT_MAX) && u[i] <= 1 - 1e-7;
    const double error = profile->numerical_error + profile->numerical_error_per_mm * r[i] +
                         fine->numerical_error + fine->numerical_error_per_mm * r[i];
    const double fixed = e == F64 ? CORE_SAMPLE_ERROR_F64 : e == F32 ? CORE_SAMPLE_ERROR_F32 : 0;
    const double allowed = fixed + (e == LUT ? 0 : error) * u[i] +
                           (fine->numerical_error + fine->numerical_error_per_mm * r[i]) * u[i];
    const double wrong = fmax(cdf_low[i] - u[i], u[i] - cdf_high[i]);
    if (inside) {
      count(s, e, SAMPLE, wrong <= allowed, fmax(wrong, 0) / allowed, u[i], r[i], cdf_low[i]);
    }
  }
}

/* The medium that invert_albedo() finds has the wanted albedo. */
static void check_inversion(struct subject *s, uint64_t *random) {
  static form_model found;
  const double wanted = below(random, 2) ? between(random, 0.01, 1) : log_between(random, 1e-6, 1);
  const double mfp_mm = log_between(random, 1e-6, 1e6);
  const inversion inverted =
      invert_albedo(models[s->model], s->moments, wanted, mfp_mm, s->medium.eta);
  core_profile profile;
  if (inverted.fault.field == NULL &&
      core_profile_prepare(&profile, core_isa_select(NULL), models[s->model], s->moments,
                           CORE_EVALUATOR_F64, &inverted.medium, NULL)
              .field == NULL) {
    core_parameters parameters = core_parameters_none();
    parameters.value[CORE_PARAMETER_COS_IN] = parameters.value[CORE_PARAMETER_COS_OUT] = 1;
    form_prepare(&found, models[s->model], s->moments, &inverted.medium, &parameters);
    const double allowed = 1e-12 + profile.numerical_error;
    core_profile_free(&profile);
    const double error = fabs((double)(found.albedo / (quad)wanted - 1));
    if (!isnan(error)) {
      count(s, F64, INVERSION, error <= allowed, error / allowed, wanted, (double)found.albedo,
            wanted);
    }
  }
}

/* ---- path lengths and modulated light ------------------------------------------------------------ */

typedef _Complex _Float128 complex_quad;

enum { LIGHT_NODES = 36, LIGHT_RADII = 16 };

/* Sets ln_R[n] of a medium by the formula or, of transport, by the independent solver as far as it
 * reaches. waves: x are frequencies. */
static void find_ln_R(const struct subject *s, const core_medium *medium, bool waves, size_t n,
                      const double *x, quad *ln_R) {
  static form_model form;
  if (s->family != FORM_TRANSPORT) {
    form_prepare(&form, models[s->model], s->moments, medium, &s->parameters);
    for (size_t i = 0; i < n; i++) {
      const form_values at = waves ? (form_values){0} : form_at(&form, x[i], true);
      ln_R[i] = waves ? logf128(form_truth(&form, at, CORE_ELEMENTWISE_TRANSFER, x[i]))
                      : logf128(at.R) - at.shift;
    }
    return;
  }
  const double sigma_t = medium->sigma_a_per_mm + medium->sigma_s_per_mm;
  isotropic_solution *solution =
      isotropic_solve(medium->eta, medium->sigma_s_per_mm / sigma_t, 1e-9, ISOTROPIC_REACH);
  for (size_t i = 0; i < n; i++) {
    const double mfp = x[i] * sigma_t;
    ln_R[i] = mfp < ISOTROPIC_REACH
                  ? logf128((quad)isotropic_at(solution, mfp).R) + 2 * logf128((quad)sigma_t)
                  : (quad)NAN;
  }
  isotropic_free(solution);
}

/* Sets truth[2][n] to phases in degrees and modulations at wavenumber omega n / c, continued from
 * `nodes` absorptions in 113 bits. */
static void continue_form(const struct subject *s, double wavenumber, int nodes, bool waves,
                          size_t n, const double *x, quad truth[2][LIGHT_RADII]) {
  static quad ln_R[LIGHT_NODES][LIGHT_RADII];
  const quad sigma_a = (quad)s->medium.sigma_a_per_mm, here = sqrtf128(sigma_a);
  const complex_quad there = csqrtf128(CMPLXF128(sigma_a, (quad)wavenumber));
  const double middle = (double)crealf128(there);
  const double half = fmin(fmax(middle / 2, 2 * (double)cimagf128(there)), middle);
  quad u[LIGHT_NODES];
  for (int j = 0; j < nodes; j++) {
    core_medium medium = s->medium;
    medium.sigma_a_per_mm = pow(middle + half * cos((j + 0.5) * M_PI / nodes), 2);
    u[j] = sqrtf128((quad)medium.sigma_a_per_mm);
    find_ln_R(s, &medium, waves, n, x, ln_R[j]);
  }
  for (size_t i = 0; i < n; i++) {
    const quad b = (ln_R[0][i] - ln_R[nodes - 1][i]) / (u[0] - u[nodes - 1]);
    complex_quad sum[2] = {0, 0};
    for (int j = 0; j < nodes; j++) {
      complex_quad weight[2] = {1, 1};
      for (int k = 0; k < nodes; k++) {
        weight[0] *= k == j ? 1 : (there - u[k]) / (u[j] - u[k]);
        weight[1] *= k == j ? 1 : (here - u[k]) / (u[j] - u[k]);
      }
      const quad value = expf128(ln_R[j][i] - ln_R[0][i] - b * (u[j] - u[0]));
      sum[0] += weight[0] * value;
      sum[1] += weight[1] * value;
    }
    truth[0][i] = -(b * cimagf128(there) + cargf128(sum[0])) * 180 / M_PIf128;
    truth[1][i] = cabsf128(sum[0] / sum[1]) * expf128(b * (crealf128(there) - here));
  }
}

/* Modulated light of a random frequency, about as fast as sigma_a or sigma_t' is large. */
static void check_modulated(struct subject *s, uint64_t *random) {
  static const int of_form[] = {LIGHT_NODES, 27, 18}, of_solver[] = {12, 10, 8};
  const int *nodes = s->family == FORM_TRANSPORT ? of_solver : of_form;
  const size_t n = s->family == FORM_DIPOLE || s->family == FORM_TRANSPORT ? LIGHT_RADII : 6;
  const double per_mhz = 2e-6 * M_PI * s->medium.eta / 0.299792458;
  const double scale = below(random, 2) ? s->medium.sigma_a_per_mm : core_sigma_t_prime(&s->medium);
  const double mhz = scale * log_between(random, 1e-4, 10) / per_mhz;
  double x[LIGHT_RADII];
  quad truth[2][LIGHT_RADII], fewer[2][LIGHT_RADII], fewest[2][LIGHT_RADII];
  struct subject light = *s;
  light.parameters.value[CORE_PARAMETER_MHZ] = mhz;
  light.parameters.value[CORE_PARAMETER_TOLERANCE] = (double)NAN;
  for (int waves = 0; waves < (s->family == FORM_DIPOLE ? 2 : 1); waves++) {
    for (size_t i = 0; i < n; i++) {
      const double mfp = log_between(random, 1e-3, 300) / core_sigma_t_prime(&s->medium);
      x[i] = (double)(float)(waves ? 0.1 / mfp : mfp);
    }
    continue_form(s, per_mhz * mhz, nodes[0], waves, n, x, truth);
    continue_form(s, per_mhz * mhz, nodes[1], waves, n, x, fewer);
    continue_form(s, per_mhz * mhz, nodes[2], waves, n, x, fewest);
    for (enum evaluator e = F64; e <= (below(random, 4) == 0 ? F32 : F64); e++) {
      if (core_profile_prepare(&light.profiles[e], core_isa_select(NULL), models[s->model],
                               s->moments, evaluator_ids[e], &s->medium, &light.parameters)
              .field != NULL) {
        continue;
      }
      for (size_t i = 0; i < 2 * n; i++) {
        const int angle = i % 2 == 0 ? 0 : 1;
        const quad known = truth[angle][i / 2];
        const quad unsure =
            fmaxf128(fabsf128(known - fewer[angle][i / 2]), fabsf128(known - fewest[angle][i / 2]));
        compare_light(&light, e, (waves ? PHASE_F : PHASE) + angle, x[i / 2], truth[angle][i / 2],
                      unsure);
      }
      check_range(&light, e, &light.profiles[e], random);
      core_profile_free(&light.profiles[e]);
    }
  }
}

/* A half space, by the table or solved, is the same as two layers that it is cut into, within what both
 * state: R, path lengths, which are those of both layers, and modulated light. */
static void check_layers(struct subject *s, uint64_t *random) {
  static const enum core_quantity asked[] = {CORE_QUANTITY_R,           CORE_QUANTITY_TRANSFER,
                                             CORE_QUANTITY_PATH,        CORE_QUANTITY_PHASE,
                                             CORE_QUANTITY_MODULATION,  CORE_QUANTITY_PHASE_F,
                                             CORE_QUANTITY_MODULATION_F};
  enum { WHOLE, UPPER, LOWER, PROFILES };
  const double mfp_mm = 1 / core_sigma_t_prime(&s->medium);
  const bool modulated = below(random, 3) == 0;
  core_medium layer[2] = {s->medium, s->medium};
  core_profile profiles[PROFILES];
  core_parameters parameters = core_parameters_none();
  int ready = 0;
  layer[0].thickness_mm = mfp_mm * log_between(random, 0.02, 20);
  parameters.value[modulated ? CORE_PARAMETER_MHZ : CORE_PARAMETER_DERIVATIVES] =
      modulated ? log_between(random, 0.01, 1) / mfp_mm * 1e4 / s->medium.eta : 1;
  parameters.value[CORE_PARAMETER_TOLERANCE] =
      below(random, 2) ? log_between(random, 3e-4, 0.03) : (double)NAN;
  for (; ready < (modulated ? LOWER : PROFILES); ready++) {
    parameters.layer_count = ready == WHOLE ? 1 : 2;
    parameters.value[CORE_PARAMETER_DERIVATIVE_LAYER] =
        ready == WHOLE || modulated ? (double)NAN : ready;
    if (core_profile_prepare(&profiles[ready], core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                             s->moments, CORE_EVALUATOR_F64, ready == WHOLE ? &s->medium : layer,
                             &parameters)
            .field != NULL) {
      break;
    }
  }
  for (int i = 0; i < 60 && ready == (modulated ? LOWER : PROFILES); i++) {
    const size_t first = modulated ? 3 : 0;
    const enum core_quantity quantity = asked[first + below(random, modulated ? 4 : 3)];
    const double mfp = log_between(random, 1e-2, 30);
    const bool waves = (quantity & (CORE_QUANTITY_TRANSFER | CORE_MODULATED_F)) != 0;
    const double x = waves ? 0.1 / (mfp * mfp_mm) : mfp * mfp_mm;
    double value[PROFILES], allowed = 0;
    for (int k = 0; k < ready; k++) {
      const core_stated_errors stated =
          core_profile_errors(&profiles[k], quantity, (core_radii_range){x, x});
      core_eval_f64(&profiles[k], quantity, 1, &x, &value[k]);
      allowed += (stated.numerical + stated.numerical_per_mm * x) *
                 (quantity == CORE_QUANTITY_R          ? value[k]
                  : quantity == CORE_QUANTITY_TRANSFER ? profiles[k].albedo
                                                       : 1);
    }
    const double cut = value[UPPER] + (quantity == CORE_QUANTITY_PATH ? value[LOWER] : 0);
    const double share = fabs(cut - value[WHOLE]) / (allowed + DBL_MIN);
    if (allowed < (double)INFINITY) {
      count(s, F64, LAYERS, share <= 1, share, x, cut, value[WHOLE]);
    }
  }
  while (ready > 0) {
    check_range(s, F64, &profiles[--ready], random);
    core_profile_free(&profiles[ready]);
  }
}

/* ---- odd layers ---------------------------------------------------------------------------------- */

enum { ODD = INT32_MAX }; /* in place of a model's number */

/* Draws layers at the limits of what is taken. */
static void draw_odd_layers(core_medium layer[CORE_LAYERS_MAX], core_parameters *to,
                            uint64_t *random) {
  const double strongest = log_between(random, 1e-3, 1e3);
  const bool steps = below(random, 3) > 0, deep = below(random, 2);
  *to = core_parameters_none();
  to->layer_count = 1 + (uint32_t)below(random, CORE_LAYERS_MAX - 1);
  to->value[CORE_PARAMETER_TOLERANCE] = 1;
  for (uint32_t i = 0; i < to->layer_count; i++) {
    const bool last = i + 1 == to->layer_count, weak = last && below(random, 2);
    const double sigma_t =
        weak ? log_between(random, 1e-14, 1e3) : strongest * log_between(random, 0.0201, 1);
    const double least = log_between(random, 1e-14, 1);
    const double absorbs[] = {0, 1, least, 1 - least, core_splitmix_f64(random)};
    const double absorbed = sigma_t * absorbs[below(random, 5)];
    const double gs[] = {0, 0.99, -0.99, between(random, -0.99, 0.99)};
    const double etas[] = {1, 1.4, 0.25, 4, log_between(random, 0.25, 4)};
    const double depths[] = {1.001e-4, 9.99e3, log_between(random, 1.001e-4, 9.99e3)};
    core_medium medium = {absorbed, sigma_t - absorbed, gs[below(random, 4)],
                          steps ? etas[below(random, 5)] : 1.4};
    medium.thickness_mm = last && deep ? 0 : depths[below(random, 3)] / core_sigma_t_prime(&medium);
    layer[i] = medium;
  }
}

/* Layers are prepared whole, and with one of them cut in two: whatever is answered is finite and not
 * negative, the shares of the energy have the sum 1, and both have the same R and T within what they
 * state. */
static void check_odd_layers(uint64_t *random) {
  struct subject s = {.moments = CORE_MOMENTS_EXACT};
  core_medium layer[2][CORE_LAYERS_MAX];
  core_profile profiles[2];
  draw_odd_layers(layer[0], &s.parameters, random);
  const uint32_t count_of = s.parameters.layer_count;
  const uint32_t at = (uint32_t)below(random, count_of);
  const bool finite = layer[0][count_of - 1].thickness_mm > 0;
  s.medium = layer[0][0];
  while (models[s.model] != CORE_MODEL_TRANSPORT) {
    s.model++;
  }
  memcpy(layer[1], layer[0], at * sizeof *layer[0]);
  memcpy(&layer[1][at + 1], &layer[0][at], (count_of - at) * sizeof *layer[0]);
  core_medium *cut = &layer[1][at];
  *cut = cut[1];
  cut->thickness_mm = between(random, 0.1, 0.9) *
                      (cut->thickness_mm > 0 ? cut->thickness_mm : 1 / core_sigma_t_prime(cut));
  cut[1].thickness_mm -= cut[1].thickness_mm > 0 ? cut->thickness_mm : 0;
  size_t ready = 0;
  for (; ready < 2; ready++) {
    s.parameters.layer_count = count_of + (uint32_t)ready;
    if (core_profile_prepare(&profiles[ready], core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                             s.moments, CORE_EVALUATOR_F64, layer[ready], &s.parameters)
            .field != NULL) {
      break;
    }
    const core_profile *p = &profiles[ready];
    double sum = 0, least = 0;
    for (size_t i = 0; i < CORE_BALANCE_SHARES; i++) {
      sum += p->balance[i];
      least = fmin(least, p->balance[i]);
    }
    const double off = fmax(fabs(sum - 1), -least);
    count(&s, F64, ODD_LAYERS, off <= 1e-7 + 4 * p->balance_error, 0, -1, sum, least);
  }
  for (double mfp = 1e-3; mfp < 1e3 && ready > 0; mfp *= 3) {
    for (int side = 0; side < (finite ? 2 : 1); side++) {
      const enum core_quantity quantity = side == 0 ? CORE_QUANTITY_R : CORE_QUANTITY_T;
      const double r = mfp / core_sigma_t_prime(&s.medium);
      double value[2], allowed = 0;
      for (size_t i = 0; i < ready; i++) {
        const core_stated_errors stated =
            core_profile_errors(&profiles[i], quantity, (core_radii_range){r, r});
        core_eval_f64(&profiles[i], quantity, 1, &r, &value[i]);
        allowed += (stated.numerical + stated.numerical_per_mm * r) * value[i];
        count(&s, F64, ODD_LAYERS, value[i] >= 0 && isfinite(value[i]) && stated.numerical >= 0, 0,
              r, value[i], stated.numerical);
      }
      if (ready == 2 && isfinite(allowed)) {
        const double share = fabs(value[1] - value[0]) / (allowed + DBL_MIN);
        count(&s, F64, ODD_LAYERS, share <= 1, share, r, value[1], value[0]);
      }
    }
  }
  while (ready > 0) {
    core_profile_free(&profiles[--ready]);
  }
}

/* ---- known values -------------------------------------------------------------------------------- */

#define KNOWN_FILE "tests/accuracy/known.csv"
enum { KNOWN_COLUMNS = 15, KNOWN_BYTES = 512 };

static unsigned id_of(const core_choice *list, const char *name) {
  const core_choice *choice = core_choice_by_name(list, name);
  if (choice == NULL) {
    fprintf(stderr, "truth: %s: %s is unknown\n", KNOWN_FILE, name);
    exit(2);
  }
  return choice->id;
}

static double number(const char *text, double otherwise) {
  return *text != '\0' ? strtod(text, NULL) : otherwise;
}

/* Prepares the request of a row, whose columns stand in the file's first line, unless it is that of
 * the row before. */
static void prepare_known(struct subject *s, enum evaluator e, char *const column[KNOWN_COLUMNS]) {
  static char before[KNOWN_BYTES];
  const size_t bytes = (size_t)(column[11] - column[1]); /* of the names and numbers of a request */
  core_profile *profile = &s->profiles[e];
  if (s->ready[e] && memcmp(before, column[1], bytes) == 0) {
    return;
  }
  memcpy(before, column[1], bytes);
  for (int i = 0; i < EVALUATORS; i++) {
    if (s->ready[i]) {
      core_profile_free(&s->profiles[i]);
      s->ready[i] = false;
    }
  }
  const unsigned id = id_of(core_models, column[1]);
  for (s->model = 0; models[s->model] != id; s->model++) {
  }
  s->moments = id_of(core_moments_list, column[2]);
  s->medium = (core_medium){number(column[3], 0), number(column[4], 0), number(column[5], 0),
                            number(column[6], 0), number(column[8], 0)};
  s->parameters = core_parameters_none();
  s->parameters.value[CORE_PARAMETER_TOLERANCE] = number(column[7], (double)NAN);
  s->parameters.value[CORE_PARAMETER_COS_IN] = s->parameters.value[CORE_PARAMETER_COS_OUT] =
      number(column[9], 1);
  s->ready[e] = core_profile_prepare(profile, core_isa_select(NULL), id, s->moments,
                                     evaluator_ids[e], &s->medium, &s->parameters)
                    .field == NULL;
  form_prepare(&s->form, id, s->moments, &s->medium, &s->parameters);
}

/* Compares the cdf at the radius that is sampled for u with the truth. For `beam`, whose cdf has no
 * closed form, it is the profile's own cdf. */
static void compare_known_sample(const struct subject *s, enum evaluator e, double u, quad truth) {
  const core_profile *profile = &s->profiles[e];
  const float narrow_u = (float)u;
  float narrow_r;
  double r;
  if (e == F64) {
    core_sample_f64(profile, 1, &u, &r);
  } else {
    core_sample_f32(profile, 1, &narrow_u, &narrow_r);
    r = (double)narrow_r;
  }
  double cdf = (double)form_truth(&s->form, form_at(&s->form, r, false), CORE_ELEMENTWISE_CDF, r);
  if (isnan(cdf)) {
    evaluate(profile, CORE_QUANTITY_CDF, 1, &r, &cdf);
  }
  const double allowed = (e == F64 ? CORE_SAMPLE_ERROR_F64 : CORE_SAMPLE_ERROR_F32) +
                         profile->numerical_error + profile->numerical_error_per_mm * r;
  const double off = fabs(cdf - (double)truth);
  count(s, e, SAMPLE, off <= allowed, off / allowed, u, cdf, (double)truth);
}

static void compare_known(char *const column[KNOWN_COLUMNS]) {
  static struct subject s;
  const double at = number(column[12], 0);
  const quad truth = (quad)strtold(column[13], NULL), size = fabsf128(truth);
  const quad error = (quad)number(column[14], 0) * size;
  int e = F64, q = 0;
  while (strcmp(column[10], evaluator_names[e]) != 0) {
    e++; /* a wrong name runs into the assertion */
    assert(e <= LUT);
  }
  while (strcmp(column[11], check_names[q]) != 0) {
    q++;
    assert(q <= SAMPLE);
  }
  prepare_known(&s, e, column);
  const core_profile *profile = &s.profiles[e];
  if (!s.ready[e]) {
    count(&s, e, q, false, (double)INFINITY, at, (double)NAN, (double)truth);
  } else if (q == SAMPLE) {
    compare_known_sample(&s, e, at, truth);
  } else if (q == ALBEDO) {
    compare(&s, e, q, 0, profile->albedo, truth, error);
  } else {
    double value;
    evaluate(profile, quantities[q], 1, &at, &value);
    const core_stated_errors stated =
        core_profile_errors(profile, quantities[q], (core_radii_range){at, at});
    const quad by_radius = form_allowed(profile, q, at, size);
    const quad beyond = s.form.known ? 0 : fmaxf128((quad)stated.numerical * size - by_radius, 0);
    compare(&s, e, q, at, value, truth, error + beyond);
  }
}

/* Compares with the rows of each `step`th group, from group `first` on. */
static void replay(size_t first, size_t step) {
  enum { GROUP = 12 };
  char line[KNOWN_BYTES];
  FILE *file = fopen(KNOWN_FILE, "r");
  if (file == NULL || fgets(line, sizeof line, file) == NULL) {
    fprintf(stderr, "truth: %s is not here: run truth in the repository's root\n", KNOWN_FILE);
    exit(2);
  }
  for (size_t row = 0; fgets(line, sizeof line, file) != NULL; row++) {
    char *column[KNOWN_COLUMNS], *rest = line;
    for (int i = 0; i < KNOWN_COLUMNS; i++) {
      assert(rest != NULL);
      column[i] = strsep(&rest, ",\n");
    }
    if (row / GROUP % step == first) {
      compare_known(column);
    }
  }
  fclose(file);
}

/* ---- drawing ------------------------------------------------------------------------------------ */

enum { ETAS = 64 };

static double etas[ETAS];

static void draw_etas(uint64_t *random) {
  for (int i = 0; i < ETAS; i++) {
    etas[i] = i == 0          ? 1
              : i == ETAS - 2 ? CORE_ETA_MIN
              : i == ETAS - 1 ? CORE_ETA_MAX
              : i < ETAS / 2  ? 1 + 0.02 * (double)below(random, 60)
              : i < ETAS - 24 ? log_between(random, CORE_ETA_MIN, CORE_ETA_MAX)
              : i < ETAS - 12 ? log_between(random, 5, CORE_ETA_MAX)
              : i % 2 == 0    ? 1 + log_between(random, 1e-15, 0.01)
                              : 1 - log_between(random, 1e-15, 0.01);
    /* The workers have what is integrated here. */
    reference_fresnel_moments(CORE_MOMENTS_EXACT, etas[i]);
    reference_fresnel_moments(CORE_MOMENTS_EXACT, 1 / etas[i]);
  }
}

/* A medium at the ends of the domain. */
static core_medium draw_end(uint64_t *random) {
  static const double sigmas[] = {1.1e-15, 1, 9e14}, gs[] = {0, -.99, .999};
  static const double shares[] = {1, 1 / (1 + 1e-12), .5, 1 / (1 + 1e6), 0}; /* of sigma_s' */
  static const size_t ends[] = {0, ETAS - 2, ETAS - 1};
  const double sigma = sigmas[below(random, 3)], share = shares[below(random, 5)];
  const double g = gs[below(random, 3)];
  return (core_medium){sigma * (1 - share), fmin(sigma * share / (1 - g), CORE_SIGMA_MAX_PER_MM), g,
                       etas[ends[below(random, 3)]]};
}

static core_medium draw_medium(enum form_family family, uint64_t *random) {
  if (family == FORM_DIPOLE && below(random, 6) == 0) {
    return draw_end(random);
  }
  const bool usual = below(random, 3) > 0;
  const double sigma_t = usual ? log_between(random, 1e-2, 1e2) : log_between(random, 1e-14, 1e14);
  const size_t absorbs = below(random, 8);
  const double ratio = usual          ? log_between(random, 1e-5, 10)
                       : absorbs == 0 ? log_between(random, 1e-250, 1e31)
                       : absorbs == 1 ? log_between(random, 1e-60, 1e-20)
                                      : log_between(random, 1e-30, 1e12);
  const size_t kind = below(random, 8);
  const double g = between(random, -1, 1);
  core_medium medium = {.eta = etas[below(random, usual && below(random, 4) ? ETAS / 2 : ETAS)]};
  const double nearly_1 = 1 - log_between(random, 1e-12, 1);
  medium.g = kind < 4 ? 0 : usual ? 0.95 * g : kind < 6 ? g : kind < 7 ? nearly_1 : -nearly_1;
  medium.sigma_s_per_mm = fmin(sigma_t / (1 - medium.g) / (1 + ratio), CORE_SIGMA_MAX_PER_MM);
  medium.sigma_a_per_mm = kind == 3 ? 0 : sigma_t * (ratio / (1 + ratio));
  return medium;
}

static core_parameters draw_parameters(struct subject *s, uint64_t *random) {
  core_parameters parameters = core_parameters_none();
  double *value = parameters.value;
  value[CORE_PARAMETER_COS_IN] = between(random, 0, 1);
  value[CORE_PARAMETER_COS_OUT] = between(random, 0, 1);
  if (s->family == FORM_SLAB) {
    const size_t kind = below(random, 3);
    const double least = kind == 0 ? 1.1001 : 1.11, most = kind == 0 ? 2 : kind == 1 ? 100 : 0.99e6;
    s->medium.thickness_mm = log_between(random, least, most) / core_sigma_t_prime(&s->medium);
  }
  if (s->family == FORM_BURLEY && below(random, 2)) {
    value[CORE_PARAMETER_SURFACE_ALBEDO] = between(random, 0, 1);
  }
  return parameters;
}

/* Radii around the medium's own scale and, one in ten, around its decay length, which counts up to
 * 1e26 mean free paths: the forms reach not much further. Dipoles, whose forms reach anywhere, also
 * get the ends of both number formats. */
static double draw_radius(const struct subject *s, bool narrow, uint64_t *random) {
  static const double ends[][2] = {{1e-3, 1e2},   {1e-2, 1e3}, {1e-12, 1e6},
                                   {1e-30, 1e30}, {1e2, 1e4},  {1e-4, 1e2}};
  static const double of_numbers[] = {-0.0,  5e-324, 1e-310, 1e-300, 1e-160, 1e-45, 1e-40,
                                      1e-38, 1e-20,  1e18,   1e19,   1e20,   1e30,  1.7e38,
                                      3e38,  1e75,   1e100,  1e150,  1e155,  1e300, DBL_MAX};
  if (s->family == FORM_DIPOLE && below(random, 6) == 0) {
    const double r = of_numbers[below(random, sizeof of_numbers / sizeof of_numbers[0])];
    return narrow ? (double)(float)r : r;
  }
  const form_part *part = &s->form.part[0];
  const double per_mm = fmax((double)part->mu, 1e-26) * (double)part->sigma_t_prime;
  const size_t kind = below(random, 66);
  const size_t range = kind < 25   ? 0
                       : kind < 38 ? 1
                       : kind < 46 ? 2
                       : kind < 50 ? 3
                       : kind < 60 ? 4
                                   : 5;
  const double scale_mm = range == 5 ? 1 / per_mm : s->profiles[FINE].scale_mm;
  const double r = scale_mm * log_between(random, ends[range][0], ends[range][1]);
  return kind == 59 ? 0 : kind == 58 ? (double)INFINITY : narrow ? (double)(float)r : r;
}

/* Returns a radius where R is next to the largest or smallest numbers of a precision. */
static double draw_edge(const core_profile *fine, bool narrow, uint64_t *random) {
  static const double ln_R[2][6] = {{709.79, 709.77, -708.3, -712, -730, -742},
                                    {88.73, 88.71, -87.2, -90, -96, -102}};
  const double wanted = ln_R[narrow][below(random, 6)];
  const double mfp_mm = 1 / core_sigma_t_prime(&fine->medium);
  double least = 1e-45 * mfp_mm, most = 1e6 * mfp_mm, found;
  for (int i = 0; i < 80; i++) {
    const double r = sqrt(least) * sqrt(most);
    core_eval_f64(fine, CORE_QUANTITY_LN_R, 1, &r, &found);
    *(found > wanted ? &least : &most) = r;
  }
  return narrow ? (double)(float)least : least;
}

static void prepare(struct subject *s, enum evaluator e, double tolerance) {
  core_parameters parameters = s->parameters;
  parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  const bool judge = e == FINE && s->family == FORM_FIT;
  s->ready[e] = core_profile_prepare(&s->profiles[e], core_isa_select(NULL),
                                     judge ? CORE_MODEL_BETTER : models[s->model], s->moments,
                                     evaluator_ids[e], &s->medium, &parameters)
                    .field == NULL;
  if (s->ready[e] && models[s->model] == CORE_MODEL_TRANSPORT) {
    /* The table's error for g other than 0 is common to all evaluators: test_transport_g.c looks for
     * it. What is left is each evaluator's own. */
    core_added_errors added;
    core_transport_added_errors(&s->medium, &added);
    s->profiles[e].numerical_error -= added.all;
  }
}

/* ---- the campaign ------------------------------------------------------------------------------- */

/* Radii that are compared with the formula, by the time that it takes. */
static size_t exact_radii(enum form_family family) {
  switch (family) {
  case FORM_DIPOLE:
  case FORM_BURLEY:
  case FORM_SKIN:
    return EXACT_MOST;
  case FORM_SLAB:
    return 8;
  default:
    return 24;
  }
}

static void compare_subject(struct subject *s, uint64_t *random) {
  static struct values values;
  const size_t exact = s->form.known ? exact_radii(s->family) : 0;
  values.count = exact + DENSE;
  for (size_t i = 0; i < values.count; i++) {
    const bool narrow = i == 1 || i >= exact || below(random, 4) > 0;
    values.r[i] = exact > 0 && i < 2 ? draw_edge(&s->profiles[FINE], i == 1, random)
                                     : draw_radius(s, narrow, random);
    const double scale_mm = s->profiles[FINE].scale_mm;
    const double f = below(random, 8) ? values.r[i] / scale_mm / scale_mm
                                      : log_between(random, 1e-20, 1e-2) / scale_mm;
    values.f[i] = narrow ? (double)(float)f : f;
  }
  for (int e = 0; e < EVALUATORS; e++) {
    for (int q = 0; s->ready[e] && q < CORE_ELEMENTWISE_COUNT; q++) {
      if (is_derivative(q) && !s->derivatives) {
        continue;
      }
      const bool waves = q == CORE_ELEMENTWISE_TRANSFER;
      evaluate(&s->profiles[e], quantities[q], values.count, waves ? values.f : values.r,
               values.of[e][q]);
    }
  }
  for (size_t i = 0; i < exact; i++) {
    compare_exactly(s, &values, i, form_at(&s->form, values.r[i], i % 24 > 0), -1, 0);
  }
  if (s->derivatives && s->form.known) {
    compare_derivatives(s, &values, exact < 8 ? exact : 8);
  }
  compare_densely(s, &values, exact);
  for (int e = 0; e < EVALUATORS; e++) {
    if (s->ready[e] && s->form.known) {
      compare(s, e, ALBEDO, 0, s->profiles[e].albedo, s->form.albedo, 0);
    }
    if (s->ready[e] && e != FINE) {
      check_end(s, e, random);
      check_range(s, e, &s->profiles[e], random);
      if (s->form.known) {
        check_samples(s, e, random);
      }
    }
  }
}

/* Draws a subject of a model. `slow` is true in rounds that prepare what takes long. */
static void draw_subject(size_t model, bool slow, bool table, uint64_t *random) {
  static struct subject s;
  s.model = model;
  s.family = form_family_of(models[model]);
  s.medium = draw_medium(s.family, random);
  s.moments = 1 + (unsigned)below(random, 4);
  s.moments =
      core_fresnel_check(s.moments, s.medium.eta).field == NULL ? s.moments : CORE_MOMENTS_EXACT;
  s.derivatives = core_has_derivatives(models[model]) && below(random, 4) == 0;
  s.parameters = draw_parameters(&s, random);
  s.parameters.value[CORE_PARAMETER_DERIVATIVES] = s.derivatives ? 1 : (double)NAN;
  memset(s.ready, 0, sizeof s.ready);
  const bool fit = s.family == FORM_FIT, transport = s.family == FORM_TRANSPORT;
  const bool given = !fit && below(random, 2);
  const double tolerance = given ? log_between(random, transport ? 2e-3 : 1e-12, 0.1) : (double)NAN;
  if ((fit || transport) && !slow) {
    return;
  }
  prepare(&s, F64, tolerance);
  s.parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  if (!s.ready[F64]) {
    return;
  }
  prepare(&s, F32, tolerance);
  if (table) {
    const double asked = given ? log_between(random, CORE_LUT_TOLERANCE_MIN, 1e-2) : (double)NAN;
    const double most = given ? asked : CORE_LUT_TOLERANCE;
    prepare(&s, LUT, asked);
    if (s.ready[LUT] && !fit && !transport) { /* those state more of their own */
      const double stated = s.profiles[LUT].numerical_error;
      count(&s, LUT, TOLERANCE, stated <= most, stated / most, most, stated, most);
    }
  }
  prepare(&s, FINE, transport || fit ? (double)NAN : 1e-12);
  form_prepare(&s.form, models[model], s.moments, &s.medium, &s.parameters);
  s.judged =
      transport ? (core_radii_range){0, 20 * s.profiles[F64].scale_mm} : s.profiles[F64].radii;
  if (s.ready[FINE]) {
    compare_subject(&s, random);
    if (s.form.known && below(random, 4) == 0) {
      check_inversion(&s, random);
    }
    core_radii_range range;
    core_parameters light = s.parameters;
    light.value[CORE_PARAMETER_MHZ] = 0;
    const bool known = s.form.known || (transport && s.medium.g == 0);
    if (known && s.medium.sigma_s_per_mm > 0 && (transport || below(random, 4) == 0) &&
        core_profile_check(models[model], s.moments, CORE_EVALUATOR_F64, &s.medium, &light, &range)
                .field == NULL) {
      check_modulated(&s, random);
    }
    if (transport && s.medium.sigma_s_per_mm > 0) {
      check_layers(&s, random);
    }
  }
  for (int e = 0; e < EVALUATORS; e++) {
    if (s.ready[e]) {
      core_profile_free(&s.profiles[e]);
    }
  }
}

/* ---- the stated errors of models ----------------------------------------------------------------- */

enum { SOLVED = 60, RANGES = 40 };

/* Solutions of transport at rising radii, for one medium whose sigma_t' is 1 per mm. */
struct solved {
  double r[SOLVED], R[SOLVED], albedo;
};

static void solve(struct solved *solved, const core_medium *medium, uint64_t *random) {
  isotropic_solution *solution =
      isotropic_solve(medium->eta, medium->sigma_s_per_mm, 1e-6, ISOTROPIC_REACH);
  for (size_t i = 0; i < SOLVED; i++) {
    solved->r[i] = log_between(random, 0.005, 40);
  }
  qsort(solved->r, SOLVED, sizeof solved->r[0], by_size);
  for (size_t i = 0; i < SOLVED; i++) {
    solved->R[i] = isotropic_at(solution, solved->r[i]).R;
  }
  solved->albedo = isotropic_total(solution);
  isotropic_free(solution);
}

/* Returns how far the wanted quantities of a profile are off at radii first to last. */
static double deviation(const core_profile *profile, const struct solved *solved, unsigned wanted,
                        size_t first, size_t last) {
  const size_t n = last - first + 1;
  const double *r = &solved->r[first], *R = &solved->R[first];
  double value[SOLVED];
  double worst =
      (wanted & CORE_QUANTITY_ALBEDO) != 0 ? fabs(profile->albedo / solved->albedo - 1) : 0;
  for (unsigned quantity = 1; quantity <= CORE_QUANTITY_RING; quantity *= 2) {
    if ((wanted & quantity) == 0 || (quantity & CORE_ARRAYS) == 0 ||
        quantity == CORE_QUANTITY_CDF) {
      continue;
    }
    core_eval_f64(profile, quantity, n, r, value);
    for (size_t i = 0; i < n; i++) {
      const double ring = 2 * (double)M_PI * r[i] * R[i];
      const double truth = quantity == CORE_QUANTITY_PDF    ? ring / solved->albedo
                           : quantity == CORE_QUANTITY_RING ? ring
                                                            : R[i];
      const double off =
          quantity == CORE_QUANTITY_LN_R ? fabs(value[i] - log(truth)) : fabs(value[i] / truth - 1);
      worst = fmax(worst, off);
    }
  }
  return worst;
}

/* No model is further from transport than it states for a request's radii and quantities. */
static void check_model_errors(uint64_t *random) {
  static const unsigned wants[] = {
      CORE_QUANTITY_R,      CORE_QUANTITY_RING,
      CORE_QUANTITY_ALBEDO, CORE_QUANTITY_R | CORE_QUANTITY_ALBEDO | CORE_QUANTITY_CDF,
      CORE_QUANTITY_PDF,    CORE_QUANTITY_LN_R};
  static struct subject s;
  struct solved solved;
  const double ratio = below(random, 6) == 0 ? 0
                       : below(random, 4)    ? log_between(random, 1e-4, 12)
                                             : log_between(random, 1e-8, 1e-4);
  const double eta =
      below(random, 4) ? between(random, 0.9, 2.1) : 1 + 0.5 * (double)below(random, 3);
  s.moments = CORE_MOMENTS_EXACT;
  s.medium = (core_medium){ratio / (1 + ratio), 1 / (1 + ratio), 0, eta};
  s.parameters = core_parameters_none();
  if (!core_transport_is_stored(&s.medium)) {
    return;
  }
  solve(&solved, &s.medium, random);
  core_profile ruler;
  if (core_profile_prepare(&ruler, core_isa_select(NULL), CORE_MODEL_TRANSPORT, s.moments,
                           CORE_EVALUATOR_F64, &s.medium, NULL)
          .field != NULL) {
    return;
  }
  for (s.model = 0; s.model < MODELS; s.model++) {
    core_profile *profile = &s.profiles[F64];
    if (models[s.model] == CORE_MODEL_TRANSPORT || /* what the others are held against */
        core_profile_prepare(profile, core_isa_select(NULL), models[s.model], s.moments,
                             CORE_EVALUATOR_F64, &s.medium, NULL)
                .field != NULL) {
      continue;
    }
    for (size_t i = 0; i < RANGES; i++) {
      const unsigned wanted = wants[below(random, sizeof wants / sizeof wants[0])];
      const size_t a = below(random, SOLVED), b = below(random, SOLVED);
      const size_t first = a < b ? a : b, last = a < b ? b : a;
      const core_radii_range range = {solved.r[first], solved.r[last]};
      const core_requested_radii asked = {
          {CORE_SPACING_LOGARITHMIC, CORE_GRID_COUNT_MAX, range.least_mm, range.most_mm},
          NULL,
          range};
      const double stated = core_model_error(profile, &ruler, wanted, &asked);
      if (isfinite(stated)) {
        const double off = deviation(profile, &solved, wanted, first, last);
        const double share =
            off / (stated + core_profile_errors(profile, wanted, range).numerical + 1e-6);
        count(&s, F64, MODEL_ERROR, share <= 1, share, solved.r[first], off, stated);
      }
    }
    core_profile_free(profile);
  }
  core_profile_free(&ruler);
}

static void run_round(uint64_t seed, unsigned only) {
  uint64_t random = seed + round_now * UINT64_C(0xd1342543de82ef95);
  core_splitmix(&random);
  for (size_t model = 0; model < MODELS; model++) {
    uint64_t own = core_splitmix(&random);
    if (only == 0 || only == models[model]) {
      const bool slow = (round_now + model) % 16 == 0 || only != 0;
      draw_subject(model, slow, (round_now + model) % 4 == 0, &own);
    }
  }
  if (only == 0 && round_now % 4 == 0) {
    check_model_errors(&random);
  }
  if (only == ODD || (only == 0 && round_now % 8 == 7)) {
    check_odd_layers(&random);
  }
}

static unsigned long long print_classes(const struct worker *workers, size_t count_of_workers) {
  unsigned long long values = 0, by_form = 0, violations = 0, of_f64 = 0;
  printf("%-30s %-4s %-11s %12s %12s %7s %s\n", "model", "", "", "values", "by formula", "worst",
         "violations");
  for (size_t model = 0; model < MODELS; model++) {
    for (int at = 0; at < EVALUATORS * CHECKS; at++) {
      struct class sum = {0};
      for (size_t w = 0; w < count_of_workers; w++) {
        const struct class *one = &workers[w].classes[model][at / CHECKS][at % CHECKS];
        sum.values += one->values;
        sum.by_form += one->by_form;
        sum.violations += one->violations;
        sum.worst = fmax(sum.worst, one->worst);
      }
      if (sum.values > 0) {
        printf("%-30s %-4s %-11s %12llu %12llu %7.3f %llu\n", model_name(model),
               at / CHECKS == FINE ? "fine" : evaluator_names[at / CHECKS],
               check_names[at % CHECKS], sum.values, sum.by_form, sum.worst, sum.violations);
      }
      values += sum.values;
      by_form += sum.by_form;
      of_f64 += at / CHECKS == F64 || at / CHECKS == FINE ? sum.values : 0;
      violations += sum.violations;
    }
  }
  printf("%llu rounds, %llu values (%llu of f64, %llu compared with the formula), %llu off by more "
         "than stated\n",
         *rounds_begun, values, of_f64, by_form, violations);
  return violations;
}

struct options {
  double seconds;
  unsigned long long rounds;
  uint64_t seed;
  unsigned only;
  size_t workers;
};

static void work(const struct options *options, double start_s) {
  while (now_s() - start_s < options->seconds) {
    round_now = __atomic_fetch_add(rounds_begun, 1, __ATOMIC_RELAXED);
    if (round_now >= options->rounds) {
      return;
    }
    run_round(options->seed, options->only);
  }
}

static void *shared(size_t bytes) {
  void *memory = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (memory == MAP_FAILED) {
    perror("mmap");
    exit(2);
  }
  return memory;
}

static struct options read_options(int argc, char **argv) {
  static const struct option names[] = {{"seconds", 1, NULL, 's'},
                                        {"rounds", 1, NULL, 'r'},
                                        {"seed", 1, NULL, 'e'},
                                        {"model", 1, NULL, 'm'},
                                        {"workers", 1, NULL, 'w'},
                                        {"odd", 0, NULL, 'o'},
                                        {0}};
  struct options options = {.seconds = (double)INFINITY,
                            .rounds = UINT64_MAX,
                            .seed = (uint64_t)(now_s() * 1e6),
                            .workers = (size_t)sysconf(_SC_NPROCESSORS_ONLN)};
  for (int c; (c = getopt_long(argc, argv, "", names, NULL)) != -1;) {
    switch (c) {
    case 's':
      options.seconds = atof(optarg);
      break;
    case 'r':
      options.rounds = strtoull(optarg, NULL, 0);
      break;
    case 'e':
      options.seed = strtoull(optarg, NULL, 0);
      break;
    case 'm':
      options.only = (unsigned)atoi(optarg);
      break;
    case 'o':
      options.only = ODD;
      break;
    case 'w':
      options.workers = (size_t)atoi(optarg);
      break;
    default:
      fprintf(stderr, "usage: truth [--seconds N | --rounds N] [--seed N] [--model ID | --odd] "
                      "[--workers N]\n");
      exit(2);
    }
  }
  if (isinf(options.seconds) && options.rounds == UINT64_MAX) {
    options.seconds = 60;
  }
  return options;
}

int main(int argc, char **argv) {
  const double start_s = now_s();
  const struct options options = read_options(argc, argv);
  printf("seed %llu\n", (unsigned long long)options.seed);
  uint64_t random = options.seed;
  draw_etas(&random);
  struct worker *workers = shared(options.workers * sizeof *workers);
  rounds_begun = shared(sizeof *rounds_begun);
  fflush(stdout);
  for (size_t w = 0; w < options.workers; w++) {
    const pid_t child = fork();
    if (child < 0) {
      perror("fork");
      return 2;
    }
    if (child == 0) {
      prctl(PR_SET_PDEATHSIG, SIGTERM);
      worker = &workers[w];
      if (options.only != ODD) {
        replay(w, options.workers);
      }
      work(&options, start_s);
      _exit(0);
    }
  }
  bool crashed = false;
  for (int status; wait(&status) > 0;) {
    crashed = crashed || status != 0;
  }
  const unsigned long long violations = print_classes(workers, options.workers);
  if (crashed) {
    printf("a worker has crashed\n");
  }
  return violations > 0 || crashed;
}
