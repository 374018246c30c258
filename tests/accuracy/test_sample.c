/* Drawing radii: core_sample_*() undoes the cdf, keeps the order of its
 * numbers, and is drawn from the density that CORE_QUANTITY_PDF gives. */
#include <float.h>
#include <math.h>

#include "tests/accuracy/reference.h"
#include "tests/unit/unit.h"

enum { EVALUATORS = 2, COUNT_MAX = 1000, RANDOM_MEDIA = 1500 };

#define MOST_U (1 - 1e-7) /* as far as the errors are promised */

static const unsigned evaluators[EVALUATORS] = {CORE_EVALUATOR_F64, CORE_EVALUATOR_F32};
static const double epsilons[EVALUATORS] = {DBL_EPSILON, FLT_EPSILON};
static const double promised[EVALUATORS] = {CORE_SAMPLE_ERROR_F64, CORE_SAMPLE_ERROR_F32};

/* The largest errors over all media. */
struct worst {
  double round_trip; /* |cdf(radius of u) - u| */
  double at_u;       /* the u and the medium that have it */
  core_medium at;
  double integral; /* |1 - integral of the pdf from 0 to infinity|, over its allowed error */
  double interval; /* |integral of the pdf between the radii of two u - difference of these u|, over
                    * its allowed error */
  size_t points;   /* number of round trips */
};

static struct worst worsts[EVALUATORS];

/* A profile as it is sampled, and the same in double precision to judge it by.
 */
struct subject {
  int e;
  core_profile profile;
  core_profile judge;
};

/* ---- both precisions ------------------------------------------------------------------------- */

static void sample(const struct subject *subject, size_t n, const double *u, double *r) {
  assert_true(n <= COUNT_MAX);
  if (subject->profile.evaluator == CORE_EVALUATOR_F64) {
    core_sample_f64(&subject->profile, n, u, r);
    return;
  }
  float u_f32[COUNT_MAX] = {0}, r_f32[COUNT_MAX];
  for (size_t i = 0; i < n; i++) {
    u_f32[i] = (float)u[i];
  }
  core_sample_f32(&subject->profile, n, u_f32, r_f32);
  for (size_t i = 0; i < n; i++) {
    r[i] = (double)r_f32[i];
  }
}

static double pdf(const struct subject *subject, double r) {
  if (subject->profile.evaluator == CORE_EVALUATOR_F64) {
    double value;
    core_eval_f64(&subject->profile, CORE_QUANTITY_PDF, 1, &r, &value);
    return value;
  }
  const float radius = (float)r;
  float value;
  core_eval_f32(&subject->profile, CORE_QUANTITY_PDF, 1, &radius, &value);
  return (double)value;
}

/* ---- the numbers to sample with -------------------------------------------------------------- */

