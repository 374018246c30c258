#include "proto/varying.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "proto/channels.h"

/* Arrays are used in place, so this machine must be little-endian like the protocol. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's arrays need swapping");

/* The quantities that a value of its own medium may have. */
#define QUANTITIES                                                                                 \
  (CORE_QUANTITY_R | CORE_QUANTITY_ALBEDO | CORE_QUANTITY_CDF | CORE_QUANTITY_RADIUS |             \
   CORE_QUANTITY_PDF | CORE_QUANTITY_RING | CORE_QUANTITY_MODEL_ERROR)

#define CORE_COEFFICIENT(bit, IDENT, name, about) | (bit)
enum {
  COEFFICIENTS = 0
#include "core/choices.def"
};

enum { MEDIUM_ARRAYS = 2 };

/* ---- requests -------------------------------------------------------------------------------- */

static unsigned array_count(const wire_varying_request *fixed) {
  return MEDIUM_ARRAYS + (fixed->numbers != VARYING_NONE);
}

uint64_t varying_request_bytes(uint32_t parameter_count, unsigned evaluator, unsigned arrays,
                               uint64_t value_count) {
  return WIRE_BYTES_varying_request + (uint64_t)parameter_count * WIRE_BYTES_parameter +
         arrays * wire_padded(value_count * core_evaluator_bytes(evaluator));
}

static wire_error bad_value(const char *field, const char *allowed) {
  return wire_error_make(WIRE_STATUS_BAD_VALUE, field, allowed);
}

/* Checks which arrays are wanted. Without radii and numbers u, only the albedo is known. */
static wire_error check_wanted(const wire_varying_request *fixed) {
  const unsigned most = fixed->numbers == VARYING_DRAWN ? (unsigned)QUANTITIES
                        : fixed->numbers == VARYING_RADII
                            ? (unsigned)QUANTITIES & ~(unsigned)CORE_QUANTITY_RADIUS
                            : (unsigned)(CORE_QUANTITY_ALBEDO | CORE_QUANTITY_MODEL_ERROR);
  if (channels_has_others(fixed->wanted)) {
    return wire_error_not_in_list("wanted", core_quantities, "a sum of");
  }
  if ((fixed->wanted & ~most) != 0) {
    return bad_value("wanted", "R, albedo, cdf, pdf, 2_pi_r_R, model_error of radii; "
                               "r besides of numbers u; else albedo");
  }
  if ((fixed->coefficients & ~(unsigned)COEFFICIENTS) != 0) {
    return wire_error_not_in_list("coefficients", core_coefficients, "a sum of");
  }
  return (fixed->wanted & ~CORE_QUANTITY_MODEL_ERROR) == 0 && fixed->coefficients == 0
             ? bad_value("wanted", "at least one quantity or coefficient")
             : wire_error_none();
}

/* Checks how the media are given. */
static wire_error check_given(const wire_varying_request *fixed) {
  if (fixed->given == 0) {
    return fixed->light != 0      ? bad_value("light", "0 where sigma_a and sigma_s are given")
           : fixed->specular != 0 ? bad_value("specular", "0 where sigma_a and sigma_s are given")
                                  : wire_error_none();
  }
  if (core_choice_by_id(core_lengths, fixed->given) == NULL) {
    return wire_error_not_in_list("given", core_lengths, "0 or one of");
  }
  if (core_choice_by_id(core_lights, fixed->light) == NULL) {
    return wire_error_not_in_list("light", core_lights, "one of");
  }
  return fixed->specular > 1 ? bad_value("specular", "0 or 1") : wire_error_none();
}

