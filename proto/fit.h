/* fit: encodes and decodes the payloads of a fit request and its reply. */
#ifndef DIPOLED_PROTO_FIT_H
#define DIPOLED_PROTO_FIT_H

#include "core/fit/fit.h"
#include "proto/schema.h"

/* What a request begins with, and the parts that follow. */
typedef struct fit_start {
  wire_fit_request request;
  wire_fit_design design;
} fit_start;
enum { FIT_PARAMETERS, FIT_REFERENCE, FIT_AT, FIT_SOURCE, FIT_DETECTOR, FIT_VALUES, FIT_ERRORS };

/* The part of a request that says what an instrument is, and what is fitted. `design` points into
 * the bytes and to `parameters`. */
typedef struct fit_design {
  core_fit_design design;
  core_parameters parameters;
} fit_design;

/* A parsed fit request. Its arrays point into the payload, which starts at a multiple of 8. */
typedef struct fit_request {
  wire_fit_request fixed;
  wire_fit_design design;      /* core checks the values */
  const uint8_t *design_bytes; /* for fit_design_read() */
  size_t design_bytes_count;
  const double *values; /* [fixed.set_count][design.reading_count] */
  const double *errors; /* the same */
} fit_request;

/* Parses a payload: schema_check(), the readings of a free scale, and the parameters. */
wire_error fit_request_parse(const uint8_t *payload, const schema_layout *layout,
                             fit_request *request);

/* Reads the design of a request that was parsed; the bytes may be a copy at a multiple of 8. */
void fit_design_read(const uint8_t *design_bytes, fit_design *design);

/* Returns the offset of the residuals, [set_count][residuals], in the payload of a reply. */
uint64_t fit_residuals_offset(uint64_t set_count);

#endif
