/* The target for messages: payloads are checked and read to their last byte, and what was decoded is
 * encoded. The replies' part serves the other targets, too. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "proto/eval.h"
#include "proto/fit.h"
#include "proto/gather.h"
#include "proto/mc.h"
#include "proto/schema.h"
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

/* ---- parts ---------------------------------------------------------------------------------- */

static const schema_payload *payload_of(unsigned type) {
  for (const schema_message *message = schema_messages; message->type != 0; message++) {
    if (message->type == (type & ~(unsigned)WIRE_REPLY)) {
      return (type & WIRE_REPLY) != 0 ? message->reply : message->request;
    }
  }
  return NULL;
}

/* Reads all parts, each from a block of its own. They lie one behind the other, and fill the
 * payload. */
static void read_parts(const schema_payload *schema, const schema_layout *layout,
                       const uint8_t *payload, size_t size) {
  uint64_t at = schema->fixed_bytes;
  CHECK(at <= size);
  for (size_t i = 0; schema->parts[i].name != NULL; i++) {
    const uint64_t end = schema->parts[i + 1].name != NULL ? layout->parts[i + 1].at : size;
    CHECK(layout->parts[i].at == at && at <= end && end <= size);
    free(fuzz_copy(payload + at, (size_t)(end - at)));
    at = end;
  }
  CHECK(at == size);
}

/* ---- requests ------------------------------------------------------------------------------- */

static bool is_good(const wire_error *error) {
  if (error->status == WIRE_STATUS_OK) {
    return true;
  }
  CHECK(error->status == WIRE_STATUS_BAD_LENGTH || error->status == WIRE_STATUS_BAD_COUNT ||
        error->status == WIRE_STATUS_BAD_VALUE || error->status == WIRE_STATUS_TOO_LARGE);
  CHECK(error->field[0] != '\0' && error->allowed[0] != '\0');
  return false;
}

/* Encodes and decodes parameters once more, and checks that they are the same. */
static void check_parameters(const core_parameters *parameters, uint32_t count) {
  uint8_t bytes[CORE_PARAMETERS_END * WIRE_BYTES_parameter];
  core_parameters again;
  CHECK(schema_count_parameters(parameters) == count);
  CHECK(schema_put_parameters(bytes, parameters) == count * (size_t)WIRE_BYTES_parameter);
  CHECK(schema_parse_parameters(bytes, count, 1, &again).status == WIRE_STATUS_OK);
  CHECK(memcmp(again.value, parameters->value, sizeof again.value) == 0);
}

/* The design of a good request is written and read again. */
static void check_design(const fit_request *request, const uint8_t *payload, size_t size) {
  fit_design read;
  fit_design_read(request->design_bytes, &read);
  if (read.design.detector_na != 0) { /* a parameter on the wire, where 0 is one, too */
    const double aperture = read.design.detector_na;
    read.parameters.value[CORE_PARAMETER_DETECTOR_NA] = isnan(aperture) ? 0 : aperture;
  }
  schema_layout layout;
  uint8_t *again = malloc(size);
  CHECK(again != NULL && schema_is_whole(&schema_fit_request, payload, size, &layout));
  memcpy(again, payload, WIRE_BYTES_fit_request + WIRE_BYTES_fit_design);
  schema_put_parameters(again + layout.parts[FIT_PARAMETERS].at, &read.parameters);
  schema_put_part(again, &layout, FIT_REFERENCE, &read.design.reference);
  schema_put_part(again, &layout, FIT_AT, read.design.at);
  schema_put_part(again, &layout, FIT_SOURCE, read.design.source_mm);
  schema_put_part(again, &layout, FIT_DETECTOR, read.design.detector_mm);
  schema_put_part(again, &layout, FIT_VALUES, request->values);
  CHECK(schema_put_part(again, &layout, FIT_ERRORS, request->errors) == again + size);
  free(again);
}

