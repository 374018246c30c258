/* The report of `dipole eval` as a table for people, as CSV and as JSON. */
#include <math.h>

#include "clients/cli/eval.h"
#include "clients/cli/json.h"
#include "clients/cli/number.h"
#include "clients/cli/table.h"

static const char *unit_of(const cli_eval_report *report, unsigned quantity) {
  const dipole_choice *choice = cli_choice_of_id(report->info, DIPOLE_QUANTITY, quantity);
  return choice != NULL ? choice->about : "";
}

static const char *parameter_name(const cli_eval_report *report, unsigned id) {
  const dipole_choice *choice = cli_choice_of_id(report->info, DIPOLE_PARAMETER, id);
  return choice != NULL ? choice->name : "";
}

/* ---- for people ---------------------------------------------------------------------------- */

/* Some of the models, which share a table. */
typedef struct block {
  size_t first, count; /* of models */
} block;

enum { BLOCK_COLUMNS = 12 };

/* As many models from `first` on as make a table that people can read. */
static block block_from(const cli_eval_report *report, size_t first) {
  const size_t columns = report->quantity_count * report->channel_count;
  const size_t count = columns < BLOCK_COLUMNS ? BLOCK_COLUMNS / columns : 1;
  const size_t left = report->model_count - first;
  return (block){first, left < count ? left : count};
}

/* Three header rows: the model, the quantity and channel, the unit. */
static void add_profile_header(const cli_eval_report *report, block models, cli_table *table) {
  const char *const first[] = {"", "r", unit_of(report, DIPOLE_RADIUS)};
  const size_t profiles = models.count * report->channel_count;
  for (size_t row = 0; row < sizeof first / sizeof first[0]; row++) {
    cli_table_add(table, "%s", first[row]);
    for (size_t column = 0; column < report->quantity_count * profiles; column++) {
      const dipole_choice *quantity = report->quantities[column / profiles];
      const size_t profile = column % profiles;
      if (row == 0) {
        const size_t model = models.first + profile / report->channel_count;
        cli_table_add(table, "%s", report->models[model].choice->name);
      } else if (row == 1) {
        const char *channel = report->channels[profile % report->channel_count].name;
        cli_table_add(table, "%s %s", quantity->name, channel);
      } else {
        cli_table_add(table, "%s", quantity->about);
      }
    }
  }
}

static void write_profiles(const cli_eval_report *report, block models, FILE *file) {
  const size_t profiles = models.count * report->channel_count;
  const cli_eval_values *values = cli_eval_values_of(report, models.first, 0);
  cli_table table = {.heads = 3, .columns = 1 + report->quantity_count * profiles};
  add_profile_header(report, models, &table);
  for (size_t i = 0; i < report->radius_count; i++) {
    cli_table_add(&table, "%.6g", report->radii[i]);
    for (size_t q = 0; q < report->quantity_count; q++) {
      /* A share of 1 and a logarithm are read best plainly; all else spans many magnitudes. */
      const unsigned id = report->quantities[q]->id;
      const char *format = id == DIPOLE_CDF || id == DIPOLE_LN_R ? "%.6g" : "%.4e";
      for (size_t p = 0; p < profiles; p++) {
        cli_table_add(&table, format, values[p].arrays[q][i]);
      }
    }
  }
  cli_table_print(&table, file);
}

