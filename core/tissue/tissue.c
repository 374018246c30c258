#include "core/tissue/tissue.h"

#include <assert.h>
#include <math.h>

#include "core/transport/functions.h"

#define END                                                                                        \
  { 0, NULL, NULL }

#define PROPERTY(P, id, IDENT, name, about, least, most, usual)                                    \
  {id, name, about " (" #least " to " #most ")"},
const core_choice core_properties[] = {CORE_EACH_PROPERTY(PROPERTY, ) END};
#define ENTRY(P, id, IDENT, name, source, ...) {id, name, source},
const core_choice core_haemoglobins[] = {CORE_EACH_HAEMOGLOBIN(ENTRY, ) END};
const core_choice core_tissues[] = {CORE_EACH_TISSUE(ENTRY, ) END};

/* ---- spectra --------------------------------------------------------------------------------- */

#define LN_10 2.302585092994045684

/* A spectrum: numbers at equal steps, or a formula. */
typedef struct spectrum {
  enum core_property chromophore;
  unsigned haemoglobin; /* the table that it belongs to; 0: all */
  double from_nm, to_nm, factor;
  const double *numbers; /* [count] */
  size_t count;
  double (*formula)(double nm);
  const char *range;
} spectrum;

enum { ANY = 0, PRAHL = CORE_HAEMOGLOBIN_PRAHL, UCL = CORE_HAEMOGLOBIN_UCL };

#define COUNT_OF(PROPERTY, HAEMOGLOBIN) (sizeof numbers_##PROPERTY##_##HAEMOGLOBIN / sizeof(double))
#define CORE_SPECTRUM(PROPERTY, HAEMOGLOBIN, from_nm, to_nm, factor, source, ...)                  \
  static const double numbers_##PROPERTY##_##HAEMOGLOBIN[] = {__VA_ARGS__};                        \
  _Static_assert((to_nm - from_nm) % (COUNT_OF(PROPERTY, HAEMOGLOBIN) - 1) == 0, "whole steps");
#define CORE_FORMULA(PROPERTY, from_nm, to_nm, per_mm, source)                                     \
  static double formula_##PROPERTY(double nm) {                                                    \
    return per_mm;                                                                                 \
  }
#include "core/tissue/spectra.def"

#define RANGE(property, from, to, source)                                                          \
  from " to " to " nm, the range of " property " (" source ")"

