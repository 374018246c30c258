/* Compares models with numbers that other programs published and with each other. truth.c compares
 * them with their formulas; the dipole family has a test of its own, test_dipole.c. */
#include <math.h>

#include "tests/unit/unit.h"

static const double pi = 3.14159265358979323846;

/* ---- evaluating ------------------------------------------------------------------------------ */

static core_parameters with(enum core_parameter parameter, double value) {
  core_parameters parameters = core_parameters_none();
  parameters.value[parameter] = value;
  return parameters;
}

static core_profile prepared(unsigned model, unsigned moments, core_medium medium,
                             const core_parameters *parameters) {
  core_profile profile;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), model, moments,
                                         CORE_EVALUATOR_F64, &medium, parameters),
                    NULL, 0);
  return profile;
}

static double value_of(const core_profile *profile, enum core_quantity quantity, double r) {
  double value;
  core_eval_f64(profile, quantity, 1, &r, &value);
  return value;
}

static double R_of(unsigned model, unsigned moments, core_medium medium, double r) {
  core_profile profile = prepared(model, moments, medium, NULL);
  const double R = value_of(&profile, CORE_QUANTITY_R, r);
  core_profile_free(&profile);
  return R;
}

static double albedo_of(unsigned model, core_medium medium, const core_parameters *parameters) {
  core_profile profile = prepared(model, CORE_MOMENTS_EXACT, medium, parameters);
  const double albedo = profile.albedo;
  core_profile_free(&profile);
  return albedo;
}

static void assert_near(double value, double truth, double relative, const char *what) {
  if (!(fabs(value - truth) <= relative * fabs(truth))) {
    fail_msg("%s is %.12g, not %.12g: off by %.3g", what, value, truth, value / truth - 1);
  }
}

/* sigma_t' = 1 per mm. */
static core_medium medium_of_ratio(double ratio, double eta) {
  return (core_medium){ratio / (1 + ratio), 1 / (1 + ratio), 0, eta};
}

/* ---- published numbers ----------------------------------------------------------------------- */

/* A renderer's source converged, with that renderer's moments; seven digits. */
UNIT_TEST(the_extended_source_has_its_converged_values) {
  static const struct {
    double albedo;
    double extended;
    double beam;
  } rows[] = {{0.2, 2.697834e-4, 2.569131e-4},
              {0.9, 1.329963e-2, 1.266623e-2},
              {0.99, 2.248571e-2, 2.145104e-2}};
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    const core_medium medium = {1 - rows[i].albedo, rows[i].albedo, 0, 1.33};
    assert_near(R_of(CORE_MODEL_EXTENDED, CORE_MOMENTS_PBRT, medium, 1), rows[i].extended, 4e-7,
                "extended");
    assert_near(R_of(CORE_MODEL_BEAM, CORE_MOMENTS_PBRT, medium, 1), rows[i].beam, 4e-7, "beam");
  }
}

UNIT_TEST(burley_has_its_published_points) {
  static const struct {
    int i;
    double x;
  } rows[] = {{1, 0.00195631}, {2, 0.00391517}, {10, 0.0196787}, {100, 0.209296}};
  core_profile profile =
      prepared(CORE_MODEL_BURLEY, CORE_MOMENTS_EXACT, (core_medium){0.02, 0.8, 0, 1.3}, NULL);
  const double d = 1 / (2 * value_of(&profile, CORE_QUANTITY_PDF, 0));
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    const double u = rows[i].i / 1023.0;
    double r;
    core_sample_f64(&profile, 1, &u, &r);
    assert_near(r / d, rows[i].x, 3e-6, "Burley's inverse");
  }
}

/* Index matched, a = 0.9, in mean free paths; exact. */
UNIT_TEST(single_scattering_has_its_published_values) {
  static const double rows[][2] = {{0.1, .42742248}, {1, 4.7113124e-3}, {10, 2.4556137e-9}};
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    assert_near(
        R_of(CORE_MODEL_SINGLE, CORE_MOMENTS_EXACT, (core_medium){0.1, 0.9, 0, 1}, rows[i][0]),
        rows[i][1], 2e-8, "single scattering");
  }
}

/* The column `single` of ../shared/vectors/transport.csv, where it is there. */
UNIT_TEST(single_scattering_agrees_with_transport) {
  char *text = unit_read_file("../shared/vectors/transport.csv");
  if (text == NULL) {
    printf("skipped: ../shared/vectors/transport.csv is not there\n");
    return;
  }
  size_t rows = 0;
  double worst = 0;
  for (char *line = strtok(text, "\n"); line != NULL; line = strtok(NULL, "\n")) {
    double ratio, eta, a, total, r, R, single;
    if (sscanf(line, "%lf,%lf,%lf,%lf,%lf,%lf,%lf", &ratio, &eta, &a, &total, &r, &R, &single) ==
        7) {
      const double value =
          R_of(CORE_MODEL_SINGLE, CORE_MOMENTS_EXACT, (core_medium){1 - a, a, 0, eta}, r);
      worst = fmax(worst, fabs(value / single - 1));
      assert_near(value, single, 1e-7, "single scattering");
      rows++;
    }
  }
  free(text);
  printf("%zu rows of transport.csv, worst %.2g\n", rows, worst);
  assert_true(rows >= 1000);
}

