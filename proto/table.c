#include "proto/table.h"

#include <math.h>
#include <string.h>

#include "proto/schema.h"

uint32_t table_checksum(const uint8_t *bytes, size_t count) {
  /* The CRC of each value of four bits. */
  static const uint32_t steps[] = {0x00000000, 0x1db71064, 0x3b6e20c8, 0x26d930ac,
                                   0x76dc4190, 0x6b6b51f4, 0x4db26158, 0x5005713c,
                                   0xedb88320, 0xf00f9344, 0xd6d6a3e8, 0xcb61b38c,
                                   0x9b64c2b0, 0x86d3d2d4, 0xa00ae278, 0xbdbdf21c};
  uint32_t crc = UINT32_MAX;
  for (size_t i = 0; i < count; i++) {
    crc ^= bytes[i];
    crc = crc >> 4 ^ steps[crc & 15];
    crc = crc >> 4 ^ steps[crc & 15];
  }
  return ~crc;
}

size_t table_reply_bytes(const core_parameters *parameters, size_t word_count) {
  const wire_table_reply fixed = {.parameter_count = (uint16_t)schema_count_parameters(parameters),
                                  .layer_count = parameters->layer_count,
                                  .word_count = (uint32_t)word_count};
  return (size_t)schema_bytes(&schema_table_reply, &fixed);
}

wire_error table_request_parse(const uint8_t *payload, const schema_layout *layout,
                               table_request *request) {
  wire_get_table_request(payload, &request->fixed);
  request->layers = (const void *)(payload + layout->parts[0].at);
  return schema_parse_parameters(payload + layout->parts[1].at, request->fixed.parameter_count,
                                 request->fixed.layer_count, &request->parameters);
}

void table_reply_put(uint8_t *at, const core_profile *profile, const core_medium *layers,
                     const core_parameters *parameters, const core_model_errors *errors) {
  const uint8_t *words = (const uint8_t *)profile->lut;
  const size_t word_bytes = profile->lut_count * sizeof *profile->lut;
  const core_radii_range pieces = core_table_pieces(profile);
  wire_table_reply fixed = {
      .layout = TABLE_LAYOUT,
      .model = (uint16_t)profile->model,
      .moments = (uint16_t)profile->moments,
      .parameter_count = (uint16_t)schema_count_parameters(parameters),
      .word_count = (uint32_t)profile->lut_count,
      .checksum = table_checksum(words, word_bytes),
      .notes = profile->notes,
      .layer_count = parameters->layer_count,
      .albedo = profile->albedo,
      .numerical_error = profile->numerical_error,
      .numerical_error_per_mm = profile->numerical_error_per_mm,
      .model_error = errors->exact ? 0 : (double)NAN,
      .pieces_from = pieces.least_mm,
      .pieces_to = pieces.most_mm,
      .radius_least = profile->radii.least_mm,
      .radius_most = profile->radii.most_mm,
      .reach = profile->reach.most_mm,
      .reach_growth = profile->reach.growth,
  };
  _Static_assert(sizeof fixed.model_errors == sizeof errors->error, "bands, albedo");
  memcpy(fixed.model_errors, errors->error, sizeof fixed.model_errors);
  memcpy(fixed.numerical_errors, profile->numerical_errors, sizeof fixed.numerical_errors);
  wire_put_table_reply(at, &fixed);
  at += WIRE_BYTES_table_reply;
  memcpy(at, layers, parameters->layer_count * sizeof *layers);
  at += parameters->layer_count * sizeof *layers;
  at += schema_put_parameters(at, parameters);
  memcpy(at, words, word_bytes);
}

size_t table_surface_words(const core_varying *surface) {
  return (surface->words_count + 3) / 4 * 4;
}

void table_reply_put_surface(uint8_t *at, const core_varying *surface,
                             const core_parameters *parameters) {
  const size_t word_bytes = table_surface_words(surface) * sizeof(float);
  const core_varying_range all = {.computed = 1,
                                  .albedo_least = 0, /* 0 for media that do not scatter */
                                  .albedo_most = surface->albedo_most,
                                  .mfp_most = (double)INFINITY};
  const unsigned wanted = CORE_QUANTITY_R | CORE_QUANTITY_CDF | CORE_QUANTITY_RADIUS;
  const core_medium all_media = {.g = surface->g, .eta = surface->eta};
  uint8_t *words = at + table_reply_bytes(parameters, 0);
  memset(words, 0, word_bytes);
  memcpy(words, surface->words, surface->words_count * sizeof(float));
  wire_table_reply fixed = {
      .layout = TABLE_LAYOUT,
      .model = (uint16_t)surface->model,
      .moments = (uint16_t)surface->moments,
      .parameter_count = (uint16_t)schema_count_parameters(parameters),
      .word_count = (uint32_t)table_surface_words(surface),
      .checksum = table_checksum(words, word_bytes),
      .notes = surface->notes,
      .layer_count = 1,
      .albedo = (double)NAN,
      .numerical_error = core_varying_error(surface, wanted, &all),
      .model_error = (double)NAN,
      .radius_most = (double)INFINITY,
      .reach = (double)INFINITY,
  };
  for (size_t i = 0; i <= CORE_MODEL_ERROR_BANDS; i++) {
    fixed.model_errors[i] = (double)NAN;
  }
  for (size_t i = 0; i <= CORE_ERROR_BANDS; i++) {
    fixed.numerical_errors[i] = fixed.numerical_error;
  }
  wire_put_table_reply(at, &fixed);
  memcpy(at + WIRE_BYTES_table_reply, &all_media, sizeof all_media);
  schema_put_parameters(at + WIRE_BYTES_table_reply + sizeof all_media, parameters);
}

bool table_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_table_reply *fixed,
                       const core_medium **layers, core_parameters *parameters,
                       const float **words) {
  schema_layout layout;
  if (!schema_is_whole(&schema_table_reply, payload, payload_bytes, &layout)) {
    return false;
  }
  wire_get_table_reply(payload, fixed);
  if (fixed->layout != TABLE_LAYOUT || fixed->word_count % 4 != 0 || fixed->layer_count < 1 ||
      fixed->layer_count > CORE_LAYERS_MAX) {
    return false;
  }
  *layers = (const void *)(payload + layout.parts[0].at);
  const uint8_t *at = payload + layout.parts[1].at;
  if (schema_parse_parameters(at, fixed->parameter_count, fixed->layer_count, parameters).status !=
      WIRE_STATUS_OK) {
    return false;
  }
  at = payload + layout.parts[2].at;
  *words = (const float *)(const void *)at;
  return table_checksum(at, fixed->word_count * sizeof(float)) == fixed->checksum;
}
