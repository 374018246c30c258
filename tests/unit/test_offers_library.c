/* libdipole when the daemon chooses the model: offers, and answers to queries of any model, from a
 * peer that sometimes sends wrong answers. */
#include <math.h>

#include "proto/eval.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

static const dipole_medium medium = {.sigma_a_per_mm = 0.25, .sigma_s_per_mm = 1, .eta = 1.3};
static const float radii[3] = {0.5f, 1, 2};
static const double wide_radii[3] = {0.5, 1, 2};
static const dipole_parameter tolerance = {CORE_PARAMETER_TOLERANCE, 0.01};

static dipole_query query_of(unsigned model, unsigned evaluator) {
  return (dipole_query){.model = model,
                        .evaluator = evaluator,
                        .moments = DIPOLE_EXACT,
                        .wanted = DIPOLE_R | DIPOLE_CDF,
                        .media = &medium,
                        .medium_count = 1,
                        .spacing = DIPOLE_LIST,
                        .radii = evaluator == DIPOLE_F64 ? (const void *)wide_radii : radii,
                        .radius_count = 3,
                        .parameters = &tolerance,
                        .parameter_count = 1};
}

/* ---- offers -------------------------------------------------------------------------------- */

enum { OFFERS = 3, OFFERS_BYTES = WIRE_BYTES_offers_reply + OFFERS * WIRE_BYTES_offer };

typedef struct offers_script {
  wire_offers_reply fixed;
  size_t payload_bytes;
} offers_script;

/* A script that answers an offers request with offers, and echoes all other requests. */
static void offer(int fd, void *context) {
  const offers_script *script = context;
  uint8_t payload[OFFERS_BYTES + 64] = {0};
  peer_frame request;
  eval_request parsed;
  wire_put_offers_reply(payload, &script->fixed);
  for (unsigned i = 0; i < OFFERS; i++) {
    const wire_offer one = {.model = (uint16_t)(i + 1),
                            .evaluator = DIPOLE_LUT,
                            .meets = i % 2,
                            .error = 0.5 / (i + 1),
                            .numerical_error = 1e-4,
                            .cost = 1.5 + i,
                            .prepare_cost = 2000};
    wire_put_offer(payload + WIRE_BYTES_offers_reply + i * WIRE_BYTES_offer, &one);
  }
  bool good = peer_say_hello(fd);
  while (good && peer_receive(fd, &request)) {
    const bool asked = request.header.type == WIRE_TYPE_OFFERS;
    if (asked &&
        (eval_request_parse(request.payload, request.header.payload_bytes, &parsed).status !=
             WIRE_STATUS_OK ||
         parsed.fixed.model != EVAL_ANY_MODEL ||
         !(parsed.parameters.value[CORE_PARAMETER_TOLERANCE] == 0.01))) {
      abort(); /* The library makes only well-formed requests. */
    }
    good = peer_send(fd, (uint16_t)(request.header.type | WIRE_REPLY), request.header.request_id,
                     asked ? payload : request.payload,
                     asked ? script->payload_bytes : request.header.payload_bytes);
    free(request.payload);
  }
}

static void assert_offers(const dipole_offer *offers) {
  for (unsigned i = 0; i < OFFERS; i++) {
    assert_int_equal(offers[i].model, i + 1);
    assert_int_equal(offers[i].evaluator, DIPOLE_LUT);
    assert_int_equal(offers[i].meets, i == 1);
    assert_true(offers[i].error == 0.5 / (i + 1) && offers[i].numerical_error == 1e-4);
    assert_true(offers[i].cost_ns == 1.5 + i && offers[i].prepare_ns == 2000);
  }
}

/* Runs a script. expected: whether the call must succeed; else it must fail with kind PROTOCOL. */
static void run_offers(offers_script script, bool expected) {
  const dipole_query query = query_of(DIPOLE_ANY_MODEL, DIPOLE_LUT);
  scripted_peer peer;
  dipole_offer *offers = NULL;
  dipole_error error = {0};
  size_t count = 99, taken = 99;
  dipole_client *client = peer_begin(&peer, offer, &script);
  assert_int_equal(dipole_offers(client, &query, &offers, &count, &taken, &error), expected);
  assert_int_equal(dipole_ping(client, NULL), expected);
  if (expected) {
    assert_int_equal(count, script.fixed.count);
    assert_int_equal(taken, script.fixed.taken);
    assert_non_null(offers);
    if (count == OFFERS) {
      assert_offers(offers);
    }
  } else {
    assert_int_equal(error.kind, DIPOLE_ERROR_PROTOCOL);
  }
  free(offers);
  peer_finish(&peer, client);
}

UNIT_TEST(offers_are_listed) {
  for (uint32_t taken = 0; taken <= OFFERS; taken++) {
    run_offers((offers_script){{OFFERS, taken}, OFFERS_BYTES}, true);
  }
  run_offers((offers_script){{0, 0}, WIRE_BYTES_offers_reply}, true);
}

UNIT_TEST(other_answers_are_refused) {
  run_offers((offers_script){{OFFERS, OFFERS + 1}, OFFERS_BYTES}, false);
  run_offers((offers_script){{UINT32_MAX, 0}, OFFERS_BYTES}, false);
  for (size_t bytes = 0; bytes <= OFFERS_BYTES + 64; bytes += 8) {
    run_offers((offers_script){{OFFERS, 1}, bytes}, bytes == OFFERS_BYTES);
  }
}

/* ---- queries of any model ------------------------------------------------------------------ */

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
  scripted_peer peer;
  dipole_result *result = NULL;
  dipole_error error = {0};
  dipole_client *client = peer_begin(&peer, answer_with_choice, &script);
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
  peer_finish(&peer, client);
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
