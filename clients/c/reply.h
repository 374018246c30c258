/* reply: checks the replies to eval and sample requests. The arrays of a frame stay where
 * they are, or are copied into a reply of several parts or into the caller's memory, or passed to
 * a reader. */
#ifndef LIBDIPOLE_REPLY_H
#define LIBDIPOLE_REPLY_H

#include "clients/c/request.h"

extern const libdipole_kind libdipole_eval_kind;
extern const libdipole_kind libdipole_sample_kind;

/* Sets the counts, evaluator and sizes that the reply to a request of pending->type may have. If
 * no memory could hold the reply, only a refusal is accepted, which states the daemon's limit. */
void libdipole_reply_expect(libdipole_pending *pending, unsigned model, unsigned evaluator,
                            unsigned wanted, uint32_t medium_count, uint64_t radius_count);

/* Makes a result of pending->frame, which it owns from now on. If that is an error frame, fails
 * with the daemon's error. The caller frees *result with dipole_result_free(). */
bool libdipole_result_take(dipole_client *client, libdipole_pending *pending,
                           dipole_result **result, dipole_error *error);

#endif
