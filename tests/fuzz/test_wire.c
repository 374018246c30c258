/* Feeds the decoders of proto/ bytes that nobody should send. Each input lies in a heap buffer of
 * exactly its size, so that the address sanitizer sees a read past its end. The same seed gives the
 * same inputs; DIPOLED_TEST_SEED in the environment chooses another. */
#include <math.h>

#include "proto/invert.h"
#include "proto/mc.h"
#include "proto/sample.h"
#include "proto/table.h"
#include "proto/wire.h"
#include "tests/unit/unit.h"

enum { ROUNDS = 300000, MEDIA_MAX = 5, PARAMETERS_MAX = 4, RADII_MAX = 9, PAYLOAD_MAX = 4096 };

static uint64_t random_state;

UNIT_SETUP(seed) {
  random_state = unit_seed();
}

/* ---- inputs --------------------------------------------------------------------------------- */

struct bytes {
  size_t length;
  uint8_t at[PAYLOAD_MAX];
};

static uint16_t random_id(const core_choice *list) {
  size_t length = 0;
  while (list[length].name != NULL) {
    length++;
  }
  return (uint16_t)list[unit_random_below(&random_state, length)].id;
}

/* The bits of all quantities. */
static unsigned quantity_bits(void) {
  unsigned bits = 0;
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    bits |= quantity->id;
  }
  return bits;
}

/* Writes `count` different parameters, from a random place of the list on. */
static void put_parameters(uint8_t *to, size_t count) {
  size_t length = 0;
  while (core_parameter_list[length].name != NULL) {
    length++;
  }
  const size_t first = unit_random_below(&random_state, length);
  assert_true(count <= length);
  for (size_t i = 0; i < count; i++) {
    const wire_parameter parameter = {
        .parameter = (uint16_t)core_parameter_list[(first + i) % length].id, .value = 0.5};
    wire_put_parameter(to + i * WIRE_BYTES_parameter, &parameter);
  }
}

/* A payload that is right: some media, parameters, and radii by list or by rule. */
static void make_request(struct bytes *to) {
  const uint32_t medium_count = (uint32_t)(1 + unit_random_below(&random_state, MEDIA_MAX));
  const uint32_t parameter_count = (uint32_t)unit_random_below(&random_state, PARAMETERS_MAX + 1);
  const bool list = unit_random_below(&random_state, 3) != 0;
  wire_eval_request fixed = {
      .model = random_id(core_models),
      .evaluator = random_id(core_evaluators),
      .moments = random_id(core_moments_list),
      .wanted = (uint16_t)(1 + unit_random_below(&random_state, quantity_bits())),
      .medium_count = medium_count,
      .spacing = list ? CORE_SPACING_LIST : CORE_SPACING_LINEAR,
      .parameter_count = (uint16_t)parameter_count,
      .radius_count = unit_random_below(&random_state, RADII_MAX + 1),
      .radius_stop = list ? 0 : 1,
  };
  const size_t radii_bytes =
      list ? (size_t)fixed.radius_count * core_evaluator_bytes(fixed.evaluator) : 0;
  memset(to, 0, sizeof *to);
  to->length = (size_t)eval_request_bytes(medium_count, parameter_count, radii_bytes);
  wire_put_eval_request(to->at, &fixed);
  for (uint32_t i = 0; i < medium_count; i++) {
    const wire_medium medium = {.sigma_a = 0.1, .sigma_s = 1, .g = 0, .eta = 1.3};
    wire_put_medium(to->at + WIRE_BYTES_eval_request + i * WIRE_BYTES_medium, &medium);
  }
  put_parameters(to->at + eval_request_bytes(medium_count, 0, 0), parameter_count);
  memset(to->at + eval_request_bytes(medium_count, parameter_count, 0), 0x3f, radii_bytes);
}

/* A reply that is right; its values are any bytes. */
static void make_reply(struct bytes *to) {
  const wire_eval_reply fixed = {
      .model = 1,
      .evaluator = random_id(core_evaluators),
      .moments = 1,
      .wanted = (uint16_t)unit_random_below(&random_state, quantity_bits() + 1),
      .channel_count = (uint32_t)unit_random_below(&random_state, MEDIA_MAX + 1),
      .radius_count = unit_random_below(&random_state, RADII_MAX + 1),
      .radius_first = unit_random_below(&random_state, 2) * unit_random(&random_state),
      .part_count = (uint32_t)(1 + unit_random_below(&random_state, 3)),
  };
  eval_layout layout;
  assert_true(eval_reply_layout(fixed.evaluator, fixed.wanted, fixed.channel_count,
                                fixed.radius_count, PAYLOAD_MAX, &layout));
  memset(to, 0x40, sizeof *to);
  to->length = (size_t)layout.payload_bytes;
  wire_put_eval_reply(to->at, &fixed);
}

