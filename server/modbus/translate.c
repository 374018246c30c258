#include "server/modbus/translate.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

#include "proto/schema.h"
#include "server/store/media.h"

enum {
  LINKS_MAX = 24,      /* most fields of a structure that have registers */
  STRUCTURES_MAX = 32, /* most structures of requests and replies */
  NAME_BYTES = 64,
  /* bytes of the longest request, that of the fit of a tissue, and room for parameters */
  REQUEST_BYTES =
      (int)WIRE_BYTES_fit_tissue_request +
      (REGISTERS_PROPERTIES_MAX + CORE_PARAMETERS_END) * (int)WIRE_BYTES_parameter +
      REGISTERS_SOUGHT_MAX * (int)WIRE_BYTES_sought +
      (5 * REGISTERS_PLACES_MAX + REGISTERS_WAVELENGTHS_MAX + 2 * REGISTERS_TISSUE_READINGS_MAX) *
          (int)sizeof(double),
};

/* ---- fields and their registers ---------------------------------------------------------------- */

static const schema_message *message_of(enum registers_job_kind kind) {
  return &schema_messages[registers_jobs[kind].message - 1];
}

/* The fields of a structure that have registers of their names. */
struct links {
  enum registers_job_kind kind;
  const schema_structure *structure;
  const char *prefix; /* prefix of the registers' names */
  bool are_results;
  unsigned count;
  struct link {
    const schema_field *field;
    size_t at; /* offset of the field in the structure */
    const registers_field *registers;
  } items[LINKS_MAX];
};

/* Finds these links, once for each structure: all units belong to one thread. */
static const struct links *links_of(enum registers_job_kind kind, const schema_structure *structure,
                                    const char *prefix, bool are_results) {
  static struct links all[STRUCTURES_MAX];
  struct links *links = all;
  for (; links->structure != NULL; links++) {
    if (links->kind == kind && links->structure == structure && links->prefix == prefix) {
      return links;
    }
  }
  assert(links < all + STRUCTURES_MAX - 1);
  *links = (struct links){kind, structure, prefix, are_results, 0, {{0}}};
  size_t at = 0;
  for (const schema_field *field = structure->fields; field->name != NULL; field++) {
    char name[NAME_BYTES];
    snprintf(name, sizeof name, "%s%s", prefix, field->name);
    const registers_field *found = registers_named(&registers_jobs[kind], name, are_results);
    if (found != NULL && found->address != registers_jobs[kind].status) {
      assert(links->count < LINKS_MAX);
      links->items[links->count++] = (struct link){field, at, found};
    }
    at += field->bytes;
  }
  return links;
}

/* ---- input ----------------------------------------------------------------------------------- */

/* Returns value `index` of a field, whose first value holds for all if there is no other. What is not
 * given is 0. */
static double number_of(const uint16_t image[REGISTERS_END], const registers_field *field,
                        unsigned index) {
  const unsigned at =
      field->address + (field->count > 1 ? index * registers_width(field->type) : 0);
  const double number = field->type == REGISTERS_U32   ? (double)registers_u32(image, at)
                        : field->type != REGISTERS_F32 ? (double)registers_u16(image, at)
                                                       : registers_number(image, at);
  return isnan(number) ? 0 : number;
}

/* Writes those fields of structure `index` of a list that have registers. */
static void put_fields(enum registers_job_kind kind, const schema_structure *structure,
                       const char *prefix, const uint16_t image[REGISTERS_END], unsigned index,
                       uint8_t *to) {
  const struct links *links = links_of(kind, structure, prefix, false);
  for (unsigned i = 0; i < links->count; i++) {
    const struct link *link = &links->items[i];
    schema_put_number(link->field, number_of(image, link->registers, index), to + link->at);
  }
}

/* The quantities of a sample that have registers. */
#define SAMPLE_WANTED (CORE_QUANTITY_RADIUS | CORE_QUANTITY_PDF | CORE_QUANTITY_MODEL_ERROR)

