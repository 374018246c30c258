#include "proto/mc.h"

#include <string.h>

#include "proto/schema.h"

wire_error mc_request_parse(const uint8_t *payload, const schema_layout *layout,
                            mc_request *request) {
  wire_get_mc_request(payload, &request->fixed);
  memcpy(request->layers, payload + layout->parts[0].at,
         request->fixed.layer_count * sizeof *request->layers);
  memcpy(request->albedo, payload + layout->parts[1].at,
         request->fixed.albedo_count * sizeof *request->albedo);
  return schema_parse_parameters(payload + layout->parts[2].at, (uint32_t)layout->parts[2].count,
                                 request->fixed.layer_count, &request->parameters);
}

bool mc_reply_layout(uint32_t side_count, uint32_t albedo_count, uint32_t ring_count,
                     schema_layout *layout) {
  if (side_count < 1 || side_count > CORE_MC_SIDES || albedo_count < 1 ||
      albedo_count > CORE_MC_ALBEDOS_MAX || ring_count < 1 || ring_count > CORE_MC_RINGS_MAX) {
    return false;
  }
  const wire_mc_reply fixed = {.state = MC_PHOTONS_WALKED,
                               .side_count = (uint16_t)side_count,
                               .albedo_count = (uint16_t)albedo_count,
                               .ring_count = ring_count};
  return schema_lay_out(&schema_mc_reply, &fixed, UINT64_MAX, layout, NULL);
}

size_t mc_photons_offset(const schema_layout *layout, uint32_t side) {
  return (size_t)(layout->parts[MC_PHOTONS].at +
                  side * (layout->parts[MC_EDGES].count - 1) * sizeof(uint64_t));
}

size_t mc_rings_offset(const schema_layout *layout, uint32_t albedo, uint32_t side, bool error) {
  const uint64_t rings = layout->parts[MC_EDGES].count - 1;
  const uint64_t sides = layout->parts[MC_PHOTONS].count / rings;
  return (size_t)(layout->parts[MC_RINGS].at +
                  ((albedo * sides + side) * 2 + error) * rings * sizeof(double));
}

bool mc_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_mc_reply *fixed,
                    schema_layout *layout) {
  if (payload_bytes < WIRE_BYTES_mc_reply) {
    return false;
  }
  wire_get_mc_reply(payload, fixed);
  if (fixed->state == MC_UNDER_WAY) {
    return payload_bytes == WIRE_BYTES_mc_reply && fixed->albedo_count == 0 &&
           fixed->ring_count == 0;
  }
  return mc_reply_layout(fixed->side_count, fixed->albedo_count, fixed->ring_count, layout) &&
         payload_bytes == layout->payload_bytes;
}
