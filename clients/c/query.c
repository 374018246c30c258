/* Sends the queries eval, sample and offers, and reads their replies. */
#include "clients/c/query.h"

#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/reply.h"
#include "core/core.h"
#include "core/draw.h"
#include "proto/eval.h"

/* ---- parts of requests --------------------------------------------------------------------- */

bool libdipole_query_check(unsigned model, unsigned others, const dipole_parameter *parameters,
                           size_t count, dipole_error *error) {
  if (model == 0) {
    return libdipole_fail_argument(error,
                                   "model is 0, which is what dipole_id() returns for a name "
                                   "that the daemon does not have");
  }
  if ((model | others) > UINT16_MAX) {
    return libdipole_fail_argument(error, "model, moments and other ids are at most 65535");
  }
  if (parameters == NULL && count > 0) {
    return libdipole_fail_argument(error, "parameters is NULL although parameter_count is not 0");
  }
  if (count > UINT16_MAX) {
    return libdipole_fail_argument(error, "parameter_count is at most 65535");
  }
  for (size_t i = 0; i < count; i++) {
    if (parameters[i].id == 0) {
      return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                            "the id of parameters[%zu] is 0, which is what dipole_id() returns for "
                            "a name that the daemon does not have",
                            i);
    }
    if (parameters[i].id > UINT16_MAX) {
      return libdipole_fail_argument(error, "the id of a parameter is at most 65535");
    }
  }
  return true;
}

/* Checks the media of a query, and the list of numbers, if any, whose type the evaluator says. */
static bool check_lists(const dipole_medium *media, uint32_t medium_count, unsigned evaluator,
                        const void *list, uint64_t count, dipole_error *error) {
  if (media == NULL && medium_count > 0) {
    return libdipole_fail_argument(error, "media is NULL although medium_count is not 0");
  }
  if (core_evaluator_bytes(evaluator) == 0) {
    return libdipole_fail(
        error, DIPOLE_ERROR_ARGUMENT,
        "evaluator is %u: this library knows DIPOLE_F64, DIPOLE_F32 and DIPOLE_LUT", evaluator);
  }
  return list != NULL || count == 0 ||
         libdipole_fail_argument(error, "radii or numbers is NULL although their count is not 0");
}

/* ---- payloads ------------------------------------------------------------------------------ */

_Static_assert(sizeof(dipole_medium) == WIRE_BYTES_medium, "media are written as they are");

static void put_parameters(uint8_t *at, const dipole_parameter *parameters, uint64_t count) {
  for (uint64_t i = 0; i < count; i++) {
    const wire_parameter parameter = {.parameter = (uint16_t)parameters[i].id,
                                      .value = parameters[i].value};
    wire_put_parameter(at + i * WIRE_BYTES_parameter, &parameter);
  }
}

void libdipole_payload_put(uint8_t *at, const schema_payload *payload, const schema_layout *layout,
                           const void *start, const void *const parts[]) {
  memcpy(at, start, payload->fixed_bytes);
  for (unsigned i = 0; payload->parts[i].name != NULL; i++) {
    if (payload->parts[i].structure == &schema_structures[SCHEMA_STRUCTURE_parameter]) {
      put_parameters(at + layout->parts[i].at, parts[i], layout->parts[i].count);
    } else {
      schema_put_part(at, layout, i, parts[i]);
    }
  }
}

bool libdipole_request_put(dipole_client *client, libdipole_pending *pending,
                           const schema_payload *payload, const void *start,
                           const void *const parts[], dipole_error *error) {
  schema_layout layout = {.payload_bytes = UINT64_MAX};
  uint8_t *at;
  schema_lay_out(payload, start, UINT64_MAX, &layout, NULL);
  if (!libdipole_request_begin(client, pending, layout.payload_bytes, &at, error)) {
    return false;
  }
  libdipole_payload_put(at, payload, &layout, start, parts);
  return libdipole_request_send(client, error);
}

libdipole_frame *libdipole_ask(dipole_client *client, libdipole_pending *pending,
                               const schema_payload *payload, const void *start,
                               const void *const parts[], const libdipole_shape *reply,
                               dipole_error *error) {
  pending->reply_bytes_max = schema_bytes(reply->payload, reply->most);
  pending->reply_bytes_min =
      reply->may_be_less ? reply->payload->fixed_bytes : pending->reply_bytes_max;
  return libdipole_request_put(client, pending, payload, start, parts, error)
             ? libdipole_reply(client, pending, error)
             : NULL;
}

/* ---- eval ---------------------------------------------------------------------------------- */

void dipole_query_init(dipole_query *query) {
  *query = (dipole_query){.model = CORE_MODEL_TRANSPORT,
                          .evaluator = DIPOLE_LUT,
                          .moments = DIPOLE_EXACT,
                          .wanted = DIPOLE_R,
                          .spacing = DIPOLE_LIST};
}

