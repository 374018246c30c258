/* Inversion: from an albedo and a length to a medium, and back. */
#include "core/inverter.h"

#include <float.h>
#include <math.h>

#include "tests/accuracy/inversion.h"
#include "tests/unit/unit.h"

#define ROUND_TRIP 1e-12

static const double etas[] = {CORE_ETA_MIN, .195, .2,  .46,   .7, 1,
                              1.3,          1.5,  2.2, 2.485, 5,  CORE_ETA_MAX};
static const double paths_mm[] = {1e-6, 1e-3, .7, 1, 30, 1e6};

static double albedo_of(unsigned model, unsigned moments, const core_medium *medium) {
  core_profile profile;
  unit_accept(core_profile_prepare(&profile, core_isa_select(NULL), model, moments,
                                   CORE_EVALUATOR_F64, medium, NULL));
  const double albedo = profile.albedo;
  core_profile_free(&profile);
  return albedo;
}

/* Checks the mean free path of a medium to within a few ulp, because its coefficients and their sum
 * are rounded. */
static void assert_mean_free_path(const core_medium *medium, double mean_free_path_mm) {
  const double sigma_t_prime = medium->sigma_a_per_mm + medium->sigma_s_per_mm;
  assert_true(fabs(sigma_t_prime * mean_free_path_mm - 1) <= 4 * DBL_EPSILON);
}

static void assert_reach(const inversion *found) {
  assert_true(found->albedo_least >= 0 && found->albedo_least < 1e-8);
  assert_true(found->albedo_most > .9 && found->albedo_most <= 1);
}

/* Inverts an albedo. Either the medium found has this albedo, or the albedo is above the largest
 * one possible and is refused. Returns whether a medium was found. */
static bool round_trip(unsigned model, unsigned moments, double albedo, double mean_free_path_mm,
                       double eta) {
  const inversion found = invert_albedo(model, moments, albedo, mean_free_path_mm, eta);
  if (found.fault.field != NULL) {
    unit_assert_fault(found.fault, "albedo", 0);
    assert_reach(&found);
    assert_true(albedo > found.albedo_most);
    return false;
  }
  assert_reach(&found);
  assert_true(albedo <= found.albedo_most);
  unit_accept(core_medium_check(&found.medium));
  assert_true(found.medium.g == 0 && found.medium.eta == eta);
  assert_mean_free_path(&found.medium, mean_free_path_mm);
  const double got = albedo_of(model, moments, &found.medium);
  UNIT_FAIL_IF(!(fabs(got - albedo) <= ROUND_TRIP * albedo),
               "model %u moments %u eta %.17g mean free path %.17g: albedo %.17g, wanted %.17g",
               model, moments, eta, mean_free_path_mm, got, albedo);
  return true;
}

/* A test for one model, with moments that hold for eta. */
typedef void member_test(unsigned model, unsigned moments, double eta, uint64_t *random);

/* Runs a test for the first two models of the list, which are those that people invert. */
static void with_every_member(member_test *test) {
  uint64_t random = unit_seed();
  for (const core_choice *model = core_models; model->id <= CORE_MODEL_BETTER; model++) {
    for (const core_choice *moments = core_moments_list; moments->name != NULL; moments++) {
      for (size_t e = 0; e < sizeof etas / sizeof etas[0]; e++) {
        if (core_fresnel_check(moments->id, etas[e]).field == NULL) {
          test(model->id, moments->id, etas[e], &random);
        }
      }
    }
  }
}

/* ---- albedos that can be reached ---------------------------------------------------------- */

static void try_listed_albedos(unsigned model, unsigned moments, double eta, uint64_t *random) {
  (void)random;
  static const double albedos[] = {1e-8, 1e-6, 1e-3,     .02,      .1,        .5, .72775656,
                                   .9,   .999, 1 - 1e-6, 1 - 1e-9, 1 - 1e-13, 1};
  for (size_t i = 0; i < sizeof albedos / sizeof albedos[0]; i++) {
    for (size_t j = 0; j < sizeof paths_mm / sizeof paths_mm[0]; j++) {
      const bool reached = round_trip(model, moments, albedos[i], paths_mm[j], eta);
      assert_true(reached || albedos[i] > .999);
    }
  }
}

UNIT_TEST(listed_albedos_come_back) {
  with_every_member(try_listed_albedos);
}

