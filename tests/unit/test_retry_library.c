/* libdipole when connections are lost and daemons are busy: what is asked again, what is not, and
 * that every query has one answer, the right one. */
#include <math.h>
#include <time.h>
#include <unistd.h>

#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

#define TIMEOUT_MS 20000 /* a test that would hang fails after this */

enum { RETRY_MS = 10000, RADII = 64 };

static const dipole_medium medium = {.sigma_a_per_mm = 0.25, .sigma_s_per_mm = 1, .eta = 1.3};
static double radii[RADII];

UNIT_SETUP(make_radii) {
  for (size_t i = 0; i < RADII; i++) {
    radii[i] = (double)i / 8;
  }
}

/* Queries differ in their number of radii, so that an answer to another one shows. */
static dipole_query query_of(uint64_t count) {
  return (dipole_query){.model = 2,
                        .evaluator = DIPOLE_F64,
                        .moments = DIPOLE_EXACT,
                        .wanted = DIPOLE_R | DIPOLE_ALBEDO,
                        .media = &medium,
                        .medium_count = 1,
                        .spacing = DIPOLE_LIST,
                        .radii = radii,
                        .radius_count = count};
}

static dipole_client *open_client(const scripted_peer *peer) {
  dipole_client *client;
  dipole_error error;
  if (!dipole_open_within(peer->address, TIMEOUT_MS, &client, &error)) {
    fail_msg("%s", error.text);
  }
  dipole_set_retry_ms(client, RETRY_MS);
  return client;
}

static void check_result(dipole_result *result, uint64_t count) {
  assert_int_equal(result->radius_count, count);
  assert_true(result->channels[0].albedo == 0.25);
  for (uint64_t i = 0; i < count; i++) {
    assert_true(result->channels[0].R_f64[i] == 2 * radii[i]);
  }
  dipole_result_free(result);
}

static void check_eval(dipole_client *client, uint64_t count) {
  const dipole_query query = query_of(count);
  dipole_result *result;
  dipole_error error;
  if (!dipole_eval(client, &query, &result, &error)) {
    fail_msg("%s", error.text);
  }
  check_result(result, count);
}

static dipole_error check_failure(dipole_client *client, enum dipole_error_kind kind) {
  const dipole_query query = query_of(5);
  dipole_result *result;
  dipole_error error;
  assert_false(dipole_eval(client, &query, &result, &error));
  assert_int_equal(error.kind, kind);
  return error;
}

static int64_t now_ms(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* ---- scripts ------------------------------------------------------------------------------- */

static void answer_seven(int fd, void *context) {
  (void)context;
  peer_say_hello_or_abort(fd);
  for (unsigned i = 0; i < 7; i++) {
    peer_frame request;
    peer_receive_or_abort(fd, &request);
    peer_answer(fd, &request);
    free(request.payload);
  }
}

static void shut_down(int fd, void *context) {
  peer_hang_up_after_request(fd, context);
  peer_send_error(fd, 0, WIRE_STATUS_SHUTTING_DOWN, 0);
}

static void break_rules(int fd, void *context) {
  peer_hang_up_after_request(fd, context);
  peer_send_error(fd, 0, WIRE_STATUS_BAD_MAGIC, 0);
}

/* ---- lost and found ------------------------------------------------------------------------ */

static void check_found(peer_script *const *scripts, void *context) {
  scripted_peer peer;
  peer_start_scripts(&peer, scripts, context);
  dipole_client *client = open_client(&peer);
  check_eval(client, 5);
  check_eval(client, 6);
  dipole_close(client);
  peer_end(&peer);
}

UNIT_TEST(test_lost_before_the_answer) {
  check_found((peer_script *const[]){peer_hang_up_after_request, peer_serve, NULL}, NULL);
}

UNIT_TEST(test_lost_while_nothing_was_asked) {
  check_found((peer_script *const[]){peer_hang_up_after_hello, peer_serve, NULL}, NULL);
}

UNIT_TEST(test_lost_anywhere_in_the_answer) {
  static const size_t sent[] = {1, 23, 24, 25, 100, 135};
  for (size_t i = 0; i < sizeof sent / sizeof sent[0]; i++) {
    size_t bytes = sent[i];
    check_found((peer_script *const[]){peer_hang_up_in_answer, peer_serve, NULL}, &bytes);
  }
}

UNIT_TEST(test_lost_again_and_again) {
  check_found((peer_script *const[]){peer_hang_up_after_request, peer_hang_up_at_once,
                                     peer_hang_up_after_request, peer_hang_up_after_hello,
                                     peer_hang_up_at_once, peer_serve, NULL},
              NULL);
}

UNIT_TEST(test_daemon_that_shuts_down) {
  check_found((peer_script *const[]){shut_down, peer_serve, NULL}, NULL);
}

UNIT_TEST(test_daemon_with_too_many_connections) {
  check_found((peer_script *const[]){peer_hang_up_after_request, peer_be_full, peer_serve, NULL},
              NULL);
}

UNIT_TEST(test_each_submitted_query_has_one_answer) {
  enum { QUERIES = 20 };
  peer_script *const scripts[] = {answer_seven, answer_seven, peer_serve, NULL};
  uint64_t ids[QUERIES + 1] = {0};
  scripted_peer peer;
  dipole_error error;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer);
  for (uint64_t i = 1; i <= QUERIES; i++) {
    const dipole_query query = query_of(i);
    assert_true(dipole_submit(client, &query, &ids[i], &error));
  }
  for (unsigned k = 0; k < QUERIES; k++) {
    uint64_t id;
    dipole_result *result;
    if (!dipole_collect(client, &id, &result, &error)) {
      fail_msg("%s", error.text);
    }
    uint64_t i = 1;
    while (i <= QUERIES && ids[i] != id) {
      i++;
    }
    assert_true(i <= QUERIES);
    ids[i] = 0; /* it does not come a second time */
    check_result(result, i);
  }
  uint64_t id;
  dipole_result *result;
  assert_false(dipole_collect(client, &id, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_ARGUMENT);
  dipole_close(client);
  peer_end(&peer);
}

/* ---- what is not tried again --------------------------------------------------------------- */

/* The client fails, stays so, and no second connection is made: the next script aborts. */
static void must_not_come(int fd, void *context) {
  (void)fd;
  (void)context;
  abort();
}

UNIT_TEST(test_none_wanted) {
  peer_script *const scripts[] = {peer_hang_up_after_request, must_not_come, NULL};
  scripted_peer peer;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer);
  dipole_set_retry_ms(client, 0);
  check_failure(client, DIPOLE_ERROR_CONNECTION);
  check_failure(client, DIPOLE_ERROR_CONNECTION);
  dipole_close(client);
  peer_end(&peer);
}

