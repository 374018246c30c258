#include "server/jobs/call.h"

#include <stdio.h>

#include "server/jobs/points.h"
#include "server/net/worker.h"
#include "server/observe/health.h"

/* Returns the field that makes a reply too large: that counts the first list of the request. */
static const char *size_field(unsigned type) {
  const schema_part *part = schema_messages[type - 1].request->parts;
  while (part->name != NULL && (part->about == NULL || part->count[0].name == NULL)) {
    part++;
  }
  return part->name == NULL                                ? "tolerance"
         : strcmp(part->count[0].name, "part_points") == 0 ? "point_count"
                                                           : part->count[0].name;
}

/* A reply is one part. Those before it are reports of progress, if the job can be stopped. */
static uint8_t *reserve_reply(void *owner, const struct job *job, wire_error *error) {
  struct call *call = owner;
  const uint64_t most = job->context->server->options.max_part_bytes;
  if (job->part_bytes > most || (call->reply.count > 0 && job->kind->stop == NULL)) {
    char allowed[80];
    snprintf(allowed, sizeof allowed, "fewer: the reply has at most max_part_bytes, %llu",
             (unsigned long long)most);
    *error = wire_error_make(WIRE_STATUS_TOO_LARGE, size_field(job->header.type), allowed);
    return NULL;
  }
  text_reset(&call->reply);
  char *room = text_room(&call->reply, (size_t)job->part_bytes);
  if (room == NULL) {
    *error = job_busy();
    return NULL;
  }
  call->reply.count = (size_t)job->part_bytes;
  return (uint8_t *)room;
}

static void commit_reply(void *owner, bool last) {
  struct call *call = owner;
  if (!last && call->report != NULL) {
    call->report(call);
  }
}

static void wake_client(void *owner) {
  worker_run_later(((struct call *)owner)->client);
}

static void drop_points(struct call *call) {
  points_release(call->points);
  call->points = NULL;
}

static void end_call(struct run *run, const wire_error *refusal) {
  struct call *call = run->owner;
  struct worker *worker = call->client->worker;
  drop_points(call);
  call->state = CALL_ENDS;
  call->error = refusal != NULL ? *refusal : wire_error_none();
  health_note_refusal(worker->server, &call->error);
  if (call->counts) {
    stats_count_reply(&worker->server->stats, call->error.status);
    latency_note(worker->context.latency, run->latency, call->arrived_ns);
  }
  worker_finish_later(call->client);
}

void call_init(struct call *call, struct client *client, struct budget *budget, bool counts) {
  static const struct run_sink sink = {
      .reserve = reserve_reply, .commit = commit_reply, .wake = wake_client, .end = end_call};
  *call = (struct call){.client = client, .counts = counts};
  run_init(&call->run, &sink, call);
  text_init(&call->payload, budget);
  text_init(&call->reply, budget);
}

void call_start(struct call *call, enum wire_type type, struct cache_owner *profiles,
                uint64_t deadline_ms) {
  struct worker *worker = call->client->worker;
  const wire_header header = {.type = (uint16_t)type,
                              .payload_bytes = (uint32_t)call->payload.count};
  struct job_request request = {.type = job_type_of(type),
                                .header = &header,
                                .payload = (const uint8_t *)call->payload.bytes,
                                .context = &worker->context,
                                .profiles = profiles,
                                .whole = true,
                                .points = &call->points};
  call->state = CALL_RUNS;
  call->arrived_ns = worker_round_ns(worker);
  call->reply.count = 0;
  if (call->counts) {
    stats_add(&worker->server->stats, request.type->requests, 1);
  }
  run_start(&call->run, &request, deadline_ms > 0 ? call->arrived_ns / 1000000 + deadline_ms : 0);
}

/* Makes the worker call the client's deadline(). */
static void await_deadline(const struct call *call) {
  if (call->run.state != RUN_IDLE && call->run.deadline_ms != 0) {
    worker_wake_at(call->client->worker, call->run.deadline_ms);
  }
}

void call_on(struct call *call, uint64_t *budget) {
  run_on(&call->run, budget);
  if (call->run.state == RUN_GOES_ON) {
    worker_run_later(call->client);
  } else {
    await_deadline(call);
  }
}

void call_expire(struct call *call) {
  if (!run_expire(&call->run)) {
    await_deadline(call);
  }
}

bool call_take_end(struct call *call) {
  const bool ended = call->state == CALL_ENDS;
  if (ended) {
    call->state = call->error.status == WIRE_STATUS_OK ? CALL_DONE : CALL_NONE;
  }
  return ended;
}

bool call_may_stop(const struct call *call) {
  return call->state == CALL_RUNS && call->run.job->kind->stop != NULL;
}

void call_stop(struct call *call, enum job_stop why) {
  if (call_may_stop(call)) {
    call->run.job->kind->stop(call->run.job, why);
  } else if (call->state == CALL_RUNS) {
    call_drop(call);
  }
}

void call_drop(struct call *call) {
  if (call->state == CALL_ENDS) { /* passes must not write into memory that is freed */
    struct worker *worker = call->client->worker;
    batch_finish(&worker->context.batch, &worker->server->stats);
  }
  run_drop(&call->run);
  drop_points(call);
  call->state = CALL_NONE;
  text_reset(&call->payload);
  text_reset(&call->reply);
}

void call_free(struct call *call) {
  call_drop(call);
  text_free(&call->payload);
  text_free(&call->reply);
}
