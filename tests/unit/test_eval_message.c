/* The payloads of eval requests and replies: the offsets of their parts, and that no count can
 * wrap. tests/e2e/test_bad_requests.py tests which status refuses an invalid request. */
#include <math.h>

#include "proto/eval.h"
#include "tests/unit/unit.h"

enum { PAYLOAD_MAX = 4096 };

/* ---- requests ----------------------------------------------------------------------------- */

/* A request that a test builds. */
struct payload {
  _Alignas(8) uint8_t bytes[PAYLOAD_MAX];
  size_t length;
};

static bool is_single(unsigned evaluator) {
  return evaluator == CORE_EVALUATOR_F32 || evaluator == CORE_EVALUATOR_LUT;
}

static wire_eval_request request_of(unsigned evaluator, uint32_t medium_count, unsigned spacing,
                                    uint64_t radius_count) {
  return (wire_eval_request){
      .model = CORE_MODEL_BETTER,
      .evaluator = (uint16_t)evaluator,
      .moments = CORE_MOMENTS_EXACT,
      .wanted = CORE_QUANTITY_R | CORE_QUANTITY_CDF,
      .medium_count = medium_count,
      .spacing = (uint16_t)spacing,
      .radius_count = radius_count,
      .radius_start = spacing == CORE_SPACING_LIST ? 0 : 0.5,
      .radius_stop = spacing == CORE_SPACING_LIST ? 0 : 8,
  };
}

/* Builds a request: the fixed part, `media` media, and `count` radii 1, 2, 3, ... in the precision
 * of the evaluator. */
static void build(struct payload *payload, const wire_eval_request *fixed, size_t media,
                  size_t count) {
  memset(payload, 0, sizeof *payload);
  wire_put_eval_request(payload->bytes, fixed);
  payload->length = WIRE_BYTES_eval_request;
  for (size_t i = 0; i < media; i++) {
    const wire_medium medium = {0.1 * (double)(i + 1), 1, 0, 1.3};
    wire_put_medium(payload->bytes + payload->length, &medium);
    payload->length += WIRE_BYTES_medium;
  }
  for (size_t i = 0; i < count; i++) {
    uint8_t *to = payload->bytes + payload->length;
    if (is_single(fixed->evaluator)) {
      const float r = (float)(i + 1);
      memcpy(to + i * sizeof r, &r, sizeof r);
    } else {
      const double r = (double)(i + 1);
      memcpy(to + i * sizeof r, &r, sizeof r);
    }
  }
  payload->length +=
      wire_padded(count * (is_single(fixed->evaluator) ? sizeof(float) : sizeof(double)));
}

static wire_error parse(const struct payload *payload, eval_request *request) {
  return eval_request_parse(payload->bytes, payload->length, request);
}

static void assert_list_parsed(unsigned evaluator, uint32_t media, size_t count) {
  struct payload payload;
  eval_request request;
  const wire_eval_request fixed = request_of(evaluator, media, CORE_SPACING_LIST, count);
  build(&payload, &fixed, media, count);
  assert_int_equal(parse(&payload, &request).status, WIRE_STATUS_OK);
  assert_int_equal(payload.length, schema_bytes(&schema_eval_request, &fixed));
  assert_memory_equal(&request.fixed, &fixed, sizeof fixed);
  for (uint32_t i = 0; i < media; i++) {
    wire_medium medium;
    wire_get_medium(request.media + i * WIRE_BYTES_medium, &medium);
    assert_true(medium.sigma_a == 0.1 * (double)(i + 1) && medium.eta == 1.3);
  }
  assert_true(count == 0 || (uintptr_t)request.radii % 8 == 0);
  for (size_t i = 0; i < count; i++) {
    const double r = evaluator == CORE_EVALUATOR_F64 ? ((const double *)request.radii)[i]
                                                     : (double)((const float *)request.radii)[i];
    assert_true(r == (double)(i + 1));
  }
}

UNIT_TEST(lists_are_taken_apart) {
  for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
    for (uint32_t media = 1; media <= 4; media++) {
      for (size_t count = 0; count <= 9; count++) {
        assert_list_parsed(evaluator->id, media, count);
      }
    }
  }
}

UNIT_TEST(grids_are_taken_apart) {
  static const unsigned spacings[] = {CORE_SPACING_LINEAR, CORE_SPACING_LOGARITHMIC};
  for (size_t i = 0; i < 2; i++) {
    struct payload payload;
    eval_request request;
    const wire_eval_request fixed = request_of(CORE_EVALUATOR_F32, 3, spacings[i], UINT64_MAX);
    build(&payload, &fixed, 3, 0);
    assert_int_equal(parse(&payload, &request).status, WIRE_STATUS_OK);
    assert_null(request.radii);
    assert_ptr_equal(request.media, payload.bytes + WIRE_BYTES_eval_request);
    assert_true(request.fixed.radius_count == UINT64_MAX);
    assert_int_equal(payload.length, schema_bytes(&schema_eval_request, &fixed));
  }
}

