#include "server/modbus/translate.h"

#include <assert.h>
#include <string.h>

#include "proto/channels.h"

_Static_assert(REGISTERS_RADII_MAX % 2 == 0, "arrays of the most radii need no padding");
_Static_assert(WIRE_BYTES_eval_request + WIRE_BYTES_medium +
                       CORE_PARAMETERS_END * WIRE_BYTES_parameter +
                       REGISTERS_RADII_MAX * sizeof(double) <=
                   MODBUS_QUESTION_BYTES,
               "the request of an eval is shorter");
_Static_assert(WIRE_BYTES_sample_request + WIRE_BYTES_medium +
                       CORE_PARAMETERS_END * WIRE_BYTES_parameter +
                       REGISTERS_RADII_MAX * sizeof(double) <=
                   MODBUS_QUESTION_BYTES,
               "the request of a sample is shorter");
_Static_assert(WIRE_BYTES_invert_request + 2 * REGISTERS_RADII_MAX * sizeof(double) <=
                   MODBUS_QUESTION_BYTES,
               "the request of an invert is shorter");
_Static_assert(WIRE_BYTES_eval_reply + sizeof(double) + 5 * WIRE_BYTES_quantity_error +
                       3 * REGISTERS_RADII_MAX * sizeof(double) <=
                   MODBUS_REPLY_BYTES,
               "the reply to an eval is shorter");

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
    parameters.value[id] =
        id > 0 ? registers_optional(image, REGISTERS_PARAMETER_AT(id)) : (double)NAN;
  }
  return parameters;
}

/* Writes `count` floats from an address on, in the precision of the evaluator, and padding. Returns
 * the bytes written. */
static size_t put_list(uint8_t *at, const uint16_t image[REGISTERS_END], unsigned address,
                       unsigned count, size_t value_bytes) {
  for (unsigned i = 0; i < count; i++) {
    const float r = registers_f32(image, address + 2 * i);
    const double wide = (double)r;
    memcpy(at + i * value_bytes, value_bytes == sizeof r ? (const void *)&r : (const void *)&wide,
           value_bytes);
  }
  const size_t bytes = (size_t)wire_padded(count * value_bytes);
  memset(at + count * value_bytes, 0, bytes - count * value_bytes);
  return bytes;
}

static size_t put_eval(const uint16_t image[REGISTERS_END], uint8_t *question) {
  const core_parameters parameters = parameters_of(image);
  const unsigned spacing = registers_u16(image, REGISTERS_AT_SPACING);
  const bool grid = spacing != CORE_SPACING_LIST;
  const wire_eval_request fixed = {
      .model = registers_u16(image, REGISTERS_AT_MODEL),
      .evaluator = registers_u16(image, REGISTERS_AT_EVALUATOR),
      .moments = registers_u16(image, REGISTERS_AT_MOMENTS),
      .wanted = registers_u16(image, REGISTERS_AT_WANTED) | CORE_QUANTITY_MODEL_ERROR,
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
    bytes += put_list(question + bytes, image, REGISTERS_AT_RADII, (unsigned)fixed.radius_count,
                      core_evaluator_bytes(fixed.evaluator));
  }
  return bytes;
}

/* The quantities of a sample that have registers. */
#define SAMPLE_WANTED (CORE_QUANTITY_RADIUS | CORE_QUANTITY_PDF | CORE_QUANTITY_MODEL_ERROR)

static size_t put_sample(const uint16_t image[REGISTERS_END], uint8_t *question) {
  const core_parameters parameters = parameters_of(image);
  const unsigned draw = registers_u16(image, REGISTERS_AT_SAMPLE_DRAW);
  const bool seeded = draw == CORE_DRAW_RANDOM || draw == CORE_DRAW_STRATIFIED;
  const wire_sample_request fixed = {
      .model = registers_u16(image, REGISTERS_AT_MODEL),
      .evaluator = registers_u16(image, REGISTERS_AT_EVALUATOR),
      .moments = registers_u16(image, REGISTERS_AT_MOMENTS),
      .wanted = SAMPLE_WANTED,
      .medium_count = 1,
      .draw = (uint16_t)draw,
      .parameter_count = (uint16_t)channels_count_parameters(&parameters),
      .sample_count = registers_u16(image, REGISTERS_AT_SAMPLE_SAMPLE_COUNT),
      .sample_first =
          draw == CORE_DRAW_RANDOM ? registers_u32(image, REGISTERS_AT_SAMPLE_SAMPLE_FIRST) : 0,
      .seed = seeded ? registers_u32(image, REGISTERS_AT_SAMPLE_SEED) : 0,
  };
  wire_put_sample_request(question, &fixed);
  size_t bytes = WIRE_BYTES_sample_request;
  bytes += put_medium(question + bytes, image);
  bytes += channels_put_parameters(question + bytes, &parameters);
  if (draw == CORE_DRAW_LIST) {
    bytes += put_list(question + bytes, image, REGISTERS_AT_SAMPLE_U, (unsigned)fixed.sample_count,
                      core_evaluator_bytes(fixed.evaluator));
  }
  return bytes;
}

