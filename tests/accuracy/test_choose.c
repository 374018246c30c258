/* The choice of a model by tolerance: what is promised is held against transport, at media, radii
 * and tolerances that were drawn, not measured; and its edges.
 */
#include <math.h>
#include <time.h>

#include "core/choose.h"
#include "core/transport/transport.h"
#include "tests/unit/unit.h"

#define PI 3.14159265358979323846

/* ---- promises against transport -------------------------------------------------------------- */

/* Preparing for a medium takes most of the time. So the media are few and evenly spread over eta
 * and the ratio of sigma_a to sigma_s, which leaves smaller gaps than twice as many random ones
 * would, and each gets many requests. */
enum {
  ETAS = 12, /* the long form; a third of them otherwise */
  MEDIA_AN_ETA = 3,
  REQUESTS_A_MEDIUM = 60,
  RADII = 200,
  PROFILES_MAX = 1000,
  MEDIA_OF_ANY_G = 12
};

/* The quantities that depend on the radius. */
static const unsigned quantities[] = {CORE_QUANTITY_R, CORE_QUANTITY_RING, CORE_QUANTITY_PDF,
                                      CORE_QUANTITY_LN_R};
enum { QUANTITIES = sizeof quantities / sizeof quantities[0] };

#define KEPT_SHARE 0.995
#define MISSED_BY_AT_MOST 2.0

/* So that this says something of what was measured: so many choices, and so many promises of all
 * candidates, are another model's than transport, at least. */
#define OTHER_CHOICES 60
#define OTHER_PROMISES 2000

/* A profile, and its values at all radii of the medium as far as they have been needed. */
struct candidate {
  core_profile profile;
  double tolerance; /* that it was prepared to, NAN for the default */
  unsigned known;   /* bits of quantities */
  double value[QUANTITIES][RADII];
};

/* A medium, what transport says of it, and the profiles that it has been asked for. */
struct truth {
  core_medium medium;
  bool single; /* the precision of the requests */
  double r[RADII];
  double R[RADII];
  double albedo;
  struct candidate candidates[PROFILES_MAX];
  size_t candidate_count;
};

static int compare(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* A radius in mean free paths: equal chances per decade, or per length. */
static double draw_mfp(bool logarithmic, uint64_t *random) {
  return logarithmic ? unit_random_log(random, 0.010001, 19.999)
                     : unit_random_between(random, 0.010001, 19.999);
}

/* sigma_t' over four decades; the radii are exact in both precisions. */
static void draw_truth(struct truth *truth, transport_boundary *boundary, double eta, double ratio,
                       uint64_t *random) {
  const double scale = unit_random_log(random, 1e-2, 1e2);
  transport_solution *solution;
  *truth = (struct truth){
      .medium = {scale * ratio / (1 + ratio), scale / (1 + ratio), 0, eta},
      .single = unit_random_below(random, 2) == 1,
  };
  const double sigma_t = truth->medium.sigma_a_per_mm + truth->medium.sigma_s_per_mm;
  unit_assert_fault(transport_solve(&solution, boundary, truth->medium.sigma_s_per_mm / sigma_t),
                    NULL, 0);
  for (size_t i = 0; i < RADII; i++) {
    truth->r[i] = (double)(float)(draw_mfp(i % 2 == 0, random) / sigma_t);
  }
  qsort(truth->r, RADII, sizeof truth->r[0], compare);
  for (size_t i = 0; i < RADII; i++) {
    truth->R[i] = sigma_t * sigma_t * transport_at(solution, truth->r[i] * sigma_t).R.value;
  }
  truth->albedo = transport_total(solution).value;
  transport_solution_free(solution);
}

/* Whether two tolerances are the same; NAN is the default. */
static bool are_same(double a, double b) {
  return a == b || (isnan(a) && isnan(b));
}

/* Profiles are kept: transport takes its time. */
static struct candidate *candidate_of(struct truth *truth, const core_candidate *wanted) {
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = wanted->numerical_tolerance;
  for (size_t i = 0; i < truth->candidate_count; i++) {
    struct candidate *kept = &truth->candidates[i];
    if (kept->profile.model == wanted->model && kept->profile.evaluator == wanted->evaluator &&
        are_same(kept->tolerance, wanted->numerical_tolerance)) {
      return kept;
    }
  }
  assert_true(truth->candidate_count < PROFILES_MAX);
  struct candidate *made = &truth->candidates[truth->candidate_count++];
  made->known = 0;
  made->tolerance = wanted->numerical_tolerance;
  unit_assert_fault(core_profile_prepare(&made->profile, core_isa_select(NULL), wanted->model,
                                         CORE_MOMENTS_EXACT, wanted->evaluator, &truth->medium,
                                         &parameters),
                    NULL, 0);
  return made;
}

/* The values of a quantity at all radii. */
static const double *values_of(struct candidate *of, const struct truth *truth, size_t quantity) {
  const core_profile *profile = &of->profile;
  const unsigned bit = quantities[quantity];
  double *value = of->value[quantity];
  if ((of->known & bit) == 0 && profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, bit, RADII, truth->r, value);
  } else if ((of->known & bit) == 0) {
    float single[RADII], out[RADII];
    for (size_t i = 0; i < RADII; i++) {
      single[i] = (float)truth->r[i];
    }
    core_eval_f32(profile, bit, RADII, single, out);
    for (size_t i = 0; i < RADII; i++) {
      value[i] = (double)out[i];
    }
  }
  of->known |= bit;
  return value;
}

