/* channels: what evals and samples have in common: the choices of a profile, media, parameters, and
 * a list of numbers that fills the rest of a payload. */
#ifndef DIPOLED_PROTO_CHANNELS_H
#define DIPOLED_PROTO_CHANNELS_H

#include "core/core.h"
#include "proto/wire.h"

/* The ids, by the lists. */
wire_error channels_check(unsigned evaluator, unsigned moments);

/* Quantities: at least one, and none that is not in the list. */
wire_error channels_check_wanted(unsigned wanted);
bool channels_has_others(unsigned wanted);

/* Bytes that have not been taken apart. */
struct channels_cursor {
  const uint8_t *at;
  size_t remaining;
};

/* Takes media (at least one) and parameters. Lengths are compared by subtraction and counts before
 * they are multiplied, so that no count can wrap. */
wire_error channels_parse(struct channels_cursor *cursor, uint32_t medium_count,
                          uint32_t parameter_count, const uint8_t **media,
                          core_parameters *parameters);

/* What a list is called in errors. */
struct channels_list {
  const char *field; /* of one number */
  const char *count_field;
  const char *too_many;
  const char *too_long;
};

extern const struct channels_list CHANNELS_RADII;
extern const struct channels_list CHANNELS_NUMBERS;

/* Takes count numbers in an evaluator's precision, and zero bytes as padding: all that remains. */
wire_error channels_parse_list(struct channels_cursor *cursor, const struct channels_list *names,
                               uint64_t count, unsigned evaluator, const void **list);

#endif
