#include "proto/gather.h"

#include "proto/channels.h"

/* Arrays are used in place, so this machine must be little-endian like the protocol. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's arrays need swapping");
_Static_assert(sizeof(core_medium) == WIRE_BYTES_medium, "one medium after the other");

static wire_error bad_count(const char *field, const char *allowed) {
  return wire_error_make(WIRE_STATUS_BAD_COUNT, field, allowed);
}

static wire_error bad_value(const char *field, const char *allowed) {
  return wire_error_make(WIRE_STATUS_BAD_VALUE, field, allowed);
}

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

uint64_t points_request_bytes(uint32_t channel_count, uint64_t part_points) {
  return WIRE_BYTES_points_request + part_points * GATHER_AXES * sizeof(double) +
         wire_padded(part_points * channel_count * sizeof(float));
}

wire_error points_request_parse(const uint8_t *payload, size_t payload_bytes,
                                points_request *request) {
  wire_points_request *fixed = &request->fixed;
  if (payload_bytes < WIRE_BYTES_points_request) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes",
                           "at least 48: a points_request");
  }
  wire_get_points_request(payload, fixed);
  if (fixed->channel_count < 1 || fixed->channel_count > CORE_GATHER_CHANNELS_MAX) {
    return bad_count("channel_count", "1 to 8");
  }
  if (fixed->zero != 0) {
    return bad_value("zero", "0");
  }
  if (fixed->point_count < 1) {
    return bad_count("point_count", "at least 1");
  }
  if (fixed->point_count > CORE_GATHER_POINTS_MAX) {
    return wire_error_make(WIRE_STATUS_TOO_LARGE, "point_count", "at most 16777216");
  }
  if (fixed->point_first > fixed->point_count) {
    return bad_count("point_first", "at most point_count");
  }
  if (fixed->part_points > fixed->point_count - fixed->point_first) {
    return bad_count("part_points", "no more points than the set has from point_first on");
  }
  if (payload_bytes != points_request_bytes(fixed->channel_count, fixed->part_points)) {
    return bad_count("part_points", "as many points as the payload holds");
  }
  const uint8_t *at = payload + WIRE_BYTES_points_request;
  request->xyz = (const double *)(const void *)at;
  at += fixed->part_points * GATHER_AXES * sizeof(double);
  request->power = (const float *)(const void *)at;
  at += fixed->part_points * fixed->channel_count * sizeof(float);
  for (; at < payload + payload_bytes; at++) {
    if (*at != 0) {
      return bad_value("power", "zero bytes of padding behind the last power");
    }
  }
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

uint64_t gather_request_bytes(uint32_t medium_count, uint32_t parameter_count,
                              uint64_t query_count) {
  return WIRE_BYTES_gather_request + (uint64_t)medium_count * WIRE_BYTES_medium +
         (uint64_t)parameter_count * WIRE_BYTES_parameter +
         query_count * GATHER_AXES * sizeof(double);
}

static wire_error check_gather(const wire_gather_request *fixed) {
  const wire_error error = channels_check(fixed->evaluator, fixed->moments);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  if (core_choice_by_id(core_models, fixed->model) == NULL) {
    return wire_error_not_in_list("model", core_models, "one of");
  }
  if (fixed->medium_count < 1 || fixed->medium_count > CORE_GATHER_CHANNELS_MAX) {
    return bad_count("medium_count", "1 to 8, as many as a point has powers");
  }
  if (fixed->query_count > GATHER_QUERIES_MAX) {
    return wire_error_make(WIRE_STATUS_TOO_LARGE, "query_count", "at most 16777216");
  }
  if (fixed->tolerance != 0 && !(fixed->tolerance >= CORE_GATHER_TOLERANCE_MIN &&
                                 fixed->tolerance <= CORE_GATHER_TOLERANCE_MAX)) {
    return bad_value("tolerance", "1e-9 to 0.5; or 0: each point is summed by itself");
  }
  return fixed->zero == 0 ? error : bad_value("zero", "0");
}

wire_error gather_request_parse(const uint8_t *payload, size_t payload_bytes,
                                gather_request *request) {
  wire_gather_request *fixed = &request->fixed;
  if (payload_bytes < WIRE_BYTES_gather_request) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes",
                           "at least 48: a gather_request");
  }
  wire_get_gather_request(payload, fixed);
  wire_error error = check_gather(fixed);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  const uint8_t *media;
  struct channels_cursor cursor = {payload + WIRE_BYTES_gather_request,
                                   payload_bytes - WIRE_BYTES_gather_request};
  error = channels_parse(&cursor, fixed->medium_count, fixed->parameter_count, &media,
                         &request->parameters);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  if (cursor.remaining != fixed->query_count * GATHER_AXES * sizeof(double)) {
    return bad_count("query_count", "as many positions as the payload holds after the parameters");
  }
  request->media = (const core_medium *)(const void *)media;
  request->queries = (const double *)(const void *)cursor.at;
  return wire_error_none();
}

size_t gather_sums_offset(uint32_t channel_count) {
  return WIRE_BYTES_gather_reply + (size_t)channel_count * WIRE_BYTES_quantity_error;
}

uint64_t gather_reply_bytes(uint32_t channel_count, uint64_t query_count) {
  return gather_sums_offset(channel_count) + channel_count * query_count * sizeof(double);
}

bool gather_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_gather_reply *fixed) {
  if (payload_bytes < WIRE_BYTES_gather_reply) {
    return false;
  }
  wire_get_gather_reply(payload, fixed);
  return fixed->channel_count >= 1 && fixed->channel_count <= CORE_GATHER_CHANNELS_MAX &&
         fixed->count <= GATHER_QUERIES_MAX && fixed->part < fixed->part_count &&
         payload_bytes == gather_reply_bytes(fixed->channel_count, fixed->count);
}