static wire_error check_choices(const wire_varying_request *fixed) {
  if (core_choice_by_id(core_models, fixed->model) == NULL) {
    return wire_error_not_in_list("model", core_models, "one of");
  }
  if (fixed->evaluator != CORE_EVALUATOR_F64 && fixed->evaluator != CORE_EVALUATOR_F32) {
    return bad_value("evaluator", "f64 or f32");
  }
  if (core_choice_by_id(core_moments_list, fixed->moments) == NULL) {
    return wire_error_not_in_list("moments", core_moments_list, "one of");
  }
  if (fixed->numbers >= VARYING_NUMBERS) {
    return bad_value("numbers", "0 (none), 1 (radii) or 2 (numbers u)");
  }
  wire_error error = check_given(fixed);
  if (error.status == WIRE_STATUS_OK) {
    error = check_wanted(fixed);
  }
  return error.status != WIRE_STATUS_OK || fixed->zero == 0 ? error : bad_value("zero", "0");
}

/* Finds the arrays in the `left` bytes at `at`, which they have to fill. */
static wire_error find_arrays(const uint8_t *at, uint64_t left, varying_request *request) {
  static const uint8_t zeros[WIRE_ALIGNMENT];
  static const char *const names[] = {"sigma_a", "sigma_s", "colour", "length", "r", "u"};
  const wire_varying_request *fixed = &request->fixed;
  const size_t value_bytes = core_evaluator_bytes(fixed->evaluator);
  const unsigned arrays = array_count(fixed);
  if (fixed->value_count > left / arrays / value_bytes ||
      arrays * wire_padded(fixed->value_count * value_bytes) != left) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "value_count",
                           "as many numbers in each array, with its padding, as the payload holds");
  }
  const size_t used = (size_t)fixed->value_count * value_bytes;
  const void *found[MEDIUM_ARRAYS + 1] = {NULL};
  for (unsigned i = 0; i < arrays; i++, at += wire_padded(used)) {
    found[i] = at;
    if (memcmp(at + used, zeros, (size_t)wire_padded(used) - used) != 0) {
      const unsigned name =
          i < MEDIUM_ARRAYS ? i + (fixed->given != 0 ? 2 : 0) : 3U + fixed->numbers;
      return bad_value(names[name], "zero bytes of padding behind the last number");
    }
  }
  request->media[0] = found[0];
  request->media[1] = found[1];
  request->numbers = found[2];
  return wire_error_none();
}

wire_error varying_request_parse(const uint8_t *payload, size_t payload_bytes,
                                 varying_request *request) {
  wire_varying_request *fixed = &request->fixed;
  if (payload_bytes < WIRE_BYTES_varying_request) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes",
                           "at least 48: a varying_request");
  }
  wire_get_varying_request(payload, fixed);
  wire_error error = check_choices(fixed);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  const uint64_t before = varying_request_bytes(fixed->parameter_count, fixed->evaluator, 0, 0);
  if (before > payload_bytes) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "parameter_count",
                           "no more parameters than the payload holds");
  }
  error = channels_parse_parameters(payload + WIRE_BYTES_varying_request, fixed->parameter_count,
                                    &request->parameters);
  request->colour = (core_colour){.light = (enum core_light)(fixed->light - 1),
                                  .specular = fixed->specular != 0,
                                  .length = (enum core_length)fixed->given};
  return error.status == WIRE_STATUS_OK
             ? find_arrays(payload + before, payload_bytes - before, request)
             : error;
}

/* ---- replies --------------------------------------------------------------------------------- */

varying_layout varying_reply_layout(unsigned evaluator, unsigned wanted, unsigned coefficients,
                                    uint64_t count) {
  varying_layout layout = {
      .arrays = coefficients | VARYING_QUANTITY(wanted & ~(unsigned)CORE_QUANTITY_MODEL_ERROR),
      .array_bytes = wire_padded(count * core_evaluator_bytes(evaluator)),
  };
  const uint64_t arrays = (uint64_t)__builtin_popcount(layout.arrays);
  layout.status_offset = WIRE_BYTES_varying_reply + arrays * layout.array_bytes;
  layout.payload_bytes = layout.status_offset + wire_padded(count);
  return layout;
}

