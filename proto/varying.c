#include "proto/varying.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/model_error.h"
#include "proto/schema.h"

/* The quantities of a value that has its own medium. */
#define QUANTITIES                                                                                 \
  (CORE_QUANTITY_R | CORE_QUANTITY_ALBEDO | CORE_QUANTITY_CDF | CORE_QUANTITY_RADIUS |             \
   CORE_QUANTITY_PDF | CORE_QUANTITY_RING | CORE_QUANTITY_MODEL_ERROR)

#define OR_BIT(P, bit, ...) | (bit)
enum { COEFFICIENTS = 0 CORE_EACH_COEFFICIENT(OR_BIT, ) };

/* ---- requests -------------------------------------------------------------------------------- */

/* Checks which arrays are wanted. Without radii and numbers u, only the albedo is known. */
static wire_error check_wanted(const wire_varying_request *fixed) {
  const unsigned most = fixed->numbers == VARYING_DRAWN ? (unsigned)QUANTITIES
                        : fixed->numbers == VARYING_RADII
                            ? (unsigned)QUANTITIES & ~(unsigned)CORE_QUANTITY_RADIUS
                            : (unsigned)(CORE_QUANTITY_ALBEDO | CORE_QUANTITY_MODEL_ERROR);
  if ((fixed->wanted & ~most) != 0) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "wanted",
                           "R, albedo, cdf, pdf, 2_pi_r_R, model_error of radii; "
                           "with u r too; else albedo");
  }
  return (fixed->wanted & ~CORE_QUANTITY_MODEL_ERROR) == 0 && fixed->coefficients == 0
             ? wire_error_make(WIRE_STATUS_BAD_VALUE, "wanted",
                               "at least one quantity or coefficient")
             : wire_error_none();
}

/* Checks that a request with colours has a light and lengths. */
static wire_error check_colours(const wire_varying_request *fixed) {
  return fixed->given != 0 && fixed->light == 0
             ? wire_error_not_in_list("light", core_lights, "one of")
             : wire_error_none();
}

wire_error varying_request_parse(const uint8_t *payload, size_t payload_bytes,
                                 varying_request *request) {
  enum { PARAMETERS, SIGMA_A, COLOUR, SIGMA_S, LENGTH, R, U };
  wire_varying_request *fixed = &request->fixed;
  schema_layout layout;
  wire_error error = schema_check(&schema_varying_request, payload, payload_bytes, &layout);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  wire_get_varying_request(payload, fixed);
  error = check_colours(fixed);
  if (error.status == WIRE_STATUS_OK) {
    error = check_wanted(fixed);
  }
  request->colour = (core_colour){.light = (enum core_light)(fixed->light - 1),
                                  .specular = fixed->specular != 0,
                                  .length = (enum core_length)fixed->given};
  /* The offset of a part that does not exist is that of the next one. */
  request->media[0] = payload + layout.parts[SIGMA_A].at;
  request->media[1] = payload + layout.parts[SIGMA_S].at;
  request->numbers = fixed->numbers != VARYING_NONE ? payload + layout.parts[R].at : NULL;
  return error.status == WIRE_STATUS_OK
             ? schema_parse_parameters(payload + layout.parts[PARAMETERS].at,
                                       fixed->parameter_count, 1, &request->parameters)
             : error;
}

/* ---- replies --------------------------------------------------------------------------------- */

varying_layout varying_reply_layout(unsigned evaluator, unsigned wanted, unsigned coefficients,
                                    uint64_t count) {
  const wire_varying_reply fixed = {.count = count,
                                    .evaluator = (uint16_t)evaluator,
                                    .wanted = wanted,
                                    .coefficients = (uint16_t)coefficients};
  schema_layout all;
  schema_lay_out(&schema_varying_reply, &fixed, UINT64_MAX, &all, NULL);
  return (varying_layout){.arrays = coefficients |
                                    VARYING_QUANTITY(wanted & ~(unsigned)CORE_QUANTITY_MODEL_ERROR),
                          .array_bytes = all.parts[0].array_bytes,
                          .status_offset = all.parts[2].at,
                          .payload_bytes = all.payload_bytes};
}

