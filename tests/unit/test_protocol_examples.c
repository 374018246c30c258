/* The examples of PROTOCOL.md: whole frames, of every message, that say what the codec and the core
 * say. (That a daemon answers so is tested from outside.) */
#include <ctype.h>
#include <math.h>

#include "core/inversion.h"
#include "core/lut/lut.h"
#include "proto/invert.h"
#include "proto/sample.h"
#include "proto/table.h"
#include "tests/unit/unit.h"

enum { EXAMPLES_MAX = 64, FRAME_MAX = 4096, NAME_MAX_BYTES = 64, LIMIT_BYTES = 1 << 20 };
#define FENCE "```hex "

struct example {
  char name[NAME_MAX_BYTES];
  _Alignas(8) uint8_t bytes[FRAME_MAX]; /* the header's 24 bytes leave the payload aligned */
  size_t length;
  wire_header header;
};

static struct example examples[EXAMPLES_MAX];
static size_t example_count;

/* ---- reading ------------------------------------------------------------------------------ */

/* A line of hexadecimal bytes; # starts a comment. */
static void read_line(struct example *example, const char *at, const char *end) {
  while (at < end && *at != '#') {
    if (isspace((unsigned char)*at)) {
      at++;
      continue;
    }
    assert_true(end - at >= 2 && isxdigit((unsigned char)at[0]) && isxdigit((unsigned char)at[1]));
    assert_true(example->length < FRAME_MAX);
    const char digits[3] = {at[0], at[1], '\0'};
    example->bytes[example->length++] = (uint8_t)strtoul(digits, NULL, 16);
    at += 2;
  }
}

/* A fenced block, from after its fence to its end, which is returned. */
static const char *read_block(struct example *example, const char *at) {
  const size_t name_length = strcspn(at, "\n");
  assert_in_range(name_length, 1, NAME_MAX_BYTES - 1);
  memcpy(example->name, at, name_length);
  at += name_length + 1;
  while (strncmp(at, "```", 3) != 0) {
    const char *end = strchr(at, '\n');
    assert_non_null(end);
    read_line(example, at, end);
    at = end + 1;
  }
  return at + 3;
}

UNIT_SETUP(read_examples) {
  char *document = unit_read_file("proto/PROTOCOL.md");
  assert_non_null(document);
  const char *at = document;
  while ((at = strstr(at, FENCE)) != NULL) {
    assert_true(example_count < EXAMPLES_MAX);
    struct example *example = &examples[example_count++];
    at = read_block(example, at + strlen(FENCE));
    if (example->length >= WIRE_BYTES_header) {
      wire_get_header(example->bytes, &example->header);
    }
  }
  free(document);
}

/* The one example of this name. */
static const struct example *example_named(const char *name) {
  const struct example *found = NULL;
  for (size_t i = 0; i < example_count; i++) {
    if (strcmp(examples[i].name, name) == 0) {
      assert_null(found);
      found = &examples[i];
    }
  }
  if (found == NULL) {
    fail_msg("PROTOCOL.md has no example %s", name);
  }
  return found;
}

static bool ends_with(const char *text, const char *end) {
  const size_t length = strlen(text);
  return length >= strlen(end) && strcmp(text + length - strlen(end), end) == 0;
}

static const uint8_t *payload_of(const struct example *example) {
  return example->bytes + WIRE_BYTES_header;
}

/* ---- all of them -------------------------------------------------------------------------- */

UNIT_TEST(examples_are_whole_frames) {
  assert_true(example_count > 0);
  for (size_t i = 0; i < example_count; i++) {
    const struct example *example = &examples[i];
    assert_true(example->length >= WIRE_BYTES_header);
    assert_int_equal(wire_header_check(&example->header, LIMIT_BYTES).status, WIRE_STATUS_OK);
    assert_int_equal(example->length, WIRE_BYTES_header + example->header.payload_bytes);
    assert_string_not_equal(wire_type_name(example->header.type), "unknown");
    const bool is_reply = (example->header.type & WIRE_REPLY) != 0;
    assert_int_equal(is_reply, ends_with(example->name, "-reply"));
    assert_int_equal(!is_reply, ends_with(example->name, "-request"));
  }
}

UNIT_TEST(every_message_has_a_request) {
#define WIRE_MESSAGE(type_id, IDENT, message_name)                                                 \
  assert_int_equal(example_named(message_name "-request")->header.type, type_id);
#include "proto/messages.def"
}

