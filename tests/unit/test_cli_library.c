/* libdipole against a peer that follows a script: orders and sizes of answers, and wrong answers,
 * that a real daemon does not produce on demand. */
#include <math.h>

#include "core/montecarlo/montecarlo.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

static const double radii[3] = {0.5, 1, 2};

static const dipole_query simple_query = {.model = 2,
                                          .evaluator = DIPOLE_F64,
                                          .moments = DIPOLE_EXACT,
                                          .wanted = DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_CDF,
                                          .media = peer_media,
                                          .medium_count = 2,
                                          .spacing = DIPOLE_LIST,
                                          .radii = radii,
                                          .radius_count = 3};

/* ---- honest answers ------------------------------------------------------------------------ */

static void check_simple_result(dipole_result *result) {
  assert_int_equal(result->channel_count, 2);
  assert_int_equal(result->radius_count, 3);
  assert_null(result->radius_f64);
  for (size_t i = 0; i < 2; i++) {
    const dipole_channel *channel = &result->channels[i];
    assert_true(channel->albedo == peer_media[i].sigma_a_per_mm);
    assert_null(channel->R_f32);
    assert_null(channel->cdf_f32);
    assert_int_equal((uintptr_t)channel->R_f64 % 8, 0);
    assert_int_equal((uintptr_t)channel->cdf_f64 % 8, 0);
    for (size_t k = 0; k < 3; k++) {
      assert_true(channel->R_f64[k] == 2 * radii[k]);
      assert_true(channel->cdf_f64[k] == radii[k] / 4);
    }
  }
  dipole_result_free(result);
}

UNIT_TEST(test_eval) {
  dipole_client *client = peer_begin(peer_serve, NULL);
  const dipole_info *info = dipole_get_info(client);
  assert_string_equal(info->address, peer_of_test.address);
  /* Control characters were replaced. */
  assert_string_equal(info->software, "scripted?[31m");
  assert_string_equal(info->instruction_set, "avx?2");
  assert_string_equal(info->R_unit, "1/mm^2?");
  assert_string_equal(info->choices[0].about, "half?spaces");
  assert_int_equal(dipole_id(client, DIPOLE_MODEL, "better"), 2);
  assert_int_equal(dipole_id(client, DIPOLE_MODEL, "bad-value"), 0);
  check_simple_result(peer_eval(client, &simple_query));
  peer_finish(client);
}

/* The request lists parameters and then five floats, which need padding. */
UNIT_TEST(test_parameters_and_notes) {
  static const float r[5] = {1, 2, 3, 4, 5};
  static const dipole_parameter parameters[2] = {{CORE_PARAMETER_COS_OUT, 0.25},
                                                 {CORE_PARAMETER_COS_IN, 0.75}};
  dipole_error error;
  dipole_result *result;
  dipole_query query = simple_query;
  query.evaluator = DIPOLE_F32;
  query.wanted = DIPOLE_S | DIPOLE_MODEL_ERROR;
  query.radii = r;
  query.radius_count = 5;
  query.parameters = parameters;
  query.parameter_count = 2;
  dipole_client *client = peer_begin(peer_serve, NULL);
  assert_true(dipole_eval(client, &query, &result, &error));
  assert_int_equal(result->notes, 2);
  for (uint32_t i = 0; i < 2; i++) {
    assert_true(result->channels[i].model_error == 0.75);
    assert_null(dipole_values_f32(result, i, DIPOLE_RING));
    assert_null(dipole_values_f64(result, i, DIPOLE_S));
    assert_true(dipole_values_f32(result, i, DIPOLE_S)[4] == 15);
  }
  dipole_result_free(result);
  assert_true(dipole_eval(client, &simple_query, &result, &error)); /* without parameters */
  assert_int_equal(result->notes, 0);
  assert_true(isnan(result->channels[0].model_error));
  dipole_result_free(result);
  peer_finish(client);
}

/* ---- refusals ------------------------------------------------------------------------------ */

static const char *const refused_fields[] = {"sigma_a", "r", "model", "", "max_mc_jobs"};

enum { REFUSALS = sizeof refused_fields / sizeof refused_fields[0] };

/* A script that refuses some requests and answers the one after them. */
static void refuse(int fd, void *context) {
  (void)context;
  peer_say_hello(fd);
  for (size_t i = 0; i < REFUSALS + 1; i++) {
    peer_frame request;
    uint8_t bytes[WIRE_BYTES_error];
    peer_receive_or_abort(fd, &request);
    if (i < REFUSALS) {
      wire_error error = {.status = WIRE_STATUS_BAD_VALUE, .index = 1};
      WIRE_SET_TEXT(error.field, refused_fields[i]);
      WIRE_SET_TEXT(error.allowed, "0 to 1e15");
      if (i >= 3) {
        error.status = WIRE_STATUS_BUSY;
        error.retry_after_ms = 7;
      }
      wire_put_error(bytes, &error);
      peer_send(fd, WIRE_TYPE_ERROR, request.header.request_id, bytes, sizeof bytes);
    } else {
      peer_answer(fd, &request);
    }
    free(request.payload);
  }
}

