/* libdipole when connections are lost and daemons are busy: which requests it repeats, and that
 * every query has exactly one, correct answer. */
#include <math.h>
#include <time.h>
#include <unistd.h>

#include "proto/mc.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

UNIT_SETUP(make_radii) {
  peer_make_radii();
}

/* ---- scripts ------------------------------------------------------------------------------- */

static void shut_down(int fd, void *context) {
  peer_hang_up_after_request(fd, context);
  peer_send_error(fd, 0, WIRE_STATUS_SHUTTING_DOWN, 0);
}

static void break_rules(int fd, void *context) {
  peer_hang_up_after_request(fd, context);
  peer_send_error(fd, 0, WIRE_STATUS_BAD_MAGIC, 0);
}

static void be_busy_and_hang_up(int fd, void *context) {
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  peer_send_error(fd, request.header.request_id, WIRE_STATUS_BUSY, 100);
  free(request.payload);
}

static void stay_silent(int fd, void *context) {
  peer_frame request;
  peer_hang_up_after_request(fd, context);
  if (peer_receive(fd, &request)) { /* waits until the client closes */
    abort();
  }
}

static void report_work_and_serve(int fd, void *context) {
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  while (peer_receive(fd, &request)) {
    const uint64_t id = request.header.request_id;
    uint8_t *payload;
    const size_t bytes = peer_evaluate(&request, &payload);
    peer_send(fd, WIRE_TYPE_PING | WIRE_REPLY, id, NULL, 0);
    peer_send(fd, WIRE_TYPE_EVAL | WIRE_REPLY, id, payload, bytes);
    free(payload);
    free(request.payload);
  }
}

/* ---- lost and found ------------------------------------------------------------------------ */

/* What the connections of a client do, and what comes of its queries. */
static const struct lost {
  peer_script *scripts[7];
  size_t sent;                 /* bytes of the answer after which peer_hang_up_in_answer() ends */
  bool once;                   /* no retries are wanted */
  unsigned retry_ms;           /* 0: the usual */
  unsigned timeout_ms;         /* 0: the usual */
  enum dipole_error_kind kind; /* DIPOLE_ERROR_NONE: every query is answered */
  unsigned status;
  const char *text; /* what the error says; NULL: whatever */
} losses[] = {
    {.scripts = {report_work_and_serve}},
    {.scripts = {peer_hang_up_after_request, peer_serve}},
    {.scripts = {peer_hang_up_after_hello, peer_serve}},
    {.scripts = {peer_hang_up_in_answer, peer_serve}, .sent = 1},
    {.scripts = {peer_hang_up_in_answer, peer_serve}, .sent = 23},
    {.scripts = {peer_hang_up_in_answer, peer_serve}, .sent = 24},
    {.scripts = {peer_hang_up_in_answer, peer_serve}, .sent = 25},
    {.scripts = {peer_hang_up_in_answer, peer_serve}, .sent = 100},
    {.scripts = {peer_hang_up_in_answer, peer_serve}, .sent = 135},
    {.scripts = {peer_hang_up_after_request, peer_hang_up_at_once, peer_hang_up_after_request,
                 peer_hang_up_after_hello, peer_hang_up_at_once, peer_serve}},
    {.scripts = {shut_down, peer_serve}},
    {.scripts = {be_busy_and_hang_up, peer_serve}},
    {.scripts = {peer_hang_up_after_request, peer_be_full, peer_serve}},
#define NOT_AGAIN .kind = DIPOLE_ERROR_CONNECTION
    {.scripts = {peer_hang_up_after_request, peer_must_not_come}, .once = true, NOT_AGAIN},
    {.scripts = {break_rules, peer_must_not_come}, .status = WIRE_STATUS_BAD_MAGIC, NOT_AGAIN},
    {.scripts = {stay_silent, peer_must_not_come}, .timeout_ms = 50, NOT_AGAIN},
    {.scripts = {peer_hang_up_after_request}, .retry_ms = 200, .text = "again failed", NOT_AGAIN},
    {.scripts = {peer_hang_up_after_request, peer_serve_other_lists},
     .text = "other lists",
     NOT_AGAIN},
#undef NOT_AGAIN
};