/* NAME-reply answers NAME-request: same id, and the type plus 0x8000 or an error. */
UNIT_TEST(replies_answer_their_requests) {
  size_t replies = 0;
  for (size_t i = 0; i < example_count; i++) {
    const struct example *reply = &examples[i];
    if (!ends_with(reply->name, "-reply")) {
      continue;
    }
    char request_name[NAME_MAX_BYTES + 8];
    snprintf(request_name, sizeof request_name, "%.*s-request",
             (int)(strlen(reply->name) - strlen("-reply")), reply->name);
    const struct example *request = example_named(request_name);
    assert_int_equal(reply->header.request_id, request->header.request_id);
    if (reply->header.type != WIRE_TYPE_ERROR) {
      assert_int_equal(reply->header.type, request->header.type | WIRE_REPLY);
    }
    replies++;
  }
  assert_true(replies > 0);
}

/* ---- each of them ------------------------------------------------------------------------- */

UNIT_TEST(hello_agrees_on_this_version) {
  const struct example *example = example_named("hello-request");
  wire_hello_request hello;
  assert_int_equal(example->header.payload_bytes, WIRE_BYTES_hello_request);
  wire_get_hello_request(payload_of(example), &hello);
  assert_true(hello.version_min <= WIRE_VERSION && hello.version_max >= WIRE_VERSION);
  assert_int_equal(hello.zero, 0);
}

UNIT_TEST(empty_requests_are_empty) {
  assert_int_equal(example_named("media-request")->header.payload_bytes, 0);
  assert_int_equal(example_named("statistics-request")->header.payload_bytes, 0);
}

UNIT_TEST(ping_comes_back) {
  const struct example *request = example_named("ping-request");
  const struct example *reply = example_named("ping-reply");
  assert_true(request->header.payload_bytes <= WIRE_PING_MAX_BYTES);
  assert_int_equal(reply->length, request->length);
  assert_memory_equal(payload_of(reply), payload_of(request), request->header.payload_bytes);
}

/* The example is the red channel of skin1, evaluated at listed radii in double precision. */
UNIT_TEST(eval_request_asks_for_skin) {
  const struct example *example = example_named("eval-request");
  eval_request request;
  assert_int_equal(
      eval_request_parse(payload_of(example), example->header.payload_bytes, &request).status,
      WIRE_STATUS_OK);
  assert_int_equal(request.fixed.evaluator, CORE_EVALUATOR_F64);
  assert_int_equal(request.fixed.spacing, CORE_SPACING_LIST);
  assert_true(request.fixed.radius_count > 0);
  unit_assert_fault(core_radii_check_f64((size_t)request.fixed.radius_count, request.radii), NULL,
                    0);
  wire_medium medium;
  wire_get_medium(request.media, &medium);
  const core_medium *skin = &core_measured_medium_by_name("skin1")->channel[0];
  assert_true(medium.sigma_a == skin->sigma_a_per_mm && medium.sigma_s == skin->sigma_s_per_mm);
  assert_true(medium.g == skin->g && medium.eta == skin->eta);
}

/* The same medium, and parameters for both angles of S. */
UNIT_TEST(parameter_request_asks_for_S) {
  const struct example *example = example_named("parameter-request");
  eval_request request;
  assert_int_equal(
      eval_request_parse(payload_of(example), example->header.payload_bytes, &request).status,
      WIRE_STATUS_OK);
  assert_int_equal(request.fixed.wanted, CORE_QUANTITY_S);
  assert_int_equal(request.fixed.parameter_count, 2);
  const double cos_in = request.parameters.value[CORE_PARAMETER_COS_IN];
  const double cos_out = request.parameters.value[CORE_PARAMETER_COS_OUT];
  assert_true(cos_in > 0 && cos_in < 1 && cos_out > 0 && cos_out < 1 && cos_in != cos_out);
}

/* Of a medium that tables can be made of, to a tolerance that they keep. */
UNIT_TEST(table_request_asks_for_a_tolerance) {
  const struct example *example = example_named("table-request");
  table_request request;
  assert_int_equal(
      table_request_parse(payload_of(example), example->header.payload_bytes, &request).status,
      WIRE_STATUS_OK);
  unit_assert_fault(core_profile_check(request.fixed.model, request.fixed.moments,
                                       CORE_EVALUATOR_LUT, &request.medium, &request.parameters,
                                       NULL),
                    NULL, 0);
  assert_true(request.parameters.value[CORE_PARAMETER_TOLERANCE] >= CORE_LUT_TOLERANCE_MIN);
}