uint64_t varying_array_offset(const varying_layout *layout, uint32_t array) {
  return WIRE_BYTES_varying_reply +
         (uint64_t)__builtin_popcount(layout->arrays & (array - 1)) * layout->array_bytes;
}

bool varying_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_varying_reply *fixed,
                         varying_layout *layout) {
  schema_layout all;
  if (!schema_is_whole(&schema_varying_reply, payload, payload_bytes, &all)) {
    return false;
  }
  wire_get_varying_reply(payload, fixed);
  *layout =
      varying_reply_layout(fixed->evaluator, fixed->wanted, fixed->coefficients, fixed->count);
  return fixed->evaluator != CORE_EVALUATOR_LUT && (fixed->wanted & ~QUANTITIES) == 0 &&
         (fixed->coefficients & ~(unsigned)COEFFICIENTS) == 0 &&
         fixed->computed_count <= fixed->count && fixed->part < fixed->part_count;
}

/* ---- evaluating ------------------------------------------------------------------------------ */

/* A slice of the values: its arrays and their precision. */
struct slice {
  const core_varying *varying;
  bool single;
  size_t n;
  const void *sigma_a;
  const void *sigma_s;
};

static void evaluate_slice(const struct slice *slice, enum core_quantity quantity, const void *in,
                           void *out) {
  core_varying_eval(slice->varying, quantity, slice->n, slice->sigma_a, slice->sigma_s, in, out);
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

/* Returns where the values of an array of the part go, from value `begin` on; NULL if the array is
 * not wanted. */
static void *array_at(const varying_part *part, uint32_t array, uint64_t begin,
                      size_t value_bytes) {
  return (part->layout.arrays & array) != 0
             ? part->payload + varying_array_offset(&part->layout, array) + begin * value_bytes
             : NULL;
}

/* Finds the media of colours and their statuses. Writes the coefficients that are wanted. */
static void invert(struct slice *slice, const varying_part *part, const varying_request *request,
                   uint64_t begin, const void *const media[2], const struct scratch *scratch) {
  const size_t bytes = slice->single ? sizeof(float) : sizeof(double);
  void *sigma_a = array_at(part, CORE_COEFFICIENT_SIGMA_A, begin, bytes);
  void *sigma_s = array_at(part, CORE_COEFFICIENT_SIGMA_S, begin, bytes);
  void *scattered = array_at(part, CORE_COEFFICIENT_SCATTERED, begin, bytes);
  sigma_a = sigma_a != NULL ? sigma_a : scratch->sigma_a;
  sigma_s = sigma_s != NULL ? sigma_s : scratch->sigma_s;
  scattered = scattered != NULL ? scattered : scratch->truth; /* it is not used yet */
  core_varying_invert(slice->varying, &request->colour, slice->n, media[0], media[1], sigma_a,
                      sigma_s, scattered, scratch->status);
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
    void *to = array_at(part, each->id, begin, slice->single ? sizeof(float) : sizeof(double));
    if (to != NULL) {
      copy_coefficient(slice, each->id, to);
    }
  }
}

/* Sets a value of the slice that cannot be computed to NaN in every array. */
static void clear(const varying_part *part, const struct slice *slice, uint64_t begin, size_t i) {
  const size_t bytes = slice->single ? sizeof(float) : sizeof(double);
  for (uint32_t array = 1; array != 0 && array <= part->layout.arrays; array <<= 1) {
    void *at = array_at(part, array, begin, bytes);
    if (at != NULL) {
      schema_put_real(at, i, slice->single, (double)NAN);
    }
  }
}

/* Overwrites the statuses of media with those of their colours that are not *ok*: a colour without
 * a medium has NaN coefficients, so the medium's status says nothing. Sets values that cannot
 * be computed to NaN. */
