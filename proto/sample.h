/* sample: encodes and decodes the payload of a sample request. Its reply is that of an eval with
 * EVAL_DRAWN (proto/eval.h). */
#ifndef DIPOLED_PROTO_SAMPLE_H
#define DIPOLED_PROTO_SAMPLE_H

#include "core/draw.h"
#include "proto/eval.h"

/* Parses a payload into an eval request in which the numbers u take the place of the radii:
 * request->radii is the list of numbers, or NULL if a rule makes them. Checks its shape only: the
 * ids and counts that the layout depends on, the ids of the parameters, the exact length and the
 * zero padding. Core checks the values. */
wire_error sample_request_parse(const uint8_t *payload, size_t payload_bytes, core_draw *draw,
                                eval_request *request);

/* Returns the payload bytes of a request with number_bytes of listed numbers, 0 for a rule. */
uint64_t sample_request_bytes(uint32_t medium_count, uint32_t parameter_count,
                              uint64_t number_bytes);

#endif
