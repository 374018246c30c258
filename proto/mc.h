/* mc: encodes and decodes the payloads of an mc request and its replies.
 *
 * The last reply ends with a table: the rings' edges, the energies, the rings. Callers use its
 * arrays in place, like those of an eval reply.
 */
#ifndef DIPOLED_PROTO_MC_H
#define DIPOLED_PROTO_MC_H

#include "core/montecarlo/montecarlo.h"
#include "proto/schema.h"

/* Values of mc_reply.state. */
enum mc_state {
  MC_UNDER_WAY,
  MC_PHOTONS_WALKED,
  MC_ERRORS_SMALL,
  MC_CANCELLED,
  MC_STOPPED, /* the daemon stopped */
};

/* A parsed mc request. */
typedef struct mc_request {
  wire_mc_request fixed;
  /* the layers of the medium: the first fixed.layer_count are set */
  core_medium layers[CORE_LAYERS_MAX];
  double albedo[CORE_MC_ALBEDOS_MAX]; /* the first fixed.albedo_count are set */
  core_parameters parameters;
} mc_request;

/* Parses a payload: schema_check(), and the parameters. The server and core check the values. */
wire_error mc_request_parse(const uint8_t *payload, const schema_layout *layout,
                            mc_request *request);

/* The parts of the last reply: double[ring_count + 1], mm; mc_energy structures;
 * uint64_t[side_count][ring_count]; double[albedo_count][side_count][2][ring_count]. */
enum { MC_EDGES, MC_ENERGIES, MC_PHOTONS, MC_RINGS };

/* Computes the layout of the last reply. Returns false if a count is out of its range. */
bool mc_reply_layout(uint32_t side_count, uint32_t albedo_count, uint32_t ring_count,
                     schema_layout *layout);

/* Returns the offset of the numbers of photons that left through a side, one for each ring. */
size_t mc_photons_offset(const schema_layout *layout, uint32_t side);

/* Returns the offset of the values of all rings of one side, for one albedo; if `error` is true, of
 * their standard errors. Both arrays are double[ring_count], 1/mm^2. */
size_t mc_rings_offset(const schema_layout *layout, uint32_t albedo, uint32_t side, bool error);

/* Parses the payload of a reply. Sets *layout unless the state is MC_UNDER_WAY. Returns false if
 * the payload does not have the shape that its fixed part announces. */
bool mc_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_mc_reply *fixed,
                    schema_layout *layout);

#endif
