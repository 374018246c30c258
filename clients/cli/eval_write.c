/* Writes the report of `dipole eval` as a table for people, as CSV and as JSON. */
#include <math.h>

#include "clients/cli/daemon.h"
#include "clients/cli/eval.h"
#include "clients/cli/rows.h"

static const char *unit_of(const cli_eval_report *report, unsigned quantity) {
  const dipole_choice *choice = cli_choice_of_id(report->profile.info, DIPOLE_QUANTITY, quantity);
  return choice != NULL ? choice->about : "";
}

static bool has_albedo(const cli_eval_report *report) {
  return (report->quantities.wanted & DIPOLE_ALBEDO) != 0;
}

/* ---- for people ---------------------------------------------------------------------------- */

/* A run of models that are written side by side in one table. */
typedef struct block {
  const cli_eval_report *report;
  size_t first, count; /* of models */
} block;

enum { BLOCK_COLUMNS = 12 };

/* Takes as many models from `first` on as make a table that people can read. */
static block block_from(const cli_eval_report *report, size_t first) {
  const size_t columns = report->quantities.count * report->profile.channel_count;
  const size_t count = columns < BLOCK_COLUMNS ? BLOCK_COLUMNS / columns : 1;
  const size_t left = report->model_count - first;
  return (block){report, first, left < count ? left : count};
}

/* Puts a radius, and the values of all quantities, models and channels there. */
static void put_radius(cli_rows *rows, const void *context, size_t index) {
  const block *of = context;
  const cli_eval_report *report = of->report;
  const size_t channels = report->profile.channel_count;
  cli_put_number(rows, CLI_COLUMN("r", .unit = unit_of(report, DIPOLE_RADIUS)),
                 rows->pass == CLI_ROWS_VALUES ? report->radii[index] : 0);
  for (size_t q = 0; q < report->quantities.count; q++) {
    const dipole_choice *quantity = report->quantities.items[q];
    /* A share of 1 and a logarithm are read best plainly; all else spans many magnitudes. */
    const bool plain = quantity->id == DIPOLE_CDF || quantity->id == DIPOLE_LN_R;
    for (size_t p = 0; p < of->count * channels; p++) {
      const size_t model = of->first + p / channels, channel = p % channels;
      char head[128];
      snprintf(head, sizeof head, "%s %s", quantity->name, report->profile.channels[channel].name);
      cli_put_number(rows,
                     CLI_COLUMN(head, .unit = quantity->about, .format = plain ? "%.6g" : "%.4e",
                                .over = report->models[model].choice->name),
                     rows->pass == CLI_ROWS_VALUES
                         ? cli_eval_values_of(report, model, channel)->arrays[q][index]
                         : 0);
    }
  }
}

/* Puts what holds for all radii of a model and channel; in JSON also the values at all radii. */
static void put_channel(cli_rows *rows, const void *context, size_t index) {
  const cli_eval_report *report = context;
  const size_t channels = report->profile.channel_count;
  const cli_eval_values *values = &report->values[index];
  const cli_channel *channel = &report->profile.channels[index % channels];
  const bool albedo = has_albedo(report);
  cli_put_text(rows, CLI_COLUMN("model", .forms = CLI_IN_TABLE),
               report->models[index / channels].choice->name);
  cli_put_text(rows, CLI_COLUMN("channel"), channel->name);
  cli_put_medium(rows, &channel->medium);
  if (albedo && rows->form == CLI_TABLE) {
    cli_put_number(rows, CLI_COLUMN("albedo"), values->albedo);
  }
  cli_put_number(
      rows, CLI_COLUMN("numerical error", NULL, "relative, at most", "%.1e", .forms = CLI_IN_TABLE),
      cli_eval_numerical_error(values, cli_eval_radius_max(report)));
  cli_put_number(rows, CLI_COLUMN("numerical_error", .forms = CLI_IN_JSON),
                 values->numerical_error);
  cli_put_number(rows, CLI_COLUMN("numerical_error_per_mm", .forms = CLI_IN_JSON),
                 values->numerical_error_per_mm);
  cli_put_number(rows, CLI_COLUMN("model_error", "model error", "relative", "%.1e", "not measured"),
                 values->model_error);
  if (albedo && rows->form == CLI_JSON) {
    cli_put_number(rows, CLI_COLUMN("albedo"), values->albedo);
  }
  for (size_t q = 0; rows->form == CLI_JSON && q < report->quantities.count; q++) {
    cli_json_numbers(rows->json, report->quantities.items[q]->name, values->arrays[q],
                     report->radius_count);
  }
}

