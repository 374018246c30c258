/* libdipole and answers in parts: the parts are put together or passed to the caller one by one, and
 * answers that end early are refused. test_messages.py has those whose parts do not belong together. */
#include <math.h>
#include <setjmp.h>

#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

UNIT_SETUP(make_radii) {
  peer_make_radii();
}

static dipole_query query_of(unsigned evaluator, unsigned wanted, uint64_t count) {
  return (dipole_query){.model = 2,
                        .evaluator = evaluator,
                        .moments = DIPOLE_EXACT,
                        .wanted = wanted,
                        .media = peer_media,
                        .medium_count = 2,
                        .spacing = DIPOLE_LIST,
                        .radii =
                            evaluator == DIPOLE_F64 ? (const void *)peer_radii_f64 : peer_radii_f32,
                        .radius_count = count};
}

/* Checks the values of a part whose first radius has position `first`. */
static void check_values(const dipole_result *result, uint64_t first) {
  const bool single = result->evaluator != DIPOLE_F64;
  assert_int_equal(result->channel_count, 2);
  for (uint32_t channel = 0; channel < 2; channel++) {
    assert_true(result->channels[channel].albedo == peer_media[channel].sigma_a_per_mm);
    for (uint64_t i = 0; i < result->radius_count; i++) {
      const double r = peer_radii_f64[first + i];
      if (single) {
        assert_true((double)dipole_values_f32(result, channel, DIPOLE_R)[i] == 2 * r);
        assert_true((double)result->radius_f32[i] == r);
      } else {
        assert_true(result->channels[channel].R_f64[i] == 2 * r);
        assert_true(result->channels[channel].cdf_f64[i] == r / 4);
        assert_true(dipole_values_f64(result, channel, DIPOLE_S)[i] == 3 * r);
      }
    }
  }
}

static const unsigned wanted_f64 = DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_CDF | DIPOLE_S;
static const unsigned wanted_f32 = DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_RADIUS;

/* ---- honest parts -------------------------------------------------------------------------- */

static uint32_t parts_of(uint64_t radii, uint64_t each) {
  return (uint32_t)((radii + each - 1) / each);
}

static const uint64_t sizes[] = {1, 7, 256, 999, 1000, 5000};

/* Counts the parts and radii that the caller got, and says when to stop. */
typedef struct reading {
  uint64_t next;
  unsigned parts;
  unsigned stop_after; /* number of parts after which to stop; 0: never */
} reading;

static bool read_part(void *context, const dipole_result *part, uint64_t radius_first) {
  reading *so_far = context;
  assert_int_equal(radius_first, so_far->next);
  assert_int_equal(part->notes, 0);
  check_values(part, radius_first);
  so_far->next += part->radius_count;
  so_far->parts++;
  return so_far->parts != so_far->stop_after;
}

UNIT_TEST(test_parts_are_handed_on) {
  for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
    const dipole_query query = query_of(DIPOLE_F32, wanted_f32, PEER_RADII);
    dipole_error error;
    reading so_far = {0};
    dipole_client *client = peer_begin(peer_serve_parts, (void *)&sizes[i]);
    peer_expect(dipole_eval_parts(client, &query, read_part, &so_far, &error), &error);
    assert_int_equal(so_far.next, PEER_RADII);
    assert_int_equal(so_far.parts, parts_of(PEER_RADII, sizes[i]));
    peer_finish(client);
  }
}

/* An answer without radii has one part. */
UNIT_TEST(test_nothing_is_handed_on) {
  dipole_error error;
  reading so_far = {0};
  const dipole_query query = query_of(DIPOLE_F64, DIPOLE_ALBEDO, 0);
  dipole_client *client = peer_begin(peer_serve, NULL);
  assert_true(dipole_eval_parts(client, &query, read_part, &so_far, &error));
  assert_int_equal(so_far.parts, 1);
  assert_int_equal(so_far.next, 0);
  peer_finish(client);
}

/* ---- other answers in between -------------------------------------------------------------- */

enum { BETWEEN = 3, EACH = 300 };