/* A count near a power of two, where arithmetic could wrap. */
static uint64_t interesting(void) {
  static const uint64_t edges[] = {
      0,          1,          2,          8,          0x7fff,     0x8000,
      0xffff,     0x08000000, 0x7fffffff, 0x80000000, 0xffffffff, UINT64_C(0x100000000),
      1ull << 53, 1ull << 60, 1ull << 61, 1ull << 62, 1ull << 63, UINT64_MAX};
  return edges[unit_random_below(&random_state, sizeof edges / sizeof edges[0])] +
         unit_random_below(&random_state, 5) - 2;
}

static void mutate_once(struct bytes *bytes) {
  static const size_t widths[] = {1, 2, 4, 8};
  const size_t width = widths[unit_random_below(&random_state, 4)];
  const uint64_t value = interesting();
  switch (unit_random_below(&random_state, 5)) {
  case 0: /* one bit */
    if (bytes->length > 0) {
      bytes->at[unit_random_below(&random_state, bytes->length)] ^=
          (uint8_t)(1u << unit_random_below(&random_state, 8));
    }
    break;
  case 1: /* one number, mostly in the fixed part, where the counts are */
    if (bytes->length >= 64) {
      const size_t slots = (unit_random_below(&random_state, 4) == 0 ? bytes->length : 64) / width;
      memcpy(bytes->at + width * unit_random_below(&random_state, slots), &value, width);
    }
    break;
  case 2: /* cut short */
    bytes->length = unit_random_below(&random_state, bytes->length + 1);
    break;
  case 3: /* cut by whole structures */
    bytes->length -= bytes->length >= 8 ? 8 : 0;
    break;
  default: /* trailing bytes */
    bytes->length += unit_random_below(&random_state, PAYLOAD_MAX - bytes->length + 1);
    break;
  }
}

/* The input in a buffer of its exact size, for the caller to free. */
static uint8_t *mutated(struct bytes *bytes) {
  for (size_t times = unit_random_below(&random_state, 4); times > 0; times--) {
    mutate_once(bytes);
  }
  uint8_t *exact = malloc(bytes->length > 0 ? bytes->length : 1);
  assert_non_null(exact);
  memcpy(exact, bytes->at, bytes->length);
  return exact;
}

/* ---- requests ------------------------------------------------------------------------------- */

static void check_refusal(const wire_error *error) {
  assert_true(error->status == WIRE_STATUS_BAD_LENGTH || error->status == WIRE_STATUS_BAD_COUNT ||
              error->status == WIRE_STATUS_BAD_VALUE);
  assert_true(error->field[0] != '\0' && error->allowed[0] != '\0');
}

/* The arrays of an accepted request lie inside the payload and fill it. Reads every byte of
 * them. */
static void check_taken(const eval_request *request, const uint8_t *payload, size_t payload_bytes) {
  const wire_eval_request *fixed = &request->fixed;
  const size_t value_bytes = core_evaluator_bytes(fixed->evaluator);
  assert_true(value_bytes == 4 || value_bytes == 8);
  assert_ptr_equal(request->media, payload + WIRE_BYTES_eval_request);
  assert_in_range(fixed->medium_count, 1, payload_bytes / WIRE_BYTES_medium);
  for (uint32_t i = 0; i < fixed->medium_count; i++) {
    wire_medium medium;
    wire_get_medium(request->media + (size_t)i * WIRE_BYTES_medium, &medium);
  }
  size_t given = 0;
  for (const core_choice *entry = core_parameter_list; entry->name != NULL; entry++) {
    given += !isnan(request->parameters.value[entry->id]);
  }
  assert_int_equal(given, fixed->parameter_count);
  size_t radii_bytes = 0;
  if (fixed->spacing == CORE_SPACING_LIST) {
    assert_true(fixed->radius_count <= payload_bytes / value_bytes);
    radii_bytes = (size_t)fixed->radius_count * value_bytes;
    uint8_t copy[PAYLOAD_MAX];
    memcpy(copy, request->radii, radii_bytes);
  } else {
    assert_null(request->radii);
  }
  assert_int_equal(eval_request_bytes(fixed->medium_count, fixed->parameter_count, radii_bytes),
                   payload_bytes);
}

static enum wire_status parse_eval(const uint8_t *payload, size_t payload_bytes) {
  eval_request request;
  const wire_error error = eval_request_parse(payload, payload_bytes, &request);
  if (error.status == WIRE_STATUS_OK) {
    check_taken(&request, payload, payload_bytes);
  } else {
    check_refusal(&error);
  }
  return error.status;
}

