#include "server/jobs/table_job.h"

#include "proto/channels.h"
#include "server/jobs/request.h"

wire_error table_job_start(struct table_job *job, const uint8_t *payload, size_t payload_bytes) {
  const wire_error error = table_request_parse(payload, payload_bytes, &job->request);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  const wire_table_request *fixed = &job->request.fixed;
  const core_fault fault = core_profile_check(fixed->model, fixed->moments, CORE_EVALUATOR_LUT,
                                              &job->request.medium, &job->request.parameters, NULL);
  if (fault.field != NULL) {
    return job_error(fault);
  }
  profiles_start(&job->order, fixed->model, fixed->moments, CORE_EVALUATOR_LUT,
                 &job->request.parameters);
  return wire_error_none();
}

static enum job_state refuse(struct table_job *job, wire_error error) {
  job->refusal = error;
  return JOB_REFUSED;
}

static enum job_state reply(struct table_job *job, const struct server *server, uint64_t request_id,
                            struct output *output) {
  const core_profile *profile = &job->order.profile;
  const size_t bytes =
      table_reply_bytes(channels_count_parameters(&job->request.parameters), profile->lut_count);
  if (bytes > server->options.max_frame_bytes) {
    return refuse(job, wire_error_make(WIRE_STATUS_TOO_LARGE, "tolerance",
                                       "more: the table is larger than max_frame_bytes"));
  }
  uint8_t *at = request_begin_frame(output, WIRE_TYPE_TABLE | WIRE_REPLY, request_id, bytes);
  if (at == NULL) {
    return refuse(job, job_busy());
  }
  table_reply_put(at, profile, &job->request.parameters);
  return JOB_DONE;
}

enum job_state table_job_run(struct table_job *job, struct profiles *profiles, uint64_t request_id,
                             struct output *output) {
  enum job_state state = JOB_WAITS;
  switch (profiles_get(profiles, &job->order, &job->request.medium)) {
  case PROFILES_WAIT:
    return JOB_WAITS;
  case PROFILES_FAULT:
    state = refuse(job, job_fault(job->order.fault, 0));
    break;
  case PROFILES_READY:
    state = reply(job, profiles->server, request_id, output);
    break;
  }
  profiles_return(&job->order);
  return state;
}

void table_job_end(struct table_job *job) {
  profiles_return(&job->order);
}
