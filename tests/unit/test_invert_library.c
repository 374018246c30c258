/* dipole_invert() and dipole_sample_numbers(): the parts of answers are put together, and wrong answers
 * are refused. */
#include "proto/eval.h"
#include "proto/schema.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

enum { MEDIA = 7, PAYLOAD_MAX = 4096 };

static const double albedos[MEDIA] = {.1, .2, .3, .4, .5, .6, .7};
static const double lengths_mm[MEDIA] = {1, 2, 3, 4, 5, 6, 7};

static const dipole_invert_query query = {.model = 2,
                                          .moments = DIPOLE_EXACT,
                                          .given = DIPOLE_DIFFUSE_MEAN_FREE_PATH,
                                          .g = 0.5,
                                          .eta = 1.4,
                                          .albedos = albedos,
                                          .lengths_mm = lengths_mm,
                                          .medium_count = MEDIA};

/* ---- inversions ---------------------------------------------------------------------------- */

/* How the peer answers a request: in parts of counts[0], counts[1], ... media, up to a count of 0.
 */
typedef struct invert_script {
  uint64_t counts[MEDIA + 2];
  enum { HONEST, ANOTHER_REACH, ANOTHER_MODEL, NO_ERRORS, TOO_MANY_MISSING } lie; /* last part */
} invert_script;

/* Sends a part with made-up media: sigma_a is the wanted albedo, sigma_s the length, the albedo is
 * 2 sigma_a, and the errors are 3, 4 and 5 sigma_a. */
static bool send_part(int fd, const peer_frame *frame, const double *request,
                      wire_invert_reply fixed, const invert_script *script) {
  uint8_t payload[PAYLOAD_MAX] = {0};
  size_t bytes = (size_t)schema_bytes(&schema_invert_reply, &fixed);
  for (uint64_t i = 0; i < fixed.count; i++) {
    const uint64_t at = (fixed.first + i) % MEDIA; /* A wrong part may have too many. */
    const double albedo = request[at];
    const double values[] = {albedo,     request[MEDIA + at], 2 * albedo,
                             3 * albedo, 4 * albedo,          5 * albedo};
    for (size_t a = 0; a < 6; a++) {
      memcpy(payload + WIRE_BYTES_invert_reply + (a * fixed.count + i) * sizeof(double), &values[a],
             sizeof(double));
    }
  }
  if (script->lie != HONEST && fixed.part + 1 == fixed.part_count) {
    fixed.albedo_most -= script->lie == ANOTHER_REACH ? 0.125 : 0;
    fixed.model = (uint16_t)(fixed.model + (script->lie == ANOTHER_MODEL));
    fixed.errors = (uint16_t)(script->lie == NO_ERRORS ? 0 : fixed.errors);
    bytes -= script->lie == NO_ERRORS ? 3 * fixed.count * sizeof(double) : 0;
    fixed.missing_count = script->lie == TOO_MANY_MISSING ? fixed.count + 1 : fixed.missing_count;
  }
  wire_put_invert_reply(payload, &fixed);
  return peer_send(fd, WIRE_TYPE_INVERT | WIRE_REPLY, frame->header.request_id, payload, bytes);
}

static bool answer_invert(int fd, const peer_frame *frame, const invert_script *script) {
  wire_invert_request request;
  schema_layout layout;
  if (schema_check(&schema_invert_request, frame->payload, frame->header.payload_bytes, &layout)
          .status != WIRE_STATUS_OK) {
    abort(); /* The library makes only well-formed requests. */
  }
  wire_get_invert_request(frame->payload, &request);
  uint32_t parts = 0;
  while (script->counts[parts] > 0) {
    parts++;
  }
  uint64_t first = 0;
  for (uint32_t part = 0; part < parts; part++) {
    const wire_invert_reply fixed = {.model = request.model,
                                     .moments = request.moments,
                                     .given = request.given,
                                     .errors = request.errors,
                                     .part = part,
                                     .part_count = parts,
                                     .count = script->counts[part],
                                     .first = first,
                                     .missing_count = part % 2,
                                     .albedo_least = 0.125,
                                     .albedo_most = 0.875};
    if (!send_part(fd, frame, (const void *)(frame->payload + layout.parts[0].at), fixed, script)) {
      return false;
    }
    first += script->counts[part];
  }
  return true;
}

