/* choice: picks the evaluator of transport for eval requests that name a tolerance in place of a
 * model.
 */
#ifndef DIPOLED_CHOICE_H
#define DIPOLED_CHOICE_H

#include "core/choose.h"
#include "proto/eval.h"

/* The state of choosing a model for one request. */
struct choice_state {
  double tolerance; /* of the request; NAN if the request names a model */
  size_t tried;     /* how many candidates have been chosen so far */
  double
      left; /* the numerical error that a profile may state if it is solved for the tolerance, else NAN */
};

/* Checks the tolerance and the media of a request of model EVAL_ANY_MODEL. */
wire_error choice_check(const eval_request *request);

/* Returns the arguments of core/choose.h for a request of model EVAL_ANY_MODEL, after
 * choice_check() and the check of its radii, which lie in the range `radii` unless they are
 * infinite. */
core_choose_request choice_asked(const eval_request *request, core_radii_range radii);

/* Writes the best candidate into the request, as if the client had requested it. Returns an error
 * if none keeps the tolerance; it says which tolerance the best one keeps. */
wire_error choice_first(struct choice_state *state, eval_request *request, core_radii_range radii);

/* Returns the refusal of a tolerance that the solver has not reached for a channel, or no error. */
wire_error choice_check_solved(const struct choice_state *state, const eval_request *request,
                               core_radii_range radii, const core_profile *profile,
                               uint32_t channel);

/* Writes the next candidate that keeps the tolerance into the request, after the preparation of a
 * candidate has failed with this fault. Returns false if there is none, if the request names a
 * model, or if memory was lacking: the same request must get the same model whenever it is sent. */
bool choice_again(struct choice_state *state, core_fault fault, eval_request *request,
                  core_radii_range radii);

#endif
