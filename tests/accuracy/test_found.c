/* Values that were once further off than their profile stated, most of them found by
 * tests/accuracy/truth.c, and what else one of its rounds is too rare to meet. */
#include <math.h>

#include "tests/accuracy/forms.h"
#include "tests/unit/unit.h"

static const struct found {
  unsigned model;
  unsigned moments;
  core_medium medium;
  double tolerance; /* 0: not given */
  double thickness; /* 0: not given */
  enum core_elementwise quantity;
  double r;
} in_f64[] = {
    /* ln R beyond the radii where the nodes of single scattering resolve the critical angle */
    {12,
     3,
     {.048342114715528794, 3.9371245834975133, .7068965829280961, 1.64},
     0,
     0,
     CORE_ELEMENTWISE_LN_R,
     1172310016},
    {12,
     3,
     {3.6002109438601964e-13, 1e-13, .0516, 1.0000000000000513},
     0,
     0,
     CORE_ELEMENTWISE_LN_R,
     2.4857153660020284e+25},
    {12, 1, {1, 1, 0, 1 - 3e-15}, 0, 0, CORE_ELEMENTWISE_LN_R, 3e12},
    /* a phase function that peaks where the light returns */
    {12,
     2,
     {6.4838038657429128e-16, 1.4245756587699197e-05, -.99356405350349442, 1},
     0,
     0,
     CORE_ELEMENTWISE_SLOPE,
     2641.4901407906523},
    {12, 1, {.1, 1, -.999999, 1.4}, 0, 0, CORE_ELEMENTWISE_R, 1e-7},
    {12, 1, {.1, 1, -.9999999999, 1.4}, 0, 0, CORE_ELEMENTWISE_CDF, 1e-3},
    /* dR/dr that has nearly underflowed, next to the source of a medium with a large sigma_s */
    {12,
     1,
     {6.2936497868660206, 1e15, .99999999999830125, 1.78},
     0,
     0,
     CORE_ELEMENTWISE_SLOPE,
     2.4562380666719175e-13},
    /* dR/dr of quantized diffusion at tight tolerances, and next to the source */
    {10,
     3,
     {.11021964541377137, .018809542588493627, -.64702573831986154, 1.28},
     1e-12,
     0,
     CORE_ELEMENTWISE_SLOPE,
     70.552864074707031},
    {10,
     3,
     {.00014008569579366506, 8.857997343145616, -.28100640199629984, 1.38},
     1e-12,
     0,
     CORE_ELEMENTWISE_SLOPE,
     79.417472839355469},
    {16,
     2,
     {4.0191784427857262e-07, 46330.611244221116, 0, 1.16},
     3.6335016179573366e-10,
     0,
     CORE_ELEMENTWISE_SLOPE,
     1.9687290331500164e-16},
    /* the cdf where quantized diffusion is continued in proportion to 1 / r^3 */
    {10, 1, {0, 10.179499265782718, 0, 1.66}, 1e-12, 0, CORE_ELEMENTWISE_CDF, 3216388352},
    {10,
     1,
     {0, .00036684443309304576, 0, 125.77969001203752},
     1e-12,
     0,
     CORE_ELEMENTWISE_CDF,
     27168.576171875},
    {10, 1, {0, 5.7032039914085173, 0, 732.20349396291783}, 1e-12, 0, CORE_ELEMENTWISE_CDF, .01},
    {10, 1, {0, 5.7032039914085173, 0, 732.20349396291783}, 1e-12, 0, CORE_ELEMENTWISE_R, 1e12},
    /* slabs beyond 30 decay lengths, and thick ones */
    {26,
     1,
     {28.86681077934717, 6.451839023028399, 0, 1.3},
     0,
     1.5153297352142563,
     CORE_ELEMENTWISE_R,
     .02},
    {26,
     1,
     {1.8161687420845836, .45904645480932443, 0, 1},
     0,
     15.62543662979096,
     CORE_ELEMENTWISE_R,
     0},
    {25,
     1,
     {.0006677488597191519, 26.936460962945098, 0, 1.5},
     0,
     41.88794671213062,
     CORE_ELEMENTWISE_R,
     0},
    {25,
     1,
     {.051633312953143065, .2196883399787797, 0, 1},
     0,
     19.861599357368725,
     CORE_ELEMENTWISE_LN_R,
     5000},
    /* a slab that is thin beside z_b, where poles on both sides of it nearly cancel */
    {25,
     1,
     {3.2641259552527675e-23, 4.3818072133481084e-06, 0, 98.552248512778107},
     1e-12,
     6978581.7805150477,
     CORE_ELEMENTWISE_R,
     134306267136},
    {26, 1, {1e-20, 1, 0, 900}, 1e-12, 3, CORE_ELEMENTWISE_R, 3e8},
    /* the least share of scattering that a medium may have */
    {10,
     3,
     {.026307168967803912, 2.7e-32, 0, .99999532156521787},
     0,
     0,
     CORE_ELEMENTWISE_LN_R,
     20843.052734375},
    {27, 1, {2e7, 2.1e-23, 0, 3.3}, 0, 8.7e-7, CORE_ELEMENTWISE_LN_R, 2.43e-5},
    {16, 1, {1.8e-13, 1.9e-43, 0, 1.92}, 0, 0, CORE_ELEMENTWISE_LN_R, 9e14},
    {20, 1, {1.8e-13, 1.9e-43, 0, 1.92}, 0, 0, CORE_ELEMENTWISE_R, 9e12},
    /* a mirror source so high that its decay loses more digits than the real one's */
    {4,
     1,
     {2.3033910920041483e-28, 2.4839093460471816e-11, .88958312730094535, 1000},
     0,
     0,
     CORE_ELEMENTWISE_R,
     5.4575372017930732e+18},
    /* the transfer function where much energy leaves next to the source: g is nearly -1 */
    {12,
     3,
     {1.0106357881548659e-45, .00020925426848301547, -.99999999705651432, 1.36},
     0,
     0,
     CORE_ELEMENTWISE_TRANSFER,
     1.9112449384541714e-05},
    {14,
     2,
     {1.8366702107793426e-41, 14220919238.275045, -.99998287672687025, 2.4791144241602359},
     0,
     0,
     CORE_ELEMENTWISE_TRANSFER,
     1053741824},
    {12, 1, {.1, 1, -.9999999999999, 1.4}, 0, 0, CORE_ELEMENTWISE_TRANSFER, .02},
    /* and where R has underflowed, but its integral has not */
    {28,
     2,
     {.030696089341953087, .94027136305590608, 0, 1.1},
     0,
     2487.5903909224426,
     CORE_ELEMENTWISE_TRANSFER,
     .004449791248148348},
    {26, 1, {1, 1, 0, 1.3}, 0, 300, CORE_ELEMENTWISE_TRANSFER, .002},
    {12, 1, {0, 1, .9999999999, 1.4}, 0, 0, CORE_ELEMENTWISE_TRANSFER, 1e-8},
    {12, 1, {0, 1, .9999999999, 1.4}, 0, 0, CORE_ELEMENTWISE_TRANSFER, 1},
    /* a sigma_a whose share of sigma_t' underflows */
    {20, 1, {5e-324, 1e15, 0, 1.4}, 0, 0, CORE_ELEMENTWISE_R, 1},
    {20, 1, {1e-320, 1e3, 0, 1.4}, 0, 0, CORE_ELEMENTWISE_LN_R, 1},
    {20, 1, {1e-308, 1e15, 0, 1.4}, 0, 0, CORE_ELEMENTWISE_CDF, 1e140},
    /* radii below those that core.h once took for the least */
    {18, 1, {.1, 1, 0, 1.4}, 0, 0, CORE_ELEMENTWISE_LN_R, 1e-310},
    {2, 1, {.1, 1, 0, 1.4}, 0, 0, CORE_ELEMENTWISE_RING, 1e-305},
};