UNIT_TEST(offers_request_names_no_model) {
  const struct example *example = example_named("offers-request");
  eval_request request;
  assert_int_equal(
      eval_request_parse(payload_of(example), example->header.payload_bytes, &request).status,
      WIRE_STATUS_OK);
  assert_int_equal(request.fixed.model, EVAL_ANY_MODEL);
  assert_true(request.parameters.value[CORE_PARAMETER_TOLERANCE] > 0);
}

/* Every bit of the reply is what the core computes for the request. */
static void assert_channel(const wire_channel *channel, const core_profile *profile,
                           unsigned wanted) {
  const bool albedo = (wanted & CORE_QUANTITY_ALBEDO) != 0;
  assert_true(albedo ? channel->albedo == profile->albedo : isnan(channel->albedo));
  assert_true(channel->numerical_error == profile->numerical_error);
  assert_true(channel->numerical_error_per_mm == profile->numerical_error_per_mm);
  assert_true(isnan(channel->model_error) == isnan(profile->model_error));
}

/* One medium, in double precision. */
static void assert_holds_the_cores_values(const char *request_name, const char *reply_name) {
  enum { RADII_MAX = 64 };
  const struct example *example = example_named(request_name);
  const struct example *answer = example_named(reply_name);
  const uint8_t *payload = payload_of(answer);
  eval_request request;
  wire_eval_reply reply;
  eval_layout layout;
  wire_channel channel;
  wire_medium wire;
  core_profile profile;
  double values[RADII_MAX];
  eval_request_parse(payload_of(example), example->header.payload_bytes, &request);
  const size_t n = (size_t)request.fixed.radius_count;
  assert_true(n <= RADII_MAX);
  assert_true(eval_reply_parse(payload, answer->header.payload_bytes, false, &reply, &layout));
  assert_int_equal(reply.model, request.fixed.model);
  assert_int_equal(reply.wanted, request.fixed.wanted);
  assert_int_equal(reply.channel_count, request.fixed.medium_count);
  assert_int_equal(reply.radius_count, n);

  wire_get_medium(request.media, &wire);
  const core_medium medium = {wire.sigma_a, wire.sigma_s, wire.g, wire.eta};
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select("portable"), request.fixed.model,
                                         request.fixed.moments, request.fixed.evaluator, &medium,
                                         &request.parameters),
                    NULL, 0);
  wire_get_channel(payload + layout.channels_offset, &channel);
  assert_channel(&channel, &profile, reply.wanted);
  assert_int_equal(reply.notes, profile.notes);
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    if (eval_is_array(reply.wanted, quantity->id)) {
      core_eval_f64(&profile, quantity->id, n, request.radii, values);
      assert_memory_equal(payload + eval_array_offset(&layout, reply.wanted, 0, quantity->id),
                          values, n * sizeof *values);
    }
  }
  core_profile_free(&profile);
}

UNIT_TEST(eval_replies_hold_the_cores_values) {
  assert_holds_the_cores_values("eval-request", "eval-reply");
  assert_holds_the_cores_values("parameter-request", "parameter-reply");
}

/* Radii of one medium, drawn by rule, and their densities, in double precision. */
UNIT_TEST(sample_reply_holds_the_cores_radii) {
  enum { COUNT_MAX = 16 };
  const struct example *example = example_named("sample-request");
  const struct example *answer = example_named("sample-reply");
  const uint8_t *payload = payload_of(answer);
  core_draw draw;
  eval_request request;
  wire_eval_reply reply;
  eval_layout layout;
  wire_medium wire;
  core_profile profile;
  double u[COUNT_MAX], r[COUNT_MAX], pdf[COUNT_MAX];
  assert_int_equal(
      sample_request_parse(payload_of(example), example->header.payload_bytes, &draw, &request)
          .status,
      WIRE_STATUS_OK);
  unit_assert_fault(core_draw_check(&draw), NULL, 0);
  assert_true(draw.rule != CORE_DRAW_LIST && draw.count <= COUNT_MAX);
  assert_true(eval_reply_parse(payload, answer->header.payload_bytes, true, &reply, &layout));
  assert_int_equal(reply.wanted, CORE_QUANTITY_RADIUS | CORE_QUANTITY_PDF);
  assert_int_equal(reply.radius_count, draw.count);

  wire_get_medium(request.media, &wire);
  const core_medium medium = {wire.sigma_a, wire.sigma_s, wire.g, wire.eta};
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select("portable"), request.fixed.model,
                                         request.fixed.moments, request.fixed.evaluator, &medium,
                                         &request.parameters),
                    NULL, 0);
  const size_t n = (size_t)draw.count;
  core_draw_f64(&draw, 0, n, u);
  core_sample_f64(&profile, n, u, r);
  core_eval_f64(&profile, CORE_QUANTITY_PDF, n, r, pdf);
  const unsigned wanted = reply.wanted | EVAL_DRAWN;
  assert_memory_equal(payload + eval_array_offset(&layout, wanted, 0, CORE_QUANTITY_RADIUS), r,
                      n * sizeof *r);
  assert_memory_equal(payload + eval_array_offset(&layout, wanted, 0, CORE_QUANTITY_PDF), pdf,
                      n * sizeof *pdf);
  core_profile_free(&profile);
}