uint64_t varying_part_values(unsigned evaluator, unsigned wanted, unsigned coefficients,
                             uint64_t max_payload_bytes) {
  /* Neither arrays nor statuses of so many values have padding. */
  const varying_layout unit =
      varying_reply_layout(evaluator, wanted, coefficients, VARYING_PART_VALUES);
  const uint64_t unit_bytes = unit.payload_bytes - WIRE_BYTES_varying_reply;
  return max_payload_bytes > WIRE_BYTES_varying_reply
             ? (max_payload_bytes - WIRE_BYTES_varying_reply) / unit_bytes * VARYING_PART_VALUES
             : 0;
}

uint64_t varying_array_offset(const varying_layout *layout, uint32_t array) {
  return WIRE_BYTES_varying_reply +
         (uint64_t)__builtin_popcount(layout->arrays & (array - 1)) * layout->array_bytes;
}

bool varying_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_varying_reply *fixed,
                         varying_layout *layout) {
  if (payload_bytes < WIRE_BYTES_varying_reply) {
    return false;
  }
  wire_get_varying_reply(payload, fixed);
  if ((fixed->evaluator != CORE_EVALUATOR_F64 && fixed->evaluator != CORE_EVALUATOR_F32) ||
      (fixed->wanted & ~QUANTITIES) != 0 || (fixed->coefficients & ~(unsigned)COEFFICIENTS) != 0 ||
      fixed->count > payload_bytes || fixed->answered_count > fixed->count) {
    return false;
  }
  *layout = varying_reply_layout(fixed->evaluator, fixed->wanted, fixed->coefficients,
                                 fixed->count);
  return fixed->part < fixed->part_count && layout->payload_bytes == payload_bytes;
}

/* ---- evaluating ------------------------------------------------------------------------------ */

/* One slice: its arrays and the precision of all of them. */
struct slice {
  const core_varying *varying;
  bool single;
  size_t n;
  const void *sigma_a;
  const void *sigma_s;
};

static void evaluate(const struct slice *slice, enum core_quantity quantity, const void *r,
                     void *out) {
  if (slice->single) {
    core_varying_eval_f32(slice->varying, quantity, slice->n, slice->sigma_a, slice->sigma_s, r,
                          out);
  } else {
    core_varying_eval_f64(slice->varying, quantity, slice->n, slice->sigma_a, slice->sigma_s, r,
                          out);
  }
}

static void sample(const struct slice *slice, const void *u, void *r) {
  if (slice->single) {
    core_varying_sample_f32(slice->varying, slice->n, slice->sigma_a, slice->sigma_s, u, r);
  } else {
    core_varying_sample_f64(slice->varying, slice->n, slice->sigma_a, slice->sigma_s, u, r);
  }
}

static void check(const struct slice *slice, bool drawn, const void *numbers, uint8_t *status,
                  core_varying_range *range) {
  const core_varying *varying = slice->varying;
  const void *a = slice->sigma_a, *s = slice->sigma_s;
  if (drawn && slice->single) {
    core_varying_check_u_f32(varying, slice->n, a, s, numbers, status, range);
  } else if (drawn) {
    core_varying_check_u_f64(varying, slice->n, a, s, numbers, status, range);
  } else if (slice->single) {
    core_varying_check_f32(varying, slice->n, a, s, numbers, status, range);
  } else {
    core_varying_check_f64(varying, slice->n, a, s, numbers, status, range);
  }
}

/* Copies a medium's coefficient, or computes the albedo of single scattering. */
static void copy_coefficient(const struct slice *slice, unsigned coefficient, void *out) {
  const size_t bytes = slice->n * (slice->single ? sizeof(float) : sizeof(double));
  if (coefficient != CORE_COEFFICIENT_SCATTERED) {
    memcpy(out, coefficient == CORE_COEFFICIENT_SIGMA_A ? slice->sigma_a : slice->sigma_s, bytes);
    return;
  }
  for (size_t i = 0; i < slice->n; i++) {
    if (slice->single) {
      const float a = ((const float *)slice->sigma_a)[i], s = ((const float *)slice->sigma_s)[i];
      ((float *)out)[i] = s / (a + s);
    } else {
      const double a = ((const double *)slice->sigma_a)[i];
      const double s = ((const double *)slice->sigma_s)[i];
      ((double *)out)[i] = s / (a + s);
    }
  }
}