static const struct found in_f32[] = {
    /* a dense medium at radii where one factor of R has underflowed in single precision */
    {8,
     1,
     {1.324748585496003e-32, 1357309046064.0171, -.6469590153608511, .99999998742762908},
     0,
     0,
     CORE_ELEMENTWISE_R,
     233095008},
    {7, 1, {8.8995801120268256e-36, 17099814532338.553, 0, 1}, 0, 0, CORE_ELEMENTWISE_S, 66938120},
    /* dR/dr has more operations than R */
    {6,
     2,
     {.0013344157343949349, 550653.76899100537, 0, 2.1},
     0,
     0,
     CORE_ELEMENTWISE_SLOPE,
     .00019060341583099216},
    /* products with a radius in single precision that has underflowed before them */
    {2, 1, {.1, 1, 0, 1.4}, 0, 0, CORE_ELEMENTWISE_RING, 1e-29},
    {2, 1, {.1, 1, 0, 1.4}, 0, 0, CORE_ELEMENTWISE_PDF, 1e-34},
    {5, 1, {1e6, 1e6, 0, 1.4}, 0, 0, CORE_ELEMENTWISE_RING, 0x1p-143},
    {1, 1, {1, 1e3, 0, 1.3}, 0, 0, CORE_ELEMENTWISE_SLOPE, 1e-38},
};

