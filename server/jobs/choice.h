/* choice: picks a model and an evaluator for eval requests that name a tolerance in place of a
 * model.
 */
#ifndef DIPOLED_CHOICE_H
#define DIPOLED_CHOICE_H

#include "core/choose.h"
#include "proto/eval.h"

/* What could answer such a request, best first, as core_choose() lists it. */
struct choice {
  core_candidate candidates[CORE_CANDIDATES_MAX];
  size_t count;
};

/* How far the choosing for one request has come. */
struct choice_state {
  double tolerance;   /* of the request; NAN if it names a model */
  double model_error; /* of the model that was chosen */
  size_t tried;       /* how many candidates have been chosen so far */
};

/* Returns the least and the largest radius of an eval request that has been checked: of its list,
 * or the ends of its grid, in the precision in which they are evaluated. */
core_radii_range choice_radii(const eval_request *request);

/* Checks the tolerance and the media of a request of model EVAL_ANY_MODEL. */
wire_error choice_check(const eval_request *request);

/* Lists the candidates for such a request. Its radii have been checked, too. */
void choice_list(const eval_request *request, struct choice *choice);

/* Writes the best candidate into the request, as if the client had asked for it. The error says
 * that none keeps the tolerance, and which tolerance the best one keeps. */
wire_error choice_first(struct choice_state *state, eval_request *request);

/* Writes the next candidate that keeps the tolerance into the request, when the one before could
 * not be prepared. Returns false if there is none or the request names a model. Lack of memory is
 * no reason to choose again, because the same request has to get the same model. */
bool choice_again(struct choice_state *state, core_fault fault, eval_request *request);

/* Sorts the candidates by cost. Returns the position of the one that an eval would get, or count if
 * there is none. */
size_t choice_sort_by_cost(struct choice *choice);

#endif