/* Fills an array of the slice with one number. */
static void fill(const struct slice *slice, double value, void *out) {
  for (size_t i = 0; i < slice->n; i++) {
    if (slice->single) {
      ((float *)out)[i] = (float)value;
    } else {
      ((double *)out)[i] = value;
    }
  }
}

/* The memory of one slice. */
struct scratch {
  double *sigma_a, *sigma_s, *r, *truth;
  uint8_t *status, *known;
};

static struct scratch divide(double *scratch) {
  double *arrays[VARYING_SCRATCH_ARRAYS];
  for (size_t i = 0; i < VARYING_SCRATCH_ARRAYS; i++) {
    arrays[i] = scratch + i * VARYING_SLICE_VALUES;
  }
  return (struct scratch){
      arrays[0], arrays[1], arrays[2], arrays[3], (uint8_t *)arrays[4], (uint8_t *)arrays[5]};
}

/* Returns where the part's values from `begin` on of an array go; NULL if it is not wanted. */
static void *place(const varying_part *part, uint32_t array, uint64_t begin, size_t value_bytes) {
  return (part->layout.arrays & array) != 0
             ? part->payload + varying_array_offset(&part->layout, array) + begin * value_bytes
             : NULL;
}

/* Finds the media of colours and their statuses. Writes the coefficients that are wanted. */
static void invert(struct slice *slice, const varying_part *part, const varying_request *request,
                   uint64_t begin, const void *const media[2], const struct scratch *scratch) {
  const size_t bytes = slice->single ? sizeof(float) : sizeof(double);
  void *sigma_a = place(part, CORE_COEFFICIENT_SIGMA_A, begin, bytes);
  void *sigma_s = place(part, CORE_COEFFICIENT_SIGMA_S, begin, bytes);
  void *scattered = place(part, CORE_COEFFICIENT_SCATTERED, begin, bytes);
  sigma_a = sigma_a != NULL ? sigma_a : scratch->sigma_a;
  sigma_s = sigma_s != NULL ? sigma_s : scratch->sigma_s;
  if (slice->single) {
    core_varying_invert_f32(slice->varying, &request->colour, slice->n, media[0], media[1], sigma_a,
                            sigma_s, scattered, scratch->status);
  } else {
    core_varying_invert_f64(slice->varying, &request->colour, slice->n, media[0], media[1], sigma_a,
                            sigma_s, scattered, scratch->status);
  }
  slice->sigma_a = sigma_a;
  slice->sigma_s = sigma_s;
}

static void take_media(struct slice *slice, const varying_part *part,
                       const varying_request *request, uint64_t begin, const void *const media[2],
                       const struct scratch *scratch) {
  if (request->fixed.given != 0) {
    invert(slice, part, request, begin, media, scratch);
    return;
  }
  slice->sigma_a = media[0];
  slice->sigma_s = media[1];
  for (const core_choice *each = core_coefficients; each->name != NULL; each++) {
    void *to = place(part, each->id, begin, slice->single ? sizeof(float) : sizeof(double));
    if (to != NULL) {
      copy_coefficient(slice, each->id, to);
    }
  }
}

/* Makes a value that is not answered NaN in every array. */
static void clear(const varying_part *part, uint64_t value, bool single) {
  for (uint32_t array = 1; array != 0 && array <= part->layout.arrays; array <<= 1) {
    void *at = place(part, array, value, single ? sizeof(float) : sizeof(double));
    if (at != NULL && single) {
      *(float *)at = NAN;
    } else if (at != NULL) {
      *(double *)at = (double)NAN;
    }
  }
}