static void put_statuses(const varying_part *part, const varying_request *request, uint64_t begin,
                         const struct slice *slice, const struct scratch *scratch,
                         size_t computed) {
  uint8_t *status = part->payload + part->layout.status_offset + begin;
  if (computed == slice->n) {
    return;
  }
  for (size_t i = 0; i < slice->n; i++) {
    if (request->fixed.given != 0 && scratch->status[i] != CORE_VALUE_OK) {
      status[i] = scratch->status[i];
    }
    if (status[i] != CORE_VALUE_OK && status[i] != CORE_VALUE_FAR) {
      clear(part, slice, begin, i);
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

/* Raises the part's model error to that of one array of the slice. */
static void compare(varying_part *part, const struct slice *slice, const struct scratch *scratch,
                    unsigned quantity, const uint8_t *status, const void *values) {
  for (size_t i = 0; i < slice->n; i++) {
    const double value = schema_real_at(values, i, slice->single);
    const double truth = schema_real_at(scratch->truth, i, slice->single);
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
  core_varying_check(ruler, drawn, slice->n, slice->sigma_a, slice->sigma_s, given, scratch->known,
                     &unused);
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    const void *values = array_at(part, VARYING_QUANTITY(quantity->id), begin, bytes);
    if (values == NULL) {
      continue;
    }
    evaluate_slice(&truth, quantity->id, quantity->id == CORE_QUANTITY_RADIUS ? given : r,
                   scratch->truth);
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
    for (size_t i = 0; i < n; i++) {
      schema_put_real(memory.r, i, slice.single, 0.5);
    }
  } else {
    numbers = (const uint8_t *)request->numbers + offset;
  }
  core_varying_range range;
  core_varying_check(varying, fixed->numbers != VARYING_RADII, n, slice.sigma_a, slice.sigma_s,
                     numbers, part->payload + part->layout.status_offset + begin, &range);
  core_varying_range_add(&part->range, &range);
  const void *given = numbers;
  if (drawn && (fixed->wanted & ~(CORE_QUANTITY_ALBEDO | CORE_QUANTITY_MODEL_ERROR)) != 0) {
    void *r = array_at(part, VARYING_QUANTITY(CORE_QUANTITY_RADIUS), begin, bytes);
    r = r != NULL ? r : memory.r;
    evaluate_slice(&slice, CORE_QUANTITY_RADIUS, numbers, r);
    numbers = r;
  }
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    void *to = array_at(part, VARYING_QUANTITY(quantity->id), begin, bytes);
    if (to != NULL && quantity->id == CORE_QUANTITY_ALBEDO) {
      evaluate_slice(&slice, CORE_QUANTITY_ALBEDO, NULL, to);
    } else if (to != NULL && quantity->id != CORE_QUANTITY_RADIUS) {
      evaluate_slice(&slice, quantity->id, numbers, to);
    }
  }
  put_statuses(part, request, begin, &slice, &memory, range.computed);
  if (ruler != NULL) {
    compare_all(part, &slice, ruler, &memory, fixed->numbers != VARYING_RADII, begin, given,
                numbers);
  }
}

/* Returns a colour as the request counts it: relative to the power that entered, or with specular
 * 1, to the incident power, the surface's reflection included. */
static double seen(const varying_request *request, const core_varying *varying, double colour) {
  const double surface = varying->specular[request->colour.light];
  return request->colour.specular ? surface + (1 - surface) * colour : colour;
}

/* Returns the model error of a part, including the numerical error of transport. */
static double model_error(const varying_part *part, const core_varying *varying,
                          const core_varying *ruler, unsigned wanted) {
  if ((wanted & CORE_QUANTITY_MODEL_ERROR) == 0) {
    return (double)NAN;
  }
  if (ruler != NULL) {
    return part->model_error +
           (1 + part->model_error) * core_varying_error(ruler, wanted, &part->range);
  }
  const bool none = part->range.albedo_least > part->range.albedo_most;
  return none || core_is_exact(varying->model, !isnan(varying->gamma)) ? 0 : (double)NAN;
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
      .computed_count = part->range.computed,
      .numerical_error = core_varying_error(varying, fixed->wanted, &part->range),
      .model_error = model_error(part, varying, ruler, fixed->wanted),
      .colour_least = colours ? seen(request, varying, varying->colour_least[light]) : (double)NAN,
      .colour_most = colours ? seen(request, varying, varying->colour_most[light]) : (double)NAN,
      .specular = colours ? varying->specular[light] : (double)NAN,
  };
  wire_put_varying_reply(part->payload, &start);
}