UNIT_TEST(test_lost_connections) {
  for (size_t i = 0; i < sizeof losses / sizeof losses[0]; i++) {
    const struct lost *row = &losses[i];
    size_t sent = row->sent;
    dipole_client *client = peer_begin_scripts(row->scripts, &sent);
    if (row->once || row->retry_ms > 0) {
      dipole_set_retry_ms(client, row->retry_ms);
    }
    if (row->timeout_ms > 0) {
      dipole_set_timeout_ms(client, row->timeout_ms);
    }
    if (row->kind == DIPOLE_ERROR_NONE) {
      peer_check_eval(client, 5);
      peer_check_eval(client, 6);
    } else {
      const dipole_error error = peer_check_failure(client, row->kind);
      assert_int_equal(error.status, row->status);
      assert_true(row->text == NULL || strstr(error.text, row->text) != NULL);
    }
    if (row->kind != DIPOLE_ERROR_NONE && (row->once || row->retry_ms > 0)) { /* it stays so */
      peer_check_failure(client, row->kind);
    }
    peer_finish(client);
  }
}

/* ---- jobs ---------------------------------------------------------------------------------- */

static const dipole_mc_query job = {.medium = {.1, 1, 0, 1.3},
                                    .spacing = DIPOLE_LINEAR,
                                    .ring_count = 4,
                                    .radius_stop_mm = 4,
                                    .photons = 1000};

/* Answers an mc request with a report of progress and then, unless the state is MC_UNDER_WAY, with
 * a table. */
static void walk_until(int fd, enum mc_state state) {
  schema_layout layout;
  peer_frame request;
  wire_mc_reply reply = {.photons = 10};
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  const uint64_t id = request.header.request_id;
  free(request.payload);
  assert_true(mc_reply_layout(1, 1, job.ring_count, &layout));
  uint8_t *payload = calloc(1, layout.payload_bytes);
  assert_non_null(payload);
  wire_put_mc_reply(payload, &reply);
  peer_send(fd, WIRE_TYPE_MC | WIRE_REPLY, id, payload, WIRE_BYTES_mc_reply);
  if (state != MC_UNDER_WAY) {
    reply = (wire_mc_reply){.state = (uint16_t)state,
                            .side_count = 1,
                            .albedo_count = 1,
                            .ring_count = job.ring_count,
                            .photons = state == MC_PHOTONS_WALKED ? job.photons : 20};
    wire_put_mc_reply(payload, &reply);
    peer_send(fd, WIRE_TYPE_MC | WIRE_REPLY, id, payload, layout.payload_bytes);
  }
  free(payload);
}

static void hang_up_in_the_middle(int fd, void *context) {
  (void)context;
  walk_until(fd, MC_UNDER_WAY);
}

static void stop_in_the_middle(int fd, void *context) {
  (void)context;
  walk_until(fd, MC_STOPPED);
}

static void walk_to_the_end(int fd, void *context) {
  peer_frame request;
  (void)context;
  walk_until(fd, MC_PHOTONS_WALKED);
  while (peer_receive(fd, &request)) { /* until the client is gone */
    free(request.payload);
  }
}

UNIT_TEST(test_a_job_is_begun_again) {
  peer_script *const scripts[] = {peer_hang_up_after_request, hang_up_in_the_middle,
                                  stop_in_the_middle, walk_to_the_end, NULL};
  dipole_mc_result *result;
  dipole_error error;
  dipole_client *client = peer_begin_scripts(scripts, NULL);
  assert_true(dipole_mc(client, &job, NULL, NULL, &result, &error));
  assert_int_equal(result->end, DIPOLE_MC_PHOTONS);
  assert_int_equal(result->last.photons, job.photons);
  assert_non_null(dipole_mc_values(result, 0, DIPOLE_MC_REFLECTED));
  assert_null(dipole_mc_values(result, 0, DIPOLE_MC_TRANSMITTED));
  assert_null(dipole_mc_errors(result, 1, DIPOLE_MC_REFLECTED));
  assert_null(dipole_mc_photons(result, DIPOLE_MC_TRANSMITTED));
  dipole_mc_result_free(result);
  peer_finish(client);
}

static bool cancel_at_once(void *context, const dipole_mc_progress *now) {
  (void)context, (void)now;
  return false;
}