/* Checks a query and sends it. Sets pending's number of layers and id. */
static bool send_query(dipole_client *client, const dipole_query *query, libdipole_pending *pending,
                       dipole_error *error) {
  const bool list = query->spacing == DIPOLE_LIST;
  if (!libdipole_query_check(query->model == DIPOLE_ANY_MODEL ? 1 : query->model,
                             query->evaluator | query->moments | query->spacing, query->parameters,
                             query->parameter_count, error) ||
      !check_lists(query->media, query->medium_count, query->evaluator, query->radii,
                   list ? query->radius_count : 0, error)) {
    return false;
  }
  pending->layer_count = libdipole_layers(query->layer_count);
  const bool any_model = query->model == DIPOLE_ANY_MODEL;
  const wire_eval_request fixed = {.model = (uint16_t)(any_model ? EVAL_ANY_MODEL : query->model),
                                   .evaluator = (uint16_t)query->evaluator,
                                   .moments = (uint16_t)query->moments,
                                   .wanted = query->wanted,
                                   .medium_count = query->medium_count,
                                   .layer_count = pending->layer_count,
                                   .spacing = (uint16_t)query->spacing,
                                   .parameter_count = (uint32_t)query->parameter_count,
                                   .radius_count = query->radius_count,
                                   .radius_start = list ? 0 : query->radius_start_mm,
                                   .radius_stop = list ? 0 : query->radius_stop_mm};
  const void *const parts[] = {query->media, query->parameters, query->radii};
  return libdipole_request_put(client, pending, &schema_eval_request, &fixed, parts, error);
}

/* Checks that a caller who has given memory for the reply has given it for all wanted arrays. */
static bool check_into(const dipole_query *query, dipole_error *error) {
  bool arrays = false;
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    arrays = arrays || eval_is_array(query->wanted, quantity->id);
  }
  const bool radii = (query->wanted & DIPOLE_RADIUS) != 0;
  return ((!arrays || query->into_values != NULL) && (!radii || query->into_radii != NULL)) ||
         libdipole_fail_argument(error, "into_values and into_radii are needed for all that is "
                                        "wanted, or for none of it");
}

/* Checks that a query that leaves the model to the daemon says how good it has to be. */
static bool check_choice(const dipole_query *query, dipole_error *error) {
  for (size_t i = 0; query->parameters != NULL && i < query->parameter_count; i++) {
    if (query->parameters[i].id == CORE_PARAMETER_TOLERANCE) {
      return true;
    }
  }
  return query->model != DIPOLE_ANY_MODEL ||
         libdipole_fail_argument(error, "DIPOLE_ANY_MODEL needs the parameter tolerance");
}

static bool submit(dipole_client *client, const dipole_query *query, libdipole_reader *reader,
                   uint64_t *id, dipole_error *error) {
  const bool into = reader == NULL && (query->into_values != NULL || query->into_radii != NULL);
  if ((into && !check_into(query, error)) || !check_choice(query, error)) {
    return false;
  }
  libdipole_pending pending = {.kind = &libdipole_eval_kind,
                               .type = WIRE_TYPE_EVAL,
                               .deadline_ms = query->deadline_ms,
                               .reader = reader,
                               .into_values = into ? query->into_values : NULL,
                               .into_radii = into ? query->into_radii : NULL};
  libdipole_reply_expect(&pending, query->model, query->evaluator, query->wanted,
                         query->medium_count, query->radius_count);
  if (!send_query(client, query, &pending, error)) {
    return false;
  }
  *id = pending.id;
  return true;
}

/* Waits for the reply to request *id, or to any request if *id is 0. Sets *id. */
static bool collect(dipole_client *client, uint64_t *id, dipole_result **result,
                    dipole_error *error) {
  libdipole_pending pending;
  if (!libdipole_request_wait(client, *id, NULL, &pending, error)) {
    return false;
  }
  *id = pending.id;
  return libdipole_result_take(client, &pending, result, error);
}

/* Waits for the reply to a request, which is given up if none comes in time. */
static bool collect_or_drop(dipole_client *client, uint64_t id, dipole_result **result,
                            dipole_error *error) {
  const bool good = collect(client, &id, result, error);
  if (!good) {
    libdipole_request_drop(client, id);
  }
  return good;
}

bool dipole_eval(dipole_client *client, const dipole_query *query, dipole_result **result,
                 dipole_error *error) {
  uint64_t id;
  error = error != NULL ? error : &(dipole_error){0};
  return submit(client, query, NULL, &id, error) && collect_or_drop(client, id, result, error);
}