static double albedo_of(const invert_request *request, const core_medium *medium) {
  core_profile profile;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select("portable"),
                                         request->fixed.model, request->fixed.moments,
                                         CORE_EVALUATOR_F64, medium, NULL),
                    NULL, 0);
  const double albedo = profile.albedo;
  core_profile_free(&profile);
  return albedo;
}

/* The media have the albedos that were asked for, and the lengths, by the formula of the text. */
UNIT_TEST(invert_reply_holds_media_as_wanted) {
  const struct example *example = example_named("invert-request");
  const struct example *answer = example_named("invert-reply");
  const uint8_t *payload = payload_of(answer);
  invert_request request;
  wire_invert_reply reply;
  assert_int_equal(
      invert_request_parse(payload_of(example), example->header.payload_bytes, &request).status,
      WIRE_STATUS_OK);
  assert_true(invert_reply_parse(payload, answer->header.payload_bytes, &reply));
  assert_int_equal(request.fixed.given, CORE_LENGTH_DIFFUSE);
  assert_int_equal(reply.medium_count, request.fixed.medium_count);
  const double *array[INVERT_ARRAYS];
  for (unsigned i = 0; i < INVERT_ARRAYS; i++) {
    array[i] = (const double *)(const void *)(payload + invert_array_offset(i, reply.medium_count));
  }
  for (size_t i = 0; i < reply.medium_count; i++) {
    const core_medium medium = {array[INVERT_SIGMA_A][i], array[INVERT_SIGMA_S][i], request.fixed.g,
                                request.fixed.eta};
    assert_true(array[INVERT_ALBEDO][i] == albedo_of(&request, &medium));
    assert_true(fabs(array[INVERT_ALBEDO][i] - request.albedos[i]) <= 1e-12 * request.albedos[i]);
    const double sigma_t_prime = medium.sigma_a_per_mm + medium.sigma_s_per_mm * (1 - medium.g);
    const double absorbed = medium.sigma_a_per_mm / sigma_t_prime;
    const double length = 1 / (sigma_t_prime * sqrt(3 * absorbed / (1 + absorbed)));
    assert_true(fabs(length - request.lengths[i]) <= 1e-14 * request.lengths[i]);
  }
}

/* The request has the right shape; it is the core that refuses its medium, as the reply says. */
UNIT_TEST(the_error_is_the_cores) {
  const struct example *example = example_named("error-request");
  const struct example *answer = example_named("error-reply");
  eval_request request;
  assert_int_equal(
      eval_request_parse(payload_of(example), example->header.payload_bytes, &request).status,
      WIRE_STATUS_OK);
  wire_medium wire;
  wire_get_medium(request.media, &wire);
  const core_medium medium = {wire.sigma_a, wire.sigma_s, wire.g, wire.eta};
  const core_fault fault = core_medium_check(&medium);
  assert_non_null(fault.field);

  wire_error error;
  assert_int_equal(answer->header.type, WIRE_TYPE_ERROR);
  assert_int_equal(answer->header.payload_bytes, WIRE_BYTES_error);
  wire_get_error(payload_of(answer), &error);
  assert_int_equal(error.status, WIRE_STATUS_BAD_VALUE);
  assert_string_equal(error.field, fault.field);
  assert_string_equal(error.allowed, fault.allowed);
  assert_int_equal(error.index, 0);
  assert_int_equal(error.retry_after_ms, 0);
}
