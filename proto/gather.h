/* gather: encodes and decodes the payloads of the messages points, which sends a set of points in
 * parts, and gather, which sums the light that they leave at other positions (core/gather/gather.h).
 *
 * A set of points is two arrays: double[point_count][3], x, y and z in mm; and
 * float[point_count][channel_count], a power in W for each channel. Its name is the hash of its
 * content, so that it is the same everywhere.
 */
#ifndef DIPOLED_PROTO_GATHER_H
#define DIPOLED_PROTO_GATHER_H

#include "core/gather/gather.h"
#include "proto/digest.h"
#include "proto/schema.h"

enum { GATHER_AXES = 3 }; /* x, y, z */

/* The most queries of one request. */
#define GATHER_QUERIES_MAX 16777216

/* The most queries of one part of a reply. */
enum { GATHER_PART_QUERIES = 16384 };

/* The name of a set, while its content is added. */
typedef struct gather_name {
  uint64_t counts[2]; /* channels, points */
  digest_state xyz;
  digest_state power;
} gather_name;

void gather_name_start(gather_name *name, uint32_t channel_count, uint64_t point_count);

/* Adds the next n points. */
void gather_name_add(gather_name *name, uint64_t n, const double *xyz, const float *power);

/* Sets set[2] to the name, when all points have been added: the hash (proto/digest.h) of the counts,
 * of the hash of all coordinates and of the hash of all powers, one after the other. */
void gather_name_end(gather_name *name, uint64_t set[2]);

/* ---- points ---------------------------------------------------------------------------------- */

/* A parsed points request. The arrays point into the payload. */
typedef struct points_request {
  wire_points_request fixed;
  const double *xyz;  /* [fixed.part_points][GATHER_AXES] */
  const float *power; /* [fixed.part_points][fixed.channel_count] */
} points_request;

/* Parses a payload: schema_check(), and the counts. core_gather_check_points() checks the values. */
wire_error points_request_parse(const uint8_t *payload, const schema_layout *layout,
                                points_request *request);

/* Parses the payload of a reply. Returns false if it has another length. */
bool points_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_points_reply *fixed);

/* ---- gather ---------------------------------------------------------------------------------- */

/* A parsed gather request. Its media and queries point into the payload. */
typedef struct gather_request {
  wire_gather_request fixed;
  core_parameters parameters;
  const core_medium *media; /* [fixed.medium_count][fixed.layer_count] */
  const double *queries;    /* [fixed.query_count][GATHER_AXES], mm */
} gather_request;

/* Parses a payload: schema_check(), and the parameters. Core checks the values. */
wire_error gather_request_parse(const uint8_t *payload, const schema_layout *layout,
                                gather_request *request);

/* Layout of a reply's payload: the fixed part, a channel structure for each channel, then the sums,
 * double[query_count][channel_count], W/mm^2. The offset counts from the payload's start. */
uint64_t gather_reply_bytes(uint32_t channel_count, uint64_t query_count);
size_t gather_sums_offset(uint32_t channel_count);

#endif
