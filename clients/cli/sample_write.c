/* The report of `dipole sample` as a table for people, as CSV and as JSON. */
#include <math.h>
#include <stdlib.h>

#include "clients/cli/json.h"
#include "clients/cli/number.h"
#include "clients/cli/sample.h"
#include "clients/cli/table.h"

static bool has_albedo(const cli_sample_report *report) {
  return (report->query.wanted & DIPOLE_ALBEDO) != 0;
}

static const dipole_channel *channel_of(const cli_sample_report *report, size_t channel) {
  return &report->result->channels[channel];
}

/* ---- for people ----------------------------------------------------------------------------- */

static void write_title(const cli_sample_report *report, FILE *file) {
  char text[CLI_NUMBER_BYTES];
  const dipole_sample_query *query = &report->query;
  fprintf(file, "%s%sradii drawn of the model %s; evaluator %s, moments %s",
          report->medium != NULL ? report->medium : "", report->medium != NULL ? ": " : "",
          report->model->name, report->evaluator->name, report->moments->name);
  for (size_t i = 0; i < report->parameters.count; i++) {
    const dipole_parameter *parameter = &report->parameters.items[i];
    const dipole_choice *choice = cli_choice_of_id(report->info, DIPOLE_PARAMETER, parameter->id);
    fprintf(file, ", %s %s", choice != NULL ? choice->name : "",
            cli_number_format(parameter->value, text));
  }
  fprintf(file, "\nnumbers: %s", report->draw->name);
  if (query->seed != 0) {
    fprintf(file, ", seed %llu", (unsigned long long)query->seed);
  }
  if (query->sample_first != 0) {
    fprintf(file, ", from number %llu on", (unsigned long long)query->sample_first);
  }
  fputs("\n\n", file);
}

/* Two header rows: the quantity and channel, the unit. */
static void write_samples(const cli_sample_report *report, FILE *file) {
  const size_t columns = report->quantity_count * report->channel_count;
  cli_table table = {.heads = 2, .columns = 1 + columns};
  for (size_t row = 0; row < table.heads; row++) {
    cli_table_add(&table, "%s", row == 0 ? "u" : "");
    for (size_t i = 0; i < columns; i++) {
      const dipole_choice *quantity = report->quantities[i / report->channel_count];
      const char *channel = report->channels[i % report->channel_count].name;
      if (row == 0) {
        cli_table_add(&table, "%s %s", quantity->name, channel);
      } else {
        cli_table_add(&table, "%s", quantity->about);
      }
    }
  }
  for (size_t index = 0; index < report->count; index++) {
    cli_table_add(&table, "%.6g", report->u[index]);
    for (size_t i = 0; i < columns; i++) {
      const unsigned id = report->quantities[i / report->channel_count]->id;
      const bool plain = id == DIPOLE_RADIUS || id == DIPOLE_CDF || id == DIPOLE_LN_R;
      cli_table_add(&table, plain ? "%.6g" : "%.4e",
                    cli_sample_value(report, i % report->channel_count, id, index));
    }
  }
  cli_table_print(&table, file);
}

static void write_channels(const cli_sample_report *report, FILE *file) {
  const bool albedo = has_albedo(report);
  cli_table table = {.heads = 2, .left = 1, .columns = albedo ? 7 : 6};
  const char *const heads[][7] = {
      {"channel", "sigma_a", "sigma_s", "g", "eta", "model error", "albedo"},
      {"", "1/mm", "1/mm", "", "", "relative", ""},
  };
  for (size_t i = 0; i < table.heads * table.columns; i++) {
    cli_table_add(&table, "%s", heads[i / table.columns][i % table.columns]);
  }
  for (size_t i = 0; i < report->channel_count; i++) {
    const dipole_medium *medium = &report->channels[i].medium;
    const dipole_channel *channel = channel_of(report, i);
    cli_table_add(&table, "%s", report->channels[i].name);
    cli_table_add(&table, "%.6g", medium->sigma_a_per_mm);
    cli_table_add(&table, "%.6g", medium->sigma_s_per_mm);
    cli_table_add(&table, "%.6g", medium->g);
    cli_table_add(&table, "%.6g", medium->eta);
    if (isnan(channel->model_error)) {
      cli_table_add(&table, "not measured");
    } else {
      cli_table_add(&table, "%.1e", channel->model_error);
    }
    if (albedo) {
      cli_table_add(&table, "%.6g", channel->albedo);
    }
  }
  cli_table_print(&table, file);
}

void cli_sample_write_table(const cli_sample_report *report, FILE *file) {
  const dipole_choice *note;
  write_title(report, file);
  if (report->quantity_count > 0) {
    write_samples(report, file);
    fputc('\n', file);
  }
  write_channels(report, file);
  for (size_t from = 0; (note = cli_next_choice(report->info, DIPOLE_NOTE, &from)) != NULL;) {
    if (cli_is_noted(report->result->notes, note)) {
      fprintf(file, "note: %s: %s\n", note->name, note->about);
    }
  }
}