static size_t put_numbers(uint8_t *at, const uint16_t image[REGISTERS_END], unsigned address,
                          unsigned count) {
  for (unsigned i = 0; i < count; i++) {
    const double value = registers_number(image, address + 2 * i);
    memcpy(at + i * sizeof value, &value, sizeof value);
  }
  return count * sizeof(double);
}

static size_t put_invert(const uint16_t image[REGISTERS_END], uint8_t *question) {
  const unsigned count = registers_u16(image, REGISTERS_AT_INVERT_MEDIUM_COUNT);
  const wire_invert_request fixed = {
      .model = registers_u16(image, REGISTERS_AT_MODEL),
      .moments = registers_u16(image, REGISTERS_AT_MOMENTS),
      .given = registers_u16(image, REGISTERS_AT_INVERT_GIVEN),
      .medium_count = count,
      .g = registers_number(image, REGISTERS_AT_G),
      .eta = registers_number(image, REGISTERS_AT_ETA),
  };
  wire_put_invert_request(question, &fixed);
  size_t bytes = WIRE_BYTES_invert_request;
  bytes += put_numbers(question + bytes, image, REGISTERS_AT_INVERT_ALBEDO, count);
  return bytes + put_numbers(question + bytes, image, REGISTERS_AT_INVERT_LENGTH, count);
}

static size_t put_mc(const uint16_t image[REGISTERS_END], uint8_t *question) {
  const double thickness = registers_optional(image, REGISTERS_AT_PARAMETER_THICKNESS);
  const double error_total = registers_optional(image, REGISTERS_AT_MC_ERROR_TOTAL);
  const double error_rings = registers_optional(image, REGISTERS_AT_MC_ERROR_RINGS);
  const wire_mc_request fixed = {
      .spacing = registers_u16(image, REGISTERS_AT_MC_SPACING),
      .ring_count = registers_u16(image, REGISTERS_AT_MC_RING_COUNT),
      .radius_start = registers_number(image, REGISTERS_AT_RADIUS_START),
      .radius_stop = registers_number(image, REGISTERS_AT_RADIUS_STOP),
      .thickness = isnan(thickness) ? (double)INFINITY : thickness,
      .seed = registers_u32(image, REGISTERS_AT_MC_SEED),
      .photons = (uint64_t)registers_number(image, REGISTERS_AT_MC_PHOTONS),
      .error_total = isnan(error_total) ? 0 : error_total,
      .error_rings = isnan(error_rings) ? 0 : error_rings,
  };
  wire_put_mc_request(question, &fixed);
  const size_t bytes = WIRE_BYTES_mc_request + put_medium(question + WIRE_BYTES_mc_request, image);
  const core_parameters given = parameters_of(image);
  core_parameters taken = core_parameters_none();
  static const unsigned walks[] = {CORE_PARAMETER_PHASE, CORE_PARAMETER_PHASE_SHARE,
                                   CORE_PARAMETER_PHASE_G, CORE_PARAMETER_DETECTOR_NA};
  for (size_t i = 0; i < sizeof walks / sizeof walks[0]; i++) {
    taken.value[walks[i]] = given.value[walks[i]];
  }
  return bytes + channels_put_parameters(question + bytes, &taken);
}

/* Sets reading[] to value and standard error of a reading, or of its ratio to what was read of the
 * reference medium: the relative errors of both are independent. */