/* The deviation of one quantity from transport at radius i. */
static double deviation_at(const struct truth *truth, unsigned quantity, size_t i, double value) {
  const double r = truth->r[i], R = truth->R[i];
  switch (quantity) {
  case CORE_QUANTITY_R:
    return fabs(value / R - 1);
  case CORE_QUANTITY_RING:
    return fabs(value / (2 * PI * r * R) - 1);
  case CORE_QUANTITY_PDF:
    return fabs(value / (2 * PI * r * R / truth->albedo) - 1);
  default:
    return fabs(value - log(R));
  }
}

/* How far the wanted quantities are off from transport at radii[first..last]. */
static double deviation(struct candidate *of, const struct truth *truth, unsigned wanted,
                        size_t first, size_t last) {
  double worst =
      (wanted & CORE_QUANTITY_ALBEDO) != 0 ? fabs(of->profile.albedo / truth->albedo - 1) : 0;
  for (size_t q = 0; q < QUANTITIES; q++) {
    const double *value = (wanted & quantities[q]) != 0 ? values_of(of, truth, q) : NULL;
    for (size_t i = first; i <= last && value != NULL; i++) {
      worst = fmax(worst, deviation_at(truth, quantities[q], i, value[i]));
    }
  }
  return worst;
}

/* How promises were kept. */
struct tally {
  size_t promises;
  size_t kept;
  size_t transport;
  double most; /* the largest deviation, in tolerances */
};

static void count(struct tally *tally, const core_candidate *candidate, double off,
                  double tolerance) {
  tally->promises++;
  tally->kept += off <= tolerance;
  tally->transport += candidate->model == CORE_MODEL_TRANSPORT;
  tally->most = fmax(tally->most, off / tolerance);
}

/* One of the medium's radii. */
static size_t draw_radius(const struct truth *truth, bool logarithmic, uint64_t *random) {
  const double sigma_t =
      truth->medium.sigma_a_per_mm + truth->medium.sigma_s_per_mm * (1 - truth->medium.g);
  const double r = draw_mfp(logarithmic, random) / sigma_t;
  size_t i = 0;
  while (i + 1 < RADII && truth->r[i] < r) {
    i++;
  }
  return i;
}

