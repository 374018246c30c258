/* libdipole with many outstanding queries: answers in any order, the limit of their number, and
 * time limits of calls. */
#include <unistd.h>

#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

enum { QUERIES = 40 };

UNIT_SETUP(make_radii) {
  peer_make_radii();
}

static void collect_id(dipole_client *client, uint64_t id, uint64_t count) {
  dipole_result *result;
  dipole_error error;
  peer_expect(dipole_collect_id(client, id, &result, &error), &error);
  peer_check_result(result, count);
}

static void fail_collect_id(dipole_client *client, uint64_t id, const char *why) {
  dipole_result *result;
  dipole_error error;
  assert_false(dipole_collect_id(client, id, &result, &error));
  assert_true(error.kind == DIPOLE_ERROR_ARGUMENT || error.kind == DIPOLE_ERROR_TIMEOUT);
  assert_string_equal(error.text, why);
}

/* ---- in any order -------------------------------------------------------------------------- */

UNIT_TEST(test_by_id_in_any_order) {
  static const char none[] = "no query with this id is outstanding";
  uint64_t ids[QUERIES];
  dipole_client *client = peer_begin_with(peer_serve, NULL, NULL);
  for (uint64_t i = 0; i < QUERIES; i++) {
    ids[i] = peer_submit(client, i + 1);
  }
  assert_int_equal(dipole_outstanding(client), QUERIES);
  for (uint64_t k = 0; k < QUERIES; k++) {
    const uint64_t i = k * 27 % QUERIES; /* visits all: 27 and 40 have no common factor */
    collect_id(client, ids[i], i + 1);
    assert_int_equal(dipole_outstanding(client), QUERIES - k - 1);
    fail_collect_id(client, ids[i], none); /* The result comes only once. */
  }
  fail_collect_id(client, 0, "no query has the id 0: take the id that dipole_submit() gave");
  fail_collect_id(client, UINT64_MAX, none);
  peer_check_eval(client, 7);
  peer_finish(client);
}

/* The client collects alternately by id and in the order of arrival. */
UNIT_TEST(test_both_ways) {
  uint64_t ids[QUERIES];
  dipole_result *result;
  dipole_error error;
  dipole_client *client = peer_begin_with(peer_serve, NULL, NULL);
  for (uint64_t i = 0; i < QUERIES; i++) {
    ids[i] = peer_submit(client, i + 1);
  }
  for (uint64_t last = QUERIES; last > 0 && dipole_outstanding(client) > 0; last--) {
    collect_id(client, ids[last - 1], last);
    uint64_t id = 0;
    assert_true(dipole_collect(client, &id, &result, &error));
    assert_true(id == ids[QUERIES - last]); /* The peer answers in order. */
    peer_check_result(result, QUERIES - last + 1);
  }
  peer_finish(client);
}

/* ---- limits -------------------------------------------------------------------------------- */

UNIT_TEST(test_no_more_than_may_be_outstanding) {
  enum { MOST = 3 };
  dipole_options options = peer_options();
  uint64_t ids[MOST], id = 0;
  dipole_error error;
  options.in_flight_max = MOST;
  dipole_client *client = peer_begin_with(peer_serve, NULL, &options);
  for (uint64_t i = 0; i < MOST; i++) {
    ids[i] = peer_submit(client, i + 1);
  }
  for (unsigned again = 0; again < 2; again++) {
    const dipole_query query = peer_query(9);
    assert_false(dipole_submit(client, &query, &id, &error));
    assert_int_equal(error.kind, DIPOLE_ERROR_FULL);
    assert_string_equal(error.text, "3 queries are outstanding, and no more may be: collect first");
  }
  peer_check_eval(client, 11); /* dipole_eval() does not count in the limit. */
  assert_int_equal(dipole_outstanding(client), MOST);
  collect_id(client, ids[1], 2);
  const uint64_t next = peer_submit(client, 9);
  collect_id(client, next, 9);
  collect_id(client, ids[2], 3);
  collect_id(client, ids[0], 1);
  peer_finish(client);
}

UNIT_TEST(test_as_many_as_one_likes) {
  enum { MANY = DIPOLE_IN_FLIGHT_MAX + 100 };
  dipole_options options = peer_options();
  options.in_flight_max = 0;
  dipole_client *client = peer_begin_with(peer_serve, NULL, &options);
  const uint64_t first = peer_submit(client, 1);
  for (unsigned i = 1; i < MANY; i++) {
    assert_true(peer_submit(client, 1 + i % 64) == first + i);
  }
  for (unsigned i = MANY; i > 0; i--) {
    collect_id(client, first + i - 1, 1 + (i - 1) % 64);
  }
  peer_finish(client);
}

