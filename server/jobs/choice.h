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
  /* the numerical error that a profile may state if it is solved for the tolerance, else NAN */
  double left;
  bool finest;    /* whether the channel is solved as exactly as the solver can */
  double least;   /* the least tolerance of the channels that miss it; 0 while none does */
  uint32_t worst; /* the channel with this tolerance */
  double at_mm;   /* the radius that has it: the least or the largest one */
};

/* Checks the tolerance and the media of a request of model EVAL_ANY_MODEL. */
wire_error choice_check(const eval_request *request);

/* Returns the arguments of core/choose.h for a request of model EVAL_ANY_MODEL, after
 * choice_check() and the check of its radii, which lie in the range `radii` unless they are
 * infinite. */
core_choose_request choice_request(const eval_request *request, core_radii_range radii);

/* Writes the best candidate into the request, as if the client had requested it. Returns an error
 * if none keeps the tolerance; it says which tolerance the best one keeps. */
wire_error choice_first(struct choice_state *state, eval_request *request, core_radii_range radii);

/* Whether the parameters to prepare a channel with depend on the radii: with a tolerance in place of a
 * model, and with one of transport, which is solved only where its table misses the tolerance there. */
bool choice_heeds_radii(const struct choice_state *state, const eval_request *request);

/* Returns the parameters to prepare a channel with this medium with, if choice_heeds_radii(). */
core_parameters choice_parameters(const struct choice_state *state, const eval_request *request,
                                  const core_medium *medium, core_radii_range radii);

/* Checks the channel's profile, which was prepared for a tolerance in place of a model. Returns false
 * if it misses that: the channel has to be prepared again, as choice_parameters() says from then on.
 * If that misses it, too, choice_refusal() will say so. */
bool choice_keeps(struct choice_state *state, const eval_request *request, core_radii_range radii,
                  const core_profile *profile, const core_medium *medium, uint32_t channel);

/* Returns the refusal of a tolerance that a channel misses, or no error. All channels have been
 * checked: the tolerance that it names is kept. */
wire_error choice_refusal(const struct choice_state *state, const eval_request *request);

/* Writes the next candidate that keeps the tolerance into the request, after the preparation of a
 * candidate has failed with this fault. Returns false if there is none, if the request names a
 * model, or if memory was lacking: the same request must get the same model whenever it is sent. */
bool choice_again(struct choice_state *state, core_fault fault, eval_request *request,
                  core_radii_range radii);

#endif
