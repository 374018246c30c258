/* Fetches, loads, saves and evaluates tables. The evaluation is the daemon's own code. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/message.h"
#include "clients/c/table.h"
#include "core/lut/lut.h"
#include "proto/table.h"

struct dipole_table {
  dipole_table_info info;
  core_profile profile;
  core_model_errors model_errors;
  float radius_least_mm; /* the least radius, 0 or more, that the model covers */
  float radius_most_mm;
  dipole_parameter parameters[CORE_PARAMETERS_END];
  size_t frame_bytes;
  _Alignas(8) uint8_t frame[]; /* the frame of the reply: header and payload */
};

/* ---- from bytes ---------------------------------------------------------------------------- */

static bool damaged(dipole_error *error, const char *what) {
  return libdipole_fail(error, DIPOLE_ERROR_TABLE, "this is not an intact table: %s", what);
}

bool libdipole_table_check(const uint8_t *bytes, size_t count, size_t *frame_bytes,
                           dipole_error *error) {
  wire_header header;
  wire_table_reply fixed;
  *frame_bytes = 0;
  if (count < WIRE_BYTES_header + WIRE_BYTES_table_reply) {
    return damaged(error, "it is too short");
  }
  wire_get_header(bytes, &header);
  if (wire_header_check(&header, UINT32_MAX).status != WIRE_STATUS_OK ||
      header.type != (WIRE_TYPE_TABLE | WIRE_REPLY)) {
    return damaged(error, "it does not start as one");
  }
  if (header.payload_bytes > count - WIRE_BYTES_header) {
    return damaged(error, "its end is missing");
  }
  wire_get_table_reply(bytes + WIRE_BYTES_header, &fixed);
  if (fixed.layout != TABLE_LAYOUT) {
    return libdipole_fail(error, DIPOLE_ERROR_TABLE,
                          "this table has layout %u, but this library reads layout %d: fetch the "
                          "table again, from a daemon of this library's version",
                          fixed.layout, TABLE_LAYOUT);
  }
  *frame_bytes = WIRE_BYTES_header + header.payload_bytes;
  return true;
}

static void set_info(dipole_table *table, const wire_table_reply *fixed, const core_medium *layers,
                     const float *words) {
  const uint8_t *at = (const void *)(layers + fixed->layer_count);
  for (size_t i = 0; i < fixed->parameter_count;
       i++) { /* Each known parameter may occur at most once. */
    wire_parameter parameter;
    wire_get_parameter(at + i * WIRE_BYTES_parameter, &parameter);
    table->parameters[i] = (dipole_parameter){parameter.parameter, parameter.value};
  }
  table->info = (dipole_table_info){
      .layout = fixed->layout,
      .model = fixed->model,
      .moments = fixed->moments,
      .notes = fixed->notes,
      .medium = *(const dipole_medium *)(const void *)layers,
      .layers = (const void *)layers,
      .layer_count = fixed->layer_count,
      .parameters = table->parameters,
      .parameter_count = fixed->parameter_count,
      .albedo = fixed->albedo,
      .numerical_error = fixed->numerical_error,
      .numerical_error_per_mm = fixed->numerical_error_per_mm,
      .model_error = fixed->model_error,
      .pieces_from_mm = fixed->pieces_from,
      .pieces_to_mm = fixed->pieces_to,
      .radius_least_mm = fixed->radius_least,
      .radius_most_mm = fixed->radius_most,
      .words = (const uint32_t *)(const void *)words,
      .word_count = fixed->word_count,
      .reach_mm = fixed->reach,
  };
}

/* Sets the range of radii in single precision, rounded inwards. */
static void set_range(dipole_table *table) {
  const double least = table->info.radius_least_mm > 0 ? table->info.radius_least_mm : 0;
  const double most = table->info.radius_most_mm;
  const float near = (float)least, far = (float)most;
  table->radius_least_mm = (double)near < least ? nextafterf(near, (float)INFINITY) : near;
  table->radius_most_mm = (double)far > most ? nextafterf(far, 0) : far;
}

/* Sets *cosine to a parameter, or to 1 if it is not given. Returns false if it is out of range. */
static bool get_cosine(const core_parameters *parameters, enum core_parameter id, double *cosine) {
  const double value = parameters->value[id];
  *cosine = value == value ? value : 1;
  return *cosine >= 0 && *cosine <= 1;
}

