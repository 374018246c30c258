#include "server/jobs/answer.h"

#include "server/jobs/request.h"
#include "server/net/worker.h"

/* ---- what it is about --------------------------------------------------------------------------
 */

static void on_news(void *context) {
  struct connection *c = context;
  worker_run_later(&c->client);
}

static void on_profile(void *context) {
  struct connection *c = context;
  c->waiting = false;
  worker_run_later(&c->client);
}

void answer_init(struct connection *c) {
  c->job.order.on_ready = on_profile;
  c->job.order.context = c;
  c->table.order.on_ready = on_profile;
  c->table.order.context = c;
  c->invert.order.on_ready = on_profile;
  c->invert.order.context = c;
}

static void let_go(struct connection *c) {
  job_end(&c->job);
  table_job_end(&c->table);
  invert_job_end(&c->invert);
}

/* It owes its worker nothing any more. */
static void forgive(struct connection *c) {
  struct backlog *backlog = &worker_scratch(c->client.worker)->backlog;
  backlog_forgive(backlog, &c->job.share);
  backlog_forgive(backlog, &c->invert.share);
}

void answer_end(struct connection *c) {
  let_go(c);
  forgive(c);
}

bool answer_is_under_way(const struct connection *c) {
  return c->answering != CONNECTION_ANSWERS_NOTHING;
}

bool answer_holds_output(const struct connection *c) {
  return !c->between_parts &&
         (c->answering == CONNECTION_ANSWERS_EVAL || c->answering == CONNECTION_ANSWERS_INVERT);
}

static bool is_late(const struct connection *c) {
  return c->deadline_ms != 0 && uv_now(worker_loop(c->client.worker)) >= c->deadline_ms;
}

static wire_error late(void) {
  return wire_error_make(WIRE_STATUS_DEADLINE, "deadline_ms", "more: the answer takes longer");
}

static void note_answer(struct connection *c, enum latency_class kind) {
  latency_note(worker_latency(c->client.worker), kind, c->arrived_ns);
}

/* ---- taking up ---------------------------------------------------------------------------------
 */

static void start(struct connection *c, const wire_header *header,
                  enum connection_answering answering) {
  c->answering = answering;
  c->job_header = *header;
}

static void answer_frame(struct connection *c, const wire_header *header, const uint8_t *payload) {
  c->arrived_ns = input_arrival_ns(&c->input, header);
  c->deadline_ms = header->deadline_ms > 0 ? c->arrived_ns / 1000000 + header->deadline_ms : 0;
  if (is_late(c)) {
    const wire_error error = late();
    stats_count_request(&c->server->stats, header->type);
    note_answer(c, LATENCY_REFUSED);
    if (request_refuse(c->server, header->request_id, &error, &c->output)) {
      input_next(&c->input, header);
    } else {
      connection_abort(c);
    }
    return;
  }
  const struct mc_caller mc = {c->server, worker_loop(c->client.worker), on_news, c, &c->mc};
  const struct request_place place = {&c->job, &c->table, &c->invert,
                                      worker_scratch(c->client.worker), &mc};
  switch (request_begin(c->server, header, payload, &c->output, &place)) {
  case REQUEST_ANSWERED: /* an eval at once: it is short */
    note_answer(c, header->type == WIRE_TYPE_EVAL ? LATENCY_EVAL_SHORT : LATENCY_OTHER);
    input_next(&c->input, header);
    break;
  case REQUEST_REFUSED:
    note_answer(c, LATENCY_REFUSED);
    input_next(&c->input, header);
    break;
  case REQUEST_BEGUN:
    input_next(&c->input, header);
    break;
  case REQUEST_STARTED:
    start(c, header, CONNECTION_ANSWERS_EVAL);
    break;
  case REQUEST_TABLE_STARTED:
    start(c, header, CONNECTION_ANSWERS_TABLE);
    break;
  case REQUEST_INVERT_STARTED:
    start(c, header, CONNECTION_ANSWERS_INVERT);
    break;
  case REQUEST_NO_ROOM:
    connection_abort(c);
    break;
  }
}

/* Takes the next frame, if one is there; false: none is. */
static bool take_frame(struct connection *c) {
  wire_header header;
  const uint8_t *payload = NULL;
  wire_error error;
  switch (input_frame(&c->input, &header, &payload, &error)) {
  case INPUT_INCOMPLETE:
    return false;
  case INPUT_FRAME:
    answer_frame(c, &header, payload);
    break;
  case INPUT_REFUSED:
    c->arrived_ns = input_arrival_ns(&c->input, &header);
    note_answer(c, LATENCY_REFUSED);
    if (!request_refuse(c->server, header.request_id, &error, &c->output)) {
      connection_abort(c);
      return false;
    }
    input_next(&c->input, &header);
    break;
  case INPUT_LOST:
    connection_end(c, 0, error);
    return false;
  }
  c->frame_started_ms = 0;
  return !c->closing;
}

/* ---- coming to an end --------------------------------------------------------------------------
 */

static enum latency_class class_of(const struct connection *c) {
  if (c->job_header.type != WIRE_TYPE_EVAL) {
    return LATENCY_OTHER;
  }
  return c->job.request.fixed.radius_count <= BATCH_SHORT_RADII ? LATENCY_EVAL_SHORT
                                                                : LATENCY_EVAL_LONG;
}