/* Removes all parameters but those that Monte Carlo accepts. */
static void keep_walks(core_parameters *parameters) {
  static const unsigned walks[] = {CORE_PARAMETER_PHASE, CORE_PARAMETER_PHASE_SHARE,
                                   CORE_PARAMETER_PHASE_G, CORE_PARAMETER_DETECTOR_NA,
                                   CORE_PARAMETER_ETA_BELOW};
  const core_parameters given = *parameters;
  *parameters = core_parameters_none();
  for (size_t i = 0; i < sizeof walks / sizeof walks[0]; i++) {
    parameters->value[walks[i]] = given.value[walks[i]];
  }
}

/* Sets the fields that have no registers, and clears those that this request does not use. */
static void complete(enum registers_job_kind kind, core_parameters *parameters, void *request) {
  const uint32_t parameter_count = schema_count_parameters(parameters);
  wire_eval_request *eval = request;
  wire_sample_request *sample = request;
  fit_start *fit = request;
  wire_fit_tissue_request *tissue = request;
  wire_invert_request *invert = request;
  switch (kind) {
  case REGISTERS_JOB_EVAL:
    eval->medium_count = 1;
    eval->parameter_count = parameter_count;
    eval->wanted |= CORE_QUANTITY_MODEL_ERROR;
    if (eval->spacing == CORE_SPACING_LIST) {
      eval->radius_start = eval->radius_stop = 0;
    }
    break;
  case REGISTERS_JOB_SAMPLE:
    sample->medium_count = 1;
    sample->parameter_count = parameter_count;
    sample->wanted = SAMPLE_WANTED;
    if (sample->draw != CORE_DRAW_RANDOM) {
      sample->sample_first = 0;
      sample->seed = sample->draw == CORE_DRAW_STRATIFIED ? sample->seed : 0;
    }
    break;
  case REGISTERS_JOB_MC:
    keep_walks(parameters);
    break;
  case REGISTERS_JOB_FIT:
    fit->request.set_count = fit->request.residuals = 1;
    fit->design.parameter_count = parameter_count;
    break;
  case REGISTERS_JOB_FIT_TISSUE:
    tissue->set_count = tissue->residuals = 1;
    break;
  case REGISTERS_JOB_INVERT:
    invert->errors = 2;
    break;
  case REGISTERS_JOBS:
    break;
  }
}

/* Writes the numbers of a list, as floats or as doubles. */
static void put_list(enum registers_job_kind kind, const schema_part *part,
                     const uint16_t image[REGISTERS_END], unsigned count, size_t bytes,
                     uint8_t *to) {
  static const registers_field *all[REGISTERS_JOBS][SCHEMA_PARTS]; /* found once, as the links */
  const registers_field **from = &all[kind][part - message_of(kind)->request->parts];
  *from = *from != NULL ? *from : registers_named(&registers_jobs[kind], part->name, false);
  for (unsigned i = 0; i < count; i++) {
    schema_put_real(to, i, bytes == sizeof(float), number_of(image, *from, i));
  }
}

/* Sets reading[] to value and standard error of a reading, or of its ratio to what was read of the
 * reference medium: the relative errors of both are independent. */
static void take_reading(const uint16_t image[REGISTERS_END], const registers_field *from,
                         unsigned index, bool ratio, double reading[2]) {
  const unsigned offset = 4 * index;
  reading[0] = number_of(image, from, 2 * index);
  reading[1] = number_of(image, from, 2 * index + 1);
  if (ratio) {
    const double known = registers_number(image, REGISTERS_AT_FIT_REFERENCE_READING + offset);
    const double error = registers_number(image, REGISTERS_AT_FIT_REFERENCE_READING + offset + 2);
    reading[0] = reading[0] / known;
    reading[1] = reading[1] > 0 ? hypot(reading[1], reading[0] * error) / known : 0;
  }
}

/* Writes values, or their standard errors, of the readings of a fit. */
static void put_readings(enum registers_job_kind kind, const uint16_t image[REGISTERS_END],
                         unsigned count, bool errors, uint8_t *to) {
  const registers_field *from = registers_named(&registers_jobs[kind], "reading", false);
  const bool ratio = kind == REGISTERS_JOB_FIT &&
                     registers_u16(image, REGISTERS_AT_FIT_SCALE) == CORE_FIT_SCALE_REFERENCE;
  for (unsigned i = 0; i < count; i++) {
    double reading[2];
    take_reading(image, from, i, ratio, reading);
    memcpy(to + i * sizeof(double), &reading[errors], sizeof(double));
  }
}

