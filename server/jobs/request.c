#include "server/jobs/request.h"

#include <string.h>

#include "server/jobs/choice.h"
#include "server/observe/report.h"

/* A message being answered. */
struct question {
  struct server *server;
  const wire_header *header;
  const uint8_t *payload;
  struct output *output;
  const struct request_place *place;
  wire_error error; /* REFUSED: why */
};

/* What a handler made of it. */
enum outcome { ANSWERED, REFUSED, STARTED_JOB, STARTED_TABLE, STARTED_INVERT, STARTED_MC };

static enum outcome refused(struct question *question, wire_error error) {
  question->error = error;
  return REFUSED;
}

/* Started, unless there is an error. */
static enum outcome started(struct question *question, wire_error error, enum outcome what) {
  return error.status == WIRE_STATUS_OK ? what : refused(question, error);
}

uint8_t *request_begin_frame(struct output *output, unsigned type, uint64_t request_id,
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

static uint8_t *begin_reply(struct question *question, size_t payload_bytes) {
  return request_begin_frame(question->output, question->header->type | WIRE_REPLY,
                             question->header->request_id, payload_bytes);
}

static enum outcome busy(struct question *question) {
  return refused(question, job_busy());
}

static enum outcome bad_length(struct question *question, const char *allowed) {
  return refused(question, wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes", allowed));
}

/* ---- messages: answer_<IDENT> for each of the list ---------------------------------------------
 */

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

static enum outcome answer_HELLO(struct question *question) {
  if (question->header->payload_bytes != WIRE_BYTES_hello_request) {
    return bad_length(question, "8");
  }
  wire_hello_request request;
  wire_get_hello_request(question->payload, &request);
  if (request.zero != 0) {
    return refused(question, wire_error_make(WIRE_STATUS_BAD_VALUE, "zero", "0"));
  }
  if (request.version_min > request.version_max) {
    return refused(question,
                   wire_error_make(WIRE_STATUS_BAD_VALUE, "version_min", "at most version_max"));
  }
  if (request.version_min > WIRE_VERSION || request.version_max < WIRE_VERSION) {
    return refused(question,
                   wire_error_make(WIRE_STATUS_BAD_VERSION, "version_max", "a range with 1 in it"));
  }
  const wire_hello_reply reply = describe_daemon(question->server);
  uint8_t *at = begin_reply(question, WIRE_BYTES_hello_reply +
                                          reply.choice_count * (size_t)WIRE_BYTES_choice +
                                          reply.limit_count * (size_t)WIRE_BYTES_value);
  if (at == NULL) {
    return busy(question);
  }
  wire_put_hello_reply(at, &reply);
  at += WIRE_BYTES_hello_reply;
  for (uint32_t i = 0; i < reply.choice_count; i++) {
    const wire_choice choice = wire_choice_at(i);
    wire_put_choice(at, &choice);
    at += WIRE_BYTES_choice;
  }
  struct value_cursor limits = {at, 0};
  options_each_number(&question->server->options, put_value, &limits);
  output_commit(question->output);
  return ANSWERED;
}

static enum outcome answer_again(struct question *question, const struct repeat_entry *entry) {
  struct job_scratch *scratch = question->place->scratch;
  uint8_t *reply = begin_reply(question, entry->reply_bytes);
  if (reply == NULL) {
    return busy(question);
  }
  repeat_answer(entry, &scratch->batch, &question->server->stats, question->payload, scratch->radii,
                reply);
  output_commit(question->output);
  return ANSWERED;
}

/* Starts a job that has been checked, if there is nothing wrong with it. */
static enum outcome start_job(struct question *question, wire_error error) {
  struct job *job = question->place->job;
  if (error.status == WIRE_STATUS_OK) {
    error = job_admit(job, question->server, question->place->scratch);
  }
  if (error.status != WIRE_STATUS_OK) {
    return refused(question, error);
  }
  uint8_t *reply = begin_reply(question, (size_t)job->layout.payload_bytes);
  if (reply == NULL) {
    backlog_forgive(&question->place->scratch->backlog, &job->share);
    return busy(question);
  }
  job_start(job, reply);
  return STARTED_JOB;
}

static enum outcome answer_EVAL(struct question *question) {
  const struct repeat_entry *entry = repeat_find(
      &question->place->scratch->repeat, question->payload, question->header->payload_bytes);
  if (entry != NULL) {
    return answer_again(question, entry);
  }
  return start_job(question, job_check(question->place->job, question->server, question->payload,
                                       question->header->payload_bytes));
}

static enum outcome answer_SAMPLE(struct question *question) {
  return start_job(question, job_check_sample(question->place->job, question->server,
                                              question->payload, question->header->payload_bytes));
}

/* Room for a list reply with count entries; NULL: none. */
static uint8_t *begin_list(struct question *question, size_t count, size_t entry_bytes) {
  uint8_t *at = begin_reply(question, WIRE_BYTES_list_reply + count * entry_bytes);
  if (at != NULL) {
    const wire_list_reply list = {.count = (uint32_t)count};
    wire_put_list_reply(at, &list);
    at += WIRE_BYTES_list_reply;
  }
  return at;
}

static enum outcome answer_MEDIA(struct question *question) {
  if (question->header->payload_bytes != 0) {
    return bad_length(question, "0");
  }
  uint8_t *at = begin_list(question, core_measured_media_count, WIRE_BYTES_measured_medium);
  if (at == NULL) {
    return busy(question);
  }
  for (size_t i = 0; i < core_measured_media_count; i++) {
    const core_measured_medium *medium = &core_measured_media[i];
    wire_measured_medium entry = {.g = medium->channel[0].g, .eta = medium->channel[0].eta};
    WIRE_SET_TEXT(entry.name, medium->name);
    for (int channel = 0; channel < 3; channel++) {
      entry.sigma_a[channel] = medium->channel[channel].sigma_a_per_mm;
      entry.sigma_s[channel] = medium->channel[channel].sigma_s_per_mm;
    }
    wire_put_measured_medium(at, &entry);
    at += WIRE_BYTES_measured_medium;
  }
  output_commit(question->output);
  return ANSWERED;
}

static void put_reported(void *context, const struct report_value *value) {
  if (value->name != NULL) {
    put_value(context, value->name, report_wire_value(value));
  }
}

static enum outcome answer_STATS(struct question *question) {
  if (question->header->payload_bytes != 0) {
    return bad_length(question, "0");
  }
  struct value_cursor cursor = {NULL, 0};
  report_each(NULL, put_reported, &cursor);
  cursor.at = begin_list(question, cursor.count, WIRE_BYTES_value);
  if (cursor.at == NULL) {
    return busy(question);
  }
  report_each(question->server, put_reported, &cursor);
  output_commit(question->output);
  return ANSWERED;
}

static enum outcome answer_PING(struct question *question) {
  const size_t bytes = question->header->payload_bytes;
  if (bytes > WIRE_PING_MAX_BYTES) {
    return bad_length(question, "at most 1024");
  }
  uint8_t *at = begin_reply(question, bytes);
  if (at == NULL) {
    return busy(question);
  }
  memcpy(at, question->payload, bytes);
  output_commit(question->output);
  return ANSWERED;
}

static enum outcome answer_MC(struct question *question) {
  const wire_error error = mc_desk_start(question->place->mc, question->header->request_id,
                                         question->payload, question->header->payload_bytes);
  return started(question, error, STARTED_MC);
}

static enum outcome answer_CANCEL(struct question *question) {
  if (question->header->payload_bytes != WIRE_BYTES_cancel_request) {
    return bad_length(question, "8");
  }
  uint8_t *at = begin_reply(question, WIRE_BYTES_cancel_reply);
  if (at == NULL) {
    return busy(question);
  }
  wire_cancel_request request;
  wire_get_cancel_request(question->payload, &request);
  const wire_cancel_reply reply = {
      .found = mc_desk_end(*question->place->mc->desk, request.job_id, MC_CANCELLED)};
  wire_put_cancel_reply(at, &reply);
  output_commit(question->output);
  return ANSWERED;
}

static enum outcome answer_TABLE(struct question *question) {
  const wire_error error =
      table_job_start(question->place->table, question->payload, question->header->payload_bytes);
  return started(question, error, STARTED_TABLE);
}

static enum outcome answer_INVERT(struct question *question) {
  struct invert_job *job = question->place->invert;
  struct backlog *backlog = &question->place->scratch->backlog;
  wire_error error =
      invert_job_check(job, question->server, question->payload, question->header->payload_bytes);
  if (error.status == WIRE_STATUS_OK) {
    error = invert_job_admit(job, question->server, backlog);
  }
  if (error.status != WIRE_STATUS_OK) {
    return refused(question, error);
  }
  uint8_t *reply = begin_reply(question, (size_t)invert_job_part_bytes(job));
  if (reply == NULL) {
    backlog_forgive(backlog, &job->share);
    return busy(question);
  }
  invert_job_start_part(job, reply);
  return STARTED_INVERT;
}

static void put_offers(uint8_t *at, const struct choice *choice, size_t taken) {
  const wire_offers_reply reply = {.count = (uint32_t)choice->count, .taken = (uint32_t)taken};
  wire_put_offers_reply(at, &reply);
  at += WIRE_BYTES_offers_reply;
  for (size_t i = 0; i < choice->count; i++) {
    const core_candidate *candidate = &choice->candidates[i];
    const wire_offer offer = {
        .model = (uint16_t)candidate->model,
        .evaluator = (uint16_t)candidate->evaluator,
        .meets = candidate->meets,
        .error = candidate->error,
        .numerical_error = candidate->numerical_error,
        .cost = candidate->cost_ns,
        .prepare_cost = candidate->prepare_ns,
    };
    wire_put_offer(at, &offer);
    at += WIRE_BYTES_offer;
  }
}

static enum outcome answer_OFFERS(struct question *question) {
  struct choice choice;
  const wire_error error =
      job_offers(question->server, question->payload, question->header->payload_bytes, &choice);
  if (error.status != WIRE_STATUS_OK) {
    return refused(question, error);
  }
  uint8_t *at =
      begin_reply(question, WIRE_BYTES_offers_reply + choice.count * (size_t)WIRE_BYTES_offer);
  if (at == NULL) {
    return busy(question);
  }
  const size_t taken = choice_sort_by_cost(&choice);
  put_offers(at, &choice, taken);
  output_commit(question->output);
  return ANSWERED;
}

static enum outcome answer(struct question *question) {
  switch (question->header->type) {
#define WIRE_MESSAGE(type, IDENT, name)                                                            \
  case type:                                                                                       \
    return answer_##IDENT(question);
#include "proto/messages.def"
  default:
    return refused(question,
                   wire_error_make(WIRE_STATUS_BAD_TYPE, "type", "a message of the protocol"));
  }
}

/* ---- public -----------------------------------------------------------------------------------
 */

bool request_refuse(struct server *server, uint64_t request_id, const wire_error *error,
                    struct output *output) {
  stats_count_answer(&server->stats, error->status);
  uint8_t *at = request_begin_frame(output, WIRE_TYPE_ERROR, request_id, WIRE_BYTES_error);
  if (at == NULL) {
    return false;
  }
  wire_put_error(at, error);
  output_commit(output);
  return true;
}

enum request_outcome request_begin(struct server *server, const wire_header *header,
                                   const uint8_t *payload, struct output *output,
                                   const struct request_place *place) {
  struct question question;
  question.server = server; /* not its error, which is large and hardly ever used */
  question.header = header;
  question.payload = payload;
  question.output = output;
  question.place = place;
  stats_count_request(&server->stats, header->type);
  switch (answer(&question)) {
  case STARTED_JOB:
    return REQUEST_STARTED;
  case STARTED_TABLE:
    return REQUEST_TABLE_STARTED;
  case STARTED_INVERT:
    return REQUEST_INVERT_STARTED;
  case ANSWERED:
    stats_count_answer(&server->stats, WIRE_STATUS_OK);
    return REQUEST_ANSWERED;
  case STARTED_MC:
    return REQUEST_BEGUN;
  case REFUSED:
    break;
  }
  return request_refuse(server, header->request_id, &question.error, output) ? REQUEST_REFUSED
                                                                             : REQUEST_NO_ROOM;
}
