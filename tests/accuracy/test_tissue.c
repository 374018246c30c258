/* Tissues: published spectra against numbers of second sources, against ../shared/spectra if it is
 * there, and at their ends; the scattering law; vessels; the test value of VTS; refusals. */
#include "core/tissue/tissue.h"

#include <math.h>

#include "tests/unit/unit.h"

#define UM_OF_1_MM 1e3 /* uM in 1 mM */

static double spectrum_at(enum core_property chromophore, enum core_haemoglobin table, double nm) {
  double per_mm;
  unit_accept(core_chromophore_at(chromophore, table, nm, &per_mm));
  return per_mm;
}

static double prahl_at(enum core_property chromophore, double nm) {
  return spectrum_at(chromophore, CORE_HAEMOGLOBIN_PRAHL, nm);
}

static double ucl_at(enum core_property chromophore, double nm) {
  return spectrum_at(chromophore, CORE_HAEMOGLOBIN_UCL, nm);
}

static void assert_within(double value, double expected, double relative) {
  UNIT_FAIL_IF(!(fabs(value - expected) <= relative * fabs(expected)), "%.6g, not %.6g within %g",
               value, expected, relative);
}

static core_tissue tissue_of(double a_per_mm, double b) {
  core_tissue tissue = core_tissue_named(0);
  tissue.value[CORE_PROPERTY_A] = a_per_mm;
  tissue.value[CORE_PROPERTY_B] = b;
  return tissue;
}

static core_medium medium_at(const core_tissue *tissue, double nm) {
  core_medium medium;
  unit_accept(core_tissue_medium(tissue, nm, &medium));
  return medium;
}

static double reduced_at(const core_tissue *tissue, double nm) {
  const core_medium medium = medium_at(tissue, nm);
  return medium.sigma_s_per_mm * (1 - medium.g);
}

/* ---- spectra --------------------------------------------------------------------------------- */

UNIT_TEST(haemoglobins_differ_as_published) {
  static const struct {
    double nm, ratio;
  } hb[] = {{650, .996}, {690, 1.04}, {730, 1.18}, {760, 1.08},
            {800, 1.10}, {830, 1.13}, {900, 1.17}, {1000, 1.31}};
  for (size_t i = 0; i < sizeof hb / sizeof hb[0]; i++) {
    assert_within(ucl_at(CORE_PROPERTY_HB, hb[i].nm) / prahl_at(CORE_PROPERTY_HB, hb[i].nm),
                  hb[i].ratio, .006);
  }
  for (double nm = 650; nm <= 1000; nm += 10) {
    const double ratio = ucl_at(CORE_PROPERTY_HBO2, nm) / prahl_at(CORE_PROPERTY_HBO2, nm);
    assert_true(ratio > 1.03 && ratio < 1.155);
  }
  /* natural, 1/mm per mM: VTS's table at 800 nm; Wray et al. 1988 at 730 and 800 nm */
  assert_within(prahl_at(CORE_PROPERTY_HBO2, 800) * UM_OF_1_MM, .1898, .011);
  assert_within(ucl_at(CORE_PROPERTY_HB, 730) * UM_OF_1_MM, .299, .01);
  assert_within(ucl_at(CORE_PROPERTY_HBO2, 800) * UM_OF_1_MM, .198, .01);
  /* Jacques 2013, p. R49: 0.01 of blood at 806 nm is 0.00438 1/mm, by another table */
  assert_within(23.3 * prahl_at(CORE_PROPERTY_HBO2, 806), .00438, .04);
}

UNIT_TEST(the_isosbestic_point_is_near_800_nm) {
  assert_true(prahl_at(CORE_PROPERTY_HB, 796) > prahl_at(CORE_PROPERTY_HBO2, 796));
  assert_true(prahl_at(CORE_PROPERTY_HB, 800) < prahl_at(CORE_PROPERTY_HBO2, 800));
  assert_true(ucl_at(CORE_PROPERTY_HB, 796) > ucl_at(CORE_PROPERTY_HBO2, 796));
  assert_true(ucl_at(CORE_PROPERTY_HB, 802) < ucl_at(CORE_PROPERTY_HBO2, 802));
}

