/* inversion: core/inverter.h at once: finds the medium with an albedo and a mean free path 1 / sigma_t'. */
#ifndef DIPOLED_TESTS_INVERSION_H
#define DIPOLED_TESTS_INVERSION_H

#include "core/inverter.h"

/* The medium whose albedo under a model is the wanted one. Its g is 0, so that sigma_s is sigma_s'. */
typedef struct inversion {
  core_fault fault; /* field `albedo` if the wanted albedo is not between the two below */
  core_medium medium;
  double albedo_least; /* range that this model, moments and eta can reach */
  double albedo_most;
} inversion;

/* Probes until the reach or the search has ended. */
static inline void inversion_run(core_inverter *inverter) {
  const core_isa *isa = core_isa_select("portable");
  double albedo, error;
  do {
    core_albedo(isa, inverter->model, inverter->moments, inverter->light, &inverter->medium,
                &albedo, &error);
  } while (!core_inverter_take(inverter, albedo, error));
}

static inline inversion invert_albedo(unsigned model, unsigned moments, double albedo,
                                      double mean_free_path_mm, double eta) {
  if (core_inversion_check(0, mean_free_path_mm).field != NULL) {
    return (inversion){.fault = core_inversion_check(0, mean_free_path_mm)};
  }
  core_inverter inverter;
  inversion found = {.fault = core_inverter_start(&inverter, model, moments, CORE_LIGHT_BEAM, false,
                                                  0, eta, 1 / mean_free_path_mm)};
  if (found.fault.field != NULL) {
    return found;
  }
  inversion_run(&inverter);
  found.albedo_least = inverter.albedo_least;
  found.albedo_most = inverter.albedo_most;
  if (core_inversion_check(albedo, mean_free_path_mm).field == NULL &&
      !core_inverter_seek(&inverter, albedo, CORE_LENGTH_FREE_PATH, mean_free_path_mm)) {
    inversion_run(&inverter);
  }
  if (!inverter.found) {
    found.fault = (core_fault){"albedo", "from albedo_least to albedo_most", 0};
    return found;
  }
  found.medium = inverter.medium;
  return found;
}

#endif