/* ---- the other requests --------------------------------------------------------------------- */

/* A sample is an eval with another fixed part, and numbers for radii. */
static void make_sample(struct bytes *to) {
  struct bytes eval;
  wire_eval_request like;
  do {
    make_request(&eval);
    wire_get_eval_request(eval.at, &like);
  } while (like.spacing != CORE_SPACING_LIST);
  const size_t before = WIRE_BYTES_eval_request, after = WIRE_BYTES_sample_request;
  const bool list = unit_random_below(&random_state, 3) != 0;
  const size_t radii_bytes = wire_padded(like.radius_count * core_evaluator_bytes(like.evaluator));
  const wire_sample_request fixed = {
      .model = like.model,
      .evaluator = like.evaluator,
      .moments = like.moments,
      .wanted = like.wanted,
      .medium_count = like.medium_count,
      .draw = list ? CORE_DRAW_LIST : CORE_DRAW_RANDOM,
      .parameter_count = like.parameter_count,
      .sample_count = like.radius_count,
  };
  memset(to, 0, sizeof *to);
  wire_put_sample_request(to->at, &fixed);
  memcpy(to->at + after, eval.at + before, eval.length - before);
  to->length = eval.length - before + after - (list ? 0 : radii_bytes);
}

static enum wire_status parse_sample(const uint8_t *payload, size_t payload_bytes) {
  core_draw draw;
  eval_request request;
  const wire_error error = sample_request_parse(payload, payload_bytes, &draw, &request);
  if (error.status == WIRE_STATUS_OK) {
    const wire_eval_request *fixed = &request.fixed;
    const size_t listed = draw.rule == CORE_DRAW_LIST
                              ? (size_t)draw.count * core_evaluator_bytes(fixed->evaluator)
                              : 0;
    uint8_t copy[PAYLOAD_MAX];
    assert_true(request.radii != NULL || draw.rule != CORE_DRAW_LIST);
    memcpy(copy, request.media, (size_t)fixed->medium_count * WIRE_BYTES_medium);
    memcpy(copy, request.radii != NULL ? request.radii : copy, listed);
    assert_int_equal(sample_request_bytes(fixed->medium_count, fixed->parameter_count, listed),
                     payload_bytes);
  } else {
    check_refusal(&error);
  }
  return error.status;
}

static void make_invert(struct bytes *to) {
  const uint64_t count = 1 + unit_random_below(&random_state, RADII_MAX);
  const wire_invert_request fixed = {
      .model = random_id(core_models),
      .moments = random_id(core_moments_list),
      .given = random_id(core_lengths),
      .medium_count = count,
      .eta = 1.3,
  };
  memset(to, 0x3f, sizeof *to);
  wire_put_invert_request(to->at, &fixed);
  to->length = (size_t)invert_request_bytes(count);
}

static enum wire_status parse_invert(const uint8_t *payload, size_t payload_bytes) {
  invert_request request;
  const wire_error error = invert_request_parse(payload, payload_bytes, &request);
  if (error.status == WIRE_STATUS_OK) {
    uint8_t copy[PAYLOAD_MAX];
    const size_t bytes = (size_t)request.fixed.medium_count * sizeof(double);
    memcpy(copy, request.albedos, bytes);
    memcpy(copy, request.lengths, bytes);
    assert_int_equal(invert_request_bytes(request.fixed.medium_count), payload_bytes);
  } else {
    check_refusal(&error);
  }
  return error.status;
}

static void make_mc(struct bytes *to) {
  const uint32_t albedos = (uint32_t)unit_random_below(&random_state, CORE_MC_ALBEDOS_MAX + 1);
  const wire_mc_request fixed = {.spacing = CORE_SPACING_LINEAR,
                                 .albedo_count = (uint16_t)albedos,
                                 .ring_count = 3,
                                 .photons = 1};
  memset(to, 0x3f, sizeof *to);
  wire_put_mc_request(to->at, &fixed);
  to->length = mc_request_bytes(albedos);
}

static enum wire_status parse_mc(const uint8_t *payload, size_t payload_bytes) {
  mc_request request;
  const wire_error error = mc_request_parse(payload, payload_bytes, &request);
  if (error.status == WIRE_STATUS_OK) {
    assert_int_equal(mc_request_bytes(request.fixed.albedo_count), payload_bytes);
  } else {
    check_refusal(&error);
  }
  return error.status;
}