/* What holds for all radii of a model and channel. */
static void write_channels(const cli_eval_report *report, FILE *file) {
  const bool albedo = (report->wanted & DIPOLE_ALBEDO) != 0;
  cli_table table = {.heads = 2, .left = 2, .columns = albedo ? 9 : 8};
  const char *const names[] = {"model", "channel", "sigma_a",         "sigma_s",    "g",
                               "eta",   "albedo",  "numerical error", "model error"};
  const char *const units[] = {"", "", "1/mm", "1/mm", "", "", "", "relative, at most", "relative"};
  for (size_t row = 0; row < table.heads; row++) {
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
      if (albedo || i != 6) {
        cli_table_add(&table, "%s", row == 0 ? names[i] : units[i]);
      }
    }
  }
  for (size_t i = 0; i < report->model_count * report->channel_count; i++) {
    const cli_eval_values *values = &report->values[i];
    const cli_channel *channel = &report->channels[i % report->channel_count];
    cli_table_add(&table, "%s", report->models[i / report->channel_count].choice->name);
    cli_table_add(&table, "%s", channel->name);
    cli_table_add(&table, "%.6g", channel->medium.sigma_a_per_mm);
    cli_table_add(&table, "%.6g", channel->medium.sigma_s_per_mm);
    cli_table_add(&table, "%.6g", channel->medium.g);
    cli_table_add(&table, "%.6g", channel->medium.eta);
    if (albedo) {
      cli_table_add(&table, "%.6g", values->albedo);
    }
    cli_table_add(&table, "%.1e", cli_eval_numerical_error(values, cli_eval_radius_max(report)));
    if (isnan(values->model_error)) {
      cli_table_add(&table, "not measured");
    } else {
      cli_table_add(&table, "%.1e", values->model_error);
    }
  }
  cli_table_print(&table, file);
}

/* " (classical, better)": the models that a note is about; " (all but single)" when those are most;
 * nothing when those are all. */
static void write_noted(const cli_eval_report *report, const dipole_choice *note, size_t noted,
                        FILE *file) {
  const bool most = noted > report->model_count / 2;
  const char *before = most ? " (all but " : " (";
  if (noted == report->model_count) {
    return;
  }
  for (size_t i = 0; i < report->model_count; i++) {
    if (cli_eval_is_noted(&report->models[i], note) != most) {
      fprintf(file, "%s%s", before, report->models[i].choice->name);
      before = ", ";
    }
  }
  fputc(')', file);
}

/* "note: NAME: what it says" */
static void write_notes(const cli_eval_report *report, FILE *file) {
  const dipole_choice *note;
  for (size_t from = 0; (note = cli_next_choice(report->info, DIPOLE_NOTE, &from)) != NULL;) {
    size_t noted = 0;
    for (size_t i = 0; i < report->model_count; i++) {
      noted += cli_eval_is_noted(&report->models[i], note);
    }
    if (noted > 0) {
      fprintf(file, "note: %s: %s", note->name, note->about);
      write_noted(report, note, noted, file);
      fputc('\n', file);
    }
  }
}

static void write_title(const cli_eval_report *report, FILE *file) {
  char text[CLI_NUMBER_BYTES];
  fprintf(file, "%s%sR in %s; evaluator %s, moments %s",
          report->medium != NULL ? report->medium : "", report->medium != NULL ? ": " : "",
          report->info->R_unit, report->evaluator->name, report->moments->name);
  for (size_t i = 0; i < report->parameters.count; i++) {
    const dipole_parameter *parameter = &report->parameters.items[i];
    fprintf(file, ", %s %s", parameter_name(report, parameter->id),
            cli_number_format(parameter->value, text));
  }
  fputs("\n\n", file);
}

void cli_eval_write_table(const cli_eval_report *report, FILE *file) {
  write_title(report, file);
  for (size_t first = 0; report->quantity_count > 0 && first < report->model_count;) {
    const block models = block_from(report, first);
    write_profiles(report, models, file);
    fputc('\n', file);
    first += models.count;
  }
  write_channels(report, file);
  if (cli_eval_radius_max(report) > 0) {
    fprintf(file, "numerical error: against the model's formula, up to r = %.6g mm\n",
            cli_eval_radius_max(report));
  }
  fputs("model error: of the model against radiative transport\n", file);
  write_notes(report, file);
  cli_eval_write_chosen(report, file);
}

/* ---- CSV ----------------------------------------------------------------------------------- */

