/* invert: encodes and decodes the payloads of an invert request and its reply. */
#ifndef DIPOLED_PROTO_INVERT_H
#define DIPOLED_PROTO_INVERT_H

#include "proto/schema.h"

/* A parsed invert request. Its arrays point into the payload, which starts at a multiple of 8. */
typedef struct invert_request {
  wire_invert_request fixed;
  const double *albedos; /* [fixed.medium_count] */
  const double *lengths; /* [fixed.medium_count], mm */
} invert_request;

/* Parses a payload: schema_check(). Core checks the values. */
wire_error invert_request_parse(const uint8_t *payload, size_t payload_bytes,
                                invert_request *request);

/* The arrays of a reply, in their order. */
enum invert_array {
  INVERT_SIGMA_A, /* 1/mm */
  INVERT_SIGMA_S, /* 1/mm */
  INVERT_ALBEDO,  /* the albedo of the medium found */
  INVERT_ARRAYS
};

/* Returns the offset of an array of medium_count doubles in the payload of a reply. */
uint64_t invert_array_offset(enum invert_array array, uint64_t medium_count);

/* Parses the fixed part of a reply. Returns false if the payload does not have the shape that its
 * fixed part announces. */
bool invert_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_invert_reply *fixed);

#endif