static int ascending(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* Neighbours of a number, where the order is easiest to get wrong. */
static size_t add_cluster(double *u, size_t n, double middle, bool single) {
  for (int i = 0; i < 8; i++) {
    u[n++] = middle;
    middle = single ? (double)nextafterf((float)middle, 2) : nextafter(middle, 2);
  }
  return n;
}

/* From 0 to 1, dense in both tails and representable in the precision; in
 * order. */
static size_t fill_u(double *u, bool single, uint64_t *random) {
  static const double clusters[] = {1e-30, 1e-12, 1e-7, 1e-3, .1, .5, .9, .999, 1 - 1e-6};
  size_t n = 0;
  u[n++] = 0;
  for (int i = 0; i <= 140; i++) {
    u[n++] = pow(10, -i * (35.0 / 140));
    u[n++] = 1 - pow(10, -i * (7.0 / 140));
  }
  for (int i = 0; i < 60; i++) {
    u[n++] = unit_random_between(random, 0, 1);
    u[n++] = 1 - unit_random_log(random, 1e-17, 1);
    u[n++] = unit_random_log(random, 1e-300, 1);
  }
  for (size_t i = 0; i < n; i++) {
    u[i] = single ? (double)(float)u[i] : u[i];
  }
  for (size_t i = 0; i < sizeof clusters / sizeof clusters[0]; i++) {
    n = add_cluster(u, n, single ? (double)(float)clusters[i] : clusters[i], single);
  }
  assert_true(n <= COUNT_MAX);
  qsort(u, n, sizeof *u, ascending);
  return n;
}

/* ---- the round trip and the order ------------------------------------------------------------ */

static void fail_at(const struct subject *subject, const char *what, double u, double r,
                    double got) {
  const core_medium *m = &subject->profile.medium;
  fail_msg("%s, model %u %s moments %u: sigma_a %.17g sigma_s %.17g g %.17g "
           "eta %.17g u %.17g r "
           "%.17g: %.17g",
           what, subject->profile.model, subject->e == 0 ? "f64" : "f32", subject->profile.moments,
           m->sigma_a_per_mm, m->sigma_s_per_mm, m->g, m->eta, u, r, got);
}

static void check_round_trip(const struct subject *subject, const double *u, const double *r,
                             size_t n) {
  double cdf[COUNT_MAX];
  struct worst *worst = &worsts[subject->e];
  core_eval_f64(&subject->judge, CORE_QUANTITY_CDF, n, r, cdf);
  for (size_t i = 0; i < n; i++) {
    const double error = fabs(cdf[i] - u[i]);
    if (!(r[i] >= 0) || (isinf(r[i]) && u[i] < MOST_U)) {
      fail_at(subject, "no radius", u[i], r[i], cdf[i]);
    }
    if (u[i] > MOST_U) {
      continue;
    }
    worst->points++;
    if (!(error <= worst->round_trip)) {
      worst->round_trip = error;
      worst->at_u = u[i];
      worst->at = subject->profile.medium;
    }
  }
}

/* More u is never less r, but for rounding: where little is left beyond r, that
 * of 1 - u. */
static void check_order(const struct subject *subject, const double *u, const double *r, size_t n) {
  for (size_t i = 1; i < n; i++) {
    const double slack = 64 * epsilons[subject->e] / fmax(1 - u[i], epsilons[subject->e]);
    if (slack < 1 && r[i] < r[i - 1] * (1 - slack)) {
      fail_at(subject, "out of order", u[i], r[i], r[i - 1]);
    }
    if (u[i] <= MOST_U && u[i] - u[i - 1] > 2 * promised[subject->e]) {
      assert_true(r[i] > r[i - 1]);
    }
  }
}

/* The ends are exact; the smallest number and the largest below 1 are not taken
 * for them. */
static void check_ends(const struct subject *subject) {
  const bool f64 = subject->e == 0;
  const double u[] = {0, f64 ? 5e-324 : 0x1p-149, f64 ? 1e-300 : 0x1p-126,
                      1 - epsilons[subject->e] / 2, 1};
  double r[5];
  sample(subject, 5, u, r);
  assert_true(r[0] == 0 && !signbit(r[0]));
  assert_true(r[1] > 0 && r[2] > r[1] && r[3] > r[2] && isfinite(r[3]));
  assert_true(isinf(r[4]) && r[4] > 0);
}

/* ---- the density ----------------------------------------------------------------------------- */

enum { NODES = 16 };
static double nodes[NODES], weights[NODES]; /* Gauss and Legendre's, for [-1, 1] */

/* The roots of Legendre's polynomial by Newton's method. */
static void fill_nodes(void) {
  for (int i = 0; i < NODES; i++) {
    double x = cos(3.14159265358979324 * (i + 0.75) / (NODES + 0.5));
    double derivative = 0;
    for (int step = 0; step < 10; step++) {
      double before = 1, at = x;
      for (int k = 2; k <= NODES; k++) {
        const double next = ((2 * k - 1) * x * at - (k - 1) * before) / k;
        before = at;
        at = next;
      }
      derivative = NODES * (x * at - before) / (x * x - 1);
      x -= at / derivative;
    }
    nodes[i] = x;
    weights[i] = 2 / ((1 - x * x) * derivative * derivative);
  }
}

/* The integral of the pdf over a panel, over r or over ln r. */
static double integrate_linear(const struct subject *subject, double low, double high) {
  double sum = 0;
  for (int i = 0; i < NODES; i++) {
    sum += weights[i] * pdf(subject, low + (high - low) * (1 + nodes[i]) / 2);
  }
  return sum * (high - low) / 2;
}

static double integrate_logarithmic(const struct subject *subject, double low, double high) {
  const double width = log(high / low);
  double sum = 0;
  for (int i = 0; i < NODES; i++) {
    const double exact = low * exp(width * (1 + nodes[i]) / 2);
    const double r = subject->e == 0 ? exact : (double)(float)exact;
    sum += weights[i] * r * pdf(subject, r);
  }
  return sum * width / 2;
}

static double integrate(const struct subject *subject, double low, double high) {
  double sum = 0;
  for (double from = low; from < high;) {
    const double to = high < from * 1.5 ? high : from * 1.25;
    sum += integrate_logarithmic(subject, from, to);
    from = to;
  }
  return sum;
}

/* What is left beyond r: panels until R falls so far that nothing more comes.
 */
static double integrate_beyond(const struct subject *subject, double r) {
  double sum = 0;
  for (int i = 0; i < 40; i++) {
    const double next = integrate(subject, r, 2 * r);
    sum += next;
    if (!(next > 1e-18)) {
      break;
    }
    r *= 2;
  }
  return sum;
}

/* The pdf's own error, what rounding of the nodes adds to it, and the sampler's
 * at both ends. */
static double allowed_integral(const struct subject *subject, double probability, double r) {
  const core_profile *profile = &subject->profile;
  const double relative = profile->numerical_error + profile->numerical_error_per_mm * r;
  return 2 * promised[subject->e] + 2 * relative * probability;
}

static void check_density(const struct subject *subject) {
  enum { KNOTS = 12 };
  static const double u[KNOTS] = {1e-7, 1e-5, 1e-3, .01, .1,   .3,
                                  .5,   .7,   .9,   .99, .999, 1 - 0x1p-20};
  double rounded[KNOTS], r[KNOTS], sum = 0;
  struct worst *worst = &worsts[subject->e];
  for (int i = 0; i < KNOTS; i++) {
    rounded[i] = subject->e == 0 ? u[i] : (double)(float)u[i];
  }
  sample(subject, KNOTS, rounded, r);
  for (int i = 0; i < KNOTS; i++) {
    const double probability = rounded[i] - (i > 0 ? rounded[i - 1] : 0);
    const double integral =
        i > 0 ? integrate(subject, r[i - 1], r[i]) : integrate_linear(subject, 0, r[i]);
    const double share =
        fabs(integral - probability) / allowed_integral(subject, probability, r[i]);
    worst->interval = fmax(worst->interval, share);
    if (!(share <= 1)) {
      fail_at(subject, "integral of the pdf to u", rounded[i], r[i], integral - probability);
    }
    sum += integral;
  }
  sum += integrate_beyond(subject, r[KNOTS - 1]);
  const double share = fabs(1 - sum) / allowed_integral(subject, 1, r[KNOTS - 1]);
  worst->integral = fmax(worst->integral, share);
  if (!(share <= 1)) {
    fail_at(subject, "integral of the pdf", 1, INFINITY, sum - 1);
  }
}

/* ---- media ----------------------------------------------------------------------------------- */

typedef void subject_test(const struct subject *subject, uint64_t *random);

static void with_profile(unsigned model, unsigned moments, const core_medium *medium,
                         subject_test *test, uint64_t *random) {
  for (int e = 0; e < EVALUATORS; e++) {
    struct subject subject = {.e = e};
    const core_isa *best = core_isa_select(NULL);
    unit_assert_fault(
        core_profile_prepare(&subject.profile, best, model, moments, evaluators[e], medium, NULL),
        NULL, 0);
    unit_assert_fault(core_profile_prepare(&subject.judge, best, model, moments, CORE_EVALUATOR_F64,
                                           medium, NULL),
                      NULL, 0);
    test(&subject, random);
  }
}

static void with_members(const core_medium *medium, subject_test *test, uint64_t *random) {
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    for (const core_choice *moments = core_moments_list; moments->name != NULL; moments++) {
      if (reference_switches(model->id) >= 0 &&
          core_fresnel_check(moments->id, medium->eta).field == NULL) {
        with_profile(model->id, moments->id, medium, test, random);
      }
    }
  }
}

