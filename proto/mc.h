/* mc: the payloads of an mc request and its replies, laid out and taken apart.
 *
 * A table follows the last reply: the rings' edges, the energies, the rings. Its arrays are used
 * where they lie, as those of an eval reply are.
 */
#ifndef DIPOLED_PROTO_MC_H
#define DIPOLED_PROTO_MC_H

#include "core/montecarlo/montecarlo.h"
#include "proto/wire.h"

/* mc_reply.state */
enum mc_state {
  MC_UNDER_WAY,
  MC_PHOTONS_WALKED,
  MC_ERRORS_SMALL,
  MC_CANCELLED,
  MC_STOPPED, /* with the daemon */
};

/* An mc request, taken apart. */
typedef struct mc_request {
  wire_mc_request fixed;
  wire_medium medium;
  double albedo[CORE_MC_ALBEDOS_MAX]; /* fixed.albedo_count of them */
} mc_request;

/* Takes a payload apart. Shape only; the values are the server's and core's to check. */
wire_error mc_request_parse(const uint8_t *payload, size_t payload_bytes, mc_request *request);

/* Bytes of a request's payload. */
size_t mc_request_bytes(uint32_t albedo_count);

/* The layout of the last reply's payload. Offsets are from its start. */
typedef struct mc_layout {
  size_t payload_bytes;
  size_t edges_offset;    /* double[ring_count + 1], mm */
  size_t energies_offset; /* mc_energy structures */
  size_t photons_offset;  /* uint64_t[side_count][ring_count] */
  size_t rings_offset;    /* double[albedo_count][side_count][2][ring_count] */
} mc_layout;

/* False when a count is out of its range. */
bool mc_reply_layout(uint32_t side_count, uint32_t albedo_count, uint32_t ring_count,
                     mc_layout *layout);

/* Offset of the photons that left through a side, by ring. */
size_t mc_photons_offset(const mc_layout *layout, uint32_t ring_count, uint32_t side);

/* Offset of the R (error: their standard errors) of the rings of a side, for an albedo, 1/mm^2. */
size_t mc_rings_offset(const mc_layout *layout, uint32_t side_count, uint32_t ring_count,
                       uint32_t albedo, uint32_t side, bool error);

/* Takes the payload of a reply apart: the fixed part and, unless the state is MC_UNDER_WAY, the
 * layout; false when the bytes do not have the shape that the fixed part announces. */
bool mc_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_mc_reply *fixed,
                    mc_layout *layout);

#endif
