/* The target for messages: payloads are decoded, and what was decoded is encoded. The replies' part
 * serves the other targets, too. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "proto/channels.h"
#include "proto/fit.h"
#include "proto/gather.h"
#include "proto/invert.h"
#include "proto/mc.h"
#include "proto/sample.h"
#include "proto/table.h"
#include "proto/varying.h"
#include "tests/fuzz/fuzz.h"

/* A structure that is read from any bytes, written and read again is the same. */
#define WIRE_STRUCTURE(name)                                                                       \
  static void round_trip_##name(const uint8_t *data) {                                             \
    uint8_t once[WIRE_BYTES_##name], twice[WIRE_BYTES_##name];                                     \
    wire_##name structure;                                                                         \
    wire_get_##name(data, &structure);                                                             \
    wire_put_##name(once, &structure);                                                             \
    wire_get_##name(once, &structure);                                                             \
    wire_put_##name(twice, &structure);                                                            \
    CHECK(memcmp(once, twice, sizeof once) == 0);                                                  \
  }
#include "proto/messages.def"

static void round_trips(const uint8_t *data, size_t size) {
#define WIRE_STRUCTURE(name)                                                                       \
  if (size >= WIRE_BYTES_##name) {                                                                 \
    uint8_t *copy = fuzz_copy(data, WIRE_BYTES_##name);                                            \
    round_trip_##name(copy);                                                                       \
    free(copy);                                                                                    \
  }
#include "proto/messages.def"
}

static bool is_good(const wire_error *error) {
  if (error->status == WIRE_STATUS_OK) {
    return true;
  }
  CHECK(error->status == WIRE_STATUS_BAD_LENGTH || error->status == WIRE_STATUS_BAD_COUNT ||
        error->status == WIRE_STATUS_BAD_VALUE);
  CHECK(error->field[0] != '\0' && error->allowed[0] != '\0');
  return false;
}

/* Reads all bytes of an array, and checks that it lies in the payload. */
static void read_array(const uint8_t *payload, size_t size, uint64_t offset, uint64_t bytes) {
  CHECK(offset <= size && bytes <= size - offset);
  free(fuzz_copy(payload + offset, (size_t)bytes));
}

/* Encodes and decodes parameters once more, and checks that they are the same. */
static void check_parameters(const core_parameters *parameters, uint32_t count) {
  uint8_t bytes[CORE_PARAMETERS_END * WIRE_BYTES_parameter];
  core_parameters again;
  CHECK(channels_count_parameters(parameters) == count);
  CHECK(channels_put_parameters(bytes, parameters) == count * (size_t)WIRE_BYTES_parameter);
  CHECK(channels_parse_parameters(bytes, count, &again).status == WIRE_STATUS_OK);
  CHECK(memcmp(again.value, parameters->value, sizeof again.value) == 0);
}

static void check_lists(const eval_request *request, const uint8_t *payload, size_t size,
                        uint64_t listed) {
  const uint64_t value_bytes = core_evaluator_bytes(request->fixed.evaluator);
  CHECK(value_bytes == 4 || value_bytes == 8);
  read_array(payload, size, (uint64_t)(request->media - payload),
             request->fixed.medium_count * (uint64_t)WIRE_BYTES_medium);
  CHECK((request->radii != NULL) == (listed > 0 || request->radii != NULL));
  if (listed > 0) {
    read_array(payload, size, (uint64_t)((const uint8_t *)request->radii - payload),
               listed * value_bytes);
  }
  check_parameters(&request->parameters, request->fixed.parameter_count);
}

static void decode_eval(const uint8_t *payload, size_t size) {
  eval_request request;
  const wire_error error = eval_request_parse(payload, size, &request);
  if (is_good(&error)) {
    const wire_eval_request *fixed = &request.fixed;
    const uint64_t listed = fixed->spacing == CORE_SPACING_LIST ? fixed->radius_count : 0;
    check_lists(&request, payload, size, listed);
    CHECK(schema_bytes(&schema_eval_request, payload) == size);
    uint8_t again[WIRE_BYTES_eval_request];
    wire_put_eval_request(again, fixed);
    CHECK(memcmp(again, payload, sizeof again) == 0);
  }
}

static void decode_sample(const uint8_t *payload, size_t size) {
  core_draw draw;
  eval_request request;
  const wire_error error = sample_request_parse(payload, size, &draw, &request);
  if (is_good(&error)) {
    const uint64_t listed = draw.rule == CORE_DRAW_LIST ? draw.count : 0;
    check_lists(&request, payload, size, listed);
    CHECK(schema_bytes(&schema_sample_request, payload) == size);
  }
}

static void decode_invert(const uint8_t *payload, size_t size) {
  invert_request request;
  const wire_error error = invert_request_parse(payload, size, &request);
  if (is_good(&error)) {
    const uint64_t bytes = request.fixed.medium_count * sizeof(double);
    read_array(payload, size, (uint64_t)((const uint8_t *)request.albedos - payload), bytes);
    read_array(payload, size, (uint64_t)((const uint8_t *)request.lengths - payload), bytes);
    CHECK(schema_bytes(&schema_invert_request, payload) == size);
  }
}

/* The design of a good request is written and read again. */
static void decode_fit(const uint8_t *payload, size_t size) {
  fit_request request;
  const wire_error error = fit_request_parse(payload, size, &request);
  if (!is_good(&error)) {
    return;
  }
  const uint64_t numbers = request.fixed.set_count * request.design.reading_count * sizeof(double);
  read_array(payload, size, (uint64_t)((const uint8_t *)request.values - payload), numbers);
  read_array(payload, size, (uint64_t)((const uint8_t *)request.errors - payload), numbers);
  CHECK(schema_bytes(&schema_fit_request, payload) == size);
  fit_design read;
  fit_design_read(request.design_bytes, &read);
  if (read.design.detector_na != 0) { /* a parameter on the wire, where 0 is one, too */
    const double aperture = read.design.detector_na;
    read.parameters.value[CORE_PARAMETER_DETECTOR_NA] = isnan(aperture) ? 0 : aperture;
  }
  schema_layout layout;
  uint8_t *again = malloc(size);
  CHECK(again != NULL && schema_is_whole(&schema_fit_request, payload, size, &layout));
  memcpy(again, payload, WIRE_BYTES_fit_request + WIRE_BYTES_fit_design);
  channels_put_parameters(again + layout.parts[FIT_PARAMETERS].at, &read.parameters);
  schema_put_part(again, &layout, FIT_REFERENCE, &read.design.reference);
  schema_put_part(again, &layout, FIT_AT, read.design.at);
  schema_put_part(again, &layout, FIT_SOURCE, read.design.source_mm);
  schema_put_part(again, &layout, FIT_DETECTOR, read.design.detector_mm);
  schema_put_part(again, &layout, FIT_VALUES, request.values);
  CHECK(schema_put_part(again, &layout, FIT_ERRORS, request.errors) == again + size);
  free(again);
}

static void decode_mc(const uint8_t *payload, size_t size) {
  mc_request request;
  const wire_error error = mc_request_parse(payload, size, &request);
  if (is_good(&error)) {
    CHECK(request.fixed.albedo_count <= CORE_MC_ALBEDOS_MAX);
    CHECK(schema_bytes(&schema_mc_request, payload) +
              channels_count_parameters(&request.parameters) * (uint64_t)WIRE_BYTES_parameter ==
          size);
  }
}

static void decode_table(const uint8_t *payload, size_t size) {
  table_request request;
  const wire_error error = table_request_parse(payload, size, &request);
  if (is_good(&error)) {
    check_parameters(&request.parameters, request.fixed.parameter_count);
    CHECK(schema_bytes(&schema_table_request, payload) == size);
  }
}

/* Checks that values are what their quantity can be: not NaN, not negative unless they are ln R or a
 * derivative, and a cdf is at most 1. */
static void check_values(const uint8_t *values, uint64_t count, unsigned evaluator,
                         unsigned quantity) {
  enum {
    ANY_SIGN = CORE_QUANTITY_LN_R | CORE_QUANTITY_SLOPE | CORE_QUANTITY_BY_SIGMA_A |
               CORE_QUANTITY_BY_SIGMA_S
  };
  const bool any_sign = (quantity & ANY_SIGN) != 0;
  for (uint64_t i = 0; i < count; i++) {
    double value;
    if (evaluator == CORE_EVALUATOR_F64) {
      memcpy(&value, values + i * sizeof value, sizeof value);
    } else {
      float single;
      memcpy(&single, values + i * sizeof single, sizeof single);
      value = single;
    }
    CHECK(any_sign ? value == value : value >= 0);
    CHECK(quantity != CORE_QUANTITY_CDF || value <= 1);
  }
}

/* Checks the albedo of a channel. It may exceed 1 for a published model, if the notes say so. */
static void check_albedo(const wire_eval_reply *fixed, const uint8_t *payload,
                         const eval_layout *layout, unsigned wanted, uint32_t channel) {
  double albedo;
  memcpy(&albedo, payload + eval_albedo_offset(channel), sizeof albedo);
  const wire_quantity_error error = eval_largest_error(payload, layout, wanted, channel);
  CHECK(!(fixed->wanted & CORE_QUANTITY_ALBEDO) ||
        (albedo >= 0 &&
         (fixed->notes & CORE_NOTE_ALBEDO_ABOVE_1 || albedo <= 1 + error.numerical_error)));
}

bool fuzz_decode_eval_reply(const uint8_t *payload, size_t size, bool drawn, bool honest) {
  wire_eval_reply fixed;
  eval_layout layout;
  if (!eval_reply_parse(payload, size, drawn, &fixed, &layout)) {
    return false;
  }
  const unsigned wanted = fixed.wanted | (drawn ? EVAL_DRAWN : 0);
  CHECK(layout.payload_bytes == size && fixed.part < fixed.part_count);
  for (uint32_t i = 0; i < fixed.channel_count; i++) {
    read_array(payload, size, eval_albedo_offset(i), sizeof(double));
    read_array(payload, size, eval_error_offset(&layout, wanted, i, 1),
               (uint64_t)layout.errors_per_channel * WIRE_BYTES_quantity_error);
    if (honest) {
      check_albedo(&fixed, payload, &layout, wanted, i);
    }
    for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
      if (eval_is_array(wanted, quantity->id)) {
        const uint64_t at = eval_array_offset(&layout, wanted, i, (enum core_quantity)quantity->id);
        read_array(payload, size, at, layout.array_bytes);
        if (honest) {
          check_values(payload + at, fixed.count, fixed.evaluator, quantity->id);
        }
      }
    }
  }
  if (!drawn && fixed.wanted & CORE_QUANTITY_RADIUS) {
    read_array(payload, size, layout.radius_offset, layout.array_bytes);
  }
  return true;
}

