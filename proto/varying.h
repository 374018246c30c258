/* varying: encodes and decodes the payloads of a request in which every value has a medium of its
 * own (core/varying.h), and of its reply. Evaluates slices of the values, so that a daemon and a
 * client at home do it with the same code.
 *
 * Callers use the arrays in place: if a payload starts at a multiple of 8, so does every array in
 * it.
 */
#ifndef DIPOLED_PROTO_VARYING_H
#define DIPOLED_PROTO_VARYING_H

#include "core/varying.h"
#include "proto/schema.h"

/* What the third array of a request holds. */
enum varying_numbers { VARYING_NONE, VARYING_RADII, VARYING_DRAWN, VARYING_NUMBERS };

/* A parsed request. Its arrays point into the payload: double or float as the evaluator says. */
typedef struct varying_request {
  wire_varying_request fixed;
  core_parameters parameters;
  core_colour colour;   /* meaning of the colours, if fixed.given is not 0 */
  const void *media[2]; /* sigma_a and sigma_s (1/mm), or colours and lengths (mm) */
  const void *numbers;  /* radii (mm) or numbers u; NULL if there are none */
} varying_request;

/* Parses a payload: schema_check(), what is wanted, and the parameters. Core checks the values. */
wire_error varying_request_parse(const uint8_t *payload, size_t payload_bytes,
                                 varying_request *request);

/* Layout of a reply's payload. Offsets count from its start. */
typedef struct varying_layout {
  uint32_t arrays;        /* mask of the arrays: see VARYING_QUANTITY */
  uint64_t array_bytes;   /* length of one array with padding */
  uint64_t status_offset; /* the statuses: one byte for each value, then padding */
  uint64_t payload_bytes;
} varying_layout;

/* The arrays of a reply are a sum of bits: those of enum core_coefficient, and those of enum
 * core_quantity moved left. They come in the order of their bits. */
#define VARYING_QUANTITY_SHIFT 8
#define VARYING_QUANTITY(bit) ((uint32_t)(bit) << VARYING_QUANTITY_SHIFT)

/* Computes the layout of a reply to fixed->wanted and fixed->coefficients for `count` values, at
 * most 2^58. */
varying_layout varying_reply_layout(unsigned evaluator, unsigned wanted, unsigned coefficients,
                                    uint64_t count);

/* Parts end at multiples of this number of values, so that kernels work on whole vectors. */
#define VARYING_PART_VALUES 256

/* Returns the offset of one of the arrays. */
uint64_t varying_array_offset(const varying_layout *layout, uint32_t array);

/* Parses the payload of a reply. Returns false if the payload does not have the shape that its
 * fixed part announces. */
bool varying_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_varying_reply *fixed,
                         varying_layout *layout);

/* ---- evaluating ------------------------------------------------------------------------------ */

/* The most values of one slice, and the arrays of this length that a slice needs as scratch. */
enum { VARYING_SLICE_VALUES = 2048, VARYING_SCRATCH_ARRAYS = 6 };

/* A reply, or a part of one, that is being filled in. */
typedef struct varying_part {
  uint8_t *payload; /* aligned to 8 */
  varying_layout layout;
  uint64_t first; /* index in the request of the part's first value */
  uint64_t count;
  core_varying_range range; /* range of all values so far */
  double model_error;       /* largest error so far against transport; NAN: nothing was compared */
} varying_part;

/* Begins a part. Zeroes the padding of its arrays. */
void varying_part_start(varying_part *part, const varying_request *request, uint8_t *payload,
                        uint64_t first, uint64_t count);

/* Evaluates the values begin to begin + n - 1 of the part, n up to VARYING_SLICE_VALUES, and writes
 * their arrays and statuses. ruler: `transport` with the same g, eta and evaluator, with which the
 * values are compared, or NULL. scratch: [VARYING_SCRATCH_ARRAYS * VARYING_SLICE_VALUES]. */
void varying_part_evaluate(varying_part *part, const varying_request *request,
                           const core_varying *varying, const core_varying *ruler, uint64_t begin,
                           size_t n, double *scratch);

/* Writes the start of the part, when all its values have been evaluated. */
void varying_part_end(const varying_part *part, const varying_request *request,
                      const core_varying *varying, const core_varying *ruler, uint32_t number,
                      uint32_t part_count);

#endif