static void invert(int fd, void *context) {
  peer_frame request;
  bool good = peer_say_hello(fd);
  while (good && peer_receive(fd, &request)) {
    good =
        request.header.type == WIRE_TYPE_INVERT
            ? answer_invert(fd, &request, context)
            : peer_send(fd, (uint16_t)(request.header.type | WIRE_REPLY), request.header.request_id,
                        request.payload, request.header.payload_bytes);
    free(request.payload);
  }
}

static void assert_inversion(const dipole_inversion *inversion, uint64_t missing) {
  assert_int_equal(inversion->medium_count, MEDIA);
  assert_int_equal(inversion->missing_count, missing);
  assert_true(inversion->albedo_least == 0.125 && inversion->albedo_most == 0.875);
  assert_memory_equal(inversion->sigma_a_per_mm, albedos, sizeof albedos);
  assert_memory_equal(inversion->sigma_s_per_mm, lengths_mm, sizeof lengths_mm);
  for (size_t i = 0; i < MEDIA; i++) {
    assert_true(inversion->albedos[i] == 2 * albedos[i]);
    assert_true(inversion->sigma_a_errors_per_mm[i] == 3 * albedos[i]);
    assert_true(inversion->sigma_s_errors_per_mm[i] == 4 * albedos[i]);
    assert_true(inversion->model_errors[i] == 5 * albedos[i]);
  }
}

/* Runs a script. expected: whether the call must succeed; else it must fail with kind PROTOCOL. */
static void run_invert(invert_script script, bool expected, uint64_t missing) {
  dipole_inversion *inversion = NULL;
  dipole_error error = {0};
  dipole_client *client = peer_begin(invert, &script);
  dipole_set_retry_ms(client, 0);
  assert_int_equal(dipole_invert(client, &query, &inversion, &error), expected);
  assert_int_equal(dipole_ping(client, NULL), expected);
  if (expected) {
    assert_inversion(inversion, missing);
  } else {
    assert_int_equal(error.kind, DIPOLE_ERROR_PROTOCOL);
    assert_null(inversion);
  }
  dipole_inversion_free(inversion);
  peer_finish(client);
}

UNIT_TEST(inversions_of_any_number_of_parts_are_put_together) {
  run_invert((invert_script){.counts = {MEDIA}}, true, 0);
  run_invert((invert_script){.counts = {3, 4}}, true, 1);
  run_invert((invert_script){.counts = {1, 1, 1, 1, 1, 1, 1}}, true, 3);
}

/* test_messages.py tells lies about the numbers of parts. */
UNIT_TEST(inversions_with_another_shape_end_the_connection) {
  for (unsigned lie = ANOTHER_REACH; lie <= TOO_MANY_MISSING; lie++) {
    run_invert((invert_script){.counts = {3, 4}, .lie = lie}, false, 0);
  }
  run_invert((invert_script){.counts = {MEDIA + 1}}, false, 0);
  run_invert((invert_script){.counts = {MEDIA - 1}}, false, 0);
}

/* ---- samples ------------------------------------------------------------------------------- */

enum { SAMPLES = 600 };

UNIT_TEST(numbers_are_the_cores) {
  const core_draw draw = {CORE_DRAW_RANDOM, SAMPLES, 0, 7};
  dipole_sample_query drawn = {
      .evaluator = DIPOLE_F64, .draw = DIPOLE_DRAW_RANDOM, .sample_count = SAMPLES, .seed = 7};
  double u[SAMPLES], wanted[SAMPLES];
  float u_f32[SAMPLES], wanted_f32[SAMPLES];
  assert_true(dipole_sample_numbers(&drawn, 0, SAMPLES, u, NULL));
  core_draw_f64(&draw, 0, SAMPLES, wanted);
  assert_memory_equal(u, wanted, sizeof u);
  drawn.evaluator = DIPOLE_LUT;
  assert_true(dipole_sample_numbers(&drawn, 10, SAMPLES - 10, u_f32, NULL));
  core_draw_f32(&draw, 10, SAMPLES - 10, wanted_f32);
  assert_memory_equal(u_f32, wanted_f32, (SAMPLES - 10) * sizeof(float));
}
