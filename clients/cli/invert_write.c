/* The report of `dipole invert` as a table for people, as CSV and as JSON. */
#include <math.h>

#include "clients/cli/invert.h"
#include "clients/cli/json.h"
#include "clients/cli/number.h"
#include "clients/cli/table.h"

/* ---- for people ----------------------------------------------------------------------------- */

enum { COLUMNS = 10 };

static void add_row(cli_table *table, const cli_invert_report *report, size_t index) {
  const cli_invert_row *row = &report->rows[index];
  cli_table_add(table, "%zu", index + 1);
  cli_table_add(table, "%.6g", row->wanted_albedo);
  cli_table_add(table, "%.6g", row->length_mm);
  if (!row->found) {
    cli_table_add(table, "%s", cli_invert_reason(report, row));
    for (size_t i = 4; i < COLUMNS; i++) {
      cli_table_add(table, "-");
    }
    return;
  }
  cli_table_add(table, "%.9g", row->medium.sigma_a_per_mm);
  cli_table_add(table, "%.9g", row->medium.sigma_s_per_mm);
  cli_table_add(table, "%.9g", row->medium.sigma_s_per_mm * (1 - row->medium.g));
  cli_table_add(table, "%.6g", row->medium.g);
  cli_table_add(table, "%.6g", row->medium.eta);
  cli_table_add(table, "%.6g", row->albedo);
  cli_table_add(table, "%.1e", fabs(row->albedo - row->wanted_albedo));
}

void cli_invert_write_table(const cli_invert_report *report, FILE *file) {
  cli_table table = {.heads = 2, .left = 1, .columns = COLUMNS};
  const char *const names[COLUMNS] = {
      "channel", "albedo", report->given->name, "sigma_a", "sigma_s", "sigma_s'",
      "g",       "eta",    "check: albedo",     "off by"};
  const char *const units[COLUMNS] = {"", "wanted", "mm", "1/mm", "1/mm", "1/mm", "", "", "", ""};
  fprintf(file, "media of given albedo; model %s, moments %s\n%s: %s\n\n", report->model->name,
          report->moments->name, report->given->name, report->given->about);
  for (size_t i = 0; i < COLUMNS; i++) {
    cli_table_add(&table, "%s", names[i]);
  }
  for (size_t i = 0; i < COLUMNS; i++) {
    cli_table_add(&table, "%s", units[i]);
  }
  for (size_t i = 0; i < report->count; i++) {
    add_row(&table, report, i);
  }
  cli_table_print(&table, file);
  fprintf(file, "check: an evaluation of the medium\nalbedos within reach: %.6g to %.17g\n",
          report->albedo_least, report->albedo_most);
}

/* ---- CSV ------------------------------------------------------------------------------------ */

/* A cell and the comma before it. What is not there, NaN, is an empty cell. */
static void write_cell(FILE *file, double value) {
  char text[CLI_NUMBER_BYTES];
  fprintf(file, ",%s", isnan(value) ? "" : cli_number_format(value, text));
}

void cli_invert_write_csv(const cli_invert_report *report, FILE *file) {
  fputs("model,channel,wanted_albedo,given,length,sigma_a,sigma_s,g,eta,albedo,status\n", file);
  for (size_t i = 0; i < report->count; i++) {
    const cli_invert_row *row = &report->rows[i];
    fprintf(file, "%s,%zu", report->model->name, i + 1);
    write_cell(file, row->wanted_albedo);
    fprintf(file, ",%s", report->given->name);
    write_cell(file, row->length_mm);
    write_cell(file, row->medium.sigma_a_per_mm);
    write_cell(file, row->medium.sigma_s_per_mm);
    write_cell(file, row->medium.g);
    write_cell(file, row->medium.eta);
    write_cell(file, row->albedo);
    fprintf(file, ",%s\n", cli_invert_reason(report, row));
  }
}

/* ---- JSON ----------------------------------------------------------------------------------- */

static void write_json_row(cli_json *json, const cli_invert_report *report, size_t index) {
  const cli_invert_row *row = &report->rows[index];
  cli_json_begin(json, NULL, '{');
  cli_json_count(json, "channel", index + 1);
  cli_json_number(json, "wanted_albedo", row->wanted_albedo);
  cli_json_number(json, "length", row->length_mm);
  cli_json_text(json, "status", cli_invert_reason(report, row));
  cli_json_number(json, "sigma_a", row->medium.sigma_a_per_mm);
  cli_json_number(json, "sigma_s", row->medium.sigma_s_per_mm);
  cli_json_number(json, "g", row->medium.g);
  cli_json_number(json, "eta", row->medium.eta);
  cli_json_number(json, "albedo", row->albedo);
  cli_json_end(json, '}');
}

void cli_invert_write_json(const cli_invert_report *report, FILE *file) {
  cli_json json = {.file = file};
  cli_json_begin(&json, NULL, '{');
  cli_json_text(&json, "software", report->info->software);
  cli_json_text(&json, "model", report->model->name);
  cli_json_text(&json, "moments", report->moments->name);
  cli_json_text(&json, "given", report->given->name);
  cli_json_number(&json, "albedo_least", report->albedo_least);
  cli_json_number(&json, "albedo_most", report->albedo_most);
  cli_json_begin(&json, "units", '{');
  cli_json_text(&json, "length", "mm");
  cli_json_text(&json, "sigma_a", "1/mm");
  cli_json_text(&json, "sigma_s", "1/mm");
  cli_json_text(&json, "albedo", "1");
  cli_json_end(&json, '}');
  cli_json_begin(&json, "channels", '[');
  for (size_t i = 0; i < report->count; i++) {
    write_json_row(&json, report, i);
  }
  cli_json_end(&json, ']');
  cli_json_end(&json, '}');
}
