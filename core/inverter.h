/* inverter: from what artists have, a diffuse albedo and a length, to a medium, probe by probe:
 * who searches prepares the media that the inverter names, and tells it their albedos. So preparing
 * may be done elsewhere, in turns with other work, and given up.
 *
 * An albedo depends on the ratio sigma_a / sigma_s' alone and falls as it grows; the length then
 * scales the medium. Same bits everywhere, as long as the albedos are.
 */
#ifndef DIPOLED_CORE_INVERTER_H
#define DIPOLED_CORE_INVERTER_H

#include "core/core.h"

/* The ratios at the ends of a search: where it has come to, and the albedo there. */
typedef struct core_inversion_point {
  double ratio;    /* sigma_a / sigma_s' */
  double albedo;   /* less what is wanted */
  double distance; /* from what is wanted, as nearly linear in ln(ratio); NaN: not known */
} core_inversion_point;

/* What a probe is for: the reach, the search, what was found. */
enum core_inverter_phase {
  CORE_INVERTER_MOST,
  CORE_INVERTER_LEAST,
  CORE_INVERTER_SEARCH,
  CORE_INVERTER_LAST,
};

/* Read medium, found, albedo, albedo_least and albedo_most; the rest is the inverter's own. */
typedef struct core_inverter {
  core_medium medium;  /* to be probed next; in the end, what was found */
  bool found;          /* there is a medium with what was wanted */
  double albedo;       /* that it has */
  double albedo_least; /* what can be reached; known when the first search may begin */
  double albedo_most;

  unsigned model;
  unsigned moments;
  double g;
  double eta;
  double sigma_t_prime_per_mm; /* of what is probed */
  double ratio_least;          /* 0, but for models that need absorption */
  enum core_inverter_phase phase;
  double wanted;
  enum core_length length;
  double length_mm;
  double low; /* albedo(low) >= wanted > albedo(high): ratios */
  double high;
  core_inversion_point now; /* the ratio that is probed */
  core_inversion_point before;
  core_inversion_point best;
  unsigned steps;
} core_inverter;

/* Begins with the reach of a model: its albedos with no scattering and with no absorption.
 * sigma_t_prime_per_mm: at which to probe, within what a medium may have. Faults as of
 * core_profile_check(), with no parameters; and `model` of a fit, whose albedo is of its range. */
core_fault core_inverter_start(core_inverter *inverter, unsigned model, unsigned moments, double g,
                               double eta, double sigma_t_prime_per_mm);

/* The albedo of inverter->medium, prepared with the evaluator f64 and no parameters. True: what was
 * begun has come to its end, and there is nothing more to be probed; false: another medium is. */
bool core_inverter_take(core_inverter *inverter, double albedo);

/* When the reach is known: what is wrong with the model, whose albedo does not depend on the
 * medium; or nothing. */
core_fault core_inverter_check(const core_inverter *inverter);

/* Begins to search for a medium; any number of times, one after the other. albedo: 0 to 1;
 * length_mm: from CORE_MEAN_FREE_PATH_MIN_MM to ..._MAX_MM; both asserted. True: there is none
 * (found is false): the albedo is out of reach. Otherwise probe, and in the end: found, and the
 * medium's albedo is within 1e-12 of the wanted one, relative, where the model's albedo has so many
 * digits; or not, as a medium of that length could not have such coefficients. */
bool core_inverter_seek(core_inverter *inverter, double albedo, enum core_length length,
                        double length_mm);

/* What is wrong with a wanted albedo or length, whatever the model. Fields: `albedo`, `length`. */
core_fault core_inversion_check(double albedo, double length_mm);

#endif
