#include "clients/cli/top_write.h"

#include <string.h>

#include "clients/cli/rows.h"

/* ---- statistics ---------------------------------------------------------------------------- */

static uint64_t find(const top_look *look, const char *name) {
  for (size_t i = 0; i < look->count; i++) {
    if (strcmp(look->values[i].name, name) == 0) {
      return look->values[i].value;
    }
  }
  return 0;
}

uint64_t top_value(const top_record *record, const char *name) {
  return find(&record->now, name);
}

static uint64_t rise(const top_record *record, const char *name) {
  const uint64_t before = find(&record->before, name), now = find(&record->now, name);
  return now > before ? now - before : 0;
}

/* What a statistic has risen by each second. */
static double rate(const top_record *record, const char *name) {
  return record->interval_s > 0 ? (double)rise(record, name) / record->interval_s : 0;
}

/* Returns the name of the next statistic, from position *from on, that begins with a prefix, and
 * sets *from behind it; NULL if there is no more. */
static const char *next(const top_record *record, const char *prefix, size_t *from) {
  while (*from < record->now.count) {
    const char *name = record->now.values[(*from)++].name;
    if (strncmp(name, prefix, strlen(prefix)) == 0) {
      return name;
    }
  }
  return NULL;
}

/* The sum of the rates of all statistics with a prefix but one. */
static double sum_of_rates(const top_record *record, const char *prefix, const char *but) {
  double sum = 0;
  const char *name;
  for (size_t from = 0; (name = next(record, prefix, &from)) != NULL;) {
    sum += strcmp(name, but) == 0 ? 0 : rate(record, name);
  }
  return sum;
}

static double requests_rate(const top_record *record) {
  return sum_of_rates(record, "requests_", "");
}

static double errors_rate(const top_record *record) {
  return sum_of_rates(record, "answers_", "answers_ok");
}

/* How many requests were evaluated in one pass, on average over the interval; 0 if none were. */
static double batch_mean(const top_record *record) {
  const uint64_t batches = rise(record, "batches_evaluated");
  return batches > 0 ? (double)rise(record, "batched_requests") / (double)batches : 0;
}

/* The quantiles of latencies that are written: as statistics call them, and for people. */
static const char *const latencies[][2] = {{"p50_us", "p50"},
                                           {"p90_us", "p90"},
                                           {"p99_us", "p99"},
                                           {"p999_us", "p99.9"},
                                           {"max_us", "max"}};
enum { LATENCIES = sizeof latencies / sizeof latencies[0] };

/* Sets `kind` to the next class of requests whose latencies are known. Returns false if there is no
 * more. */
static bool next_latency(const top_record *record, size_t *from, char *kind, size_t bytes) {
  static const char prefix[] = "latency_", suffix[] = "_count";
  const char *name;
  while ((name = next(record, prefix, from)) != NULL) {
    const char *rest = name + strlen(prefix);
    const size_t length = strlen(rest);
    if (length > strlen(suffix) && strcmp(rest + length - strlen(suffix), suffix) == 0) {
      snprintf(kind, bytes, "%.*s", (int)(length - strlen(suffix)), rest);
      return true;
    }
  }
  return false;
}

static uint64_t latency(const top_record *record, const char *kind, const char *what) {
  char name[96];
  snprintf(name, sizeof name, "latency_%s_%s", kind, what);
  return top_value(record, name);
}

/* ---- for people ---------------------------------------------------------------------------- */

/* Puts 950, 12.3 k or 4.56 M: three figures; a count has no part of one. */
static void put_figures(cli_rows *rows, const char *head, double value, bool is_count) {
  static const char *const units[] = {"", " k", " M", " G", " T", " P"};
  char text[32];
  size_t unit = 0;
  while (value >= 999.5 && unit + 1 < sizeof units / sizeof units[0]) {
    value /= 1000;
    unit++;
  }
  const bool is_whole = value >= 99.95 || value <= 0 || (is_count && unit == 0);
  snprintf(text, sizeof text, "%.*f%s", is_whole ? 0 : value >= 9.995 ? 1 : 2, value, units[unit]);
  cli_put_text(rows, CLI_COLUMN(head), text);
}

static void put_rates(cli_rows *rows, const void *context, size_t index) {
  const top_record *record = context;
  (void)index;
  put_figures(rows, "requests", requests_rate(record), false);
  put_figures(rows, "radii", rate(record, "radii_evaluated"), false);
  cli_put_number(rows, CLI_COLUMN("MB in", .format = "%.2f"), rate(record, "received_bytes") / 1e6);
  cli_put_number(rows, CLI_COLUMN("MB out", .format = "%.2f"), rate(record, "sent_bytes") / 1e6);
  cli_put_number(rows, CLI_COLUMN("batch", .format = "%.1f"), batch_mean(record));
  put_figures(rows, "errors", errors_rate(record), false);
  put_figures(rows, "cache hits", rate(record, "cache_hits"), false);
  put_figures(rows, "misses", rate(record, "cache_misses"), false);
}

static void put_gauges(cli_rows *rows, const void *context, size_t index) {
  static const char *const gauges[][2] = {
      {"connections_open", "connections"}, {"queued_connections", "queued"},
      {"owed_radii", "radii owed"},        {"mc_jobs_open", "mc jobs"},
      {"cache_entries", "profiles"},       {"cache_bytes", "their bytes"},
      {"buffer_bytes", "buffer bytes"},
  };
  (void)index;
  for (size_t i = 0; i < sizeof gauges / sizeof gauges[0]; i++) {
    put_figures(rows, gauges[i][1], (double)top_value(context, gauges[i][0]), true);
  }
}

