/* table: encodes and decodes the payloads of a table request and its reply. A file with a table
 * holds one whole frame with such a reply. */
#ifndef DIPOLED_PROTO_TABLE_H
#define DIPOLED_PROTO_TABLE_H

#include "core/model_error.h"
#include "core/varying.h"
#include "proto/schema.h"

#define TABLE_LAYOUT 5 /* version of the layout of table_reply and the words (core/lut/lut.h) */

/* A parsed table request. It points into the payload. */
typedef struct table_request {
  wire_table_request fixed;
  const core_medium *layers; /* [fixed.layer_count]: the layers of the medium, in the payload */
  core_parameters parameters;
} table_request;

/* Whether a request is for the surface of all media with its g and eta (core/varying.h):
 * sigma_a and sigma_s are 0. */
static inline bool table_is_surface(const table_request *request) {
  return request->fixed.layer_count == 1 && request->layers->sigma_a_per_mm == 0 &&
         request->layers->sigma_s_per_mm == 0;
}

/* Parses a payload: schema_check(), and the parameters. Core checks the values. */
wire_error table_request_parse(const uint8_t *payload, const schema_layout *layout,
                               table_request *request);

/* Returns the payload bytes of a reply with a table of word_count words, to a request with these
 * parameters. */
size_t table_reply_bytes(const core_parameters *parameters, size_t word_count);

/* Returns the checksum of a table's words: CRC-32 (ISO 3309, the one of Ethernet and gzip),
 * reflected, with the polynomial 0x04c11db7. */
uint32_t table_checksum(const uint8_t *bytes, size_t count);

/* Writes the reply for a profile of evaluator lut, table_reply_bytes() long. `at` is a multiple of
 * 8. layers and parameters are those of the request. errors: those of the model by band of
 * radii. */
void table_reply_put(uint8_t *at, const core_profile *profile, const core_medium *layers,
                     const core_parameters *parameters, const core_model_errors *errors);

/* The number of words of a surface on the wire: with zeros, a multiple of 4. */
size_t table_surface_words(const core_varying *surface);

/* Writes the reply for a surface, table_reply_bytes() long for table_surface_words(). */
void table_reply_put_surface(uint8_t *at, const core_varying *surface,
                             const core_parameters *parameters);

/* Parses a reply. Sets *layers, of which there are fixed->layer_count, and *words to places in the
 * payload, which starts at a multiple of 8. Returns false if the payload does not have the shape
 * that its fixed part announces, has another layout, or has a wrong checksum. Core checks the
 * words. */
bool table_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_table_reply *fixed,
                       const core_medium **layers, core_parameters *parameters,
                       const float **words);

#endif
