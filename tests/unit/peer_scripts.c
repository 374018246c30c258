#include "tests/unit/peer_scripts.h"

#include <time.h>

#include "clients/c/request.h"
#include "tests/unit/unit.h"

void peer_receive_or_abort(int fd, peer_frame *request) {
  if (!peer_receive(fd, request)) {
    abort();
  }
}

void peer_say_hello_or_abort(int fd) {
  if (!peer_say_hello(fd)) {
    abort();
  }
}

void peer_send_error(int fd, uint64_t id, enum wire_status status, uint32_t retry_after_ms) {
  const wire_error error = {.status = (uint16_t)status, .retry_after_ms = retry_after_ms};
  uint8_t payload[WIRE_BYTES_error];
  wire_put_error(payload, &error);
  peer_send(fd, WIRE_TYPE_ERROR, id, payload, sizeof payload);
}

void peer_answer(int fd, const peer_frame *request) {
  uint8_t *payload;
  const size_t bytes = peer_evaluate(request, &payload);
  peer_send(fd, WIRE_TYPE_EVAL | WIRE_REPLY, request->header.request_id, payload, bytes);
  free(payload);
}

void peer_hang_up_at_once(int fd, void *context) {
  (void)fd;
  (void)context;
}

void peer_hang_up_after_hello(int fd, void *context) {
  (void)context;
  peer_say_hello_or_abort(fd);
}

void peer_hang_up_after_request(int fd, void *context) {
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  free(request.payload);
}

uint8_t *peer_make_answer(const peer_frame *request, size_t garbled, size_t *count) {
  uint8_t *payload;
  const size_t payload_bytes = peer_evaluate(request, &payload);
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = WIRE_TYPE_EVAL | WIRE_REPLY,
                              .request_id = request->header.request_id,
                              .payload_bytes = (uint32_t)payload_bytes};
  *count = WIRE_BYTES_header + payload_bytes;
  uint8_t *bytes = malloc(*count);
  if (bytes == NULL) {
    abort();
  }
  wire_put_header(bytes, &header);
  memcpy(bytes + WIRE_BYTES_header, payload, payload_bytes);
  if (garbled < payload_bytes) {
    memset(bytes + WIRE_BYTES_header + garbled, 0xff, payload_bytes - garbled);
  }
  free(payload);
  return bytes;
}

static uint64_t radii_of(const peer_frame *request) {
  wire_eval_request fixed;
  wire_get_eval_request(request->payload, &fixed);
  return fixed.radius_count;
}

uint32_t peer_parts_of(const peer_frame *request, uint64_t each) {
  const uint64_t count = radii_of(request);
  return count > each ? (uint32_t)((count + each - 1) / each) : 1;
}

bool peer_send_part(int fd, const peer_frame *request, uint32_t part, uint64_t each) {
  const uint64_t first = part * each, left = radii_of(request) - first;
  uint8_t *payload;
  const size_t bytes = peer_evaluate_part(request, first, left < each ? left : each, part,
                                          peer_parts_of(request, each), &payload);
  const bool good =
      peer_send(fd, WIRE_TYPE_EVAL | WIRE_REPLY, request->header.request_id, payload, bytes);
  free(payload);
  return good;
}

void peer_serve_parts(int fd, void *context) {
  const uint64_t each = *(const uint64_t *)context;
  peer_frame request;
  bool good = peer_say_hello(fd);
  while (good && peer_receive(fd, &request)) {
    for (uint32_t part = 0; good && part < peer_parts_of(&request, each); part++) {
      good = peer_send_part(fd, &request, part, each);
    }
    free(request.payload);
  }
}

void peer_hang_up_in_answer(int fd, void *context) {
  peer_frame request;
  size_t count;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  uint8_t *bytes = peer_make_answer(&request, 0, &count);
  peer_send_bytes(fd, bytes, *(const size_t *)context);
  free(bytes);
  free(request.payload);
}

void peer_be_full(int fd, void *context) {
  (void)context;
  peer_send_error(fd, 0, WIRE_STATUS_BUSY, 30);
}

void peer_accept_only(int fd, void *context) {
  peer_frame request;
  (void)context;
  while (peer_receive(fd, &request)) {
    free(request.payload);
  }
}

void peer_be_silent(int fd, void *context) {
  peer_say_hello_or_abort(fd);
  peer_accept_only(fd, context);
}

void peer_stay_busy(int fd, void *context) {
  peer_frame request;
  peer_say_hello_or_abort(fd);
  while (peer_receive(fd, &request)) {
    peer_send_error(fd, request.header.request_id, WIRE_STATUS_BUSY, *(const uint32_t *)context);
    free(request.payload);
  }
}

void peer_answer_seven(int fd, void *context) {
  (void)context;
  peer_say_hello_or_abort(fd);
  for (unsigned i = 0; i < 7; i++) {
    peer_frame request;
    peer_receive_or_abort(fd, &request);
    peer_answer(fd, &request);
    free(request.payload);
  }
}

void peer_must_not_come(int fd, void *context) {
  (void)fd;
  (void)context;
  abort();
}

void peer_serve_other_lists(int fd, void *context) {
  uint8_t payload[WIRE_BYTES_hello_reply + WIRE_BYTES_choice];
  wire_hello_reply reply = {.version = WIRE_VERSION,
                            .version_min = WIRE_VERSION,
                            .version_max = WIRE_VERSION,
                            .workers = 1,
                            .choice_count = 1};
  wire_choice model = {.kind = WIRE_CHOICE_MODEL, .id = 2};
  peer_frame request;
  (void)context;
  WIRE_SET_TEXT(model.name, "worse");
  wire_put_hello_reply(payload, &reply);
  wire_put_choice(payload + WIRE_BYTES_hello_reply, &model);
  peer_receive_or_abort(fd, &request);
  peer_send(fd, WIRE_TYPE_HELLO | WIRE_REPLY, request.header.request_id, payload, sizeof payload);
  free(request.payload);
  if (peer_receive(fd, &request)) {
    abort(); /* This peer has other lists, so no request of the client means the right thing. */
  }
}