/* Inverting the albedo and the mean free path of a medium gives its coefficients. */
UNIT_TEST(coefficients_come_back) {
  for (size_t i = 0; i < core_measured_media_count; i++) {
    for (size_t c = 0; c < 3; c++) { /* of layers, the half space below */
      const size_t layers = core_measured_media[i].layer_count;
      const core_medium *measured = &core_measured_media[i].channel[c * layers + layers - 1];
      const core_medium similar = {measured->sigma_a_per_mm,
                                   measured->sigma_s_per_mm * (1 - measured->g), 0, measured->eta,
                                   0};
      const core_medium *medium = &similar;
      const double path_mm = 1 / (medium->sigma_a_per_mm + medium->sigma_s_per_mm);
      const double albedo = albedo_of(CORE_MODEL_BETTER, CORE_MOMENTS_EXACT, medium);
      const inversion found =
          invert_albedo(CORE_MODEL_BETTER, CORE_MOMENTS_EXACT, albedo, path_mm, medium->eta);
      unit_accept(found.fault);
      assert_true(fabs(found.medium.sigma_a_per_mm - medium->sigma_a_per_mm) <=
                  1e-10 * medium->sigma_a_per_mm);
      assert_true(fabs(found.medium.sigma_s_per_mm - medium->sigma_s_per_mm) <=
                  1e-10 * medium->sigma_s_per_mm);
    }
  }
}

/* The shortest and the longest allowed mean free path can be inverted. */
UNIT_TEST(extreme_mean_free_paths_are_taken) {
  static const double ends_mm[] = {CORE_MEAN_FREE_PATH_MIN_MM, CORE_MEAN_FREE_PATH_MAX_MM};
  for (size_t i = 0; i < sizeof ends_mm / sizeof ends_mm[0]; i++) {
    for (const core_choice *model = core_models; model->id <= CORE_MODEL_BETTER; model++) {
      assert_true(round_trip(model->id, CORE_MOMENTS_EXACT, .5, ends_mm[i], 1.3));
      assert_true(round_trip(model->id, CORE_MOMENTS_EXACT, 1e-8, ends_mm[i], 1.3));
    }
  }
}

/* ---- the reach ---------------------------------------------------------------------------- */

static void try_the_most(unsigned model, unsigned moments, double eta, uint64_t *random) {
  (void)random;
  for (size_t j = 0; j < sizeof paths_mm / sizeof paths_mm[0]; j++) {
    const double most = invert_albedo(model, moments, .5, paths_mm[j], eta).albedo_most;
    const inversion white = invert_albedo(model, moments, most, paths_mm[j], eta);
    unit_accept(white.fault);
    assert_true(white.medium.sigma_a_per_mm == 0);
    assert_true(albedo_of(model, moments, &white.medium) == most);
    assert_mean_free_path(&white.medium, paths_mm[j]);
    if (model == CORE_MODEL_BETTER && moments == CORE_MOMENTS_EXACT) {
      assert_true(most == 1);
    }
  }
}

UNIT_TEST(the_most_has_no_absorption) {
  with_every_member(try_the_most);
}

static void try_out_of_reach(unsigned model, unsigned moments, double eta, uint64_t *random) {
  (void)random;
  const inversion reach = invert_albedo(model, moments, .5, 1, eta);
  const double wanted[] = {nextafter(reach.albedo_most, 2),
                           1.5,
                           1e300,
                           INFINITY,
                           -1e-300,
                           -.5,
                           -1,
                           -INFINITY,
                           (double)NAN};
  for (size_t i = 0; i < sizeof wanted / sizeof wanted[0]; i++) {
    const inversion found = invert_albedo(model, moments, wanted[i], 1, eta);
    unit_assert_fault(found.fault, "albedo", 0);
    assert_true(found.albedo_most == reach.albedo_most);
    assert_true(found.albedo_least == reach.albedo_least);
    assert_reach(&found);
  }
  const inversion least = invert_albedo(model, moments, reach.albedo_least, 1, eta);
  unit_accept(least.fault);
}

UNIT_TEST(an_albedo_out_of_reach_is_a_fault_that_names_the_reach) {
  with_every_member(try_out_of_reach);
}

/* ---- every model, probe by probe ----------------------------------------------------------- */

/* How many probes a search may take. The larger limit is for models whose albedo jumps as terms are
 * added, where the search bisects. */
enum { PROBES_USUAL = 16, PROBES_MOST = 120 };