bool fuzz_decode_invert_reply(const uint8_t *payload, size_t size) {
  wire_invert_reply fixed;
  const bool good = invert_reply_parse(payload, size, &fixed);
  for (int array = 0; good && array < INVERT_ARRAYS; array++) {
    read_array(payload, size, invert_array_offset((enum invert_array)array, fixed.count),
               fixed.count * sizeof(double));
  }
  return good;
}

bool fuzz_decode_fit_reply(const uint8_t *payload, size_t size) {
  wire_fit_reply fixed;
  const bool good = fit_reply_parse(payload, size, &fixed);
  if (good) {
    CHECK(fit_reply_bytes(fixed.count, fixed.reading_count) == size);
    read_array(payload, size, WIRE_BYTES_fit_reply, fixed.count * WIRE_BYTES_fitted);
    read_array(payload, size, fit_residuals_offset(fixed.count),
               fixed.count * fixed.reading_count * sizeof(double));
  }
  return good;
}

static void decode_points(const uint8_t *payload, size_t size) {
  points_request request;
  const wire_error error = points_request_parse(payload, size, &request);
  if (error.status == WIRE_STATUS_TOO_LARGE || !is_good(&error)) {
    return;
  }
  const wire_points_request *fixed = &request.fixed;
  CHECK(fixed->part_points <= fixed->point_count - fixed->point_first);
  read_array(payload, size, (uint64_t)((const uint8_t *)request.xyz - payload),
             fixed->part_points * GATHER_AXES * sizeof(double));
  read_array(payload, size, (uint64_t)((const uint8_t *)request.power - payload),
             fixed->part_points * fixed->channel_count * sizeof(float));
  CHECK(schema_bytes(&schema_points_request, payload) == size);
}