static void ask(struct truth *truth, struct tally *chosen, struct tally *all, uint64_t *random) {
  static const unsigned wants[] = {
      CORE_QUANTITY_R,
      CORE_QUANTITY_R,
      CORE_QUANTITY_R | CORE_QUANTITY_RADIUS | CORE_QUANTITY_ALBEDO,
      CORE_QUANTITY_RING,
      CORE_QUANTITY_PDF,
      CORE_QUANTITY_LN_R,
  };
  core_candidate candidates[CORE_CANDIDATES_MAX];
  const bool logarithmic = unit_random_below(random, 2) == 1;
  const size_t a = draw_radius(truth, logarithmic, random);
  const size_t b = draw_radius(truth, logarithmic, random);
  const size_t first = a < b ? a : b, last = a < b ? b : a;
  const core_choose_request request = {
      .media = &truth->medium,
      .media_count = 1,
      .moments = CORE_MOMENTS_EXACT,
      .wanted = wants[unit_random_below(random, sizeof wants / sizeof wants[0])],
      .radii = {truth->r[first], truth->r[last]},
      .radius_count = (uint64_t)unit_random_log(random, 1, 1e9),
      .single = truth->single,
      .tolerance = unit_random_log(random, 1e-3, 0.5),
  };
  const size_t candidate_count = core_choose(&request, candidates);
  for (size_t i = 0; i < candidate_count && candidates[i].meets; i++) {
    const double off =
        deviation(candidate_of(truth, &candidates[i]), truth, request.wanted, first, last);
    count(all, &candidates[i], off, request.tolerance);
    if (i == 0) {
      count(chosen, &candidates[i], off, request.tolerance);
    }
    if (off > request.tolerance) {
      printf("sigma_a %.4g, g %.4g, eta %.4g, r %.4g to %.4g mm, wanted %u: %s is off by %.4g, not "
             "%.4g\n",
             truth->medium.sigma_a_per_mm, truth->medium.g, truth->medium.eta,
             request.radii.least_mm, request.radii.most_mm, request.wanted,
             core_choice_by_id(core_models, candidates[i].model)->name, off, request.tolerance);
    }
  }
}

/* Media of other g. The truth is transport's table of solutions, whose own error is left out. */
static void ask_anisotropic(struct tally *chosen, struct tally *all, uint64_t *random) {
  static struct truth truth;
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-4; /* a look-up will do */
  for (size_t m = 0; m < MEDIA_OF_ANY_G; m++) {
    const double ratio = unit_random_log(random, 1e-4, 9.9);
    const double g = unit_random_between(random, -0.49, 0.94);
    core_profile profile;
    truth = (struct truth){.medium = {ratio / (1 + ratio), 1 / (1 + ratio) / (1 - g), g,
                                      unit_random_between(random, 1, 2)},
                           .single = m % 2 == 1};
    unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                           CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &truth.medium,
                                           &parameters),
                      NULL, 0);
    for (size_t i = 0; i < RADII; i++) {
      truth.r[i] = (double)(float)draw_mfp(i % 2 == 0, random);
    }
    qsort(truth.r, RADII, sizeof truth.r[0], compare);
    core_eval_f64(&profile, CORE_QUANTITY_R, RADII, truth.r, truth.R);
    truth.albedo = profile.albedo;
    for (size_t i = 0; i < REQUESTS_A_MEDIUM; i++) {
      ask(&truth, chosen, all, random);
    }
    core_profile_free(&profile);
    for (size_t i = 0; i < truth.candidate_count; i++) {
      core_profile_free(&truth.candidates[i].profile);
    }
  }
}

static void report(const struct tally *tally, const char *what) {
  printf("%s: %zu promises, kept %zu (%.2f %%), largest error %.3f tolerances, %zu other than "
         "transport (%.1f %%)\n",
         what, tally->promises, tally->kept, 100.0 * (double)tally->kept / (double)tally->promises,
         tally->most, tally->promises - tally->transport,
         100.0 * (double)(tally->promises - tally->transport) / (double)tally->promises);
  assert_true((double)tally->kept >= KEPT_SHARE * (double)tally->promises);
  assert_true(tally->most <= MISSED_BY_AT_MOST);
}

/* The fraction of the golden section's multiple: evenly spread for any number of them. */
static double spread(size_t i) {
  const double multiple = (double)i * 0.6180339887498949;
  return multiple - floor(multiple);
}

/* Of the choices, and of all candidates that say that they would meet the tolerance. */
UNIT_TEST(promises_are_kept) {
  static struct truth truth;
  struct tally chosen = {0}, all = {0};
  uint64_t random = unit_seed();
  const size_t etas = unit_is_long() ? ETAS : ETAS / 3;
  for (size_t e = 0; e < etas; e++) {
    transport_boundary *boundary;
    const double eta = 1 + ((double)e + unit_random_between(&random, 0, 1)) / (double)etas;
    unit_assert_fault(transport_boundary_create(&boundary, eta, 1e-6), NULL, 0);
    for (size_t m = 0; m < MEDIA_AN_ETA; m++) {
      /* from 1e-4 to 10, and for each fourth eta down to 1e-7 once */
      const double ratio = m == 0 && e % 4 == 0 ? 1e-7 * pow(1e3, spread(e))
                                                : 1e-4 * pow(1e5, spread(e * MEDIA_AN_ETA + m));
      draw_truth(&truth, boundary, eta, ratio, &random);
      for (size_t i = 0; i < REQUESTS_A_MEDIUM; i++) {
        ask(&truth, &chosen, &all, &random);
      }
      for (size_t i = 0; i < truth.candidate_count; i++) {
        core_profile_free(&truth.candidates[i].profile);
      }
    }
    transport_boundary_free(boundary);
  }
  ask_anisotropic(&chosen, &all, &random);
  report(&chosen, "choices");
  report(&all, "all candidates that meet");
  assert_true(chosen.promises >= etas * MEDIA_AN_ETA * REQUESTS_A_MEDIUM);
  assert_true(chosen.promises - chosen.transport >= OTHER_CHOICES);
  assert_true(all.promises - all.transport >= OTHER_PROMISES);
}