/* ---- parameters --------------------------------------------------------------------------- */

enum { PARAMETERS_MAX = CORE_PARAMETERS_END };

/* Builds a request with two media, these parameters and a list of three radii. */
static void build_with_parameters(struct payload *payload, const wire_parameter *parameters,
                                  size_t count) {
  wire_eval_request fixed = request_of(CORE_EVALUATOR_F32, 2, CORE_SPACING_LIST, 3);
  struct payload without;
  fixed.parameter_count = (uint16_t)count;
  build(&without, &fixed, 2, 3);
  const size_t before = WIRE_BYTES_eval_request + 2 * WIRE_BYTES_medium;
  memset(payload, 0, sizeof *payload);
  memcpy(payload->bytes, without.bytes, before);
  for (size_t i = 0; i < count; i++) {
    wire_put_parameter(payload->bytes + before + i * WIRE_BYTES_parameter, &parameters[i]);
  }
  memcpy(payload->bytes + before + count * WIRE_BYTES_parameter, without.bytes + before,
         without.length - before);
  payload->length = without.length + count * WIRE_BYTES_parameter;
}

static size_t parameter_list_length(void) {
  size_t length = 0;
  while (core_parameter_list[length].name != NULL) {
    length++;
  }
  return length;
}

/* Requests have none to all of the parameters, in the reverse order of the list. A parameter that
 * is not given is NaN, and the radii are found behind the parameters. */
UNIT_TEST(parameters_are_taken_apart) {
  const size_t all = parameter_list_length();
  assert_in_range(all, 1, PARAMETERS_MAX);
  for (size_t count = 0; count <= all; count++) {
    wire_parameter parameters[PARAMETERS_MAX];
    struct payload payload;
    eval_request request;
    for (size_t i = 0; i < count; i++) {
      parameters[i] = (wire_parameter){.parameter = (uint16_t)core_parameter_list[all - 1 - i].id,
                                       .value = i == 0 ? INFINITY : -0.25 * (double)i};
    }
    build_with_parameters(&payload, parameters, count);
    assert_int_equal(payload.length, schema_bytes(&schema_eval_request, payload.bytes));
    assert_int_equal(parse(&payload, &request).status, WIRE_STATUS_OK);
    for (size_t i = 0; i < all; i++) {
      const double value = request.parameters.value[core_parameter_list[all - 1 - i].id];
      assert_true(i < count ? value == parameters[i].value : isnan(value));
    }
    assert_true((uintptr_t)request.radii % 8 == 0);
    assert_true(((const float *)request.radii)[2] == 3);
  }
}

/* ---- replies ------------------------------------------------------------------------------ */

enum { ALL_QUANTITIES = 16383 };

/* The quantities that have an array for each channel, in the order of the arrays. */
static const enum core_quantity order[] = {
    CORE_QUANTITY_R,          CORE_QUANTITY_CDF,         CORE_QUANTITY_SLOPE,
    CORE_QUANTITY_LN_R,       CORE_QUANTITY_PDF,         CORE_QUANTITY_RING,
    CORE_QUANTITY_S,          CORE_QUANTITY_TRANSFER,    CORE_QUANTITY_BY_SIGMA_A,
    CORE_QUANTITY_BY_SIGMA_S, CORE_QUANTITY_MODEL_ERRORS};
enum { ORDER = sizeof order / sizeof order[0] };

static bool has(unsigned wanted, enum core_quantity quantity) {
  return (wanted & quantity) != 0;
}

static unsigned array_count(unsigned wanted) {
  unsigned count = 0;
  for (size_t i = 0; i < ORDER; i++) {
    count += has(wanted, order[i]);
  }
  return count;
}

/* Checks a layout against the order in PROTOCOL.md: the channels, the radii once, then R and cdf
 * for each channel. */