/* A cell and the comma before it. What is not there, NaN, is an empty cell. */
static void write_cell(FILE *file, double value) {
  char text[CLI_NUMBER_BYTES];
  fprintf(file, ",%s", isnan(value) ? "" : cli_number_format(value, text));
}

/* The names of a model's notes, with blanks between them. */
static void write_csv_notes(const cli_eval_report *report, const cli_eval_model *model,
                            FILE *file) {
  const dipole_choice *note;
  const char *before = ",";
  for (size_t from = 0; (note = cli_next_choice(report->info, DIPOLE_NOTE, &from)) != NULL;) {
    if (cli_eval_is_noted(model, note)) {
      fprintf(file, "%s%s", before, note->name);
      before = " ";
    }
  }
  fputs(before[0] == ',' ? before : "", file);
}

/* R and cdf have columns of their own whether wanted or not; other quantities follow when wanted.
 */
static bool is_appended(const dipole_choice *quantity) {
  return quantity->id != DIPOLE_R && quantity->id != DIPOLE_CDF;
}

static double value_at(const double *array, bool any, size_t radius) {
  return any && array != NULL ? array[radius] : NAN;
}

static void write_csv_row(const cli_eval_report *report, size_t model, size_t channel_index,
                          size_t radius, FILE *file) {
  const cli_eval_values *values = cli_eval_values_of(report, model, channel_index);
  const cli_channel *channel = &report->channels[channel_index];
  const bool any = radius < report->radius_count;
  const double r_mm = any ? report->radii[radius] : NAN;
  fprintf(file, "%s,%s", report->models[model].choice->name, channel->name);
  write_cell(file, channel->medium.sigma_a_per_mm);
  write_cell(file, channel->medium.sigma_s_per_mm);
  write_cell(file, channel->medium.g);
  write_cell(file, channel->medium.eta);
  write_cell(file, r_mm);
  write_cell(file, value_at(cli_eval_array(report, values, DIPOLE_R), any, radius));
  write_cell(file, values->albedo);
  write_cell(file, value_at(cli_eval_array(report, values, DIPOLE_CDF), any, radius));
  write_cell(file, cli_eval_numerical_error(values, any ? r_mm : 0));
  write_cell(file, values->model_error);
  write_csv_notes(report, &report->models[model], file);
  for (size_t q = 0; q < report->quantity_count; q++) {
    if (is_appended(report->quantities[q])) {
      write_cell(file, value_at(values->arrays[q], any, radius));
    }
  }
  if (cli_eval_is_chosen(report)) {
    fprintf(file, ",%s", report->evaluator->name);
  }
  fputc('\n', file);
}

void cli_eval_write_csv(const cli_eval_report *report, FILE *file) {
  /* Without radii (only the albedo was wanted) there is one row for each model and channel. */
  const size_t rows = report->radius_count > 0 ? report->radius_count : 1;
  fputs("model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,cdf,numerical_error,model_error,notes",
        file);
  for (size_t q = 0; q < report->quantity_count; q++) {
    if (is_appended(report->quantities[q])) {
      fprintf(file, ",%s", report->quantities[q]->name);
    }
  }
  /* Where it was chosen, it is not known beforehand. */
  fputs(cli_eval_is_chosen(report) ? ",evaluator\n" : "\n", file);
  for (size_t model = 0; model < report->model_count; model++) {
    for (size_t channel = 0; channel < report->channel_count; channel++) {
      for (size_t radius = 0; radius < rows; radius++) {
        write_csv_row(report, model, channel, radius, file);
      }
    }
  }
}

/* ---- JSON ---------------------------------------------------------------------------------- */