/* ---- edges ----------------------------------------------------------------------------------- */

static const core_medium ordinary = {0.05, 1, 0, 1.4};

/* 30 % of R from 5 to 10 mm, which other models than transport can do. */
static core_choose_request easy(const core_medium *media, size_t media_count) {
  return (core_choose_request){
      .media = media,
      .media_count = media_count,
      .moments = CORE_MOMENTS_EXACT,
      .wanted = CORE_QUANTITY_R,
      .radii = {5, 10},
      .radius_count = 1000000,
      .tolerance = 0.3,
  };
}

static core_candidate choose(const core_choose_request *request) {
  core_candidate candidates[CORE_CANDIDATES_MAX];
  assert_true(core_choose(request, candidates) > 0);
  return candidates[0];
}

/* Whether any other model than transport can promise anything. */
static bool others_promise(const core_choose_request *request) {
  core_candidate candidates[CORE_CANDIDATES_MAX];
  const size_t n = core_choose(request, candidates);
  for (size_t i = 0; i < n; i++) {
    if (candidates[i].model != CORE_MODEL_TRANSPORT && candidates[i].error < (double)INFINITY) {
      return true;
    }
  }
  return false;
}

static void only_transport_promises(core_choose_request request) {
  assert_false(others_promise(&request));
  const core_candidate choice = choose(&request);
  assert_int_equal(choice.model, CORE_MODEL_TRANSPORT);
  assert_true(choice.meets);
  assert_true(choice.model_error == 0);
}

UNIT_TEST(a_tolerance_that_is_loose_takes_another_model) {
  const core_choose_request request = easy(&ordinary, 1);
  const core_candidate choice = choose(&request);
  assert_true(choice.meets);
  assert_int_not_equal(choice.model, CORE_MODEL_TRANSPORT);
  assert_true(choice.error <= request.tolerance);
  assert_true(choice.model_error > 0 && choice.model_error <= choice.error);
  assert_true(choice.numerical_error > 0 && choice.numerical_error < 1e-3);
  assert_true(choice.cost_ns > 0 && choice.prepare_ns > 0);
}

/* Nothing that meets the tolerance is cheaper than the choice by more than what is alike, and the
 * rest of the list is in the order in which it is to be taken. */
UNIT_TEST(the_list_is_in_order) {
  for (int single = 0; single < 2; single++) {
    core_choose_request request = easy(&ordinary, 1);
    core_candidate candidates[CORE_CANDIDATES_MAX];
    request.single = single;
    const size_t n = core_choose(&request, candidates);
    size_t meeting = 0;
    assert_true(n > 1);
    for (size_t i = 0; i < n; i++) {
      assert_true(single == (candidates[i].evaluator != CORE_EVALUATOR_F64));
      assert_true(candidates[i].meets == (candidates[i].error <= request.tolerance));
      assert_true(i == 0 || candidates[i - 1].meets >= candidates[i].meets);
      meeting += candidates[i].meets;
    }
    for (size_t i = 1; i < n; i++) {
      const core_candidate *a = &candidates[i - 1], *b = &candidates[i];
      if (i < meeting) {
        assert_true(a->total_ns <= b->total_ns * CORE_CHOOSE_COST_ALIKE);
        assert_true(a->total_ns * CORE_CHOOSE_COST_ALIKE < b->total_ns || a->error <= b->error ||
                    a->total_ns < b->total_ns);
      } else if (i > meeting) {
        assert_true(a->error <= b->error);
      }
    }
  }
}

/* ---- preparing ------------------------------------------------------------------------------- */