static core_parameters parameters_of(const struct found *one) {
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_COS_IN] = parameters.value[CORE_PARAMETER_COS_OUT] = 1;
  if (one->tolerance > 0) {
    parameters.value[CORE_PARAMETER_TOLERANCE] = one->tolerance;
  }
  if (one->thickness > 0) {
    parameters.value[CORE_PARAMETER_THICKNESS] = one->thickness;
  }
  return parameters;
}

/* Returns whether the value is as near to the truth as its profile states. */
static bool is_right(const struct found *one, enum core_evaluator evaluator) {
  static form_model form;
  static const unsigned bits[CORE_ELEMENTWISE_COUNT] = {
      [CORE_ELEMENTWISE_R] = CORE_QUANTITY_R,
      [CORE_ELEMENTWISE_CDF] = CORE_QUANTITY_CDF,
      [CORE_ELEMENTWISE_LN_R] = CORE_QUANTITY_LN_R,
      [CORE_ELEMENTWISE_SLOPE] = CORE_QUANTITY_SLOPE,
      [CORE_ELEMENTWISE_S] = CORE_QUANTITY_S,
      [CORE_ELEMENTWISE_TRANSFER] = CORE_QUANTITY_TRANSFER,
      [CORE_ELEMENTWISE_PDF] = CORE_QUANTITY_PDF,
      [CORE_ELEMENTWISE_RING] = CORE_QUANTITY_RING,
  };
  const core_parameters parameters = parameters_of(one);
  core_profile profile;
  double value;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), one->model, one->moments,
                                         evaluator, &one->medium, &parameters),
                    NULL, 0);
  if (evaluator == CORE_EVALUATOR_F32) {
    const float r = (float)one->r;
    float narrow;
    core_eval_f32(&profile, bits[one->quantity], 1, &r, &narrow);
    value = (double)narrow;
  } else {
    core_eval_f64(&profile, bits[one->quantity], 1, &one->r, &value);
  }
  form_prepare(&form, one->model, one->moments, &one->medium, &parameters);
  const quad truth = form_truth(&form, form_at(&form, one->r, false), one->quantity, one->r);
  const double share = form_share(&form, &profile, one->quantity, one->r, value, truth, 0);
  core_profile_free(&profile);
  if (!(share <= 1)) {
    print_error("model %u, %s at %.9g: %.17g, not %.17g: %.3f of what is stated\n", one->model,
                evaluator == CORE_EVALUATOR_F32 ? "f32" : "f64", one->r, value, (double)truth,
                share);
  }
  return share <= 1;
}

