/* Messages whose reply is written in one step: hello, media, statistics, ping and cancel. */
#include <string.h>

#include "proto/schema.h"
#include "server/jobs/job.h"
#include "server/observe/report.h"
#include "server/store/media.h"

/* Accepts a request whose reply is one part of part_bytes. */
static enum job_outcome reply_with(struct job *job, size_t part_bytes) {
  job->part_bytes = part_bytes;
  return JOB_NEXT_PART;
}

/* ---- hello ----------------------------------------------------------------------------------- */

/* Where the next value of a list is written. `at` is NULL if the values are only counted. */
struct value_cursor {
  uint8_t *at;
  uint32_t count;
};

static void put_value(void *context, const char *name, uint64_t number) {
  struct value_cursor *cursor = context;
  if (cursor->at != NULL) {
    wire_value value = {.value = number};
    WIRE_SET_TEXT(value.name, name);
    wire_put_value(cursor->at, &value);
    cursor->at += WIRE_BYTES_value;
  }
  cursor->count++;
}

static wire_hello_reply describe_daemon(const struct server *server) {
  struct value_cursor counter = {NULL, 0};
  options_each_number(&server->options, put_value, &counter);
  wire_hello_reply reply = {
      .version = WIRE_VERSION,
      .version_min = WIRE_VERSION,
      .version_max = WIRE_VERSION,
      .workers = (uint16_t)server->options.workers,
      .choice_count = (uint32_t)wire_choice_count(),
      .limit_count = counter.count,
  };
  WIRE_SET_TEXT(reply.software, "dipoled " DIPOLED_VERSION);
  WIRE_SET_TEXT(reply.instruction_set, core_isa_name(server->isa));
  WIRE_SET_TEXT(reply.R_unit, WIRE_R_UNIT);
  return reply;
}

static wire_error check_hello(const struct job_request *from) {
  wire_hello_request request;
  wire_get_hello_request(from->payload, &request);
  if (request.version_min > request.version_max) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "version_min", "at most version_max");
  }
  return request.version_min > WIRE_VERSION || request.version_max < WIRE_VERSION
             ? wire_error_make(WIRE_STATUS_BAD_VERSION, "version_max", "a range with 2 in it")
             : wire_error_none();
}

static enum job_outcome start_hello(struct job *job, const struct job_request *request) {
  if (!job_passes(job, check_hello(request))) {
    return JOB_REFUSED;
  }
  const wire_hello_reply reply = describe_daemon(job->context->server);
  return reply_with(job, WIRE_BYTES_hello_reply + reply.choice_count * (size_t)WIRE_BYTES_choice +
                             reply.limit_count * (size_t)WIRE_BYTES_value);
}

static enum job_outcome put_hello(struct job *job, uint8_t *at) {
  const wire_hello_reply reply = describe_daemon(job->context->server);
  wire_put_hello_reply(at, &reply);
  at += WIRE_BYTES_hello_reply;
  for (uint32_t i = 0; i < reply.choice_count; i++) {
    const wire_choice choice = wire_choice_at(i);
    wire_put_choice(at, &choice);
    at += WIRE_BYTES_choice;
  }
  struct value_cursor limits = {at, 0};
  options_each_number(&job->context->server->options, put_value, &limits);
  return JOB_DONE;
}

const struct job_kind job_kind_HELLO = {
    .request = &schema_hello_request, .start = start_hello, .begin_part = put_hello};

/* ---- lists ----------------------------------------------------------------------------------- */

/* Accepts a request whose reply is a list. */
static enum job_outcome start_list(struct job *job, size_t count, size_t entry_bytes) {
  return reply_with(job, WIRE_BYTES_list_reply + count * entry_bytes);
}

/* Writes the count of a list. Returns the address of the first entry. */
static uint8_t *put_list(uint8_t *at, size_t count) {
  const wire_list_reply list = {.count = (uint32_t)count};
  wire_put_list_reply(at, &list);
  return at + WIRE_BYTES_list_reply;
}

