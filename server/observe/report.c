#include "server/observe/report.h"

#include <stdio.h>

#include "server/observe/latency.h"
#include "server/observe/log.h"
#include "server/server.h"

/* The function that gets the values, and their source. */
struct reporter {
  const struct server *server; /* NULL: all values are 0 */
  void (*each)(void *context, const struct report_value *value);
  void *context;
};

uint64_t report_wire_value(const struct report_value *value) {
  return value->is_ns ? (value->value + 500) / 1000 : value->value;
}

static uint64_t counted(const struct reporter *to, unsigned index) {
  return to->server != NULL ? stats_get(&to->server->stats, (enum stats_index)index) : 0;
}

static uint64_t counted_in(const struct reporter *to, unsigned first, unsigned end) {
  uint64_t sum = 0;
  for (unsigned i = first; i < end; i++) {
    sum += counted(to, i);
  }
  return sum;
}

static void report(const struct reporter *to, const char *name, const struct report_family *family,
                   const char *suffix, const char *labels, uint64_t value) {
  to->each(to->context, &(struct report_value){name, family, suffix, labels, false, value});
}

/* ---- single values: server/observe/stats.def ------------------------------------------------- */

static void report_list(const struct reporter *to) {
  const struct server *server = to->server;
#define REPORT(name, type, help, value)                                                            \
  {                                                                                                \
    static const struct report_family family = {name, REPORT_##type, help};                        \
    report(to, name, &family, REPORT_##type == REPORT_COUNTER ? "_total" : "", "", value);         \
  }
#define SERVER_STATISTIC(IDENT, name, type, help)                                                  \
  REPORT(name, type, help, counted(to, STATS_##IDENT))
#define SERVER_COMPUTED(name, type, value, help)                                                   \
  REPORT(name, type, help, server != NULL ? (value) : 0)
#include "server/observe/stats.def"
}

/* ---- families: values by message, status and model ------------------------------------------- */

static void report_requests(const struct reporter *to) {
  static const struct report_family family = {"requests", REPORT_COUNTER,
                                              "requests received, by message"};
#define WIRE_MESSAGE(type, IDENT, name, ...)                                                       \
  report(to, "requests_" name, &family, "_total", "message=\"" name "\"",                          \
         counted(to, STATS_REQUESTS_##IDENT));
#include "proto/messages.def"
}

static void report_replies(const struct reporter *to) {
  static const struct report_family family = {"replies", REPORT_COUNTER,
                                              "replies, by status; ok or an error"};
#define WIRE_STATUS(code, IDENT, modbus_exception, http, scpi, name, text)                         \
  report(to, "replies_" name, &family, "_total", "status=\"" name "\"",                            \
         counted(to, STATS_REPLIES_##IDENT));
#include "proto/statuses.def"
#undef WIRE_STATUS
}

static void report_models(const struct reporter *to) {
  static const struct report_family family = {"model_radii", REPORT_COUNTER,
                                              "radii evaluated, by model, once for each channel"};
#define REPORT_RADII(id, IDENT, name, ...)                                                         \
  report(to, "radii_" name, &family, "_total", "model=\"" name "\"",                               \
         counted(to, STATS_RADII_##IDENT));
  CORE_EACH_MODEL(REPORT_RADII, REPORT_RADII)
}

/* ---- latencies ------------------------------------------------------------------------------- */

static void report_ns(const struct reporter *to, const char *name,
                      const struct report_family *family, const char *suffix, const char *labels,
                      uint64_t ns) {
  to->each(to->context, &(struct report_value){name, family, suffix, labels, true, ns});
}

/* Returns the latencies of one class of requests, summed over all workers. */
static struct histogram_sum sum_of(const struct reporter *to, enum latency_class kind) {
  struct histogram_sum sum = {.count = 0};
  for (uint64_t i = 0; to->server != NULL && i < server_worker_count(to->server); i++) {
    histogram_merge(&sum, &to->server->latencies[i].histograms[kind]);
  }
  return sum;
}

/* The upper ends of the buckets in the metrics: powers of 2 in ns, from 4.1 us to 68.7 s. */
enum { OCTAVE_FIRST = 12, OCTAVE_LAST = 36 };

/* Reports a class as a histogram of Prometheus. Histograms of several daemons can be added, and
 * give quantiles over any time. */
static void report_histogram(const struct reporter *to, const char *kind, const char *sum_name,
                             const char *count_name, const struct histogram_sum *sum) {
  static const struct report_family family = {
      "latency_seconds", REPORT_HISTOGRAM,
      "from a request's last byte to its reply, by class of request"};
  char labels[80];
  for (unsigned octave = OCTAVE_FIRST; octave <= OCTAVE_LAST; octave++) {
    snprintf(labels, sizeof labels, "class=\"%s\",le=\"%.9f\"", kind,
             (double)(UINT64_C(1) << octave) / 1e9);
    report(to, NULL, &family, "_bucket", labels, histogram_below(sum, octave));
  }
  snprintf(labels, sizeof labels, "class=\"%s\",le=\"+Inf\"", kind);
  report(to, NULL, &family, "_bucket", labels, sum->count);
  snprintf(labels, sizeof labels, "class=\"%s\"", kind);
  report_ns(to, sum_name, &family, "_sum", labels, sum->sum_ns);
  report(to, count_name, &family, "_count", labels, sum->count);
}

static void report_latencies(const struct reporter *to) {
  static const struct report_family quantiles = {"", REPORT_NO_METRIC, ""};
  struct histogram_sum sum;
#define QUANTILE(class, what, share)                                                               \
  report_ns(to, "latency_" class "_" what "_us", &quantiles, "", "",                               \
            histogram_quantile_ns(&sum, share));
#define LATENCY_CLASS(IDENT, name, about)                                                          \
  sum = sum_of(to, LATENCY_##IDENT);                                                               \
  QUANTILE(name, "p50", 0.5)                                                                       \
  QUANTILE(name, "p90", 0.9)                                                                       \
  QUANTILE(name, "p99", 0.99)                                                                      \
  QUANTILE(name, "p999", 0.999)                                                                    \
  report_ns(to, "latency_" name "_max_us", &quantiles, "", "", sum.most_ns);                       \
  report_histogram(to, name, "latency_" name "_sum_us", "latency_" name "_count", &sum);
#include "server/observe/stats.def"
}

/* ---- public ---------------------------------------------------------------------------------- */

void report_each(const struct server *server,
                 void (*each)(void *context, const struct report_value *value), void *context) {
  const struct reporter to = {server, each, context};
  report_list(&to);
  report_requests(&to);
  report_replies(&to);
  report_models(&to);
  report_latencies(&to);
}