static core_candidate choose_for(core_choose_request request, uint64_t radius_count) {
  request.radius_count = radius_count;
  return choose(&request);
}

/* A formula is ready at once, a table is faster from some thousands of radii on; each quantity that
 * is wanted counts. */
UNIT_TEST(the_choice_counts_preparing) {
  core_choose_request request = easy(&ordinary, 1);
  request.single = true;
  request.tolerance = 0.03;
  const core_candidate few = choose_for(request, 10), many = choose_for(request, 1000000000);
  assert_true(few.meets && many.meets);
  assert_true(few.prepare_ns < many.prepare_ns && few.cost_ns > many.cost_ns);
  const uint64_t same =
      (uint64_t)((many.prepare_ns - few.prepare_ns) / (few.cost_ns - many.cost_ns));
  assert_int_equal(choose_for(request, same / 4).evaluator, few.evaluator);
  assert_int_equal(choose_for(request, same * 4).evaluator, many.evaluator);
  request.wanted = CORE_QUANTITY_R | CORE_QUANTITY_RING | CORE_QUANTITY_S | CORE_QUANTITY_ALBEDO;
  assert_int_equal(choose_for(request, same / 2).evaluator, many.evaluator);
  request.wanted = CORE_QUANTITY_ALBEDO; /* no radius counts */
  assert_true(choose_for(request, 1000000000).prepare_ns < 1e6);
}

/* With g, transport comes from its table whatever the tolerance is, in some milliseconds; its
 * difference from isotropic scattering is looked up besides. */
UNIT_TEST(preparing_with_g_costs_a_look_up) {
  const core_medium medium = {0.05, 10, 0.9, 1.4};
  size_t found = 0;
  for (int i = 0; i < 4; i++) {
    core_candidate candidates[CORE_CANDIDATES_MAX];
    core_choose_request request = easy(&medium, 1);
    request.single = i % 2 == 1;
    request.tolerance = i < 2 ? 0.02 : 1e-7;
    const size_t n = core_choose(&request, candidates);
    for (size_t k = 0; k < n; k++) {
      const bool transport = candidates[k].model == CORE_MODEL_TRANSPORT;
      assert_true(!transport || (candidates[k].prepare_ns > 5e5 && candidates[k].prepare_ns < 2e7));
      found += transport;
    }
  }
  assert_int_equal(found, 6);
}

/* Returns the least of some processor times that preparing with a candidate takes. */
static double preparing_ns(const core_candidate *of, const core_medium *medium) {
  enum { TIMES = 3 };
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = of->numerical_tolerance;
  double least = (double)INFINITY;
  for (int i = 0; i < TIMES; i++) {
    core_profile profile;
    const clock_t begin = clock();
    unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), of->model,
                                           CORE_MOMENTS_EXACT, of->evaluator, medium, &parameters),
                      NULL, 0);
    least = fmin(least, 1e9 * (double)(clock() - begin) / CLOCKS_PER_SEC);
    core_profile_free(&profile);
  }
  return least;
}

/* Transport solves what its table does not hold, whatever the tolerance is: the stated cost of
 * preparing is that of the solver there. The costs are those of another machine, so that they are
 * compared with the first medium's. A medium that hardly scatters takes five times as long as most. */
UNIT_TEST(preparing_what_the_table_does_not_hold_costs_a_solution) {
  static const core_medium media[] = {
      {0.05, 1, 0, 1.4}, {0.05, 10, 0.9, 1.4}, {1e-7, 1, 0, 1.4},
      {0, 10, 0.9, 1.4}, {1e-7, 2, 0.5, 2},    {0.1, 1, 0, 0.6},
      {0.1, 1, 0, 2.5},  {200, 1, 0, 1.4},     {0.001, 1, -0.3, 1.1}};
  double stated = 0, measured = 0;
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    core_candidate candidates[CORE_CANDIDATES_MAX], *transport = candidates;
    core_choose_request request = easy(&media[i], 1);
    request.tolerance = 0.03;
    core_choose(&request, candidates);
    while (transport->model != CORE_MODEL_TRANSPORT || transport->evaluator != CORE_EVALUATOR_F64) {
      transport++;
    }
    const double ns = preparing_ns(transport, &media[i]);
    stated = i == 0 ? transport->prepare_ns : stated;
    measured = i == 0 ? ns : measured;
    const double off = ns / measured / (transport->prepare_ns / stated);
    printf("medium %zu: %.2g ns, %.2f of what is stated\n", i, ns, off);
    assert_true(off > 1.0 / 6 && off < 6);
  }
}

