/* dipole info: the daemon, what it offers, its limits and its statistics. */
#include <stdlib.h>
#include <string.h>

#include "clients/cli/cli.h"
#include "clients/cli/csv.h"
#include "clients/cli/json.h"
#include "clients/cli/table.h"

/* The daemon's lists, as people call them. */
static const struct {
  enum dipole_kind kind;
  const char *plural;
} lists[] = {
    {DIPOLE_MODEL, "models"},         {DIPOLE_EVALUATOR, "evaluators"}, {DIPOLE_MOMENTS, "moments"},
    {DIPOLE_QUANTITY, "quantities"},  {DIPOLE_SPACING, "spacings"},     {DIPOLE_STATUS, "statuses"},
    {DIPOLE_PARAMETER, "parameters"}, {DIPOLE_NOTE, "notes"},           {DIPOLE_DRAW, "draws"},
    {DIPOLE_LENGTH, "lengths"},
};

enum { LISTS = sizeof lists / sizeof lists[0] };

typedef struct info_report {
  const dipole_info *info;
  const dipole_value *statistics;
  size_t statistic_count;
} info_report;

/* ---- for people ---------------------------------------------------------------------------- */

static void print_values(const char *title, const dipole_value *values, size_t count) {
  cli_table table = {.columns = 3, .left = 2};
  printf("\n%s\n", title);
  for (size_t i = 0; i < count; i++) {
    cli_table_add(&table, " ");
    cli_table_add(&table, "%s", values[i].name);
    cli_table_add(&table, "%llu", (unsigned long long)values[i].value);
  }
  cli_table_print(&table, stdout);
}

static void write_table(const info_report *report) {
  const dipole_info *info = report->info;
  cli_table table = {.columns = 2, .left = 2};
  cli_table_add(&table, "daemon");
  cli_table_add(&table, "%s", info->software);
  cli_table_add(&table, "address");
  cli_table_add(&table, "%s", info->address);
  cli_table_add(&table, "protocol version");
  cli_table_add(&table, "%u", info->protocol_version);
  cli_table_add(&table, "instruction set");
  cli_table_add(&table, "%s", info->instruction_set);
  cli_table_add(&table, "workers");
  cli_table_add(&table, "%u", info->workers);
  cli_table_add(&table, "unit of R");
  cli_table_add(&table, "%s", info->R_unit);
  cli_table_print(&table, stdout);
  for (size_t i = 0; i < LISTS; i++) {
    const dipole_choice *choice;
    cli_table list = {.columns = 3, .left = 3};
    printf("\n%s\n", lists[i].plural);
    for (size_t from = 0; (choice = cli_next_choice(info, lists[i].kind, &from)) != NULL;) {
      cli_table_add(&list, " ");
      cli_table_add(&list, "%s", choice->name);
      cli_table_add(&list, "%s", choice->about);
    }
    cli_table_print(&list, stdout);
  }
  print_values("limits", info->limits, info->limit_count);
  print_values("statistics", report->statistics, report->statistic_count);
}

/* ---- for programs -------------------------------------------------------------------------- */

static void write_csv_text(const char *section, const char *name, const char *value) {
  printf("%s,", section);
  cli_csv_write_cell(name, stdout);
  fputc(',', stdout);
  cli_csv_write_cell(value, stdout);
  fputc('\n', stdout);
}

static void write_csv_count(const char *section, const char *name, uint64_t value) {
  char text[24];
  snprintf(text, sizeof text, "%llu", (unsigned long long)value);
  write_csv_text(section, name, text);
}

static void write_csv(const info_report *report) {
  const dipole_info *info = report->info;
  puts("section,name,value");
  write_csv_text("daemon", "software", info->software);
  write_csv_text("daemon", "address", info->address);
  write_csv_count("daemon", "protocol_version", info->protocol_version);
  write_csv_text("daemon", "instruction_set", info->instruction_set);
  write_csv_count("daemon", "workers", info->workers);
  write_csv_text("daemon", "R_unit", info->R_unit);
  for (size_t i = 0; i < LISTS; i++) {
    const dipole_choice *choice;
    for (size_t from = 0; (choice = cli_next_choice(info, lists[i].kind, &from)) != NULL;) {
      write_csv_text(lists[i].plural, choice->name, choice->about);
    }
  }
  for (size_t i = 0; i < info->limit_count; i++) {
    write_csv_count("limits", info->limits[i].name, info->limits[i].value);
  }
  for (size_t i = 0; i < report->statistic_count; i++) {
    write_csv_count("statistics", report->statistics[i].name, report->statistics[i].value);
  }
}

static void write_json_values(cli_json *json, const char *key, const dipole_value *values,
                              size_t count) {
  cli_json_begin(json, key, '{');
  for (size_t i = 0; i < count; i++) {
    cli_json_count(json, values[i].name, values[i].value);
  }
  cli_json_end(json, '}');
}

static void write_json(const info_report *report) {
  const dipole_info *info = report->info;
  cli_json json = {.file = stdout};
  cli_json_begin(&json, NULL, '{');
  cli_json_text(&json, "software", info->software);
  cli_json_text(&json, "address", info->address);
  cli_json_count(&json, "protocol_version", info->protocol_version);
  cli_json_text(&json, "instruction_set", info->instruction_set);
  cli_json_count(&json, "workers", info->workers);
  cli_json_text(&json, "R_unit", info->R_unit);
  for (size_t i = 0; i < LISTS; i++) {
    const dipole_choice *choice;
    cli_json_begin(&json, lists[i].plural, '[');
    for (size_t from = 0; (choice = cli_next_choice(info, lists[i].kind, &from)) != NULL;) {
      cli_json_begin(&json, NULL, '{');
      cli_json_count(&json, "id", choice->id);
      cli_json_text(&json, "name", choice->name);
      cli_json_text(&json, "about", choice->about);
      cli_json_end(&json, '}');
    }
    cli_json_end(&json, ']');
  }
  write_json_values(&json, "limits", info->limits, info->limit_count);
  write_json_values(&json, "statistics", report->statistics, report->statistic_count);
  cli_json_end(&json, '}');
}

/* ---- the command --------------------------------------------------------------------------- */

static int show(const cli_command *command, const char *format, dipole_client *client) {
  dipole_value *statistics;
  dipole_error error;
  size_t count;
  if (!dipole_statistics(client, &statistics, &count, &error)) {
    return cli_fail(command, "%s", error.text);
  }
  const info_report report = {dipole_get_info(client), statistics, count};
  if (format == NULL || strcmp(format, "table") == 0) {
    write_table(&report);
  } else if (strcmp(format, "csv") == 0) {
    write_csv(&report);
  } else {
    write_json(&report);
  }
  free(statistics);
  return CLI_OK;
}

static int run(const cli_command *command, int argc, char **argv) {
  return cli_run_plain(command, argc, argv, show);
}

static const cli_option options[] = {{0}};

const cli_command cli_command_info = {
    .name = "info",
    .about = "Show a daemon: models, evaluators, instruction set, limits, statistics",
    .formats = "table,csv,json",
    .options = options,
    .examples = "  dipole info\n"
                "  dipole info --connect tcp:farm7:4817 --format json\n",
    .run = run,
};
