#include "clients/cli/top_write.h"

#include <string.h>

#include "clients/cli/cli.h"
#include "clients/cli/csv.h"
#include "clients/cli/json.h"
#include "clients/cli/number.h"
#include "clients/cli/table.h"

/* ---- for people ------------------------------------------------------------------------------- */

/* 950, 12.3 k, 4.56 M: three figures; a count has no part of one. */
static void add_figures(cli_table *table, double value, bool is_count) {
  static const char *const units[] = {"", " k", " M", " G", " T", " P"};
  size_t unit = 0;
  while (value >= 999.5 && unit + 1 < sizeof units / sizeof units[0]) {
    value /= 1000;
    unit++;
  }
  const bool is_whole = value >= 99.95 || value <= 0 || (is_count && unit == 0);
  cli_table_add(table, "%.*f%s", is_whole ? 0 : value >= 9.995 ? 1 : 2, value, units[unit]);
}

static void add_rate(cli_table *table, double value) {
  add_figures(table, value, false);
}

static void add_count(cli_table *table, uint64_t value) {
  add_figures(table, (double)value, true);
}

static void write_title(const dipole_info *info, const top_record *record, FILE *file) {
  const uint64_t up_s = top_value(record, "uptime_ms") / 1000;
  fprintf(file, "%s at %s: up %llu:%02u:%02u, %u workers, %s\n", info->software, info->address,
          (unsigned long long)(up_s / 3600), (unsigned)(up_s / 60 % 60), (unsigned)(up_s % 60),
          info->workers, info->instruction_set);
  if (record->before.count > 0) {
    fprintf(file, "Each second, over the last %.1f s\n\n", record->interval_s);
  } else {
    fputs("Each second, since its start\n\n", file);
  }
}

static void write_rates(const top_record *record, FILE *file) {
  static const char *const heads[] = {"requests", "radii",  "MB in",      "MB out",
                                      "batch",    "errors", "cache hits", "misses"};
  cli_table table = {.columns = sizeof heads / sizeof heads[0], .heads = 1};
  for (size_t i = 0; i < table.columns; i++) {
    cli_table_add(&table, "%s", heads[i]);
  }
  add_rate(&table, top_requests_rate(record));
  add_rate(&table, top_rate(record, "radii_evaluated"));
  cli_table_add(&table, "%.2f", top_rate(record, "received_bytes") / 1e6);
  cli_table_add(&table, "%.2f", top_rate(record, "sent_bytes") / 1e6);
  cli_table_add(&table, "%.1f", top_batch_mean(record));
  add_rate(&table, top_errors_rate(record));
  add_rate(&table, top_rate(record, "cache_hits"));
  add_rate(&table, top_rate(record, "cache_misses"));
  cli_table_print(&table, file);
}

static void write_gauges(const top_record *record, FILE *file) {
  static const char *const gauges[][2] = {
      {"connections_open", "connections"}, {"queued_connections", "queued"},
      {"owed_radii", "radii owed"},        {"mc_jobs_open", "mc jobs"},
      {"cache_entries", "profiles"},       {"cache_bytes", "their bytes"},
      {"buffer_bytes", "buffer bytes"},
  };
  cli_table table = {.columns = sizeof gauges / sizeof gauges[0], .heads = 1};
  for (size_t i = 0; i < table.columns; i++) {
    cli_table_add(&table, "%s", gauges[i][1]);
  }
  for (size_t i = 0; i < table.columns; i++) {
    add_count(&table, top_value(record, gauges[i][0]));
  }
  fputs("\nNow\n", file);
  cli_table_print(&table, file);
}

static const char *const latency_columns[] = {"p50_us", "p90_us", "p99_us", "p999_us", "max_us"};
enum { LATENCY_COLUMNS = sizeof latency_columns / sizeof latency_columns[0] };

static void write_latencies(const top_record *record, FILE *file) {
  static const char *const heads[] = {
      "us, since its start", "p50", "p90", "p99", "p99.9", "max", "requests"};
  cli_table table = {.columns = LATENCY_COLUMNS + 2, .left = 1, .heads = 1};
  for (size_t i = 0; i < table.columns; i++) {
    cli_table_add(&table, "%s", heads[i]);
  }
  char kind[64];
  for (size_t from = 0; top_next_latency(record, &from, kind, sizeof kind);) {
    cli_table_add(&table, "%s", kind);
    for (size_t i = 0; i < LATENCY_COLUMNS; i++) {
      cli_table_add(&table, "%llu",
                    (unsigned long long)top_latency(record, kind, latency_columns[i]));
    }
    add_count(&table, top_latency(record, kind, "count"));
  }
  fputs("\n", file);
  cli_table_print(&table, file);
}

