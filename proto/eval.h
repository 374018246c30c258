/* eval: the payloads of an eval request and its reply, laid out and taken apart.
 *
 * The arrays are used where they lie: a payload that starts at a multiple of 8 has every structure
 * and array at a multiple of 8.
 */
#ifndef DIPOLED_PROTO_EVAL_H
#define DIPOLED_PROTO_EVAL_H

#include "core/core.h"
#include "proto/wire.h"

/* The model of a request that asks for a tolerance instead. */
#define EVAL_ANY_MODEL 0

/* An eval request, taken apart. The pointers point into the payload. */
typedef struct eval_request {
  wire_eval_request fixed;
  const uint8_t *media; /* fixed.medium_count structures: wire_get_medium(media + i * 32, ...) */
  core_parameters parameters;
  const void *radii; /* a list: fixed.radius_count of double or float; NULL for a grid */
} eval_request;

/* Takes a payload apart. Shape only: ids and counts that the layout depends on are checked, as are
 * the ids of the parameters, the exact length and zero padding; the values are core's to check. */
wire_error eval_request_parse(const uint8_t *payload, size_t payload_bytes, eval_request *request);

/* Bytes of a request's payload with radii_bytes of listed radii (0 for a grid). */
uint64_t eval_request_bytes(uint32_t medium_count, uint32_t parameter_count, uint64_t radii_bytes);

/* Added to the quantities that are wanted of a sample (proto/sample.h): the radii are drawn, and
 * each channel has its own, an array as any other. The wire does not carry it. */
#define EVAL_DRAWN 0x10000u

/* The layout of a reply's payload. Offsets are from its start. */
typedef struct eval_layout {
  uint64_t payload_bytes;
  uint64_t radius_offset;   /* of the radii; only when wanted, and not drawn */
  uint64_t array_bytes;     /* of one array, padded */
  uint64_t channels_offset; /* of the first channel structure */
  uint64_t arrays_offset;   /* of the first channel's arrays */
  unsigned arrays_per_channel;
} eval_layout;

/* The layout that a reply has for these counts; false when it would exceed max_payload_bytes
 * (checked without overflow for any input). wanted: quantity bits of the list, EVAL_DRAWN;
 * evaluator of the list. */
bool eval_reply_layout(unsigned evaluator, unsigned wanted, uint32_t channel_count,
                       uint64_t radius_count, uint64_t max_payload_bytes, eval_layout *layout);

/* The most radii that a reply of max_payload_bytes has room for, rounded down to a multiple of
 * EVAL_PART_RADII; 0: not even that many. Of a reply with no arrays: UINT64_MAX. */
uint64_t eval_part_radii(unsigned evaluator, unsigned wanted, uint32_t channel_count,
                         uint64_t max_payload_bytes);

/* Parts are cut at multiples of this, so that kernels find whole vectors in each. */
#define EVAL_PART_RADII 256

/* True when a reply has an array of this quantity for each channel. */
bool eval_is_array(unsigned wanted, unsigned quantity);

/* Offset of a channel's array of a quantity for which eval_is_array(). The arrays of a channel lie
 * in the order of the list of quantities. */
uint64_t eval_array_offset(const eval_layout *layout, unsigned wanted, uint32_t channel,
                           enum core_quantity quantity);

/* Takes the payload of a reply to an eval apart, or with drawn to a sample: the fixed part and the
 * layout; false when the bytes do not have the shape that the fixed part announces. */
bool eval_reply_parse(const uint8_t *payload, size_t payload_bytes, bool drawn,
                      wire_eval_reply *fixed, eval_layout *layout);

#endif
