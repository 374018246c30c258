/* Monte Carlo: a detached job, so other requests of its connection go on. Threads of mc_pool.h walk
 * its photons. It replies with reports of progress and, at the end, with its table of results. */
#include <stdlib.h>
#include <string.h>

#include "server/jobs/job.h"
#include "server/jobs/mc_pool.h"

/* What the pool sends when mc_job_look() has something new to return. It outlives the job, until libuv
 * has closed it. */
struct news {
  uv_async_t wake;
  void (*on_ready)(void *owner);
  void *owner;
};

struct mc {
  struct job job;
  struct news *news;
  struct mc_job *walk;
  uint64_t progress_count; /* number of progress replies sent */
  bool complete;           /* whether the next part is the table and not a report of progress */
  wire_mc_reply progress;
};

JOB_STRUCTURE(struct mc, of)

static void on_wake(uv_async_t *handle) {
  const struct news *news = handle->data;
  news->on_ready(news->owner);
}

static void on_closed(uv_handle_t *handle) {
  free(handle->data);
}

static wire_error no_memory(void) {
  return wire_error_busy(CORE_FIELD_MEMORY, "less than the memory that is free: try again",
                         JOB_RETRY_AFTER_MS);
}

static enum job_outcome start_mc(struct job *job, const struct job_request *request) {
  struct mc *mc = of(job);
  mc->news = malloc(sizeof *mc->news);
  if (mc->news == NULL || uv_async_init(job->context->loop, &mc->news->wake, on_wake) != 0) {
    free(mc->news);
    return job_refuse(job, no_memory());
  }
  mc->news->wake.data = mc->news;
  mc->news->on_ready = request->on_ready;
  mc->news->owner = request->owner;
  mc->progress_count = 0;
  mc->complete = false;
  const wire_error error = mc_job_start(job->context->server->mc, request->payload,
                                        request->header->payload_bytes, &mc->news->wake, &mc->walk);
  if (error.status != WIRE_STATUS_OK) {
    uv_close((uv_handle_t *)&mc->news->wake, on_closed);
    return job_refuse(job, error);
  }
  return JOB_GOES_ON;
}

static enum job_outcome step_mc(struct job *job, uint64_t *budget) {
  (void)budget;
  struct mc *mc = of(job);
  switch (mc_job_look(mc->walk, &mc->progress)) {
  case MC_NOTHING_NEW:
    break;
  case MC_PROGRESS:
    if (job->reader_idle) {
      job->part_bytes = WIRE_BYTES_mc_reply;
      return JOB_NEXT_PART;
    }
    break;
  case MC_TABLE: {
    size_t bytes;
    mc_job_table(mc->walk, &bytes);
    job->part_bytes = bytes;
    mc->complete = true;
    return JOB_NEXT_PART;
  }
  case MC_NO_MEMORY:
    return job_refuse(job, no_memory());
  }
  return JOB_WAITS;
}

static enum job_outcome begin_part(struct job *job, uint8_t *payload) {
  struct mc *mc = of(job);
  if (mc->complete) {
    size_t bytes;
    const uint8_t *table = mc_job_table(mc->walk, &bytes);
    memcpy(payload, table, bytes);
    return JOB_DONE;
  }
  mc->progress.number = ++mc->progress_count;
  wire_put_mc_reply(payload, &mc->progress);
  return JOB_GOES_ON;
}

static void stop_mc(struct job *job, enum job_stop why) {
  mc_job_end(of(job)->walk, why == JOB_CANCELLED ? MC_CANCELLED : MC_STOPPED);
}

static void end_mc(struct job *job) {
  struct mc *mc = of(job);
  mc_job_drop(mc->walk);
  uv_close((uv_handle_t *)&mc->news->wake, on_closed);
}

const struct job_kind job_kind_MC = {.detached = true,
                                     .start = start_mc,
                                     .begin_part = begin_part,
                                     .step = step_mc,
                                     .end = end_mc,
                                     .stop = stop_mc};
