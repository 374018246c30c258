/* The report of `dipole bench` in each of its formats. */
#include "clients/cli/bench.h"
#include "clients/cli/json.h"
#include "clients/cli/number.h"
#include "clients/cli/table.h"

/* ---- for programs ----------------------------------------------------------------------------- */

static double p50(const bench_result *result) {
  return bench_times_quantile_us(&result->times, 0.5);
}
static double p99(const bench_result *result) {
  return bench_times_quantile_us(&result->times, 0.99);
}
static double most(const bench_result *result) {
  return (double)result->times.most_ns / 1000;
}
static double connections(const bench_result *result) {
  return result->load.connections;
}
static double in_flight(const bench_result *result) {
  return result->load.in_flight;
}
static double radii(const bench_result *result) {
  return (double)result->load.radii;
}
static double requests(const bench_result *result) {
  return (double)result->times.count;
}
static double seconds(const bench_result *result) {
  return result->took_s;
}

/* In the order of a line; the name is that of the column and of the key. */
static const struct {
  const char *name;
  double (*value)(const bench_result *result);
} figures[] = {
    {"radii", radii},
    {"connections", connections},
    {"in_flight", in_flight},
    {"requests", requests},
    {"seconds", seconds},
    {"p50_us", p50},
    {"p99_us", p99},
    {"max_us", most},
    {"requests_per_s", bench_requests_per_s},
    {"radii_per_s", bench_radii_per_s},
    {"bytes_per_s", bench_bytes_per_s},
};
enum { FIGURES = sizeof figures / sizeof figures[0] };

void bench_write_csv(const bench_report *report, FILE *file) {
  char text[CLI_NUMBER_BYTES];
  fputs("measurement", file);
  for (size_t i = 0; i < FIGURES; i++) {
    fprintf(file, ",%s", figures[i].name);
  }
  fputc('\n', file);
  for (size_t m = 0; m < BENCH_MEASUREMENTS; m++) {
    const bench_result *result = &report->results[m];
    fputs(result->load.name, file);
    for (size_t i = 0; i < FIGURES; i++) {
      fprintf(file, ",%s", cli_number_format(figures[i].value(result), text));
    }
    fputc('\n', file);
  }
}

void bench_write_json(const bench_report *report, FILE *file) {
  cli_json json = {.file = file};
  cli_json_begin(&json, NULL, '{');
  cli_json_text(&json, "software", report->info->software);
  cli_json_text(&json, "address", report->info->address);
  cli_json_text(&json, "instruction_set", report->info->instruction_set);
  cli_json_count(&json, "workers", report->info->workers);
  cli_json_text(&json, "model", report->model->name);
  cli_json_text(&json, "evaluator", report->evaluator->name);
  cli_json_count(&json, "channels", report->channels);
  cli_json_begin(&json, "measurements", '[');
  for (size_t m = 0; m < BENCH_MEASUREMENTS; m++) {
    cli_json_begin(&json, NULL, '{');
    cli_json_text(&json, "name", report->results[m].load.name);
    cli_json_text(&json, "about", report->results[m].load.about);
    for (size_t i = 0; i < FIGURES; i++) {
      cli_json_number(&json, figures[i].name, figures[i].value(&report->results[m]));
    }
    cli_json_end(&json, '}');
  }
  cli_json_end(&json, ']');
  cli_json_end(&json, '}');
}

/* ---- for people ------------------------------------------------------------------------------- */

/* Three figures, as far as that needs no exponent. */
static void add_figures(cli_table *table, double value) {
  cli_table_add(table, "%.*f", value >= 99.95 ? 0 : value >= 9.995 ? 1 : 2, value);
}

static void add_row(cli_table *table, const bench_result *result) {
  const bench_load *load = &result->load;
  cli_table_add(table, "%s", load->name);
  cli_table_add(table, "%llu", (unsigned long long)load->radii);
  cli_table_add(table, "%u", load->connections);
  cli_table_add(table, "%u", load->in_flight);
  add_figures(table, p50(result));
  add_figures(table, p99(result));
  add_figures(table, most(result));
  add_figures(table, bench_requests_per_s(result));
  add_figures(table, bench_radii_per_s(result) / 1e6);
  add_figures(table, bench_bytes_per_s(result) / 1e6);
}

void bench_write_table(const bench_report *report, FILE *file) {
  static const char *const heads[] = {"requests", "radii",  "connections", "in flight", "p50 us",
                                      "p99 us",   "max us", "requests/s",  "M radii/s", "MB/s"};
  const dipole_info *info = report->info;
  cli_table table = {.columns = sizeof heads / sizeof heads[0], .left = 1, .heads = 1};
  fprintf(file, "%s at %s: %u workers, %s\n%s, %s, %s%s%zu channel%s\n\n", info->software,
          info->address, info->workers, info->instruction_set, report->model->name,
          report->evaluator->name, report->medium != NULL ? report->medium : "",
          report->medium != NULL ? ", " : "", report->channels, report->channels == 1 ? "" : "s");
  for (size_t i = 0; i < table.columns; i++) {
    cli_table_add(&table, "%s", heads[i]);
  }
  for (size_t m = 0; m < BENCH_MEASUREMENTS; m++) {
    add_row(&table, &report->results[m]);
  }
  cli_table_print(&table, file);
}
