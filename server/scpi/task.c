#include <string.h>

#include "server/net/worker.h"
#include "server/observe/health.h"
#include "server/scpi/session.h"

static struct job_context *context_of(const struct scpi_task *task) {
  return &task->session->client->worker->context;
}

/* A part that is not the last one is a report of progress: the next one takes its place. */
static uint8_t *reserve_reply(void *owner, const struct job *job, wire_error *error) {
  struct scpi_task *task = owner;
  const uint64_t most = task->session->server->options.max_part_bytes;
  text_reset(&task->reply);
  *error = wire_error_busy("max_total_bytes", "less data at a time: the buffers are full", 1000);
  char *room = NULL;
  if (job->part_bytes > most) {
    *error = wire_error_make(WIRE_STATUS_TOO_LARGE, "max_part_bytes", "fewer values at a time");
  } else if ((room = text_room(&task->reply, (size_t)job->part_bytes)) != NULL) {
    task->reply.count = (size_t)job->part_bytes;
  }
  return (uint8_t *)room;
}

static void wake_task(void *owner) {
  worker_run_later(((struct scpi_task *)owner)->session->client);
}

/* The values of an eval are in the batch: the session takes them when the worker has evaluated it. */
static void end_run(struct run *run, const wire_error *refusal) {
  struct scpi_task *task = run->owner;
  task->state = SCPI_TASK_ENDS;
  task->error = refusal != NULL ? *refusal : wire_error_none();
  stats_count_reply(&task->session->server->stats, task->error.status);
  health_note_refusal(task->session->server, &task->error);
  latency_note(context_of(task)->latency, run->latency, task->arrived_ns);
  worker_finish_later(task->session->client);
}

static const struct run_sink sink = {.reserve = reserve_reply, .wake = wake_task, .end = end_run};

void scpi_task_init(struct scpi_task *task, struct scpi_session *session) {
  task->session = session;
  run_init(&task->run, &sink, task);
  text_init(&task->payload, &session->server->buffers);
  text_init(&task->reply, &session->server->buffers);
}

void scpi_task_start(struct scpi_task *task, enum wire_type type) {
  struct client *client = task->session->client;
  const wire_header header = {.type = (uint16_t)type,
                              .payload_bytes = (uint32_t)task->payload.count};
  struct job_request request = {.type = job_type_of(type),
                                .header = &header,
                                .payload = (const uint8_t *)task->payload.bytes,
                                .context = context_of(task),
                                .profiles = &client->profiles,
                                .whole = true};
  task->state = SCPI_TASK_RUNS;
  task->arrived_ns = worker_round_ns(client->worker);
  task->reply.count = 0;
  stats_add(&task->session->server->stats, request.type->requests, 1);
  run_start(&task->run, &request, 0);
  worker_run_later(client);
}

void scpi_task_drop(struct scpi_task *task) {
  if (task->state == SCPI_TASK_ENDS) {
    batch_finish(&context_of(task)->batch, &task->session->server->stats);
  }
  run_drop(&task->run);
  task->state = SCPI_TASK_NONE;
  text_reset(&task->payload);
  text_reset(&task->reply);
}