UNIT_TEST(what_was_found_is_right) {
  size_t wrong = 0;
  for (size_t i = 0; i < sizeof in_f64 / sizeof in_f64[0]; i++) {
    wrong += !is_right(&in_f64[i], CORE_EVALUATOR_F64);
  }
  for (size_t i = 0; i < sizeof in_f32 / sizeof in_f32[0]; i++) {
    wrong += !is_right(&in_f32[i], CORE_EVALUATOR_F32);
  }
  assert_int_equal(wrong, 0);
}

/* The cdf of `beam` next to the source, by Simpson's rule over ln r of R in 113 bits. */
UNIT_TEST(the_cdf_of_a_beam_is_right_next_to_the_source) {
  static const struct {
    core_medium medium;
    double r, cdf;
  } known[] = {
      {{.01, 1, 0, 1.4}, 9.9009900990099006e-13, 1.3836845073962646e-23},
      {{.01, 1, 0, 1.4}, 9.9009900990099001e-08, 7.8922410233095209e-14},
      {{.01, 1, 0, 1.4}, 9.9009900990099013e-06, 5.5144139416569459e-10},
      {{1, 1, 0, 1.4}, 4.9999999999999999e-13, 7.3834424520749872e-23},
      {{1, 1, 0, 1.4}, 4.9999999999999998e-08, 4.1812199815651e-13},
      {{1, 1, 0, 1.4}, 5.0000000000000004e-06, 2.9003391668365315e-09},
  };
  for (size_t i = 0; i < sizeof known / sizeof known[0]; i++) {
    core_profile profile;
    unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BEAM, 1,
                                           CORE_EVALUATOR_F64, &known[i].medium, NULL),
                      NULL, 0);
    const double cdf = unit_value_at(&profile, CORE_QUANTITY_CDF, known[i].r);
    assert_true(fabs(cdf / known[i].cdf - 1) <= profile.numerical_error);
    core_profile_free(&profile);
  }
}

/* Where numbers on the way to a value underflow, also beside a radius of 0, no error is promised. */
UNIT_TEST(next_to_the_source_the_error_is_not_known) {
  static const double lists[][2] = {{0, 1e-310}, {1, 1e-270}, {0, 1e-200}, {0, 1e-20}};
  const core_medium medium = {0.1, 1, 0, 1.4};
  core_profile profile;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BEAM, 1,
                                         CORE_EVALUATOR_F64, &medium, NULL),
                    NULL, 0);
  for (int i = 0; i < 4; i++) {
    core_radii_range radii;
    unit_assert_fault(core_radii_check_f64(2, lists[i], &radii), NULL, 0);
    assert_int_equal(isinf(core_profile_errors(&profile, CORE_QUANTITY_R, radii).numerical), i < 2);
    assert_int_equal(isinf(core_profile_errors(&profile, CORE_QUANTITY_SLOPE, radii).numerical),
                     i < 3);
  }
  core_profile_free(&profile);
}

/* S where light from outside strikes a thinner medium next to the critical angle. */
UNIT_TEST(S_is_right_next_to_the_critical_angle) {
  static form_model form;
  const double r = 1;
  double value, worst = 0;
  size_t beyond = 0; /* at so many angles light enters */
  for (double eta = 0.0101; eta < 1; eta += 0.01) {
    const core_medium medium = {0, 1, 0, eta};
    core_parameters parameters = core_parameters_none();
    double cosine = sqrt(1 - eta * eta);
    for (double more = 1; more < 1e3; more *= 1.5) {
      core_profile profile;
      cosine = nextafter(cosine * (1 + more * 0x1p-52), 1);
      parameters.value[CORE_PARAMETER_COS_IN] = parameters.value[CORE_PARAMETER_COS_OUT] = cosine;
      unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BETTER, 1,
                                             CORE_EVALUATOR_F64, &medium, &parameters),
                        NULL, 0);
      core_eval_f64(&profile, CORE_QUANTITY_S, 1, &r, &value);
      form_prepare(&form, CORE_MODEL_BETTER, 1, &medium, &parameters);
      const quad truth = form_truth(&form, form_at(&form, r, false), CORE_ELEMENTWISE_S, r);
      beyond += truth > 0;
      worst = fmax(worst, form_share(&form, &profile, CORE_ELEMENTWISE_S, r, value, truth, 0));
      core_profile_free(&profile);
    }
  }
  printf("S next to the critical angle: at most %.3f of what is stated\n", worst);
  assert_true(worst <= 1 && beyond > 1000);
}

