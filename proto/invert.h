/* invert: the payloads of an invert request and its reply, laid out and taken apart. */
#ifndef DIPOLED_PROTO_INVERT_H
#define DIPOLED_PROTO_INVERT_H

#include "core/core.h"
#include "proto/wire.h"

/* An invert request, taken apart. The arrays lie in the payload, which starts at a multiple of 8.
 */
typedef struct invert_request {
  wire_invert_request fixed;
  const double *albedos; /* [fixed.medium_count] */
  const double *lengths; /* likewise, mm */
} invert_request;

/* Takes a payload apart. Shape, ids of the lists, and padding; the values are core's to check. */
wire_error invert_request_parse(const uint8_t *payload, size_t payload_bytes,
                                invert_request *request);

/* Bytes of a request's payload. medium_count: up to 2^59. */
uint64_t invert_request_bytes(uint64_t medium_count);

/* The arrays of a reply, in their order: sigma_a, sigma_s, albedo. */
enum invert_array {
  INVERT_SIGMA_A, /* 1/mm */
  INVERT_SIGMA_S, /* 1/mm */
  INVERT_ALBEDO,  /* that the medium has */
  INVERT_ARRAYS
};

/* Bytes of the reply, or its part, with so many media, up to 2^58. */
uint64_t invert_reply_bytes(uint64_t medium_count);

/* Offset of an array of medium_count doubles in it. */
uint64_t invert_array_offset(enum invert_array array, uint64_t medium_count);

/* The most media that a reply of so many bytes has room for. */
uint64_t invert_part_media(uint64_t max_payload_bytes);

/* Takes a reply's payload apart: the fixed part; false when the bytes do not have the shape that it
 * announces. */
bool invert_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_invert_reply *fixed);

#endif
