/* libdipole and answers into the caller's memory: the library writes the right values and no byte
 * beside them, for any shape, any cut into parts, and after errors. */
#include "proto/eval.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

enum { RADII = 301, MEDIA = 2, GUARD = 64, UNTOUCHED = 0xa5 };

UNIT_SETUP(make_radii) {
  peer_make_radii();
}

/* The value that the peer gives for a radius, by quantity, in the order of the arrays. */
static const struct {
  unsigned quantity;
  double factor;
} quantities[] = {{DIPOLE_R, 2}, {DIPOLE_CDF, 0.25}, {DIPOLE_S, 3}};
enum { QUANTITIES = sizeof quantities / sizeof quantities[0] };

/* The caller's memory, with guard bytes on both sides. */
typedef struct room {
  uint8_t *bytes;
  size_t count;
} room;

static room room_for(size_t count) {
  const room made = {malloc(count + 2 * GUARD), count};
  assert_non_null(made.bytes);
  memset(made.bytes, UNTOUCHED, count + 2 * GUARD);
  return made;
}

static void *inside(const room *of) {
  return of->bytes + GUARD;
}

static void check_untouched(const uint8_t *bytes, size_t count) {
  for (size_t i = 0; i < count; i++) {
    assert_int_equal(bytes[i], UNTOUCHED);
  }
}

static void end_room(room *of) {
  check_untouched(of->bytes, GUARD);
  check_untouched(of->bytes + GUARD + of->count, GUARD);
  free(of->bytes);
}

typedef struct question {
  dipole_query query;
  size_t value_bytes;
  room values, radii;
} question;

static question question_of(unsigned evaluator, unsigned wanted, uint64_t count) {
  question made = {.value_bytes = evaluator == DIPOLE_F64 ? sizeof(double) : sizeof(float)};
  size_t arrays = 0;
  for (size_t q = 0; q < QUANTITIES; q++) {
    arrays += (wanted & quantities[q].quantity) != 0;
  }
  made.values = room_for(MEDIA * arrays * count * made.value_bytes);
  made.radii = room_for((wanted & DIPOLE_RADIUS) != 0 ? count * made.value_bytes : 0);
  made.query = (dipole_query){.model = 2,
                              .evaluator = evaluator,
                              .moments = DIPOLE_EXACT,
                              .wanted = wanted,
                              .media = peer_media,
                              .medium_count = MEDIA,
                              .spacing = DIPOLE_LIST,
                              .radii = evaluator == DIPOLE_F64 ? (const void *)peer_radii_f64
                                                               : peer_radii_f32,
                              .radius_count = count,
                              .into_values = inside(&made.values),
                              .into_radii = inside(&made.radii)};
  return made;
}

static void end_question(question *of) {
  end_room(&of->values);
  end_room(&of->radii);
}

static double value_at(const void *values, size_t value_bytes, uint64_t i) {
  return value_bytes == sizeof(double) ? ((const double *)values)[i]
                                       : (double)((const float *)values)[i];
}

static void check_array(const question *of, const void *values, const void *place, double factor) {
  for (uint64_t i = 0; i < of->query.radius_count; i++) {
    assert_true(value_at(values, of->value_bytes, i) == factor * peer_radii_f64[i]);
    assert_true(value_at(place, of->value_bytes, i) == factor * peer_radii_f64[i]);
  }
}