/* Returns a radius where ln R has a value, from 1e-45 to 1e6 mean free paths. */
static double radius_of(const core_profile *profile, double ln_R) {
  const double mfp_mm = 1 / core_sigma_t_prime(&profile->medium);
  double least = 1e-45 * mfp_mm, most = 1e6 * mfp_mm;
  for (int i = 0; i < 80; i++) {
    const double r = sqrt(least) * sqrt(most);
    *(unit_value_at(profile, CORE_QUANTITY_LN_R, r) > ln_R ? &least : &most) = r;
  }
  return least;
}

/* Around the largest and the smallest numbers of each precision, for media of all densities: values
 * are infinite where they are larger than the largest number and nowhere else, and they underflow
 * gradually. */
UNIT_TEST(values_are_right_next_to_the_largest_and_smallest_numbers) {
  static const double per_mm[] = {1e-3, 1, 1e8, 1e9, 1e10};
  static const double f64[] = {709.79, 709.77, -708.3, -712, -730, -742};
  static const double f32[] = {88.73, 88.71, -87.2, -90, -96, -102};
  static form_model form;
  size_t compared = 0;
  double worst = 0;
  for (int i = 0; i < 23 * 5 * 2; i++) {
    const unsigned model = CORE_MODEL_CLASSICAL + (unsigned)(i / 10);
    const bool single = i % 2 == 1;
    const double sigma = per_mm[i / 2 % 5];
    const core_medium medium = {0.1 * sigma, sigma, 0, 1.4};
    const core_parameters parameters = parameters_of(&(struct found){0});
    core_profile wide, profile;
    unit_assert_fault(core_profile_prepare(&wide, core_isa_select(NULL), model, 1,
                                           CORE_EVALUATOR_F64, &medium, &parameters),
                      NULL, 0);
    unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), model, 1,
                                           single ? CORE_EVALUATOR_F32 : CORE_EVALUATOR_F64,
                                           &medium, &parameters),
                      NULL, 0);
    form_prepare(&form, model, 1, &medium, &parameters);
    for (int k = 0; k < 6; k++) {
      const double found = radius_of(&wide, single ? f32[k] : f64[k]);
      const double r = single ? (double)(float)found : found;
      const form_values at = form_at(&form, r, false);
      for (int s = 0; s < 2 && r > 0; s++) {
        const double value = unit_value_at(&profile, s ? CORE_QUANTITY_S : CORE_QUANTITY_R, r);
        const enum core_elementwise quantity = s ? CORE_ELEMENTWISE_S : CORE_ELEMENTWISE_R;
        const double share =
            form_share(&form, &profile, quantity, r, value, form_truth(&form, at, quantity, r), 0);
        if (!(share <= 1)) {
          fail_msg("model %u, %s, sigma_s %g, %s at %.17g: %.17g, %.3f of what is stated", model,
                   single ? "f32" : "f64", sigma, s ? "S" : "R", r, value, share);
        }
        worst = fmax(worst, share);
        compared++;
      }
    }
    core_profile_free(&wide);
    core_profile_free(&profile);
  }
  printf("the largest and smallest numbers: %zu values, at most %.3f of what is stated\n", compared,
         worst);
  assert_true(compared > 2000);
}

