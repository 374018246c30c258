/* Media: the measured ones, and those that do not scatter. Which ones are valid, and what is refused, is
 * in tests/e2e/wrong.txt. */
#include <math.h>

#include "tests/unit/unit.h"

/* ---- profiles ----------------------------------------------------------------------------- */

/* No light returns from a medium that does not scatter. */
UNIT_TEST(without_scattering_everything_is_zero) {
  static const core_medium absorbing = {0.3, 0, 0.5, 1.3};
  static const double radii[] = {0, 1e-9, 1, 1e9, INFINITY};
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    core_profile profile;
    double R[5], cdf[5];
    const core_medium medium = unit_medium(model->id, &absorbing);
    const core_fault fault =
        core_profile_prepare(&profile, core_isa_select(NULL), model->id, CORE_MOMENTS_EXACT,
                             CORE_EVALUATOR_F64, &medium, NULL);
    if (model->id == CORE_MODEL_GAUSSIANS) { /* R is 0, so there is nothing to fit. */
      unit_assert_fault(fault, "fit_from", 0);
      continue;
    }
    unit_accept(fault);
    if ((profile.notes & CORE_NOTE_MEDIUM_UNUSED) != 0) {
      core_profile_free(&profile);
      continue;
    }
    assert_true(profile.albedo == 0);
    core_eval_f64(&profile, CORE_QUANTITY_R, 5, radii, R);
    core_eval_f64(&profile, CORE_QUANTITY_CDF, 5, radii, cdf);
    for (size_t i = 0; i < 5; i++) {
      assert_true(R[i] == 0 && cdf[i] == 0);
    }
    core_profile_free(&profile);
  }
}

/* ---- the measured list -------------------------------------------------------------------- */

static void assert_measured(const char *name, const double sigma_s[3], const double sigma_a[3]) {
  const core_measured_medium *medium = core_measured_medium_by_name(name);
  assert_non_null(medium);
  assert_string_equal(medium->name, name);
  assert_int_equal(medium->layer_count, 1);
  for (size_t i = 0; i < 3; i++) {
    assert_true(medium->channel[i].sigma_s_per_mm == sigma_s[i]);
    assert_true(medium->channel[i].sigma_a_per_mm == sigma_a[i]);
    assert_true(medium->channel[i].g == 0);
    assert_true(medium->channel[i].eta == 1.3);
  }
}

/* Jensen et al. 2001, Figure 5: sigma_s' and sigma_a in 1/mm. */
UNIT_TEST(measured_media_are_the_published_ones) {
  static const struct {
    const char *name;
    double sigma_s[3];
    double sigma_a[3];
  } published[] = {
      {"apple", {2.29, 2.39, 1.97}, {0.0030, 0.0034, 0.046}},
      {"chicken1", {0.15, 0.21, 0.38}, {0.015, 0.077, 0.19}},
      {"chicken2", {0.19, 0.25, 0.32}, {0.018, 0.088, 0.20}},
      {"cream", {7.38, 5.47, 3.15}, {0.0002, 0.0028, 0.0163}},
      {"ketchup", {0.18, 0.07, 0.03}, {0.061, 0.97, 1.45}},
      {"marble", {2.19, 2.62, 3.00}, {0.0021, 0.0041, 0.0071}},
      {"potato", {0.68, 0.70, 0.55}, {0.0024, 0.0090, 0.12}},
      {"skimmilk", {0.70, 1.22, 1.90}, {0.0014, 0.0025, 0.0142}},
      {"skin1", {0.74, 0.88, 1.01}, {0.032, 0.17, 0.48}},
      {"skin2", {1.09, 1.59, 1.79}, {0.013, 0.070, 0.145}},
      {"spectralon", {11.6, 20.4, 14.9}, {0, 0, 0}},
      {"wholemilk", {2.55, 3.21, 3.77}, {0.0011, 0.0024, 0.014}},
  };
  const size_t count = sizeof published / sizeof published[0];
  assert_int_equal(core_measured_media_count, count + 3); /* and three of skin */
  for (size_t i = 0; i < count; i++) {
    assert_measured(published[i].name, published[i].sigma_s, published[i].sigma_a);
  }
}

/* Jacques 2013: sigma_a by Eq. 8, 12 and Table 3, sigma_s' by Table 1, with Prahl's haemoglobin. */
UNIT_TEST(skin_is_made_of_published_values) {
  static const struct {
    const char *name;
    double melanosomes, haemoglobin_uM, oxygen;
  } skins[] = {{"skin-light", 0.0087, 7.9, 0.985},
               {"skin-medium", 0.0115, 9.6, 0.992},
               {"skin-dark", 0.0165, 2.7, 0.993}};
  static const double waves_nm[] = {610, 550, 460};
  static const double haemoglobin[][2] = {/* with oxygen and without, 1/mm per uM */
                                          {0.0003468, 0.002174},
                                          {0.009905, 0.0123},
                                          {0.01024, 0.005385}};
  for (size_t i = 0; i < 3 * 3; i++) {
    const size_t c = i % 3;
    const core_measured_medium *skin = core_measured_medium_by_name(skins[i / 3].name);
    assert_non_null(skin);
    const core_medium *layers = &skin->channel[c * skin->layer_count];
    const double share = skins[i / 3].oxygen, wave = waves_nm[c] / 500;
    const double bloodless = 0.0244 + 8.53 * exp(-(waves_nm[c] - 154) / 66.2);
    const double blood = share * haemoglobin[c][0] + (1 - share) * haemoglobin[c][1];
    const double g = 0.62 + 0.00029 * waves_nm[c];
    const core_medium expected[] = {{skins[i / 3].melanosomes * 51.9 * pow(wave, -3) + bloodless,
                                     6.87 * pow(wave, -1.161) / (1 - g), g, 1.4, 0.06},
                                    {skins[i / 3].haemoglobin_uM * blood + bloodless,
                                     4.53 * pow(wave, -1.292) / (1 - g), g, 1.4, 0}};
    assert_int_equal(skin->layer_count, 2);
    for (size_t layer = 0; layer < 2; layer++) {
      assert_true(fabs(layers[layer].sigma_a_per_mm / expected[layer].sigma_a_per_mm - 1) < 0.005);
      assert_true(fabs(layers[layer].sigma_s_per_mm / expected[layer].sigma_s_per_mm - 1) < 0.001);
      assert_true(fabs(layers[layer].g - g) < 0.0006 && layers[layer].eta == 1.4);
      assert_true(layers[layer].thickness_mm == expected[layer].thickness_mm);
    }
  }
}

UNIT_TEST(measured_media_are_valid_and_found_by_name_only) {
  for (size_t i = 0; i < core_measured_media_count; i++) {
    const core_measured_medium *medium = &core_measured_media[i];
    assert_ptr_equal(core_measured_medium_by_name(medium->name), medium);
    for (size_t channel = 0; channel < 3; channel++) {
      const core_medium *layers = &medium->channel[channel * medium->layer_count];
      unit_accept(core_layers_check(layers, medium->layer_count));
    }
  }
  assert_null(core_measured_medium_by_name(""));
  assert_null(core_measured_medium_by_name("skin"));
  assert_null(core_measured_medium_by_name("skin10"));
  assert_null(core_measured_medium_by_name("Skin1"));
}
