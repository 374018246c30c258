/* report: all numbers that the daemon reports about itself, with their names, for the statistics
 * reply and for the metrics. */
#ifndef DIPOLED_REPORT_H
#define DIPOLED_REPORT_H

#include <stdbool.h>
#include <stdint.h>

struct server;

/* The types of metrics that Prometheus knows. */
enum report_type {
  REPORT_COUNTER,
  REPORT_GAUGE,
  REPORT_HISTOGRAM,
  REPORT_NO_METRIC, /* for values of the statistics only */
};

/* The properties that several values share. The values of a family are reported in a row. */
struct report_family {
  const char *name; /* of the metric, without the prefix dipoled_ and the _total of counters */
  enum report_type type;
  const char *help;
};

/* One number of the report. Its texts are valid during the call of each(). */
struct report_value {
  const char *name; /* name in the statistics; NULL: only the metrics have this value */
  const struct report_family *family;
  const char *suffix; /* of the metric's name: "", "_total", "_bucket", "_sum" or "_count" */
  const char *labels; /* `key="value",...`; "" if there are none */
  bool is_ns;         /* whether it is in ns: the statistics state us, and the metrics seconds */
  uint64_t value;
};

/* Calls each() for every value, always in the same order. Any thread may call this once the workers
 * have started. If server is NULL, all values are 0: use this to get the names. */
void report_each(const struct server *server,
                 void (*each)(void *context, const struct report_value *value), void *context);

/* Returns the value in the unit of the statistics. */
uint64_t report_wire_value(const struct report_value *value);

#endif