static void write_json_units(cli_json *json, const cli_eval_report *report) {
  cli_json_begin(json, "units", '{');
  cli_json_text(json, "sigma_a", "1/mm");
  cli_json_text(json, "sigma_s", "1/mm");
  cli_json_text(json, "r", unit_of(report, DIPOLE_RADIUS));
  cli_json_text(json, "R", report->info->R_unit);
  cli_json_text(json, "albedo", unit_of(report, DIPOLE_ALBEDO));
  cli_json_text(json, "cdf", unit_of(report, DIPOLE_CDF));
  for (size_t q = 0; q < report->quantity_count; q++) {
    if (is_appended(report->quantities[q])) {
      cli_json_text(json, report->quantities[q]->name, report->quantities[q]->about);
    }
  }
  cli_json_end(json, '}');
}

static void write_json_parameters(cli_json *json, const cli_eval_report *report) {
  cli_json_begin(json, "parameters", '{');
  for (size_t i = 0; i < report->parameters.count; i++) {
    const dipole_parameter *parameter = &report->parameters.items[i];
    cli_json_number(json, parameter_name(report, parameter->id), parameter->value);
  }
  cli_json_end(json, '}');
}

static void write_json_channel(cli_json *json, const cli_eval_report *report, size_t model,
                               size_t index) {
  const cli_eval_values *values = cli_eval_values_of(report, model, index);
  const cli_channel *channel = &report->channels[index];
  cli_json_begin(json, NULL, '{');
  cli_json_text(json, "channel", channel->name);
  cli_json_number(json, "sigma_a", channel->medium.sigma_a_per_mm);
  cli_json_number(json, "sigma_s", channel->medium.sigma_s_per_mm);
  cli_json_number(json, "g", channel->medium.g);
  cli_json_number(json, "eta", channel->medium.eta);
  cli_json_number(json, "numerical_error", values->numerical_error);
  cli_json_number(json, "numerical_error_per_mm", values->numerical_error_per_mm);
  cli_json_number(json, "model_error", values->model_error);
  if ((report->wanted & DIPOLE_ALBEDO) != 0) {
    cli_json_number(json, "albedo", values->albedo);
  }
  for (size_t q = 0; q < report->quantity_count; q++) {
    cli_json_numbers(json, report->quantities[q]->name, values->arrays[q], report->radius_count);
  }
  cli_json_end(json, '}');
}

static void write_json_model(cli_json *json, const cli_eval_report *report, size_t index) {
  const cli_eval_model *model = &report->models[index];
  const dipole_choice *note;
  cli_json_begin(json, NULL, '{');
  cli_json_text(json, "model", model->choice->name);
  cli_json_text(json, "source", model->choice->about);
  cli_json_begin(json, "notes", '[');
  for (size_t from = 0; (note = cli_next_choice(report->info, DIPOLE_NOTE, &from)) != NULL;) {
    if (cli_eval_is_noted(model, note)) {
      cli_json_text(json, NULL, note->name);
    }
  }
  cli_json_end(json, ']');
  cli_json_begin(json, "channels", '[');
  for (size_t channel = 0; channel < report->channel_count; channel++) {
    write_json_channel(json, report, index, channel);
  }
  cli_json_end(json, ']');
  cli_json_end(json, '}');
}

void cli_eval_write_json(const cli_eval_report *report, FILE *file) {
  cli_json json = {.file = file};
  cli_json_begin(&json, NULL, '{');
  cli_json_text(&json, "software", report->info->software);
  cli_json_text(&json, "instruction_set", report->info->instruction_set);
  if (report->medium != NULL) {
    cli_json_text(&json, "medium", report->medium);
  }
  cli_json_text(&json, "evaluator", report->evaluator->name);
  cli_json_text(&json, "moments", report->moments->name);
  write_json_parameters(&json, report);
  cli_eval_write_chosen_json(report, &json);
  write_json_units(&json, report);
  cli_json_numbers(&json, "r", report->radii, report->radius_count);
  cli_json_begin(&json, "models", '[');
  for (size_t model = 0; model < report->model_count; model++) {
    write_json_model(&json, report, model);
  }
  cli_json_end(&json, ']');
  cli_json_end(&json, '}');
}
