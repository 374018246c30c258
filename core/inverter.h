/* inverter: finds the medium that has a given diffuse albedo, in one of two lights, and a given
 * length, which is what artists know. The search goes probe by probe: the inverter names a medium, and the caller
 * prepares it and passes its albedo to core_inverter_take(). So the caller decides where and when
 * to prepare, and may stop at any probe.
 *
 * An albedo depends on the ratio sigma_a / sigma_s' alone and falls as the ratio grows; the length
 * then scales the medium. The same albedos give the same bits on every machine.
 */
#ifndef DIPOLED_CORE_INVERTER_H
#define DIPOLED_CORE_INVERTER_H

#include "core/varying.h"

/* A ratio that was probed, and its albedo. */
typedef struct core_inversion_point {
  double ratio;    /* sigma_a / sigma_s' */
  double albedo;   /* albedo at the ratio minus the wanted albedo */
  double distance; /* ln(a / (most - a)) minus the same of the wanted albedo; NaN if undefined */
} core_inversion_point;

/* The purpose of a probe. */
enum core_inverter_phase {
  CORE_INVERTER_MOST,   /* finds the largest albedo that the model can have */
  CORE_INVERTER_LEAST,  /* finds the least albedo */
  CORE_INVERTER_SEARCH, /* narrows the range of ratios */
  CORE_INVERTER_LAST,   /* gives the albedo of the medium that was found */
  CORE_INVERTER_DARKER, /* shows that a medium is as dark as that one may be by its error */
  CORE_INVERTER_BRIGHTER,
};

/* Callers read medium, found, albedo, the errors, albedo_least and albedo_most, and may set finds_errors.
 * The inverter keeps the other fields for itself. */
typedef struct core_inverter {
  /* whether searches find the errors of coefficients, which takes two more probes, seldom more */
  bool finds_errors;
  core_medium medium; /* the medium to probe next, or at the end of a search the one found */
  bool found;         /* true if a medium has the wanted albedo and length */
  double albedo;      /* albedo of the medium that was found */
  /* the most by which its coefficients differ from those that have the wanted albedo by the model's
   * exact formula; infinite where these have no limit */
  double sigma_a_error_per_mm;
  double sigma_s_error_per_mm;
  /* range of albedos that can be reached, apart from 0; known before the first search */
  double albedo_least;
  double albedo_most;

  unsigned model;
  unsigned moments;
  double g;
  double eta;
  enum core_light light;
  double specular; /* what albedos contain of the surface's own reflection */
  double sigma_t_prime_per_mm; /* sigma_t' of the medium that is probed */
  /* least ratio sigma_a / sigma_s': positive for models that need absorption, else 0 */
  double ratio_least;
  double ratio_most;
  enum core_inverter_phase phase;
  double wanted;
  enum core_length length;
  double length_mm;
  double low;               /* a ratio with albedo(low) >= wanted */
  double high;              /* a ratio with albedo(high) < wanted */
  core_inversion_point now; /* the ratio that is probed */
  core_inversion_point before;
  core_inversion_point best;
  unsigned steps;
  double ratio;       /* that of the medium found */
  core_medium answer; /* that medium, while others are probed for its errors */
  double off;         /* the most by which its albedo differs from the wanted one */
  double aim;         /* the wanted albedo less or plus that */
  double factor;      /* between the ratio that is probed and `ratio` */
} core_inverter;

/* Begins to find the reach of a model: its albedos, of a light, without absorption and without
 * scattering. specular: whether the albedos to seek contain core_specular(). The probes have this
 * sigma_t', which must be one that a medium with g = 0 may have; for g close to 1 it is smaller, so
 * that sigma_s is in range. Returns the faults of core_profile_check() without parameters and of
 * core_light_check(), and a fault of `model` for a fit, because its albedo depends on the range of
 * the fit. */
core_fault core_inverter_start(core_inverter *inverter, unsigned model, unsigned moments,
                               enum core_light light, bool specular, double g, double eta,
                               double sigma_t_prime_per_mm);

/* Returns the sum of an albedo per power that entered, such as albedo_most, and what the surface
 * reflects, if the albedos to seek contain that. */
double core_inverter_seen(const core_inverter *inverter, double albedo);

/* Takes the albedo of inverter->medium, prepared with the evaluator f64 and no parameters, and its
 * relative error. Returns true when the reach or the search has ended, and false when
 * inverter->medium is to be probed next. */
bool core_inverter_take(core_inverter *inverter, double albedo, double error);

/* Call this when the reach is known. Returns a fault if the model's albedo is the same for every
 * medium. */
core_fault core_inverter_check(const core_inverter *inverter);

/* Begins to search for a medium. One inverter serves any number of searches, one after the other.
 * Asserts that albedo is 0 to 1 and length_mm from CORE_MEAN_FREE_PATH_MIN_MM to ..._MAX_MM.
 * Returns true if the albedo is out of reach; found is then false. Otherwise the caller probes
 * until the search ends. At its end found is true and the medium's albedo has a relative error of
 * at most 1e-12, where the model's albedo has this many digits; or found is false, because a medium
 * of that length would have coefficients out of range. */
bool core_inverter_seek(core_inverter *inverter, double albedo, enum core_length length,
                        double length_mm);

/* Returns the fault of a wanted albedo or length that no model can have: field `albedo` or
 * `length`. */
core_fault core_inversion_check(double albedo, double length_mm);

#endif
