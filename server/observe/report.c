#include "server/observe/report.h"

#include <stdio.h>

#include "server/observe/latency.h"
#include "server/server.h"

/* Whom the values go to. */
struct reporter {
  const struct server *server; /* NULL: without values */
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

/* ---- server/observe/stats.def ------------------------------------------------------------------------- */

static uint64_t computed_UPTIME_MS(const struct reporter *to) {
  return (uv_hrtime() - to->server->started_ns) / 1000000;
}

static uint64_t computed_BUFFER_BYTES(const struct reporter *to) {
  return atomic_load(&to->server->buffer_bytes);
}

static uint64_t computed_RADII_EVALUATED(const struct reporter *to) {
  return counted_in(to, STATS_RADII, STATS_BATCHES);
}

static uint64_t computed_BATCHES_EVALUATED(const struct reporter *to) {
  return counted_in(to, STATS_BATCHES, STATS_COUNT);
}

static void report_plain(const struct reporter *to, const char *name,
                         const struct report_family *family, uint64_t value) {
  const struct report_value plain = {
      .name = name,
      .family = family,
      .suffix = family->type == REPORT_COUNTER ? "_total" : "",
      .labels = "",
      .value = value,
  };
  to->each(to->context, &plain);
}

static void report_list(const struct reporter *to) {
#define SERVER_STATISTIC(IDENT, name, type, help)                                                  \
  {                                                                                                \
    static const struct report_family family = {name, REPORT_##type, help};                        \
    report_plain(to, name, &family, counted(to, STATS_##IDENT));                                   \
  }
#define SERVER_COMPUTED(IDENT, name, type, help)                                                   \
  {                                                                                                \
    static const struct report_family family = {name, REPORT_##type, help};                        \
    report_plain(to, name, &family, to->server != NULL ? computed_##IDENT(to) : 0);                \
  }
#include "server/observe/stats.def"
}

/* ---- other lists ------------------------------------------------------------------------------ */

/* `prefix` and the member's name in the statistics; with a label, among the metrics. */
static void report_member(const struct reporter *to, const struct report_family *family,
                          const char *prefix, const char *label, const char *member,
                          unsigned index) {
  char name[96];
  char labels[96];
  snprintf(name, sizeof name, "%s%s", prefix, member);
  snprintf(labels, sizeof labels, "%s=\"%s\"", label, member);
  const struct report_value value = {
      .name = name,
      .family = family,
      .suffix = "_total",
      .labels = labels,
      .value = counted(to, index),
  };
  to->each(to->context, &value);
}

static void report_requests(const struct reporter *to) {
  static const struct report_family family = {"requests", REPORT_COUNTER,
                                              "requests taken up, by message"};
#define WIRE_MESSAGE(type, IDENT, name)                                                            \
  report_member(to, &family, "requests_", "message", name, STATS_REQUESTS_##IDENT);
#include "proto/messages.def"
}

static void report_answers(const struct reporter *to) {
  static const struct report_family family = {"answers", REPORT_COUNTER,
                                              "requests answered, by status; ok or an error"};
#define WIRE_STATUS(code, IDENT, modbus_exception, name, text)                                     \
  report_member(to, &family, "answers_", "status", name, STATS_ANSWERS_##IDENT);
#include "proto/statuses.def"
#undef WIRE_STATUS
}

static void report_models(const struct reporter *to) {
  static const struct report_family family = {"model_radii", REPORT_COUNTER,
                                              "radii evaluated, by model, once for each channel"};
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                 \
  report_member(to, &family, "radii_", "model", name, STATS_RADII_##IDENT);
#define CORE_SUM(id, IDENT, name, FIRST, SECOND, source)                                           \
  report_member(to, &family, "radii_", "model", name, STATS_RADII_##IDENT);
#include "core/models.def"
}

/* ---- batch sizes ------------------------------------------------------------------------------ */

/* A histogram as Prometheus has them: cumulative, with sum and count. */
static void report_batches(const struct reporter *to) {
  static const struct report_family family = {"batch_requests", REPORT_HISTOGRAM,
                                              "arrays of short evals in one pass of a kernel"};
  uint64_t count = 0;
  for (unsigned size = 0; size + 1 < STATS_BATCH_SIZES; size++) {
    char name[48];
    char labels[48];
    snprintf(name, sizeof name, "batches_up_to_%u_requests", 1U << size);
    snprintf(labels, sizeof labels, "le=\"%u\"", 1U << size);
    count += counted(to, STATS_BATCHES + size);
    to->each(to->context, &(struct report_value){name, &family, "_bucket", labels, .value = count});
  }
  count += counted(to, STATS_COUNT - 1);
  const uint64_t sum = counted(to, STATS_BATCHED_REQUESTS);
  to->each(to->context,
           &(struct report_value){NULL, &family, "_bucket", "le=\"+Inf\"", .value = count});
  to->each(to->context, &(struct report_value){NULL, &family, "_sum", "", .value = sum});
  to->each(to->context, &(struct report_value){NULL, &family, "_count", "", .value = count});
}

/* ---- latencies -------------------------------------------------------------------------------- */

static void report_duration(const struct reporter *to, const struct report_family *family,
                            const char *kind, const char *what, const char *suffix,
                            const char *quantile, uint64_t ns) {
  char name[64];
  char labels[64];
  snprintf(name, sizeof name, "latency_%s_%s", kind, what);
  snprintf(labels, sizeof labels, "class=\"%s\"%s", kind, quantile);
  to->each(to->context, &(struct report_value){name, family, suffix, labels, true, ns});
}

static void merge(const struct reporter *to, enum latency_class kind, struct histogram_sum *sum) {
  *sum = (struct histogram_sum){.count = 0};
  for (uint64_t i = 0; to->server != NULL && i < to->server->options.workers; i++) {
    histogram_merge(sum, &to->server->latencies[i].histograms[kind]);
  }
}

/* *most_ns: the longest of all. */
static void report_latency(const struct reporter *to, enum latency_class kind, const char *name,
                           uint64_t *most_ns) {
  static const struct report_family family = {
      "latency_seconds", REPORT_SUMMARY,
      "from a request's last byte to its answer, since the start, by class of request"};
  static const struct {
    double share;
    const char *what;
    const char *quantile;
  } quantiles[] = {
      {0.5, "p50_us", ",quantile=\"0.5\""},
      {0.9, "p90_us", ",quantile=\"0.9\""},
      {0.99, "p99_us", ",quantile=\"0.99\""},
      {0.999, "p999_us", ",quantile=\"0.999\""},
  };
  struct histogram_sum sum;
  merge(to, kind, &sum);
  for (size_t i = 0; i < sizeof quantiles / sizeof quantiles[0]; i++) {
    report_duration(to, &family, name, quantiles[i].what, "", quantiles[i].quantile,
                    histogram_quantile_ns(&sum, quantiles[i].share));
  }
  report_duration(to, &family, name, "sum_us", "_sum", "", sum.sum_ns);
  char count_name[64];
  char labels[64];
  snprintf(count_name, sizeof count_name, "latency_%s_count", name);
  snprintf(labels, sizeof labels, "class=\"%s\"", name);
  to->each(to->context,
           &(struct report_value){count_name, &family, "_count", labels, .value = sum.count});
  *most_ns = sum.most_ns;
}

static void report_latencies(const struct reporter *to) {
  static const struct report_family family = {"latency_max_seconds", REPORT_GAUGE,
                                              "the longest latency since the start"};
  uint64_t most_ns[LATENCY_CLASSES];
#define LATENCY_CLASS(IDENT, name, about)                                                          \
  report_latency(to, LATENCY_##IDENT, name, &most_ns[LATENCY_##IDENT]);
#include "server/observe/latency.def"
#undef LATENCY_CLASS
#define LATENCY_CLASS(IDENT, name, about)                                                          \
  report_duration(to, &family, name, "max_us", "", "", most_ns[LATENCY_##IDENT]);
#include "server/observe/latency.def"
#undef LATENCY_CLASS
}

/* ---- public ----------------------------------------------------------------------------------- */

void report_each(const struct server *server,
                 void (*each)(void *context, const struct report_value *value), void *context) {
  const struct reporter to = {server, each, context};
  report_list(&to);
  report_requests(&to);
  report_answers(&to);
  report_models(&to);
  report_batches(&to);
  report_latencies(&to);
}
