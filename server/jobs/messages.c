/* Messages whose reply is written in one step: hello, media, statistics, ping and cancel. */
#include <string.h>

#include "proto/schema.h"
#include "server/jobs/job.h"
#include "server/observe/report.h"
#include "server/store/media.h"

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
  uint8_t head[WIRE_BYTES_hello_reply];
  wire_put_hello_reply(head, &reply);
  return job_reply(job, head);
}

static void put_hello(struct job *job, uint8_t *at) {
  for (size_t i = 0; i < wire_choice_count(); i++) {
    const wire_choice choice = wire_choice_at(i);
    wire_put_choice(at, &choice);
    at += WIRE_BYTES_choice;
  }
  struct value_cursor limits = {at, 0};
  options_each_number(&job->context->server->options, put_value, &limits);
}

const struct job_kind job_kind_HELLO = {.request = &schema_hello_request,
                                        .reply = &schema_hello_reply,
                                        .start = start_hello,
                                        .put = put_hello};

/* ---- lists ----------------------------------------------------------------------------------- */

/* Accepts a request whose reply is a list. */
static enum job_outcome start_list(struct job *job, size_t count) {
  const wire_list_reply list = {.count = (uint32_t)count};
  return job_reply(job, &list);
}

static enum job_outcome start_media(struct job *job, const struct job_request *request) {
  (void)request;
  size_t count, layers = 0;
  const core_measured_medium *all = media_all(&count);
  for (size_t i = 0; i < count; i++) {
    layers += all[i].layer_count;
  }
  return start_list(job, layers);
}

static void put_media(struct job *job, uint8_t *at) {
  (void)job;
  size_t count;
  const core_measured_medium *all = media_all(&count);
  for (size_t i = 0; i < count; i++) {
    const core_measured_medium *medium = &all[i];
    for (size_t layer = 0; layer < medium->layer_count; layer++) {
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
      wire_put_measured_medium(at, &entry);
      at += WIRE_BYTES_measured_medium;
    }
  }
}

const struct job_kind job_kind_MEDIA = {.request = &schema_nothing,
                                        .reply = &schema_media_reply,
                                        .start = start_media,
                                        .put = put_media};

static void put_reported(void *context, const struct report_value *value) {
  if (value->name != NULL) {
    put_value(context, value->name, report_wire_value(value));
  }
}

static enum job_outcome start_statistics(struct job *job, const struct job_request *request) {
  struct value_cursor counter = {NULL, 0};
  (void)request;
  report_each(NULL, put_reported, &counter);
  return start_list(job, counter.count);
}

static void put_statistics(struct job *job, uint8_t *at) {
  struct value_cursor cursor = {at, 0};
  report_each(job->context->server, put_reported, &cursor);
}

const struct job_kind job_kind_STATS = {.request = &schema_nothing,
                                        .reply = &schema_statistics_reply,
                                        .start = start_statistics,
                                        .put = put_statistics};

/* ---- ping ------------------------------------------------------------------------------------ */

static enum job_outcome start_ping(struct job *job, const struct job_request *request) {
  job->part_bytes = request->header->payload_bytes;
  return job->part_bytes > WIRE_PING_MAX_BYTES
             ? job_refuse(job,
                          wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes", "at most 1024"))
             : JOB_NEXT_PART;
}

static enum job_outcome put_ping(struct job *job, uint8_t *at) {
  memcpy(at, job->payload, job->header.payload_bytes);
  return JOB_DONE;
}

const struct job_kind job_kind_PING = {.start = start_ping, .begin_part = put_ping};

/* ---- cancel ---------------------------------------------------------------------------------- */

static enum job_outcome start_cancel(struct job *job, const struct job_request *from) {
  const wire_cancel_request *request = (const void *)from->payload;
  const wire_cancel_reply reply = {.found = from->cancel != NULL &&
                                            from->cancel(from->canceller, request->job_id)};
  return job_reply(job, &reply);
}

const struct job_kind job_kind_CANCEL = {
    .request = &schema_cancel_request, .reply = &schema_cancel_reply, .start = start_cancel};
