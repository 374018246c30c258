/* Starts, follows and cancels Monte Carlo jobs, and reads their results. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/query.h"
#include "clients/c/request.h"
#include "proto/mc.h"

_Static_assert((int)DIPOLE_MC_REFLECTED == (int)CORE_MC_REFLECTED &&
                   (int)DIPOLE_MC_SIDES == (int)CORE_MC_SIDES,
               "sides");
_Static_assert((int)DIPOLE_MC_PHOTONS == (int)MC_PHOTONS_WALKED &&
                   (int)DIPOLE_MC_STOPPED == (int)MC_STOPPED,
               "ends");

_Static_assert(sizeof(dipole_mc_energy) == WIRE_BYTES_mc_energy,
               "one takes the place of the other");

/* ---- requests ------------------------------------------------------------------------------ */

/* Checks the fields on which the layout of the frame depends. The daemon checks the others. */
static bool check_query(const dipole_mc_query *query, dipole_error *error) {
  if (query->albedo_count > CORE_MC_ALBEDOS_MAX) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "albedo_count is at most %d",
                          CORE_MC_ALBEDOS_MAX);
  }
  if (query->albedos == NULL && query->albedo_count > 0) {
    return libdipole_fail_argument(error, "albedos is NULL although albedo_count is not 0");
  }
  return libdipole_query_check(1, query->spacing, query->parameters, query->parameter_count, error);
}

/* These return the number of sides and of albedos in the reply. */
static uint32_t sides_of(const dipole_mc_query *query) {
  const uint32_t count = query->layers != NULL ? query->layer_count : 0;
  const dipole_medium *last = count > 0 ? &query->layers[count - 1] : &query->medium;
  return last->thickness_mm > 0 ? DIPOLE_MC_SIDES : 1;
}

static uint32_t albedos_of(const dipole_mc_query *query) {
  return query->albedo_count > 0 ? query->albedo_count : 1;
}

static bool is_progress(const libdipole_frame *frame) {
  wire_mc_reply reply;
  /* The payload has room for this: begin_job() set reply_bytes_min to its size. */
  wire_get_mc_reply(frame->payload, &reply);
  return reply.state == MC_UNDER_WAY;
}

static bool is_cut_off(const libdipole_frame *frame) {
  wire_mc_reply reply;
  wire_get_mc_reply(frame->payload, &reply);
  return reply.state == MC_STOPPED;
}

/* Sending a job again starts it anew; its result has the same bits. */
static const libdipole_kind job_kind = {
    .repeatable = true, .endless = true, .is_progress = is_progress, .is_cut_off = is_cut_off};

static bool begin_job(dipole_client *client, const dipole_mc_query *query,
                      libdipole_pending *pending, dipole_error *error) {
  schema_layout layout;
  uint8_t *payload;
  *pending = (libdipole_pending){.kind = &job_kind,
                                 .type = WIRE_TYPE_MC,
                                 .reply_bytes_min = WIRE_BYTES_mc_reply,
                                 .reply_bytes_max = WIRE_BYTES_mc_reply};
  /* Without a layout the numbers are out of range: the daemon refuses them with a message. */
  if (mc_reply_layout(sides_of(query), albedos_of(query), query->ring_count, &layout)) {
    pending->reply_bytes_max = layout.payload_bytes;
  }
  const wire_mc_request start = {
      .spacing = (uint16_t)query->spacing,
      .albedo_count = (uint16_t)query->albedo_count,
      .ring_count = query->ring_count,
      .radius_start = query->radius_start_mm,
      .radius_stop = query->radius_stop_mm,
      .layer_count = libdipole_layers(query->layers != NULL ? query->layer_count : 1),
      .seed = query->seed,
      .photons = query->photons,
      .error_total = query->error_total,
      .error_rings = query->error_rings};
  pending->medium_count = 1;
  pending->layer_count = start.layer_count;
  const void *const parts[] = {query->layers != NULL ? query->layers : &query->medium,
                               query->albedos, query->parameters};
  schema_layout request;
  schema_lay_out(&schema_mc_request, &start, UINT64_MAX, &request, NULL);
  request.parts[2].count = query->parameter_count; /* The albedos are followed by the parameters. */
  request.payload_bytes += query->parameter_count * (uint64_t)WIRE_BYTES_parameter;
  if (!libdipole_request_begin(client, pending, request.payload_bytes, &payload, error)) {
    return false;
  }
  libdipole_payload_put(payload, &schema_mc_request, &request, &start, parts);
  return libdipole_request_send(client, error);
}

/* ---- replies ------------------------------------------------------------------------------- */

static dipole_mc_progress progress_of(const wire_mc_reply *from) {
  return (dipole_mc_progress){.photons = from->photons,
                              .photons_expected = from->photons_expected,
                              .error_total = from->error_total,
                              .error_rings = from->error_rings,
                              .worst_from_mm = from->worst_from,
                              .worst_to_mm = from->worst_to,
                              .worst_side = from->worst_side,
                              .worst_albedo = from->worst_albedo};
}

static dipole_mc_energy get_energy(const uint8_t *at) {
  wire_mc_energy from;
  wire_get_mc_energy(at, &from);
  dipole_mc_energy to = {.albedo = from.albedo,
                         .R = {from.reflected, from.reflected_error},
                         .T = {from.transmitted, from.transmitted_error},
                         .absorbed = {from.absorbed, from.absorbed_error},
                         .unfinished = {from.unfinished, from.unfinished_error},
                         .roulette = {from.roulette, from.roulette_error},
                         .imbalance = from.imbalance};
  for (size_t side = 0; side < DIPOLE_MC_SIDES; side++) {
    to.unscattered[side] = from.unscattered[side];
    to.under[side] = (dipole_mc_value){from.under[side], from.under_error[side]};
    to.over[side] = (dipole_mc_value){from.over[side], from.over_error[side]};
  }
  for (size_t i = 0; i < sizeof to.in_layer / sizeof to.in_layer[0]; i++) {
    to.in_layer[i] = (dipole_mc_value){from.in_layer[i], from.in_layer_error[i]};
  }
  return to;
}