/* Every candidate's total follows from its costs. */
UNIT_TEST(the_total_is_that_of_a_medium) {
  core_choose_request request = easy(&ordinary, 1);
  core_candidate candidates[CORE_CANDIDATES_MAX];
  request.wanted =
      CORE_QUANTITY_R | CORE_QUANTITY_PDF | CORE_QUANTITY_ALBEDO | CORE_QUANTITY_RADIUS;
  request.radius_count = 1234;
  const size_t n = core_choose(&request, candidates);
  for (size_t i = 0; i < n; i++) {
    const core_candidate *one = &candidates[i];
    assert_true(one->total_ns == one->prepare_ns + 2 * 1234 * one->cost_ns);
  }
}

/* A table is built to the tolerance that the request leaves it, not to the default. */
UNIT_TEST(a_table_is_built_to_what_is_asked) {
  static const struct {
    double tolerance, built;
  } tables[] = {{1e-2, 1e-3}, {1e-3, (double)NAN}, {1e-4, 2.5e-5}};
  core_choose_request request = easy(&ordinary, 1);
  core_candidate candidates[CORE_CANDIDATES_MAX];
  request.single = true;
  for (size_t i = 0; i < sizeof tables / sizeof tables[0]; i++) {
    request.tolerance = tables[i].tolerance;
    const size_t n = core_choose(&request, candidates);
    size_t k = 0;
    while (k < n && !(candidates[k].model == CORE_MODEL_TRANSPORT &&
                      candidates[k].evaluator == CORE_EVALUATOR_LUT)) {
      k++;
    }
    assert_true(k < n && candidates[k].meets);
    const double built = candidates[k].numerical_tolerance;
    assert_true(isnan(tables[i].built) ? isnan(built) : fabs(built / tables[i].built - 1) < 0.05);
  }
}

UNIT_TEST(outside_of_what_was_measured_only_transport_promises) {
  core_choose_request request = easy(&ordinary, 1);
  request.radii.least_mm = 0;
  only_transport_promises(request);
  request.radii.least_mm = 0.0094; /* 0.00987 mean free paths */
  only_transport_promises(request);
  request.radii.least_mm = 0.0096;
  assert_true(others_promise(&request));
  request.radii.most_mm = 20 / 1.05;
  assert_true(others_promise(&request));
  request.radii.most_mm = 19.1;
  only_transport_promises(request);
  request.radii.most_mm = (double)INFINITY; /* where transport does not reach either */
  assert_false(others_promise(&request));
  assert_false(choose(&request).meets);
  static const core_medium media[] = {{10.1, 1, 0, 1.4}, {0.05, 1, 0, 0.99}, {0.05, 1, 0, 2.01}};
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    request = easy(&media[i], 1);
    request.radii = (core_radii_range){0.5, 1};
    only_transport_promises(request);
  }
}

UNIT_TEST(the_ends_of_what_was_measured_belong_to_it) {
  static const core_medium media[] = {
      {0, 1, 0, 1.4}, {10, 1, 0, 1.4}, {0.05, 1, 0, 1}, {0.05, 1, 0, 2}, {0.3, 0.03, 0, 1.1}};
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    core_choose_request request = easy(&media[i], 1);
    const double mfp_mm = 1 / (media[i].sigma_a_per_mm + media[i].sigma_s_per_mm);
    request.radii = (core_radii_range){0.01 * mfp_mm, 20 * mfp_mm};
    assert_true(others_promise(&request));
  }
}

UNIT_TEST(what_was_not_measured_is_not_promised) {
  core_choose_request request = easy(&ordinary, 1);
  request.wanted = CORE_QUANTITY_R | CORE_QUANTITY_CDF;
  only_transport_promises(request);
  request.wanted = CORE_QUANTITY_SLOPE;
  only_transport_promises(request);
  request.wanted = CORE_QUANTITY_R;
  request.moments = CORE_MOMENTS_FIT;
  only_transport_promises(request);
}

/* The albedo alone needs no radii. */
UNIT_TEST(the_albedo_needs_no_radii) {
  core_choose_request request = easy(&ordinary, 1);
  request.wanted = CORE_QUANTITY_ALBEDO | CORE_QUANTITY_RADIUS;
  request.radii = (core_radii_range){0, (double)INFINITY};
  assert_int_not_equal(choose(&request).model, CORE_MODEL_TRANSPORT);
}

