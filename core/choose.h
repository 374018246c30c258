/* choose: finds how to evaluate transport to a tolerance, and what other models cost.
 *
 * A request that gives a tolerance in place of a model gets `transport`, in the evaluator that its
 * number of radii makes cheapest: looked up in the table of solutions, or solved where that does not
 * cover a medium or is not exact enough. core/costs.def has the costs, which `make tradeoff` measured. A
 * choice depends on the request alone: the same request gives the same choice on every machine,
 * whatever is cached.
 *
 * The functions are pure: they allocate nothing and keep no state.
 */
#ifndef DIPOLED_CORE_CHOOSE_H
#define DIPOLED_CORE_CHOOSE_H

#include "core/core.h"
#include "core/costs.def"

/* A request for a model and an evaluator. */
typedef struct core_choose_request {
  const core_medium *media; /* one for each channel; they all get the same model */
  size_t media_count;       /* at least 1 */
  uint32_t layer_count;     /* of each medium: media[media_count * layer_count] */
  double eta_below;         /* as the parameter; NAN: not given */
  unsigned wanted;          /* bits of enum core_quantity */
  core_radii_range radii;   /* read only if an elementwise quantity is wanted */
  uint64_t radius_count;    /* number of radii, the same for each medium */
  bool single; /* true: values of single precision are requested; false: double precision */
  /* The largest accepted error of any value against radiative transport with Henyey-Greenstein
   * scattering and a Fresnel boundary. It is relative, but absolute for ln R. */
  double tolerance;
} core_choose_request;

/* A model with an evaluator, for a request. The errors are upper bounds, and INFINITY where nothing
 * can be promised. The error of what is solved is the tolerance itself, or an estimate if that is
 * less than any solution states: only the prepared profile states what the solver has reached. */
typedef struct core_candidate {
  enum core_model model;
  enum core_evaluator evaluator;
  double numerical_tolerance; /* the parameter `tolerance` to prepare with; NAN: the default */
  double left; /* of what is solved: the numerical error that its profile may state; else NAN */
  double model_error;
  double numerical_error;
  double error;      /* model_error and numerical_error together */
  double cost_ns;    /* time for one radius, as measured on one machine */
  double prepare_ns; /* time to prepare one medium, as measured there */
  double total_ns;   /* time for one medium: preparing it and evaluating all wanted quantities */
  bool looked_up;    /* false: the solver makes it, as the table of solutions does not serve */
  bool meets;        /* the error is at most the tolerance */
} core_candidate;

enum {
  CORE_TRANSPORT_CANDIDATES = 2,
#define CORE_TWO(...) +2
  CORE_CANDIDATES_MAX = 0 CORE_EACH_COST(CORE_TWO)
};

/* Lists `transport` with every evaluator of the precision that is requested and returns their
 * number, or 0 if there are no media. The first one is the choice: the one with the least total_ns
 * of those that meet the tolerance. The caller takes the next candidate if it cannot prepare one.
 * If none meets the tolerance, the candidate with the least error comes first. The errors of
 * candidates that do not meet the tolerance are the least that they can have: each meets any
 * tolerance from there on. The numerical error grows beyond the reach (core_reach). */
size_t core_choose(const core_choose_request *request,
                   core_candidate candidates[CORE_TRANSPORT_CANDIDATES]);

/* Returns the error that the table of solutions keeps for all media of a request at its radii, in
 * double precision or by f32: an upper bound of what profiles state that are prepared without the
 * parameter `tolerance`. It is INFINITY if the table lacks a medium. The tolerance is not read. */
double core_choose_stored_error(const core_choose_request *request);

/* The models whose costs are known, ascending; an id of 0 ends the list. */
extern const unsigned core_costed_models[];

/* Sets *candidate to a model of the list with an evaluator and these errors; numerical_tolerance is
 * that of the default. */
void core_offer(core_candidate *candidate, const core_choose_request *request, unsigned model,
                enum core_evaluator evaluator, double model_error, double numerical_error);

#endif
