#include "server/modbus/translate.h"

#include <assert.h>
#include <string.h>

#include "proto/channels.h"

_Static_assert(REGISTERS_RADII_MAX % 2 == 0, "arrays of the most radii need no padding");

/* ---- input ----------------------------------------------------------------------------------- */

static size_t put_medium(uint8_t *at, const uint16_t image[REGISTERS_END]) {
  const wire_medium medium = {
      .sigma_a = registers_number(image, REGISTERS_AT_SIGMA_A),
      .sigma_s = registers_number(image, REGISTERS_AT_SIGMA_S),
      .g = registers_number(image, REGISTERS_AT_G),
      .eta = registers_number(image, REGISTERS_AT_ETA),
  };
  wire_put_medium(at, &medium);
  return WIRE_BYTES_medium;
}

static core_parameters parameters_of(const uint16_t image[REGISTERS_END]) {
  core_parameters parameters;
  for (unsigned id = 0; id < CORE_PARAMETERS_END; id++) {
    parameters.value[id] = id > 0 ? registers_optional(image, id) : (double)NAN;
  }
  return parameters;
}

/* Writes the listed radii in the precision of the evaluator, and padding. Returns the bytes
 * written. */
static size_t put_list(uint8_t *at, const uint16_t image[REGISTERS_END], size_t value_bytes) {
  const unsigned count = registers_u16(image, REGISTERS_AT_RADIUS_COUNT);
  for (unsigned i = 0; i < count; i++) {
    const float r = registers_f32(image, REGISTERS_AT_RADII + 2 * i);
    const double wide = (double)r;
    memcpy(at + i * value_bytes, value_bytes == sizeof r ? (const void *)&r : (const void *)&wide,
           value_bytes);
  }
  const size_t bytes = (size_t)wire_padded(count * value_bytes);
  memset(at + count * value_bytes, 0, bytes - count * value_bytes);
  return bytes;
}

size_t modbus_translate_input(const uint16_t image[REGISTERS_END], uint8_t *question) {
  const core_parameters parameters = parameters_of(image);
  const unsigned spacing = registers_u16(image, REGISTERS_AT_SPACING);
  const bool grid = spacing != CORE_SPACING_LIST;
  const wire_eval_request fixed = {
      .model = registers_u16(image, REGISTERS_AT_MODEL),
      .evaluator = registers_u16(image, REGISTERS_AT_EVALUATOR),
      .moments = registers_u16(image, REGISTERS_AT_MOMENTS),
      .wanted = registers_u16(image, REGISTERS_AT_WANTED),
      .medium_count = 1,
      .spacing = (uint16_t)spacing,
      .parameter_count = (uint16_t)channels_count_parameters(&parameters),
      .radius_count = registers_u16(image, REGISTERS_AT_RADIUS_COUNT),
      .radius_start = grid ? registers_number(image, REGISTERS_AT_RADIUS_START) : 0,
      .radius_stop = grid ? registers_number(image, REGISTERS_AT_RADIUS_STOP) : 0,
  };
  wire_put_eval_request(question, &fixed);
  size_t bytes = WIRE_BYTES_eval_request;
  bytes += put_medium(question + bytes, image);
  bytes += channels_put_parameters(question + bytes, &parameters);
  if (!grid) {
    bytes += put_list(question + bytes, image, core_evaluator_bytes(fixed.evaluator));
  }
  assert(bytes <= MODBUS_QUESTION_BYTES);
  return bytes;
}

/* ---- output ---------------------------------------------------------------------------------- */

/* An array of values in the precision of the evaluator. `at` is NULL if there is no array. */
struct values {
  const uint8_t *at;
  size_t bytes; /* size of one value */
};

static double value_at(const struct values *values, unsigned index) {
  if (values->bytes == sizeof(float)) {
    float value;
    memcpy(&value, values->at + index * sizeof value, sizeof value);
    return (double)value;
  }
  double value;
  memcpy(&value, values->at + index * sizeof value, sizeof value);
  return value;
}

/* Writes the values into registers. Registers that held values of the previous answer, and get none
 * now, become NaN. */
static void set_values(uint16_t image[REGISTERS_END], unsigned single_at, unsigned double_at,
                       const struct values *values, unsigned count, unsigned count_before) {
  const unsigned most = count > count_before ? count : count_before;
  for (unsigned i = 0; i < most; i++) {
    const bool there = i < count && values->at != NULL;
    const double value = there ? value_at(values, i) : (double)NAN;
    registers_set_f32(image, single_at + 2 * i, (float)value);
    if (double_at > 0) {
      registers_set_f64(image, double_at + 4 * i, value);
    }
  }
}

/* Rounds the bound of an error up to single precision, so that it remains a bound. */
static float rounded_up(double bound) {
  const float nearest = (float)bound;
  return (double)nearest < bound ? nextafterf(nearest, INFINITY) : nearest;
}