/* A quantity more is never nearer. */
UNIT_TEST(what_is_wanted_has_to_be_met_together) {
  core_choose_request request = easy(&ordinary, 1);
  request.tolerance = 10;
  const double R = choose(&request).error;
  core_candidate of_R[CORE_CANDIDATES_MAX], of_all[CORE_CANDIDATES_MAX];
  assert_true(R < 10);
  const size_t n = core_choose(&request, of_R);
  request.wanted |= CORE_QUANTITY_ALBEDO | CORE_QUANTITY_LN_R | CORE_QUANTITY_PDF;
  assert_int_equal(core_choose(&request, of_all), n);
  for (size_t i = 0; i < n; i++) {
    for (size_t j = 0; j < n; j++) {
      if (of_R[i].model == of_all[j].model && of_R[i].evaluator == of_all[j].evaluator) {
        assert_true(of_all[j].error >= of_R[i].error);
      }
    }
  }
}

/* Nothing can do it: the nearest that there is comes first, and says how near. */
UNIT_TEST(a_tolerance_that_nothing_meets) {
  core_choose_request request = easy(&ordinary, 1);
  request.tolerance = 1e-9;
  core_candidate choice = choose(&request);
  assert_false(choice.meets);
  assert_int_equal(choice.model, CORE_MODEL_TRANSPORT);
  assert_true(choice.error > 1e-9 && choice.error < 1e-7);
  request.tolerance = (double)NAN;
  assert_false(choose(&request).meets);
  static const core_medium out_of_all = {0.05, 1, 0, 5};
  request = easy(&out_of_all, 1);
  choice = choose(&request);
  assert_false(choice.meets);
  assert_true(isinf(choice.error));
}

/* A phase function of which only gamma is known: transport alone takes gamma, with the error that
 * was measured for it, which no small tolerance allows. */
UNIT_TEST(gamma_is_for_transport) {
  const core_medium tissue = {0.05, 10, 0.9, 1.4};
  core_choose_request request = easy(&tissue, 1);
  request.gamma = 1.6;
  request.tolerance = 0.5;
  request.radii = (core_radii_range){1, 4};
  core_candidate choice = choose(&request);
  assert_true(choice.meets && choice.model == CORE_MODEL_TRANSPORT);
  assert_true(choice.model_error > 0.01 && choice.model_error < 0.5);
  request.tolerance = 0.01;
  choice = choose(&request);
  assert_false(choice.meets);
  assert_true(choice.model == CORE_MODEL_TRANSPORT && choice.error > 0.01);
  request.gamma = 0.6; /* nothing was measured */
  request.tolerance = 1;
  assert_true(isinf(choose(&request).error));
}

/* The tighter the tolerance, the tighter transport is solved; and no tighter than it is asked. */
UNIT_TEST(the_numerical_tolerance_follows) {
  core_choose_request request = easy(&ordinary, 1);
  request.tolerance = 1e-4;
  core_candidate choice = choose(&request);
  assert_true(choice.meets && isnan(choice.numerical_tolerance));
  request.tolerance = 1e-6;
  choice = choose(&request);
  assert_true(choice.meets && choice.numerical_tolerance <= 0.25e-6 * 1.0001 &&
              choice.numerical_tolerance > 0.2e-6);
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = choice.numerical_tolerance;
  core_profile profile;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), choice.model,
                                         CORE_MOMENTS_EXACT, choice.evaluator, &ordinary,
                                         &parameters),
                    NULL, 0);
  assert_true(profile.numerical_error <= choice.numerical_error * 1.0001);
  core_profile_free(&profile);
}

/* One channel that needs transport takes all of them there. */
UNIT_TEST(the_choice_holds_for_all_channels) {
  const core_medium media[3] = {ordinary, {0.06, 1, 0, 1.4}, {0.05, 0.0001, 0, 1.4}};
  core_choose_request request = easy(media, 2);
  const double two = choose(&request).model_error;
  assert_true(two > 0);
  for (size_t i = 0; i < 2; i++) {
    request = easy(&media[i], 1);
    request.tolerance = two;
    assert_true(choose(&request).model_error <= two);
  }
  request = easy(media, 3);
  only_transport_promises(request);
  core_candidate candidates[CORE_CANDIDATES_MAX];
  request.media_count = 0;
  assert_int_equal(core_choose(&request, candidates), 0);
}

