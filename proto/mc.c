#include "proto/mc.h"

#include <string.h>

#include "proto/channels.h"

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's arrays need swapping");

size_t mc_request_bytes(uint32_t albedo_count, uint32_t parameter_count) {
  return WIRE_BYTES_mc_request + WIRE_BYTES_medium + albedo_count * sizeof(double) +
         (size_t)parameter_count * WIRE_BYTES_parameter;
}

static const char nothing_after[] =
    "nothing after the medium but albedo_count albedos and then parameters";

/* All that is left after the albedos is parameters. */
static wire_error parse_parameters(const uint8_t *at, size_t bytes, core_parameters *parameters) {
  if (bytes % WIRE_BYTES_parameter != 0) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes", nothing_after);
  }
  return channels_parse_parameters(at, (uint32_t)(bytes / WIRE_BYTES_parameter), parameters);
}

wire_error mc_request_parse(const uint8_t *payload, size_t payload_bytes, mc_request *request) {
  if (payload_bytes < mc_request_bytes(0, 0)) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes",
                           "at least 96: an mc_request and a medium");
  }
  wire_get_mc_request(payload, &request->fixed);
  wire_get_medium(payload + WIRE_BYTES_mc_request, &request->medium);
  if (request->fixed.albedo_count > CORE_MC_ALBEDOS_MAX) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "albedo_count", "0 to 16");
  }
  const size_t before = mc_request_bytes(request->fixed.albedo_count, 0);
  if (payload_bytes < before) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes", nothing_after);
  }
  memcpy(request->albedo, payload + mc_request_bytes(0, 0),
         request->fixed.albedo_count * sizeof *request->albedo);
  return parse_parameters(payload + before, payload_bytes - before, &request->parameters);
}

bool mc_reply_layout(uint32_t side_count, uint32_t albedo_count, uint32_t ring_count,
                     mc_layout *layout) {
  if (side_count < 1 || side_count > CORE_MC_SIDES || albedo_count < 1 ||
      albedo_count > CORE_MC_ALBEDOS_MAX || ring_count < 1 || ring_count > CORE_MC_RINGS_MAX) {
    return false;
  }
  const size_t sides = side_count, albedos = albedo_count, rings = ring_count;
  layout->edges_offset = WIRE_BYTES_mc_reply;
  layout->energies_offset = layout->edges_offset + (rings + 1) * sizeof(double);
  layout->photons_offset = layout->energies_offset + albedos * WIRE_BYTES_mc_energy;
  layout->rings_offset = layout->photons_offset + sides * rings * sizeof(uint64_t);
  layout->payload_bytes = layout->rings_offset + albedos * sides * 2 * rings * sizeof(double);
  return true;
}

size_t mc_photons_offset(const mc_layout *layout, uint32_t ring_count, uint32_t side) {
  return layout->photons_offset + (size_t)side * ring_count * sizeof(uint64_t);
}

size_t mc_rings_offset(const mc_layout *layout, uint32_t side_count, uint32_t ring_count,
                       uint32_t albedo, uint32_t side, bool error) {
  const size_t array = ((size_t)albedo * side_count + side) * 2 + (error ? 1 : 0);
  return layout->rings_offset + array * ring_count * sizeof(double);
}

bool mc_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_mc_reply *fixed,
                    mc_layout *layout) {
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