/* Probes until the search has ended. Returns the number of probes. */
static unsigned probe_to_the_end(core_inverter *inverter) {
  unsigned probes = 0;
  double albedo;
  do {
    albedo = albedo_of(inverter->model, inverter->moments, &inverter->medium);
    probes++;
    assert_true(probes <= PROBES_MOST);
  } while (!core_inverter_take(inverter, albedo, 0));
  return probes;
}

/* Returns the length of a medium by the formula of its kind. */
static double length_of(const core_medium *medium, enum core_length length) {
  const double reduced = medium->sigma_s_per_mm * (1 - medium->g);
  const double sigma_t_prime = medium->sigma_a_per_mm + reduced;
  const double absorbed = medium->sigma_a_per_mm / sigma_t_prime;
  switch (length) {
  case CORE_LENGTH_DIFFUSE:
    return 1 / (sigma_t_prime * sqrt(3 * absorbed / (1 + absorbed)));
  case CORE_LENGTH_CLASSICAL_DIFFUSE:
    return 1 / sqrt(3 * medium->sigma_a_per_mm * sigma_t_prime);
  case CORE_LENGTH_EXTINCTION:
    return 1 / (medium->sigma_a_per_mm + medium->sigma_s_per_mm);
  default:
    return 1 / sigma_t_prime;
  }
}

/* Returns whether these tests search with a model: only if it prepares quickly. The tests in
 * tests/e2e invert slow models, whose search is the same. */
static bool is_searched(const core_choice *model) {
  return !core_prepares_slowly(model->id, CORE_EVALUATOR_F64, NULL, NULL);
}

static void seek_albedos(core_inverter *inverter, unsigned usual) {
  static const double albedos[] = {1e-6, .003, .05, .2, .5, .8, .97, .9999};
  for (size_t i = 0; i < sizeof albedos / sizeof albedos[0]; i++) {
    const enum core_length length = CORE_LENGTH_FREE_PATH + i % 4;
    const double length_mm = i % 2 ? .7 : 13;
    if (core_inverter_seek(inverter, albedos[i], length, length_mm)) {
      assert_false(inverter->found);
      assert_true(albedos[i] > inverter->albedo_most);
      continue;
    }
    assert_true(probe_to_the_end(inverter) <= usual);
    assert_true(inverter->found);
    assert_true(inverter->albedo ==
                albedo_of(inverter->model, inverter->moments, &inverter->medium));
    assert_true(fabs(inverter->albedo - albedos[i]) <= ROUND_TRIP * albedos[i]);
    assert_true(fabs(length_of(&inverter->medium, length) / length_mm - 1) <= 1e-13);
  }
}

UNIT_TEST(every_model_is_inverted_for_every_length) {
  unsigned inverted = 0;
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    for (unsigned i = 0; i < 6 && is_searched(model); i++) {
      core_inverter inverter;
      const core_fault fault = core_inverter_start(&inverter, model->id, CORE_MOMENTS_EXACT, 0,
                                                   false, i % 2 ? .8 : 0, 1 + .4 * (i / 2), 1);
      if (fault.field != NULL) {
        assert_string_equal(fault.field, "thickness"); /* A slab needs a thickness. */
        continue;
      }
      probe_to_the_end(&inverter);
      if (core_inverter_check(&inverter).field != NULL) {
        assert_true(strncmp(model->name, "skin-", 5) ==
                    0); /* The skin- models are the same for every medium. */
        continue;
      }
      const bool jumps = core_worth_keeping(model->id, CORE_EVALUATOR_F64, NULL);
      seek_albedos(&inverter, jumps ? PROBES_MOST : PROBES_USUAL);
      inverted++;
    }
  }
  assert_true(inverted >= 6 * 15);
}

/* The same albedo and length give the same bits, whatever was searched for before. */
UNIT_TEST(searches_do_not_depend_on_each_other) {
  uint64_t random = unit_seed();
  core_inverter one, other;
  core_inverter_start(&one, CORE_MODEL_BETTER, CORE_MOMENTS_EXACT, 0, false, .3, 1.4, 1);
  probe_to_the_end(&one);
  for (int i = 0; i < 200; i++) {
    const double albedo = unit_random_between(&random, 0, 1);
    const double length_mm = unit_random_log(&random, .01, 100);
    assert_false(core_inverter_seek(&one, albedo, CORE_LENGTH_DIFFUSE, length_mm));
    probe_to_the_end(&one);
    core_inverter_start(&other, CORE_MODEL_BETTER, CORE_MOMENTS_EXACT, 0, false, .3, 1.4, 1);
    probe_to_the_end(&other);
    assert_false(core_inverter_seek(&other, albedo, CORE_LENGTH_DIFFUSE, length_mm));
    probe_to_the_end(&other);
    assert_memory_equal(&one.medium, &other.medium, sizeof one.medium);
    assert_true(one.albedo == other.albedo);
  }
}