UNIT_TEST(test_refusals_say_what_is_allowed) {
  static const char *const texts[REFUSALS] = {
      "bad-value: sigma_a of medium 2 of 2: allowed: 0 to 1e15",
      "bad-value: r number 2 of 3: allowed: 0 to 1e15", "bad-value: model: allowed: 0 to 1e15",
      "busy: the daemon is at its limit; try again later (in 7 ms)",
      "busy: the daemon is at its limit; try again later (in 7 ms): max_mc_jobs: allowed: 0 to "
      "1e15"};
  dipole_error error;
  dipole_result *result;
  dipole_client *client = peer_begin(refuse, NULL);
  for (size_t i = 0; i < REFUSALS; i++) {
    assert_false(dipole_eval(client, &simple_query, &result, &error));
    assert_int_equal(error.kind, DIPOLE_ERROR_REFUSED);
    assert_string_equal(error.text, texts[i]);
    assert_string_equal(error.field, refused_fields[i]);
    assert_int_equal(error.status, i < 3 ? WIRE_STATUS_BAD_VALUE : WIRE_STATUS_BUSY);
    assert_int_equal(error.retry_after_ms, i < 3 ? 0 : 7);
  }
  check_simple_result(peer_eval(client, &simple_query));
  peer_finish(client);
}

UNIT_TEST(test_busy_at_connecting) {
  dipole_client *client;
  dipole_error error;
  peer_start(&peer_of_test, peer_be_full, NULL);
  dipole_options options = peer_options();
  options.retry_ms = 0;
  assert_false(dipole_open_with(peer_of_test.address, &options, &client, &error));
  assert_null(client);
  assert_int_equal(error.kind, DIPOLE_ERROR_REFUSED);
  assert_int_equal(error.status, WIRE_STATUS_BUSY);
  assert_int_equal(error.retry_after_ms, 30);
  peer_end(&peer_of_test);
}

/* ---- lies ---------------------------------------------------------------------------------- */

/* A change of one number in the header of an otherwise correct answer; test_messages.py changes
 * payloads. */
typedef struct one_lie {
  const char *what;
  size_t offset; /* of the number, from the start of the frame */
  size_t bytes;
  uint64_t value;
} one_lie;

static void tell_lie(int fd, void *context) {
  const one_lie *lie = context;
  peer_frame request;
  size_t bytes;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  uint8_t *frame = peer_make_answer(&request, SIZE_MAX, &bytes);
  for (size_t i = 0; i < lie->bytes; i++) {
    frame[lie->offset + i] = (uint8_t)(lie->value >> (8 * i));
  }
  peer_send_bytes(fd, frame, bytes);
  free(frame);
  free(request.payload);
}

UNIT_TEST(test_lies_are_noticed) {
  one_lie lies[] = {
      {"magic", 0, 4, 0x12345678},
      {"version", 4, 2, 1},
      {"another type", 6, 2, WIRE_TYPE_PING | WIRE_REPLY},
      {"a request instead of an answer", 6, 2, WIRE_TYPE_EVAL},
      {"an error of another length", 6, 2, WIRE_TYPE_ERROR},
      {"an answer that nobody asked for", 8, 8, 12345},
      {"a payload of 4 GiB", 16, 4, 0xfffffff8},
      {"an empty payload", 16, 4, 0},
      {"a payload that is not padded", 16, 4, 3},
  };
  for (size_t i = 0; i < sizeof lies / sizeof lies[0]; i++) {
    dipole_error error;
    dipole_result *result;
    dipole_client *client = peer_begin(tell_lie, &lies[i]);
    for (int again = 0; again < 2; again++) { /* The client stays broken after the first error. */
      if (dipole_eval(client, &simple_query, &result, &error)) {
        fail_msg("not noticed: %s", lies[i].what);
      }
      if (error.kind != DIPOLE_ERROR_PROTOCOL) {
        fail_msg("%s: %s", lies[i].what, error.text);
      }
    }
    peer_finish(client);
  }
}

/* ---- arguments ----------------------------------------------------------------------------- */

