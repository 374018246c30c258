/* Fit of layers: a request is fitted on another thread, as a slow thing of the cache, which keeps the
 * reply. */
#include <stddef.h>
#include <stdlib.h>

#include "core/fit/layers.h"
#include "server/jobs/job.h"

struct layers_job {
  struct job job;
  struct lookup lookup; /* gets the reply */
};

JOB_STRUCTURE(struct layers_job, layers_of)

/* A reply in the cache. */
struct layers_reply {
  uint8_t *payload;
  uint64_t bytes;
};

/* Reads a request that was checked; it points into the payload. */
static core_layers_fit_request read_request(const uint8_t *payload) {
  wire_fit_layers_request fixed;
  schema_layout layout;
  wire_get_fit_layers_request(payload, &fixed);
  schema_lay_out(&schema_fit_layers_request, payload, UINT64_MAX, &layout, NULL);
  const double *at = (const void *)(payload + layout.parts[1].at);
  return (core_layers_fit_request){.scale = fixed.scale,
                                   .unknowns = fixed.unknowns,
                                   .layer = (const void *)(payload + layout.parts[0].at),
                                   .layer_count = fixed.layer_count,
                                   .count = fixed.reading_count,
                                   .at = at,
                                   .values = at + fixed.reading_count,
                                   .errors = at + 2 * (size_t)fixed.reading_count};
}

_Static_assert(offsetof(core_layers_fit, unknown_count) == WIRE_BYTES_fit_layers_reply &&
                   sizeof(core_estimate) == WIRE_BYTES_estimate,
               "a result has its layout");

static core_fault prepare_reply(void *thing, const struct cache_key *key, const core_isa *isa,
                                const atomic_bool *stop) {
  struct layers_reply *reply = thing;
  const core_layers_fit_request request = read_request(key->content);
  const wire_fit_layers_reply fixed = {.unknowns = (uint16_t)request.unknowns,
                                       .reading_count = (uint32_t)request.count};
  const uint64_t bytes = schema_bytes(&schema_fit_layers_reply, &fixed);
  uint8_t *payload = malloc((size_t)bytes);
  if (payload == NULL) {
    return (core_fault){CORE_FIELD_MEMORY, "enough for the reply", 0};
  }
  double *residuals = (double *)(void *)(payload + bytes) - request.count;
  core_layers_fit fit;
  const core_fault fault = core_layers_fit_run(&fit, isa, &request, residuals, stop);
  if (fault.field != NULL) {
    free(payload);
    return fault;
  }
  memcpy(payload, &fit, WIRE_BYTES_fit_layers_reply);
  memcpy(payload + WIRE_BYTES_fit_layers_reply, fit.unknown,
         fit.unknown_count * WIRE_BYTES_estimate);
  *reply = (struct layers_reply){payload, bytes};
  return fault;
}

static void free_reply(void *thing) {
  free(((struct layers_reply *)thing)->payload);
}

static uint64_t reply_bytes_of(const void *thing) {
  return ((const struct layers_reply *)thing)->bytes;
}

static const struct cache_kind reply_kind = {.thing_bytes = sizeof(struct layers_reply),
                                             .prepare = prepare_reply,
                                             .free = free_reply,
                                             .bytes = reply_bytes_of};

/* ---- the job --------------------------------------------------------------------------------- */

static enum job_outcome start_layers(struct job *job, const struct job_request *from) {
  struct layers_job *layers = layers_of(job);
  const core_layers_fit_request request = read_request(from->payload);
  const core_fault fault = core_layers_fit_check(&request);
  if (fault.field != NULL) {
    return job_refuse(job, job_error(fault));
  }
  job_init_other(job, &layers->lookup, from);
  return JOB_GOES_ON;
}

static enum job_outcome step_layers(struct job *job, uint64_t *budget) {
  struct layers_job *layers = layers_of(job);
  const enum job_outcome outcome = job_get(job, &layers->lookup, &reply_kind, job->payload,
                                           job->header.payload_bytes, CACHE_SOLVED);
  *budget -= *budget < JOB_STEP_RADII ? *budget : JOB_STEP_RADII;
  if (outcome != JOB_GOES_ON) {
    return outcome;
  }
  job->part_bytes = reply_bytes_of(lookup_thing(&layers->lookup));
  return JOB_NEXT_PART;
}

static enum job_outcome put_layers(struct job *job, uint8_t *at) {
  const struct layers_reply *reply = lookup_thing(&layers_of(job)->lookup);
  memcpy(at, reply->payload, (size_t)reply->bytes);
  return JOB_DONE;
}

static void end_layers(struct job *job) {
  lookup_return(&layers_of(job)->lookup);
}

const struct job_kind job_kind_FIT_LAYERS = {.request = &schema_fit_layers_request,
                                             .start = start_layers,
                                             .begin_part = put_layers,
                                             .step = step_layers,
                                             .end = end_layers};
