/* libdipole with many queries under way: answers in any order, how many may be outstanding, and
 * calls that are limited in time. */
#include <unistd.h>

#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

enum { RADII = 64, QUERIES = 40, PATIENCE_MS = 20000 };

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

static dipole_options options_of(void) {
  dipole_options options;
  dipole_options_init(&options);
  options.connect_timeout_ms = options.timeout_ms = options.retry_ms = PATIENCE_MS;
  return options;
}

static dipole_client *open_client(const scripted_peer *peer, const dipole_options *options) {
  dipole_client *client;
  dipole_error error;
  if (!dipole_open_with(peer->address, options, &client, &error)) {
    fail_msg("%s", error.text);
  }
  return client;
}

static void check_result(dipole_result *result, uint64_t count) {
  assert_int_equal(result->radius_count, count);
  for (uint64_t i = 0; i < count; i++) {
    assert_true(result->channels[0].R_f64[i] == 2 * radii[i]);
  }
  dipole_result_free(result);
}

static uint64_t submit(dipole_client *client, uint64_t count) {
  const dipole_query query = query_of(count);
  dipole_error error;
  uint64_t id = 0;
  if (!dipole_submit(client, &query, &id, &error)) {
    fail_msg("%s", error.text);
  }
  assert_true(id != 0);
  return id;
}