/* Puts a class of requests and its latencies. */
static void put_latency(cli_rows *rows, const void *context, size_t index) {
  char kind[64] = "";
  size_t from = 0;
  for (size_t i = 0; i <= index; i++) {
    next_latency(context, &from, kind, sizeof kind);
  }
  cli_put_text(rows, CLI_COLUMN("us, since its start"), kind);
  for (size_t i = 0; i < LATENCIES; i++) {
    cli_put_count(rows, CLI_COLUMN(latencies[i][1]), latency(context, kind, latencies[i][0]));
  }
  put_figures(rows, "requests", (double)latency(context, kind, "count"), true);
}

/* Writes the statistics of a prefix that rose, all but one of them. */
static void write_active(const top_record *record, const char *prefix, const char *but,
                         const char *head, FILE *file) {
  cli_table table = {.columns = 2, .left = 1, .heads = 1};
  cli_rows rows = {.form = CLI_TABLE, .table = &table, .pass = CLI_ROWS_VALUES};
  const char *name;
  for (size_t from = 0; (name = next(record, prefix, &from)) != NULL;) {
    const double each_second = rate(record, name);
    if (each_second > 0 && strcmp(name, but) != 0) {
      if (table.cell_count == 0) {
        cli_table_add(&table, "%s", head);
        cli_table_add(&table, "each second");
      }
      cli_table_add(&table, "%s", name + strlen(prefix));
      put_figures(&rows, "", each_second, false);
    }
  }
  if (table.cell_count > 0) {
    fputs("\n", file);
    cli_table_print(&table, file);
  }
}

void top_write_table(const dipole_info *info, const top_record *record, FILE *file) {
  const uint64_t up_s = top_value(record, "uptime_ms") / 1000;
  char kind[64];
  size_t kinds = 0;
  fprintf(file, "%s at %s: up %llu:%02u:%02u, %u workers, %s\n", info->software, info->address,
          (unsigned long long)(up_s / 3600), (unsigned)(up_s / 60 % 60), (unsigned)(up_s % 60),
          info->workers, info->instruction_set);
  if (record->before.count > 0) {
    fprintf(file, "Each second, over the last %.1f s\n\n", record->interval_s);
  } else {
    fputs("Each second, since its start\n\n", file);
  }
  cli_rows_print(file, 0, 1, put_rates, record);
  fputs("\nNow\n", file);
  cli_rows_print(file, 0, 1, put_gauges, record);
  fputs("\n", file);
  for (size_t from = 0; next_latency(record, &from, kind, sizeof kind);) {
    kinds++;
  }
  cli_rows_print(file, 1, kinds, put_latency, record);
  write_active(record, "radii_", "radii_evaluated", "radii of model", file);
  write_active(record, "answers_", "answers_ok", "errors", file);
}

/* ---- for programs: always the same names from the same daemon ------------------------------- */

static void put_rates_of(cli_rows *rows, const top_record *record, const char *prefix) {
  const char *name;
  for (size_t from = 0; (name = next(record, prefix, &from)) != NULL;) {
    char per_s[96];
    snprintf(per_s, sizeof per_s, "%s_per_s", name);
    cli_put_number(rows, CLI_COLUMN(per_s), rate(record, name));
  }
}

static void put_record(cli_rows *rows, const void *context, size_t index) {
  static const char *const rates[] = {"received_bytes", "sent_bytes", "cache_hits", "cache_misses",
                                      "radii_",         "requests_",  "answers_"};
  static const char *const gauges[] = {"uptime_ms",   "connections_open", "queued_connections",
                                       "owed_radii",  "buffer_bytes",     "cache_entries",
                                       "cache_bytes", "mc_jobs_open"};
  const top_record *record = context;
  char kind[64];
  (void)index;
  cli_put_number(rows, CLI_COLUMN("interval_s"), record->interval_s);
  for (size_t i = 0; i < sizeof gauges / sizeof gauges[0]; i++) {
    cli_put_number(rows, CLI_COLUMN(gauges[i]), (double)top_value(record, gauges[i]));
  }
  cli_put_number(rows, CLI_COLUMN("requests_per_s"), requests_rate(record));
  cli_put_number(rows, CLI_COLUMN("errors_per_s"), errors_rate(record));
  cli_put_number(rows, CLI_COLUMN("requests_per_batch"), batch_mean(record));
  for (size_t i = 0; i < sizeof rates / sizeof rates[0]; i++) {
    put_rates_of(rows, record, rates[i]);
  }
  for (size_t from = 0; next_latency(record, &from, kind, sizeof kind);) {
    for (size_t i = 0; i < LATENCIES; i++) {
      char name[96];
      snprintf(name, sizeof name, "latency_%s_%s", kind, latencies[i][0]);
      cli_put_number(rows, CLI_COLUMN(name), (double)top_value(record, name));
    }
  }
}

void top_write_csv(const top_record *record, bool names, FILE *file) {
  cli_rows_csv(file, names, 1, put_record, record);
}

void top_write_json(const top_record *record, FILE *file) {
  cli_json json = {.file = file, .one_line = true};
  cli_json_begin(&json, NULL, '{');
  cli_rows_members(&json, put_record, record, 0);
  cli_json_end(&json, '}');
}