/* R(r) and the totals, index matched and with a boundary; exact, nine digits of them. */
UNIT_TEST(transport_has_its_published_values) {
  static const double radii[] = {.1, .5, 1, 2, 5, 10};
  static const struct {
    double a;
    double R[6];
  } rows[] = {
      {.5, {2.7160357e-1, 2.3164264e-2, 5.2531991e-3, 7.0457166e-4, 9.8241658e-6, 2.8957658e-8}},
      {.9, {5.6107803e-1, 6.7096093e-2, 2.1217650e-2, 4.9406107e-3, 2.6224896e-4, 5.7670504e-6}},
      {.99, {6.4361447e-1, 8.6855766e-2, 3.1387826e-2, 9.4042074e-3, 1.0995469e-3, 1.1009614e-4}}};
  static const struct {
    double a, n, total;
  } totals[] = {{.1, 1, .01639034215},      {.1, 1.33, .02768625739}, {.1, 1.5, .04560923231},
                {.7, 1, .20867995212},      {.7, 1.5, .12890516220},  {.999, 1, .91284533480},
                {.999, 1.33, .86908178965}, {.999, 1.5, .84145847579}};
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    core_profile profile = prepared(CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT,
                                    (core_medium){1 - rows[i].a, rows[i].a, 0, 1}, NULL);
    for (size_t j = 0; j < 6; j++) {
      assert_near(value_of(&profile, CORE_QUANTITY_R, radii[j]), rows[i].R[j],
                  profile.numerical_error, "transport");
    }
    core_profile_free(&profile);
  }
  for (size_t i = 0; i < sizeof totals / sizeof totals[0]; i++) {
    const double n = totals[i].n;
    const double specular = (n - 1) * (n - 1) / ((n + 1) * (n + 1));
    const core_medium medium = {1 - totals[i].a, totals[i].a, 0, n};
    assert_near(specular + (1 - specular) * albedo_of(CORE_MODEL_TRANSPORT, medium, NULL),
                totals[i].total, 3.3e-6, "the total of transport");
  }
}

/* The columns R and total of ../shared/vectors/transport.csv: every eighth medium. */
UNIT_TEST(transport_agrees_with_exact_solutions) {
  char *text = unit_read_file("../shared/vectors/transport.csv");
  if (text == NULL) {
    printf("skipped: ../shared/vectors/transport.csv is not there\n");
    return;
  }
  core_profile profile = {0};
  double solved = -1, worst = 0;
  size_t media = 0, rows = 0;
  for (char *line = strtok(text, "\n"); line != NULL; line = strtok(NULL, "\n")) {
    double ratio, eta, a, total, r, R;
    if (sscanf(line, "%lf,%lf,%lf,%lf,%lf,%lf", &ratio, &eta, &a, &total, &r, &R) != 6) {
      continue;
    }
    if (a * 10 + eta != solved) {
      solved = a * 10 + eta;
      core_profile_free(&profile);
      profile = (core_profile){0};
      if (media++ % 8 == 3) {
        profile = prepared(CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT,
                           (core_medium){1 - a, a, 0, eta}, NULL);
        assert_near(profile.albedo, total, profile.numerical_error, "the total of transport");
      }
    }
    if (profile.table != NULL) {
      const double value = value_of(&profile, CORE_QUANTITY_R, r);
      worst = fmax(worst, fabs(value / R - 1));
      assert_near(value, R, profile.numerical_error, "transport");
      rows++;
    }
  }
  core_profile_free(&profile);
  free(text);
  printf("%zu rows of transport.csv, worst %.2g\n", rows, worst);
  assert_true(rows >= 100);
}

/* ---- slabs ------------------------------------------------------------------------------------ */