static void take_reading(const uint16_t image[REGISTERS_END], unsigned index, bool ratio,
                         double reading[2]) {
  const unsigned offset = 4 * index;
  reading[0] = registers_number(image, REGISTERS_AT_FIT_READING + offset);
  reading[1] = registers_number(image, REGISTERS_AT_FIT_READING + offset + 2);
  if (ratio) {
    const double known = registers_number(image, REGISTERS_AT_FIT_REFERENCE_READING + offset);
    const double error = registers_number(image, REGISTERS_AT_FIT_REFERENCE_READING + offset + 2);
    reading[0] = reading[0] / known;
    reading[1] = reading[1] > 0 ? hypot(reading[1], reading[0] * error) / known : 0;
  }
}

static size_t put_fit(const uint16_t image[REGISTERS_END], uint8_t *question) {
  const core_parameters parameters = parameters_of(image);
  const unsigned count = registers_u16(image, REGISTERS_AT_FIT_READING_COUNT);
  const fit_start start = {{.set_count = 1, .residuals = 1},
                           {
                               .model = registers_u16(image, REGISTERS_AT_MODEL),
                               .moments = registers_u16(image, REGISTERS_AT_MOMENTS),
                               .axis = registers_u16(image, REGISTERS_AT_FIT_AXIS),
                               .scale = registers_u16(image, REGISTERS_AT_FIT_SCALE),
                               .reading_count = count,
                               .parameter_count = (uint16_t)channels_count_parameters(&parameters),
                               .g = registers_number(image, REGISTERS_AT_G),
                               .eta = registers_number(image, REGISTERS_AT_ETA),
                           }};
  double at[REGISTERS_FIT_READINGS_MAX];
  double source_mm[REGISTERS_FIT_READINGS_MAX], detector_mm[REGISTERS_FIT_READINGS_MAX];
  for (unsigned i = 0; i < count; i++) {
    at[i] = registers_number(image, REGISTERS_AT_FIT_AT + 2 * i);
    source_mm[i] = registers_number(image, REGISTERS_AT_FIT_SOURCE);
    detector_mm[i] = registers_number(image, REGISTERS_AT_FIT_DETECTOR);
  }
  const core_medium reference = {registers_number(image, REGISTERS_AT_FIT_REFERENCE_SIGMA_A),
                                 registers_number(image, REGISTERS_AT_FIT_REFERENCE_SIGMA_S),
                                 registers_number(image, REGISTERS_AT_FIT_REFERENCE_G),
                                 registers_number(image, REGISTERS_AT_FIT_REFERENCE_ETA)};
  schema_layout layout;
  schema_lay_out(&schema_fit_request, &start, UINT64_MAX, &layout, NULL);
  memcpy(question, &start, sizeof start);
  channels_put_parameters(question + layout.parts[FIT_PARAMETERS].at, &parameters);
  schema_put_part(question, &layout, FIT_REFERENCE, &reference);
  schema_put_part(question, &layout, FIT_AT, at);
  schema_put_part(question, &layout, FIT_SOURCE, source_mm);
  schema_put_part(question, &layout, FIT_DETECTOR, detector_mm);
  uint8_t *to = question + layout.parts[FIT_VALUES].at;
  for (unsigned i = 0; i < count; i++) {
    double reading[2];
    take_reading(image, i, start.design.scale == CORE_FIT_SCALE_REFERENCE, reading);
    memcpy(to + i * sizeof(double), &reading[0], sizeof(double));
    memcpy(to + (count + i) * sizeof(double), &reading[1], sizeof(double));
  }
  return (size_t)layout.payload_bytes;
}

