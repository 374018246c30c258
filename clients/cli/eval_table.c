/* Evaluates a file of tables, one for each channel, without a daemon. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/eval.h"
#include "clients/cli/tables_file.h"
#include "core/core.h"

/* ---- what the tables are --------------------------------------------------------------------- */

static bool is_same_profile(const dipole_table_info *a, const dipole_table_info *b) {
  bool same =
      a->model == b->model && a->moments == b->moments && a->parameter_count == b->parameter_count;
  for (size_t i = 0; same && i < a->parameter_count; i++) {
    same = a->parameters[i].id == b->parameters[i].id &&
           a->parameters[i].value == b->parameters[i].value;
  }
  return same;
}

static int check_same(const char *path, const cli_tables *tables) {
  for (size_t i = 1; i < tables->count; i++) {
    if (!is_same_profile(dipole_table_get_info(tables->items[0]),
                         dipole_table_get_info(tables->items[i]))) {
      return cli_fail("%s: tables 1 and %zu differ in model, moments or parameters: put them into "
                      "files of their own",
                      path, i + 1);
    }
  }
  return CLI_OK;
}

/* Writes the name of a table's medium: that of a measured medium if it is one, as in "skin1 red",
 * else its number from 1. */
static void name_channel(const dipole_medium *medium, size_t index, char *name, size_t bytes) {
  snprintf(name, bytes, "%zu", index + 1);
  for (size_t i = 0; i < core_measured_media_count; i++) {
    for (size_t k = 0; k < CLI_COLOURS; k++) {
      const core_medium *known = &core_measured_media[i].channel[k];
      if (known->sigma_a_per_mm == medium->sigma_a_per_mm &&
          known->sigma_s_per_mm == medium->sigma_s_per_mm && known->g == medium->g &&
          known->eta == medium->eta) {
        snprintf(name, bytes, "%s %s", core_measured_media[i].name, cli_colours[k]);
        return;
      }
    }
  }
}

/* Takes the model and the channels from the tables. */
static int describe(const char *path, const cli_tables *tables, cli_eval_report *report) {
  const dipole_table_info *first = dipole_table_get_info(tables->items[0]);
  const dipole_choice *model = cli_choice_of_id(report->profile.info, DIPOLE_MODEL, first->model);
  report->profile.moments = cli_choice_of_id(report->profile.info, DIPOLE_MOMENTS, first->moments);
  if (model == NULL || report->profile.moments == NULL) {
    return cli_fail(
        "%s: model %u or moments %u are not known to this program: use the version that wrote it",
        path, first->model, first->moments);
  }
  cli_eval_add_model(report, model, true);
  report->models[0].evaluator =
      cli_choice_of_id(report->profile.info, DIPOLE_EVALUATOR, DIPOLE_LUT);
  for (size_t i = 0; i < first->parameter_count; i++) {
    cli_parameters_set(&report->profile.parameters, first->parameters[i].id,
                       first->parameters[i].value);
  }
  cli_profile_set_channels(&report->profile, tables->count);
  for (size_t i = 0; i < tables->count; i++) {
    const dipole_table_info *info = dipole_table_get_info(tables->items[i]);
    cli_channel *channel = &report->profile.channels[i];
    name_channel(&info->medium, i, channel->name, sizeof channel->name);
    channel->medium = report->profile.media[i] = info->medium;
    report->models[0].notes |= info->notes;
  }
  return CLI_OK;
}

/* ---- values ---------------------------------------------------------------------------------- */

/* Takes the radii. Returns them in single precision; says what is wrong and returns
 * NULL if it cannot. */
static float *take_radii(const cli_settings *settings, cli_eval_report *report) {
  cli_eval_radii radii = cli_eval_make_radii(settings, report);
  dipole_error error;
  if (radii.spacing != DIPOLE_LIST) {
    radii.f32 = cli_allocate(radii.count, sizeof *radii.f32);
    if (!dipole_grid_radii((enum dipole_spacing)radii.spacing, radii.start_mm, radii.stop_mm,
                           radii.count, radii.f32, &error)) {
      cli_fail("%s", error.text);
      return NULL;
    }
  }
  report->place_count = (size_t)radii.count;
  report->places = cli_allocate(report->place_count, sizeof *report->places);
  for (size_t i = 0; i < report->place_count; i++) {
    report->places[i] = cli_number_of_single(radii.f32[i]);
  }
  return radii.f32 != NULL ? radii.f32 : cli_allocate(0, sizeof *radii.f32);
}