/* Checks the values of each array of the result and of the memory, and frees the result. */
static void check_result(const question *of, dipole_result *result) {
  const bool single = of->value_bytes == sizeof(float);
  const size_t array_bytes = of->query.radius_count * of->value_bytes;
  const uint8_t *place = inside(&of->values);
  assert_int_equal(result->radius_count, of->query.radius_count);
  for (uint32_t c = 0; c < MEDIA; c++) {
    assert_true(result->channels[c].albedo == peer_media[c].sigma_a_per_mm);
    for (size_t q = 0; q < QUANTITIES; q++) {
      if ((of->query.wanted & quantities[q].quantity) != 0) {
        const unsigned quantity = quantities[q].quantity;
        check_array(of,
                    single ? (const void *)dipole_values_f32(result, c, quantity)
                           : dipole_values_f64(result, c, quantity),
                    place, quantities[q].factor);
        place += array_bytes;
      }
    }
  }
  if ((of->query.wanted & DIPOLE_RADIUS) != 0) {
    check_array(of, single ? (const void *)result->radius_f32 : result->radius_f64,
                inside(&of->radii), 1);
  }
  const void *R = single ? (const void *)result->channels[0].R_f32 : result->channels[0].R_f64;
  assert_int_equal(R != NULL, (of->query.wanted & DIPOLE_R) != 0);
  dipole_result_free(result);
}

static void ask(dipole_client *client, unsigned evaluator, unsigned wanted, uint64_t count) {
  question asked = question_of(evaluator, wanted, count);
  dipole_result *result;
  dipole_error error;
  peer_expect(dipole_eval(client, &asked.query, &result, &error), &error);
  check_result(&asked, result);
  end_question(&asked);
}

static const unsigned all = DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_CDF | DIPOLE_S | DIPOLE_RADIUS;
static const unsigned wanted_sets[] = {DIPOLE_R,
                                       DIPOLE_R | DIPOLE_ALBEDO,
                                       DIPOLE_CDF | DIPOLE_S | DIPOLE_ALBEDO,
                                       DIPOLE_ALBEDO,
                                       DIPOLE_RADIUS | DIPOLE_CDF,
                                       DIPOLE_RADIUS | DIPOLE_ALBEDO,
                                       all};
enum { WANTED_SETS = sizeof wanted_sets / sizeof wanted_sets[0] };

static void ask_all(dipole_client *client) {
  static const uint64_t counts[] = {0, 1, 2, 3, 7, 8, 64, 255, 300, RADII};
  for (size_t w = 0; w < WANTED_SETS; w++) {
    for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++) {
      ask(client, DIPOLE_F64, wanted_sets[w], counts[i]);
      ask(client, DIPOLE_F32, wanted_sets[w], counts[i]);
    }
  }
}

UNIT_TEST(test_every_shape) {
  dipole_client *client = peer_begin_with(peer_serve, NULL, NULL);
  ask_all(client);
  peer_finish(client);
}

UNIT_TEST(test_parts) {
  static const uint64_t sizes[] = {1, 3, 64};
  for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
    uint64_t each = sizes[i];
    dipole_client *client = peer_begin_with(peer_serve_parts, &each, NULL);
    ask_all(client);
    peer_finish(client);
  }
}

/* ---- what goes wrong ----------------------------------------------------------------------- */

/* A script that sends the answer except for its last *context bytes. */
static void hang_up_before_the_end(int fd, void *context) {
  peer_frame request;
  size_t count;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  uint8_t *bytes = peer_make_answer(&request, eval_albedo_offset(MEDIA), &count);
  const size_t before = *(const size_t *)context;
  peer_send_bytes(fd, bytes, before < count ? count - before : 0);
  free(bytes);
  free(request.payload);
}

UNIT_TEST(test_lost_and_asked_again) {
  static const size_t before_the_end[] = {1, 4, 12, 20, 100, 1000, 2500, 3000, 5000};
  peer_script *const scripts[] = {hang_up_before_the_end, peer_serve, NULL};
  for (size_t i = 0; i < sizeof before_the_end / sizeof before_the_end[0]; i++) {
    size_t before = before_the_end[i];
    dipole_client *client = peer_begin_scripts(scripts, &before);
    ask(client, i % 2 != 0 ? DIPOLE_F32 : DIPOLE_F64, all, 101);
    ask(client, DIPOLE_F64, all, 9);
    peer_finish(client);
  }
}