UNIT_TEST(other_spectra_are_natural_and_per_mm) {
  /* Matcher et al. 1994 at 37 C, decadic 1/cm, times ln 10: another temperature */
  static const struct {
    double nm, per_mm, ratio;
  } water[] = {{740, .003026, 1.09},
               {800, .002201, .98},
               {930, .01322, 1.07},
               {970, .05059, 1.05},
               {1000, .03967, .97}};
  for (size_t i = 0; i < sizeof water / sizeof water[0]; i++) {
    assert_within(water[i].per_mm / prahl_at(CORE_PROPERTY_WATER, water[i].nm), water[i].ratio,
                  .006);
  }
  static const struct {
    double nm, flattening;
  } blood[] = {{420, .45}, {450, .94}, {542, .96}, {800, .87}};
  for (size_t i = 0; i < 4; i++) {
    assert_within(prahl_at(CORE_PROPERTY_BLOOD, blood[i].nm),
                  2326 * prahl_at(CORE_PROPERTY_HBO2, blood[i].nm) * blood[i].flattening, .012);
  }
  assert_within(prahl_at(CORE_PROPERTY_WATER, 975), .0505, .1); /* UCL's 0.2193, decadic 1/cm */
  assert_within(prahl_at(CORE_PROPERTY_WATER, 980), .0482, .01);
  assert_within(prahl_at(CORE_PROPERTY_FAT, 930), .0131, .005);
  assert_within(prahl_at(CORE_PROPERTY_MELANIN, 500), 51.9, 1e-14);
  assert_within(prahl_at(CORE_PROPERTY_MELANIN, 1000), 51.9 / 8, 1e-14);
  assert_within(6.6e10 * pow(500, -3.33) / prahl_at(CORE_PROPERTY_MELANIN, 500), 1.31, .01);
  assert_within(6.6e10 * pow(800, -3.33) / prahl_at(CORE_PROPERTY_MELANIN, 800), 1.12, .01);
  assert_within(prahl_at(CORE_PROPERTY_BILIRUBIN, 450.8), 55000 * log(10) * 1e-7, .002);
  assert_within(prahl_at(CORE_PROPERTY_CAROTENE, 451), 139500 * log(10) * 1e-7, .011);
  assert_true(prahl_at(CORE_PROPERTY_CAROTENE, 600) == 0);
  assert_within(prahl_at(CORE_PROPERTY_CCO_OX, 830) - prahl_at(CORE_PROPERTY_CCO_RED, 830),
                2.35 * log(10) * 1e-4, .01);
  assert_within(prahl_at(CORE_PROPERTY_BLOODLESS, 500), .0244 + 8.53 * exp(-(500 - 154) / 66.2),
                1e-13);
}