/* Adds the statuses of the colours to those of the media. A colour without a medium has a NaN for
 * its medium, whose status is then no news. */
static void put_statuses(const varying_part *part, const varying_request *request, uint64_t begin,
                         const struct slice *slice, const struct scratch *scratch,
                         size_t answered) {
  uint8_t *status = part->payload + part->layout.status_offset + begin;
  if (answered == slice->n) {
    return;
  }
  for (size_t i = 0; i < slice->n; i++) {
    if (request->fixed.given != 0 && scratch->status[i] != CORE_VALUE_OK) {
      status[i] = scratch->status[i];
    }
    if (status[i] != CORE_VALUE_OK && status[i] != CORE_VALUE_FAR) {
      clear(part, begin + i, slice->single);
    }
  }
}

void varying_part_start(varying_part *part, const varying_request *request, uint8_t *payload,
                        uint64_t first, uint64_t count) {
  const wire_varying_request *fixed = &request->fixed;
  const size_t used = (size_t)count * core_evaluator_bytes(fixed->evaluator);
  *part = (varying_part){.payload = payload, .first = first, .count = count};
  part->layout = varying_reply_layout(fixed->evaluator, fixed->wanted, fixed->coefficients, count);
  part->range =
      (core_varying_range){.albedo_least = (double)INFINITY, .mfp_least = (double)INFINITY};
  part->model_error = (double)NAN;
  for (uint64_t at = WIRE_BYTES_varying_reply; at < part->layout.status_offset;
       at += part->layout.array_bytes) {
    memset(payload + at + used, 0, (size_t)part->layout.array_bytes - used);
  }
  memset(payload + part->layout.status_offset + count, 0, (size_t)(wire_padded(count) - count));
}

/* Raises the part's model error to that of an array of the slice. */
static void compare(varying_part *part, const struct slice *slice, const struct scratch *scratch,
                    unsigned quantity, const uint8_t *status, const void *values) {
  for (size_t i = 0; i < slice->n; i++) {
    const double value =
        slice->single ? (double)((const float *)values)[i] : ((const double *)values)[i];
    const double truth =
        slice->single ? (double)((const float *)scratch->truth)[i] : scratch->truth[i];
    if (status[i] == CORE_VALUE_OK && scratch->known[i] == CORE_VALUE_OK && !isinf(truth)) {
      const double apart = fabs(value - truth);
      const double relative = quantity == CORE_QUANTITY_CDF ? apart : apart > 0 ? apart / truth : 0;
      part->model_error = fmax(part->model_error, relative);
    }
  }
}

/* Compares the slice's values with those of transport. given: radii or numbers u; r: the radii. */
static void compare_all(varying_part *part, const struct slice *slice, const core_varying *ruler,
                        const struct scratch *scratch, bool drawn, uint64_t begin,
                        const void *given, const void *r) {
  const size_t bytes = slice->single ? sizeof(float) : sizeof(double);
  const uint8_t *status = part->payload + part->layout.status_offset + begin;
  struct slice truth = *slice;
  core_varying_range unused;
  truth.varying = ruler;
  check(&truth, drawn, given, scratch->known, &unused);
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    const void *values = place(part, VARYING_QUANTITY(quantity->id), begin, bytes);
    if (values == NULL) {
      continue;
    }
    if (quantity->id == CORE_QUANTITY_RADIUS) {
      sample(&truth, given, scratch->truth);
    } else {
      evaluate(&truth, quantity->id, r, scratch->truth);
    }
    compare(part, slice, scratch, quantity->id, status, values);
  }
}

