/* table: encodes and decodes the payloads of a table request and its reply. A file with a table
 * holds one whole frame with such a reply. */
#ifndef DIPOLED_PROTO_TABLE_H
#define DIPOLED_PROTO_TABLE_H

#include "core/model_error.h"
#include "core/varying.h"
#include "proto/schema.h"

#define TABLE_LAYOUT 4 /* version of the layout of table_reply and the words (core/lut/lut.h) */

/* A parsed table request. */
typedef struct table_request {
  wire_table_request fixed;
  core_medium medium;
  core_parameters parameters;
} table_request;

/* Whether a request or reply is for the surface of all media with its g and eta (core/varying.h):
 * sigma_a and sigma_s are 0. */
static inline bool table_is_surface(const core_medium *medium) {
  return medium->sigma_a_per_mm == 0 && medium->sigma_s_per_mm == 0;
}

/* Parses a payload: schema_check(), and the parameters. Core checks the values. */
wire_error table_request_parse(const uint8_t *payload, size_t payload_bytes,
                               table_request *request);

/* Returns the payload bytes of a reply with a table of word_count words. */
size_t table_reply_bytes(uint32_t parameter_count, size_t word_count);

/* Returns the checksum of a table's words: CRC-32 (ISO 3309, the one of Ethernet and gzip),
 * reflected, with the polynomial 0x04c11db7. */
uint32_t table_checksum(const uint8_t *bytes, size_t count);

/* Writes the reply for a profile of evaluator lut, table_reply_bytes() long. `at` is a multiple of
 * 8. `parameters` are those of the request; errors: those of the model by band of radii. */
void table_reply_put(uint8_t *at, const core_profile *profile, const core_parameters *parameters,
                     const core_model_errors *errors);

/* The number of words of a surface on the wire: with zeros, a multiple of 4. */
size_t table_surface_words(const core_varying *surface);

/* Writes the reply for a surface, table_reply_bytes() long for table_surface_words(). */
void table_reply_put_surface(uint8_t *at, const core_varying *surface,
                             const core_parameters *parameters);

/* Parses a reply. *words points into the payload, which starts at a multiple of 8. Returns false if
 * the payload does not have the shape that its fixed part announces, has another layout, or has a
 * wrong checksum. Core checks what the words say. */
bool table_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_table_reply *fixed,
                       core_parameters *parameters, const float **words);

#endif