/* Makes the result of the last frame of a job. */
static dipole_mc_result *make_result(libdipole_frame *frame, const wire_mc_reply *fixed,
                                     const schema_layout *layout) {
  uint8_t *energies = frame->payload + layout->parts[MC_ENERGIES].at;
  for (uint32_t i = 0; i < fixed->albedo_count; i++) {
    uint8_t *at = energies + (size_t)i * WIRE_BYTES_mc_energy;
    const dipole_mc_energy energy = get_energy(at);
    memcpy(at, &energy, sizeof energy);
  }
  frame->mc =
      (dipole_mc_result){.end = (enum dipole_mc_end)fixed->state,
                         .last = progress_of(fixed),
                         .side_count = fixed->side_count,
                         .albedo_count = fixed->albedo_count,
                         .ring_count = fixed->ring_count,
                         .edges_mm = (const void *)(frame->payload + layout->parts[MC_EDGES].at),
                         .energies = (const void *)energies};
  return &frame->mc;
}

static bool is_requested(const dipole_mc_query *query, const wire_mc_reply *fixed) {
  return fixed->state <= MC_STOPPED && fixed->side_count == sides_of(query) &&
         fixed->albedo_count == albedos_of(query) && fixed->ring_count == query->ring_count;
}

/* Waits for the next reply of a job. After the last reply, *result is the result. After another
 * one, *result is NULL and *progress is set. */
static bool next_reply(dipole_client *client, const dipole_mc_query *query, uint64_t id,
                       dipole_mc_progress *progress, dipole_mc_result **result,
                       dipole_error *error) {
  libdipole_pending pending = {.id = id};
  wire_mc_reply fixed;
  schema_layout layout;
  libdipole_frame *frame = libdipole_reply(client, &pending, error);
  *result = NULL;
  if (frame == NULL) {
    return false;
  }
  const bool shaped = mc_reply_parse(frame->payload, frame->header.payload_bytes, &fixed, &layout);
  if (shaped && fixed.state == MC_UNDER_WAY) {
    *progress = progress_of(&fixed);
    free(frame);
    return true;
  }
  if (!shaped || !is_requested(query, &fixed)) {
    free(frame);
    return libdipole_bad_reply(
        client, "it replied to an mc request with another shape than requested", error);
  }
  *result = make_result(frame, &fixed, &layout);
  return true;
}

/* ---- the public calls ---------------------------------------------------------------------- */

/* Waits for the reply to a cancel request and ignores it: the result of the job says enough. There
 * may be no reply, because a daemon that stops sends the result and closes. */
static void drop_cancel(dipole_client *client, uint64_t cancel_id) {
  libdipole_pending pending;
  dipole_error unwanted;
  if (cancel_id != 0 && libdipole_request_wait(client, cancel_id, NULL, &pending, &unwanted)) {
    free(pending.frame);
  }
}

bool dipole_mc(dipole_client *client, const dipole_mc_query *query,
               bool (*progress)(void *context, const dipole_mc_progress *now), void *context,
               dipole_mc_result **result, dipole_error *error) {
  libdipole_pending job;
  dipole_mc_progress now;
  uint64_t cancel_id = 0;
  error = error != NULL ? error : &(dipole_error){0};
  if (!check_query(query, error) || !begin_job(client, query, &job, error)) {
    return false;
  }
  for (;;) {
    if (!next_reply(client, query, job.id, &now, result, error)) {
      return false;
    }
    if (*result != NULL) {
      drop_cancel(client, cancel_id);
      return true;
    }
    client->torn = true;
    const bool goes_on = progress == NULL || progress(context, &now);
    client->torn = false;
    if (!goes_on && cancel_id == 0 && !libdipole_cancel(client, job.id, &cancel_id, error)) {
      return false;
    }
  }
}

static schema_layout layout_of(const dipole_mc_result *result) {
  schema_layout layout;
  mc_reply_layout(result->side_count, result->albedo_count, result->ring_count, &layout);
  return layout;
}

static const double *rings(const dipole_mc_result *result, uint32_t albedo,
                           enum dipole_mc_side side, bool error) {
  const libdipole_frame *frame = (const void *)result;
  const schema_layout layout = layout_of(result);
  return albedo < result->albedo_count && (uint32_t)side < result->side_count
             ? (const void *)(frame->payload + mc_rings_offset(&layout, albedo, side, error))
             : NULL;
}

const double *dipole_mc_values(const dipole_mc_result *result, uint32_t albedo,
                               enum dipole_mc_side side) {
  return rings(result, albedo, side, false);
}

const double *dipole_mc_errors(const dipole_mc_result *result, uint32_t albedo,
                               enum dipole_mc_side side) {
  return rings(result, albedo, side, true);
}

const uint64_t *dipole_mc_photons(const dipole_mc_result *result, enum dipole_mc_side side) {
  const libdipole_frame *frame = (const void *)result;
  const schema_layout layout = layout_of(result);
  return (uint32_t)side < result->side_count
             ? (const void *)(frame->payload + mc_photons_offset(&layout, side))
             : NULL;
}