size_t modbus_translate_input(enum registers_job_kind kind, const uint16_t image[REGISTERS_END],
                              uint8_t *question) {
  static size_t (*const put[REGISTERS_JOBS])(const uint16_t image[REGISTERS_END],
                                             uint8_t *question) = {
      [REGISTERS_JOB_EVAL] = put_eval,     [REGISTERS_JOB_SAMPLE] = put_sample,
      [REGISTERS_JOB_INVERT] = put_invert, [REGISTERS_JOB_MC] = put_mc,
      [REGISTERS_JOB_FIT] = put_fit,
  };
  const size_t bytes = put[kind](image, question);
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
    return (struct values){question + WIRE_BYTES_eval_request + WIRE_BYTES_medium +
                               fixed->parameter_count * WIRE_BYTES_parameter,
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

/* Returns the largest numerical error of values at radii up to r. rounded: the values have been
 * rounded from double precision to float registers. */
static float stated_error(const wire_quantity_error *error, double r, bool rounded) {
  return rounded_up(error->numerical_error + error->numerical_error_per_mm * r +
                    (rounded ? 0x1p-24 : 0));
}

static void set_errors(uint16_t image[REGISTERS_END], const wire_quantity_error *error, double r,
                       bool rounded) {
  registers_set_f32(image, REGISTERS_AT_NUMERICAL_ERROR, stated_error(error, r, rounded));
  registers_set_f32(image, REGISTERS_AT_MODEL_ERROR, rounded_up(error->model_error));
  registers_set_f64(image, REGISTERS_AT_NUMERICAL_ERROR_DOUBLE, error->numerical_error);
  registers_set_f64(image, REGISTERS_AT_NUMERICAL_ERROR_PER_MM, error->numerical_error_per_mm);
  registers_set_f64(image, REGISTERS_AT_MODEL_ERROR_DOUBLE, error->model_error);
}

/* Sets the errors of each quantity of its own; NaN for those that are not wanted. */
static void set_errors_of_each(uint16_t image[REGISTERS_END], const uint8_t *reply,
                               const eval_layout *layout, unsigned wanted, double r, bool rounded) {
  static const unsigned quantities[REGISTERS_WANTED_MAX] = {CORE_QUANTITY_R, CORE_QUANTITY_ALBEDO,
                                                            CORE_QUANTITY_CDF, CORE_QUANTITY_S};
  for (unsigned i = 0; i < REGISTERS_WANTED_MAX; i++) {
    wire_quantity_error error = {(double)NAN, (double)NAN, (double)NAN};
    if ((wanted & quantities[i]) != 0) {
      wire_get_quantity_error(reply + eval_error_offset(layout, wanted, 0, quantities[i]), &error);
    }
    registers_set_f32(image, REGISTERS_AT_NUMERICAL_ERRORS + 2 * i,
                      stated_error(&error, r, rounded));
    registers_set_f32(image, REGISTERS_AT_MODEL_ERRORS + 2 * i, rounded_up(error.model_error));
  }
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

static void take_eval(const uint8_t *question, const uint8_t *reply, size_t reply_bytes,
                      uint16_t image[REGISTERS_END]) {
  wire_eval_request asked;
  wire_eval_reply start;
  eval_layout layout;
  wire_get_eval_request(question, &asked);
  wire_get_eval_reply(reply, &start);
  const unsigned count = (unsigned)start.count;
  const bool fits =
      eval_reply_layout(start.evaluator, start.wanted, 1, count, reply_bytes, &layout);
  assert(fits && count <= REGISTERS_RADII_MAX);

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
  const wire_quantity_error error = eval_largest_error(reply, &layout, start.wanted, 0);
  const double most_mm = largest(&radii, count);
  set_errors(image, &error, most_mm, R.bytes == sizeof(double));
  set_errors_of_each(image, reply, &layout, start.wanted, most_mm, R.bytes == sizeof(double));
  double albedo;
  memcpy(&albedo, reply + eval_albedo_offset(0), sizeof albedo);
  registers_set_f32(image, REGISTERS_AT_ALBEDO, (float)albedo);
  registers_set_f64(image, REGISTERS_AT_ALBEDO_DOUBLE, albedo);
  registers_set_u16(image, REGISTERS_AT_COUNT, count);
  registers_set_u16(image, REGISTERS_AT_MODEL_TAKEN, start.model);
  registers_set_u16(image, REGISTERS_AT_EVALUATOR_TAKEN, start.evaluator);
  registers_set_u16(image, REGISTERS_AT_NOTES, start.notes);
}

static void take_sample(const uint8_t *question, const uint8_t *reply, size_t reply_bytes,
                        uint16_t image[REGISTERS_END]) {
  (void)question;
  wire_eval_reply start;
  eval_layout layout;
  const bool whole = eval_reply_parse(reply, reply_bytes, true, &start, &layout);
  assert(whole && start.count <= REGISTERS_RADII_MAX);
  const size_t value_bytes = core_evaluator_bytes(start.evaluator);
  const unsigned drawn = SAMPLE_WANTED | EVAL_DRAWN;
  const struct values radii = {reply + eval_array_offset(&layout, drawn, 0, CORE_QUANTITY_RADIUS),
                               value_bytes};
  const struct values pdf = {reply + eval_array_offset(&layout, drawn, 0, CORE_QUANTITY_PDF),
                             value_bytes};
  const unsigned count = (unsigned)start.count;
  const wire_quantity_error error = eval_largest_error(reply, &layout, drawn, 0);
  const unsigned before = registers_u16(image, REGISTERS_AT_SAMPLE_COUNT);
  set_values(image, REGISTERS_AT_SAMPLE_R, 0, &radii, count, before);
  set_values(image, REGISTERS_AT_SAMPLE_PDF, 0, &pdf, count, before);
  registers_set_f32(image, REGISTERS_AT_SAMPLE_NUMERICAL_ERROR,
                    stated_error(&error, largest(&radii, count), value_bytes == sizeof(double)));
  registers_set_f32(image, REGISTERS_AT_SAMPLE_MODEL_ERROR, rounded_up(error.model_error));
  registers_set_u16(image, REGISTERS_AT_SAMPLE_COUNT, count);
  registers_set_u16(image, REGISTERS_AT_SAMPLE_NOTES, start.notes);
}

static void take_invert(const uint8_t *question, const uint8_t *reply, size_t reply_bytes,
                        uint16_t image[REGISTERS_END]) {
  static const unsigned at[INVERT_ARRAYS] = {
      REGISTERS_AT_INVERT_SIGMA_A, REGISTERS_AT_INVERT_SIGMA_S, REGISTERS_AT_INVERT_ALBEDO_FOUND};
  (void)question;
  wire_invert_reply start;
  const bool whole = invert_reply_parse(reply, reply_bytes, &start);
  assert(whole && start.part_count == 1 && start.count <= REGISTERS_RADII_MAX);
  const unsigned count = (unsigned)start.count;
  const unsigned before = registers_u16(image, REGISTERS_AT_INVERT_COUNT);
  for (unsigned i = 0; i < INVERT_ARRAYS; i++) {
    const struct values values = {reply + invert_array_offset(i, count), sizeof(double)};
    set_values(image, at[i], 0, &values, count, before);
  }
  registers_set_u16(image, REGISTERS_AT_INVERT_COUNT, count);
  registers_set_u16(image, REGISTERS_AT_INVERT_MISSING_COUNT, (unsigned)start.missing_count);
  registers_set_f32(image, REGISTERS_AT_INVERT_ALBEDO_LEAST, (float)start.albedo_least);
  registers_set_f32(image, REGISTERS_AT_INVERT_ALBEDO_MOST, (float)start.albedo_most);
}

/* Writes the progress of an mc job, which every reply to its request has. */
static void set_progress(uint16_t image[REGISTERS_END], const wire_mc_reply *reply) {
  const double expected = (double)reply->photons_expected;
  const double progress = expected > 0 ? (double)reply->photons / expected : 0;
  registers_set_f32(image, REGISTERS_AT_MC_PROGRESS, (float)progress);
  registers_set_f32(image, REGISTERS_AT_MC_PHOTONS_WALKED, (float)reply->photons);
  registers_set_f32(image, REGISTERS_AT_MC_PHOTONS_EXPECTED, (float)expected);
  registers_set_f32(image, REGISTERS_AT_MC_ERROR_TOTAL_NOW, rounded_up(reply->error_total));
  registers_set_f32(image, REGISTERS_AT_MC_ERROR_RINGS_NOW, rounded_up(reply->error_rings));
}

static void set_energy(uint16_t image[REGISTERS_END], const wire_mc_energy *energy) {
  const struct {
    unsigned at;
    double value;
  } numbers[] = {
      {REGISTERS_AT_MC_REFLECTED, energy->reflected},
      {REGISTERS_AT_MC_TRANSMITTED, energy->transmitted},
      {REGISTERS_AT_MC_ABSORBED, energy->absorbed},
      {REGISTERS_AT_MC_UNFINISHED, energy->unfinished},
      {REGISTERS_AT_MC_IMBALANCE, energy->imbalance},
      {REGISTERS_AT_MC_UNSCATTERED, energy->unscattered[0]},
      {REGISTERS_AT_MC_UNSCATTERED + 2, energy->unscattered[1]},
      {REGISTERS_AT_MC_UNDER, energy->under[0]},
      {REGISTERS_AT_MC_UNDER + 2, energy->under[1]},
      {REGISTERS_AT_MC_OVER, energy->over[0]},
      {REGISTERS_AT_MC_OVER + 2, energy->over[1]},
  };
  for (size_t i = 0; i < sizeof numbers / sizeof numbers[0]; i++) {
    registers_set_f32(image, numbers[i].at, (float)numbers[i].value);
  }
  registers_set_f32(image, REGISTERS_AT_MC_REFLECTED_ERROR, rounded_up(energy->reflected_error));
  registers_set_f32(image, REGISTERS_AT_MC_TRANSMITTED_ERROR,
                    rounded_up(energy->transmitted_error));
  registers_set_f32(image, REGISTERS_AT_MC_ABSORBED_ERROR, rounded_up(energy->absorbed_error));
}

static void take_mc(const uint8_t *question, const uint8_t *reply, size_t reply_bytes,
                    uint16_t image[REGISTERS_END]) {
  static const unsigned at[CORE_MC_SIDES][2] = {
      {REGISTERS_AT_MC_R, REGISTERS_AT_MC_R_ERROR},
      {REGISTERS_AT_MC_T, REGISTERS_AT_MC_T_ERROR},
  };
  (void)question;
  wire_mc_reply start;
  wire_mc_energy energy;
  mc_layout layout;
  const bool whole = mc_reply_parse(reply, reply_bytes, &start, &layout);
  assert(whole);
  set_progress(image, &start);
  if (start.state == MC_UNDER_WAY) {
    return;
  }
  wire_get_mc_energy(reply + layout.energies_offset, &energy);
  set_energy(image, &energy);
  const unsigned count = start.ring_count;
  const unsigned before = registers_u16(image, REGISTERS_AT_MC_COUNT);
  const struct values edges = {reply + layout.edges_offset, sizeof(double)};
  set_values(image, REGISTERS_AT_MC_EDGES, 0, &edges, count + 1, before > 0 ? before + 1 : 0);
  for (unsigned i = 0; i < 2 * CORE_MC_SIDES; i++) {
    const unsigned side = i / 2;
    struct values values = {NULL, sizeof(double)};
    if (side < start.side_count) {
      values.at = reply + mc_rings_offset(&layout, start.side_count, count, 0, side, i % 2);
    }
    set_values(image, at[side][i % 2], 0, &values, count, before);
  }
  registers_set_u16(image, REGISTERS_AT_MC_COUNT, count);
  registers_set_u16(image, REGISTERS_AT_MC_STATE, start.state);
  registers_set_f32(image, REGISTERS_AT_MC_PROGRESS, 1);
}

/* Names the reading that is wrong. A ratio that is not finite was divided by a reference reading of
 * 0. */
static wire_error wrong_reading(const uint8_t *question, const wire_fitted *fitted) {
  double asked;
  schema_layout layout;
  schema_lay_out(&schema_fit_request, question, UINT64_MAX, &layout, NULL);
  memcpy(&asked, question + layout.parts[FIT_VALUES].at + fitted->index * sizeof asked,
         sizeof asked);
  const bool value = fitted->field == 1;
  wire_error error;
  if (value && !isfinite(asked)) {
    error = wire_error_make(WIRE_STATUS_BAD_VALUE, "reference_reading", "above 0");
  } else {
    error = wire_error_make(WIRE_STATUS_BAD_VALUE, "reading",
                            value ? "a finite value" : "a standard error above 0");
  }
  error.index = 2 * fitted->index + (value ? 0 : 1);
  return error;
}

static float root(double variance) {
  return rounded_up(sqrt(variance));
}

static void set_fitted(uint16_t image[REGISTERS_END], const uint8_t *question,
                       const wire_fitted *fitted) {
  wire_fit_design design;
  wire_get_fit_design(question + WIRE_BYTES_fit_request, &design);
  const struct {
    unsigned at;
    double value;
  } numbers[] = {
      {REGISTERS_AT_FIT_SIGMA_A, fitted->sigma_a},
      {REGISTERS_AT_FIT_SIGMA_S_PRIME, fitted->sigma_s_prime},
      {REGISTERS_AT_FIT_CORRELATION,
       fitted->covariance_a_s / sqrt(fitted->variance_a * fitted->variance_s)},
      {REGISTERS_AT_FIT_CHI_SQUARED, fitted->chi_squared},
      {REGISTERS_AT_FIT_REDUCED, fitted->reduced_chi_squared},
      {REGISTERS_AT_FIT_FACTOR, fitted->factor},
      {REGISTERS_AT_FIT_CONDITION, fitted->condition},
      {REGISTERS_AT_FIT_SECOND, fitted->second_sigma_a},
      {REGISTERS_AT_FIT_SECOND + 2, fitted->second_sigma_s_prime},
      {REGISTERS_AT_FIT_SECOND + 4, fitted->second_chi_squared},
      {REGISTERS_AT_FIT_G, design.g},
      {REGISTERS_AT_FIT_ETA, design.eta},
  };
  for (size_t i = 0; i < sizeof numbers / sizeof numbers[0]; i++) {
    registers_set_f32(image, numbers[i].at, (float)numbers[i].value);
  }
  registers_set_f32(image, REGISTERS_AT_FIT_SIGMA_A_ERROR, root(fitted->variance_a));
  registers_set_f32(image, REGISTERS_AT_FIT_SIGMA_S_PRIME_ERROR, root(fitted->variance_s));
  registers_set_f32(image, REGISTERS_AT_FIT_FACTOR_ERROR, root(fitted->variance_factor));
  registers_set_f32(image, REGISTERS_AT_FIT_MODEL_ERROR, rounded_up(fitted->model_error));
  registers_set_u16(image, REGISTERS_AT_FIT_FIT_STATUS, fitted->status);
  registers_set_text(image, REGISTERS_AT_FIT_FIT_STATUS_NAME, REGISTERS_FIT_STATUS_NAME_BYTES / 2,
                     core_choice_by_id(core_fit_statuses, fitted->status)->name);
  registers_set_u16(image, REGISTERS_AT_FIT_BOUNDS, fitted->bounds);
}

static enum registers_status take_fit(const uint8_t *question, const uint8_t *reply,
                                      size_t reply_bytes, uint16_t image[REGISTERS_END],
                                      wire_error *error) {
  wire_fit_reply start;
  wire_fitted fitted;
  const bool whole = fit_reply_parse(reply, reply_bytes, &start);
  assert(whole && start.count == 1 && start.reading_count <= REGISTERS_FIT_READINGS_MAX);
  wire_get_fitted(reply + WIRE_BYTES_fit_reply, &fitted);
  if (fitted.status == CORE_FIT_STATUS_REFUSED) {
    *error = wrong_reading(question, &fitted);
    return REGISTERS_STATUS_ERROR;
  }
  set_fitted(image, question, &fitted);
  const struct values residuals = {reply + fit_residuals_offset(1), sizeof(double)};
  set_values(image, REGISTERS_AT_FIT_RESIDUAL, 0, &residuals, start.reading_count,
             registers_u16(image, REGISTERS_AT_FIT_COUNT));
  registers_set_u16(image, REGISTERS_AT_FIT_COUNT, start.reading_count);
  registers_set_u16(image, REGISTERS_AT_FIT_NOTES, start.notes);
  return fitted.status == CORE_FIT_STATUS_FITTED ? REGISTERS_STATUS_DONE
                                                 : REGISTERS_STATUS_UNFITTED;
}

enum registers_status modbus_translate_reply(enum registers_job_kind kind, const uint8_t *question,
                                             const uint8_t *reply, size_t reply_bytes,
                                             uint16_t image[REGISTERS_END], wire_error *error) {
  static void (*const take[REGISTERS_JOBS])(const uint8_t *question, const uint8_t *reply,
                                            size_t reply_bytes, uint16_t image[REGISTERS_END]) = {
      [REGISTERS_JOB_EVAL] = take_eval,
      [REGISTERS_JOB_SAMPLE] = take_sample,
      [REGISTERS_JOB_INVERT] = take_invert,
      [REGISTERS_JOB_MC] = take_mc,
  };
  if (kind == REGISTERS_JOB_FIT) {
    return take_fit(question, reply, reply_bytes, image, error);
  }
  take[kind](question, reply, reply_bytes, image);
  return REGISTERS_STATUS_DONE;
}
