#include "server/jobs/requests.h"

#include <stdio.h>
#include <stdlib.h>

#include "server/observe/health.h"
#include "server/store/points.h"

void requests_init(struct requests *requests, struct input *input, struct output *output,
                   void (*wake)(void *owner), void *owner) {
  *requests = (struct requests){
      .input = input, .output = output, .wake = wake, .owner = owner, .roles = ROLE_ALL};
  requests->aside_end = &requests->waiting_aside;
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

/* ---- requests beside the input --------------------------------------------------------------- */

/* What may wait beside the input. More stays in the input, and in the socket. */
#define ASIDE_BYTES ((uint64_t)4 << 20)

/* Moves the first frame out of the input. Returns NULL if there is no memory. */
static struct aside *put_aside(struct requests *r, const wire_header *header) {
  struct aside *aside = malloc(sizeof *aside);
  if (aside != NULL) {
    *aside = (struct aside){.header = *header, .arrived_ns = input_arrival_ns(r->input, header)};
  }
  if (aside != NULL && !input_take(r->input, header, &aside->block)) {
    free(aside);
    aside = NULL;
  }
  return aside;
}

static void free_aside(struct requests *r, struct aside *aside) {
  if (aside != NULL) {
    input_free_block(r->input, &aside->block);
    free(aside);
  }
}

static void add_aside(struct requests *r, struct aside *aside) {
  *r->aside_end = aside;
  r->aside_end = &aside->next;
  r->aside_count++;
  r->aside_bytes += aside->block.capacity;
}

/* Removes the one that *link points to from the list. */
static struct aside *remove_aside(struct requests *r, struct aside **link) {
  struct aside *aside = *link;
  *link = aside->next;
  r->aside_end = *link == NULL ? link : r->aside_end;
  r->aside_count--;
  r->aside_bytes -= aside->block.capacity;
  return aside;
}

/* Ends the request that has been dealt with: removes it from where it is. */
static void end_request(struct requests *r, const wire_header *header) {
  if (r->own == NULL) {
    input_next(r->input, header);
  } else {
    free_aside(r, r->own);
    r->own = NULL;
  }
}

/* ---- the job that answers in turn ------------------------------------------------------------ */

/* Ends the job that holds the input. Its reply is in the output; a refusal is written now. */
static void finish(struct requests *r, const wire_error *refusal) {
  struct job *job = r->job;
  const wire_header header = job->header;
  note_latency(r, refusal != NULL ? LATENCY_REFUSED : job->latency);
  job_end(job);
  r->job = NULL;
  r->waiting = false;
  r->part_open = false;
  r->between_parts = false;
  if (refusal == NULL) {
    stats_count_answer(stats_of(r), WIRE_STATUS_OK);
  } else if (!requests_refuse(r, header.request_id, refusal)) {
    r->no_room = true;
    return;
  }
  end_request(r, &header);
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
  return count + r->aside_count + (r->own != NULL);
}

void requests_drop(struct requests *r) {
  drop_detached(r);
  if (r->job != NULL) {
    job_end(r->job);
    r->job = NULL;
  }
  free_aside(r, r->own);
  r->own = NULL;
  while (r->waiting_aside != NULL) {
    free_aside(r, remove_aside(r, &r->waiting_aside));
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
    end_request(r, header);
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

/* Ends those requests beside the input that have this id. */
static bool cancel(void *owner, uint64_t request_id) {
  struct requests *r = owner;
  const wire_error error =
      wire_error_make(WIRE_STATUS_CANCELLED, "job_id", "no cancel request that names it");
  bool found = false;
  if (r->job != NULL && r->own != NULL && r->job->header.request_id == request_id) {
    give_up(r, &error);
    found = true;
  }
  for (struct aside **link = &r->waiting_aside; *link != NULL && !r->no_room;) {
    if ((*link)->header.request_id != request_id) {
      link = &(*link)->next;
      continue;
    }
    struct aside *aside = remove_aside(r, link);
    stats_count_request(stats_of(r), aside->header.type);
    r->no_room = !requests_refuse(r, request_id, &error);
    free_aside(r, aside);
    found = true;
  }
  return found;
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
                                      .whole = r->whole,
                                      .detached = &r->detached,
                                      .points = &r->points,
                                      .cancel = cancel};
  struct job *job;
  const enum job_outcome outcome = job_start(&r->slot, &request, &job);
  if (outcome == JOB_REFUSED) {
    refuse(r, header, &job->refusal);
  } else if (outcome == JOB_DETACHED) {
    end_request(r, header);
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
    r->own = job_is_aside(header.type) ? put_aside(r, &header) : NULL;
    start(r, &header, r->own != NULL ? r->own->block.payload : payload);
  } else {
    refuse(r, &header, &error);
  }
  return true;
}

static void start_aside(struct requests *r) {
  r->own = remove_aside(r, &r->waiting_aside);
  const wire_header header = r->own->header;
  r->arrived_ns = r->own->arrived_ns;
  start(r, &header, r->own->block.payload);
}

/* Answers a cancel request while a job runs, which may be the one that it ends. Returns false if it
 * has to wait, because the answer of another job is being written. */
static bool take_cancel(struct requests *r, const wire_header *header, const uint8_t *payload) {
  wire_cancel_request fixed = {0};
  if (header->payload_bytes == WIRE_BYTES_cancel_request) {
    wire_get_cancel_request(payload, &fixed);
  }
  if (r->part_open && fixed.job_id != r->job->header.request_id) {
    return false;
  }
  struct job_slot slot;
  struct job *job;
  const struct job_request request = {.header = header,
                                      .payload = payload,
                                      .context = r->context,
                                      .owner = r,
                                      .detached = &r->detached,
                                      .cancel = cancel};
  stats_count_request(stats_of(r), header->type);
  const enum job_outcome outcome = job_start(&slot, &request, &job);
  uint8_t *at = NULL;
  if (r->no_room) {
    return true;
  }
  if (outcome == JOB_REFUSED) {
    r->no_room = !requests_refuse(r, header->request_id, &job->refusal);
  } else {
    at = begin_reply(r, job);
    r->no_room = at == NULL;
  }
  if (at != NULL) {
    job->kind->begin_part(job, at);
    output_commit(r->output);
    stats_count_answer(stats_of(r), WIRE_STATUS_OK);
  }
  input_next(r->input, header);
  r->taken++;
  return true;
}

/* While a job runs whose request is beside the input: answers the cancel request that comes next, or
 * puts the next request of such a kind beside it. Returns whether it took a frame. */
static bool look_ahead(struct requests *r) {
  wire_header header;
  const uint8_t *payload = NULL;
  wire_error error;
  if (input_frame(r->input, &header, &payload, &error) != INPUT_FRAME) {
    return false;
  }
  if (header.type == WIRE_TYPE_CANCEL) {
    return take_cancel(r, &header, payload);
  }
  const uint64_t frame_bytes = WIRE_BYTES_header + (uint64_t)header.payload_bytes;
  if (!job_is_aside(header.type) || r->aside_bytes + frame_bytes > ASIDE_BYTES ||
      r->aside_count >= r->context->server->options.max_in_flight) {
    return false;
  }
  struct aside *aside = put_aside(r, &header);
  if (aside == NULL) {
    return false;
  }
  add_aside(r, aside);
  r->taken++;
  return true;
}

bool requests_take_on(struct requests *r) {
  wire_header header;
  const uint8_t *payload;
  wire_error error;
  return r->job == NULL ||
         (r->own != NULL && input_frame(r->input, &header, &payload, &error) == INPUT_INCOMPLETE);
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
  if (r->own != NULL && look_ahead(r)) {
    *budget -= *budget < JOB_STEP_RADII ? *budget : JOB_STEP_RADII;
    more = true;
  } else if (r->job != NULL) {
    more = !r->waiting && step_job(r, budget);
  } else if (!r->ended && !output_is_full(r->output)) {
    *budget -= *budget < JOB_STEP_RADII ? *budget : JOB_STEP_RADII;
    if (r->waiting_aside != NULL) {
      start_aside(r);
      more = true;
    } else {
      more = take_frame(r);
    }
  }
  return more && !r->no_room;
}