static void refuse(int fd, void *context) {
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  peer_send_error(fd, request.header.request_id, WIRE_STATUS_BAD_VALUE, 0);
  free(request.payload);
  while (peer_receive(fd, &request)) {
    peer_answer(fd, &request);
    free(request.payload);
  }
}

UNIT_TEST(test_refused) {
  dipole_result *result;
  dipole_error error;
  dipole_client *client = peer_begin_with(refuse, NULL, NULL);
  question asked = question_of(DIPOLE_F64, all, 5);
  assert_false(dipole_eval(client, &asked.query, &result, &error));
  assert_int_equal(error.kind, DIPOLE_ERROR_REFUSED);
  check_untouched(inside(&asked.values), asked.values.count);
  end_question(&asked);
  ask(client, DIPOLE_F64, all, 5);
  peer_finish(client);
}

/* A script that sends *context bytes of the first answer, waits for the second request, and then
 * sends the rest and the second answer. */
static void pause_in_the_answer(int fd, void *context) {
  const size_t before = *(const size_t *)context;
  peer_frame first, second;
  size_t count;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &first);
  uint8_t *bytes = peer_make_answer(&first, SIZE_MAX, &count);
  const size_t at_first = before < count ? before : count;
  peer_send_bytes(fd, bytes, at_first);
  peer_receive_or_abort(fd, &second);
  peer_send_bytes(fd, bytes + at_first, count - at_first);
  peer_answer(fd, &second);
  free(bytes);
  free(first.payload);
  free(second.payload);
}

/* After the client has given a query up, the library does not write to the caller's memory,
 * wherever in the answer the call has ended. */
UNIT_TEST(test_given_up) {
  static const size_t sent[] = {0, 1, 30, 200, 300, 304, 1000, 2000, 4000, 100000};
  for (size_t i = 0; i < sizeof sent / sizeof sent[0]; i++) {
    size_t bytes = sent[i];
    dipole_result *result;
    dipole_error error;
    dipole_client *client = peer_begin_with(pause_in_the_answer, &bytes, NULL);
    question asked = question_of(i % 2 != 0 ? DIPOLE_F32 : DIPOLE_F64, all, 101);
    dipole_set_call_timeout_ms(client, 20);
    const bool answered = dipole_eval(client, &asked.query, &result, &error);
    dipole_set_call_timeout_ms(client, 0);
    if (answered) { /* The script sent the whole answer at first. */
      check_result(&asked, result);
    } else {
      assert_int_equal(error.kind, DIPOLE_ERROR_TIMEOUT);
    }
    memset(inside(&asked.values), UNTOUCHED, asked.values.count);
    memset(inside(&asked.radii), UNTOUCHED, asked.radii.count);
    ask(client, DIPOLE_F64, all, 9);
    check_untouched(inside(&asked.values), asked.values.count);
    check_untouched(inside(&asked.radii), asked.radii.count);
    end_question(&asked);
    peer_finish(client);
  }
}

/* A script that answers for wrong radii: too few, or not the first ones. */
static void lie(int fd, void *context) {
  const bool parts = *(const bool *)context;
  peer_frame request;
  uint8_t *payload;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  const size_t bytes = peer_evaluate_part(&request, parts ? 4 : 0, 5, 0, 1, &payload);
  peer_send(fd, WIRE_TYPE_EVAL | WIRE_REPLY, request.header.request_id, payload, bytes);
  free(payload);
  free(request.payload);
}

UNIT_TEST(test_lies_are_not_written) {
  for (unsigned i = 0; i < 2; i++) {
    bool parts = i != 0;
    dipole_result *result;
    dipole_error error;
    dipole_client *client = peer_begin_with(lie, &parts, NULL);
    question asked = question_of(DIPOLE_F64, DIPOLE_R, parts ? 9 : 7);
    assert_false(dipole_eval(client, &asked.query, &result, &error));
    assert_int_equal(error.kind, DIPOLE_ERROR_PROTOCOL);
    check_untouched(inside(&asked.values), asked.values.count);
    end_question(&asked);
    peer_finish(client);
  }
}
