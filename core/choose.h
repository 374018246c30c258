/* choose: finds the cheapest model and evaluator that are near enough to radiative transport.
 *
 * core/model_error.h gives the errors of models; core/costs.def has the costs of evaluators, which
 * `make tradeoff` measured. A choice depends on the request alone: the same request gives the same
 * choice on every machine, whatever is cached. The number of radii is part of the request: few
 * radii are not worth a long preparation.
 *
 * The functions are pure: they allocate nothing and keep no state.
 */
#ifndef DIPOLED_CORE_CHOOSE_H
#define DIPOLED_CORE_CHOOSE_H

#include "core/core.h"

/* A request for a model and an evaluator. */
typedef struct core_choose_request {
  const core_medium *media; /* one for each channel; they all get the same model */
  size_t media_count;       /* at least 1 */
  unsigned moments;       /* enum core_moments; only EXACT was measured, and transport reads none */
  unsigned wanted;        /* bits of enum core_quantity */
  core_radii_range radii; /* read only if an elementwise quantity is wanted */
  uint64_t radius_count;  /* number of radii, the same for each medium */
  bool single; /* true: values of single precision are asked for; false: double precision */
  /* The largest accepted error of any value against radiative transport with Henyey-Greenstein
   * scattering and a Fresnel boundary. It is relative, but absolute for ln R. */
  double tolerance;
  double gamma; /* the parameter gamma of all media, which only `transport` takes; 0: not given */
} core_choose_request;

/* A model with an evaluator, for a request. The errors are relative upper bounds: no error that was
 * measured around the media and radii of the request is larger. An error is INFINITY where nothing
 * can be promised. */
typedef struct core_candidate {
  enum core_model model;
  enum core_evaluator evaluator;
  double numerical_tolerance; /* the parameter `tolerance` to prepare with; NAN: the default */
  double model_error;
  double numerical_error;
  double error;      /* model_error and numerical_error together */
  double cost_ns;    /* time for one radius, as measured on one machine */
  double prepare_ns; /* time to prepare one medium, as measured there */
  double total_ns;   /* time for one medium: preparing it and evaluating all wanted quantities */
  bool meets;        /* the error is at most the tolerance */
} core_candidate;

/* Costs within this factor count as equal, because measured costs vary by as much. */
#define CORE_CHOOSE_COST_ALIKE 1.1

/* The tolerances that a request is prepared with if the one that it asks for allows it; NAN: the
 * default. Tolerances between them are not used, so that requests share prepared profiles. Larger
 * ones save hardly any time: a table of the better dipole takes 6.6 ms with 1e-4, 2.7 ms with 1e-3
 * and 2.6 ms with 1e-2. */
#define CORE_CHOOSE_TOLERANCES                                                                     \
  { (double)NAN, 1e-4, 1e-3 }

enum {
  CORE_CHOOSE_TOLERANCE_COUNT = 3,
  CORE_CANDIDATES_MAX = 0
#define CORE_COST(model, evaluator, numerical, numerical_least, least, ...) +1
#define CORE_COST_WITH_G(model, evaluator, prepare_ns)
#include "core/costs.def"
};

/* Lists every candidate of the precision that is asked for and returns their number, or 0 if there
 * are no media. The first one is the choice: the one with the least total_ns of those that meet the
 * tolerance. Among costs that count as equal the least error wins, then the earlier line of
 * core/costs.def. The caller takes the next candidate if it cannot prepare one. If none meets the
 * tolerance, the candidate with the least error comes first. The errors of candidates that do not
 * meet the tolerance are the least that they can have: each meets any tolerance from there on.
 *
 * The errors of `transport` are known everywhere in its domain for g = 0, and for other g where it
 * does not use the similarity relation. For other models they are known where core/model_error.h
 * has them, but those of the cdf and dR/dr are not. The numerical error of `transport` grows beyond
 * its reach (core_reach). */
size_t core_choose(const core_choose_request *request,
                   core_candidate candidates[CORE_CANDIDATES_MAX]);

#endif