UNIT_TEST(test_a_fault_of_the_client_is_none_of_the_connection) {
  peer_script *const scripts[] = {break_rules, must_not_come, NULL};
  scripted_peer peer;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer);
  assert_int_equal(check_failure(client, DIPOLE_ERROR_CONNECTION).status, WIRE_STATUS_BAD_MAGIC);
  dipole_close(client);
  peer_end(&peer);
}

static void stay_silent(int fd, void *context) {
  peer_frame request;
  peer_hang_up_after_request(fd, context);
  if (peer_receive(fd, &request)) { /* until the client closes */
    abort();
  }
}

UNIT_TEST(test_a_silent_daemon_is_not_asked_again) {
  peer_script *const scripts[] = {stay_silent, must_not_come, NULL};
  scripted_peer peer;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer);
  dipole_set_timeout_ms(client, 50);
  check_failure(client, DIPOLE_ERROR_CONNECTION);
  dipole_close(client);
  peer_end(&peer);
}

UNIT_TEST(test_nobody_comes_back) {
  peer_script *const scripts[] = {peer_hang_up_after_request, NULL};
  scripted_peer peer;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer);
  dipole_set_retry_ms(client, 200);
  const int64_t start_ms = now_ms();
  const dipole_error error = check_failure(client, DIPOLE_ERROR_CONNECTION);
  assert_non_null(strstr(error.text, "connecting again failed"));
  assert_true(now_ms() - start_ms < 5000);
  check_failure(client, DIPOLE_ERROR_CONNECTION);
  dipole_close(client);
  peer_end(&peer);
}

/* A daemon whose model 2 is called otherwise. */
static void serve_other_lists(int fd, void *context) {
  uint8_t payload[WIRE_BYTES_hello_reply + WIRE_BYTES_choice];
  wire_hello_reply reply = {
      .version = 1, .version_min = 1, .version_max = 1, .workers = 1, .choice_count = 1};
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
    abort(); /* whatever it is, it has another meaning here */
  }
}

UNIT_TEST(test_a_daemon_with_other_lists_is_another) {
  peer_script *const scripts[] = {peer_hang_up_after_request, serve_other_lists, NULL};
  scripted_peer peer;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer);
  const dipole_error error = check_failure(client, DIPOLE_ERROR_CONNECTION);
  assert_non_null(strstr(error.text, "other lists"));
  dipole_close(client);
  peer_end(&peer);
}