/* Names the first radius that a table does not take. */
static int fail_radius(const dipole_table_info *info, const cli_eval_report *report) {
  size_t at = 0;
  while (at + 1 < report->place_count && report->places[at] >= info->radius_least_mm &&
         report->places[at] <= info->radius_most_mm) {
    at++;
  }
  return cli_fail("r number %zu of %zu: allowed: %.6g to %.6g mm, which the model covers", at + 1,
                  report->place_count, info->radius_least_mm, info->radius_most_mm);
}

/* Fills in the values of one table. */
static int evaluate(const dipole_table *table, const float *r, const cli_eval_report *report,
                    cli_eval_values *values) {
  const dipole_table_info *info = dipole_table_get_info(table);
  const size_t n = report->place_count;
  float probe = 0;
  values->albedo = (report->quantities.wanted & DIPOLE_ALBEDO) != 0 ? info->albedo : (double)NAN;
  float *out = cli_allocate(n, sizeof *out);
  int status = CLI_OK;
  for (size_t q = 0; status == CLI_OK && q < report->quantities.count; q++) {
    const enum dipole_quantity quantity = (enum dipole_quantity)report->quantities.items[q]->id;
    if (quantity == DIPOLE_ALBEDO) {
      continue;
    }
    if (!dipole_table_values(table, quantity, 0, &probe, &probe)) {
      status = cli_fail("--wanted %s: a table does not hold it; it holds R, albedo, cdf, pdf, "
                        "2_pi_r_R and S",
                        report->quantities.items[q]->name);
    } else if (!dipole_table_values(table, quantity, n, r, out)) {
      status = fail_radius(info, report);
    } else {
      values->arrays[q] = cli_allocate(n, sizeof(double));
      for (size_t i = 0; i < n; i++) {
        values->arrays[q][i] = cli_number_of_single(out[i]);
      }
    }
  }
  dipole_errors errors;
  if (status == CLI_OK &&
      !dipole_table_errors(table, report->quantities.wanted & ~(unsigned)DIPOLE_RADIUS, n, r,
                           &errors)) {
    status = fail_radius(info, report);
  }
  if (status == CLI_OK) {
    values->errors = errors;
  }
  for (size_t q = 0; status == CLI_OK && q < report->quantities.count; q++) {
    dipole_table_errors(table, report->quantities.items[q]->id, n, r, &values->of_each[q]);
  }
  return status;
}

static int evaluate_all(const cli_settings *settings, const cli_tables *tables,
                        cli_eval_report *report) {
  cli_eval_make_values(report);
  float *r = take_radii(settings, report);
  int status = r != NULL ? CLI_OK : CLI_FAILED;
  for (size_t i = 0; status == CLI_OK && i < tables->count; i++) {
    status = evaluate(tables->items[i], r, report, &report->values[i]);
  }
  return status;
}

int cli_eval_table(const cli_settings *settings, cli_eval_report *report, dipole_info **info) {
  cli_tables tables = {0};
  dipole_error error;
  if (!dipole_local_info(info, &error)) {
    return cli_fail("%s", error.text);
  }
  report->profile.info = *info;
  if (!cli_eval_take_quantities(settings, report)) {
    return CLI_USAGE;
  }
  int status = cli_tables_read(settings->table, &tables) ? CLI_OK : CLI_FAILED;
  status = status == CLI_OK ? check_same(settings->table, &tables) : status;
  status = status == CLI_OK ? describe(settings->table, &tables, report) : status;
  status = status == CLI_OK ? evaluate_all(settings, &tables, report) : status;
  cli_tables_free(&tables);
  return status;
}