/* ---- clients ------------------------------------------------------------------------------- */

dipole_options peer_options(void) {
  dipole_options options;
  dipole_options_init(&options);
  options.connect_timeout_ms = options.timeout_ms = options.retry_ms = PEER_PATIENCE_MS;
  return options;
}

dipole_client *peer_open(const char *address, const dipole_options *options) {
  const dipole_options usual = peer_options();
  dipole_client *client;
  dipole_error error;
  UNIT_FAIL_IF(!dipole_open_with(address, options != NULL ? options : &usual, &client, &error),
               "%s: %s", address, error.text);
  return client;
}

scripted_peer peer_of_test;

dipole_client *peer_begin(peer_script *script, void *context) {
  dipole_options options = peer_options();
  options.retry_ms = 0;
  return peer_begin_with(script, context, &options);
}

dipole_client *peer_begin_with(peer_script *script, void *context, const dipole_options *options) {
  peer_start(&peer_of_test, script, context);
  return peer_open(peer_of_test.address, options);
}

dipole_client *peer_begin_scripts(peer_script *const *scripts, void *context) {
  peer_start_scripts(&peer_of_test, scripts, context);
  return peer_open(peer_of_test.address, NULL);
}

void peer_finish(dipole_client *client) {
  if (client->pending_count == 0) { /* nothing is kept that could be sent again */
    assert_true(client->retry.kept_bytes == 0 && client->retry.later_count == 0);
  }
  dipole_close(client);
  peer_end(&peer_of_test);
}

void peer_expect(bool good, const dipole_error *error) {
  UNIT_FAIL_IF(!good, "%s", error->text);
}

dipole_result *peer_eval(dipole_client *client, const dipole_query *query) {
  dipole_result *result = NULL;
  dipole_error error;
  peer_expect(dipole_eval(client, query, &result, &error), &error);
  return result;
}

char *peer_list(const char *const *addresses, size_t count) {
  char *list = calloc(count, 128);
  assert_non_null(list);
  for (size_t i = 0; i < count; i++) {
    sprintf(list + strlen(list), "%s%s", i > 0 ? "," : "", addresses[i]);
  }
  return list;
}

int64_t peer_now_ms(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* ---- queries ------------------------------------------------------------------------------- */

double peer_radii_f64[PEER_RADII];
float peer_radii_f32[PEER_RADII];

void peer_make_radii(void) {
  for (size_t i = 0; i < PEER_RADII; i++) {
    peer_radii_f32[i] = (float)i / 8;
    peer_radii_f64[i] = (double)peer_radii_f32[i];
  }
}

const dipole_medium peer_media[2] = {{.sigma_a_per_mm = 0.25, .sigma_s_per_mm = 1, .eta = 1.3},
                                     {.sigma_a_per_mm = 0.5, .sigma_s_per_mm = 2, .eta = 1.3}};

dipole_query peer_query(uint64_t count) {
  return (dipole_query){.model = 2,
                        .evaluator = DIPOLE_F64,
                        .moments = DIPOLE_EXACT,
                        .wanted = DIPOLE_R | DIPOLE_ALBEDO,
                        .media = peer_media,
                        .medium_count = 1,
                        .spacing = DIPOLE_LIST,
                        .radii = peer_radii_f64,
                        .radius_count = count};
}

void peer_check_result(dipole_result *result, uint64_t count) {
  assert_int_equal(result->radius_count, count);
  assert_true(result->channels[0].albedo == 0.25);
  for (uint64_t i = 0; i < count; i++) {
    assert_true(result->channels[0].R_f64[i] == 2 * peer_radii_f64[i]);
  }
  dipole_result_free(result);
}

void peer_check_eval(dipole_client *client, uint64_t count) {
  const dipole_query query = peer_query(count);
  peer_check_result(peer_eval(client, &query), count);
}

dipole_error peer_check_failure(dipole_client *client, enum dipole_error_kind kind) {
  const dipole_query query = peer_query(5);
  dipole_result *result;
  dipole_error error;
  assert_false(dipole_eval(client, &query, &result, &error));
  assert_int_equal(error.kind, kind);
  return error;
}

uint64_t peer_submit(dipole_client *client, uint64_t count) {
  const dipole_query query = peer_query(count);
  dipole_error error;
  uint64_t id = 0;
  peer_expect(dipole_submit(client, &query, &id, &error), &error);
  assert_true(id != 0);
  return id;
}

void peer_check_each(dipole_client *client, uint64_t count) {
  uint64_t *ids = calloc(count + 1, sizeof *ids), id;
  dipole_result *result;
  dipole_error error;
  assert_non_null(ids);
  for (uint64_t i = 1; i <= count; i++) {
    ids[i] = peer_submit(client, i);
  }
  for (uint64_t k = 0; k < count; k++) {
    peer_expect(dipole_collect(client, &id, &result, &error), &error);
    uint64_t i = 1;
    while (i <= count && ids[i] != id) {
      i++;
    }
    assert_true(i <= count);
    ids[i] = 0; /* so that a second answer to this query is noticed */
    peer_check_result(result, i);
  }
  assert_false(dipole_collect(client, &id, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_ARGUMENT);
  assert_string_equal(error.text, "no query is outstanding");
  free(ids);
}
