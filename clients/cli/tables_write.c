/* Tables for people, as CSV and as JSON. */
#include <math.h>
#include <string.h>

#include "clients/cli/json.h"
#include "clients/cli/number.h"
#include "clients/cli/table.h"
#include "clients/cli/tables.h"

/* The words, as proto/PROTOCOL.md has them. */
enum { WORDS_BEFORE_PIECES = 784, PIECE_WORDS = 4, MANTISSA_BITS = 23 };

/* An entry of an octave that has no pieces: the first piece of all, uncut. */
enum { ENTRY_OUTSIDE = MANTISSA_BITS };

static const char *const constants[] = {
    "pieces_from", "pieces_to", "scale",    "ring_scale",  "pdf_scale",
    "near_power",  "near_R",    "near_log", "near_cdf",    "near_cdf_log",
    "far",         "limit",     "first_u",  "near_radius",
};

enum { CONSTANTS = sizeof constants / sizeof constants[0] };

/* A function in pieces: its entries, by the exponent of its argument. */
static const struct {
  const char *name;
  size_t entries, count;
} functions[] = {{"R", 16, 256},
                 {"cdf", 272, 256},
                 {"radius_of_u", 528, 128},
                 {"radius_of_1_minus_u", 656, 128}};

static size_t count_pieces(const dipole_table_info *info) {
  return (info->word_count - WORDS_BEFORE_PIECES) / PIECE_WORDS;
}

static double number_of(uint32_t word) {
  float number;
  memcpy(&number, &word, sizeof number);
  return (double)number;
}

/* ---- for people ---------------------------------------------------------------------------- */

static void write_title(const cli_tables_report *report, FILE *file) {
  char text[CLI_NUMBER_BYTES];
  fprintf(file, "%s%stables of %s, moments %s",
          report->channels.medium != NULL ? report->channels.medium : "",
          report->channels.medium != NULL ? ": " : "", report->model->name, report->moments->name);
  for (size_t i = 0; i < report->parameters.count; i++) {
    const dipole_parameter *parameter = &report->parameters.items[i];
    const dipole_choice *choice = cli_choice_of_id(report->info, DIPOLE_PARAMETER, parameter->id);
    fprintf(file, ", %s %s", choice != NULL ? choice->name : "",
            cli_number_format(parameter->value, text));
  }
  fputs("\n\n", file);
}

static void add_row(const cli_tables_report *report, size_t index, cli_table *table) {
  const dipole_table_info *info = dipole_table_get_info(report->tables.items[index]);
  size_t bytes;
  dipole_table_bytes(report->tables.items[index], &bytes);
  cli_table_add(table, "%s", report->channels.items[index].name);
  cli_table_add(table, "%.6g", info->medium.sigma_a_per_mm);
  cli_table_add(table, "%.6g", info->medium.sigma_s_per_mm);
  cli_table_add(table, "%.6g", info->medium.g);
  cli_table_add(table, "%.6g", info->medium.eta);
  cli_table_add(table, "%.6g", info->albedo);
  cli_table_add(table, "%.4g", info->pieces_from_mm);
  cli_table_add(table, "%.4g", info->pieces_to_mm);
  cli_table_add(table, "%zu", count_pieces(info));
  cli_table_add(table, "%zu", bytes);
  cli_table_add(table, "%.1e", info->numerical_error);
  if (isnan(info->model_error)) {
    cli_table_add(table, "not measured");
  } else {
    cli_table_add(table, "%.1e", info->model_error);
  }
}

static void write_notes(const cli_tables_report *report, FILE *file) {
  const dipole_choice *note;
  unsigned notes = 0;
  for (size_t i = 0; i < report->tables.count; i++) {
    notes |= dipole_table_get_info(report->tables.items[i])->notes;
  }
  for (size_t from = 0; (note = cli_next_choice(report->info, DIPOLE_NOTE, &from)) != NULL;) {
    if (cli_is_noted(notes, note)) {
      fprintf(file, "note: %s: %s\n", note->name, note->about);
    }
  }
}

void cli_tables_write_table(const cli_tables_report *report, FILE *file) {
  static const char *const head[] = {"channel",
                                     "sigma_a",
                                     "sigma_s",
                                     "g",
                                     "eta",
                                     "albedo",
                                     "pieces from",
                                     "to",
                                     "pieces",
                                     "bytes",
                                     "numerical error",
                                     "model error",
                                     "",
                                     "1/mm",
                                     "1/mm",
                                     "",
                                     "",
                                     "",
                                     "mm",
                                     "mm",
                                     "",
                                     "",
                                     "relative, at most",
                                     "relative"};
  cli_table table = {.heads = 2, .left = 1, .columns = sizeof head / sizeof head[0] / 2};
  for (size_t i = 0; i < sizeof head / sizeof head[0]; i++) {
    cli_table_add(&table, "%s", head[i]);
  }
  for (size_t i = 0; i < report->tables.count; i++) {
    add_row(report, i, &table);
  }
  write_title(report, file);
  cli_table_print(&table, file);
  fputs("numerical error: of R and cdf against the model's formula, as measured\n"
        "model error: of the model against radiative transport\n",
        file);
  write_notes(report, file);
}

/* ---- CSV ----------------------------------------------------------------------------------- */

/* Nine digits: as many as it takes to get back a number in single precision. */
static void write_cell(FILE *file, double value) {
  fprintf(file, ",%.9g", value);
}

static void write_csv_piece(const char *channel, const char *function, double from, double to,
                            const uint32_t *words, FILE *file) {
  const double c0 = number_of(words[0]);
  fprintf(file, "%s,%s", channel, function);
  write_cell(file, from);
  write_cell(file, to);
  fprintf(file, ",%s", signbit(c0) ? "right" : "left");
  write_cell(file, fabs(c0));
  for (size_t i = 1; i < PIECE_WORDS; i++) {
    write_cell(file, number_of(words[i]));
  }
  fputc('\n', file);
}

