#include "server/jobs/mc.h"

#include <stdlib.h>
#include <string.h>

#include "server/jobs/request.h"

struct entry {
  struct entry *next;
  uint64_t request_id;
  uint64_t told; /* replies so far */
  struct mc_job *job;
};

struct mc_desk {
  struct server *server;
  void (*on_news)(void *context);
  void *context;
  uv_async_t wake;
  struct entry *entries;
};

static void on_wake(uv_async_t *handle) {
  struct mc_desk *desk = handle->data;
  desk->on_news(desk->context);
}

static void on_closed(uv_handle_t *handle) {
  free(handle->data);
}

static struct mc_desk *open_desk(const struct mc_caller *caller) {
  struct mc_desk *desk = calloc(1, sizeof *desk);
  if (desk == NULL || uv_async_init(caller->loop, &desk->wake, on_wake) != 0) {
    free(desk);
    return NULL;
  }
  desk->server = caller->server;
  desk->on_news = caller->on_news;
  desk->context = caller->context;
  desk->wake.data = desk;
  return desk;
}

static wire_error no_memory(void) {
  wire_error error = wire_error_make(WIRE_STATUS_BUSY, "", "less at a time: out of memory");
  error.retry_after_ms = JOB_RETRY_AFTER_MS;
  return error;
}

wire_error mc_desk_start(const struct mc_caller *caller, uint64_t request_id,
                         const uint8_t *payload, size_t payload_bytes) {
  if (*caller->desk == NULL) {
    *caller->desk = open_desk(caller);
  }
  struct mc_desk *desk = *caller->desk;
  struct entry *entry = desk != NULL ? calloc(1, sizeof *entry) : NULL;
  if (entry == NULL) {
    return no_memory();
  }
  const wire_error error =
      mc_job_start(caller->server->mc, payload, payload_bytes, &desk->wake, &entry->job);
  if (error.status != WIRE_STATUS_OK) {
    free(entry);
    return error;
  }
  entry->request_id = request_id;
  entry->next = desk->entries;
  desk->entries = entry;
  return error;
}

bool mc_desk_end(struct mc_desk *desk, uint64_t request_id, enum mc_state state) {
  bool found = false;
  for (struct entry *e = desk != NULL ? desk->entries : NULL; e != NULL; e = e->next) {
    if (e->request_id == request_id) {
      mc_job_end(e->job, state);
      found = true;
    }
  }
  return found;
}

bool mc_desk_end_all(struct mc_desk *desk, enum mc_state state) {
  for (struct entry *e = desk != NULL ? desk->entries : NULL; e != NULL; e = e->next) {
    mc_job_end(e->job, state);
  }
  return mc_desk_open(desk);
}

bool mc_desk_open(const struct mc_desk *desk) {
  return desk != NULL && desk->entries != NULL;
}

static bool put_reply(struct output *output, uint64_t request_id, const uint8_t *payload,
                      size_t payload_bytes) {
  uint8_t *at = request_begin_frame(output, WIRE_TYPE_MC | WIRE_REPLY, request_id, payload_bytes);
  if (at == NULL) {
    return false;
  }
  memcpy(at, payload, payload_bytes);
  output_commit(output);
  return true;
}

static void put_progress(struct entry *entry, struct output *output, wire_mc_reply *progress) {
  uint8_t payload[WIRE_BYTES_mc_reply];
  progress->number = entry->told + 1;
  wire_put_mc_reply(payload, progress);
  if (put_reply(output, entry->request_id, payload, sizeof payload)) {
    entry->told++;
  }
}

static bool put_table(struct mc_desk *desk, const struct entry *entry, struct output *output) {
  size_t bytes;
  const uint8_t *table = mc_job_table(entry->job, &bytes);
  if (!put_reply(output, entry->request_id, table, bytes)) {
    return false; /* the budget is exhausted now, and may not be later */
  }
  stats_count_answer(&desk->server->stats, WIRE_STATUS_OK);
  return true;
}

/* True: the last reply has been committed. */
static bool answer_one(struct mc_desk *desk, struct entry *entry, struct output *output) {
  wire_mc_reply progress;
  wire_error error;
  bool last = false;
  switch (mc_job_look(entry->job, &progress)) {
  case MC_NOTHING_NEW:
    break;
  case MC_PROGRESS:
    if (output->ready_bytes == 0) {
      put_progress(entry, output, &progress);
    }
    break;
  case MC_TABLE:
    last = put_table(desk, entry, output);
    break;
  case MC_NO_MEMORY:
    error = no_memory();
    last = request_refuse(desk->server, entry->request_id, &error, output);
    break;
  }
  if (last) {
    mc_job_drop(entry->job);
  }
  return last;
}

void mc_desk_answer(struct mc_desk *desk, struct output *output) {
  if (desk == NULL) {
    return;
  }
  for (struct entry **link = &desk->entries; *link != NULL;) {
    struct entry *entry = *link;
    if (answer_one(desk, entry, output)) {
      *link = entry->next;
      free(entry);
    } else {
      link = &entry->next;
    }
  }
}

void mc_desk_close(struct mc_desk *desk) {
  if (desk == NULL) {
    return;
  }
  while (desk->entries != NULL) {
    struct entry *entry = desk->entries;
    desk->entries = entry->next;
    mc_job_drop(entry->job);
    free(entry);
  }
  uv_close((uv_handle_t *)&desk->wake, on_closed);
}