static bool is_noted(const cli_eval_model *model, const dipole_choice *note) {
  return (model->notes & note->id) == note->id;
}

/* " (classical, better)": the models that a note is about; " (all but single)" if those are most;
 * nothing if those are all. */
static void write_noted(const cli_eval_report *report, const dipole_choice *note) {
  size_t noted = 0;
  for (size_t i = 0; i < report->model_count; i++) {
    noted += is_noted(&report->models[i], note);
  }
  const bool most = noted > report->model_count / 2;
  const char *before = most ? " (all but " : " (";
  for (size_t i = 0; noted < report->model_count && i < report->model_count; i++) {
    if (is_noted(&report->models[i], note) != most) {
      printf("%s%s", before, report->models[i].choice->name);
      before = ", ";
    }
  }
  puts(noted < report->model_count ? ")" : "");
}

/* Writes "note: NAME: what it says" for each note. */
static void write_notes(const cli_eval_report *report) {
  const dipole_choice *note;
  for (size_t from = 0;
       (note = cli_next_choice(report->profile.info, DIPOLE_NOTE, &from)) != NULL;) {
    bool noted = false;
    for (size_t i = 0; i < report->model_count; i++) {
      noted = noted || (note->id != 0 && is_noted(&report->models[i], note));
    }
    if (noted) {
      printf("note: %s: %s", note->name, note->about);
      write_noted(report, note);
    }
  }
}

static void write_table(const cli_eval_report *report) {
  const cli_profile *profile = &report->profile;
  cli_write_medium(profile, stdout);
  printf("R in %s; evaluator %s, moments %s", profile->info->R_unit, profile->evaluator->name,
         profile->moments->name);
  cli_write_parameters(profile, stdout);
  fputs("\n\n", stdout);
  for (size_t first = 0; report->quantities.count > 0 && first < report->model_count;) {
    const block models = block_from(report, first);
    cli_rows_print(stdout, 0, report->radius_count, put_radius, &models);
    putchar('\n');
    first += models.count;
  }
  cli_rows_print(stdout, 2, report->model_count * profile->channel_count, put_channel, report);
  if (cli_eval_radius_max(report) > 0) {
    printf("numerical error: against the model's formula, up to r = %.6g mm\n",
           cli_eval_radius_max(report));
  }
  puts("model error: of the model against radiative transport");
  write_notes(report);
  cli_eval_write_chosen(report, stdout);
}

/* ---- CSV ----------------------------------------------------------------------------------- */

/* Writes the names of a model's notes with blanks between them. */
static const char *join_notes(const cli_profile *profile, unsigned notes, char *text,
                              size_t bytes) {
  const dipole_choice *note;
  size_t length = 0;
  text[0] = '\0';
  for (size_t from = 0; length < bytes && (note = cli_next_note(profile->info, notes, &from));) {
    length +=
        (size_t)snprintf(text + length, bytes - length, "%s%s", length > 0 ? " " : "", note->name);
  }
  return text;
}

/* R and cdf have columns of their own whether wanted or not; other quantities follow if wanted. */
static bool is_appended(const dipole_choice *quantity) {
  return quantity->id != DIPOLE_R && quantity->id != DIPOLE_CDF;
}

/* Without radii, when only the albedo was wanted, there is one row for each model and channel. */
static size_t rows_of_channel(const cli_eval_report *report) {
  return report->radius_count > 0 ? report->radius_count : 1;
}

