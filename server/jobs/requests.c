#include "server/jobs/requests.h"

#include <stdio.h>
#include <stdlib.h>

#include "server/jobs/points.h"
#include "server/observe/health.h"

/* What detached requests may hold of a connection's input. More stays in the input, and in the
 * socket. */
#define DETACHED_BYTES ((uint64_t)4 << 20)

/* A detached request: it has left the input and runs beside others. */
struct detached {
  TAILQ_ENTRY(detached) in_requests;
  const struct job_type *type;
  wire_header header;
  uint64_t arrived_ns;
  struct input_block block; /* the frame */
  struct run run;
  bool waits;   /* for its start, as another one of its kind is under way */
  bool refused; /* set after the run: whether it was refused */
  wire_error refusal;
};

static struct stats *stats_of(const struct requests *r) {
  return &r->context->server->stats;
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

bool requests_refuse(struct requests *r, uint64_t request_id, const wire_error *error) {
  health_note_refusal(r->context->server, error);
  uint8_t *at = begin_frame(r->output, WIRE_TYPE_ERROR, request_id, WIRE_BYTES_error);
  if (at == NULL) {
    return false;
  }
  stats_count_reply(stats_of(r), error->status);
  wire_put_error(at, error);
  output_commit(r->output);
  return true;
}

/* Notes the end of a request. refusal: what is still to be written; NULL: all is. Returns false if the
 * output has no room for it. */
static bool reply_to_request(struct requests *r, const wire_header *header,
                             const wire_error *refusal) {
  if (refusal == NULL) {
    stats_count_reply(stats_of(r), WIRE_STATUS_OK);
    return true;
  }
  return requests_refuse(r, header->request_id, refusal);
}

/* ---- runs ------------------------------------------------------------------------------------ */

static uint8_t *reserve_part(void *owner, const struct job *job, wire_error *error) {
  const struct requests *r = owner;
  uint8_t *payload = begin_frame(r->output, job->header.type | WIRE_REPLY, job->header.request_id,
                                 (size_t)job->part_bytes);
  if (payload == NULL) {
    *error = job_busy();
  }
  return payload;
}

static void commit_part(void *owner, bool last) {
  (void)last;
  output_commit(((struct requests *)owner)->output);
}

static void give_part_up(void *owner) {
  output_cancel(((struct requests *)owner)->output);
}

static void wake_connection(void *owner) {
  const struct requests *r = owner;
  r->wake(r->owner);
}

static uint64_t deadline_of(const wire_header *header, uint64_t arrived_ns) {
  return header->deadline_ms > 0 ? arrived_ns / 1000000 + header->deadline_ms : 0;
}

/* ---- detached requests ----------------------------------------------------------------------- */

/* The refusal is written later: another request may have a part open in the output. */
static void end_detached(struct run *run, const wire_error *refusal) {
  struct detached *detached = (void *)((char *)run - offsetof(struct detached, run));
  detached->refused = refusal != NULL;
  if (refusal != NULL) {
    detached->refusal = *refusal;
  }
}

static const struct run_sink detached_sink = {.reserve = reserve_part,
                                              .commit = commit_part,
                                              .cancel = give_part_up,
                                              .wake = wake_connection,
                                              .end = end_detached,
                                              .waits_for_room = true};

/* Moves the first frame out of the input. Returns NULL if there is no memory. */
static struct detached *detach_request(struct requests *r, const struct job_type *type) {
  struct detached *detached = malloc(sizeof *detached);
  if (detached == NULL || !input_take(r->input, &r->header, &detached->block)) {
    free(detached);
    return NULL;
  }
  detached->type = type;
  detached->header = r->header;
  detached->arrived_ns = r->arrived_ns;
  detached->waits = true;
  run_init(&detached->run, &detached_sink, r);
  detached->run.deadline_ms = deadline_of(&r->header, r->arrived_ns);
  r->detached_count++;
  r->detached_bytes += r->header.payload_bytes;
  return detached;
}

static bool has_ended(const struct detached *detached) {
  return !detached->waits && detached->run.state == RUN_IDLE;
}

static void remove_detached(struct requests *r, struct detached *detached) {
  TAILQ_REMOVE(&r->detached, detached, in_requests);
  r->detached_count--;
  r->detached_bytes -= detached->header.payload_bytes;
  r->blocked = false;
  input_free_block(r->input, &detached->block);
  free(detached);
}

static void drop_detached(struct requests *r) {
  struct detached *detached;
  while ((detached = TAILQ_FIRST(&r->detached)) != NULL) {
    run_drop(&detached->run);
    remove_detached(r, detached);
  }
}

const wire_header *requests_under_way(const struct requests *r) {
  const struct detached *first = TAILQ_FIRST(&r->detached);
  return r->run.state != RUN_IDLE ? &r->header : first != NULL ? &first->header : NULL;
}

bool requests_stop_detached(struct requests *r, enum job_stop why) {
  struct detached *detached;
  TAILQ_FOREACH(detached, &r->detached, in_requests) {
    struct job *job = detached->run.job;
    if (detached->run.state != RUN_IDLE && job->kind->stop != NULL) {
      job->kind->stop(job, why);
    }
  }
  return r->detached_count > 0;
}

/* Ends those requests that have this id. */
static bool cancel_requests(void *canceller, uint64_t request_id) {
  struct requests *r = canceller;
  const wire_error error =
      wire_error_make(WIRE_STATUS_CANCELLED, "job_id", "no cancel request that names it");
  bool found = false;
  struct detached *one;
  TAILQ_FOREACH(one, &r->detached, in_requests) {
    struct job *job = one->run.job;
    if (one->header.request_id != request_id || has_ended(one)) {
      continue;
    }
    found = true;
    if (!one->waits && job->kind->stop != NULL) {
      job->kind->stop(job, JOB_CANCELLED);
    } else {
      one->waits = false;
      run_end(&one->run, &error);
    }
  }
  return found;
}

bool requests_give_up(struct requests *r, const wire_error *error, bool all) {
  bool any = r->run.state == RUN_WAITS || (all && r->run.state != RUN_IDLE);
  struct detached *one;
  if (any) {
    run_end(&r->run, error);
  }
  TAILQ_FOREACH(one, &r->detached, in_requests) {
    if (all ? !has_ended(one) : one->run.state == RUN_WAITS && one->type->kind->stop == NULL) {
      one->waits = false;
      run_end(&one->run, error);
      any = true;
    }
  }
  return any;
}

static void start_request(struct requests *r, struct run *run, const struct job_type *type,
                          const wire_header *header, const uint8_t *payload, uint64_t arrived_ns) {
  struct job_request request = {.type = type,
                                .header = header,
                                .payload = payload,
                                .context = r->context,
                                .profiles = r->profiles,
                                .points = &r->points,
                                .cancel = cancel_requests,
                                .canceller = r};
  run_start(run, &request, deadline_of(header, arrived_ns));
}

static void begin_detached(struct requests *r, struct detached *one) {
  one->waits = false;
  start_request(r, &one->run, one->type, &one->header, one->block.payload, one->arrived_ns);
}

static bool expire_detached(struct requests *r, struct detached *one) {
  if (one->waits && run_is_late(&one->run, r->context)) {
    begin_detached(r, one); /* begin_detached() refuses it */
    return true;
  }
  return run_expire(&one->run);
}

/* Begins the parts that wait for room, and serves the requests that have ended, as far as there is
 * room. Returns whether there were any of these. */
static bool write_detached(struct requests *r) {
  bool any = false;
  struct detached *next;
  for (struct detached *one = TAILQ_FIRST(&r->detached); one != NULL; one = next) {
    uint64_t budget = 1;
    next = TAILQ_NEXT(one, in_requests);
    if (one->run.state == RUN_HAS_PART) {
      job_resume(one->run.job);
      if (!output_is_full(r->output)) {
        run_step(&one->run, &budget);
      }
    }
    if (one->run.state == RUN_HAS_PART) {
      job_rest(one->run.job);
    } else if (has_ended(one) &&
               reply_to_request(r, &one->header, one->refused ? &one->refusal : NULL)) {
      latency_note(r->context->latency, one->run.latency, one->arrived_ns);
      remove_detached(r, one);
      any = true;
    }
  }
  return any;
}

bool requests_step_detached(struct requests *r, uint64_t *budget) {
  bool more = false;
  bool under_way = false; /* a job that does its own work, and holds memory for it */
  struct detached *one;
  TAILQ_FOREACH(one, &r->detached, in_requests) {
    struct run *run = &one->run;
    if (!expire_detached(r, one) && one->waits && !under_way) {
      begin_detached(r, one);
    }
    while (run->state == RUN_GOES_ON && *budget > 0) {
      run->job->reader_idle = r->output->ready_bytes == 0;
      run_step(run, budget);
    }
    under_way |= run->state != RUN_IDLE && run->job->kind->stop == NULL;
  }
  if (!r->run.part_open && r->detached_count > 0) {
    more = write_detached(r);
  }
  TAILQ_FOREACH(one, &r->detached, in_requests) {
    more |= one->run.state == RUN_GOES_ON;
  }
  return more;
}

/* ---- the request that is served in its turn ------------------------------------------------ */

/* Removes the request that has been dealt with from the input. */
static void end_frame(struct requests *r, const wire_error *refusal) {
  latency_note(r->context->latency, r->run.latency, r->arrived_ns);
  r->no_room = !reply_to_request(r, &r->header, refusal);
  if (!r->no_room) {
    input_next(r->input, &r->header);
  }
}

static void end_in_turn(struct run *run, const wire_error *refusal) {
  end_frame(run->owner, refusal);
}

void requests_init(struct requests *requests, struct input *input, struct output *output,
                   void (*wake_owner)(void *owner), void *owner) {
  static const struct run_sink sink = {.reserve = reserve_part,
                                       .commit = commit_part,
                                       .cancel = give_part_up,
                                       .wake = wake_connection,
                                       .end = end_in_turn};
  *requests = (struct requests){
      .input = input, .output = output, .wake = wake_owner, .owner = owner, .roles = ROLE_ALL};
  TAILQ_INIT(&requests->detached);
  run_init(&requests->run, &sink, requests);
}

/* ---- waiting and ending ---------------------------------------------------------------------- */

uint64_t requests_deadline_ms(const struct requests *r) {
  const bool waits = r->run.state == RUN_WAITS || r->run.state == RUN_HAS_PART;
  uint64_t first_ms = waits ? r->run.deadline_ms : 0;
  const struct detached *one;
  TAILQ_FOREACH(one, &r->detached, in_requests) {
    const uint64_t at_ms = has_ended(one) ? 0 : one->run.deadline_ms;
    first_ms = at_ms != 0 && (first_ms == 0 || at_ms < first_ms) ? at_ms : first_ms;
  }
  return first_ms;
}

bool requests_expire(struct requests *r) {
  const bool waits = r->run.state == RUN_WAITS || r->run.state == RUN_HAS_PART;
  bool any = waits && run_expire(&r->run);
  struct detached *one;
  TAILQ_FOREACH(one, &r->detached, in_requests) {
    any |= expire_detached(r, one);
  }
  return any;
}

void requests_drop(struct requests *r) {
  drop_detached(r);
  run_drop(&r->run);
  points_release(r->points);
  r->points = NULL;
}

void requests_trim(struct requests *r, uint64_t now_ms) {
  if (r->points != NULL && r->run.state == RUN_IDLE && points_is_late(r->points, now_ms)) {
    points_release(r->points);
    r->points = NULL;
  }
}

void requests_end(struct requests *r, uint64_t request_id, wire_error error) {
  r->tell_end(r->owner, &error);
  requests_refuse(r, request_id, &error);
  drop_detached(r);
  r->ended = true;
}

/* ---- taking requests up ---------------------------------------------------------------------- */

/* Returns whether the client has the role that a message needs. If not, sets *error. */
static bool is_allowed(const struct requests *r, const struct job_type *type, wire_error *error) {
  if (type == NULL || (r->roles & type->role) == type->role) {
    return true;
  }
  char allowed[sizeof error->allowed];
  snprintf(allowed, sizeof allowed, "certificates with the role %s", roles_name(type->role));
  *error = wire_error_make(WIRE_STATUS_NOT_ALLOWED, "role", allowed);
  return false;
}

static void refuse_request(struct requests *r, wire_error error) {
  r->run.latency = LATENCY_REFUSED;
  end_frame(r, &error);
}

/* Starts a request that leaves the input, or lets it wait for its turn. Requests that their own
 * threads work on come first and start at once: their steps cost nothing. */
static void start_detached(struct requests *r, const struct job_type *type) {
  struct detached *one = detach_request(r, type);
  if (one == NULL) {
    refuse_request(r, job_busy());
  } else if (type->kind->stop == NULL) {
    TAILQ_INSERT_TAIL(&r->detached, one, in_requests);
  } else {
    TAILQ_INSERT_HEAD(&r->detached, one, in_requests);
    begin_detached(r, one);
    one->run.deadline_ms = 0; /* the deadline limits only the start of the job */
  }
}

/* Starts the request whose header is r->header. */
static void take_request(struct requests *r, const struct job_type *type, const uint8_t *payload) {
  wire_error error;
  if (type != NULL) {
    stats_add(stats_of(r), type->requests, 1);
  }
  if (!is_allowed(r, type, &error)) {
    refuse_request(r, error);
  } else if (type != NULL && type->kind->detached) {
    start_detached(r, type);
  } else {
    start_request(r, &r->run, type, &r->header, payload, r->arrived_ns);
  }
}

/* Takes the next frame. Returns false if no complete frame has arrived, or if it waits. */
static bool take_frame(struct requests *r) {
  const uint8_t *payload = NULL;
  wire_error error;
  const enum input_outcome outcome = input_frame(r->input, &r->header, &payload, &error);
  if (outcome == INPUT_INCOMPLETE) {
    return false;
  }
  if (outcome == INPUT_LOST) {
    requests_end(r, 0, error);
    return false;
  }
  const struct job_type *type = outcome == INPUT_FRAME ? job_type_of(r->header.type) : NULL;
  r->blocked = type != NULL && type->kind->detached && r->detached_count > 0 &&
               (r->detached_count >= r->context->server->options.max_in_flight ||
                r->detached_bytes + r->header.payload_bytes > DETACHED_BYTES);
  if (r->blocked) {
    return false;
  }
  r->arrived_ns = input_arrival_ns(r->input, &r->header);
  r->taken++;
  if (outcome == INPUT_FRAME) {
    take_request(r, type, payload);
  } else {
    refuse_request(r, error);
  }
  return true;
}

/* Goes on with the request that is served in its turn. Returns false if it waits for its profile,
 * or for the reader, who does not keep up with its parts. */
static bool step_run(struct requests *r, uint64_t *budget) {
  if (r->run.state == RUN_HAS_PART) {
    write_detached(r); /* detached replies need not wait for the last part */
    if (output_is_full(r->output)) {
      job_rest(r->run.job);
      return run_expire(&r->run);
    }
    job_resume(r->run.job);
  } else if (r->run.state == RUN_WAITS) {
    return false;
  }
  run_step(&r->run, budget);
  return true;
}

bool requests_step(struct requests *r, uint64_t *budget) {
  bool more = false;
  if (r->run.state != RUN_IDLE) {
    more = step_run(r, budget);
  } else if (!r->ended) {
    write_detached(r); /* the next frame may begin a part */
    if (!output_is_full(r->output)) {
      *budget -= *budget < JOB_STEP_RADII ? *budget : JOB_STEP_RADII;
      more = take_frame(r);
    }
  }
  return more && !r->no_room;
}