void varying_part_evaluate(varying_part *part, const varying_request *request,
                           const core_varying *varying, const core_varying *ruler, uint64_t begin,
                           size_t n, double *scratch) {
  const struct scratch memory = divide(scratch);
  const wire_varying_request *fixed = &request->fixed;
  const size_t bytes = core_evaluator_bytes(fixed->evaluator);
  const size_t offset = (size_t)(part->first + begin) * bytes;
  const bool drawn = fixed->numbers == VARYING_DRAWN;
  struct slice slice = {.varying = varying, .single = bytes == sizeof(float), .n = n};
  const void *media[] = {(const uint8_t *)request->media[0] + offset,
                         (const uint8_t *)request->media[1] + offset};
  take_media(&slice, part, request, begin, media, &memory);
  const void *numbers = memory.r;
  if (fixed->numbers == VARYING_NONE) { /* any number u: the albedo has no radius */
    fill(&slice, 0.5, memory.r);
  } else {
    numbers = (const uint8_t *)request->numbers + offset;
  }
  core_varying_range range;
  check(&slice, fixed->numbers != VARYING_RADII, numbers,
        part->payload + part->layout.status_offset + begin, &range);
  core_varying_range_add(&part->range, &range);
  const void *given = numbers;
  if (drawn && (fixed->wanted & ~(CORE_QUANTITY_ALBEDO | CORE_QUANTITY_MODEL_ERROR)) != 0) {
    void *r = place(part, VARYING_QUANTITY(CORE_QUANTITY_RADIUS), begin, bytes);
    r = r != NULL ? r : memory.r;
    sample(&slice, numbers, r);
    numbers = r;
  }
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    void *to = place(part, VARYING_QUANTITY(quantity->id), begin, bytes);
    if (to != NULL && quantity->id == CORE_QUANTITY_ALBEDO) {
      evaluate(&slice, CORE_QUANTITY_ALBEDO, NULL, to);
    } else if (to != NULL && quantity->id != CORE_QUANTITY_RADIUS) {
      evaluate(&slice, quantity->id, numbers, to);
    }
  }
  put_statuses(part, request, begin, &slice, &memory, range.answered);
  if (ruler != NULL) {
    compare_all(part, &slice, ruler, &memory, fixed->numbers != VARYING_RADII, begin, given,
                numbers);
  }
}

/* Returns colours of the light of a request: what a medium reflects per power that entered, and,
 * if the request's colours contain it, what the surface reflects. */
static double seen(const varying_request *request, const core_varying *varying, double colour) {
  const double surface = varying->specular[request->colour.light];
  return request->colour.specular ? surface + (1 - surface) * colour : colour;
}

/* Returns the model error of a part; that of transport itself counts, too. */
static double model_error(const varying_part *part, const core_varying *varying,
                          const core_varying *ruler, unsigned wanted) {
  if ((wanted & CORE_QUANTITY_MODEL_ERROR) == 0) {
    return (double)NAN;
  }
  return ruler == NULL ? core_varying_stated_error(varying, wanted, &part->range)
                       : part->model_error + (1 + part->model_error) *
                                                 core_varying_error(ruler, wanted, &part->range);
}

void varying_part_end(const varying_part *part, const varying_request *request,
                      const core_varying *varying, const core_varying *ruler, uint32_t number,
                      uint32_t part_count) {
  const wire_varying_request *fixed = &request->fixed;
  const bool colours = fixed->given != 0;
  const enum core_light light = request->colour.light;
  const wire_varying_reply start = {
      .model = fixed->model,
      .evaluator = fixed->evaluator,
      .moments = fixed->moments,
      .wanted = fixed->wanted,
      .coefficients = fixed->coefficients,
      .notes = varying->notes,
      .count = part->count,
      .first = part->first,
      .part = number,
      .part_count = part_count,
      .answered_count = part->range.answered,
      .numerical_error = core_varying_error(varying, fixed->wanted, &part->range),
      .model_error = model_error(part, varying, ruler, fixed->wanted),
      .colour_least = colours ? seen(request, varying, varying->colour_least[light]) : (double)NAN,
      .colour_most = colours ? seen(request, varying, varying->colour_most[light]) : (double)NAN,
      .specular = colours ? varying->specular[light] : (double)NAN,
  };
  wire_put_varying_reply(part->payload, &start);
}