static core_medium make_medium(double sigma_t_prime, double ratio, double g, double eta) {
  const double sigma_s_prime = sigma_t_prime / (1 + ratio);
  return (core_medium){sigma_s_prime * ratio, sigma_s_prime / (1 - g), g, eta};
}

static void with_corners(subject_test *test, uint64_t *random) {
  static const double sigmas[] = {1e-6, 1, 1e6};
  static const double ratios[] = {0, 1e-12, 1e-9, 1e-6, 1e-4, .01, .3, 1, 30, 1e3, 1e6};
  static const double etas[] = {.2, .46, 1, 1.3, 2.2, 5};
  static const double gs[] = {-.99, .999};
  for (size_t s = 0; s < sizeof sigmas / sizeof sigmas[0]; s++) {
    for (size_t q = 0; q < sizeof ratios / sizeof ratios[0]; q++) {
      for (size_t e = 0; e < sizeof etas / sizeof etas[0]; e++) {
        const core_medium medium = make_medium(sigmas[s], ratios[q], gs[(s + q) % 2], etas[e]);
        with_members(&medium, test, random);
      }
    }
  }
}

static void with_random_media(subject_test *test, uint64_t *random, int count) {
  for (int i = 0; i < count; i++) {
    const double ratio =
        unit_random_below(random, 10) == 0 ? 0 : unit_random_log(random, 1e-12, 1e6);
    const core_medium medium =
        make_medium(unit_random_log(random, 1e-6, 1e6), ratio,
                    unit_random_between(random, -.99, .999), unit_random_log(random, .2, 5));
    const unsigned model = unit_random_below(random, 2) ? CORE_MODEL_BETTER : CORE_MODEL_CLASSICAL;
    with_profile(model, CORE_MOMENTS_EXACT, &medium, test, random);
  }
}