/* The names of columns of ../shared/spectra/spectra.csv, from `from_nm` on. */
static const struct {
  const char *column;
  enum core_property chromophore;
  enum core_haemoglobin table;
  double from_nm, to_nm;
} columns[] = {
    {"HbO2", CORE_PROPERTY_HBO2, CORE_HAEMOGLOBIN_PRAHL, 0, 2000},
    {"Hb", CORE_PROPERTY_HB, CORE_HAEMOGLOBIN_PRAHL, 0, 2000},
    {"HbO2_UCL", CORE_PROPERTY_HBO2, CORE_HAEMOGLOBIN_UCL, 0, 2000},
    {"Hb_UCL", CORE_PROPERTY_HB, CORE_HAEMOGLOBIN_UCL, 0, 2000},
    {"blood_oxy_B14", CORE_PROPERTY_BLOOD, CORE_HAEMOGLOBIN_PRAHL, 0, 2000},
    {"water_Segelstein", CORE_PROPERTY_WATER, CORE_HAEMOGLOBIN_PRAHL, 0, 660},
    {"water_Kou", CORE_PROPERTY_WATER, CORE_HAEMOGLOBIN_PRAHL, 670, 2000},
    {"fat", CORE_PROPERTY_FAT, CORE_HAEMOGLOBIN_PRAHL, 0, 2000},
    {"melanosome", CORE_PROPERTY_MELANIN, CORE_HAEMOGLOBIN_PRAHL, 0, 2000},
    {"bilirubin", CORE_PROPERTY_BILIRUBIN, CORE_HAEMOGLOBIN_PRAHL, 0, 560},
    {"carotene", CORE_PROPERTY_CAROTENE, CORE_HAEMOGLOBIN_PRAHL, 0, 520},
    {"CCO_ox", CORE_PROPERTY_CCO_OX, CORE_HAEMOGLOBIN_PRAHL, 0, 2000},
    {"CCO_red", CORE_PROPERTY_CCO_RED, CORE_HAEMOGLOBIN_PRAHL, 0, 2000},
};
enum { COLUMNS = sizeof columns / sizeof columns[0], CELLS_MAX = 32 };

/* Splits a line of CSV in place. */
static size_t split_line(char *line, char *cells[CELLS_MAX]) {
  size_t count = 0;
  for (char *one; count < CELLS_MAX && (one = strsep(&line, ",")) != NULL;) {
    cells[count++] = one;
  }
  return count;
}

UNIT_TEST(spectra_are_those_of_the_collected_table) {
  char *text = unit_read_file("../shared/spectra/spectra.csv");
  text = text != NULL ? text : unit_read_file("../../shared/spectra/spectra.csv");
  if (text == NULL) {
    skip();
  }
  char *names[CELLS_MAX], *cells[CELLS_MAX], *rest = text, *line;
  size_t name_count = 0, compared = 0;
  while ((line = strsep(&rest, "\n")) != NULL) {
    if (line[0] == '#' || line[0] == '\0') {
      continue;
    }
    if (name_count == 0) {
      name_count = split_line(line, names);
      continue;
    }
    const size_t count = split_line(line, cells);
    const double nm = atof(cells[0]);
    for (size_t i = 0; i < COLUMNS; i++) {
      for (size_t k = 1; k < count; k++) {
        if (strcmp(names[k], columns[i].column) == 0 && cells[k][0] != '\0' &&
            nm >= columns[i].from_nm && nm <= columns[i].to_nm) {
          assert_within(spectrum_at(columns[i].chromophore, columns[i].table, nm), atof(cells[k]),
                        1e-3);
          compared++;
        }
      }
    }
  }
  free(text);
  printf("%zu numbers compared\n", compared);
  assert_true(compared > 600);
}