/* A script that mixes the frames of three answers: two in parts, and one in a single frame. */
static void mix(int fd, void *context) {
  peer_frame request[BETWEEN];
  (void)context;
  peer_say_hello(fd);
  for (size_t i = 0; i < BETWEEN; i++) {
    peer_receive_or_abort(fd, &request[i]);
  }
  for (uint32_t part = 0; part < parts_of(PEER_RADII, EACH); part++) {
    peer_send_part(fd, &request[2], part, EACH);
    peer_send_part(fd, &request[0], part, EACH);
    if (part == 1) {
      peer_send_part(fd, &request[1], 0, PEER_RADII);
    }
  }
  for (size_t i = 0; i < BETWEEN; i++) {
    free(request[i].payload);
  }
}

static void ask_for_a_mix(bool handed_on) {
  dipole_error error;
  dipole_result *result;
  reading so_far = {0};
  uint64_t ids[2], id;
  const dipole_query query = query_of(DIPOLE_F64, wanted_f64, PEER_RADII);
  dipole_client *client = peer_begin(mix, NULL);
  assert_true(dipole_submit(client, &query, &ids[0], &error));
  assert_true(dipole_submit(client, &query, &ids[1], &error));
  if (handed_on) {
    assert_true(dipole_eval_parts(client, &query, read_part, &so_far, &error));
    assert_int_equal(so_far.next, PEER_RADII);
  } else {
    assert_true(dipole_eval(client, &query, &result, &error));
    check_values(result, 0);
    dipole_result_free(result);
  }
  for (size_t i = 0; i < 2; i++) {
    assert_true(dipole_collect(client, &id, &result, &error));
    assert_true(id == ids[0] || id == ids[1]);
    assert_int_equal(result->radius_count, PEER_RADII);
    check_values(result, 0);
    dipole_result_free(result);
    ids[id == ids[1]] = 0;
  }
  assert_false(dipole_collect(client, &id, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_ARGUMENT);
  peer_finish(client);
}

UNIT_TEST(test_other_answers_may_come_in_between) {
  ask_for_a_mix(false);
  ask_for_a_mix(true);
}

/* ---- answers that end early ---------------------------------------------------------------- */

/* A script that sends two parts and then an error, and answers all later requests in parts. */
static void be_late(int fd, void *context) {
  static const uint64_t each = EACH;
  peer_frame request;
  (void)context;
  peer_say_hello(fd);
  for (int i = 0; i < 3; i++) {
    peer_receive_or_abort(fd, &request);
    assert_int_equal(request.header.deadline_ms, 250 + i);
    for (uint32_t part = 0; part < (i < 2 ? 2 : parts_of(PEER_RADII, EACH)); part++) {
      peer_send_part(fd, &request, part, each);
    }
    if (i < 2) {
      peer_send_error(fd, request.header.request_id, WIRE_STATUS_DEADLINE, 0);
    }
    free(request.payload);
  }
}

UNIT_TEST(test_an_error_ends_an_answer) {
  dipole_error error;
  dipole_result *result;
  reading so_far = {0};
  dipole_query query = query_of(DIPOLE_F64, wanted_f64, PEER_RADII);
  dipole_client *client = peer_begin(be_late, NULL);
  query.deadline_ms = 250;
  assert_false(dipole_eval(client, &query, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_REFUSED);
  assert_int_equal(error.status, WIRE_STATUS_DEADLINE);
  query.deadline_ms = 251;
  assert_false(dipole_eval_parts(client, &query, read_part, &so_far, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_REFUSED);
  assert_int_equal(so_far.next, 2 * EACH);
  query.deadline_ms = 252;
  assert_true(dipole_eval(client, &query, &result, &error)); /* The client goes on working. */
  check_values(result, 0);
  dipole_result_free(result);
  peer_finish(client);
}

/* The reader stops after 1, 2, ... parts; the client's next query is then answered correctly. */
UNIT_TEST(test_a_reader_may_stop) {
  static const uint64_t each = EACH;
  const dipole_query query = query_of(DIPOLE_F64, wanted_f64, PEER_RADII);
  dipole_error error;
  dipole_result *result;
  uint64_t id;
  dipole_client *client = peer_begin(peer_serve_parts, (void *)&each);
  for (unsigned stop_after = 1; stop_after <= parts_of(PEER_RADII, EACH); stop_after++) {
    reading so_far = {.stop_after = stop_after};
    assert_false(dipole_eval_parts(client, &query, read_part, &so_far, &error));
    assert_int_equal(error.kind, DIPOLE_ERROR_STOPPED);
    assert_int_equal(so_far.parts, stop_after);
    assert_false(dipole_collect(client, &id, &result, &error)); /* Nothing is outstanding. */
    assert_int_equal(error.kind, DIPOLE_ERROR_ARGUMENT);
    if (stop_after != 2) { /* After 2, the next reader starts while old parts still arrive. */
      assert_true(dipole_eval(client, &query, &result, &error));
      check_values(result, 0);
      dipole_result_free(result);
    }
  }
  reading so_far = {.stop_after = 1};
  assert_false(dipole_eval_parts(client, &query, read_part, &so_far, &error));
  peer_finish(client);
}

static jmp_buf left;

static bool jump(void *context, const dipole_result *part, uint64_t radius_first) {
  (void)context, (void)part, (void)radius_first;
  longjmp(left, 1);
}

static bool use_client(void *context, const dipole_result *part, uint64_t radius_first) {
  dipole_error error;
  (void)part, (void)radius_first;
  assert_false(dipole_ping(context, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_CONNECTION);
  return true;
}

/* Nothing is taken for an answer after such a reader. */
static void break_rules(bool (*reader)(void *, const dipole_result *, uint64_t)) {
  static const uint64_t each = EACH;
  const dipole_query query = query_of(DIPOLE_F64, wanted_f64, PEER_RADII);
  dipole_error error;
  dipole_client *client = peer_begin(peer_serve_parts, (void *)&each);
  if (setjmp(left) == 0) {
    dipole_eval_parts(client, &query, reader, client, &error);
  }
  assert_false(dipole_ping(client, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_CONNECTION);
  peer_finish(client);
}

UNIT_TEST(test_a_reader_that_uses_the_client) {
  break_rules(use_client);
}

UNIT_TEST(test_a_reader_that_jumps_out_of_its_call) {
  break_rules(jump);
}

/* A script that sends the first part of an answer for 2^40 radii, which no memory could hold, and
 * then an error. */
static void begin_something_huge(int fd, void *context) {
  peer_frame request;
  uint8_t *payload;
  (void)context;
  peer_say_hello(fd);
  while (peer_receive(fd, &request)) {
    const size_t bytes = peer_evaluate_part(&request, 0, 256, 0, UINT32_MAX, &payload);
    peer_send(fd, WIRE_TYPE_EVAL | WIRE_REPLY, request.header.request_id, payload, bytes);
    peer_send_error(fd, request.header.request_id, WIRE_STATUS_BUSY, 0);
    free(payload);
    free(request.payload);
  }
}

static bool count_positions(void *context, const dipole_result *part, uint64_t radius_first) {
  uint64_t *next = context;
  assert_int_equal(radius_first, *next);
  for (uint64_t i = 0; i < part->radius_count; i++) {
    assert_true(part->radius_f64[i] == (double)(radius_first + i));
  }
  *next += part->radius_count;
  return true;
}

UNIT_TEST(test_answers_beyond_memory) {
  dipole_error error;
  uint64_t next = 0;
  dipole_query query = query_of(DIPOLE_F64, wanted_f64 | DIPOLE_RADIUS, UINT64_C(1) << 40);
  query.spacing = DIPOLE_LINEAR;
  query.radius_stop_mm = 1;
  dipole_client *client = peer_begin(begin_something_huge, NULL);
  assert_false(dipole_eval_parts(client, &query, count_positions, &next, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_REFUSED);
  assert_int_equal(next, 256);
  peer_finish(client);
}
