/* query: writes the media and parameters of requests. The library checks only the fields on which
 * the layout of a frame depends; the daemon checks all others. */
#ifndef LIBDIPOLE_QUERY_H
#define LIBDIPOLE_QUERY_H

#include "clients/c/request.h"
#include "proto/schema.h"

/* Returns the number of layers that a query's layer_count means: 0 means 1. */
static inline uint16_t libdipole_layers(uint32_t layer_count) {
  return (uint16_t)(layer_count == 0 ? 1 : layer_count > UINT16_MAX ? UINT16_MAX : layer_count);
}

/* Checks the model, which dipole_id() may not have found, and that of parameters the count and the
 * ids. others: all other ids of a query, combined with |; they have to fit into 16 bits. */
bool libdipole_query_check(unsigned model, unsigned others, const dipole_parameter *parameters,
                           size_t count, dipole_error *error);

/* Writes a request: the structures that it begins with, of this layout, and its parts in the order of
 * proto/messages.def. Parameters are those of a query, media are dipole_medium. A part that is NULL, or
 * is not there, has no numbers but 0. */
void libdipole_payload_put(uint8_t *at, const schema_payload *payload, const schema_layout *layout,
                           const void *start, const void *const parts[]);

/* Begins a request with this payload, and sends it. */
bool libdipole_request_put(dipole_client *client, libdipole_pending *pending,
                           const schema_payload *payload, const void *start,
                           const void *const parts[], dipole_error *error);

/* The reply that a request may have. */
typedef struct libdipole_shape {
  const schema_payload *payload;
  const void *most; /* a first structure with the largest counts */
  bool may_be_less; /* whether a frame may have less, as one of several or a shorter one */
} libdipole_shape;

/* Sends a request like libdipole_request_put(), and waits for its reply like libdipole_reply(). */
libdipole_frame *libdipole_ask(dipole_client *client, libdipole_pending *pending,
                               const schema_payload *payload, const void *start,
                               const void *const parts[], const libdipole_shape *reply,
                               dipole_error *error);

#endif