/* Puts the values of a model and channel at a radius. */
static void put_value(cli_rows *rows, const void *context, size_t index) {
  const cli_eval_report *report = context;
  const size_t profile = index / rows_of_channel(report), radius = index % rows_of_channel(report);
  const cli_eval_model *model = &report->models[profile / report->profile.channel_count];
  const cli_channel *channel = &report->profile.channels[profile % report->profile.channel_count];
  const cli_eval_values *values = &report->values[profile];
  const bool any = report->radius_count > 0;
  const double *R = any ? cli_eval_array(report, values, DIPOLE_R) : NULL;
  const double *cdf = any ? cli_eval_array(report, values, DIPOLE_CDF) : NULL;
  const double r_mm = any ? report->radii[radius] : (double)NAN;
  char notes[256];
  cli_put_text(rows, CLI_COLUMN("model"), model->choice->name);
  cli_put_text(rows, CLI_COLUMN("channel"), channel->name);
  cli_put_medium(rows, &channel->medium);
  cli_put_number(rows, CLI_COLUMN("r"), r_mm);
  cli_put_number(rows, CLI_COLUMN("R"), R != NULL ? R[radius] : (double)NAN);
  cli_put_number(rows, CLI_COLUMN("albedo"), values->albedo);
  cli_put_number(rows, CLI_COLUMN("cdf"), cdf != NULL ? cdf[radius] : (double)NAN);
  cli_put_number(rows, CLI_COLUMN("numerical_error"),
                 cli_eval_numerical_error(values, any ? r_mm : 0));
  cli_put_number(rows, CLI_COLUMN("model_error"), values->model_error);
  cli_put_text(rows, CLI_COLUMN("notes"),
               join_notes(&report->profile, model->notes, notes, sizeof notes));
  for (size_t q = 0; q < report->quantities.count; q++) {
    if (is_appended(report->quantities.items[q])) {
      cli_put_number(rows, CLI_COLUMN(report->quantities.items[q]->name),
                     any ? values->arrays[q][radius] : (double)NAN);
    }
  }
  if (cli_eval_is_chosen(report)) { /* the user does not know it beforehand */
    cli_put_text(rows, CLI_COLUMN("evaluator"), report->profile.evaluator->name);
  }
}

/* ---- JSON ---------------------------------------------------------------------------------- */

static void put_model(cli_rows *rows, const void *context, size_t index) {
  const cli_eval_report *report = context;
  const cli_eval_model *model = &report->models[index];
  const size_t channels = report->profile.channel_count;
  cli_put_text(rows, CLI_COLUMN("model"), model->choice->name);
  cli_put_text(rows, CLI_COLUMN("source"), model->choice->about);
  cli_json_notes(rows->json, report->profile.info, model->notes);
  cli_json_begin(rows->json, "channels", '[');
  for (size_t channel = 0; channel < channels; channel++) {
    cli_json_begin(rows->json, NULL, '{');
    cli_rows_members(rows->json, put_channel, report, index * channels + channel);
    cli_json_end(rows->json, '}');
  }
  cli_json_end(rows->json, ']');
}

static void write_json(const cli_eval_report *report) {
  const cli_profile *profile = &report->profile;
  cli_json json = {.file = stdout};
  cli_json_begin(&json, NULL, '{');
  cli_json_head(&json, profile);
  cli_json_text(&json, "evaluator", profile->evaluator->name);
  cli_json_text(&json, "moments", profile->moments->name);
  cli_json_parameters(&json, profile);
  cli_eval_write_chosen_json(report, &json);
  cli_json_begin(&json, "units", '{');
  cli_json_text(&json, "sigma_a", "1/mm");
  cli_json_text(&json, "sigma_s", "1/mm");
  cli_json_text(&json, "r", unit_of(report, DIPOLE_RADIUS));
  cli_json_text(&json, "R", profile->info->R_unit);
  cli_json_text(&json, "albedo", unit_of(report, DIPOLE_ALBEDO));
  cli_json_text(&json, "cdf", unit_of(report, DIPOLE_CDF));
  for (size_t q = 0; q < report->quantities.count; q++) {
    if (is_appended(report->quantities.items[q])) {
      cli_json_text(&json, report->quantities.items[q]->name, report->quantities.items[q]->about);
    }
  }
  cli_json_end(&json, '}');
  cli_json_numbers(&json, "r", report->radii, report->radius_count);
  cli_rows_json(&json, "models", report->model_count, put_model, report);
  cli_json_end(&json, '}');
}

void cli_eval_write(const cli_eval_report *report, enum cli_form form) {
  if (form == CLI_TABLE) {
    write_table(report);
  } else if (form == CLI_CSV) {
    cli_rows_csv(stdout, true,
                 report->model_count * report->profile.channel_count * rows_of_channel(report),
                 put_value, report);
  } else if (form == CLI_JSON) {
    write_json(report);
  }
}
