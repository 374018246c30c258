#include "server/jobs/run.h"

#include <stdlib.h>

void run_init(struct run *run, const struct run_sink *sink, void *owner) {
  run->sink = sink;
  run->owner = owner;
  run->state = RUN_IDLE;
  run->part_open = false;
  run->deadline_ms = 0;
}

/* ---- slots ----------------------------------------------------------------------------------- */

enum {
  SLOTS_KEPT = 64
}; /* free slots that a worker keeps, so that small requests allocate nothing */

static struct job_slot *lend_slot(struct job_context *context) {
  struct job_slot *slot = SLIST_FIRST(&context->free_slots);
  if (slot == NULL) {
    return malloc(sizeof *slot);
  }
  SLIST_REMOVE_HEAD(&context->free_slots, next);
  context->free_slot_count--;
  return slot;
}

static void return_slot(struct job_context *context, struct job_slot *slot) {
  if (context->free_slot_count == SLOTS_KEPT) {
    free(slot);
    return;
  }
  SLIST_INSERT_HEAD(&context->free_slots, slot, next);
  context->free_slot_count++;
}

void run_free_slots(struct job_context *context) {
  while (context->free_slot_count > 0) {
    free(lend_slot(context));
  }
}

/* ---- ending ---------------------------------------------------------------------------------- */

/* First evaluates the batch, which may hold values for a part that is open. */
static void end_job(struct run *run) {
  if (run->part_open) {
    struct job_context *context = run->job->context;
    batch_finish(&context->batch, &context->server->stats);
    if (run->sink->cancel != NULL) {
      run->sink->cancel(run->owner);
    }
    run->part_open = false;
  }
  job_end(run->job);
  run->state = RUN_IDLE;
}

void run_drop(struct run *run) {
  if (run->state != RUN_IDLE) {
    end_job(run);
    return_slot(run->job->context, run->slot);
  }
}

/* The refusal may lie in the slot, and the sink may free the run. */
void run_end(struct run *run, const wire_error *refusal) {
  if (run->state == RUN_IDLE) { /* the job has not been started */
    run->latency = LATENCY_NONE;
    run->sink->end(run, refusal);
    return;
  }
  struct job_context *context = run->job->context;
  struct job_slot *slot = run->slot;
  run->latency =
      refusal != NULL && run->job->latency != LATENCY_NONE ? LATENCY_REFUSED : run->job->latency;
  end_job(run);
  run->sink->end(run, refusal);
  return_slot(context, slot);
}

bool run_is_late(const struct run *run, const struct job_context *context) {
  return run->deadline_ms != 0 && uv_now(context->loop) >= run->deadline_ms;
}

static wire_error late_error(void) {
  return wire_error_make(WIRE_STATUS_DEADLINE, "deadline_ms",
                         "more milliseconds, or 0 for no limit");
}

bool run_expire(struct run *run) {
  if (run->state == RUN_IDLE || !run_is_late(run, run->job->context)) {
    return false;
  }
  const wire_error error = late_error();
  run_end(run, &error);
  return true;
}

/* ---- steps ----------------------------------------------------------------------------------- */

static void commit_part(struct run *run, bool last) {
  run->part_open = false;
  if (run->sink->commit != NULL) {
    run->sink->commit(run->owner, last);
  }
}

static void begin_part(struct run *run) {
  struct job *job = run->job;
  wire_error error;
  uint8_t *payload = run->sink->reserve(run->owner, job, &error);
  if (payload == NULL && run->sink->waits_for_room) {
    run->state = RUN_HAS_PART;
    return;
  }
  if (payload == NULL) { /* the reply ends after the complete parts */
    run_end(run, &error);
    return;
  }
  run->part_open = true;
  run->state = RUN_GOES_ON;
  bool done = true;
  if (job->kind->reply == NULL) {
    done = job->kind->begin_part(job, payload) == JOB_DONE;
  } else {
    job_put_reply(job, payload);
  }
  if (done || job->kind->detached) {
    commit_part(run, done);
  }
  if (done) {
    run_end(run, NULL);
  }
}

static void follow_outcome(struct run *run, enum job_outcome outcome) {
  run->state = outcome == JOB_WAITS ? RUN_WAITS : RUN_GOES_ON;
  switch (outcome) {
  case JOB_GOES_ON:
  case JOB_WAITS:
    return;
  case JOB_NEXT_PART:
    if (run->part_open) {
      run->state = RUN_HAS_PART;
      commit_part(run, false);
    } else if (run->sink->waits_for_room) {
      run->state = RUN_HAS_PART;
    } else {
      begin_part(run);
    }
    return;
  case JOB_DONE:
    commit_part(run, true);
    run_end(run, NULL);
    return;
  case JOB_REFUSED:
    run_end(run, &run->job->refusal);
    return;
  }
}

static void on_ready(void *owner) {
  struct run *run = owner;
  if (run->state == RUN_WAITS) {
    run->state = RUN_GOES_ON;
    run->sink->wake(run->owner);
  }
}

void run_start(struct run *run, struct job_request *request, uint64_t deadline_ms) {
  run->deadline_ms = deadline_ms;
  request->on_ready = on_ready;
  request->owner = run;
  struct job_context *context = request->context;
  const bool late = run_is_late(run, context);
  struct job_slot *slot = late ? NULL : lend_slot(context);
  if (slot == NULL) {
    const wire_error error = late ? late_error() : job_busy();
    run->latency = LATENCY_REFUSED;
    run->sink->end(run, &error);
    return;
  }
  run->slot = slot;
  run->job = (struct job *)(void *)slot->bytes;
  const enum job_outcome outcome = job_start(slot, request);
  if (outcome != JOB_REFUSED) {
    follow_outcome(run, outcome);
    return;
  }
  run->latency = LATENCY_REFUSED;
  run->sink->end(run, &run->job->refusal);
  return_slot(context, slot);
}

void run_step(struct run *run, uint64_t *budget) {
  if (run_expire(run)) {
    return;
  }
  if (run->state == RUN_HAS_PART) {
    begin_part(run);
  } else {
    follow_outcome(run, run->job->kind->step(run->job, budget));
  }
}

void run_on(struct run *run, uint64_t *budget) {
  while ((run->state == RUN_GOES_ON && *budget > 0) || run->state == RUN_HAS_PART) {
    run_step(run, budget);
  }
}