bool dipole_eval_parts(dipole_client *client, const dipole_query *query,
                       bool (*part)(void *context, const dipole_result *part,
                                    uint64_t radius_first),
                       void *context, dipole_error *error) {
  libdipole_pending pending;
  libdipole_reader reader = {.part = part, .context = context};
  uint64_t id;
  error = error != NULL ? error : &(dipole_error){0};
  if (!submit(client, query, &reader, &id, error)) {
    return false;
  }
  if (!libdipole_request_wait(client, id, &reader, &pending, error)) {
    libdipole_request_drop(client, id);
    return false;
  }
  const bool good = reader.stopped ? libdipole_fail(error, DIPOLE_ERROR_STOPPED,
                                                    "the rest of the reply was not wanted")
                                   : libdipole_refusal_check(client, &pending, error);
  free(pending.frame);
  return good;
}

bool dipole_submit(dipole_client *client, const dipole_query *query, uint64_t *id,
                   dipole_error *error) {
  error = error != NULL ? error : &(dipole_error){0};
  if (client->in_flight_max != 0 && dipole_outstanding(client) >= client->in_flight_max) {
    return libdipole_fail(error, DIPOLE_ERROR_FULL,
                          "%u queries are outstanding, and no more may be: collect first",
                          client->in_flight_max);
  }
  return submit(client, query, NULL, id, error);
}

bool dipole_collect(dipole_client *client, uint64_t *id, dipole_result **result,
                    dipole_error *error) {
  uint64_t found = 0;
  libdipole_call_begin(client, &libdipole_eval_kind);
  const bool good = collect(client, &found, result, error != NULL ? error : &(dipole_error){0});
  if (found != 0) {
    *id = found;
  }
  return good;
}

bool dipole_collect_id(dipole_client *client, uint64_t id, dipole_result **result,
                       dipole_error *error) {
  error = error != NULL ? error : &(dipole_error){0};
  libdipole_call_begin(client, &libdipole_eval_kind);
  return id != 0 ? collect(client, &id, result, error)
                 : libdipole_fail_argument(
                       error, "no query has the id 0: take the id that dipole_submit() gave");
}

/* ---- sample -------------------------------------------------------------------------------- */

static bool send_sample(dipole_client *client, const dipole_sample_query *query,
                        libdipole_pending *pending, dipole_error *error) {
  if (!libdipole_query_check(query->model, query->evaluator | query->moments | query->draw,
                             query->parameters, query->parameter_count, error) ||
      !check_lists(query->media, query->medium_count, query->evaluator, query->numbers,
                   query->draw == DIPOLE_DRAW_LIST ? query->sample_count : 0, error)) {
    return false;
  }
  libdipole_reply_expect(pending, query->model, query->evaluator, query->wanted,
                         query->medium_count, query->sample_count);
  pending->layer_count = libdipole_layers(query->layer_count);
  const wire_sample_request fixed = {.model = (uint16_t)query->model,
                                     .evaluator = (uint16_t)query->evaluator,
                                     .moments = (uint16_t)query->moments,
                                     .wanted = query->wanted,
                                     .medium_count = query->medium_count,
                                     .layer_count = pending->layer_count,
                                     .draw = (uint16_t)query->draw,
                                     .parameter_count = (uint32_t)query->parameter_count,
                                     .sample_count = query->sample_count,
                                     .sample_first = query->sample_first,
                                     .seed = query->seed};
  const void *const parts[] = {query->media, query->parameters, query->numbers};
  return libdipole_request_put(client, pending, &schema_sample_request, &fixed, parts, error);
}

bool dipole_sample(dipole_client *client, const dipole_sample_query *query, dipole_result **result,
                   dipole_error *error) {
  libdipole_pending pending = {
      .kind = &libdipole_sample_kind, .type = WIRE_TYPE_SAMPLE, .deadline_ms = query->deadline_ms};
  error = error != NULL ? error : &(dipole_error){0};
  return send_sample(client, query, &pending, error) &&
         collect_or_drop(client, pending.id, result, error);
}

bool dipole_sample_numbers(const dipole_sample_query *query, uint64_t begin, size_t n, void *u,
                           dipole_error *error) {
  error = error != NULL ? error : &(dipole_error){0};
  const core_draw draw = {query->draw, query->sample_count, query->sample_first, query->seed};
  if (core_choice_by_id(core_draws, query->draw) == NULL || query->draw == DIPOLE_DRAW_LIST) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "draw is %u: numbers are made for DIPOLE_DRAW_REGULAR, "
                          "DIPOLE_DRAW_STRATIFIED and DIPOLE_DRAW_RANDOM",
                          query->draw);
  }
  const core_fault fault = core_draw_check(&draw);
  if (fault.field != NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "%s: allowed: %s", fault.field,
                          fault.allowed);
  }
  if (begin > draw.count || n > draw.count - begin) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "there are only %llu numbers",
                          (unsigned long long)draw.count);
  }
  switch (core_evaluator_bytes(query->evaluator)) {
  case sizeof(double):
    core_draw_f64(&draw, begin, n, u);
    return true;
  case sizeof(float):
    core_draw_f32(&draw, begin, n, u);
    return true;
  default:
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "evaluator is %u", query->evaluator);
  }
}