static void collect_id(dipole_client *client, uint64_t id, uint64_t count) {
  dipole_result *result;
  dipole_error error;
  if (!dipole_collect_id(client, id, &result, &error)) {
    fail_msg("%s", error.text);
  }
  check_result(result, count);
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

static void fail_eval(dipole_client *client, enum dipole_error_kind kind) {
  const dipole_query query = query_of(5);
  dipole_result *result;
  dipole_error error;
  assert_false(dipole_eval(client, &query, &result, &error));
  assert_int_equal(error.kind, kind);
}

static void fail_collect_id(dipole_client *client, uint64_t id, enum dipole_error_kind kind) {
  dipole_result *result;
  dipole_error error;
  assert_false(dipole_collect_id(client, id, &result, &error));
  assert_int_equal(error.kind, kind);
}

/* ---- in any order -------------------------------------------------------------------------- */

UNIT_TEST(test_by_id_in_any_order) {
  uint64_t ids[QUERIES];
  scripted_peer peer;
  peer_start(&peer, peer_serve, NULL);
  dipole_client *client = open_client(&peer, NULL);
  for (uint64_t i = 0; i < QUERIES; i++) {
    ids[i] = submit(client, i + 1);
  }
  assert_int_equal(dipole_outstanding(client), QUERIES);
  for (uint64_t k = 0; k < QUERIES; k++) {
    const uint64_t i = k * 27 % QUERIES; /* all of them: 27 and 40 have no common factor */
    collect_id(client, ids[i], i + 1);
    assert_int_equal(dipole_outstanding(client), QUERIES - k - 1);
    fail_collect_id(client, ids[i], DIPOLE_ERROR_ARGUMENT); /* it does not come twice */
  }
  fail_collect_id(client, 0, DIPOLE_ERROR_ARGUMENT);
  fail_collect_id(client, UINT64_MAX, DIPOLE_ERROR_ARGUMENT);
  check_eval(client, 7);
  dipole_close(client);
  peer_end(&peer);
}

/* By id and whatever comes, in turns. */
UNIT_TEST(test_both_ways) {
  uint64_t ids[QUERIES];
  scripted_peer peer;
  dipole_result *result;
  dipole_error error;
  peer_start(&peer, peer_serve, NULL);
  dipole_client *client = open_client(&peer, NULL);
  for (uint64_t i = 0; i < QUERIES; i++) {
    ids[i] = submit(client, i + 1);
  }
  for (uint64_t last = QUERIES; last > 0 && dipole_outstanding(client) > 0; last--) {
    collect_id(client, ids[last - 1], last);
    uint64_t id = 0;
    assert_true(dipole_collect(client, &id, &result, &error));
    assert_true(id == ids[QUERIES - last]); /* the peer keeps to the order */
    check_result(result, QUERIES - last + 1);
  }
  dipole_close(client);
  peer_end(&peer);
}

/* ---- how many ------------------------------------------------------------------------------ */

UNIT_TEST(test_no_more_than_may_be_outstanding) {
  enum { MOST = 3 };
  dipole_options options = options_of();
  uint64_t ids[MOST], id = 0;
  scripted_peer peer;
  dipole_error error;
  options.in_flight_max = MOST;
  peer_start(&peer, peer_serve, NULL);
  dipole_client *client = open_client(&peer, &options);
  for (uint64_t i = 0; i < MOST; i++) {
    ids[i] = submit(client, i + 1);
  }
  for (unsigned again = 0; again < 2; again++) {
    const dipole_query query = query_of(9);
    assert_false(dipole_submit(client, &query, &id, &error));
    assert_int_equal(error.kind, DIPOLE_ERROR_FULL);
  }
  check_eval(client, 11); /* one that is waited for is none of them */
  assert_int_equal(dipole_outstanding(client), MOST);
  collect_id(client, ids[1], 2);
  const uint64_t next = submit(client, 9);
  collect_id(client, next, 9);
  collect_id(client, ids[2], 3);
  collect_id(client, ids[0], 1);
  dipole_close(client);
  peer_end(&peer);
}

UNIT_TEST(test_as_many_as_one_likes) {
  enum { MANY = DIPOLE_IN_FLIGHT_MAX + 100 };
  dipole_options options = options_of();
  scripted_peer peer;
  options.in_flight_max = 0;
  peer_start(&peer, peer_serve, NULL);
  dipole_client *client = open_client(&peer, &options);
  const uint64_t first = submit(client, 1);
  for (unsigned i = 1; i < MANY; i++) {
    assert_true(submit(client, 1 + i % RADII) == first + i);
  }
  for (unsigned i = MANY; i > 0; i--) {
    collect_id(client, first + i - 1, 1 + (i - 1) % RADII);
  }
  dipole_close(client);
  peer_end(&peer);
}

/* ---- sent at once -------------------------------------------------------------------------- */

enum { BURST = 30 };

/* Says so on a pipe when all of a burst are here. */
static void note_burst(int fd, void *context) {
  const int *pipe_ends = context;
  peer_say_hello_or_abort(fd);
  for (unsigned i = 0; i < BURST; i++) {
    peer_frame request;
    peer_receive_or_abort(fd, &request);
    free(request.payload);
  }
  if (write(pipe_ends[1], "!", 1) != 1) {
    abort();
  }
}

UNIT_TEST(test_flush) {
  int pipe_ends[2];
  scripted_peer peer;
  char byte;
  assert_int_equal(pipe(pipe_ends), 0);
  peer_start(&peer, note_burst, pipe_ends);
  dipole_client *client = open_client(&peer, NULL);
  for (unsigned i = 0; i < BURST; i++) {
    submit(client, 1 + i);
  }
  dipole_flush(client);
  assert_int_equal(read(pipe_ends[0], &byte, 1), 1); /* and nothing else is called */
  dipole_close(client);
  peer_end(&peer);
  close(pipe_ends[0]);
  close(pipe_ends[1]);
}

/* ---- calls that take too long -------------------------------------------------------------- */

/* Answers a request only when the next one is there. */
static void serve_one_behind(int fd, void *context) {
  peer_frame before, request;
  (void)context;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &before);
  while (peer_receive(fd, &request)) {
    peer_answer(fd, &before);
    free(before.payload);
    before = request;
  }
  free(before.payload);
}

