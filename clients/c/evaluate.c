/* Evaluating: one query and its answer, many under way at once, and answers in parts. */
#include <stdlib.h>

#include "clients/c/client.h"

static bool submit(dipole_client *client, const dipole_query *query, libdipole_reader *reader,
                   uint64_t *id, dipole_error *error) {
  eval_layout layout;
  libdipole_pending pending = {.type = WIRE_TYPE_EVAL,
                               .model = (uint16_t)query->model,
                               .evaluator = (uint16_t)query->evaluator,
                               .wanted = (uint16_t)query->wanted,
                               .reader = reader,
                               .into_values = reader == NULL ? query->into_values : NULL,
                               .into_radii = reader == NULL ? query->into_radii : NULL};
  if (reader == NULL && !libdipole_into_check(query, error)) {
    return false;
  }
  /* What is so large that nothing could hold it is asked for all the same: the daemon's refusal
   * says what the limit is. */
  if (core_evaluator_bytes(query->evaluator) > 0 &&
      eval_reply_layout(query->evaluator, query->wanted, query->medium_count, query->radius_count,
                        UINT64_MAX, &layout)) {
    pending.reply_bytes_min = layout.radius_offset; /* of a part: with its channels */
    pending.reply_bytes_max = layout.payload_bytes;
  } else {
    pending.reply_bytes_min = UINT64_MAX;
  }
  if (!libdipole_query_send(client, query, &pending, error)) {
    return false;
  }
  *id = pending.id;
  return true;
}

/* ---- one at a time ------------------------------------------------------------------------- */

/* Waits for this answer; what came of it in *result. */
static bool collect(dipole_client *client, uint64_t id, dipole_result **result,
                    dipole_error *error) {
  libdipole_pending pending;
  return libdipole_request_wait(client, id, &pending, error) &&
         libdipole_result_take(client, &pending, result, error);
}

bool dipole_eval(dipole_client *client, const dipole_query *query, dipole_result **result,
                 dipole_error *error) {
  dipole_error unwanted;
  uint64_t id;
  error = error != NULL ? error : &unwanted;
  if (!submit(client, query, NULL, &id, error)) {
    return false;
  }
  const bool good = collect(client, id, result, error);
  if (!good) {
    libdipole_pending_drop(client, id); /* when it has not come in time */
  }
  return good;
}

bool dipole_eval_parts(dipole_client *client, const dipole_query *query,
                       bool (*part)(void *context, const dipole_result *part,
                                    uint64_t radius_first),
                       void *context, dipole_error *error) {
  dipole_error unwanted;
  libdipole_pending pending;
  libdipole_reader reader = {.part = part, .context = context};
  uint64_t id;
  error = error != NULL ? error : &unwanted;
  if (!submit(client, query, &reader, &id, error) ||
      !libdipole_request_read(client, id, &reader, &pending, error)) {
    return false;
  }
  if (reader.stopped) {
    free(pending.frame);
    return libdipole_fail(error, DIPOLE_ERROR_STOPPED, "the rest of the answer was not wanted");
  }
  const bool good = libdipole_refusal_check(client, &pending, error);
  free(pending.frame);
  return good;
}

/* ---- many at once -------------------------------------------------------------------------- */

bool dipole_submit(dipole_client *client, const dipole_query *query, uint64_t *id,
                   dipole_error *error) {
  dipole_error unwanted;
  error = error != NULL ? error : &unwanted;
  if (client->in_flight_max != 0 && dipole_outstanding(client) >= client->in_flight_max) {
    return libdipole_fail(error, DIPOLE_ERROR_FULL,
                          "%u queries are outstanding, and no more may be: collect first",
                          client->in_flight_max);
  }
  return submit(client, query, NULL, id, error);
}

bool dipole_collect(dipole_client *client, uint64_t *id, dipole_result **result,
                    dipole_error *error) {
  dipole_error unwanted;
  libdipole_pending pending;
  error = error != NULL ? error : &unwanted;
  libdipole_call_begin(client, WIRE_TYPE_EVAL);
  if (!libdipole_request_wait(client, 0, &pending, error)) {
    return false;
  }
  *id = pending.id;
  return libdipole_result_take(client, &pending, result, error);
}

bool dipole_collect_id(dipole_client *client, uint64_t id, dipole_result **result,
                       dipole_error *error) {
  dipole_error unwanted;
  libdipole_call_begin(client, WIRE_TYPE_EVAL);
  error = error != NULL ? error : &unwanted;
  return id != 0 ? collect(client, id, result, error)
                 : libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "no query has the id 0");
}
