/* report: all that the daemon tells of itself, as numbers with names: for the statistics reply and
 * for the metrics. */
#ifndef DIPOLED_REPORT_H
#define DIPOLED_REPORT_H

#include <stdbool.h>
#include <stdint.h>

struct server;

/* The types of Prometheus' text format. */
enum report_type { REPORT_COUNTER, REPORT_GAUGE, REPORT_SUMMARY, REPORT_HISTOGRAM };

/* Values of one kind, which follow each other. */
struct report_family {
  const char *name; /* of the metric, after dipoled_; without the _total that counters end with */
  enum report_type type;
  const char *help;
};

/* Texts stay as long as the call. */
struct report_value {
  const char *name; /* in the statistics; NULL: it is not among them */
  const struct report_family *family;
  const char *suffix; /* of the metric's name: "", "_total", "_bucket", "_sum" or "_count" */
  const char *labels; /* `key="value",...`; "": none */
  bool is_ns;         /* a duration, that the statistics have in us, the metrics in seconds */
  uint64_t value;
};

/* Calls each() for every value, always in the same order. Any thread, once the workers have
 * started. NULL: for the names alone, without values. */
void report_each(const struct server *server,
                 void (*each)(void *context, const struct report_value *value), void *context);

/* The value in the unit that the statistics have. */
uint64_t report_wire_value(const struct report_value *value);

#endif