/* ---- CSV ------------------------------------------------------------------------------------ */

/* A cell and the comma before it. What is not there, NaN, is an empty cell. */
static void write_cell(FILE *file, double value) {
  char text[CLI_NUMBER_BYTES];
  fprintf(file, ",%s", isnan(value) ? "" : cli_number_format(value, text));
}

void cli_sample_write_csv(const cli_sample_report *report, FILE *file) {
  fputs("model,channel,sigma_a,sigma_s,g,eta,u", file);
  for (size_t q = 0; q < report->quantity_count; q++) {
    fprintf(file, ",%s", report->quantities[q]->name);
  }
  fputs(has_albedo(report) ? ",albedo\n" : "\n", file);
  for (size_t channel = 0; channel < report->channel_count; channel++) {
    const dipole_medium *medium = &report->channels[channel].medium;
    for (size_t i = 0; i < report->count; i++) {
      fprintf(file, "%s,%s", report->model->name, report->channels[channel].name);
      write_cell(file, medium->sigma_a_per_mm);
      write_cell(file, medium->sigma_s_per_mm);
      write_cell(file, medium->g);
      write_cell(file, medium->eta);
      write_cell(file, report->u[i]);
      for (size_t q = 0; q < report->quantity_count; q++) {
        write_cell(file, cli_sample_value(report, channel, report->quantities[q]->id, i));
      }
      if (has_albedo(report)) {
        write_cell(file, channel_of(report, channel)->albedo);
      }
      fputc('\n', file);
    }
  }
}

/* ---- JSON ----------------------------------------------------------------------------------- */

static void write_json_channel(cli_json *json, const cli_sample_report *report, size_t index,
                               double *values) {
  const dipole_medium *medium = &report->channels[index].medium;
  const dipole_channel *channel = channel_of(report, index);
  cli_json_begin(json, NULL, '{');
  cli_json_text(json, "channel", report->channels[index].name);
  cli_json_number(json, "sigma_a", medium->sigma_a_per_mm);
  cli_json_number(json, "sigma_s", medium->sigma_s_per_mm);
  cli_json_number(json, "g", medium->g);
  cli_json_number(json, "eta", medium->eta);
  cli_json_number(json, "numerical_error", channel->numerical_error);
  cli_json_number(json, "numerical_error_per_mm", channel->numerical_error_per_mm);
  cli_json_number(json, "model_error", channel->model_error);
  if (has_albedo(report)) {
    cli_json_number(json, "albedo", channel->albedo);
  }
  for (size_t q = 0; q < report->quantity_count; q++) {
    for (size_t i = 0; i < report->count; i++) {
      values[i] = cli_sample_value(report, index, report->quantities[q]->id, i);
    }
    cli_json_numbers(json, report->quantities[q]->name, values, report->count);
  }
  cli_json_end(json, '}');
}

static void write_json_units(cli_json *json, const cli_sample_report *report) {
  cli_json_begin(json, "units", '{');
  cli_json_text(json, "sigma_a", "1/mm");
  cli_json_text(json, "sigma_s", "1/mm");
  cli_json_text(json, "u", "1");
  for (size_t q = 0; q < report->quantity_count; q++) {
    cli_json_text(json, report->quantities[q]->name, report->quantities[q]->about);
  }
  cli_json_end(json, '}');
}

void cli_sample_write_json(const cli_sample_report *report, FILE *file) {
  cli_json json = {.file = file};
  const dipole_choice *note;
  double *values = cli_allocate(report->count, sizeof *values);
  cli_json_begin(&json, NULL, '{');
  cli_json_text(&json, "software", report->info->software);
  cli_json_text(&json, "instruction_set", report->info->instruction_set);
  if (report->medium != NULL) {
    cli_json_text(&json, "medium", report->medium);
  }
  cli_json_text(&json, "model", report->model->name);
  cli_json_text(&json, "evaluator", report->evaluator->name);
  cli_json_text(&json, "moments", report->moments->name);
  cli_json_text(&json, "draw", report->draw->name);
  cli_json_count(&json, "seed", report->query.seed);
  cli_json_count(&json, "first", report->query.sample_first);
  write_json_units(&json, report);
  cli_json_begin(&json, "notes", '[');
  for (size_t from = 0; (note = cli_next_choice(report->info, DIPOLE_NOTE, &from)) != NULL;) {
    if (cli_is_noted(report->result->notes, note)) {
      cli_json_text(&json, NULL, note->name);
    }
  }
  cli_json_end(&json, ']');
  cli_json_numbers(&json, "u", report->u, report->count);
  cli_json_begin(&json, "channels", '[');
  for (size_t channel = 0; channel < report->channel_count; channel++) {
    write_json_channel(&json, report, channel, values);
  }
  cli_json_end(&json, ']');
  cli_json_end(&json, '}');
  free(values);
}