UNIT_TEST(test_a_job_is_not_begun_again) {
  peer_script *const scripts[] = {peer_hang_up_after_request, must_not_come, NULL};
  const dipole_mc_query query = {.medium = medium,
                                 .thickness_mm = INFINITY,
                                 .spacing = DIPOLE_LINEAR,
                                 .ring_count = 4,
                                 .radius_stop_mm = 4,
                                 .photons = 1000};
  scripted_peer peer;
  dipole_mc_result *result;
  dipole_error error;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer);
  assert_false(dipole_mc(client, &query, NULL, NULL, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_CONNECTION);
  dipole_close(client);
  peer_end(&peer);
}

UNIT_TEST(test_what_is_too_large_to_keep) {
  peer_script *const scripts[] = {peer_hang_up_after_hello, must_not_come, NULL};
  const uint64_t count = DIPOLE_RETRY_KEPT_BYTES / sizeof(double);
  double *many = calloc(count, sizeof *many);
  dipole_query query = query_of(count);
  dipole_result *result;
  dipole_error error;
  scripted_peer peer;
  assert_non_null(many);
  query.radii = many;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer);
  assert_false(dipole_eval(client, &query, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_CONNECTION);
  dipole_close(client);
  peer_end(&peer);
  free(many);
}

/* ---- busy ---------------------------------------------------------------------------------- */

/* Refuses each request twice; *context counts what it received. */
static void serve_the_third_time(int fd, void *context) {
  unsigned *received = context;
  peer_frame request;
  peer_say_hello_or_abort(fd);
  while (peer_receive(fd, &request)) {
    if (++*received % 3 != 0) {
      peer_send_error(fd, request.header.request_id, WIRE_STATUS_BUSY, 20);
    } else {
      peer_answer(fd, &request);
    }
    free(request.payload);
  }
}

UNIT_TEST(test_busy) {
  peer_script *const scripts[] = {serve_the_third_time, must_not_come, NULL};
  unsigned received = 0;
  scripted_peer peer;
  peer_start_scripts(&peer, scripts, &received);
  dipole_client *client = open_client(&peer);
  const int64_t start_ms = now_ms();
  check_eval(client, 5);
  assert_true(now_ms() - start_ms >= 40);
  check_eval(client, 6);
  dipole_close(client);
  peer_end(&peer);
  assert_int_equal(received, 6);
}

/* Refuses the second of three requests at first. */
static void serve_out_of_turn(int fd, void *context) {
  unsigned received = 0;
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  while (peer_receive(fd, &request)) {
    if (++received == 2) {
      peer_send_error(fd, request.header.request_id, WIRE_STATUS_BUSY, 50);
    } else {
      peer_answer(fd, &request);
    }
    free(request.payload);
  }
}

UNIT_TEST(test_others_do_not_wait_for_the_busy_one) {
  peer_script *const scripts[] = {serve_out_of_turn, NULL};
  static const unsigned order[] = {0, 2, 1};
  uint64_t ids[3];
  scripted_peer peer;
  dipole_error error;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer);
  for (unsigned i = 0; i < 3; i++) {
    const dipole_query query = query_of(i + 1);
    assert_true(dipole_submit(client, &query, &ids[i], &error));
  }
  for (unsigned i = 0; i < 3; i++) {
    uint64_t id;
    dipole_result *result;
    assert_true(dipole_collect(client, &id, &result, &error));
    assert_true(id == ids[order[i]]);
    check_result(result, order[i] + 1);
  }
  dipole_close(client);
  peer_end(&peer);
}

/* *context: retry_after_ms. */
static void stay_busy(int fd, void *context) {
  peer_frame request;
  peer_say_hello_or_abort(fd);
  while (peer_receive(fd, &request)) {
    peer_send_error(fd, request.header.request_id, WIRE_STATUS_BUSY, *(const uint32_t *)context);
    free(request.payload);
  }
}

UNIT_TEST(test_busy_for_longer_than_that) {
  static const uint32_t retry_after_ms[] = {0, 1, 60, 60000};
  for (size_t i = 0; i < 4; i++) {
    peer_script *const scripts[] = {stay_busy, NULL};
    uint32_t after_ms = retry_after_ms[i];
    scripted_peer peer;
    peer_start_scripts(&peer, scripts, &after_ms);
    dipole_client *client = open_client(&peer);
    dipole_set_retry_ms(client, 100);
    const int64_t start_ms = now_ms();
    const dipole_error error = check_failure(client, DIPOLE_ERROR_REFUSED);
    assert_true(now_ms() - start_ms < 5000);
    assert_int_equal(error.status, WIRE_STATUS_BUSY);
    assert_int_equal(error.retry_after_ms, after_ms);
    check_failure(client, DIPOLE_ERROR_REFUSED); /* it goes on working */
    dipole_close(client);
    peer_end(&peer);
  }
}

