/* channels: the parameters of requests, and the quantities that they may want. */
#ifndef DIPOLED_PROTO_CHANNELS_H
#define DIPOLED_PROTO_CHANNELS_H

#include "core/core.h"
#include "proto/wire.h"

/* A layer of a medium has the same layout on the wire and in core, so core reads payloads in place. */
_Static_assert(sizeof(core_medium) == WIRE_BYTES_medium, "one layer after the other");

/* Returns true if `wanted` has a bit that is not in the list of quantities. */
bool channels_has_others(unsigned wanted);

/* Parses `count` parameter structures, which the caller knows to be in the payload. Checks their
 * ids and padding, that each parameter comes at most once, and that no value is NaN. The error's
 * index is the position of the structure. Core checks the ranges. layer_count: of the request's
 * media. */
wire_error channels_parse_parameters(const uint8_t *at, uint32_t count, uint32_t layer_count,
                                     core_parameters *parameters);

/* Returns how many parameters are given, that is, not NaN. */
uint32_t channels_count_parameters(const core_parameters *parameters);

/* Writes those parameters that are not NaN, in the order of their ids, WIRE_BYTES_parameter each.
 * Returns the number of bytes written. */
size_t channels_put_parameters(uint8_t *at, const core_parameters *parameters);

#endif