/* Takes a request apart as the daemon does. Returns whether it is a good one. */
static bool decode_request(unsigned type, const uint8_t *payload, size_t size) {
  union {
    eval_request eval;
    fit_request fit;
    mc_request mc;
    table_request table;
    varying_request varying;
    points_request points;
    gather_request gather;
  } request;
  core_draw draw;
  schema_layout layout;
  wire_error error = {.status = WIRE_STATUS_BAD_TYPE};
#define PARSE(IDENT, name, ...)                                                                    \
  case WIRE_TYPE_##IDENT:                                                                          \
    error = name##_request_parse(payload, size, __VA_ARGS__);                                      \
    break
#define PARSE_CHECKED(IDENT, name)                                                                 \
  case WIRE_TYPE_##IDENT:                                                                          \
    error = schema_check(&schema_##name##_request, payload, size, &layout);                        \
    if (error.status == WIRE_STATUS_OK) {                                                          \
      error = name##_request_parse(payload, &layout, &request.name);                               \
    }                                                                                              \
    break
  switch (type) {
    PARSE(EVAL, eval, &request.eval);
    PARSE(OFFERS, eval, &request.eval);
    PARSE(SAMPLE, sample, &draw, &request.eval);
    PARSE_CHECKED(FIT, fit);
    PARSE_CHECKED(MC, mc);
    PARSE_CHECKED(TABLE, table);
    PARSE(VARYING, varying, &request.varying);
    PARSE_CHECKED(POINTS, points);
    PARSE_CHECKED(GATHER, gather);
  case WIRE_TYPE_INVERT:
    error = schema_check(&schema_invert_request, payload, size, &layout);
    break;
  default:
    return false;
  }
#undef PARSE
#undef PARSE_CHECKED
  if (!is_good(&error)) {
    return false;
  }
  switch (type) {
  case WIRE_TYPE_FIT:
    check_design(&request.fit, payload, size);
    break;
  case WIRE_TYPE_TABLE:
    check_parameters(&request.table.parameters, request.table.fixed.parameter_count);
    break;
  case WIRE_TYPE_VARYING:
    check_parameters(&request.varying.parameters, request.varying.fixed.parameter_count);
    break;
  case WIRE_TYPE_GATHER:
    check_parameters(&request.gather.parameters, request.gather.fixed.parameter_count);
    break;
  case WIRE_TYPE_EVAL:
  case WIRE_TYPE_OFFERS:
  case WIRE_TYPE_SAMPLE:
    check_parameters(&request.eval.parameters, request.eval.fixed.parameter_count);
    break;
  default:
    break;
  }
  return true;
}

/* ---- replies -------------------------------------------------------------------------------- */

/* Checks that values are what their quantity can be: not NaN, but a model error of a medium that is
 * not solved, not negative unless they are ln R or a derivative, and a cdf is at most 1. */
static void check_values(const uint8_t *values, uint64_t count, unsigned evaluator,
                         unsigned quantity) {
  enum {
    ANY_SIGN = CORE_QUANTITY_LN_R | CORE_QUANTITY_SLOPE | CORE_QUANTITY_BY_SIGMA_A |
               CORE_QUANTITY_BY_SIGMA_S | CORE_PATHS | CORE_MODULATED
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
    CHECK(any_sign ? value == value
                   : value >= 0 || (value != value && quantity == CORE_QUANTITY_MODEL_ERRORS));
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

void fuzz_check_evaluated(const uint8_t *payload, size_t size, bool drawn) {
  wire_eval_reply fixed;
  eval_layout layout;
  CHECK(eval_reply_parse(payload, size, drawn, &fixed, &layout));
  const unsigned wanted = fixed.wanted | (drawn ? EVAL_DRAWN : 0);
  for (uint32_t i = 0; i < fixed.channel_count; i++) {
    check_albedo(&fixed, payload, &layout, wanted, i);
    for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
      if (eval_is_array(wanted, quantity->id)) {
        const uint64_t at = eval_array_offset(&layout, wanted, i, (enum core_quantity)quantity->id);
        check_values(payload + at, fixed.count, fixed.evaluator, quantity->id);
      }
    }
  }
}

/* Takes a reply apart as the client library does. */
static bool parse_reply(unsigned type, const uint8_t *payload, size_t size) {
  union {
    wire_eval_reply eval;
    wire_points_reply points;
    wire_varying_reply varying;
    wire_mc_reply mc;
    wire_table_reply table;
  } fixed;
  eval_layout evaluated;
  varying_layout varying;
  schema_layout layout;
  core_parameters parameters;
  const core_medium *layers;
  const float *words;
  switch (type & ~(unsigned)WIRE_REPLY) {
  case WIRE_TYPE_EVAL:
  case WIRE_TYPE_SAMPLE:
    return eval_reply_parse(payload, size, type == (WIRE_TYPE_SAMPLE | WIRE_REPLY), &fixed.eval,
                            &evaluated);
  case WIRE_TYPE_INVERT:
    return schema_is_whole(&schema_invert_reply, payload, size, &layout);
  case WIRE_TYPE_FIT:
    return schema_is_whole(&schema_fit_reply, payload, size, &layout);
  case WIRE_TYPE_POINTS:
    return points_reply_parse(payload, size, &fixed.points);
  case WIRE_TYPE_GATHER:
    return schema_is_whole(&schema_gather_reply, payload, size, &layout);
  case WIRE_TYPE_VARYING:
    return varying_reply_parse(payload, size, &fixed.varying, &varying);
  case WIRE_TYPE_MC:
    return mc_reply_parse(payload, size, &fixed.mc, &layout);
  case WIRE_TYPE_TABLE:
    if (!table_reply_parse(payload, size, &fixed.table, &layers, &parameters, &words)) {
      return false;
    }
    check_parameters(&parameters, fixed.table.parameter_count);
    return true;
  default:
    return false;
  }
}

bool fuzz_decode_reply(unsigned type, const uint8_t *payload, size_t size) {
  const schema_payload *schema = payload_of(type);
  schema_layout layout;
  if (!parse_reply(type, payload, size)) {
    return false;
  }
  CHECK(schema_is_whole(schema, payload, size, &layout));
  read_parts(schema, &layout, payload, size);
  return true;
}

/* The target for messages. An input is the type of a message, in two bytes, and a payload. */
void fuzz_messages(const uint8_t *data, size_t size) {
  schema_layout layout;
  if (size < 2) {
    return;
  }
  const unsigned type = data[0] | (unsigned)data[1] << 8;
  size -= 2;
  uint8_t *payload = fuzz_copy(data + 2, size);
  round_trips(payload, size);
  if ((type & WIRE_REPLY) != 0) {
    fuzz_decode_reply(type, payload, size);
  } else if (decode_request(type, payload, size)) {
    const schema_payload *schema = payload_of(type);
    CHECK(schema_check(schema, payload, size, &layout).status == WIRE_STATUS_OK);
    read_parts(schema, &layout, payload, size);
  }
  free(payload);
}
