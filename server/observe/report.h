/* report: all numbers that the daemon reports of itself, with their names, for the statistics reply
 * and for the metrics. */
#ifndef DIPOLED_REPORT_H
#define DIPOLED_REPORT_H

#include <stdbool.h>
#include <stdint.h>

struct server;

/* The types of metrics that Prometheus knows. */
enum report_type { REPORT_COUNTER, REPORT_GAUGE, REPORT_SUMMARY, REPORT_HISTOGRAM };

/* What several values have in common. They are reported one after the other. */
struct report_family {
  const char *name; /* of the metric, without the prefix dipoled_ and the _total of counters */
  enum report_type type;
  const char *help;
};

/* One number. Its texts are valid during the call of each(). */
struct report_value {
  const char *name; /* in the statistics; NULL: only the metrics have this value */
  const struct report_family *family;
  const char *suffix; /* of the metric's name: "", "_total", "_bucket", "_sum" or "_count" */
  const char *labels; /* `key="value",...`; "" if there are none */
  bool is_ns;         /* it is a duration in ns: us in the statistics, seconds in the metrics */
  uint64_t value;
};

/* Calls each() for every value, always in the same order. Any thread may call this once the workers
 * have started. With NULL for the server, all values are 0, for callers that need the names. */
void report_each(const struct server *server,
                 void (*each)(void *context, const struct report_value *value), void *context);

/* The value in the unit of the statistics. */
uint64_t report_wire_value(const struct report_value *value);

#endif
