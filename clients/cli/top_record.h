/* top_record: what happened in a daemon between two looks at its statistics. */
#ifndef DIPOLE_CLI_TOP_RECORD_H
#define DIPOLE_CLI_TOP_RECORD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "clients/c/dipole.h"

/* One look. Starts all 0, which is how a daemon starts. */
typedef struct top_look {
  dipole_value *values; /* to be freed */
  size_t count;
  double at_s; /* of a clock that does not jump */
} top_look;

typedef struct top_record {
  top_look before;
  top_look now;
  double interval_s;
} top_record;

/* A statistic now, and what it has risen by each second; 0: the daemon has none such. */
uint64_t top_value(const top_record *record, const char *name);
double top_rate(const top_record *record, const char *name);

/* Requests of all messages, and errors of all kinds, each second. */
double top_requests_rate(const top_record *record);
double top_errors_rate(const top_record *record);

/* Requests evaluated in one pass, on average over the interval; 0: none were. */
double top_batch_mean(const top_record *record);

/* The statistics that begin with a prefix, one after the other: the next one's position from *from
 * on, which then follows it. False: there is no more. *rest: its name after the prefix. */
bool top_next(const top_record *record, const char *prefix, size_t *from, const char **rest);

/* Where latencies are told, from *from on: the class in *kind. False: there is no more. */
bool top_next_latency(const top_record *record, size_t *from, char *kind, size_t bytes);

/* Of such a class: `what` is p50_us, p90_us, p99_us, p999_us, max_us or count. */
uint64_t top_latency(const top_record *record, const char *kind, const char *what);

#endif
