/* sample: encodes and decodes the payload of a sample request. Its reply is that of an eval with
 * EVAL_DRAWN (proto/eval.h). */
#ifndef DIPOLED_PROTO_SAMPLE_H
#define DIPOLED_PROTO_SAMPLE_H

#include "core/draw.h"
#include "proto/eval.h"

/* Parses a payload into an eval request in which the numbers u take the place of the radii:
 * request->radii is the list of numbers, or NULL if a rule makes them. Checks it as
 * eval_request_parse() does. */
wire_error sample_request_parse(const uint8_t *payload, size_t payload_bytes, core_draw *draw,
                                eval_request *request);

#endif