static void assert_layout(unsigned evaluator, unsigned wanted, uint32_t channels, uint64_t count) {
  eval_layout layout;
  const uint64_t array = (count * (evaluator == CORE_EVALUATOR_F64 ? 8 : 4) + 7) / 8 * 8;
  const unsigned errors = (unsigned)__builtin_popcount(wanted);
  uint64_t at = 40 + (8 + 24 * (uint64_t)errors) * channels;
  const uint64_t radii_at = at;
  const unsigned arrays = array_count(wanted);
  const uint64_t bytes = at + array * (has(wanted, CORE_QUANTITY_RADIUS) + arrays * channels);

  assert_true(eval_reply_layout(evaluator, wanted, channels, count, bytes, &layout));
  assert_int_equal(layout.payload_bytes, bytes);
  assert_int_equal(layout.errors_offset, 40 + 8 * channels);
  assert_int_equal(eval_albedo_offset(2), 56);
  assert_int_equal(layout.arrays_per_channel, arrays);
  if (has(wanted, CORE_QUANTITY_RADIUS)) {
    assert_int_equal(layout.radius_offset, radii_at);
    at += array;
  }
  for (uint32_t channel = 0; channel < channels; channel++) {
    for (size_t i = 0; i < ORDER; i++) {
      if (has(wanted, order[i])) {
        assert_int_equal(eval_array_offset(&layout, wanted, channel, order[i]), at);
        at += array;
      }
    }
  }
  assert_int_equal(at, bytes);
  assert_false(eval_reply_layout(evaluator, wanted, channels, count, bytes - 1, &layout));
  assert_false(eval_reply_layout(evaluator, wanted, channels, count, 0, &layout));
}

/* The lists of this file, ALL_QUANTITIES and order, have all quantities of core. */
UNIT_TEST(the_layout_covers_all_quantities) {
  unsigned all = 0, elementwise = 0;
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    all |= quantity->id;
    elementwise += core_quantity_elementwise(quantity->id);
  }
  assert_int_equal(all, ALL_QUANTITIES);
  assert_int_equal(elementwise, ORDER);
}

UNIT_TEST(arrays_lie_where_the_protocol_says) {
  for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
    for (unsigned wanted = 1; wanted <= ALL_QUANTITIES; wanted++) {
      for (uint32_t channels = 1; channels <= 4; channels++) {
        for (uint64_t count = 0; count <= 5; count++) {
          assert_layout(evaluator->id, wanted, channels, count);
        }
      }
    }
  }
}

/* Returns the expected result of eval_reply_layout(), computed in 128 bits so that nothing wraps.
 */
static bool fits(unsigned evaluator, unsigned wanted, uint32_t channels, uint64_t count,
                 uint64_t max_bytes) {
  const unsigned __int128 array =
      ((unsigned __int128)count * core_evaluator_bytes(evaluator) + 7) / 8 * 8;
  const unsigned arrays = array_count(wanted);
  /* at most 2^35 arrays of 2^67 bytes: this fits into 128 bits */
  const unsigned __int128 bytes =
      40 + (8 + 24 * (unsigned)__builtin_popcount(wanted)) * (unsigned __int128)channels +
      array * (has(wanted, CORE_QUANTITY_RADIUS) + (unsigned __int128)arrays * channels);
  return bytes <= max_bytes;
}

static void assert_fits_as_it_should(unsigned evaluator, unsigned wanted, uint32_t channels,
                                     uint64_t count, uint64_t max_bytes) {
  eval_layout layout;
  const bool expected = fits(evaluator, wanted, channels, count, max_bytes);
  if (eval_reply_layout(evaluator, wanted, channels, count, max_bytes, &layout) != expected) {
    fail_msg("evaluator %u wanted %u channels %u count %llu in %llu bytes: fits is %d", evaluator,
             wanted, channels, (unsigned long long)count, (unsigned long long)max_bytes, expected);
  }
}

/* The counts lie on both sides of every limit at which a product could wrap. */
UNIT_TEST(layouts_do_not_wrap) {
  static const uint64_t limits[] = {4096,           UINT32_MAX,      (uint64_t)1 << 40,
                                    UINT64_MAX / 2, UINT64_MAX - 65, UINT64_MAX};
  static const uint32_t channels[] = {1, 2, 3, 5, 1u << 27, UINT32_MAX - 1, UINT32_MAX};
  uint64_t random = unit_seed();
  for (int i = 0; i < 200000; i++) {
    const unsigned evaluator = i % 2 ? CORE_EVALUATOR_F64 : CORE_EVALUATOR_F32;
    const unsigned wanted = 1 + (unsigned)unit_random_below(&random, ALL_QUANTITIES);
    const uint32_t channel_count = channels[unit_random_below(&random, 7)];
    const uint64_t limit = limits[unit_random_below(&random, 6)];
    const unsigned arrays = array_count(wanted);
    const uint64_t all = has(wanted, CORE_QUANTITY_RADIUS) + (uint64_t)arrays * channel_count;
    /* counts near the largest one that fits, near a wrap, or random */
    const uint64_t largest = limit / (all > 0 ? all : 1) / core_evaluator_bytes(evaluator);
    const uint64_t bases[] = {largest, (uint64_t)1 << (58 + i % 6), unit_random(&random), 0};
    const uint64_t count = bases[i % 4] + unit_random_below(&random, 40) - 20;
    assert_fits_as_it_should(evaluator, wanted, channel_count, count, limit);
  }
}