/* The next one of a prefix that rose, and is not `but`. */
static bool next_active(const top_record *record, const char *prefix, const char *but, size_t *from,
                        const char **rest, double *rate) {
  while (top_next(record, prefix, from, rest)) {
    *rate = top_rate(record, record->now.values[*from - 1].name);
    if (*rate > 0 && strcmp(*rest, but) != 0) {
      return true;
    }
  }
  return false;
}

static void write_active(const top_record *record, const char *prefix, const char *but,
                         const char *head, FILE *file) {
  cli_table table = {.columns = 2, .left = 1, .heads = 1};
  const char *rest;
  double rate;
  size_t first = 0;
  if (!next_active(record, prefix, but, &first, &rest, &rate)) {
    return;
  }
  cli_table_add(&table, "%s", head);
  cli_table_add(&table, "each second");
  for (size_t from = 0; next_active(record, prefix, but, &from, &rest, &rate);) {
    cli_table_add(&table, "%s", rest);
    add_rate(&table, rate);
  }
  fputs("\n", file);
  cli_table_print(&table, file);
}

void top_write_table(const dipole_info *info, const top_record *record, FILE *file) {
  write_title(info, record, file);
  write_rates(record, file);
  write_gauges(record, file);
  write_latencies(record, file);
  write_active(record, "radii_", "evaluated", "radii of model", file);
  write_active(record, "answers_", "ok", "errors", file);
}

/* ---- for programs ----------------------------------------------------------------------------- */

/* Calls each() for every name and value of a record: always the same names from the same daemon. */
typedef void each_value(void *context, const char *name, double value);

static void each_rate(const top_record *record, const char *prefix, each_value *each,
                      void *context) {
  const char *rest;
  for (size_t from = 0; top_next(record, prefix, &from, &rest);) {
    char name[96];
    const char *statistic = record->now.values[from - 1].name;
    snprintf(name, sizeof name, "%s_per_s", statistic);
    each(context, name, top_rate(record, statistic));
  }
}

static void each_latency(const top_record *record, each_value *each, void *context) {
  char kind[64];
  for (size_t from = 0; top_next_latency(record, &from, kind, sizeof kind);) {
    for (size_t i = 0; i < LATENCY_COLUMNS; i++) {
      char name[96];
      snprintf(name, sizeof name, "latency_%s_%s", kind, latency_columns[i]);
      each(context, name, (double)top_value(record, name));
    }
  }
}

static void each_in(const top_record *record, each_value *each, void *context) {
  static const char *const rates[] = {"received_bytes", "sent_bytes", "cache_hits", "cache_misses"};
  static const char *const gauges[] = {"uptime_ms",   "connections_open", "queued_connections",
                                       "owed_radii",  "buffer_bytes",     "cache_entries",
                                       "cache_bytes", "mc_jobs_open"};
  each(context, "interval_s", record->interval_s);
  for (size_t i = 0; i < sizeof gauges / sizeof gauges[0]; i++) {
    each(context, gauges[i], (double)top_value(record, gauges[i]));
  }
  each(context, "requests_per_s", top_requests_rate(record));
  each(context, "errors_per_s", top_errors_rate(record));
  each(context, "requests_per_batch", top_batch_mean(record));
  for (size_t i = 0; i < sizeof rates / sizeof rates[0]; i++) {
    each_rate(record, rates[i], each, context);
  }
  each_rate(record, "radii_", each, context);
  each_rate(record, "requests_", each, context);
  each_rate(record, "answers_", each, context);
  each_latency(record, each, context);
}

typedef struct csv_line {
  FILE *file;
  bool names; /* rather than values */
  bool filled;
} csv_line;

static void write_cell(void *context, const char *name, double value) {
  csv_line *line = context;
  char text[CLI_NUMBER_BYTES];
  fputs(line->filled ? "," : "", line->file);
  line->filled = true;
  if (line->names) {
    cli_csv_write_cell(name, line->file);
  } else {
    cli_number_format(value, text);
    fputs(text, line->file);
  }
}

void top_write_csv(const top_record *record, bool first, FILE *file) {
  if (first) {
    csv_line names = {file, true, false};
    each_in(record, write_cell, &names);
    fputc('\n', file);
  }
  csv_line values = {file, false, false};
  each_in(record, write_cell, &values);
  fputc('\n', file);
}

static void write_pair(void *context, const char *name, double value) {
  cli_json_number(context, name, value);
}

void top_write_json(const top_record *record, FILE *file) {
  cli_json json = {.file = file, .one_line = true};
  cli_json_begin(&json, NULL, '{');
  each_in(record, write_pair, &json);
  cli_json_end(&json, '}');
}
