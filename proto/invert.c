#include "proto/invert.h"

/* Arrays are used in place, so this machine must be little-endian like the protocol. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's arrays need swapping");

enum { REQUEST_ARRAYS = 2 };

uint64_t invert_request_bytes(uint64_t medium_count) {
  return WIRE_BYTES_invert_request + medium_count * (REQUEST_ARRAYS * sizeof(double));
}

static wire_error check_choices(const wire_invert_request *fixed) {
  if (core_choice_by_id(core_models, fixed->model) == NULL) {
    return wire_error_not_in_list("model", core_models, "one of");
  }
  if (core_choice_by_id(core_moments_list, fixed->moments) == NULL) {
    return wire_error_not_in_list("moments", core_moments_list, "one of");
  }
  if (core_choice_by_id(core_lengths, fixed->given) == NULL) {
    return wire_error_not_in_list("given", core_lengths, "one of");
  }
  return fixed->zero != 0 ? wire_error_make(WIRE_STATUS_BAD_VALUE, "zero", "0") : wire_error_none();
}

wire_error invert_request_parse(const uint8_t *payload, size_t payload_bytes,
                                invert_request *request) {
  if (payload_bytes < WIRE_BYTES_invert_request) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes",
                           "at least 32: an invert_request");
  }
  wire_get_invert_request(payload, &request->fixed);
  const wire_error error = check_choices(&request->fixed);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  const size_t media_bytes = payload_bytes - WIRE_BYTES_invert_request;
  const size_t medium_bytes = REQUEST_ARRAYS * sizeof(double);
  const uint64_t count = request->fixed.medium_count;
  if (count < 1) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "medium_count", "at least 1");
  }
  if (media_bytes % medium_bytes != 0 || media_bytes / medium_bytes != count) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "medium_count",
                           "as many albedos, and lengths, as the payload holds");
  }
  request->albedos = (const double *)(const void *)(payload + WIRE_BYTES_invert_request);
  request->lengths = request->albedos + count;
  return wire_error_none();
}

uint64_t invert_array_offset(enum invert_array array, uint64_t medium_count) {
  return WIRE_BYTES_invert_reply + array * medium_count * sizeof(double);
}

uint64_t invert_reply_bytes(uint64_t medium_count) {
  return invert_array_offset(INVERT_ARRAYS, medium_count);
}

uint64_t invert_part_media(uint64_t max_payload_bytes) {
  return max_payload_bytes > WIRE_BYTES_invert_reply
             ? (max_payload_bytes - WIRE_BYTES_invert_reply) / (INVERT_ARRAYS * sizeof(double))
             : 0;
}

bool invert_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_invert_reply *fixed) {
  if (payload_bytes < WIRE_BYTES_invert_reply) {
    return false;
  }
  wire_get_invert_reply(payload, fixed);
  const size_t medium_bytes = INVERT_ARRAYS * sizeof(double);
  const size_t media_bytes = payload_bytes - WIRE_BYTES_invert_reply;
  return fixed->part < fixed->part_count && media_bytes % medium_bytes == 0 &&
         media_bytes / medium_bytes == fixed->count &&
         fixed->missing_count <= fixed->count;
}
