#include "proto/invert.h"

wire_error invert_request_parse(const uint8_t *payload, size_t payload_bytes,
                                invert_request *request) {
  schema_layout layout;
  const wire_error error = schema_check(&schema_invert_request, payload, payload_bytes, &layout);
  if (error.status == WIRE_STATUS_OK) {
    wire_get_invert_request(payload, &request->fixed);
    request->albedos = (const double *)(const void *)(payload + layout.parts[0].at);
    request->lengths = (const double *)(const void *)(payload + layout.parts[1].at);
  }
  return error;
}

uint64_t invert_array_offset(enum invert_array array, uint64_t medium_count) {
  return WIRE_BYTES_invert_reply + array * medium_count * sizeof(double);
}

bool invert_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_invert_reply *fixed) {
  schema_layout layout;
  if (!schema_is_whole(&schema_invert_reply, payload, payload_bytes, &layout)) {
    return false;
  }
  wire_get_invert_reply(payload, fixed);
  return fixed->part < fixed->part_count && fixed->missing_count <= fixed->count;
}