/* Makes the table's profile, which owns a copy of the words. */
static bool set_profile(dipole_table *table, const wire_table_reply *fixed,
                        const core_medium *layers, const core_parameters *parameters,
                        const float *words, dipole_error *error) {
  core_profile *profile = &table->profile;
  double cos_in, cos_out;
  *profile = (core_profile){
      .medium = *layers,
      .model = (enum core_model)fixed->model,
      .moments = (enum core_moments)fixed->moments,
      .albedo = fixed->albedo,
      .numerical_error = fixed->numerical_error,
      .numerical_error_per_mm = fixed->numerical_error_per_mm,
      .reach = {fixed->reach, fixed->reach_growth},
      .notes = fixed->notes,
      .radii = {fixed->radius_least, fixed->radius_most},
  };
  table->model_errors.exact = fixed->model_error == 0;
  memcpy(table->model_errors.error, fixed->model_errors, sizeof fixed->model_errors);
  memcpy(profile->numerical_errors, fixed->numerical_errors, sizeof fixed->numerical_errors);
  for (size_t i = 0; i <= CORE_ERROR_BANDS; i++) {
    if (!(fixed->numerical_errors[i] >= 0 &&
          fixed->numerical_errors[i] <= fixed->numerical_error)) {
      return damaged(error, "its errors by band of radii are not from 0 to its largest error");
    }
  }
  if (!(fixed->reach > 0 && fixed->reach_growth >= 0)) {
    return damaged(error, "it does not say up to which radius its error holds");
  }
  if (core_layers_check(layers, fixed->layer_count).field != NULL ||
      !get_cosine(parameters, CORE_PARAMETER_COS_IN, &cos_in) ||
      !get_cosine(parameters, CORE_PARAMETER_COS_OUT, &cos_out)) {
    return damaged(error, "its medium or a parameter is not valid");
  }
  const core_fault fault =
      core_profile_from_table(profile, core_isa_select(NULL), words, fixed->word_count);
  if (fault.field != NULL && strcmp(fault.field, CORE_FIELD_MEMORY) == 0) {
    return libdipole_fail_memory(error);
  }
  if (fault.field != NULL) {
    return damaged(error, "an entry points outside of it");
  }
  profile->cos_in = cos_in;
  profile->cos_out = cos_out;
  const core_radii_range pieces = core_table_pieces(profile);
  return (pieces.least_mm == fixed->pieces_from && pieces.most_mm == fixed->pieces_to) ||
         damaged(error, "the radii of its pieces differ from those that it states");
}

/* Reads and checks the frame of a table. */
static bool parse(dipole_table *table, dipole_error *error) {
  wire_table_reply fixed;
  core_parameters parameters;
  const core_medium *layers;
  const float *words;
  if (!table_reply_parse(table->frame + WIRE_BYTES_header, table->frame_bytes - WIRE_BYTES_header,
                         &fixed, &layers, &parameters, &words)) {
    return damaged(error, "its counts or its checksum are wrong");
  }
  set_info(table, &fixed, layers, words);
  set_range(table);
  return set_profile(table, &fixed, layers, &parameters, words, error);
}

bool dipole_table_load(const void *bytes, size_t count, dipole_table **table, dipole_error *error) {
  size_t frame_bytes;
  error = error != NULL ? error : &(dipole_error){0};
  if (!libdipole_table_check(bytes, count, &frame_bytes, error)) {
    return false;
  }
  dipole_table *made = malloc(sizeof *made + frame_bytes);
  if (made == NULL) {
    return libdipole_fail_memory(error);
  }
  made->frame_bytes = frame_bytes;
  made->profile = (core_profile){0};
  memcpy(made->frame, bytes, frame_bytes);
  if (!parse(made, error)) {
    dipole_table_free(made);
    return false;
  }
  *table = made;
  return true;
}

/* ---- from a daemon ------------------------------------------------------------------------- */

/* Returns whether a reply has these parameters, in any order. */
static bool has_parameters(const dipole_reply *reply, const dipole_table_query *query) {
  uint64_t count;
  const wire_parameter *found = dipole_reply_array(reply, "parameter", &count);
  bool good = count == query->parameter_count;
  for (size_t i = 0; good && i < query->parameter_count; i++) {
    const dipole_parameter *one = &query->parameters[i];
    size_t k = 0;
    while (k < count && found[k].parameter != one->id) {
      k++;
    }
    good = k < count && memcmp(&found[k].value, &one->value, sizeof one->value) == 0;
  }
  return good;
}