UNIT_TEST(test_what_is_submitted_stays) {
  dipole_options options = options_of();
  scripted_peer peer;
  dipole_result *result;
  dipole_error error;
  uint64_t id;
  options.call_timeout_ms = 20;
  peer_start(&peer, serve_one_behind, NULL);
  dipole_client *client = open_client(&peer, &options);
  const uint64_t first = submit(client, 3);
  fail_collect_id(client, first, DIPOLE_ERROR_TIMEOUT);
  assert_false(dipole_collect(client, &id, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_TIMEOUT);
  assert_string_equal(error.text, "the call took longer than 20 ms");
  assert_int_equal(dipole_outstanding(client), 1);
  dipole_set_call_timeout_ms(client, 0);
  const uint64_t second = submit(client, 4);
  collect_id(client, first, 3);
  submit(client, 5);
  collect_id(client, second, 4);
  dipole_close(client); /* with one outstanding */
  peer_end(&peer);
}

UNIT_TEST(test_what_nobody_waits_for_is_thrown_away) {
  dipole_options options = options_of();
  scripted_peer peer;
  options.call_timeout_ms = 20;
  peer_start(&peer, serve_one_behind, NULL);
  dipole_client *client = open_client(&peer, &options);
  for (unsigned i = 0; i < 3; i++) {
    fail_eval(client, DIPOLE_ERROR_TIMEOUT);
  }
  assert_int_equal(dipole_outstanding(client), 0);
  dipole_set_call_timeout_ms(client, 0);
  const uint64_t id = submit(client, 9);
  submit(client, 10);
  collect_id(client, id, 9);
  dipole_close(client);
  peer_end(&peer);
}

static void be_silent(int fd, void *context) {
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  while (peer_receive(fd, &request)) {
    free(request.payload);
  }
}

/* Silence is as long as it is, however short the calls. */
UNIT_TEST(test_silence_counts_over_calls) {
  dipole_options options = options_of();
  scripted_peer peer;
  unsigned calls = 0;
  dipole_error error;
  options.call_timeout_ms = 20;
  options.timeout_ms = 90;
  peer_start(&peer, be_silent, NULL);
  dipole_client *client = open_client(&peer, &options);
  while (!dipole_ping(client, &error) && error.kind == DIPOLE_ERROR_TIMEOUT && calls < 100) {
    calls++;
  }
  assert_int_equal(error.kind, DIPOLE_ERROR_CONNECTION);
  assert_string_equal(error.text, "the daemon was silent for 90 ms: gave up");
  assert_in_range(calls, 2, 99);
  dipole_close(client);
  peer_end(&peer);
}

/* Accepts, and says nothing. */
static void accept_only(int fd, void *context) {
  peer_frame request;
  (void)context;
  while (peer_receive(fd, &request)) {
    free(request.payload);
  }
}

/* A call ends while the connection is being restored; the next one goes on with that. */
UNIT_TEST(test_reconnecting_takes_no_longer) {
  peer_script *const scripts[] = {peer_hang_up_after_request, accept_only, peer_serve, NULL};
  dipole_options options = options_of();
  scripted_peer peer;
  options.call_timeout_ms = 100;
  peer_start_scripts(&peer, scripts, NULL);
  dipole_client *client = open_client(&peer, &options);
  const uint64_t id = submit(client, 6);
  fail_collect_id(client, id, DIPOLE_ERROR_TIMEOUT);
  dipole_set_call_timeout_ms(client, 0);
  check_eval(client, 5);
  collect_id(client, id, 6);
  dipole_close(client);
  peer_end(&peer);
}

static void stay_busy(int fd, void *context) {
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  while (peer_receive(fd, &request)) {
    peer_send_error(fd, request.header.request_id, WIRE_STATUS_BUSY, 5000);
    free(request.payload);
  }
}

UNIT_TEST(test_busy_takes_no_longer) {
  dipole_options options = options_of();
  scripted_peer peer;
  options.call_timeout_ms = 50;
  peer_start(&peer, stay_busy, NULL);
  dipole_client *client = open_client(&peer, &options);
  fail_eval(client, DIPOLE_ERROR_TIMEOUT);
  fail_eval(client, DIPOLE_ERROR_TIMEOUT);
  assert_int_equal(dipole_outstanding(client), 0);
  dipole_close(client);
  peer_end(&peer);
}