/* A cdf that has reached 1 stays there. It once stepped back by an epsilon. */
UNIT_TEST(a_cdf_never_exceeds_1_and_stays_there) {
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
      const core_medium medium = {0.3, 1, 0, 1.4};
      const core_parameters parameters = unit_parameters(model->id, &medium);
      core_profile profile;
      unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), model->id, 1,
                                             evaluator->id, &medium, &parameters),
                        NULL, 0);
      double before = 0;
      for (double r = 0.5 * profile.scale_mm; r < 1e3 * profile.scale_mm; r *= 1.0003) {
        const double cdf = unit_value_at(&profile, CORE_QUANTITY_CDF, (double)(float)r);
        assert_true(cdf <= 1 && (before < 1 || cdf == 1));
        before = cdf;
      }
      core_profile_free(&profile);
    }
  }
}

/* An albedo that has underflowed to 0 has no cdf: it is 0 at infinity, too (core.h). */
UNIT_TEST(an_albedo_that_has_underflowed_has_no_cdf) {
  const core_medium medium = {1.115581921955049e-06, .0015423923707965296, -.19034407250105878,
                              1.06};
  const struct found slab = {.thickness = 74046473.510515705};
  const core_parameters parameters = parameters_of(&slab);
  const double r = (double)INFINITY;
  const float r_f32 = INFINITY;
  double cdf;
  float cdf_f32;
  core_profile profile;
  for (unsigned evaluator = CORE_EVALUATOR_F64; evaluator <= CORE_EVALUATOR_F32; evaluator++) {
    unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL),
                                           CORE_MODEL_BETTER_MULTIPOLE_TRANSMITTED, 1, evaluator,
                                           &medium, &parameters),
                      NULL, 0);
    assert_true(profile.albedo == 0);
    if (evaluator == CORE_EVALUATOR_F64) {
      core_eval_f64(&profile, CORE_QUANTITY_CDF, 1, &r, &cdf);
      assert_true(cdf == 0);
    } else {
      core_eval_f32(&profile, CORE_QUANTITY_CDF, 1, &r_f32, &cdf_f32);
      assert_true(cdf_f32 == 0);
    }
    core_profile_free(&profile);
  }
}

/* Samples where the cdf has a long plateau between the real and the mirrored source. */
UNIT_TEST(samples_are_right_where_the_mirrored_source_is_far) {
  const core_medium media[] = {{0, 1, 0, 43.936506262824352}, {1e-9, 1, 0, 900}, {0, 1, 0, .002}};
  enum { SAMPLES = 400 };
  double u[SAMPLES], r[SAMPLES], cdf[SAMPLES];
  float u_f32[SAMPLES], r_f32[SAMPLES];
  for (size_t m = 0; m < sizeof media / sizeof media[0]; m++) {
    for (unsigned model = CORE_MODEL_CLASSICAL; model <= CORE_MODEL_BOUNDARY_EXITANCE; model++) {
      core_profile f64, f32;
      unit_assert_fault(core_profile_prepare(&f64, core_isa_select(NULL), model, 1,
                                             CORE_EVALUATOR_F64, &media[m], NULL),
                        NULL, 0);
      unit_assert_fault(core_profile_prepare(&f32, core_isa_select(NULL), model, 1,
                                             CORE_EVALUATOR_F32, &media[m], NULL),
                        NULL, 0);
      for (int i = 0; i < SAMPLES; i++) {
        u[i] = (i + 0.5) / SAMPLES;
        u_f32[i] = (float)u[i];
      }
      core_sample_f64(&f64, SAMPLES, u, r);
      core_eval_f64(&f64, CORE_QUANTITY_CDF, SAMPLES, r, cdf);
      for (int i = 0; i < SAMPLES; i++) {
        assert_true(fabs(cdf[i] - u[i]) <= CORE_SAMPLE_ERROR_F64 + 2 * f64.numerical_error);
      }
      core_sample_f32(&f32, SAMPLES, u_f32, r_f32);
      for (int i = 0; i < SAMPLES; i++) {
        r[i] = (double)r_f32[i];
      }
      core_eval_f64(&f64, CORE_QUANTITY_CDF, SAMPLES, r, cdf);
      for (int i = 0; i < SAMPLES; i++) {
        assert_true(fabs(cdf[i] - (double)u_f32[i]) <= CORE_SAMPLE_ERROR_F32 + f32.numerical_error +
                                                           f32.numerical_error_per_mm * r[i]);
      }
      core_profile_free(&f64);
      core_profile_free(&f32);
    }
  }
}

