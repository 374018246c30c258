/* parameters: the parameter structures that requests and tables carry. */
#ifndef DIPOLED_PROTO_PARAMETERS_H
#define DIPOLED_PROTO_PARAMETERS_H

#include "core/core.h"
#include "proto/wire.h"

/* Takes `count` structures apart, which are there. Ids, padding, each at most once, no NaN; the
 * error's index is the position of the structure. Ranges are core's to check. */
wire_error parameters_parse(const uint8_t *at, uint32_t count, core_parameters *parameters);

/* How many are given. */
uint32_t parameters_count(const core_parameters *parameters);

/* Writes those that are given, in the order of their ids; returns the bytes that they took:
 * WIRE_BYTES_parameter each. */
size_t parameters_put(uint8_t *at, const core_parameters *parameters);

#endif
