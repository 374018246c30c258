/* table: what fetching and loading a table and a surface have in common. */
#ifndef LIBDIPOLE_TABLE_H
#define LIBDIPOLE_TABLE_H

#include "clients/c/request.h"
#include "core/model_error.h"
#include "proto/varying.h"

/* Reads the header of the frame at the start of the bytes; sets *frame_bytes to its length. Fails
 * if they do not start with the whole frame of a table. */
bool libdipole_table_check(const uint8_t *bytes, size_t count, size_t *frame_bytes,
                           dipole_error *error);

/* Sends a table request and waits for the reply, whose libdipole_frame_bytes() are then set. Returns
 * NULL if it failed or was refused. */
libdipole_frame *libdipole_table_request(dipole_client *client, const dipole_table_query *query,
                                         dipole_error *error);

/* Fails with kind PROTOCOL if the reply to a table request was no intact table: *error is then of kind
 * TABLE. Keeps any other error. Returns false. */
bool libdipole_table_refuse(dipole_client *client, dipole_error *error);

/* Returns the profile that a table evaluates, of evaluator lut. The table owns it. */
const core_profile *libdipole_table_profile(const dipole_table *table);

/* Returns the model's errors by band of radii. The table owns them. */
const core_model_errors *libdipole_table_model_errors(const dipole_table *table);

/* Returns the preparation for the request's evaluator if the surface is that of its model, moments,
 * g, eta and parameters, else NULL. The surface owns it. */
const core_varying *libdipole_surface_varying(const dipole_surface *surface,
                                              const varying_request *request);

#endif
