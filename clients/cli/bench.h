/* bench: what `dipole bench` measures, and how it says so. */
#ifndef DIPOLE_CLI_BENCH_H
#define DIPOLE_CLI_BENCH_H

#include "clients/cli/cli.h"

enum { BENCH_CONNECTIONS_MAX = 256, BENCH_RADII_MAX = 1 << 22, BENCH_MEASUREMENTS = 3 };

/* Memory for the values under way, of all connections. */
#define BENCH_VALUES_MAX_BYTES ((size_t)1 << 30)

/* How often something took how long: in buckets of a 64th of an octave, so that a quantile is
 * within 1 %. */
enum { BENCH_OCTAVE = 64, BENCH_BUCKETS = 48 * BENCH_OCTAVE };
typedef struct bench_times {
  uint64_t count;
  uint64_t most_ns;
  uint32_t buckets[BENCH_BUCKETS];
} bench_times;

void bench_times_add(bench_times *times, uint64_t ns);
void bench_times_join(bench_times *times, const bench_times *more);

/* What a share of them did not exceed, in us; 0 when there are none. */
double bench_times_quantile_us(const bench_times *times, double share);

/* One way of asking. */
typedef struct bench_load {
  const char *name;
  const char *about;
  unsigned connections;
  unsigned in_flight; /* on each of them */
  uint64_t radii;     /* of each request */
  double seconds;
} bench_load;

/* What came of it. */
typedef struct bench_result {
  bench_load load;
  bench_times times;  /* from submitting to the answer in hand */
  double took_s;      /* from the first request to the last answer */
  double value_bytes; /* of a radius or value */
  double values_per_radius;
} bench_result;

double bench_requests_per_s(const bench_result *result);
double bench_radii_per_s(const bench_result *result); /* in all channels */
double bench_bytes_per_s(const bench_result *result); /* of radii that go and values that come */

/* Asks the query in this way, with as many of its radii as the load says. The first connection is
 * the client's own. Called again and again while it goes on: show(context, share done, requests).
 * False: *error says why. */
bool bench_run(dipole_client *client, const cli_common *common, const dipole_query *query,
               const bench_load *load, void (*show)(void *context, double share, uint64_t requests),
               void *context, bench_result *result, dipole_error *error);

/* All of it. */
typedef struct bench_report {
  const dipole_info *info;
  const dipole_choice *model, *evaluator;
  const char *medium; /* NULL: given by its coefficients */
  size_t channels;
  bench_result results[BENCH_MEASUREMENTS];
} bench_report;

void bench_write_table(const bench_report *report, FILE *file);
void bench_write_csv(const bench_report *report, FILE *file);
void bench_write_json(const bench_report *report, FILE *file);

#endif