static void make_table(struct bytes *to) {
  const uint32_t parameters = (uint32_t)unit_random_below(&random_state, PARAMETERS_MAX + 1);
  const wire_table_request fixed = {.model = random_id(core_models),
                                    .moments = random_id(core_moments_list),
                                    .parameter_count = (uint16_t)parameters};
  memset(to, 0, sizeof *to);
  wire_put_table_request(to->at, &fixed);
  put_parameters(to->at + table_request_bytes(0), parameters);
  to->length = table_request_bytes(parameters);
}

static enum wire_status parse_table(const uint8_t *payload, size_t payload_bytes) {
  table_request request;
  const wire_error error = table_request_parse(payload, payload_bytes, &request);
  if (error.status == WIRE_STATUS_OK) {
    assert_int_equal(table_request_bytes(request.fixed.parameter_count), payload_bytes);
  } else {
    check_refusal(&error);
  }
  return error.status;
}

static const struct {
  void (*make)(struct bytes *to);
  enum wire_status (*parse)(const uint8_t *payload, size_t payload_bytes);
} messages[] = {{make_request, parse_eval},
                {make_sample, parse_sample},
                {make_invert, parse_invert},
                {make_mc, parse_mc},
                {make_table, parse_table}};
enum { MESSAGES = sizeof messages / sizeof messages[0] };

UNIT_TEST(requests_are_refused_or_whole) {
  size_t taken[MESSAGES] = {0};
  for (size_t round = 0; round < ROUNDS * 2; round++) {
    const size_t message = round % MESSAGES;
    struct bytes bytes;
    messages[message].make(&bytes);
    uint8_t *payload = mutated(&bytes);
    taken[message] += messages[message].parse(payload, bytes.length) == WIRE_STATUS_OK;
    free(payload);
  }
  for (size_t i = 0; i < MESSAGES; i++) {
    assert_true(taken[i] > ROUNDS * 2 / MESSAGES / 10 && taken[i] < ROUNDS * 2 / MESSAGES);
  }
}

/* Every other length than the right one, from nothing to trailing bytes. */
UNIT_TEST(only_the_exact_length_will_do) {
  for (size_t round = 0; round < 200 * MESSAGES; round++) {
    struct bytes bytes;
    messages[round % MESSAGES].make(&bytes);
    for (size_t length = 0; length < bytes.length + 64; length++) {
      uint8_t *payload = malloc(length > 0 ? length : 1);
      assert_non_null(payload);
      memcpy(payload, bytes.at, length);
      assert_int_equal(messages[round % MESSAGES].parse(payload, length) == WIRE_STATUS_OK,
                       length == bytes.length);
      free(payload);
    }
  }
}

/* ---- replies -------------------------------------------------------------------------------- */

static void read_array(const uint8_t *payload, size_t payload_bytes, uint64_t offset,
                       uint64_t length) {
  uint8_t copy[PAYLOAD_MAX];
  assert_true(offset <= payload_bytes && length <= payload_bytes - offset);
  memcpy(copy, payload + offset, (size_t)length);
}

/* Checks that every structure and array that the reply announces lies inside of it. Reads all their
 * bytes, so that a sanitizer sees an overrun. */
static void check_reply(const uint8_t *payload, size_t payload_bytes, const wire_eval_reply *fixed,
                        const eval_layout *layout) {
  assert_int_equal(layout->payload_bytes, payload_bytes);
  assert_true(fixed->part < fixed->part_count);
  for (uint32_t i = 0; i < fixed->channel_count; i++) {
    read_array(payload, payload_bytes, layout->channels_offset + (uint64_t)i * WIRE_BYTES_channel,
               WIRE_BYTES_channel);
    for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
      if (eval_is_array(fixed->wanted, quantity->id)) {
        const uint64_t offset = eval_array_offset(layout, fixed->wanted, i, quantity->id);
        read_array(payload, payload_bytes, offset, layout->array_bytes);
      }
    }
  }
  if (fixed->wanted & CORE_QUANTITY_RADIUS) {
    read_array(payload, payload_bytes, layout->radius_offset, layout->array_bytes);
  }
}

UNIT_TEST(replies_are_refused_or_whole) {
  size_t taken = 0;
  for (size_t round = 0; round < ROUNDS; round++) {
    struct bytes bytes;
    make_reply(&bytes);
    uint8_t *payload = mutated(&bytes);
    wire_eval_reply fixed;
    eval_layout layout;
    if (eval_reply_parse(payload, bytes.length, false, &fixed, &layout)) {
      check_reply(payload, bytes.length, &fixed, &layout);
      taken++;
    }
    free(payload);
  }
  assert_in_range(taken, ROUNDS / 5, ROUNDS - ROUNDS / 5);
}