/* ---- the tests ------------------------------------------------------------------------------- */

static void check_samples(const struct subject *subject, uint64_t *random) {
  double u[COUNT_MAX], r[COUNT_MAX];
  const size_t n = fill_u(u, subject->e != 0, random);
  sample(subject, n, u, r);
  check_round_trip(subject, u, r, n);
  check_order(subject, u, r, n);
  check_ends(subject);
}

UNIT_TEST(samples_undo_the_cdf_in_order) {
  uint64_t random = unit_seed();
  with_corners(check_samples, &random);
  with_random_media(check_samples, &random, RANDOM_MEDIA);
  for (int e = 0; e < EVALUATORS; e++) {
    const struct worst *worst = &worsts[e];
    printf("%s sample: |cdf(r) - u| worst %.3g, bound %.3g, %zu points (u "
           "%.17g, sigma_a %.17g "
           "sigma_s %.17g g %.17g eta %.17g)\n",
           core_choice_by_id(core_evaluators, evaluators[e])->name, worst->round_trip, promised[e],
           worst->points, worst->at_u, worst->at.sigma_a_per_mm, worst->at.sigma_s_per_mm,
           worst->at.g, worst->at.eta);
  }
  for (int e = 0; e < EVALUATORS; e++) {
    assert_true(worsts[e].round_trip <= promised[e]);
  }
}

static void integrate_profile(const struct subject *subject, uint64_t *random) {
  (void)random;
  check_density(subject);
}

UNIT_TEST(pdf_integrates_to_the_samples_shares_and_to_1) {
  uint64_t random = unit_seed();
  fill_nodes();
  with_corners(integrate_profile, &random);
  with_random_media(integrate_profile, &random, RANDOM_MEDIA / 5);
  for (int e = 0; e < EVALUATORS; e++) {
    printf("%s pdf: integral between samples worst %.3f of what is allowed, "
           "from 0 to infinity "
           "%.3f\n",
           core_choice_by_id(core_evaluators, evaluators[e])->name, worsts[e].interval,
           worsts[e].integral);
  }
}

static void check_nothing(const struct subject *subject, uint64_t *random) {
  double u[COUNT_MAX], r[COUNT_MAX];
  const size_t n = fill_u(u, subject->e != 0, random);
  sample(subject, n, u, r);
  for (size_t i = 0; i < n; i++) {
    assert_true(r[i] == 0 && !signbit(r[i]));
  }
  assert_true(pdf(subject, 0) == 0 && pdf(subject, 1) == 0);
}

UNIT_TEST(nothing_scattered_gives_radius_0) {
  uint64_t random = unit_seed();
  static const core_medium media[] = {{1, 0, 0, 1.3}, {1e-6, 0, .5, .2}, {1e6, 0, -.9, 5}};
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    with_members(&media[i], check_nothing, &random);
  }
}