/* Returns the medium that the register `preset` names; NULL: none. */
static const core_measured_medium *preset_of(const uint16_t image[REGISTERS_END]) {
  const unsigned row = registers_u16(image, REGISTERS_AT_PRESET);
  size_t count;
  return row > 0 ? &media_all(&count)[(row - 1) / 3] : NULL;
}

/* Returns the number of layers in a request; NULL for requests whose medium has one. */
static uint32_t *layer_count_of(enum registers_job_kind kind, void *request) {
  return kind == REGISTERS_JOB_EVAL     ? &((wire_eval_request *)request)->layer_count
         : kind == REGISTERS_JOB_SAMPLE ? &((wire_sample_request *)request)->layer_count
         : kind == REGISTERS_JOB_MC     ? &((wire_mc_request *)request)->layer_count
                                        : NULL;
}

bool modbus_translate_input(enum registers_job_kind kind, const uint16_t image[REGISTERS_END],
                            struct text *to_payload) {
  const schema_payload *payload = message_of(kind)->request;
  core_parameters parameters = core_parameters_none();
  schema_layout layout;
  size_t bytes = 0;
  text_reset(to_payload);
  uint8_t *request = (uint8_t *)text_room(to_payload, REQUEST_BYTES);
  if (request == NULL) {
    return false;
  }
  memset(request, 0, payload->fixed_bytes);
  for (int i = 0; i < 2 && payload->structures[i] != NULL; i++) {
    put_fields(kind, payload->structures[i], "", image, 0, request + bytes);
    bytes += payload->structures[i]->bytes;
  }
  for (const core_choice *one = core_parameter_list; one->name != NULL; one++) {
    parameters.value[one->id] = registers_number(image, REGISTERS_PARAMETER_AT(one->id));
  }
  complete(kind, &parameters, request);
  const core_measured_medium *preset = preset_of(image);
  const size_t preset_row = (registers_u16(image, REGISTERS_AT_PRESET) - 1U) % 3;
  uint32_t *layer_count = layer_count_of(kind, request);
  if (preset != NULL && layer_count != NULL) {
    *layer_count = (uint32_t)preset->layer_count;
  }
  schema_lay_out(payload, request, UINT64_MAX, &layout, NULL);
  memset(request + bytes, 0, (size_t)layout.payload_bytes - bytes);
  bytes = (size_t)layout.payload_bytes;
  assert(bytes + CORE_PARAMETERS_END * WIRE_BYTES_parameter <= REQUEST_BYTES);
  for (unsigned i = 0; payload->parts[i].name != NULL; i++) {
    const schema_part *part = &payload->parts[i];
    const unsigned count = (unsigned)layout.parts[i].count;
    uint8_t *to = request + layout.parts[i].at;
    if (strcmp(part->name, "parameter") == 0) {
      const size_t put = schema_put_parameters(to, &parameters);
      bytes += part->rest ? put : 0;
    } else if (count > 0 && part->kind == SCHEMA_LIST) {
      for (unsigned k = 0; k < count; k++) {
        put_fields(kind, part->structure, "", image, k, to + k * part->structure->bytes);
      }
      for (size_t k = 0; layer_count != NULL && preset != NULL && k < preset->layer_count; k++) {
        const core_medium *from = &preset->channel[preset_row * preset->layer_count + k];
        const wire_medium layer = {from->sigma_a_per_mm, from->sigma_s_per_mm, from->g, from->eta,
                                   from->thickness_mm};
        wire_put_medium(to + k * WIRE_BYTES_medium, &layer);
      }
      if (layer_count != NULL && preset == NULL && count > 1) {
        put_fields(kind, part->structure, "below_", image, 0, to + WIRE_BYTES_medium);
      }
      /* The reference medium has the thickness of the medium. */
      if (strcmp(part->name, "reference") == 0) {
        put_fields(kind, part->structure, "reference_", image, 0, to);
      }
    } else if (count > 0 && part->form == SCHEMA_SETS) {
      put_readings(kind, image, count, strcmp(part->name, "errors") == 0, to);
    } else if (count > 0) {
      put_list(kind, part, image, count, (size_t)layout.parts[i].bytes, to);
    }
  }
  to_payload->count = bytes;
  return true;
}

