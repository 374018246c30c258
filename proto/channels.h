/* channels: the parts that requests for profiles share. These are the choice of a profile, the
 * media (one channel each), the parameters, and a list of numbers that fills the rest of the
 * payload.
 *
 * All functions that return wire_error return status OK or the first fault.
 */
#ifndef DIPOLED_PROTO_CHANNELS_H
#define DIPOLED_PROTO_CHANNELS_H

#include "core/core.h"
#include "proto/wire.h"

/* Checks that both ids are in their lists. */
wire_error channels_check(unsigned evaluator, unsigned moments);

/* Checks that `wanted` has at least one bit and only bits of the list of quantities. */
wire_error channels_check_wanted(unsigned wanted);

/* Returns true if `wanted` has a bit that is not in the list of quantities. */
bool channels_has_others(unsigned wanted);

/* The part of a payload that has not been parsed yet. */
struct channels_cursor {
  const uint8_t *at;
  size_t remaining; /* bytes from `at` on */
};

/* Parses medium_count media (at least one) and parameter_count parameters, and moves the cursor
 * behind them. *media points into the payload. Lengths are compared by subtraction, and counts are
 * checked before they are multiplied, so that no count can wrap. */
wire_error channels_parse(struct channels_cursor *cursor, uint32_t medium_count,
                          uint32_t parameter_count, const uint8_t **media,
                          core_parameters *parameters);

/* Parses `count` parameter structures, which the caller knows to be in the payload. Checks their
 * ids and padding, that each parameter comes at most once, and that no value is NaN. The error's
 * index is the position of the structure. Core checks the ranges. */
wire_error channels_parse_parameters(const uint8_t *at, uint32_t count,
                                     core_parameters *parameters);

/* Returns how many parameters are given, that is, not NaN. */
uint32_t channels_count_parameters(const core_parameters *parameters);

/* Writes those parameters that are not NaN, in the order of their ids, WIRE_BYTES_parameter each.
 * Returns the number of bytes written. */
size_t channels_put_parameters(uint8_t *at, const core_parameters *parameters);

/* The texts of errors in a list of numbers: names of fields, and what is allowed. */
struct channels_list {
  const char *field;       /* name of the list */
  const char *count_field; /* name of its count */
  const char *too_many;    /* what is allowed if the payload is too short for the count */
  const char *too_long;    /* what is allowed if the payload is too long for the count */
};

extern const struct channels_list CHANNELS_RADII;
extern const struct channels_list CHANNELS_NUMBERS;

/* Parses `count` numbers in the evaluator's precision and their zero padding. They have to be all
 * that remains. *list points into the payload. */
wire_error channels_parse_list(struct channels_cursor *cursor, const struct channels_list *names,
                               uint64_t count, unsigned evaluator, const void **list);

#endif
