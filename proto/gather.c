#include "proto/gather.h"

#include "proto/schema.h"

/* ---- names ----------------------------------------------------------------------------------- */

void gather_name_start(gather_name *name, uint32_t channel_count, uint64_t point_count) {
  name->counts[0] = channel_count;
  name->counts[1] = point_count;
  digest_start(&name->xyz);
  digest_start(&name->power);
}

void gather_name_add(gather_name *name, uint64_t n, const double *xyz, const float *power) {
  digest_add(&name->xyz, xyz, (size_t)n * GATHER_AXES * sizeof *xyz);
  digest_add(&name->power, power, (size_t)(n * name->counts[0]) * sizeof *power);
}

void gather_name_end(gather_name *name, uint64_t set[2]) {
  uint64_t parts[2][2];
  digest_state whole;
  digest_end(&name->xyz, parts[0]);
  digest_end(&name->power, parts[1]);
  digest_start(&whole);
  digest_add(&whole, name->counts, sizeof name->counts);
  digest_add(&whole, parts, sizeof parts);
  digest_end(&whole, set);
}

/* ---- points ---------------------------------------------------------------------------------- */

wire_error points_request_parse(const uint8_t *payload, const schema_layout *layout,
                                points_request *request) {
  wire_points_request *fixed = &request->fixed;
  wire_get_points_request(payload, fixed);
  if (fixed->point_first > fixed->point_count) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "point_first", "at most point_count");
  }
  if (fixed->part_points > fixed->point_count - fixed->point_first) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "part_points",
                           "no more points than the set has from point_first on");
  }
  request->xyz = (const double *)(const void *)(payload + layout->parts[0].at);
  request->power = (const float *)(const void *)(payload + layout->parts[1].at);
  return wire_error_none();
}

bool points_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_points_reply *fixed) {
  if (payload_bytes != WIRE_BYTES_points_reply) {
    return false;
  }
  wire_get_points_reply(payload, fixed);
  return fixed->known <= 1;
}

/* ---- gather ---------------------------------------------------------------------------------- */

wire_error gather_request_parse(const uint8_t *payload, const schema_layout *layout,
                                gather_request *request) {
  wire_get_gather_request(payload, &request->fixed);
  request->media = (const core_medium *)(const void *)(payload + layout->parts[0].at);
  request->queries = (const double *)(const void *)(payload + layout->parts[2].at);
  return schema_parse_parameters(payload + layout->parts[1].at, request->fixed.parameter_count,
                                 request->fixed.layer_count, &request->parameters);
}

size_t gather_sums_offset(uint32_t channel_count) {
  return WIRE_BYTES_gather_reply + (size_t)channel_count * WIRE_BYTES_quantity_error;
}

uint64_t gather_reply_bytes(uint32_t channel_count, uint64_t query_count) {
  const wire_gather_reply fixed = {.channel_count = channel_count, .count = query_count};
  return schema_bytes(&schema_gather_reply, &fixed);
}