/* The energy of a beam behind a boundary that hardly lets it out: the largest radii that matter are
 * many z_b away. */
UNIT_TEST(samples_of_a_beam_reach_as_far_as_its_energy) {
  const core_medium medium = {6.6146687839737058e-125, 2140064168.7218938, 0, 834.73977330846378};
  const double u[] = {0.5, 0.99999917, 1 - 1e-9};
  double r[3], cdf[3];
  core_profile profile;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BEAM, 1,
                                         CORE_EVALUATOR_F64, &medium, NULL),
                    NULL, 0);
  core_sample_f64(&profile, 3, u, r);
  core_eval_f64(&profile, CORE_QUANTITY_CDF, 3, r, cdf);
  for (int i = 0; i < 3; i++) {
    assert_true(fabs(cdf[i] - u[i]) <= CORE_SAMPLE_ERROR_F64 + 2 * profile.numerical_error);
  }
  core_profile_free(&profile);
}

/* A table's stated error holds between the arguments where building it has looked. */
UNIT_TEST(a_table_states_its_largest_error) {
  const struct {
    unsigned model;
    core_medium medium;
    double tolerance, from, to;
    enum core_quantity quantity;
  } tables[] = {
      {CORE_MODEL_SKIN_GREEN, {.034, .86, .56, 1.72}, 0, .1, 1, CORE_QUANTITY_R},
      {CORE_MODEL_BETTER, {0, 5e-9, 0, 1}, 0, 1e8, 4e8, CORE_QUANTITY_CDF},
  };
  double worst = 0;
  for (size_t i = 0; i < sizeof tables / sizeof tables[0]; i++) {
    for (double tolerance = 1e-5; tolerance < 0.05; tolerance *= 1.3) {
      core_parameters parameters = core_parameters_none();
      parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
      core_profile lut, f64;
      unit_assert_fault(core_profile_prepare(&lut, core_isa_select(NULL), tables[i].model, 3,
                                             CORE_EVALUATOR_LUT, &tables[i].medium, &parameters),
                        NULL, 0);
      unit_assert_fault(core_profile_prepare(&f64, core_isa_select(NULL), tables[i].model, 3,
                                             CORE_EVALUATOR_F64, &tables[i].medium, NULL),
                        NULL, 0);
      for (double at = tables[i].from; at < tables[i].to; at *= 1.0003) {
        const float r_f32 = (float)at;
        const double r = (double)r_f32;
        float value;
        double truth;
        core_eval_f32(&lut, tables[i].quantity, 1, &r_f32, &value);
        core_eval_f64(&f64, tables[i].quantity, 1, &r, &truth);
        worst = fmax(worst, fabs((double)value / truth - 1) / lut.numerical_error);
      }
      core_profile_free(&lut);
      core_profile_free(&f64);
    }
  }
  printf("tables: at most %.3f of what is stated\n", worst);
  assert_true(worst <= 1);
}

/* R of transport for g below 0 halfway between two albedos of its table, where its series are
 * furthest off. The truth is a solution with a tolerance of 1e-4, whose error it states
 * itself. */