/* The answer, which is in the output, or the error that is sent in its place, is the last of it. */
static void finish(struct connection *c, const wire_error *refusal) {
  note_answer(c, refusal != NULL ? LATENCY_REFUSED : class_of(c));
  forgive(c);
  c->answering = CONNECTION_ANSWERS_NOTHING;
  c->between_parts = false;
  if (refusal == NULL) {
    stats_count_answer(&c->server->stats, WIRE_STATUS_OK);
  } else if (!request_refuse(c->server, c->job_header.request_id, refusal, &c->output)) {
    connection_abort(c);
    return;
  }
  input_next(&c->input, &c->job_header);
}

/* What has been gathered for the reply may not be written to its place any more. */
static void cancel_output(struct connection *c) {
  batch_finish(&worker_scratch(c->client.worker)->batch, &c->server->stats);
  output_cancel(&c->output);
}

/* The deadline has passed: what has been filled in so far is given up. */
static void give_up(struct connection *c) {
  const wire_error error = late();
  if (answer_holds_output(c)) {
    cancel_output(c);
  }
  c->waiting = false;
  let_go(c);
  finish(c, &error);
}

/* The worker's clock watches the deadline while nothing else does. */
static void watch_deadline(struct connection *c) {
  if (c->deadline_ms != 0) {
    worker_wake_at(c->client.worker, c->deadline_ms);
  }
}

void answer_deadline(struct connection *c) {
  if (!c->closing && (c->waiting || c->between_parts)) {
    if (is_late(c)) {
      give_up(c);
      worker_run_later(&c->client);
    } else {
      watch_deadline(c);
    }
  }
}

/* ---- going on ----------------------------------------------------------------------------------
 */

static enum job_state run(struct connection *c, uint64_t *budget) {
  struct profiles *profiles = worker_profiles(c->client.worker);
  struct job_scratch *scratch = worker_scratch(c->client.worker);
  if (c->answering == CONNECTION_ANSWERS_EVAL) {
    return job_slice(&c->job, c->server, profiles, scratch, budget);
  }
  if (c->answering == CONNECTION_ANSWERS_INVERT) {
    return invert_job_run(&c->invert, c->server, profiles, &scratch->backlog, budget);
  }
  *budget -= *budget < JOB_STEP_RADII ? *budget : JOB_STEP_RADII;
  return table_job_run(&c->table, profiles, c->job_header.request_id, &c->output);
}

static const wire_error *refusal_of(const struct connection *c) {
  return c->answering == CONNECTION_ANSWERS_EVAL     ? &c->job.refusal
         : c->answering == CONNECTION_ANSWERS_INVERT ? &c->invert.refusal
                                                     : &c->table.refusal;
}

/* A part has been committed, and there is another. */
static void pause_after_part(struct connection *c) {
  if (c->answering == CONNECTION_ANSWERS_EVAL) {
    job_next_part(&c->job);
  } else {
    invert_job_next_part(&c->invert);
  }
  c->between_parts = true;
  mc_desk_answer(c->mc, &c->output); /* which else would wait until the last part is there */
  watch_deadline(c);
}

static void go_on(struct connection *c, uint64_t *budget) {
  switch (run(c, budget)) {
  case JOB_GOES_ON:
    return;
  case JOB_WAITS:
    c->waiting = true;
    watch_deadline(c);
    return;
  case JOB_PART_DONE:
    output_commit(&c->output);
    pause_after_part(c);
    return;
  case JOB_DONE:
    output_commit(&c->output);
    finish(c, NULL);
    return;
  case JOB_REFUSED:
    cancel_output(c);
    finish(c, refusal_of(c));
    return;
  }
}

/* Room for the next part; without, what has been sent is all there will be, and the error says so.
 */
static void begin_part(struct connection *c) {
  const bool is_eval = c->answering == CONNECTION_ANSWERS_EVAL;
  const uint64_t bytes = is_eval ? c->job.layout.payload_bytes : invert_job_part_bytes(&c->invert);
  c->between_parts = false;
  uint8_t *reply = request_begin_frame(&c->output, c->job_header.type | WIRE_REPLY,
                                       c->job_header.request_id, (size_t)bytes);
  if (reply == NULL) {
    const wire_error busy = job_busy();
    finish(c, &busy);
  } else if (is_eval) {
    job_start_part(&c->job, reply);
  } else {
    invert_job_start_part(&c->invert, reply);
  }
}

/* Between two parts; false: not while the reader does not keep up. */
static bool step_between_parts(struct connection *c) {
  struct backlog *backlog = &worker_scratch(c->client.worker)->backlog;
  struct backlog_share *share =
      c->answering == CONNECTION_ANSWERS_EVAL ? &c->job.share : &c->invert.share;
  if (connection_blocked(c)) {
    backlog_rest(backlog, share);
    return false;
  }
  backlog_resume(backlog, share);
  begin_part(c);
  return true;
}

bool answer_step(struct connection *c, uint64_t *budget) {
  if (c->waiting) {
    return false;
  }
  if (answer_is_under_way(c) && is_late(c)) {
    give_up(c);
    return !c->closing;
  }
  if (c->between_parts) {
    return step_between_parts(c);
  }
  if (answer_is_under_way(c)) {
    go_on(c, budget);
    return true;
  }
  if (c->ending || connection_blocked(c)) {
    return false;
  }
  *budget -= *budget < JOB_STEP_RADII ? *budget : JOB_STEP_RADII;
  return take_frame(c);
}