/* ---- output ---------------------------------------------------------------------------------- */

/* An array of values in the precision of the evaluator. `at` is NULL if there is no array. */
struct values {
  const uint8_t *at;
  bool single; /* else of double precision */
};

/* Writes the values into registers. Registers that held values of the previous reply, and get none
 * now, become NaN. */
static void set_values(uint16_t image[REGISTERS_END], unsigned single_at, unsigned double_at,
                       const struct values *values, unsigned count, unsigned count_before) {
  const unsigned there = values->at != NULL ? count : 0;
  for (unsigned i = 0; i < count || i < count_before; i++) {
    const double value = i < there ? schema_real_at(values->at, i, values->single) : (double)NAN;
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

#define STRUCTURE(name) (&schema_structures[SCHEMA_STRUCTURE_##name])

/* Sets the registers of the fields of structure `index` of a list. Errors are rounded up. */
static void set_fields(enum registers_job_kind kind, const schema_structure *structure,
                       const char *prefix, const uint8_t *from, unsigned index,
                       uint16_t image[REGISTERS_END]) {
  const struct links *links = links_of(kind, structure, prefix, true);
  for (unsigned i = 0; i < links->count; i++) {
    const struct link *link = &links->items[i];
    const size_t bytes = link->field->bytes / link->field->count;
    for (unsigned k = 0; k < link->field->count; k++) {
      const double number = schema_number_at(link->field, from + link->at + k * bytes);
      if (link->registers->type != REGISTERS_F32) {
        registers_set_u16(image, link->registers->address + index, (unsigned)number);
      } else {
        registers_set_f32(image, link->registers->address + 2 * (index + k),
                          strstr(link->field->name, "error") != NULL ? rounded_up(number)
                                                                     : (float)number);
      }
    }
  }
}

/* Returns the radii of the request. Those of a grid are computed into `room`. */
static struct values radii_of(const uint8_t *request, bool single,
                              double room[REGISTERS_RADII_MAX]) {
  wire_eval_request fixed;
  wire_get_eval_request(request, &fixed);
  if (fixed.spacing == CORE_SPACING_LIST) {
    return (struct values){request + WIRE_BYTES_eval_request +
                               fixed.layer_count * WIRE_BYTES_medium +
                               fixed.parameter_count * WIRE_BYTES_parameter,
                           single};
  }
  const core_grid grid = {fixed.spacing, fixed.radius_count, fixed.radius_start, fixed.radius_stop};
  core_grid_radii(&grid, 0, (size_t)grid.count, single, room);
  return (struct values){(const uint8_t *)room, single};
}

/* Returns the largest finite radius. Infinity does not count: R is exactly 0 there. */
static double largest(const struct values *radii, unsigned count) {
  double most = 0;
  for (unsigned i = 0; i < count; i++) {
    const double r = schema_real_at(radii->at, i, radii->single);
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

/* Sets the errors of each quantity; NaN for those that are not wanted. */
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

static struct values array_of(const uint8_t *reply, const eval_layout *layout, unsigned wanted,
                              bool single, enum core_quantity quantity) {
  const bool there = eval_is_array(wanted, quantity);
  return (struct values){there ? reply + eval_array_offset(layout, wanted, 0, quantity) : NULL,
                         single};
}

/* Sets what only an eval has. */
static void set_eval(uint16_t image[REGISTERS_END], const uint8_t *reply,
                     const wire_eval_reply *start, const wire_quantity_error *error) {
  const double albedo = schema_real_at(reply + eval_albedo_offset(0), 0, false);
  registers_set_f64(image, REGISTERS_AT_NUMERICAL_ERROR_DOUBLE, error->numerical_error);
  registers_set_f64(image, REGISTERS_AT_NUMERICAL_ERROR_PER_MM, error->numerical_error_per_mm);
  registers_set_f64(image, REGISTERS_AT_MODEL_ERROR_DOUBLE, error->model_error);
  registers_set_f32(image, REGISTERS_AT_ALBEDO, (float)albedo);
  registers_set_f64(image, REGISTERS_AT_ALBEDO_DOUBLE, albedo);
  registers_set_u16(image, REGISTERS_AT_MODEL_TAKEN, start->model);
  registers_set_u16(image, REGISTERS_AT_EVALUATOR_TAKEN, start->evaluator);
}

/* Takes the reply to an eval, or to a sample. */
static void take_eval(bool drawn, const uint8_t *request, const uint8_t *reply, size_t reply_bytes,
                      uint16_t image[REGISTERS_END]) {
  static const struct {
    bool drawn;
    enum core_quantity quantity;
    unsigned single_at, double_at;
  } arrays[] = {{false, CORE_QUANTITY_R, REGISTERS_AT_R, REGISTERS_AT_R_DOUBLE},
                {false, CORE_QUANTITY_CDF, REGISTERS_AT_CDF, REGISTERS_AT_CDF_DOUBLE},
                {false, CORE_QUANTITY_T, REGISTERS_AT_T, 0},
                {false, CORE_QUANTITY_S, REGISTERS_AT_S, REGISTERS_AT_S_DOUBLE},
                {true, CORE_QUANTITY_RADIUS, REGISTERS_AT_SAMPLE_R, 0},
                {true, CORE_QUANTITY_PDF, REGISTERS_AT_SAMPLE_PDF, 0}};
  wire_eval_reply start;
  eval_layout layout;
  double room[REGISTERS_RADII_MAX];
  wire_get_eval_reply(reply, &start);
  const unsigned wanted = start.wanted | (drawn ? EVAL_DRAWN : 0), count = (unsigned)start.count;
  const bool fits = eval_reply_layout(start.evaluator, wanted, 1, count, reply_bytes, &layout);
  assert(fits && count <= REGISTERS_RADII_MAX);
  const bool single = core_evaluator_bytes(start.evaluator) == sizeof(float);
  const unsigned count_at = drawn ? REGISTERS_AT_SAMPLE_COUNT : REGISTERS_AT_COUNT;
  const unsigned before = registers_u16(image, count_at);
  for (size_t i = 0; i < sizeof arrays / sizeof arrays[0]; i++) {
    if (arrays[i].drawn == drawn) {
      const struct values values = array_of(reply, &layout, wanted, single, arrays[i].quantity);
      set_values(image, arrays[i].single_at, arrays[i].double_at, &values, count, before);
    }
  }
  const struct values radii = drawn ? array_of(reply, &layout, wanted, single, CORE_QUANTITY_RADIUS)
                                    : radii_of(request, single, room);
  const double most_mm = largest(&radii, count);
  const wire_quantity_error error = eval_largest_error(reply, &layout, wanted, 0);
  registers_set_u16(image, count_at, count);
  registers_set_u16(image, drawn ? REGISTERS_AT_SAMPLE_NOTES : REGISTERS_AT_NOTES, start.notes);
  registers_set_f32(image,
                    drawn ? REGISTERS_AT_SAMPLE_NUMERICAL_ERROR : REGISTERS_AT_NUMERICAL_ERROR,
                    stated_error(&error, most_mm, !single));
  registers_set_f32(image, drawn ? REGISTERS_AT_SAMPLE_MODEL_ERROR : REGISTERS_AT_MODEL_ERROR,
                    rounded_up(error.model_error));
  if (!drawn) {
    set_values(image, REGISTERS_AT_DISTANCES, 0, &radii, count, before);
    set_errors_of_each(image, reply, &layout, wanted, most_mm, !single);
    set_eval(image, reply, &start, &error);
  }
}

/* Sets the registers of a reply's numbers by their names: of its structure, of lists of structures and of
 * arrays. Registers that get none become NaN. */
static void set_reply(enum registers_job_kind kind, const uint8_t *reply, size_t reply_bytes,
                      uint16_t image[REGISTERS_END], schema_layout *layout) {
  const schema_payload *payload = message_of(kind)->reply;
  const bool whole = schema_is_whole(payload, reply, reply_bytes, layout);
  assert(whole);
  registers_clear(image, &registers_jobs[kind]);
  set_fields(kind, payload->structures[0], "", reply, 0, image);
  for (unsigned i = 0; payload->parts[i].name != NULL; i++) {
    const schema_part *part = &payload->parts[i];
    const unsigned count = (unsigned)layout->parts[i].count;
    const struct values values = {reply + layout->parts[i].at, false};
    const bool named = strcmp(part->name, "estimates") == 0;
    const registers_field *to =
        part->kind == SCHEMA_f64 ? registers_named(&registers_jobs[kind], part->name, true) : NULL;
    for (unsigned k = 0; part->kind == SCHEMA_LIST && k < count; k++) {
      set_fields(kind, part->structure, named ? "estimate_" : "",
                 values.at + k * part->structure->bytes, k, image);
    }
    if (to != NULL) {
      set_values(image, to->address, 0, &values, count, 0);
    }
  }
}

/* Writes the progress of an mc job, which every reply to its request has. */
static void set_progress(uint16_t image[REGISTERS_END], const wire_mc_reply *reply) {
  const double expected = (double)reply->photons_expected;
  const double progress = reply->state != MC_UNDER_WAY ? 1
                          : expected > 0               ? (double)reply->photons / expected
                                                       : 0;
  registers_set_f32(image, REGISTERS_AT_MC_PROGRESS, (float)progress);
  registers_set_f32(image, REGISTERS_AT_MC_PHOTONS_WALKED, (float)reply->photons);
  registers_set_f32(image, REGISTERS_AT_MC_PHOTONS_EXPECTED, (float)expected);
  registers_set_f32(image, REGISTERS_AT_MC_ERROR_TOTAL_NOW, rounded_up(reply->error_total));
  registers_set_f32(image, REGISTERS_AT_MC_ERROR_RINGS_NOW, rounded_up(reply->error_rings));
}

static void take_mc(const uint8_t *reply, size_t reply_bytes, uint16_t image[REGISTERS_END]) {
  static const unsigned at[CORE_MC_SIDES][2] = {
      {REGISTERS_AT_MC_R, REGISTERS_AT_MC_R_ERROR},
      {REGISTERS_AT_MC_T, REGISTERS_AT_MC_T_ERROR},
  };
  wire_mc_reply start;
  schema_layout layout;
  wire_get_mc_reply(reply, &start);
  if (start.state != MC_UNDER_WAY) {
    set_reply(REGISTERS_JOB_MC, reply, reply_bytes, image, &layout);
    registers_set_u16(image, REGISTERS_AT_MC_COUNT, start.ring_count);
  }
  set_progress(image, &start);
  for (unsigned i = 0; i < 2U * start.side_count && start.state != MC_UNDER_WAY; i++) {
    const struct values values = {reply + mc_rings_offset(&layout, 0, i / 2, i % 2), false};
    set_values(image, at[i / 2][i % 2], 0, &values, start.ring_count, 0);
  }
}

/* Sets the largest errors of the media that were found. */
static void set_invert_errors(uint16_t image[REGISTERS_END], const uint8_t *reply,
                              const schema_layout *layout) {
  enum { SIGMA_A, SIGMA_S, ALBEDO, MODEL = 5, ARRAYS };
  double most = 0x1p-24, model_error = 0; /* registers round the coefficients */
  for (unsigned i = 0; i < layout->parts[SIGMA_A].count; i++) {
    double value[ARRAYS];
    for (unsigned k = 0; k < ARRAYS; k++) {
      value[k] = schema_real_at(reply + layout->parts[k].at, i, false);
    }
    for (unsigned k = SIGMA_A; k < ALBEDO; k++) { /* 0 / 0 is NaN, which fmax() passes over */
      most = fmax(most, value[k + 3] / value[k] + 0x1p-24);
    }
    const bool larger = isnan(value[MODEL]) || value[MODEL] > model_error;
    model_error = !isnan(value[SIGMA_A]) && larger ? value[MODEL] : model_error;
  }
  registers_set_f32(image, REGISTERS_AT_INVERT_NUMERICAL_ERROR, rounded_up(most));
  registers_set_f32(image, REGISTERS_AT_INVERT_MODEL_ERROR, rounded_up(model_error));
}

/* Names the reading that is wrong. Registers are finite: a value that is not was divided by a reference
 * reading of 0. */
static wire_error wrong_reading(unsigned field, unsigned index) {
  wire_error error =
      field == 1 ? wire_error_make(WIRE_STATUS_BAD_VALUE, "reference_reading", "above 0")
                 : wire_error_make(WIRE_STATUS_BAD_VALUE, "reading", "a standard error above 0");
  error.index = 2 * index + (field == 1 ? 0 : 1);
  return error;
}

static float root(double variance) {
  return rounded_up(sqrt(variance));
}

static void set_fitted(uint16_t image[REGISTERS_END], const uint8_t *request,
                       const wire_fitted *fitted) {
  wire_fit_design design;
  wire_get_fit_design(request + WIRE_BYTES_fit_request, &design);
  const double correlation = fitted->covariance_a_s / sqrt(fitted->variance_a * fitted->variance_s);
  const float second[] = {(float)fitted->second_sigma_a, (float)fitted->second_sigma_s_prime,
                          (float)fitted->second_chi_squared};
  for (unsigned i = 0; i < 3; i++) {
    registers_set_f32(image, REGISTERS_AT_FIT_SECOND + 2 * i, second[i]);
  }
  registers_set_f32(image, REGISTERS_AT_FIT_CORRELATION, (float)correlation);
  registers_set_f32(image, REGISTERS_AT_FIT_G, (float)design.g);
  registers_set_f32(image, REGISTERS_AT_FIT_ETA, (float)design.eta);
  registers_set_f32(image, REGISTERS_AT_FIT_SIGMA_A_ERROR, root(fitted->variance_a));
  registers_set_f32(image, REGISTERS_AT_FIT_SIGMA_S_PRIME_ERROR, root(fitted->variance_s));
  registers_set_f32(image, REGISTERS_AT_FIT_FACTOR_ERROR, root(fitted->variance_factor));
  registers_set_text(image, REGISTERS_AT_FIT_FIT_STATUS_NAME, REGISTERS_FIT_STATUS_NAME_BYTES / 2,
                     core_choice_by_id(core_fit_statuses, fitted->status)->name);
}

static enum registers_status take_fit(enum registers_job_kind kind, const uint8_t *request,
                                      const uint8_t *reply, size_t reply_bytes,
                                      uint16_t image[REGISTERS_END], wire_error *error) {
  const registers_job *job = &registers_jobs[kind];
  const bool tissue = kind == REGISTERS_JOB_FIT_TISSUE;
  const uint8_t *set = reply + message_of(kind)->reply->fixed_bytes;
  wire_fitted fitted;
  wire_fitted_tissue found;
  schema_layout layout;
  wire_get_fitted(set, &fitted);
  wire_get_fitted_tissue(set, &found);
  if (fitted.status ==
      CORE_FIT_STATUS_REFUSED) { /* both begin with the status, and have an index */
    *error =
        wrong_reading(tissue ? found.field : fitted.field, tissue ? found.index : fitted.index);
    return REGISTERS_STATUS_ERROR;
  }
  set_reply(kind, reply, reply_bytes, image, &layout);
  if (!tissue) {
    set_fitted(image, request, &fitted);
  }
  registers_set_u16(image, registers_named(job, "fit_status", true)->address, fitted.status);
  registers_set_u16(image, job->status + REGISTERS_BEHIND_COUNT,
                    (unsigned)layout.parts[tissue ? 3 : 1].count);
  return fitted.status == CORE_FIT_STATUS_FITTED ? REGISTERS_STATUS_DONE
                                                 : REGISTERS_STATUS_UNFITTED;
}

enum registers_status modbus_translate_reply(enum registers_job_kind kind, const uint8_t *request,
                                             const uint8_t *reply, size_t reply_bytes,
                                             uint16_t image[REGISTERS_END], wire_error *error) {
  schema_layout layout;
  switch (kind) {
  case REGISTERS_JOB_EVAL:
  case REGISTERS_JOB_SAMPLE:
    take_eval(kind == REGISTERS_JOB_SAMPLE, request, reply, reply_bytes, image);
    break;
  case REGISTERS_JOB_MC:
    take_mc(reply, reply_bytes, image);
    break;
  case REGISTERS_JOB_INVERT:
    set_reply(kind, reply, reply_bytes, image, &layout);
    set_invert_errors(image, reply, &layout);
    break;
  case REGISTERS_JOB_FIT:
  case REGISTERS_JOB_FIT_TISSUE:
    return take_fit(kind, request, reply, reply_bytes, image, error);
  case REGISTERS_JOBS:
    break;
  }
  return REGISTERS_STATUS_DONE;
}