UNIT_TEST(a_thick_slab_is_a_half_space) {
  static const unsigned pairs[][2] = {{CORE_MODEL_MULTIPOLE, CORE_MODEL_CLASSICAL},
                                      {CORE_MODEL_BETTER_MULTIPOLE, CORE_MODEL_BETTER}};
  const core_parameters thick = with(CORE_PARAMETER_THICKNESS, 9.9e5);
  for (size_t i = 0; i < 2; i++) {
    for (double ratio = 0; ratio<20; ratio = ratio> 0 ? ratio * 100 : 1e-3) {
      const core_medium medium = medium_of_ratio(ratio, 1.3);
      core_profile slab = prepared(pairs[i][0], CORE_MOMENTS_EXACT, medium, &thick);
      core_profile half = prepared(pairs[i][1], CORE_MOMENTS_EXACT, medium, NULL);
      for (double r = 0; r < 100; r = 1.5 * r + 0.01) {
        assert_near(value_of(&slab, CORE_QUANTITY_R, r), value_of(&half, CORE_QUANTITY_R, r),
                    3e-12 * (1 + r), "a thick slab");
      }
      assert_near(slab.albedo, half.albedo, ratio > 0 ? 1e-11 : 1e-5, "its albedo");
      core_profile_free(&slab);
      core_profile_free(&half);
    }
  }
}

/* What is absorbed, from the diffusion equation across the slab, solved independently:
 * sigma_a int phi dz with phi = alpha' sinh(mu z<) sinh(mu (L - z>)) / (D mu sinh(mu L)). */
static double absorbed_in_slab(core_medium medium, double thickness) {
  const core_fresnel fresnel = core_fresnel_moments(CORE_MOMENTS_EXACT, medium.eta);
  const double mu = sqrt(3 * medium.sigma_a_per_mm);
  const double zb = 2 * (2 - fresnel.one_minus_2c1) / fresnel.one_minus_2c1 / 3;
  const double length = thickness + 2 * zb;
  const double at = 1 + zb;
  const double front = cosh(mu * at) - cosh(mu * zb);
  const double back = cosh(mu * (length - at)) - cosh(mu * zb);
  return medium.sigma_s_per_mm * (sinh(mu * (length - at)) * front + sinh(mu * at) * back) /
         sinh(mu * length);
}

UNIT_TEST(a_slab_balances) {
  for (double ratio = 1e-4; ratio < 20; ratio *= 10) {
    for (double thickness = 1.1; thickness < 40; thickness *= 2.3) {
      for (double eta = 0.7; eta < 2.1; eta += 0.35) {
        const core_medium medium = medium_of_ratio(ratio, eta);
        const core_parameters parameters = with(CORE_PARAMETER_THICKNESS, thickness);
        const double reflected = albedo_of(CORE_MODEL_MULTIPOLE, medium, &parameters);
        const double transmitted = albedo_of(CORE_MODEL_MULTIPOLE_TRANSMITTED, medium, &parameters);
        assert_near(reflected + transmitted + absorbed_in_slab(medium, thickness),
                    medium.sigma_s_per_mm, 1e-11, "what leaves and is absorbed");
      }
    }
  }
}

UNIT_TEST(a_slab_names_its_domain) {
  const core_medium medium = {0.1, 0.9, 0, 1.3};
  core_parameters parameters = core_parameters_none();
  static const double bad[] = {(double)NAN, 1.0999, 1.0001e6, 0, -1, INFINITY};
  for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
    parameters.value[CORE_PARAMETER_THICKNESS] = bad[i];
    unit_assert_fault(core_profile_check(CORE_MODEL_MULTIPOLE, CORE_MOMENTS_EXACT,
                                         CORE_EVALUATOR_F64, &medium, &parameters, NULL),
                      "thickness", 0);
  }
}

/* ---- sums, fits, the BSSRDF, energy ----------------------------------------------------------- */

/* Only a part that uses the similarity relation has its note, and the sum has it, too. */
UNIT_TEST(a_sum_has_the_notes_of_its_parts) {
  const core_medium medium = {0.032, 0.74, 0.3, 1.3};
  core_profile sum = prepared(CORE_MODEL_BETTER_SINGLE, CORE_MOMENTS_EXACT, medium, NULL);
  core_profile single = prepared(CORE_MODEL_SINGLE, CORE_MOMENTS_EXACT, medium, NULL);
  assert_int_equal(sum.notes, CORE_NOTE_SIMILARITY);
  assert_int_equal(single.notes, 0);
  core_profile_free(&sum);
  core_profile_free(&single);
}