UNIT_TEST(no_spectrum_goes_on_beyond_its_ends) {
  static const struct {
    enum core_property chromophore;
    enum core_haemoglobin table;
    double from_nm, to_nm;
  } ends[] = {
#define ANY PRAHL
#define CORE_SPECTRUM(PROPERTY, HAEMOGLOBIN, from_nm, to_nm, ...)                                  \
  {CORE_PROPERTY_##PROPERTY, TABLE(HAEMOGLOBIN), from_nm, to_nm},
#define TABLE(HAEMOGLOBIN) TABLE_(HAEMOGLOBIN)
#define TABLE_(HAEMOGLOBIN) CORE_HAEMOGLOBIN_##HAEMOGLOBIN
#define CORE_FORMULA(PROPERTY, from_nm, to_nm, ...)                                                \
  {CORE_PROPERTY_##PROPERTY, CORE_HAEMOGLOBIN_PRAHL, from_nm, to_nm},
#include "core/tissue/spectra.def"
  };
  bool seen[CORE_CHROMOPHORES_MAX + 1] = {false};
  for (size_t i = 0; i < sizeof ends / sizeof ends[0]; i++) {
    double per_mm = -1;
    const double outside[] = {nextafter(ends[i].from_nm, 0), nextafter(ends[i].to_nm, 1e9),
                              (double)NAN, -1, INFINITY};
    for (size_t k = 0; k < 5; k++) {
      unit_assert_fault(
          core_chromophore_at(ends[i].chromophore, ends[i].table, outside[k], &per_mm),
          "wavelength", 0);
      assert_true(per_mm == -1);
    }
    assert_true(spectrum_at(ends[i].chromophore, ends[i].table, ends[i].from_nm) > 0);
    assert_true(spectrum_at(ends[i].chromophore, ends[i].table, ends[i].to_nm) >= 0);
    seen[ends[i].chromophore] = true;
  }
  for (const core_choice *one = core_properties; one->name != NULL; one++) {
    assert_true(one->id > CORE_CHROMOPHORES_MAX || seen[one->id]);
  }
}

/* ---- tissues --------------------------------------------------------------------------------- */

/* VTS, TissueTests.cs: 0.067854 1/mm, and 0.84 1/mm by its law 0.84 (lambda / 1000)^-0.55. */
UNIT_TEST(liver_at_1000_nm_is_that_of_VTS) {
  core_tissue liver = core_tissue_named(core_choice_by_name(core_tissues, "liver")->id);
  assert_within(medium_at(&liver, 1000).sigma_a_per_mm, .067854, .001);
  liver.value[CORE_PROPERTY_A] = .84 * pow(2, .55);
  liver.value[CORE_PROPERTY_B] = .55;
  assert_within(reduced_at(&liver, 1000), .84, 1e-14);
  assert_within(medium_at(&liver, 1000).sigma_s_per_mm, 8.4, 1e-14);
  assert_true(medium_at(&liver, 1000).g == .9 && medium_at(&liver, 1000).eta == 1.4);
}

/* Jacques 2013, Table 2: both laws of skin. */
UNIT_TEST(scattering_is_a_power_law) {
  core_tissue skin = tissue_of(4.6, 1.421);
  assert_within(reduced_at(&skin, 500), 4.6, 1e-14);
  for (double nm = 400; nm <= 1300; nm += 50) {
    assert_within(reduced_at(&skin, nm), 4.6 * pow(nm / 500, -1.421), 1e-14);
  }
  skin = tissue_of(4.8, .702);
  skin.value[CORE_PROPERTY_RAYLEIGH] = .409;
  assert_within(reduced_at(&skin, 1000), 4.8 * (.409 / 16 + .591 * pow(2, -.702)),
                1e-14); /* f^-4, not f^1e-4 */
  skin.value[CORE_PROPERTY_HBO2] = 1;
  assert_true(medium_at(&skin, 650).sigma_a_per_mm == prahl_at(CORE_PROPERTY_HBO2, 650));
  skin.value[CORE_PROPERTY_G] = -.5;
  assert_within(medium_at(&skin, 500).sigma_s_per_mm, 4.8 / 1.5, 1e-14);
}

UNIT_TEST(vessels_hide_blood) {
  static const struct {
    double nm, of_10_um, of_50_um;
  } known[] = {{420, .19, .04}, {542, .76, .33}, {600, .98, .92}, {800, 1, .98}};
  core_tissue blood = tissue_of(0, 0);
  blood.value[CORE_PROPERTY_HBO2] = 2326;
  for (size_t i = 0; i < 4; i++) {
    const double free_per_mm = prahl_at(CORE_PROPERTY_HBO2, known[i].nm);
    blood.value[CORE_PROPERTY_VESSEL_RADIUS] = .01;
    assert_true(fabs(core_tissue_packaging(&blood, free_per_mm, 0) - known[i].of_10_um) < .0051);
    blood.value[CORE_PROPERTY_VESSEL_RADIUS] = .05;
    assert_true(fabs(core_tissue_packaging(&blood, free_per_mm, 0) - known[i].of_50_um) < .0051);
    assert_within(medium_at(&blood, known[i].nm).sigma_a_per_mm,
                  2326 * free_per_mm * core_tissue_packaging(&blood, free_per_mm, 0), 1e-14);
  }
  /* a tenth of the blood with a saturation of 0.25 has the same factor, and other absorbers none */
  core_tissue tissue = tissue_of(0, 0);
  tissue.value[CORE_PROPERTY_HBO2] = 58.15;
  tissue.value[CORE_PROPERTY_HB] = 174.45;
  tissue.value[CORE_PROPERTY_WATER] = .6;
  tissue.value[CORE_PROPERTY_VESSEL_RADIUS] = .03;
  const double x =
      .06 * 2326 *
      (.25 * prahl_at(CORE_PROPERTY_HBO2, 560) + .75 * prahl_at(CORE_PROPERTY_HB, 560));
  assert_within(medium_at(&tissue, 560).sigma_a_per_mm,
                x / .6 * (1 - exp(-x)) / x + .6 * prahl_at(CORE_PROPERTY_WATER, 560), 1e-13);
  /* the series and the quotient meet; without radius there is no effect */
  tissue.value[CORE_PROPERTY_HB] = 0;
  for (double mu = 7e-6; mu < 7.4e-6; mu += 2e-8) {
    const double y = .06 * 2326 * mu;
    assert_within(core_tissue_packaging(&tissue, mu, 0), -expm1(-y) / y, 1e-12);
  }
  tissue.value[CORE_PROPERTY_VESSEL_RADIUS] = 0;
  assert_true(core_tissue_packaging(&tissue, 1, 1) == 1);
}

UNIT_TEST(named_tissues_are_valid) {
  for (const core_choice *one = core_tissues; one->name != NULL; one++) {
    core_tissue tissue = core_tissue_named(one->id);
    const bool scatters = strstr(one->about, "give a and b") == NULL;
    unit_assert_fault(core_tissue_check(&tissue), scatters ? NULL : "a_per_mm", 0);
    tissue.value[CORE_PROPERTY_A] = 1;
    tissue.value[CORE_PROPERTY_B] = 1;
    assert_true(medium_at(&tissue, 650).sigma_a_per_mm > 0);
  }
}

/* ---- refusals -------------------------------------------------------------------------------- */

static void assert_refused(enum core_property property, double value, const char *field) {
  core_tissue tissue = tissue_of(1, 1);
  core_medium medium = {.eta = 7};
  tissue.value[CORE_PROPERTY_BLOOD] = .1;
  tissue.value[property] = value;
  unit_assert_fault(core_tissue_medium(&tissue, 650, &medium), field, 0);
  assert_true(medium.eta == 7);
}

UNIT_TEST(refuses_what_is_no_tissue) {
#define REFUSES(P, id, IDENT, name, about, least, most, usual)                                     \
  assert_refused(CORE_PROPERTY_##IDENT, nextafter(least, -INFINITY), name);                        \
  assert_refused(CORE_PROPERTY_##IDENT, nextafter(most, INFINITY), name);                          \
  assert_refused(CORE_PROPERTY_##IDENT, (double)NAN, name);
  CORE_EACH_PROPERTY(REFUSES, )
  assert_refused(CORE_PROPERTY_VESSEL_RADIUS, .01, "vessel_radius_mm"); /* with whole blood */
}

/* tests/e2e/wrong.txt has those that are refused. */
UNIT_TEST(without_scattering_its_law_does_not_matter) {
  core_tissue tissue = tissue_of(0, 0);
  tissue.value[CORE_PROPERTY_WATER] = 1;
  assert_true(medium_at(&tissue, 300).sigma_s_per_mm == 0);
}
