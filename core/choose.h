/* choose: the cheapest model and evaluator that are near enough to radiative transport.
 *
 * core/model_error.h knows what models are off by; what evaluators cost was measured by
 * `make tradeoff` and is in core/costs.def. A choice depends on the request alone, not on the machine, on what is cached
 * or on how many radii are asked for: the same request gives the same values everywhere.
 *
 * Pure functions: nothing is allocated or kept.
 */
#ifndef DIPOLED_CORE_CHOOSE_H
#define DIPOLED_CORE_CHOOSE_H

#include "core/core.h"

/* What is asked for. */
typedef struct core_choose_request {
  const core_medium *media; /* of the channels; one model is chosen for all of them */
  size_t media_count;       /* at least 1 */
  unsigned moments;       /* of the list; only the exact ones were measured, transport needs none */
  unsigned wanted;        /* bits of enum core_quantity */
  core_radii_range radii; /* of the elementwise quantities; without one of them it is not read */
  bool single;            /* values of single precision are asked for, else of double precision */
  /* How far any value may be off from radiative transport, relative; of ln R: absolute. Scattering
   * is Henyey and Greenstein's, the boundary Fresnel's. */
  double tolerance;
} core_choose_request;

/* A model with an evaluator, for a request. Errors are relative and bounds: no measured one was
 * larger around the media and radii of the request. INFINITY: nothing can be promised. */
typedef struct core_candidate {
  enum core_model model;
  enum core_evaluator evaluator;
  double numerical_tolerance; /* the parameter to prepare with; NAN: none, the default will do */
  double model_error;
  double numerical_error;
  double error;      /* both together */
  double cost_ns;    /* for a radius, as measured on one machine */
  double prepare_ns; /* likewise, for one medium */
  bool meets;        /* the error is at most the tolerance */
} core_candidate;

/* Costs within this factor are alike: they were measured, and vary by as much. */
#define CORE_CHOOSE_COST_ALIKE 1.1

enum {
  CORE_CANDIDATES_MAX = 0
#define CORE_COST(model, evaluator, ns, prepare_ns, numerical, numerical_least, least) +1
#include "core/costs.def"
};

/* Lists every candidate of the precision that is asked for, and returns how many they are; 0 when
 * there are no media. The first is the choice: of those that meet the tolerance the cheapest (of
 * costs that are alike the one with the least error, then the first of the list); the next ones are
 * what is to be taken where preparing it fails. If none meets the tolerance, the one with the least
 * error comes first.
 *
 * What can be promised: transport itself everywhere within its domain where g is 0. Other models,
 * and media with another g, where core/model_error.h knows their error; nothing of theirs is promised
 * of the cdf and dR/dr. Transport's numerical error grows beyond its reach (core_reach). */
size_t core_choose(const core_choose_request *request,
                   core_candidate candidates[CORE_CANDIDATES_MAX]);

#endif
