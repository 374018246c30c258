/* answer: the answers to eval and sample requests. Each frame is checked. Its arrays are then used
 * where they lie, copied to their place in an answer of several parts, handed to a reader, or
 * received straight into the caller's memory. */
#ifndef LIBDIPOLE_ANSWER_H
#define LIBDIPOLE_ANSWER_H

#include "clients/c/request.h"

extern const libdipole_kind libdipole_eval_kind;
extern const libdipole_kind libdipole_eval_into_kind; /* into the caller's memory */

/* Sets what the answer to pending->type may look like: its counts, evaluator and sizes. An answer
 * that no memory could hold may not come at all: the daemon's refusal says what the limit is. */
void libdipole_answer_expect(libdipole_pending *pending, unsigned model, unsigned evaluator,
                             unsigned wanted, uint32_t medium_count, uint64_t radius_count);

/* Makes a result of an answer, or fails with what its error frame says. Takes pending->frame over.
 * The caller frees *result with dipole_result_free(). */
bool libdipole_result_take(dipole_client *client, libdipole_pending *pending,
                           dipole_result **result, dipole_error *error);

#endif
