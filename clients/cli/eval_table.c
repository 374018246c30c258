/* What `dipole eval --table` evaluates by itself: a file of tables, one for each channel. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/eval.h"
#include "clients/cli/tables.h"

/* ---- what the tables are ------------------------------------------------------------------- */

static bool is_same_profile(const dipole_table_info *a, const dipole_table_info *b) {
  bool same =
      a->model == b->model && a->moments == b->moments && a->parameter_count == b->parameter_count;
  for (size_t i = 0; same && i < a->parameter_count; i++) {
    same = a->parameters[i].id == b->parameters[i].id &&
           a->parameters[i].value == b->parameters[i].value;
  }
  return same;
}

static int check_same(const cli_command *command, const char *path, const cli_tables *tables) {
  for (size_t i = 1; i < tables->count; i++) {
    if (!is_same_profile(dipole_table_get_info(tables->items[0]),
                         dipole_table_get_info(tables->items[i]))) {
      return cli_fail(command,
                      "%s: tables 1 and %zu differ in model, moments or parameters: put them into "
                      "files of their own",
                      path, i + 1);
    }
  }
  return CLI_OK;
}

/* The model and the channels, as the tables have them. */
static int describe(const cli_command *command, const char *path, const cli_tables *tables,
                    cli_eval_report *report) {
  const dipole_table_info *first = dipole_table_get_info(tables->items[0]);
  const dipole_choice *model = cli_choice_of_id(report->info, DIPOLE_MODEL, first->model);
  report->moments = cli_choice_of_id(report->info, DIPOLE_MOMENTS, first->moments);
  report->evaluator = cli_choice_of_id(report->info, DIPOLE_EVALUATOR, DIPOLE_LUT);
  if (model == NULL || report->moments == NULL) {
    return cli_fail(command, "%s: model %u or moments %u are not known here", path, first->model,
                    first->moments);
  }
  report->models = cli_allocate(1, sizeof *report->models);
  report->models[0] = (cli_eval_model){.choice = model, .named = true};
  report->model_count = 1;
  for (size_t i = 0; i < first->parameter_count; i++) {
    cli_parameters_set(&report->parameters, first->parameters[i].id, first->parameters[i].value);
  }
  report->channel_count = tables->count;
  report->channels = cli_allocate(tables->count, sizeof *report->channels);
  for (size_t i = 0; i < tables->count; i++) {
    const dipole_table_info *info = dipole_table_get_info(tables->items[i]);
    snprintf(report->channels[i].name, sizeof report->channels[i].name, "%zu", i + 1);
    report->channels[i].medium = info->medium;
    report->models[0].notes |= info->notes;
  }
  return CLI_OK;
}

/* ---- values -------------------------------------------------------------------------------- */

/* The radii in single precision, to be freed; NULL, saying so, when they are none. */
static float *take_radii(const cli_command *command, const cli_eval_settings *settings,
                         cli_eval_report *report) {
  cli_eval_radii radii = cli_eval_make_radii(settings, report);
  dipole_error error;
  if (radii.spacing != DIPOLE_LIST) {
    radii.f32 = cli_allocate(radii.count, sizeof *radii.f32);
    if (!dipole_grid_radii((enum dipole_spacing)radii.spacing, radii.start_mm, radii.stop_mm,
                           radii.count, radii.f32, &error)) {
      cli_fail(command, "%s", error.text);
      free(radii.f32);
      return NULL;
    }
  }
  report->radius_count = (size_t)radii.count;
  report->radii = cli_allocate(report->radius_count, sizeof *report->radii);
  for (size_t i = 0; i < report->radius_count; i++) {
    report->radii[i] = (double)radii.f32[i];
  }
  return radii.f32 != NULL ? radii.f32 : cli_allocate(0, sizeof *radii.f32);
}

/* Of several radii the first that a table does not take. */
static int fail_radius(const cli_command *command, const dipole_table_info *info,
                       const cli_eval_report *report) {
  size_t at = 0;
  while (at + 1 < report->radius_count && report->radii[at] >= info->radius_least_mm &&
         report->radii[at] <= info->radius_most_mm) {
    at++;
  }
  return cli_fail(command, "r number %zu of %zu: allowed: %.6g to %.6g mm, which the model covers",
                  at + 1, report->radius_count, info->radius_least_mm, info->radius_most_mm);
}

/* The values of one table. */
static int evaluate(const cli_command *command, const dipole_table *table, const float *r,
                    const cli_eval_report *report, cli_eval_values *values) {
  const dipole_table_info *info = dipole_table_get_info(table);
  const size_t n = report->radius_count;
  float probe = 0;
  values->albedo = (report->wanted & DIPOLE_ALBEDO) != 0 ? info->albedo : (double)NAN;
  values->numerical_error = info->numerical_error;
  values->numerical_error_per_mm = info->numerical_error_per_mm;
  values->model_error = info->model_error;
  float *out = cli_allocate(n, sizeof *out);
  int status = CLI_OK;
  for (size_t q = 0; status == CLI_OK && q < report->quantity_count; q++) {
    const enum dipole_quantity quantity = (enum dipole_quantity)report->quantities[q]->id;
    if (!dipole_table_values(table, quantity, 0, &probe, &probe)) {
      status = cli_fail(command,
                        "--want %s: a table does not hold it; it holds R, albedo, cdf, pdf, "
                        "2_pi_r_R and S",
                        report->quantities[q]->name);
    } else if (!dipole_table_values(table, quantity, n, r, out)) {
      status = fail_radius(command, info, report);
    } else {
      values->arrays[q] = cli_allocate(n, sizeof(double));
      for (size_t i = 0; i < n; i++) {
        values->arrays[q][i] = (double)out[i];
      }
    }
  }
  free(out);
  return status;
}

static int evaluate_all(const cli_command *command, const cli_eval_settings *settings,
                        const cli_tables *tables, cli_eval_report *report) {
  report->values_capacity = tables->count;
  report->values = cli_allocate(tables->count, sizeof *report->values);
  float *r = take_radii(command, settings, report);
  int status = r != NULL ? CLI_OK : CLI_FAILED;
  for (size_t i = 0; status == CLI_OK && i < tables->count; i++) {
    status = evaluate(command, tables->items[i], r, report, &report->values[i]);
  }
  free(r);
  return status;
}

int cli_eval_table(const cli_command *command, const cli_eval_settings *settings,
                   cli_eval_report *report, dipole_info **info) {
  cli_tables tables = {0};
  dipole_error error;
  if (!dipole_local_info(info, &error)) {
    return cli_fail(command, "%s", error.text);
  }
  report->info = *info;
  if (!cli_eval_choose_quantities(command, &settings->want, report)) {
    return CLI_USAGE;
  }
  int status = cli_tables_read(command, settings->table, &tables) ? CLI_OK : CLI_FAILED;
  if (status == CLI_OK) {
    status = check_same(command, settings->table, &tables);
  }
  if (status == CLI_OK) {
    status = describe(command, settings->table, &tables, report);
  }
  if (status == CLI_OK) {
    status = evaluate_all(command, settings, &tables, report);
  }
  cli_tables_free(&tables);
  return status;
}