/* ---- sent at once -------------------------------------------------------------------------- */

enum { BURST = 30 };

/* A script that writes to a pipe when all requests of a burst have arrived. */
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
  char byte;
  assert_int_equal(pipe(pipe_ends), 0);
  dipole_client *client = peer_begin_with(note_burst, pipe_ends, NULL);
  for (unsigned i = 0; i < BURST; i++) {
    peer_submit(client, 1 + i);
  }
  dipole_flush(client);
  assert_int_equal(read(pipe_ends[0], &byte, 1), 1); /* without another call of the library */
  peer_finish(client);
  close(pipe_ends[0]);
  close(pipe_ends[1]);
}

/* ---- calls that take too long -------------------------------------------------------------- */

/* A script that answers a request only when the next one has arrived. */
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
  dipole_options options = peer_options();
  dipole_result *result;
  dipole_error error;
  uint64_t id;
  options.call_timeout_ms = 20;
  dipole_client *client = peer_begin_with(serve_one_behind, NULL, &options);
  const uint64_t first = peer_submit(client, 3);
  fail_collect_id(client, first, "the call took longer than 20 ms");
  assert_false(dipole_collect(client, &id, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_TIMEOUT);
  assert_string_equal(error.text, "the call took longer than 20 ms");
  assert_int_equal(dipole_outstanding(client), 1);
  dipole_set_call_timeout_ms(client, 0);
  const uint64_t second = peer_submit(client, 4);
  collect_id(client, first, 3);
  peer_submit(client, 5);
  collect_id(client, second, 4);
  dipole_close(client); /* while one query is outstanding */
  peer_end(&peer_of_test);
}

UNIT_TEST(test_what_nobody_waits_for_is_thrown_away) {
  dipole_options options = peer_options();
  options.call_timeout_ms = 20;
  dipole_client *client = peer_begin_with(serve_one_behind, NULL, &options);
  for (unsigned i = 0; i < 3; i++) {
    peer_check_failure(client, DIPOLE_ERROR_TIMEOUT);
  }
  assert_int_equal(dipole_outstanding(client), 0);
  dipole_set_call_timeout_ms(client, 0);
  const uint64_t id = peer_submit(client, 9);
  peer_submit(client, 10);
  collect_id(client, id, 9);
  peer_finish(client);
}

/* The silence of a daemon counts across calls, even if each call is short. */
UNIT_TEST(test_silence_counts_over_calls) {
  dipole_options options = peer_options();
  unsigned calls = 0;
  dipole_error error;
  options.call_timeout_ms = 20;
  options.timeout_ms = 600;
  dipole_client *client = peer_begin_with(peer_be_silent, NULL, &options);
  while (!dipole_ping(client, &error) && error.kind == DIPOLE_ERROR_TIMEOUT && calls < 100) {
    calls++;
  }
  assert_int_equal(error.kind, DIPOLE_ERROR_CONNECTION);
  assert_string_equal(error.text, "the daemon was silent for 600 ms: gave up");
  assert_in_range(calls, 2, 99);
  peer_finish(client);
}

/* A call ends in time while the client reconnects, and the next call goes on reconnecting. */
UNIT_TEST(test_reconnecting_takes_no_longer) {
  peer_script *const scripts[] = {peer_hang_up_after_request, peer_accept_only, peer_serve, NULL};
  dipole_options options = peer_options();
  options.call_timeout_ms = 100;
  peer_start_scripts(&peer_of_test, scripts, NULL);
  dipole_client *client = peer_open(peer_of_test.address, &options);
  const uint64_t id = peer_submit(client, 6);
  fail_collect_id(client, id, "the call took longer than 100 ms");
  dipole_set_call_timeout_ms(client, 0);
  peer_check_eval(client, 5);
  collect_id(client, id, 6);
  peer_finish(client);
}

UNIT_TEST(test_busy_takes_no_longer) {
  dipole_options options = peer_options();
  options.call_timeout_ms = 50;
  dipole_client *client = peer_begin_with(peer_stay_busy, &(uint32_t){5000}, &options);
  peer_check_failure(client, DIPOLE_ERROR_TIMEOUT);
  peer_check_failure(client, DIPOLE_ERROR_TIMEOUT);
  assert_int_equal(dipole_outstanding(client), 0);
  peer_finish(client);
}