/* Returns the radii of the request. Those of a grid are computed into `room`. */
static struct values radii_of(const uint8_t *question, const wire_eval_request *fixed,
                              double room[REGISTERS_RADII_MAX]) {
  const size_t value_bytes = core_evaluator_bytes(fixed->evaluator);
  if (fixed->spacing == CORE_SPACING_LIST) {
    return (struct values){question + eval_request_bytes(1, fixed->parameter_count, 0),
                           value_bytes};
  }
  const core_grid grid = {fixed->spacing, fixed->radius_count, fixed->radius_start,
                          fixed->radius_stop};
  if (value_bytes == sizeof(float)) {
    core_grid_radii_f32(&grid, 0, (size_t)grid.count, (float *)(void *)room);
  } else {
    core_grid_radii_f64(&grid, 0, (size_t)grid.count, room);
  }
  return (struct values){(const uint8_t *)room, value_bytes};
}

/* Returns the largest finite radius. Infinity does not count: R is exactly 0 there. */
static double largest(const struct values *radii, unsigned count) {
  double most = 0;
  for (unsigned i = 0; i < count; i++) {
    const double r = value_at(radii, i);
    most = r > most && r < (double)INFINITY ? r : most;
  }
  return most;
}

static void set_errors(uint16_t image[REGISTERS_END], const wire_channel *channel, double r,
                       bool rounded) {
  const double numerical =
      channel->numerical_error + channel->numerical_error_per_mm * r +
      (rounded ? 0x1p-24 : 0); /* the error of rounding double precision to float registers */
  registers_set_f32(image, REGISTERS_AT_NUMERICAL_ERROR, rounded_up(numerical));
  registers_set_f32(image, REGISTERS_AT_MODEL_ERROR, rounded_up(channel->model_error));
  registers_set_f32(image, REGISTERS_AT_ALBEDO, (float)channel->albedo);
  registers_set_f64(image, REGISTERS_AT_NUMERICAL_ERROR_DOUBLE, channel->numerical_error);
  registers_set_f64(image, REGISTERS_AT_NUMERICAL_ERROR_PER_MM, channel->numerical_error_per_mm);
  registers_set_f64(image, REGISTERS_AT_MODEL_ERROR_DOUBLE, channel->model_error);
  registers_set_f64(image, REGISTERS_AT_ALBEDO_DOUBLE, channel->albedo);
}

static struct values array_of(const uint8_t *reply, const eval_layout *layout,
                              const wire_eval_reply *start, enum core_quantity quantity) {
  const size_t value_bytes = core_evaluator_bytes(start->evaluator);
  if (!eval_is_array(start->wanted, quantity)) {
    return (struct values){NULL, value_bytes};
  }
  return (struct values){reply + eval_array_offset(layout, start->wanted, 0, quantity),
                         value_bytes};
}

void modbus_translate_reply(const uint8_t *question, const uint8_t *reply,
                            uint16_t image[REGISTERS_END]) {
  wire_eval_request asked;
  wire_eval_reply start;
  wire_channel channel;
  eval_layout layout;
  wire_get_eval_request(question, &asked);
  wire_get_eval_reply(reply, &start);
  const unsigned count = (unsigned)start.radius_count;
  const bool fits =
      eval_reply_layout(start.evaluator, start.wanted, 1, count, MODBUS_REPLY_BYTES, &layout);
  assert(fits && count <= REGISTERS_RADII_MAX);
  wire_get_channel(reply + layout.channels_offset, &channel);

  double room[REGISTERS_RADII_MAX];
  asked.evaluator = start.evaluator;
  const struct values radii = radii_of(question, &asked, room);
  const struct values R = array_of(reply, &layout, &start, CORE_QUANTITY_R);
  const struct values cdf = array_of(reply, &layout, &start, CORE_QUANTITY_CDF);
  const struct values S = array_of(reply, &layout, &start, CORE_QUANTITY_S);
  const unsigned before = registers_u16(image, REGISTERS_AT_COUNT);
  set_values(image, REGISTERS_AT_R, REGISTERS_AT_R_DOUBLE, &R, count, before);
  set_values(image, REGISTERS_AT_CDF, REGISTERS_AT_CDF_DOUBLE, &cdf, count, before);
  set_values(image, REGISTERS_AT_S, REGISTERS_AT_S_DOUBLE, &S, count, before);
  set_values(image, REGISTERS_AT_DISTANCES, 0, &radii, count, before);
  set_errors(image, &channel, largest(&radii, count), R.bytes == sizeof(double));
  registers_set_u16(image, REGISTERS_AT_COUNT, count);
  registers_set_u16(image, REGISTERS_AT_MODEL_TAKEN, start.model);
  registers_set_u16(image, REGISTERS_AT_EVALUATOR_TAKEN, start.evaluator);
  registers_set_u16(image, REGISTERS_AT_NOTES, start.notes);
}