/* A tolerance is answered for any g, with errors that were measured at that g: of single
 * scattering, too. */
UNIT_TEST(a_tolerance_is_answered_for_any_g) {
  static const double gs[] = {-0.5, -0.1, 0.3, 0.7, 0.85, 0.9, 0.95};
  for (size_t k = 0; k < sizeof gs / sizeof gs[0]; k++) {
    const core_medium medium = {0.05, 1 / (1 - gs[k]), gs[k], 1.4};
    core_choose_request request = easy(&medium, 1);
    core_candidate candidates[CORE_CANDIDATES_MAX];
    const size_t n = core_choose(&request, candidates);
    size_t known = 0;
    for (size_t i = 0; i < n; i++) {
      known += candidates[i].error < (double)INFINITY;
      assert_true(candidates[i].model != CORE_MODEL_SINGLE || candidates[i].error > 0.9);
    }
    assert_int_equal(known, n);
    assert_true(candidates[0].meets && candidates[0].model != CORE_MODEL_TRANSPORT);
    request.tolerance = 0.02;
    request.radii = (core_radii_range){0.1, 10};
    assert_true(choose(&request).meets && choose(&request).model == CORE_MODEL_TRANSPORT);
    request.wanted = CORE_QUANTITY_CDF;
    assert_true(choose(&request).meets && choose(&request).model == CORE_MODEL_TRANSPORT);
  }
}

/* Beyond transport's table the error of the similarity relation comes on top, where it is known. */
UNIT_TEST(anisotropy_beyond_the_table) {
  const core_medium further = {0.05, 33, 0.97, 1.4};
  core_choose_request request = easy(&further, 1);
  request.radii = (core_radii_range){1, 4}; /* further away Monte Carlo is too noisy */
  assert_true(choose(&request).error < (double)INFINITY);
  assert_int_not_equal(choose(&request).model, CORE_MODEL_TRANSPORT);
  request.radii.least_mm = 0.09; /* below 0.1 mean free paths */
  assert_true(isinf(choose(&request).error));
  request.radii.least_mm = 1;
  request.wanted = CORE_QUANTITY_CDF;
  assert_true(isinf(choose(&request).error));
}

/* The same in other units of length, for the radii are relative to the medium. */
UNIT_TEST(lengths_do_not_matter) {
  const core_medium dense = {50, 1000, 0, 1.4};
  core_choose_request request = easy(&ordinary, 1);
  const core_candidate choice = choose(&request);
  request = easy(&dense, 1);
  request.radii = (core_radii_range){5e-3, 10e-3};
  const core_candidate other = choose(&request);
  assert_int_equal(choice.model, other.model);
  assert_true(choice.error == other.error);
}

/* Where transport is looked up, its error is that of the table, whatever it is prepared with. */
UNIT_TEST(the_error_of_a_table_is_not_the_tolerance) {
  for (int i = 0; i < 3; i++) {
    const double g = 0.45 * i;
    const core_medium medium = {0.1, 1 / (1 - g), g, 1.4};
    const core_choose_request request = {.media = &medium,
                                         .media_count = 1,
                                         .moments = CORE_MOMENTS_EXACT,
                                         .wanted = CORE_QUANTITY_R,
                                         .radii = {1, 1},
                                         .radius_count = 1,
                                         .single = true,
                                         .tolerance = 0.01};
    core_candidate candidates[CORE_CANDIDATES_MAX];
    const size_t count = core_choose(&request, candidates);
    for (size_t k = 0; k < count; k++) {
      if (candidates[k].model == CORE_MODEL_TRANSPORT &&
          candidates[k].evaluator == CORE_EVALUATOR_F32) {
        core_parameters parameters = core_parameters_none();
        core_profile profile;
        parameters.value[CORE_PARAMETER_TOLERANCE] = candidates[k].numerical_tolerance;
        unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL),
                                               CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT,
                                               CORE_EVALUATOR_F32, &medium, &parameters),
                          NULL, 0);
        const double stated =
            core_profile_errors(&profile, CORE_QUANTITY_R, request.radii).numerical;
        assert_true(candidates[k].numerical_error >= stated &&
                    candidates[k].numerical_error < stated + 2e-4);
        core_profile_free(&profile);
      }
    }
  }
}
