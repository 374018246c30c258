/* libdipole when the daemon chooses the model: answers to queries of any model, from a peer that
 * sometimes sends wrong answers. */

#include "proto/eval.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

static const float radii[3] = {0.5f, 1, 2};
static const double wide_radii[3] = {0.5, 1, 2};
static const dipole_parameter tolerance = {CORE_PARAMETER_TOLERANCE, 0.01};

static dipole_query query_of(unsigned model, unsigned evaluator) {
  return (dipole_query){.model = model,
                        .evaluator = evaluator,
                        .moments = DIPOLE_EXACT,
                        .wanted = DIPOLE_R | DIPOLE_CDF,
                        .media = peer_media,
                        .medium_count = 1,
                        .spacing = DIPOLE_LIST,
                        .radii = evaluator == DIPOLE_F64 ? (const void *)wide_radii : radii,
                        .radius_count = 3,
                        .parameters = &tolerance,
                        .parameter_count = 1};
}

typedef struct choice_script {
  uint16_t model, evaluator; /* as the peer's answer states them */
} choice_script;

/* A script that answers eval requests correctly, except for the stated model and evaluator. */
static void answer_with_choice(int fd, void *context) {
  const choice_script *script = context;
  peer_frame request;
  bool good = peer_say_hello(fd);
  while (good && peer_receive(fd, &request)) {
    uint8_t *payload = NULL;
    size_t bytes = request.header.payload_bytes;
    if (request.header.type == WIRE_TYPE_EVAL) {
      wire_eval_reply fixed;
      bytes = peer_evaluate(&request, &payload);
      wire_get_eval_reply(payload, &fixed);
      fixed.model = script->model;
      fixed.evaluator = script->evaluator;
      wire_put_eval_reply(payload, &fixed);
    }
    good = peer_send(fd, (uint16_t)(request.header.type | WIRE_REPLY), request.header.request_id,
                     payload != NULL ? payload : request.payload, bytes);
    free(payload);
    free(request.payload);
  }
}

static void assert_single_values(const dipole_result *result) {
  assert_null(result->channels[0].R_f64);
  assert_null(dipole_values_f64(result, 0, DIPOLE_R));
  for (size_t i = 0; i < 3; i++) {
    assert_true(result->channels[0].R_f32[i] == 2 * radii[i]);
    assert_true(dipole_values_f32(result, 0, DIPOLE_CDF)[i] == radii[i] / 4);
  }
}

static void run_choice(unsigned model, unsigned evaluator, choice_script script, bool expected) {
  const dipole_query query = query_of(model, evaluator);
  dipole_result *result = NULL;
  dipole_error error = {0};
  dipole_client *client = peer_begin(answer_with_choice, &script);
  assert_int_equal(dipole_eval(client, &query, &result, &error), expected);
  assert_int_equal(dipole_ping(client, NULL), expected);
  assert_int_equal(error.kind, expected ? DIPOLE_ERROR_NONE : DIPOLE_ERROR_PROTOCOL);
  if (expected) {
    assert_int_equal(result->model, script.model);
    assert_int_equal(result->evaluator, script.evaluator);
  }
  if (expected && evaluator != DIPOLE_F64) {
    assert_single_values(result);
  } else if (expected) {
    assert_true(dipole_values_f64(result, 0, DIPOLE_R)[2] == 4);
    assert_null(dipole_values_f32(result, 0, DIPOLE_R));
  }
  dipole_result_free(result);
  peer_finish(client);
}

UNIT_TEST(any_model_is_answered_by_an_evaluator_of_the_type) {
  static const unsigned evaluators[] = {DIPOLE_F64, DIPOLE_F32, DIPOLE_LUT};
  for (size_t asked = 0; asked < 3; asked++) {
    for (size_t taken = 0; taken < 3; taken++) {
      const choice_script script = {7, (uint16_t)evaluators[taken]};
      const bool same_type = (asked == 0) == (taken == 0);
      run_choice(DIPOLE_ANY_MODEL, evaluators[asked], script, same_type);
      run_choice(7, evaluators[asked], script, asked == taken);
    }
  }
  run_choice(DIPOLE_ANY_MODEL, DIPOLE_LUT, (choice_script){7, 4}, false);
}