UNIT_TEST(what_there_is_not_is_not_found) {
  core_inverter inverter;
  core_inverter_start(&inverter, CORE_MODEL_SINGLE, CORE_MOMENTS_EXACT, 0, false, 0, 1.3, 1);
  probe_to_the_end(&inverter);
  assert_true(inverter.albedo_most < .1);
  assert_true(core_inverter_seek(&inverter, .5, CORE_LENGTH_FREE_PATH, 1));
  assert_false(inverter.found);
  core_inverter_start(&inverter, CORE_MODEL_BETTER, CORE_MOMENTS_EXACT, 0, false, 0, 1.3, 1);
  probe_to_the_end(&inverter);
  assert_false(core_inverter_seek(&inverter, 0, CORE_LENGTH_FREE_PATH, 1));
  probe_to_the_end(&inverter);
  assert_true(inverter.found && inverter.medium.sigma_s_per_mm == 0 && inverter.albedo == 0);
  /* A medium that scatters nothing has no other albedo than 0, nor one that is not known. */
  const double others[] = {1e-9, (double)NAN};
  for (size_t i = 0; i < 2; i++) {
    assert_false(core_inverter_seek(&inverter, 0, CORE_LENGTH_FREE_PATH, 1));
    assert_true(core_inverter_take(&inverter, others[i], 0));
    assert_false(inverter.found);
  }
  /* Without absorption, both diffuse lengths are infinite. */
  assert_true(core_inverter_seek(&inverter, 1, CORE_LENGTH_DIFFUSE, 1));
  assert_true(core_inverter_seek(&inverter, 1, CORE_LENGTH_CLASSICAL_DIFFUSE, 1));
  assert_false(inverter.found);
  assert_false(core_inverter_seek(&inverter, 1, CORE_LENGTH_FREE_PATH, 1));
  probe_to_the_end(&inverter);
  assert_true(inverter.found && inverter.medium.sigma_a_per_mm == 0 && inverter.albedo == 1);
}

/* The medium of a colour of 0.5, g 0.9, eta 1.5 in diffuse light has this albedo of single scattering:
 * that of a walk (see core/varying.h for the light). */
UNIT_TEST(colours_of_diffuse_light_are_inverted) {
  for (int specular = 0; specular < 2; specular++) {
    core_inverter inverter;
    unit_accept(core_inverter_start(&inverter, CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT,
                                    CORE_LIGHT_DIFFUSE, specular, .9, 1.5, 1));
    inversion_run(&inverter);
    const double share = specular ? core_specular(CORE_LIGHT_DIFFUSE, 1.5) : 0;
    assert_true(core_inverter_seen(&inverter, inverter.albedo_most) == 1);
    assert_false(
        core_inverter_seek(&inverter, share + (1 - share) * .5, CORE_LENGTH_EXTINCTION, 2));
    inversion_run(&inverter);
    const core_medium *found = &inverter.medium;
    assert_true(fabs((found->sigma_a_per_mm + found->sigma_s_per_mm) * 2 - 1) < 1e-13);
    assert_true(fabs(found->sigma_s_per_mm * 2 - .9981006) < 1e-7);
    assert_true(!specular || core_inverter_seek(&inverter, .05, CORE_LENGTH_EXTINCTION, 2));
  }
  core_inverter dipole;
  unit_assert_fault(core_inverter_start(&dipole, CORE_MODEL_BETTER, CORE_MOMENTS_EXACT,
                                        CORE_LIGHT_DIFFUSE, false, 0, 1.4, 1),
                    "light", 0);
}

/* An albedo that is inverted by hand: (1 - s) / (1 + 2 s), with s^2 the share sigma_a / sigma_t' of a
 * medium. Its slope is -1/2 in the logarithms at the bright end and -1 at the dark one. */
static double made_up_albedo(const core_medium *medium, double off) {
  const double sigma_t_prime = medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g);
  const double s = sqrt(medium->sigma_a_per_mm / sigma_t_prime);
  return (1 - s) / (1 + 2 * s) * (1 + off);
}

