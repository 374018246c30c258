/* query: writes the media and parameters of requests. The library checks only the fields on which
 * the layout of a frame depends; the daemon checks all others. */
#ifndef LIBDIPOLE_QUERY_H
#define LIBDIPOLE_QUERY_H

#include "clients/c/request.h"
#include "proto/schema.h"

/* Fails if dipole_id() did not find the model. */
bool libdipole_model_check(unsigned model, dipole_error *error);

/* Checks the count and the ids of parameters. */
bool libdipole_parameters_check(const dipole_parameter *parameters, size_t count,
                                dipole_error *error);

/* These write bytes at `at` and return the address behind them. */
uint8_t *libdipole_parameters_put(uint8_t *at, const dipole_parameter *parameters, size_t count);
uint8_t *libdipole_medium_put(uint8_t *at, const dipole_medium *medium);

/* Writes a request: the structures that it begins with, of this layout, and its parts in the order of
 * proto/messages.def. Parameters are those of a query, media are dipole_medium. A part that is NULL, or
 * is not there, has no numbers but 0. */
void libdipole_payload_put(uint8_t *at, const schema_payload *payload, const schema_layout *layout,
                           const void *start, const void *const parts[]);

/* Begins a request with this payload, and sends it. */
bool libdipole_request_put(dipole_client *client, libdipole_pending *pending,
                           const schema_payload *payload, const void *start,
                           const void *const parts[], dipole_error *error);

/* Fails unless each of several numbers fits into 16 bits. all: their bits, combined with |. names:
 * the names of the fields, for the error message. */
bool libdipole_check_u16(unsigned all, const char *names, dipole_error *error);

#endif