UNIT_TEST(transport_between_the_albedos_of_its_table) {
  const core_medium medium = {0.0086343149442095583, 0.68876179057435116, -0.4393447758318606,
                              2.1485858171691916};
  static const double truth[][3] = {
      {12, 9.0219266e-05, 2.3e-5}, {16, 3.1239052e-05, 2.6e-5}, {20, 1.1687489e-05, 3.4e-5}};
  const unsigned evaluators[] = {CORE_EVALUATOR_F64, CORE_EVALUATOR_F32, CORE_EVALUATOR_LUT};
  for (size_t i = 0; i < sizeof evaluators / sizeof evaluators[0]; i++) {
    core_profile profile;
    unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                           CORE_MOMENTS_EXACT, evaluators[i], &medium, NULL),
                      NULL, 0);
    for (size_t j = 0; j < sizeof truth / sizeof truth[0]; j++) {
      const double r = truth[j][0];
      const float r_f32 = (float)r;
      double R;
      float R_f32;
      if (evaluators[i] == CORE_EVALUATOR_F64) {
        core_eval_f64(&profile, CORE_QUANTITY_R, 1, &r, &R);
      } else {
        core_eval_f32(&profile, CORE_QUANTITY_R, 1, &r_f32, &R_f32);
        R = (double)R_f32;
      }
      const double stated =
          core_profile_errors(&profile, CORE_QUANTITY_R, (core_radii_range){r, r}).numerical;
      assert_true(fabs(R / truth[j][1] - 1) <= stated + truth[j][2]);
    }
    core_profile_free(&profile);
  }
}

/* dR/dr of transport by table is that of the stored solutions, whose slopes are less exact than
 * their values, whatever the tolerance of the table. */
UNIT_TEST(slopes_beside_a_table_have_an_error_of_their_own) {
  const core_medium medium = {9.8273266432665927e-05, 2.2953981017321046, 0, 2.08};
  const float r_f32 = 0.51388126611709595F;
  const double r = (double)r_f32;
  for (double tolerance = 1e-5; tolerance < 1e-3; tolerance *= 2) {
    core_parameters parameters = core_parameters_none();
    core_profile lut, exact;
    float slope;
    double truth;
    parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
    unit_assert_fault(core_profile_prepare(&lut, core_isa_select(NULL), CORE_MODEL_TRANSPORT, 4,
                                           CORE_EVALUATOR_LUT, &medium, &parameters),
                      NULL, 0);
    parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-8;
    unit_assert_fault(core_profile_prepare(&exact, core_isa_select(NULL), CORE_MODEL_TRANSPORT, 4,
                                           CORE_EVALUATOR_F64, &medium, &parameters),
                      NULL, 0);
    core_eval_f32(&lut, CORE_QUANTITY_SLOPE, 1, &r_f32, &slope);
    core_eval_f64(&exact, CORE_QUANTITY_SLOPE, 1, &r, &truth);
    const core_radii_range radii = {r, r};
    const double stated = core_profile_errors(&lut, CORE_QUANTITY_SLOPE, radii).numerical;
    assert_true(fabs((double)slope / truth - 1) <= stated + 1e-8);
    assert_true(core_profile_errors(&lut, CORE_QUANTITY_R, radii).numerical <= tolerance);
    core_profile_free(&lut);
    core_profile_free(&exact);
  }
}

/* Far away in a dark medium, where R is below what the table's solutions resolve. The truth is a
 * solution with a tolerance of 1e-4. */
UNIT_TEST(transport_with_g_where_its_table_ends) {
  const core_medium medium = {0.54875120806794742, 1.6528208203568595, 0.72698263092146687, 1};
  const double truth[][2] = {{23.334396362304688, 2.2871e-15}, {24.4, 6.649e-16}};
  core_profile profile;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                         CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &medium, NULL),
                    NULL, 0);
  for (size_t i = 0; i < sizeof truth / sizeof truth[0]; i++) {
    const double r = truth[i][0];
    double R;
    core_eval_f64(&profile, CORE_QUANTITY_R, 1, &r, &R);
    const double stated =
        core_profile_errors(&profile, CORE_QUANTITY_R, (core_radii_range){r, r}).numerical;
    assert_true(fabs(R / truth[i][1] - 1) <= stated + 2e-4);
  }
  core_profile_free(&profile);
}