static size_t build_reply(uint8_t *bytes, wire_eval_reply fixed) {
  eval_layout layout;
  assert_true(eval_reply_layout(fixed.evaluator, fixed.wanted, fixed.channel_count, fixed.count,
                                PAYLOAD_MAX, &layout));
  memset(bytes, 0, PAYLOAD_MAX);
  wire_put_eval_reply(bytes, &fixed);
  return (size_t)layout.payload_bytes;
}

static const wire_eval_reply good_reply = {
    .model = CORE_MODEL_BETTER,
    .evaluator = CORE_EVALUATOR_F32,
    .moments = CORE_MOMENTS_EXACT,
    .wanted = CORE_QUANTITY_R | CORE_QUANTITY_CDF | CORE_QUANTITY_RADIUS,
    .channel_count = 3,
    .notes = CORE_NOTE_SIMILARITY,
    .count = 7,
    .first = 256,
    .part = 1,
    .part_count = 3,
};

UNIT_TEST(replies_are_taken_apart) {
  uint8_t bytes[PAYLOAD_MAX];
  const size_t right = build_reply(bytes, good_reply);
  for (size_t length = 0; length < right + 64; length++) {
    wire_eval_reply fixed;
    eval_layout layout;
    assert_int_equal(eval_reply_parse(bytes, length, false, &fixed, &layout), length == right);
    if (length == right) {
      assert_memory_equal(&fixed, &good_reply, sizeof fixed);
      assert_int_equal(layout.payload_bytes, right);
    }
  }
}

/* A client must not trust a daemon's counts: it refuses replies of another shape. */
UNIT_TEST(replies_of_another_shape_are_refused) {
  uint8_t bytes[PAYLOAD_MAX];
  eval_layout layout;
  const size_t right = build_reply(bytes, good_reply);
#define REFUSED(member, value)                                                                     \
  do {                                                                                             \
    wire_eval_reply fixed = good_reply;                                                            \
    fixed.member = (value);                                                                        \
    wire_put_eval_reply(bytes, &fixed);                                                            \
    assert_false(eval_reply_parse(bytes, right, false, &fixed, &layout));                          \
  } while (0)
  REFUSED(channel_count, 4);
  REFUSED(channel_count, UINT32_MAX);
  REFUSED(count, 9);
  REFUSED(count, UINT64_MAX);
  REFUSED(count, (UINT64_C(1) << 62) + 7);
  REFUSED(evaluator, 0);
  REFUSED(evaluator, CORE_EVALUATOR_F64);
  REFUSED(wanted, good_reply.wanted | 0x4000);
  REFUSED(part, 3);
  REFUSED(part_count, 0);
#undef REFUSED
}

/* eval_part_radii() returns the largest multiple of EVAL_PART_RADII that fits. */
UNIT_TEST(parts_are_as_large_as_they_may_be) {
  uint64_t random = unit_seed();
  size_t none = 0;
  for (int i = 0; i < 20000; i++) {
    const unsigned evaluator = i % 2 ? CORE_EVALUATOR_F64 : CORE_EVALUATOR_F32;
    const unsigned wanted = 1 + (unsigned)unit_random_below(&random, ALL_QUANTITIES);
    const uint32_t channels = 1 + (uint32_t)unit_random_below(&random, 64);
    const uint64_t most = 4096 + unit_random_below(&random, i % 3 ? 1 << 20 : 1 << 14);
    const uint64_t radii = eval_part_radii(evaluator, wanted, channels, most);
    if (array_count(wanted) == 0 && !has(wanted, CORE_QUANTITY_RADIUS)) {
      assert_true(radii == UINT64_MAX);
      continue;
    }
    assert_int_equal(radii % EVAL_PART_RADII, 0);
    assert_true(fits(evaluator, wanted, channels, radii, most) || radii == 0);
    assert_false(fits(evaluator, wanted, channels, radii + EVAL_PART_RADII, most));
    none += radii == 0;
  }
  assert_true(none > 0);
  assert_true(eval_part_radii(CORE_EVALUATOR_F64, CORE_QUANTITY_ALBEDO, 200, 4096) == 0);
  assert_int_equal(eval_part_radii(CORE_EVALUATOR_F64, CORE_QUANTITY_R, 1, 4096), 256);
}

UNIT_TEST(values_have_their_sizes) {
  assert_int_equal(core_evaluator_bytes(CORE_EVALUATOR_F64), 8);
  assert_int_equal(core_evaluator_bytes(CORE_EVALUATOR_F32), 4);
  assert_int_equal(core_evaluator_bytes(CORE_EVALUATOR_LUT), 4);
  assert_int_equal(core_evaluator_bytes(0), 0);
  assert_int_equal(core_evaluator_bytes(UINT32_MAX), 0);
  assert_int_equal(wire_padded(0), 0);
  assert_int_equal(wire_padded(1), 8);
  assert_int_equal(wire_padded(8), 8);
  assert_int_equal(wire_padded(9), 16);
}
