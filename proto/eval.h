/* eval: encodes and decodes the payloads of requests to eval and to sample, and of their replies.
 *
 * Callers use the arrays in place: if a payload starts at a multiple of 8, so does every structure
 * and array in it.
 */
#ifndef DIPOLED_PROTO_EVAL_H
#define DIPOLED_PROTO_EVAL_H

#include "core/draw.h"
#include "proto/schema.h"

/* Model id of a request that gives a tolerance in place of a model. */
#define EVAL_ANY_MODEL 0

/* The parts of a request to eval, and to sample. */
enum { EVAL_MEDIA, EVAL_PARAMETERS, EVAL_RADII };

/* A parsed eval request. Its pointers point into the payload. */
typedef struct eval_request {
  wire_eval_request fixed;
  const core_medium *media; /* [fixed.medium_count][fixed.layer_count] */
  core_parameters parameters;
  const void *radii; /* [fixed.radius_count], double or float; NULL for a grid */
} eval_request;

/* Parses a payload: schema_check(), and the parameters. Core checks the values. */
wire_error eval_request_parse(const uint8_t *payload, size_t payload_bytes, eval_request *request);

/* Parses a request to sample into an eval request in which the numbers u take the place of the radii:
 * request->radii is the list of numbers, or NULL if a rule makes them. */
wire_error sample_request_parse(const uint8_t *payload, size_t payload_bytes, core_draw *draw,
                                eval_request *request);

/* Flag added to `wanted` for a sample: each channel has its own array of drawn
 * radii. The wire does not carry it. */
#define EVAL_DRAWN 0x80000000u

/* Layout of a reply's payload. Offsets count from its start. */
typedef struct eval_layout {
  uint64_t payload_bytes;
  uint64_t radius_offset;   /* the array of radii, if they are wanted and not drawn */
  uint64_t array_bytes;     /* length of one array with padding */
  uint64_t balances_offset; /* those of the channels, if they are wanted */
  uint64_t errors_offset;   /* quantity_error of the first channel's first quantity */
  unsigned errors_per_channel;
  uint64_t arrays_offset; /* the first channel's first array */
  unsigned arrays_per_channel;
} eval_layout;

/* Computes the layout of a reply. Returns false if it would exceed max_payload_bytes; no input
 * overflows. `evaluator` is in its list; `wanted` has bits of the list of quantities and
 * EVAL_DRAWN. */
bool eval_reply_layout(unsigned evaluator, unsigned wanted, uint32_t channel_count,
                       uint64_t radius_count, uint64_t max_payload_bytes, eval_layout *layout);

/* Returns how many radii fit into a reply of max_payload_bytes, rounded down to a multiple of
 * EVAL_PART_RADII, possibly 0. Returns UINT64_MAX for a reply without arrays. */
uint64_t eval_part_radii(unsigned evaluator, unsigned wanted, uint32_t channel_count,
                         uint64_t max_payload_bytes);

/* Parts end at multiples of this number of radii, so that kernels work on whole vectors. */
#define EVAL_PART_RADII 256

/* Returns true if a reply has an array of this quantity for each channel. */
bool eval_is_array(unsigned wanted, unsigned quantity);

/* Returns the offset of a channel's array of a quantity for which eval_is_array() holds. The arrays
 * of a channel lie in the order of the list of quantities. */
uint64_t eval_array_offset(const eval_layout *layout, unsigned wanted, uint32_t channel,
                           enum core_quantity quantity);

/* Returns the offset of a channel's albedo, an f64. */
uint64_t eval_albedo_offset(uint32_t channel);

/* Returns the offset of the quantity_error of a wanted quantity in a channel. They lie in the order
 * of the list of quantities. */
uint64_t eval_error_offset(const eval_layout *layout, unsigned wanted, uint32_t channel,
                           unsigned quantity);

/* Returns the errors that hold for all values of a channel: the largest of all its quantities. */
wire_quantity_error eval_largest_error(const uint8_t *payload, const eval_layout *layout,
                                       unsigned wanted, uint32_t channel);

/* Parses the payload of a reply to an eval or, if `drawn`, to a sample. Returns false if the
 * payload does not have the shape that its fixed part announces. */
bool eval_reply_parse(const uint8_t *payload, size_t payload_bytes, bool drawn,
                      wire_eval_reply *fixed, eval_layout *layout);

#endif