static void decode_gather(const uint8_t *payload, size_t size) {
  gather_request request;
  const wire_error error = gather_request_parse(payload, size, &request);
  if (error.status == WIRE_STATUS_TOO_LARGE || !is_good(&error)) {
    return;
  }
  const wire_gather_request *fixed = &request.fixed;
  read_array(payload, size, (uint64_t)((const uint8_t *)request.media - payload),
             fixed->medium_count * (uint64_t)WIRE_BYTES_medium);
  read_array(payload, size, (uint64_t)((const uint8_t *)request.queries - payload),
             fixed->query_count * GATHER_AXES * sizeof(double));
  check_parameters(&request.parameters, fixed->parameter_count);
  CHECK(schema_bytes(&schema_gather_request, payload) == size);
}

bool fuzz_decode_points_reply(const uint8_t *payload, size_t size) {
  wire_points_reply fixed;
  return points_reply_parse(payload, size, &fixed);
}

bool fuzz_decode_gather_reply(const uint8_t *payload, size_t size) {
  wire_gather_reply fixed;
  if (!gather_reply_parse(payload, size, &fixed)) {
    return false;
  }
  read_array(payload, size, gather_sums_offset(fixed.channel_count),
             fixed.count * fixed.channel_count * sizeof(double));
  return true;
}