libdipole_frame *libdipole_table_request(dipole_client *client, const dipole_table_query *query,
                                         dipole_error *error) {
  const dipole_medium *layers = query->layers != NULL ? query->layers : &query->medium;
  uint64_t layer_count = libdipole_layers(query->layers != NULL ? query->layer_count : 1);
  const dipole_field fields[] = {
      {"model", .number = query->model},
      {"moments", .number = query->moments},
      {"medium", .elements = layers, .count = layer_count},
      {"parameter", .elements = query->parameters, .count = query->parameter_count}};
  dipole_reply *reply;
  if (!dipole_call(client, "table", fields, LIBDIPOLE_COUNT(fields), query->deadline_ms, &reply,
                   error)) {
    return NULL;
  }
  const void *found = dipole_reply_array(reply, "medium", &layer_count);
  if (memcmp(found, layers, layer_count * sizeof *layers) != 0 || !has_parameters(reply, query)) {
    dipole_reply_free(reply);
    libdipole_bad_reply(client, "it replied to a table request with that of something else", error);
    return NULL;
  }
  libdipole_frame *frame = (void *)reply;
  wire_put_header(libdipole_frame_bytes(frame), &frame->header);
  return frame;
}

bool libdipole_table_refuse(dipole_client *client, dipole_error *error) {
  return error->kind == DIPOLE_ERROR_TABLE &&
         libdipole_bad_reply(client, "it replied to a table request with what is none", error);
}

bool dipole_table_fetch(dipole_client *client, const dipole_table_query *query,
                        dipole_table **table, dipole_error *error) {
  error = error != NULL ? error : &(dipole_error){0};
  if (query->layers == NULL && query->medium.sigma_a_per_mm == 0 &&
      query->medium.sigma_s_per_mm == 0) {
    return libdipole_fail_argument(
        error, "sigma_a and sigma_s are 0: dipole_surface_fetch() is for all media");
  }
  libdipole_frame *frame = libdipole_table_request(client, query, error);
  const bool intact =
      frame != NULL &&
      dipole_table_load(libdipole_frame_bytes(frame),
                        WIRE_BYTES_header + (size_t)frame->payload_bytes, table, error);
  free(frame);
  return intact || libdipole_table_refuse(client, error);
}

/* ---- evaluating a table -------------------------------------------------------------------- */

const void *dipole_table_bytes(const dipole_table *table, size_t *count) {
  *count = table->frame_bytes;
  return table->frame;
}

const core_profile *libdipole_table_profile(const dipole_table *table) {
  return &table->profile;
}

const core_model_errors *libdipole_table_model_errors(const dipole_table *table) {
  return &table->model_errors;
}

const dipole_table_info *dipole_table_get_info(const dipole_table *table) {
  return &table->info;
}

/* It has no branch in the loop, so that the compiler vectorizes it. */
static bool is_between(const float *x, size_t n, float least, float most) {
  int out = 0;
  for (size_t i = 0; i < n; i++) {
    out |= !(x[i] >= least) | !(x[i] <= most);
  }
  return out == 0;
}

bool dipole_table_values(const dipole_table *table, enum dipole_quantity quantity, size_t n,
                         const float *r, float *out) {
  const core_profile *profile = &table->profile;
  if (!core_table_has((enum core_quantity)quantity) ||
      !is_between(r, n, table->radius_least_mm, table->radius_most_mm)) {
    return false;
  }
  core_eval_f32(profile, (enum core_quantity)quantity, n, r, out);
  return true;
}

bool dipole_table_errors(const dipole_table *table, unsigned wanted, size_t n, const float *r,
                         dipole_errors *errors) {
  for (unsigned bit = 1; bit != 0; bit <<= 1) {
    if ((wanted & bit) != 0 && bit != DIPOLE_ALBEDO && !core_table_has((enum core_quantity)bit)) {
      return false;
    }
  }
  core_radii_range range;
  if (!is_between(r, n, table->radius_least_mm, table->radius_most_mm) ||
      core_radii_check_f32(n, r, &range).field != NULL) {
    return false;
  }
  const core_stated_errors stated = core_profile_errors(&table->profile, wanted, range);
  *errors = (dipole_errors){
      stated.numerical, stated.numerical_per_mm,
      core_model_errors_of(&table->model_errors, &table->profile.medium, wanted, range)};
  return true;
}

bool dipole_table_radii(const dipole_table *table, size_t n, const float *u, float *r) {
  const bool good = is_between(u, n, 0, 1);
  if (good) {
    core_sample_f32(&table->profile, n, u, r);
  }
  return good;
}

void dipole_table_free(dipole_table *table) {
  if (table != NULL) {
    core_profile_free(&table->profile);
    free(table);
  }
}
