/* table: the payloads of a table request and its reply, laid out and taken apart. A reply is also
 * what a table is kept as: in a file it is one whole frame.
 */
#ifndef DIPOLED_PROTO_TABLE_H
#define DIPOLED_PROTO_TABLE_H

#include "core/core.h"
#include "proto/wire.h"

#define TABLE_LAYOUT 1 /* of the words: core/lut/lut.h */

/* A table request, taken apart. */
typedef struct table_request {
  wire_table_request fixed;
  core_medium medium;
  core_parameters parameters;
} table_request;

/* Takes a payload apart. Shape, ids of the lists, and padding; the values are core's to check. */
wire_error table_request_parse(const uint8_t *payload, size_t payload_bytes,
                               table_request *request);

/* Bytes of a request's payload. */
size_t table_request_bytes(uint32_t parameter_count);

/* Bytes of the reply with a table of that many words. */
size_t table_reply_bytes(uint32_t parameter_count, size_t word_count);

/* Writes the reply for a profile of evaluator lut: table_reply_bytes() to `at`, which is a multiple
 * of 8. parameters: those of the request. */
void table_reply_put(uint8_t *at, const core_profile *profile, const core_parameters *parameters);

/* Takes a reply apart: *words lie in the payload, which starts at a multiple of 8. False when the
 * bytes do not have the shape that the fixed part announces, the layout is another, or the checksum
 * is wrong; what the words say is core's to check. */
bool table_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_table_reply *fixed,
                       core_parameters *parameters, const float **words);

#endif