/* A query of which one field is another is not sent. call: has it as `wrong`. */
#define REFUSED(type, call, right, field, value)                                                   \
  do {                                                                                             \
    type wrong = (right);                                                                          \
    wrong.field = (value);                                                                         \
    error.kind = DIPOLE_ERROR_NONE;                                                                \
    if ((call) || error.kind != DIPOLE_ERROR_ARGUMENT) {                                           \
      fail_msg("%s = %s was sent", #field, #value);                                                \
    }                                                                                              \
  } while (false)

UNIT_TEST(test_arguments) {
  dipole_error error;
  dipole_result *result;
  dipole_client *client = peer_begin(peer_serve, NULL);
  static const dipole_parameter beyond = {65536 + CORE_PARAMETER_COS_IN, 0.5};
  const dipole_parameter misspelt = {dipole_id(client, DIPOLE_PARAMETER, "tolerence"), 0.01};
#define EVAL(field, value)                                                                         \
  REFUSED(dipole_query, dipole_eval(client, &wrong, &result, &error), simple_query, field, value)
  EVAL(media, NULL);
  EVAL(radii, NULL);
  EVAL(evaluator, 99);
  EVAL(radius_count, UINT64_MAX);
  EVAL(model, 65536 + 2);
  EVAL(spacing, 65536 + DIPOLE_LIST);
  EVAL(parameter_count, 1);
  dipole_query given = simple_query;
  given.parameters = &beyond;
  REFUSED(dipole_query, dipole_eval(client, &wrong, &result, &error), given, parameter_count, 1);
  REFUSED(dipole_query, dipole_eval(client, &wrong, &result, &error), given, parameter_count,
          65536 + 1);
  given.parameters = &misspelt;
  REFUSED(dipole_query, dipole_eval(client, &wrong, &result, &error), given, parameter_count, 1);
  assert_non_null(strstr(error.text, "parameters[0]"));
  EVAL(model, DIPOLE_ANY_MODEL);
  assert_non_null(strstr(error.text, "needs the parameter tolerance"));
#undef EVAL

  dipole_table *table;
  const dipole_table_query fetched = {.model = 2, .moments = DIPOLE_EXACT, .medium = peer_media[0]};
#define TABLE(field, value)                                                                        \
  REFUSED(dipole_table_query, dipole_table_fetch(client, &wrong, &table, &error), fetched, field,  \
          value)
  TABLE(model, 65536);
  TABLE(moments, 65536);
  TABLE(parameter_count, 1);
#undef TABLE

  dipole_mc_result *walked;
  const dipole_mc_query job = {.medium = peer_media[0],
                               .spacing = DIPOLE_LINEAR,
                               .ring_count = 2,
                               .radius_stop_mm = 2,
                               .photons = 1000};
#define MC(field, value)                                                                           \
  REFUSED(dipole_mc_query, dipole_mc(client, &wrong, NULL, NULL, &walked, &error), job, field,     \
          value)
  MC(albedo_count, 1);
  MC(albedo_count, CORE_MC_ALBEDOS_MAX + 1);
  MC(spacing, 65536);
#undef MC

  dipole_sample_query drawn = {.model = 2,
                               .evaluator = DIPOLE_F64,
                               .moments = DIPOLE_EXACT,
                               .wanted = DIPOLE_RADIUS,
                               .media = peer_media,
                               .medium_count = 1,
                               .draw = DIPOLE_DRAW_RANDOM,
                               .sample_count = 3};
#define SAMPLE(field, value)                                                                       \
  REFUSED(dipole_sample_query, dipole_sample(client, &wrong, &result, &error), drawn, field, value)
  SAMPLE(media, NULL);
  SAMPLE(model, 65536);
  SAMPLE(evaluator, 9);
  SAMPLE(draw, DIPOLE_DRAW_LIST);
  drawn.draw = DIPOLE_DRAW_LIST;
  drawn.numbers = radii;
  SAMPLE(sample_count, UINT64_MAX);
#undef SAMPLE

  dipole_inversion *inversion;
  const dipole_invert_query inverted = {.model = 2,
                                        .moments = DIPOLE_EXACT,
                                        .eta = 1.4,
                                        .albedos = radii,
                                        .lengths_mm = radii,
                                        .medium_count = 1};
#define INVERT(field, value)                                                                       \
  REFUSED(dipole_invert_query, dipole_invert(client, &wrong, &inversion, &error), inverted, field, \
          value)
  INVERT(lengths_mm, NULL);
  INVERT(given, 65536);
  INVERT(medium_count, UINT64_MAX);
#undef INVERT
  check_simple_result(peer_eval(client, &simple_query)); /* The client sent none of the above. */
  peer_finish(client);
  dipole_close(NULL);
  dipole_result_free(NULL);
  dipole_inversion_free(NULL);
}
