/* bench_load: puts a load on a daemon, and measures how fast it answers. */
#ifndef DIPOLE_CLI_BENCH_LOAD_H
#define DIPOLE_CLI_BENCH_LOAD_H

#include "clients/cli/cli.h"

/* Counts durations in buckets of a 64th of an octave, so that a quantile is exact within 1 %. */
enum { BENCH_OCTAVE = 64, BENCH_BUCKETS = 48 * BENCH_OCTAVE };
typedef struct bench_times {
  uint64_t count;
  uint64_t most_ns;
  uint32_t buckets[BENCH_BUCKETS];
} bench_times;

/* Returns the duration, in us, that this share of the durations did not exceed. Returns 0 if
 * nothing was counted. */
double bench_times_quantile_us(const bench_times *times, double share);

/* The load that bench_run() puts on a daemon. */
typedef struct bench_load {
  const char *name;
  const char *about;
  unsigned connections;
  unsigned in_flight; /* requests under way on each connection */
  uint64_t radii;     /* how many radii each request has */
  double seconds;
} bench_load;

/* What was measured under a load. */
typedef struct bench_result {
  bench_load load;
  bench_times times;  /* how long each request took, from submitting it to having its answer */
  double took_s;      /* from the first request to the last answer */
  double value_bytes; /* size of a radius and of a value */
  double values_per_radius;
} bench_result;

double bench_requests_per_s(const bench_result *result);
double bench_radii_per_s(const bench_result *result); /* counts the radii of each channel */
double bench_bytes_per_s(const bench_result *result); /* of radii and values together */

/* Asks the query in this way, with as many of its radii as the load says. The first connection is
 * the client's own. Calls show() with the share that is done, 0 to 1, and the number of requests,
 * every 50 ms. Returns false, with *error, if a request failed. */
bool bench_run(dipole_client *client, const cli_common *common, const dipole_query *query,
               const bench_load *load, void (*show)(void *context, double share, uint64_t requests),
               void *context, bench_result *result, dipole_error *error);

#endif