/* The pieces of an octave lie side by side. */
static void write_csv_octave(const char *channel, const char *function,
                             const dipole_table_info *info, uint32_t entry, int exponent,
                             FILE *file) {
  const uint32_t pieces = UINT32_C(1) << (MANTISSA_BITS - (entry & 31));
  const uint32_t *words = info->words + WORDS_BEFORE_PIECES + (size_t)(entry >> 5) * PIECE_WORDS;
  const double step = ldexp(1, exponent) / pieces;
  for (uint32_t i = 0; i < pieces; i++) {
    const double from = ldexp(1, exponent) + i * step;
    write_csv_piece(channel, function, from, from + step, words + (size_t)i * PIECE_WORDS, file);
  }
}

static void write_csv_table(const char *channel, const dipole_table_info *info, FILE *file) {
  for (size_t i = 0; i < CONSTANTS; i++) {
    fprintf(file, "%s,%s,,,", channel, constants[i]);
    write_cell(file, number_of(info->words[i]));
    fputs(",,,\n", file);
  }
  for (size_t f = 0; f < sizeof functions / sizeof functions[0]; f++) {
    for (size_t i = 0; i < functions[f].count; i++) {
      const uint32_t entry = info->words[functions[f].entries + i];
      if (entry != ENTRY_OUTSIDE) {
        write_csv_octave(channel, functions[f].name, info, entry, (int)i - 127, file);
      }
    }
  }
}

void cli_tables_write_csv(const cli_tables_report *report, FILE *file) {
  fputs("channel,function,from,to,written_from,c0,c1,c2,c3\n", file);
  for (size_t i = 0; i < report->tables.count; i++) {
    write_csv_table(report->channels.items[i].name, dipole_table_get_info(report->tables.items[i]),
                    file);
  }
}

/* ---- JSON ---------------------------------------------------------------------------------- */

static void write_json_notes(cli_json *json, const cli_tables_report *report, unsigned notes) {
  const dipole_choice *note;
  cli_json_begin(json, "notes", '[');
  for (size_t from = 0; (note = cli_next_choice(report->info, DIPOLE_NOTE, &from)) != NULL;) {
    if (cli_is_noted(notes, note)) {
      cli_json_text(json, NULL, note->name);
    }
  }
  cli_json_end(json, ']');
}

static void write_json_table(cli_json *json, const cli_tables_report *report, size_t index) {
  const dipole_table_info *info = dipole_table_get_info(report->tables.items[index]);
  cli_json_begin(json, NULL, '{');
  cli_json_text(json, "channel", report->channels.items[index].name);
  cli_json_number(json, "sigma_a", info->medium.sigma_a_per_mm);
  cli_json_number(json, "sigma_s", info->medium.sigma_s_per_mm);
  cli_json_number(json, "g", info->medium.g);
  cli_json_number(json, "eta", info->medium.eta);
  cli_json_number(json, "albedo", info->albedo);
  cli_json_number(json, "numerical_error", info->numerical_error);
  cli_json_number(json, "numerical_error_per_mm", info->numerical_error_per_mm);
  cli_json_number(json, "model_error", info->model_error);
  write_json_notes(json, report, info->notes);
  cli_json_number(json, "pieces_from", info->pieces_from_mm);
  cli_json_number(json, "pieces_to", info->pieces_to_mm);
  cli_json_number(json, "radius_least", info->radius_least_mm);
  cli_json_number(json, "radius_most", info->radius_most_mm);
  cli_json_count(json, "pieces", count_pieces(info));
  cli_json_count(json, "layout", info->layout);
  cli_json_counts(json, "words", info->words, info->word_count);
  cli_json_end(json, '}');
}

static void write_json_units(cli_json *json) {
  static const char *const units[][2] = {{"sigma_a", "1/mm"},    {"sigma_s", "1/mm"},
                                         {"pieces_from", "mm"},  {"pieces_to", "mm"},
                                         {"radius_least", "mm"}, {"radius_most", "mm"}};
  cli_json_begin(json, "units", '{');
  for (size_t i = 0; i < sizeof units / sizeof units[0]; i++) {
    cli_json_text(json, units[i][0], units[i][1]);
  }
  cli_json_end(json, '}');
}

void cli_tables_write_json(const cli_tables_report *report, FILE *file) {
  cli_json json = {.file = file};
  cli_json_begin(&json, NULL, '{');
  cli_json_text(&json, "software", report->info->software);
  cli_json_text(&json, "instruction_set", report->info->instruction_set);
  if (report->channels.medium != NULL) {
    cli_json_text(&json, "medium", report->channels.medium);
  }
  cli_json_text(&json, "model", report->model->name);
  cli_json_text(&json, "source", report->model->about);
  cli_json_text(&json, "moments", report->moments->name);
  cli_json_begin(&json, "parameters", '{');
  for (size_t i = 0; i < report->parameters.count; i++) {
    const dipole_parameter *parameter = &report->parameters.items[i];
    const dipole_choice *choice = cli_choice_of_id(report->info, DIPOLE_PARAMETER, parameter->id);
    cli_json_number(&json, choice != NULL ? choice->name : "", parameter->value);
  }
  cli_json_end(&json, '}');
  write_json_units(&json);
  cli_json_begin(&json, "tables", '[');
  for (size_t i = 0; i < report->tables.count; i++) {
    write_json_table(&json, report, i);
  }
  cli_json_end(&json, ']');
  cli_json_end(&json, '}');
}
