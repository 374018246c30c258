/* choice: for eval requests that ask for a tolerance instead of a model. */
#ifndef DIPOLED_CHOICE_H
#define DIPOLED_CHOICE_H

#include "core/choose.h"
#include "proto/eval.h"

/* What may answer such a request, best first; see core_choose(). */
struct choice {
  core_candidate candidates[CORE_CANDIDATES_MAX];
  size_t count;
};

/* What is wrong with a request of model EVAL_ANY_MODEL before its radii are looked at: no tolerance,
 * one out of range, a medium. */
wire_error choice_check(const eval_request *request);

/* Lists the candidates for such a request, whose radii are right, too. */
void choice_list(const eval_request *request, struct choice *choice);

/* The error that says that none keeps the tolerance, and what the best one there is does. */
wire_error choice_none(const struct choice *choice);

/* Writes a candidate into the request, as if the client had asked for it. */
void choice_take(const core_candidate *candidate, eval_request *request);

/* Sorts the candidates by cost; returns where the one that an eval would take has come to: count,
 * when there is none. */
size_t choice_sort_by_cost(struct choice *choice);

#endif
