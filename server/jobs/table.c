/* Table: sends the table of a model for one medium, or the surface for all media of one g and eta,
 * so that the client can evaluate it itself. */
#include <math.h>

#include "core/ruler.h"
#include "proto/table.h"
#include "server/jobs/job.h"

struct table {
  struct job job;
  table_request request;
  struct profiles_lookup lookup;
  struct lookup surface;        /* lookup of a surface, instead of a profile */
  struct profiles_lookup ruler; /* profile of transport, if model errors need it */
};

JOB_STRUCTURE(struct table, table_of)

/* Checks a request for a surface with a medium that every model takes. */
static core_fault check_table(const table_request *request, unsigned evaluator) {
  core_medium medium = *request->layers;
  const bool surface = table_is_surface(request);
  medium.sigma_a_per_mm = medium.sigma_s_per_mm = 1;
  return core_profile_check(request->fixed.model, request->fixed.moments, evaluator,
                            surface ? &medium : request->layers, &request->parameters, NULL);
}

static enum job_outcome start_table(struct job *job, const struct job_request *from) {
  struct table *table = table_of(job);
  table_request *request = &table->request;
  if (!job_passes(job, table_request_parse(from->payload, &from->layout, request))) {
    return JOB_REFUSED;
  }
  const wire_table_request *fixed = &request->fixed;
  const unsigned evaluator = table_is_surface(request) ? CORE_EVALUATOR_F32 : CORE_EVALUATOR_LUT;
  if (!job_passes(job, job_error(check_table(request, evaluator)))) {
    return JOB_REFUSED;
  }
  request->parameters.value[CORE_PARAMETER_MHZ] = (double)NAN; /* it is of R alone */
  job_init_other(&table->job, &table->surface, from);
  job_init_lookup(&table->job, &table->ruler, from);
  job_init_lookup(&table->job, &table->lookup, from);
  profiles_start(&table->lookup, fixed->model, fixed->moments, evaluator, &request->parameters);
  return JOB_GOES_ON;
}

static enum lookup_state get_thing(struct table *table) {
  struct profiles *profiles = &table->job.context->profiles;
  const core_medium *medium = table->request.layers;
  if (table_is_surface(&table->request)) {
    const wire_table_request *fixed = &table->request.fixed;
    const enum lookup_state state =
        varyings_get(&profiles->lookups, &table->surface, fixed->model, fixed->moments,
                     CORE_EVALUATOR_F32, &table->request.parameters, medium->g, medium->eta);
    table->lookup.fault = table->surface.fault;
    return state;
  }
  const enum lookup_state state =
      profiles_get_ruler(profiles, &table->ruler, table->request.fixed.model,
                         &table->request.parameters, medium, false);
  table->lookup.fault = table->ruler.fault;
  return state == LOOKUP_READY ? profiles_get(profiles, &table->lookup, medium) : state;
}

static enum job_outcome step_table(struct job *job, uint64_t *budget) {
  struct table *table = table_of(job);
  *budget -= *budget < JOB_STEP_RADII ? *budget : JOB_STEP_RADII;
  const enum job_outcome outcome = job_follow(job, get_thing(table), &table->lookup.fault, 0);
  if (outcome != JOB_GOES_ON) {
    return outcome;
  }
  const core_varying *surface = varyings_found(&table->surface);
  job->part_bytes = table_reply_bytes(&table->request.parameters,
                                      surface != NULL ? table_surface_words(surface)
                                                      : table->lookup.profile.lut_count);
  return job->part_bytes > job->context->server->options.max_frame_bytes
             ? job_refuse(job, wire_error_make(WIRE_STATUS_TOO_LARGE, "tolerance",
                                               "larger: this table exceeds max_frame_bytes"))
             : JOB_NEXT_PART;
}

static enum job_outcome put_table(struct job *job, uint8_t *at) {
  struct table *table = table_of(job);
  const core_varying *surface = varyings_found(&table->surface);
  if (surface != NULL) {
    table_reply_put_surface(at, surface, &table->request.parameters);
  } else {
    const core_model_errors errors = core_model_errors_measure(
        &table->lookup.profile, table->ruler.ready ? &table->ruler.profile : NULL);
    table_reply_put(at, &table->lookup.profile, table->request.layers, &table->request.parameters,
                    &errors);
  }
  return JOB_DONE;
}

static void end_table(struct job *job) {
  lookup_return(&table_of(job)->surface);
  profiles_return(&table_of(job)->lookup);
  profiles_return(&table_of(job)->ruler);
}

const struct job_kind job_kind_TABLE = {.request = &schema_table_request,
                                        .start = start_table,
                                        .begin_part = put_table,
                                        .step = step_table,
                                        .end = end_table};