static void be_busy_and_hang_up(int fd, void *context) {
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  peer_send_error(fd, request.header.request_id, WIRE_STATUS_BUSY, 100);
  free(request.payload);
}

UNIT_TEST(test_lost_while_waiting) {
  check_found((peer_script *const[]){be_busy_and_hang_up, peer_serve, NULL}, NULL);
}

/* ---- deadlines ----------------------------------------------------------------------------- */

static void hang_up_after_a_while(int fd, void *context) {
  peer_hang_up_after_request(fd, context);
  usleep(50000);
}

/* *context: the deadline that arrives. */
static void note_deadline(int fd, void *context) {
  peer_frame request;
  peer_say_hello_or_abort(fd);
  if (peer_receive(fd, &request)) {
    *(uint32_t *)context = request.header.deadline_ms;
    peer_answer(fd, &request);
    free(request.payload);
  }
}

UNIT_TEST(test_deadlines_go_on) {
  peer_script *const scripts[] = {hang_up_after_a_while, note_deadline, NULL};
  uint32_t left_ms = 0;
  dipole_query query = query_of(9);
  scripted_peer peer;
  dipole_result *result;
  dipole_error error;
  query.deadline_ms = 15000;
  peer_start_scripts(&peer, scripts, &left_ms);
  dipole_client *client = open_client(&peer);
  assert_true(dipole_eval(client, &query, &result, &error));
  check_result(result, 9);
  dipole_close(client);
  peer_end(&peer);
  assert_in_range(left_ms, 1, 14960);
}

UNIT_TEST(test_deadlines_end) {
  peer_script *const scripts[] = {hang_up_after_a_while, peer_serve, NULL};
  dipole_query query = query_of(9);
  scripted_peer peer;
  dipole_result *result;
  dipole_error error;
  query.deadline_ms = 20;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer);
  assert_false(dipole_eval(client, &query, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_REFUSED);
  assert_int_equal(error.status, WIRE_STATUS_DEADLINE);
  assert_string_equal(error.field, "deadline_ms");
  check_eval(client, 5);
  dipole_close(client);
  peer_end(&peer);
}

/* ---- parts --------------------------------------------------------------------------------- */

/* Three of the parts of eight radii each, or none; then the whole with other parts. */
static void send_parts(int fd, const peer_frame *request, uint32_t count, uint64_t each) {
  for (uint32_t part = 0; part < count; part++) {
    uint8_t *payload;
    const size_t bytes =
        peer_evaluate_part(request, part * each, each, part, (uint32_t)(RADII / each), &payload);
    peer_send(fd, WIRE_TYPE_EVAL | WIRE_REPLY, request->header.request_id, payload, bytes);
    free(payload);
  }
}

static void send_three_parts(int fd, void *context) {
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  send_parts(fd, &request, 3, 8);
  free(request.payload);
}

static void send_other_parts(int fd, void *context) {
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  while (peer_receive(fd, &request)) {
    send_parts(fd, &request, 4, 16);
    free(request.payload);
  }
}

UNIT_TEST(test_parts_are_put_together_anew) {
  peer_script *const scripts[] = {send_three_parts, send_other_parts, NULL};
  scripted_peer peer;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer);
  check_eval(client, RADII);
  dipole_close(client);
  peer_end(&peer);
}

static bool read_part(void *context, const dipole_result *part, uint64_t radius_first) {
  uint64_t *read = context;
  assert_int_equal(radius_first, *read);
  for (uint64_t i = 0; i < part->radius_count; i++) {
    assert_true(part->channels[0].R_f64[i] == 2 * radii[radius_first + i]);
  }
  *read += part->radius_count;
  return true;
}

UNIT_TEST(test_parts_are_not_handed_on_twice) {
  peer_script *const lost_at_first[] = {peer_hang_up_after_request, send_other_parts, NULL};
  peer_script *const lost_in_between[] = {send_three_parts, must_not_come, NULL};
  const dipole_query query = query_of(RADII);
  scripted_peer peer;
  dipole_error error;
  uint64_t read = 0;
  peer_start_scripts(&peer, lost_at_first, NULL);
  dipole_client *client = open_client(&peer);
  assert_true(dipole_eval_parts(client, &query, read_part, &read, &error));
  assert_int_equal(read, RADII);
  dipole_close(client);
  peer_end(&peer);

  read = 0;
  peer_start_scripts(&peer, lost_in_between, NULL);
  client = open_client(&peer);
  assert_false(dipole_eval_parts(client, &query, read_part, &read, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_CONNECTION);
  assert_int_equal(read, 24);
  dipole_close(client);
  peer_end(&peer);
}