UNIT_TEST(test_a_cancelled_job_is_not_begun_again) {
  peer_script *const scripts[] = {hang_up_in_the_middle, peer_must_not_come, NULL};
  dipole_mc_result *result;
  dipole_error error;
  dipole_client *client = peer_begin_scripts(scripts, NULL);
  assert_false(dipole_mc(client, &job, cancel_at_once, NULL, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_CONNECTION);
  peer_finish(client);
}

UNIT_TEST(test_a_job_that_is_cut_off_where_no_retries_are_wanted) {
  peer_script *const scripts[] = {stop_in_the_middle, peer_must_not_come, NULL};
  dipole_mc_result *result;
  dipole_error error;
  dipole_client *client = peer_begin_scripts(scripts, NULL);
  dipole_set_retry_ms(client, 0);
  assert_true(dipole_mc(client, &job, NULL, NULL, &result, &error));
  assert_int_equal(result->end, DIPOLE_MC_STOPPED);
  assert_int_equal(result->last.photons, 20);
  dipole_mc_result_free(result);
  peer_finish(client);
}

UNIT_TEST(test_what_is_too_large_to_keep) {
  peer_script *const scripts[] = {peer_hang_up_after_hello, peer_must_not_come, NULL};
  const uint64_t count = DIPOLE_RETRY_KEPT_BYTES / sizeof(double);
  double *many = calloc(count, sizeof *many);
  dipole_query query = peer_query(count);
  dipole_result *result;
  dipole_error error;
  assert_non_null(many);
  query.radii = many;
  dipole_client *client = peer_begin_scripts(scripts, NULL);
  assert_false(dipole_eval(client, &query, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_CONNECTION);
  peer_finish(client);
  free(many);
}

/* ---- busy ---------------------------------------------------------------------------------- */

/* A script that refuses each request twice, for either reason. *context counts the requests that it received. */
static void serve_the_third_time(int fd, void *context) {
  unsigned *received = context;
  peer_frame request;
  peer_say_hello_or_abort(fd);
  while (peer_receive(fd, &request)) {
    if (++*received % 3 != 0) {
      const bool is_busy = *received % 3 == 1;
      peer_send_error(fd, request.header.request_id,
                      is_busy ? WIRE_STATUS_BUSY : WIRE_STATUS_SHUTTING_DOWN, 20);
    } else {
      peer_answer(fd, &request);
    }
    free(request.payload);
  }
}

UNIT_TEST(test_busy) {
  peer_script *const scripts[] = {serve_the_third_time, peer_must_not_come, NULL};
  unsigned received = 0;
  dipole_client *client = peer_begin_scripts(scripts, &received);
  const int64_t start_ms = peer_now_ms();
  peer_check_eval(client, 5);
  assert_true(peer_now_ms() - start_ms >= 40);
  peer_check_eval(client, 6);
  peer_finish(client);
  assert_int_equal(received, 6);
}

/* A script that refuses the second of three requests when it first arrives, and answers the first one
 * after all others. */
static void serve_out_of_turn(int fd, void *context) {
  unsigned received = 0;
  peer_frame request, first = {0};
  (void)context;
  peer_say_hello_or_abort(fd);
  while (peer_receive(fd, &request)) {
    if (++received == 1) {
      first = request;
      continue;
    }
    if (received == 2) {
      peer_send_error(fd, request.header.request_id, WIRE_STATUS_BUSY, 50);
    } else {
      peer_answer(fd, &request);
    }
    if (received == 4) {
      peer_answer(fd, &first);
    }
    free(request.payload);
  }
  free(first.payload);
}

UNIT_TEST(test_others_do_not_wait_for_the_busy_one) {
  peer_script *const scripts[] = {serve_out_of_turn, NULL};
  uint64_t ids[3];
  dipole_error error;
  dipole_client *client = peer_begin_scripts(scripts, NULL);
  for (unsigned i = 0; i < 3; i++) {
    const dipole_query query = peer_query(i + 1);
    assert_true(dipole_submit(client, &query, &ids[i], &error));
  }
  for (unsigned i = 0; i < 3; i++) {
    uint64_t id;
    dipole_result *result;
    assert_true(dipole_collect(client, &id, &result, &error));
    const unsigned which = id == ids[2] ? 2 : id == ids[1];
    assert_true(id == ids[which] &&
                (which == 2) == (i == 0)); /* the two others may come together */
    peer_check_result(result, which + 1);
  }
  peer_finish(client);
}

UNIT_TEST(test_busy_for_longer_than_that) {
  static const uint32_t retry_after_ms[] = {0, 1, 60, 60000};
  for (size_t i = 0; i < 4; i++) {
    peer_script *const scripts[] = {peer_stay_busy, NULL};
    uint32_t after_ms = retry_after_ms[i];
    dipole_client *client = peer_begin_scripts(scripts, &after_ms);
    dipole_set_retry_ms(client, 100);
    const dipole_error error = peer_check_failure(client, DIPOLE_ERROR_REFUSED);
    assert_int_equal(error.status, WIRE_STATUS_BUSY);
    assert_int_equal(error.retry_after_ms, after_ms);
    peer_check_failure(client, DIPOLE_ERROR_REFUSED); /* The client goes on working. */
    peer_finish(client);
  }
}

/* ---- deadlines ----------------------------------------------------------------------------- */

static void hang_up_after_a_while(int fd, void *context) {
  peer_hang_up_after_request(fd, context);
  usleep(50000);
}

/* A script that stores the deadline of the request in *context. */
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
  dipole_query query = peer_query(9);
  dipole_result *result;
  dipole_error error;
  query.deadline_ms = 15000;
  dipole_client *client = peer_begin_scripts(scripts, &left_ms);
  assert_true(dipole_eval(client, &query, &result, &error));
  peer_check_result(result, 9);
  peer_finish(client);
  assert_in_range(left_ms, 1, 14960);
}

UNIT_TEST(test_deadlines_end) {
  peer_script *const scripts[] = {hang_up_after_a_while, peer_serve, NULL};
  dipole_query query = peer_query(9);
  dipole_result *result;
  dipole_error error;
  query.deadline_ms = 20;
  for (int collects = 0; collects < 2; collects++) {
    uint64_t id;
    dipole_client *client = peer_begin_scripts(scripts, NULL);
    assert_false(collects ? dipole_submit(client, &query, &id, &error) &&
                                dipole_collect(client, &id, &result, &error)
                          : dipole_eval(client, &query, &result, &error));
    assert_int_equal(error.kind, DIPOLE_ERROR_REFUSED);
    assert_int_equal(error.status, WIRE_STATUS_DEADLINE);
    assert_string_equal(error.field, "deadline_ms");
    peer_check_eval(client, 5);
    peer_finish(client);
  }
}

/* ---- parts --------------------------------------------------------------------------------- */

enum { RADII = 64 };

static void send_three_parts(int fd, void *context) {
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  for (uint32_t part = 0; part < 3; part++) {
    peer_send_part(fd, &request, part, 8);
  }
  free(request.payload);
}

static void send_other_parts(int fd, void *context) {
  uint64_t each = 16;
  (void)context;
  peer_serve_parts(fd, &each);
}

static bool read_part(void *context, const dipole_result *part, uint64_t radius_first) {
  uint64_t *read = context;
  assert_int_equal(radius_first, *read);
  for (uint64_t i = 0; i < part->radius_count; i++) {
    assert_true(part->channels[0].R_f64[i] == 2 * peer_radii_f64[radius_first + i]);
  }
  *read += part->radius_count;
  return true;
}

UNIT_TEST(test_parts_are_not_handed_on_twice) {
  peer_script *const lost_at_first[] = {peer_hang_up_after_request, send_other_parts, NULL};
  peer_script *const lost_in_between[] = {send_three_parts, peer_must_not_come, NULL};
  const dipole_query query = peer_query(RADII);
  dipole_error error;
  uint64_t read = 0;
  dipole_client *client = peer_begin_scripts(lost_at_first, NULL);
  assert_true(dipole_eval_parts(client, &query, read_part, &read, &error));
  assert_int_equal(read, RADII);
  peer_finish(client);

  read = 0;
  client = peer_begin_scripts(lost_in_between, NULL);
  assert_false(dipole_eval_parts(client, &query, read_part, &read, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_CONNECTION);
  assert_int_equal(read, 24);
  peer_finish(client);
}
