/* sample: the payload of a sample request, laid out and taken apart. The reply is an eval's with
 * EVAL_DRAWN: proto/eval.h. */
#ifndef DIPOLED_PROTO_SAMPLE_H
#define DIPOLED_PROTO_SAMPLE_H

#include "core/draw.h"
#include "proto/eval.h"

/* Takes a payload apart into the eval of radii that are yet to be drawn: numbers u take the place
 * of the radii, of which request->radii is the list, NULL when they are drawn by rule. Shape only:
 * ids and counts that the layout depends on are checked, as are the ids of the parameters, the
 * exact length and zero padding; the values are core's to check. */
wire_error sample_request_parse(const uint8_t *payload, size_t payload_bytes, core_draw *draw,
                                eval_request *request);

/* Bytes of a request's payload with number_bytes of listed numbers (0 by rule). */
uint64_t sample_request_bytes(uint32_t medium_count, uint32_t parameter_count,
                              uint64_t number_bytes);

#endif
