#include <math.h>
#include <string.h>

#include "core/core.h"

/* The comparisons are false for NaN, so NaN is outside of every range. */
static bool in_range(double value, double low, double high) {
  return value >= low && value <= high;
}

core_fault core_medium_check(const core_medium *medium) {
  const double sigma_t_prime = medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g);
  if (!in_range(medium->sigma_a_per_mm, 0, CORE_SIGMA_MAX_PER_MM)) {
    return (core_fault){"sigma_a", "0 to 1e15 per mm", 0};
  }
  if (!in_range(medium->sigma_s_per_mm, 0, CORE_SIGMA_MAX_PER_MM)) {
    return (core_fault){"sigma_s", "0 to 1e15 per mm", 0};
  }
  if (!(medium->g > -1 && medium->g < 1)) {
    return (core_fault){"g", "between -1 and 1, exclusive", 0};
  }
  if (!in_range(medium->eta, CORE_ETA_MIN, CORE_ETA_MAX)) {
    return (core_fault){"eta", "0.001 to 1000", 0};
  }
  if (!(medium->thickness_mm == 0 ||
        in_range(medium->thickness_mm, CORE_THICKNESS_MIN_MM, CORE_THICKNESS_MAX_MM))) {
    return (core_fault){"thickness", "0 (a half space), or 1e-15 to 1e30 mm", 0};
  }
  if (sigma_t_prime < CORE_SIGMA_T_PRIME_MIN_PER_MM) {
    return (core_fault){"sigma_s", "sigma_a + sigma_s (1 - g) of at least 1e-15 per mm", 0};
  }
  const double sigma_s_prime = medium->sigma_s_per_mm * (1 - medium->g);
  if (medium->sigma_s_per_mm > 0 && sigma_s_prime < CORE_SCATTERED_MIN * sigma_t_prime) {
    return (core_fault){"sigma_s", "0, or sigma_s (1 - g) of at least 1e-32 sigma_a", 0};
  }
  return (core_fault){0};
}

core_fault core_layers_check(const core_medium *medium, size_t layer_count) {
  core_fault fault = {0};
  for (size_t i = 0; i < layer_count && fault.field == NULL; i++) {
    fault = core_medium_check(&medium[i]);
    if (fault.field == NULL && i + 1 < layer_count && !(medium[i].thickness_mm > 0)) {
      fault = (core_fault){"thickness", "above 0: only the last layer may be a half space", 0};
    }
    fault.index = i;
  }
  return fault;
}

#define CHANNEL(sigma_s_prime, sigma_a)                                                            \
  { sigma_a, sigma_s_prime, 0, 1.3 }
#define MEDIUM(name, s_r, s_g, s_b, a_r, a_g, a_b)                                                 \
  {                                                                                                \
    name, 1, {                                                                                     \
      CHANNEL(s_r, a_r), CHANNEL(s_g, a_g), CHANNEL(s_b, a_b)                                      \
    }                                                                                              \
  }

/* Skin of two layers at 610, 550 and 460 nm: an epidermis of 0.06 mm over a dermis. The arguments are
 * sigma_a of both in 1/mm, after Jacques 2013 (Phys. Med. Biol. 58, R37), Table 3, rows 11, 13 and 14
 * (Tseng et al. 2011: skin types I-II, III-IV, V-VI): 0.87, 1.15 and 1.65 % of melanosomes (Eq. 8) in
 * the epidermis; haemoglobin of 7.9, 9.6 and 2.7 uM with 98.5, 99.2 and 99.3 % of oxygen (Prahl's
 * spectra) in the dermis; and in both bloodless skin, 0.0244 + 8.53 exp(-(lambda - 154) / 66.2)
 * (Jacques 1998). sigma_s' is 6.87 (lambda / 500)^-1.161 and 4.53 (lambda / 500)^-1.292 (Table 1), g
 * is 0.62 + 0.00029 lambda (van Gemert et al. 1989). */
#define LAYERS(a, s, g, dermis_a, dermis_s)                                                        \
  {a, s, g, 1.4, 0.06}, {                                                                          \
    dermis_a, dermis_s, g, 1.4                                                                     \
  }
#define SKIN(name, a_r, a_g, a_b, d_r, d_g, d_b)                                                   \
  {                                                                                                \
    name, 2, {                                                                                     \
      LAYERS(a_r, 26.85, 0.797, d_r, 17.25), LAYERS(a_g, 27.89, 0.7795, d_g, 18.16),               \
          LAYERS(a_b, 30.69, 0.753, d_b, 20.46)                                                    \
    }                                                                                              \
  }

/* Each line but those of SKIN() has sigma_s' and sigma_a in 1/mm for red, green and blue, from Jensen, Marschner,
 * Levoy, Hanrahan 2001, Figure 5. */
const core_measured_medium core_measured_media[] = {
    MEDIUM("apple", 2.29, 2.39, 1.97, 0.0030, 0.0034, 0.046),
    MEDIUM("chicken1", 0.15, 0.21, 0.38, 0.015, 0.077, 0.19),
    MEDIUM("chicken2", 0.19, 0.25, 0.32, 0.018, 0.088, 0.20),
    MEDIUM("cream", 7.38, 5.47, 3.15, 0.0002, 0.0028, 0.0163),
    MEDIUM("ketchup", 0.18, 0.07, 0.03, 0.061, 0.97, 1.45),
    MEDIUM("marble", 2.19, 2.62, 3.00, 0.0021, 0.0041, 0.0071),
    MEDIUM("potato", 0.68, 0.70, 0.55, 0.0024, 0.0090, 0.12),
    MEDIUM("skimmilk", 0.70, 1.22, 1.90, 0.0014, 0.0025, 0.0142),
    SKIN("skin-dark", 0.505, 0.689, 1.21, 0.0341, 0.0727, 0.136),
    SKIN("skin-light", 0.282, 0.385, 0.688, 0.0361, 0.124, 0.189),
    SKIN("skin-medium", 0.362, 0.494, 0.875, 0.0366, 0.141, 0.206),
    MEDIUM("skin1", 0.74, 0.88, 1.01, 0.032, 0.17, 0.48),
    MEDIUM("skin2", 1.09, 1.59, 1.79, 0.013, 0.070, 0.145),
    MEDIUM("spectralon", 11.6, 20.4, 14.9, 0, 0, 0),
    MEDIUM("wholemilk", 2.55, 3.21, 3.77, 0.0011, 0.0024, 0.014),
};

const size_t core_measured_media_count = sizeof core_measured_media / sizeof core_measured_media[0];

const core_measured_medium *core_measured_medium_by_name(const char *name) {
  for (size_t i = 0; i < core_measured_media_count; i++) {
    if (strcmp(core_measured_media[i].name, name) == 0) {
      return &core_measured_media[i];
    }
  }
  return NULL;
}