static const spectrum spectra[] = {
#define CORE_SPECTRUM(PROPERTY, HAEMOGLOBIN, from_nm, to_nm, factor, source, ...)                  \
  {CORE_PROPERTY_##PROPERTY,                                                                       \
   HAEMOGLOBIN,                                                                                    \
   from_nm,                                                                                        \
   to_nm,                                                                                          \
   factor,                                                                                         \
   numbers_##PROPERTY##_##HAEMOGLOBIN,                                                             \
   COUNT_OF(PROPERTY, HAEMOGLOBIN),                                                                \
   NULL,                                                                                           \
   RANGE(#PROPERTY, #from_nm, #to_nm, source)},
#define CORE_FORMULA(PROPERTY, from_nm, to_nm, per_mm, source)                                     \
  {CORE_PROPERTY_##PROPERTY,                                                                       \
   ANY,                                                                                            \
   from_nm,                                                                                        \
   to_nm,                                                                                          \
   1,                                                                                              \
   NULL,                                                                                           \
   0,                                                                                              \
   formula_##PROPERTY,                                                                             \
   RANGE(#PROPERTY, #from_nm, #to_nm, source)},
#include "core/tissue/spectra.def"
};

core_fault core_chromophore_at(enum core_property chromophore, enum core_haemoglobin haemoglobin,
                               double wavelength_nm, double *per_mm) {
  const spectrum *one = spectra;
  while (one->chromophore != chromophore ||
         (one->haemoglobin != ANY && one->haemoglobin != haemoglobin)) {
    one++;
    assert(one < spectra + sizeof spectra / sizeof spectra[0]);
  }
  if (!(wavelength_nm >= one->from_nm && wavelength_nm <= one->to_nm)) {
    return (core_fault){"wavelength", one->range, 0};
  }
  if (one->formula != NULL) {
    *per_mm = one->formula(wavelength_nm);
    return (core_fault){0};
  }
  const size_t last = one->count - 1;
  const double step_nm = (one->to_nm - one->from_nm) / (double)last; /* exact */
  const double place = (wavelength_nm - one->from_nm) / step_nm;
  const size_t k = (size_t)place < last ? (size_t)place : last - 1;
  const double share = place - (double)k;
  *per_mm = one->factor * ((1 - share) * one->numbers[k] + share * one->numbers[k + 1]);
  return (core_fault){0};
}

/* ---- tissues --------------------------------------------------------------------------------- */

core_tissue core_tissue_named(unsigned id) {
#define IDENT_OF(P, id, IDENT, ...) IDENT = CORE_PROPERTY_##IDENT,
#define USUAL_OF(P, id, IDENT, name, about, least, most, usual) [IDENT] = (double)(usual),
#define VALUES_OF(P, id, IDENT, name, source, ...) {id, {__VA_ARGS__}},
  enum { CORE_EACH_PROPERTY(IDENT_OF, ) };
  core_tissue tissue = {.haemoglobin = CORE_HAEMOGLOBIN_PRAHL,
                        .value = {CORE_EACH_PROPERTY(USUAL_OF, )}};
  static const struct {
    unsigned id;
    double value[CORE_PROPERTIES_END]; /* 0: the usual value */
  } named[] = {CORE_EACH_TISSUE(VALUES_OF, )};
  for (size_t i = 0; i < sizeof named / sizeof named[0]; i++) {
    for (size_t k = 0; named[i].id == id && k < CORE_PROPERTIES_END; k++) {
      tissue.value[k] = named[i].value[k] > 0 ? named[i].value[k] : tissue.value[k];
    }
  }
  return tissue;
}

core_fault core_tissue_check(const core_tissue *tissue) {
  static const struct {
    unsigned id;
    double least, most;
    const char *name, *allowed, *needed;
  } ranges[] = {
#define RANGE_OF(P, id, IDENT, name, about, least, most, usual)                                    \
  {id, least, most, name, #least " to " #most, #least " to " #most ": it has to be given"},
      CORE_EACH_PROPERTY(RANGE_OF, )};
  for (size_t i = 0; i < sizeof ranges / sizeof ranges[0]; i++) {
    const double value = tissue->value[ranges[i].id];
    /* NaN is outside of every range */
    if (!(value >= ranges[i].least && value <= ranges[i].most)) {
      return (core_fault){ranges[i].name, isnan(value) ? ranges[i].needed : ranges[i].allowed, 0};
    }
  }
  if (tissue->value[CORE_PROPERTY_VESSEL_RADIUS] > 0 && tissue->value[CORE_PROPERTY_BLOOD] > 0) {
    return (core_fault){"vessel_radius_mm",
                        "0 with blood_fraction: that spectrum was measured with red cells", 0};
  }
  return (core_fault){0};
}

double core_packaging_of(double x) {
  /* below 1e-3, the next term of the series is below epsilon / 10 */
  return x < 1e-3 ? 1 - x / 2 * (1 - x / 3 * (1 - x / 4 * (1 - x / 5))) : (1 - fn_exp(-x)) / x;
}

double core_tissue_packaging(const core_tissue *tissue, double hbo2_per_mm, double hb_per_mm) {
  const double hbo2 = tissue->value[CORE_PROPERTY_HBO2], hb = tissue->value[CORE_PROPERTY_HB];
  if (hbo2 + hb == 0) {
    return 1;
  }
  const double whole = CORE_BLOOD_UM * (hbo2 * hbo2_per_mm + hb * hb_per_mm) / (hbo2 + hb);
  return core_packaging_of(2 * tissue->value[CORE_PROPERTY_VESSEL_RADIUS] * whole);
}

static double power_of(double ratio, double exponent) {
  return fn_exp(exponent * fn_log(ratio));
}

core_fault core_tissue_medium(const core_tissue *tissue, double wavelength_nm,
                              core_medium *medium) {
  const double *value = tissue->value;
  double per_mm[CORE_CHROMOPHORES_MAX + 1] = {0};
  core_fault fault = core_tissue_check(tissue);
  for (const core_choice *one = core_properties; fault.field == NULL && one->name != NULL; one++) {
    if (one->id <= CORE_CHROMOPHORES_MAX && value[one->id] > 0) {
      fault = core_chromophore_at((enum core_property)one->id, tissue->haemoglobin, wavelength_nm,
                                  &per_mm[one->id]);
    }
  }
  if (fault.field != NULL) {
    return fault;
  }
  if (value[CORE_PROPERTY_A] > 0 &&
      !(wavelength_nm >= CORE_SCATTERING_FROM_NM && wavelength_nm <= CORE_SCATTERING_TO_NM)) {
    return (core_fault){"wavelength",
                        CORE_TEXT(CORE_SCATTERING_FROM_NM) " to " CORE_TEXT(
                            CORE_SCATTERING_TO_NM) " nm: the scattering law is not known beyond",
                        0};
  }
  const double packaging =
      core_tissue_packaging(tissue, per_mm[CORE_PROPERTY_HBO2], per_mm[CORE_PROPERTY_HB]);
  per_mm[CORE_PROPERTY_HBO2] *= packaging;
  per_mm[CORE_PROPERTY_HB] *= packaging;
  double sigma_a_per_mm = 0, reduced_per_mm = 0;
  for (size_t id = 1; id <= CORE_CHROMOPHORES_MAX; id++) {
    sigma_a_per_mm += value[id] * per_mm[id];
  }
  if (value[CORE_PROPERTY_A] > 0) {
    const double rayleigh = value[CORE_PROPERTY_RAYLEIGH], ratio = wavelength_nm / 500;
    reduced_per_mm =
        value[CORE_PROPERTY_A] * (rayleigh * power_of(ratio, -4) +
                                  (1 - rayleigh) * power_of(ratio, -value[CORE_PROPERTY_B]));
  }
  const core_medium found = {sigma_a_per_mm, reduced_per_mm / (1 - value[CORE_PROPERTY_G]),
                             value[CORE_PROPERTY_G], value[CORE_PROPERTY_ETA],
                             value[CORE_PROPERTY_THICKNESS]};
  fault = core_medium_check(&found);
  if (fault.field == NULL) {
    *medium = found;
  }
  return fault;
}
