#include "server/jobs/requests.h"

#include <stdio.h>

#include "server/observe/health.h"
#include "server/store/points.h"

void requests_init(struct requests *requests, struct input *input, struct output *output,
                   void (*wake)(void *owner), void *owner) {
  *requests = (struct requests){
      .input = input, .output = output, .wake = wake, .owner = owner, .roles = ROLE_ALL};
}

static struct stats *stats_of(const struct requests *r) {
  return &r->context->server->stats;
}

static bool is_late(const struct requests *r) {
  return r->deadline_ms != 0 && uv_now(r->context->loop) >= r->deadline_ms;
}

static void note_latency(struct requests *r, enum latency_class kind) {
  latency_note(r->context->latency, kind, r->arrived_ns);
}

/* ---- frames ---------------------------------------------------------------------------------- */

/* Reserves a frame in the output and writes its header. Returns where its payload goes, or NULL if
 * there is no room. */
static uint8_t *begin_frame(struct output *output, unsigned type, uint64_t request_id,
                            size_t payload_bytes) {
  uint8_t *frame = output_reserve(output, WIRE_BYTES_header + payload_bytes);
  if (frame == NULL) {
    return NULL;
  }
  const wire_header header = {
      .magic = WIRE_MAGIC,
      .version = WIRE_VERSION,
      .type = (uint16_t)type,
      .request_id = request_id,
      .payload_bytes = (uint32_t)payload_bytes,
  };
  wire_put_header(frame, &header);
  return frame + WIRE_BYTES_header;
}

static uint8_t *begin_reply(struct requests *r, const struct job *job) {
  return begin_frame(r->output, job->header.type | WIRE_REPLY, job->header.request_id,
                     (size_t)job->part_bytes);
}

bool requests_refuse(struct requests *r, uint64_t request_id, const wire_error *error) {
  stats_count_answer(stats_of(r), error->status);
  health_note_refusal(r->context->server, error);
  uint8_t *at = begin_frame(r->output, WIRE_TYPE_ERROR, request_id, WIRE_BYTES_error);
  if (at == NULL) {
    return false;
  }
  wire_put_error(at, error);
  output_commit(r->output);
  return true;
}

/* ---- detached jobs --------------------------------------------------------------------------- */

static void drop_detached(struct requests *r) {
  while (r->detached != NULL) {
    struct job *job = r->detached;
    r->detached = job->next;
    job_end(job);
  }
}

bool requests_stop_detached(struct requests *r, enum job_stop why) {
  for (struct job *job = r->detached; job != NULL; job = job->next) {
    job->kind->stop(job, why);
  }
  return r->detached != NULL;
}

/* Lets a detached job write. Returns true if the last reply or the refusal has been committed. If
 * the output has no room, the job is asked again later. */
static bool step_detached(struct requests *r, struct job *job) {
  uint64_t budget = JOB_SLICE_RADII;
  job->reader_idle = r->output->ready_bytes == 0;
  enum job_outcome outcome = job->kind->step(job, &budget);
  if (outcome == JOB_NEXT_PART) {
    uint8_t *payload = begin_reply(r, job);
    if (payload == NULL) {
      return false;
    }
    outcome = job->kind->begin_part(job, payload);
    output_commit(r->output);
    if (outcome == JOB_DONE) {
      stats_count_answer(stats_of(r), WIRE_STATUS_OK);
    }
  }
  return outcome == JOB_DONE ||
         (outcome == JOB_REFUSED && requests_refuse(r, job->header.request_id, &job->refusal));
}

void requests_step_detached(struct requests *r) {
  if (r->part_open) {
    return;
  }
  for (struct job **link = &r->detached; *link != NULL;) {
    struct job *job = *link;
    if (step_detached(r, job)) {
      *link = job->next;
      job_end(job);
    } else {
      link = &job->next;
    }
  }
}

/* ---- the job that holds the input ------------------------------------------------------------ */

/* Ends the job that holds the input. Its reply is in the output; a refusal is written now. */
static void finish(struct requests *r, const wire_error *refusal) {
  struct job *job = r->job;
  const wire_header *header = &job->header;
  note_latency(r, refusal != NULL ? LATENCY_REFUSED : job->latency);
  job_end(job);
  r->job = NULL;
  r->waiting = false;
  r->part_open = false;
  r->between_parts = false;
  if (refusal == NULL) {
    stats_count_answer(stats_of(r), WIRE_STATUS_OK);
  } else if (!requests_refuse(r, header->request_id, refusal)) {
    r->no_room = true;
    return;
  }
  input_next(r->input, header);
}

/* Ends the job with a refusal. If a part is open, first empties the batch, which may still hold
 * values for it, and then cancels the part. */
static void give_up(struct requests *r, const wire_error *refusal) {
  if (r->part_open) {
    batch_finish(&r->context->batch, stats_of(r));
    output_cancel(r->output);
  }
  finish(r, refusal);
}

static void begin_part(struct requests *r) {
  struct job *job = r->job;
  r->between_parts = false;
  uint8_t *payload = begin_reply(r, job);
  if (payload == NULL) { /* no room: the reply ends with the parts that have been sent */
    const wire_error busy = job_busy();
    finish(r, &busy);
    return;
  }
  r->part_open = true;
  if (job->kind->begin_part(job, payload) == JOB_DONE) {
    output_commit(r->output);
    finish(r, NULL);
  }
}

static void end_part(struct requests *r) {
  output_commit(r->output);
  r->part_open = false;
  r->between_parts = true;
  requests_step_detached(r); /* so that detached jobs need not wait for the last part */
}