/* The deviation that a fit states holds between the radii that it was measured at. */
UNIT_TEST(a_fit_keeps_its_stated_error) {
  static const unsigned models[] = {CORE_MODEL_BETTER, CORE_MODEL_EXTENDED, CORE_MODEL_BURLEY,
                                    CORE_MODEL_BETTER_SINGLE};
  const core_medium medium = {0.032, 0.74, 0, 1.3};
  uint64_t random = unit_seed();
  for (size_t m = 0; m < sizeof models / sizeof models[0]; m++) {
    for (int count = 1; count <= 12; count += 3) {
      core_parameters parameters = with(CORE_PARAMETER_FIT_MODEL, models[m]);
      parameters.value[CORE_PARAMETER_GAUSSIANS] = count;
      parameters.value[CORE_PARAMETER_FIT_FROM] = 0.05;
      parameters.value[CORE_PARAMETER_FIT_TO] = 8;
      core_profile fit = prepared(CORE_MODEL_GAUSSIANS, CORE_MOMENTS_EXACT, medium, &parameters);
      core_profile model = prepared(models[m], CORE_MOMENTS_EXACT, medium, NULL);
      assert_true(fit.radii.least_mm == 0.05 && fit.radii.most_mm == 8);
      assert_true(count < 10 || fit.numerical_error < 0.02);
      for (int i = 0; i < 2000; i++) {
        const double r = unit_random_log(&random, 0.05, 8);
        assert_near(value_of(&fit, CORE_QUANTITY_R, r), value_of(&model, CORE_QUANTITY_R, r),
                    fit.numerical_error, "a fit");
      }
      core_profile_free(&fit);
      core_profile_free(&model);
    }
  }
}

UNIT_TEST(a_fit_meets_a_tolerance_or_says_so) {
  const core_medium medium = {0.032, 0.74, 0, 1.3};
  core_parameters parameters = with(CORE_PARAMETER_TOLERANCE, 0.01);
  core_profile fit = prepared(CORE_MODEL_GAUSSIANS, CORE_MOMENTS_EXACT, medium, &parameters);
  assert_true(fit.numerical_error <= 0.01 + 1e-13);
  core_profile_free(&fit);
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-10;
  unit_assert_fault(core_profile_prepare(&fit, core_isa_select(NULL), CORE_MODEL_GAUSSIANS,
                                         CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &medium,
                                         &parameters),
                    "tolerance", 0);
}

/* What leaves in all directions is what R says: int S cos dw = F_t(cos_in) R, for eta on both sides
 * of 1. */
UNIT_TEST(the_bssrdf_gives_out_what_R_says) {
  enum { STEPS = 2000 };
  for (double eta = 0.7; eta < 2; eta += 0.3) {
    const core_medium medium = {0.1, 1, 0, eta};
    core_parameters parameters = with(CORE_PARAMETER_COS_IN, 0.9);
    double sum = 0, R = 0;
    for (int i = 0; i < STEPS; i++) {
      /* cos = s^2: the transmittance has a square root at grazing incidence */
      const double s = (i + 0.5) / STEPS;
      parameters.value[CORE_PARAMETER_COS_OUT] = s * s;
      core_profile profile = prepared(CORE_MODEL_BETTER, CORE_MOMENTS_EXACT, medium, &parameters);
      R = value_of(&profile, CORE_QUANTITY_R, 0.5);
      sum += value_of(&profile, CORE_QUANTITY_S, 0.5) * 2 * pi * s * s * 2 * s / STEPS;
    }
    assert_near(sum, core_fresnel_transmittance(eta, 0.9) * R, 3e-4, "the light that leaves");
  }
  assert_near(core_fresnel_transmittance(1.5, 1), 0.96, 1e-15, "normal transmittance");
  assert_true(core_fresnel_transmittance(0.5, 0.8) == 0); /* beyond the critical angle */
  assert_near(core_fresnel_transmittance(1, 1e-9), 1, 1e-15, "no boundary");
}

/* No model gives out more than went in without saying so. */
UNIT_TEST(an_albedo_above_1_is_confessed) {
  size_t above = 0;
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    for (double ratio = 0; ratio<20; ratio = ratio> 0 ? ratio * 30 : 1e-6) {
      for (double eta = 0.5; eta < 2.5; eta += 0.25) {
        const core_medium medium = medium_of_ratio(ratio, eta);
        const core_parameters parameters = unit_parameters(model->id, &medium);
        core_profile profile;
        const core_fault fault =
            core_profile_prepare(&profile, core_isa_select(NULL), model->id, CORE_MOMENTS_EXACT,
                                 CORE_EVALUATOR_F64, &medium, &parameters);
        if (fault.field != NULL) {
          assert_string_equal(fault.field, "sigma_a"); /* Burley's diffuse mean free path */
          continue;
        }
        const bool confessed = (profile.notes & CORE_NOTE_ALBEDO_ABOVE_1) != 0;
        for (const core_choice *one = core_evaluators; one->name != NULL && confessed; one++) {
          core_profile same;
          if (core_profile_prepare(&same, core_isa_select(NULL), model->id, CORE_MOMENTS_EXACT,
                                   one->id, &medium, &parameters)
                  .field == NULL) {
            assert_int_equal(same.notes, profile.notes);
            core_profile_free(&same);
          }
        }
        assert_int_equal(confessed, profile.albedo > 1 + profile.numerical_error);
        above += confessed;
        core_profile_free(&profile);
      }
    }
  }
  printf("%zu profiles give out more than went in, and say so\n", above);
  assert_true(above > 0);
}