static enum job_outcome start_media(struct job *job, const struct job_request *request) {
  (void)request;
  size_t count, layers = 0;
  const core_measured_medium *all = media_all(&count);
  for (size_t i = 0; i < count; i++) {
    layers += all[i].layer_count;
  }
  return start_list(job, layers, WIRE_BYTES_measured_medium);
}

static enum job_outcome put_media(struct job *job, uint8_t *at) {
  (void)job;
  uint8_t *entry_at = at + WIRE_BYTES_list_reply;
  size_t count, layers = 0;
  const core_measured_medium *all = media_all(&count);
  for (size_t i = 0; i < count; i++) {
    const core_measured_medium *medium = &all[i];
    for (size_t layer = 0; layer < medium->layer_count; layer++, layers++) {
      wire_measured_medium entry;
      WIRE_SET_TEXT(entry.name, medium->name);
      for (size_t channel = 0; channel < 3; channel++) {
        const core_medium *from = &medium->channel[channel * medium->layer_count + layer];
        entry.sigma_a[channel] = from->sigma_a_per_mm;
        entry.sigma_s[channel] = from->sigma_s_per_mm;
        entry.g[channel] = from->g;
        entry.eta[channel] = from->eta;
        entry.thickness[channel] = from->thickness_mm;
      }
      wire_put_measured_medium(entry_at, &entry);
      entry_at += WIRE_BYTES_measured_medium;
    }
  }
  put_list(at, layers);
  return JOB_DONE;
}

const struct job_kind job_kind_MEDIA = {
    .request = &schema_nothing, .start = start_media, .begin_part = put_media};

static void put_reported(void *context, const struct report_value *value) {
  if (value->name != NULL) {
    put_value(context, value->name, report_wire_value(value));
  }
}

static size_t statistics_count(void) {
  struct value_cursor counter = {NULL, 0};
  report_each(NULL, put_reported, &counter);
  return counter.count;
}

static enum job_outcome start_statistics(struct job *job, const struct job_request *request) {
  (void)request;
  return start_list(job, statistics_count(), WIRE_BYTES_value);
}

static enum job_outcome put_statistics(struct job *job, uint8_t *at) {
  struct value_cursor cursor = {put_list(at, statistics_count()), 0};
  report_each(job->context->server, put_reported, &cursor);
  return JOB_DONE;
}

const struct job_kind job_kind_STATS = {
    .request = &schema_nothing, .start = start_statistics, .begin_part = put_statistics};

/* ---- ping ------------------------------------------------------------------------------------ */

struct ping {
  struct job job;
  const uint8_t *payload;
};

JOB_STRUCTURE(struct ping, ping_of)

static enum job_outcome start_ping(struct job *job, const struct job_request *request) {
  ping_of(job)->payload = request->payload;
  return request->header->payload_bytes > WIRE_PING_MAX_BYTES
             ? job_refuse(job,
                          wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes", "at most 1024"))
             : reply_with(job, request->header->payload_bytes);
}

static enum job_outcome put_ping(struct job *job, uint8_t *at) {
  memcpy(at, ping_of(job)->payload, job->header.payload_bytes);
  return JOB_DONE;
}

const struct job_kind job_kind_PING = {.start = start_ping, .begin_part = put_ping};

/* ---- cancel ---------------------------------------------------------------------------------- */

struct cancel {
  struct job job;
  bool found;
};

JOB_STRUCTURE(struct cancel, cancel_of)

static enum job_outcome start_cancel(struct job *job, const struct job_request *from) {
  struct cancel *cancel = cancel_of(job);
  wire_cancel_request request;
  wire_get_cancel_request(from->payload, &request);
  cancel->found = from->cancel != NULL && from->cancel(from->canceller, request.job_id);
  return reply_with(job, WIRE_BYTES_cancel_reply);
}

static enum job_outcome put_cancel(struct job *job, uint8_t *at) {
  const wire_cancel_reply reply = {.found = cancel_of(job)->found};
  wire_put_cancel_reply(at, &reply);
  return JOB_DONE;
}

const struct job_kind job_kind_CANCEL = {
    .request = &schema_cancel_request, .start = start_cancel, .begin_part = put_cancel};