static core_medium made_up_medium(const core_inverter *inverter, double albedo) {
  const double s = (1 - albedo) / (1 + 2 * albedo), a = s * s, g = inverter->g;
  const double path = inverter->length == CORE_LENGTH_DIFFUSE ? sqrt(3 * a / (1 + a)) : 1;
  const double sigma_t_prime = 1 / (path * inverter->length_mm);
  return (core_medium){a * sigma_t_prime, (1 - a) * sigma_t_prime / (1 - g), g, inverter->eta, 0};
}

/* The albedos are off by as much as they say, which spoils the coefficients: the stated errors hold,
 * and are at most 2.1 times what they have to be. */
UNIT_TEST(errors_of_coefficients_are_those_of_the_albedo) {
  static const double albedos[] = {1e-3, .03, .2, .5, .9, .99, .9999, 1 - 1e-6, 1};
  static const double errors[] = {1e-12, 1e-6, 1e-3};
  unsigned infinite = 0;
  for (unsigned i = 0; i < 9 * 3 * 2 * 2; i++) {
    const double wanted = albedos[i % 9], error = errors[i / 9 % 3],
                 off = i / 27 % 2 ? error : -error;
    const enum core_length length = i / 54 ? CORE_LENGTH_DIFFUSE : CORE_LENGTH_FREE_PATH;
    core_inverter inverter;
    unit_accept(core_inverter_start(&inverter, CORE_MODEL_BETTER, CORE_MOMENTS_EXACT, 0, false, .5,
                                    1.4, 1));
    inverter.finds_errors = true;
    while (!core_inverter_take(&inverter, made_up_albedo(&inverter.medium, off), error)) {
    }
    if (core_inverter_seek(&inverter, wanted, length, 2)) {
      continue; /* brighter than the albedo that is too dark */
    }
    while (!core_inverter_take(&inverter, made_up_albedo(&inverter.medium, off), error)) {
    }
    if (!inverter.found) {
      assert_true(length == CORE_LENGTH_DIFFUSE && wanted >= 1 - error);
      continue;
    }
    const core_medium truth = made_up_medium(&inverter, wanted);
    const double stated[] = {inverter.sigma_a_error_per_mm, inverter.sigma_s_error_per_mm};
    const double value[] = {truth.sigma_a_per_mm, truth.sigma_s_per_mm};
    const double off_by[] = {fabs(inverter.medium.sigma_a_per_mm - value[0]),
                             fabs(inverter.medium.sigma_s_per_mm - value[1])};
    for (int k = 0; k < 2 && value[1] < INFINITY; k++) {
      assert_true(off_by[k] <= stated[k] * (1 + 1e-9));
      assert_true(wanted > .9 || stated[k] <= 2.1 * off_by[k] + 1e-14 * value[k]);
    }
    infinite += isinf(stated[1]);
  }
  assert_true(infinite > 0); /* next to white, nothing limits sigma_s of a diffuse length */
}

/* Every way in which a model may leave out what is not the albedo. */
UNIT_TEST(an_albedo_by_itself_has_the_bits_of_a_profile) {
  static const core_medium media[] = {{.05, 9.5, .9, 1.4}, {.3, 1, 0, 1.3},   {1e-13, 1, .3, 1.5},
                                      {2, 1, -.7, 1.4},    {1, 0, .2, 1.4},   {300, 1, .5, 1.2},
                                      {1, 1e-14, 0, 1},    {.01, 2, .98, .5}, {-1, 1, 0, 1}};
  const core_parameters none = core_parameters_none();
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
      double albedo, error;
      core_profile profile;
      if (!unit_is_long() &&
          core_prepares_slowly(model->id, CORE_EVALUATOR_F64, &media[i], &none)) {
        continue;
      }
      const core_fault fault = core_albedo(core_isa_select(NULL), model->id, CORE_MOMENTS_EXACT,
                                           CORE_LIGHT_BEAM, &media[i], &albedo, &error);
      const core_fault whole =
          core_profile_prepare(&profile, core_isa_select(NULL), model->id, CORE_MOMENTS_EXACT,
                               CORE_EVALUATOR_F64, &media[i], NULL);
      unit_assert_fault(fault, whole.field, whole.index);
      if (whole.field == NULL) {
        assert_memory_equal(&albedo, &profile.albedo, sizeof albedo);
        assert_true(error == profile.numerical_errors[CORE_ERROR_BANDS]);
        core_profile_free(&profile);
      } else {
        assert_true(isnan(albedo));
      }
    }
  }
}