static void follow(struct requests *r, enum job_outcome outcome) {
  switch (outcome) {
  case JOB_GOES_ON:
  case JOB_DETACHED:
    return;
  case JOB_WAITS:
    r->waiting = true;
    return;
  case JOB_NEXT_PART:
    if (r->part_open) {
      end_part(r);
    } else {
      begin_part(r);
    }
    return;
  case JOB_DONE:
    output_commit(r->output);
    finish(r, NULL);
    return;
  case JOB_REFUSED:
    give_up(r, &r->job->refusal);
    return;
  }
}

static wire_error late(void) {
  return wire_error_make(WIRE_STATUS_DEADLINE, "deadline_ms",
                         "more milliseconds, or 0 for no limit");
}

uint64_t requests_deadline_ms(const struct requests *r) {
  return r->waiting || r->between_parts ? r->deadline_ms : 0;
}

bool requests_expire(struct requests *r) {
  if (requests_deadline_ms(r) == 0 || !is_late(r)) {
    return false;
  }
  const wire_error error = late();
  give_up(r, &error);
  return true;
}

unsigned requests_count(const struct requests *r) {
  unsigned count = input_count(r->input) +
                   output_count(r->output, r->job != NULL ? r->job->header.request_id : 0);
  for (const struct job *job = r->detached; job != NULL; job = job->next) {
    count++;
  }
  return count;
}

void requests_drop(struct requests *r) {
  drop_detached(r);
  if (r->job != NULL) {
    job_end(r->job);
    r->job = NULL;
  }
  points_release(r->points);
  r->points = NULL;
}

void requests_trim(struct requests *r, uint64_t now_ms) {
  if (r->points != NULL && r->job == NULL && points_is_late(r->points, now_ms)) {
    points_release(r->points);
    r->points = NULL;
  }
}

void requests_end(struct requests *r, uint64_t request_id, wire_error error) {
  if (r->tell_end != NULL) {
    r->tell_end(r->owner, &error);
  }
  requests_refuse(r, request_id, &error);
  drop_detached(r);
  r->ended = true;
}

/* ---- taking requests up ---------------------------------------------------------------------- */

static void on_ready(void *owner) {
  struct requests *r = owner;
  r->waiting = false;
  r->wake(r->owner);
}

static void on_news(void *owner) {
  const struct requests *r = owner;
  r->wake(r->owner);
}

/* Refuses a request that has no job, because its frame or its start was refused. */
static void refuse(struct requests *r, const wire_header *header, const wire_error *error) {
  note_latency(r, LATENCY_REFUSED);
  if (requests_refuse(r, header->request_id, error)) {
    input_next(r->input, header);
  } else {
    r->no_room = true;
  }
}

/* Returns whether the client has the role that a message needs. If not, sets *error. */
static bool is_allowed(const struct requests *r, unsigned type, wire_error *error) {
  const unsigned needed = roles_needed(type);
  if ((r->roles & needed) == needed) {
    return true;
  }
  char allowed[sizeof error->allowed];
  snprintf(allowed, sizeof allowed, "certificates with the role %s", roles_name(needed));
  *error = wire_error_make(WIRE_STATUS_NOT_ALLOWED, "role", allowed);
  return false;
}

static void start(struct requests *r, const wire_header *header, const uint8_t *payload) {
  stats_count_request(stats_of(r), header->type);
  r->deadline_ms = header->deadline_ms > 0 ? r->arrived_ns / 1000000 + header->deadline_ms : 0;
  wire_error error = late();
  if (is_late(r) || !is_allowed(r, header->type, &error)) {
    refuse(r, header, &error);
    return;
  }
  const struct job_request request = {.header = header,
                                      .payload = payload,
                                      .context = r->context,
                                      .on_ready = on_ready,
                                      .on_news = on_news,
                                      .owner = r,
                                      .profiles = r->profiles,
                                      .detached = &r->detached,
                                      .points = &r->points};
  struct job *job;
  const enum job_outcome outcome = job_start(&r->slot, &request, &job);
  if (outcome == JOB_REFUSED) {
    refuse(r, header, &job->refusal);
  } else if (outcome == JOB_DETACHED) {
    input_next(r->input, header);
  } else {
    r->job = job;
    follow(r, outcome);
  }
}

/* Takes the next frame. Returns false if no complete frame has arrived. */
static bool take_frame(struct requests *r) {
  wire_header header;
  const uint8_t *payload = NULL;
  wire_error error;
  const enum input_outcome outcome = input_frame(r->input, &header, &payload, &error);
  if (outcome == INPUT_INCOMPLETE) {
    return false;
  }
  if (outcome == INPUT_LOST) {
    requests_end(r, 0, error);
    return false;
  }
  r->arrived_ns = input_arrival_ns(r->input, &header);
  r->taken++;
  if (outcome == INPUT_FRAME) {
    start(r, &header, payload);
  } else {
    refuse(r, &header, &error);
  }
  return true;
}

/* Begins the next part, or waits if the reader does not keep up. Returns false if it waits. */
static bool step_between_parts(struct requests *r) {
  if (output_is_full(r->output)) {
    job_rest(r->job);
    return false;
  }
  job_resume(r->job);
  begin_part(r);
  return true;
}

static bool step_job(struct requests *r, uint64_t *budget) {
  if (is_late(r)) {
    const wire_error error = late();
    give_up(r, &error);
    return true;
  }
  if (r->between_parts) {
    return step_between_parts(r);
  }
  follow(r, r->job->kind->step(r->job, budget));
  return true;
}

bool requests_step(struct requests *r, uint64_t *budget) {
  bool more = false;
  if (r->job != NULL) {
    more = !r->waiting && step_job(r, budget);
  } else if (!r->ended && !output_is_full(r->output)) {
    *budget -= *budget < JOB_STEP_RADII ? *budget : JOB_STEP_RADII;
    more = take_frame(r);
  }
  return more && !r->no_room;
}