static void decode_varying(const uint8_t *payload, size_t size) {
  varying_request request;
  if (varying_request_parse(payload, size, &request).status != WIRE_STATUS_OK) {
    return;
  }
  check_parameters(&request.parameters, request.fixed.parameter_count);
  const size_t bytes =
      (size_t)request.fixed.value_count * core_evaluator_bytes(request.fixed.evaluator);
  const void *arrays[] = {request.media[0], request.media[1], request.numbers};
  for (size_t i = 0; i < sizeof arrays / sizeof arrays[0]; i++) {
    if (arrays[i] != NULL) {
      read_array(payload, size, (uint64_t)((const uint8_t *)arrays[i] - payload), bytes);
    }
  }
}

bool fuzz_decode_varying_reply(const uint8_t *payload, size_t size) {
  wire_varying_reply fixed;
  varying_layout layout;
  if (!varying_reply_parse(payload, size, &fixed, &layout)) {
    return false;
  }
  for (uint32_t array = 1; array != 0 && array <= layout.arrays; array <<= 1) {
    if ((layout.arrays & array) != 0) {
      read_array(payload, size, varying_array_offset(&layout, array), layout.array_bytes);
    }
  }
  read_array(payload, size, layout.status_offset, fixed.count);
  return true;
}

bool fuzz_decode_mc_reply(const uint8_t *payload, size_t size, bool *under_way) {
  wire_mc_reply fixed;
  mc_layout layout;
  if (!mc_reply_parse(payload, size, &fixed, &layout)) {
    return false;
  }
  *under_way = fixed.state == MC_UNDER_WAY;
  if (!*under_way) {
    CHECK(layout.payload_bytes == size);
    for (uint32_t side = 0; side < fixed.side_count; side++) {
      read_array(payload, size, mc_photons_offset(&layout, fixed.ring_count, side),
                 fixed.ring_count * sizeof(uint64_t));
      for (uint32_t i = 0; i < 2 * fixed.albedo_count; i++) {
        read_array(payload, size,
                   mc_rings_offset(&layout, fixed.side_count, fixed.ring_count, i / 2, side, i % 2),
                   fixed.ring_count * sizeof(double));
      }
    }
  }
  return true;
}

static void decode_table_reply(const uint8_t *payload, size_t size) {
  wire_table_reply fixed;
  core_parameters parameters;
  const float *words;
  if (table_reply_parse(payload, size, &fixed, &parameters, &words)) {
    check_parameters(&parameters, fixed.parameter_count);
    read_array(payload, size, (uint64_t)((const uint8_t *)words - payload),
               fixed.word_count * sizeof *words);
  }
}

/* The target for messages. An input is the type of a message, in two bytes, and a payload. */
void fuzz_messages(const uint8_t *data, size_t size) {
  bool under_way;
  if (size < 2) {
    return;
  }
  const unsigned type = data[0] | (unsigned)data[1] << 8;
  size -= 2;
  uint8_t *payload = fuzz_copy(data + 2, size);
  round_trips(payload, size);
  switch (type) {
  case WIRE_TYPE_EVAL:
  case WIRE_TYPE_OFFERS:
    decode_eval(payload, size);
    break;
  case WIRE_TYPE_SAMPLE:
    decode_sample(payload, size);
    break;
  case WIRE_TYPE_INVERT:
    decode_invert(payload, size);
    break;
  case WIRE_TYPE_FIT:
    decode_fit(payload, size);
    break;
  case WIRE_TYPE_POINTS:
    decode_points(payload, size);
    break;
  case WIRE_TYPE_GATHER:
    decode_gather(payload, size);
    break;
  case WIRE_TYPE_VARYING:
    decode_varying(payload, size);
    break;
  case WIRE_TYPE_MC:
    decode_mc(payload, size);
    break;
  case WIRE_TYPE_TABLE:
    decode_table(payload, size);
    break;
  case WIRE_TYPE_EVAL | WIRE_REPLY:
    fuzz_decode_eval_reply(payload, size, false, false);
    break;
  case WIRE_TYPE_SAMPLE | WIRE_REPLY:
    fuzz_decode_eval_reply(payload, size, true, false);
    break;
  case WIRE_TYPE_INVERT | WIRE_REPLY:
    fuzz_decode_invert_reply(payload, size);
    break;
  case WIRE_TYPE_FIT | WIRE_REPLY:
    fuzz_decode_fit_reply(payload, size);
    break;
  case WIRE_TYPE_POINTS | WIRE_REPLY:
    fuzz_decode_points_reply(payload, size);
    break;
  case WIRE_TYPE_GATHER | WIRE_REPLY:
    fuzz_decode_gather_reply(payload, size);
    break;
  case WIRE_TYPE_VARYING | WIRE_REPLY:
    fuzz_decode_varying_reply(payload, size);
    break;
  case WIRE_TYPE_MC | WIRE_REPLY:
    fuzz_decode_mc_reply(payload, size, &under_way);
    break;
  case WIRE_TYPE_TABLE | WIRE_REPLY:
    decode_table_reply(payload, size);
    break;
  default:
    break;
  }
  free(payload);
}
