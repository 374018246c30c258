/* The report of `dipole eval` and `dipole sample`, as it is held and as it is written. */
#include <math.h>
#include <stdlib.h>

#include "clients/cli/daemon.h"
#include "clients/cli/eval.h"
#include "clients/cli/rows.h"

/* ---- holding --------------------------------------------------------------------------------- */

void cli_eval_add_model(cli_eval_report *report, const dipole_choice *model, bool named) {
  for (size_t i = 0; i < report->model_count; i++) {
    if (report->models[i].choice == model) {
      report->models[i].named |= named;
      return;
    }
  }
  report->models = cli_resize(report->models, report->model_count + 1, sizeof *report->models);
  report->models[report->model_count++] = (cli_eval_model){.choice = model, .named = named};
}

void cli_eval_make_values(cli_eval_report *report) {
  report->values =
      cli_allocate(report->model_count * report->profile.channel_count, sizeof *report->values);
}

/* Returns the larger number, or NaN if either is NaN. */
static double larger(double a, double b) {
  return isnan(a) || a > b ? a : b;
}

/* Keeps the errors of a part. A list that is asked for in pieces has the largest model error of all. */
static void keep_errors(dipole_errors *kept, dipole_errors part, bool is_first) {
  const double before = kept->model_error;
  *kept = part;
  kept->model_error = is_first ? part.model_error : larger(before, part.model_error);
}

/* Makes room for all places once the daemon has agreed to so many. */
static double *make_room(double *values, size_t count) {
  return values != NULL ? values : cli_allocate(count, sizeof *values);
}

void cli_eval_keep(cli_eval_report *report, size_t model, size_t first, const dipole_result *part) {
  for (uint32_t i = 0; i < part->channel_count; i++) {
    const dipole_channel *channel = &part->channels[i];
    cli_eval_values *values = &report->values[model * report->profile.channel_count + i];
    values->albedo = channel->albedo;
    const dipole_errors all = {channel->numerical_error, channel->numerical_error_per_mm,
                               channel->model_error};
    keep_errors(&values->errors, all, first == 0);
    for (size_t q = 0; q < report->quantities.count; q++) {
      const unsigned id = report->quantities.items[q]->id;
      keep_errors(&values->of_each[q], dipole_errors_of(part, i, id), first == 0);
      const double *f64 = dipole_values_f64(part, i, id);
      const float *f32 = dipole_values_f32(part, i, id);
      if (f64 == NULL && f32 == NULL) {
        continue; /* the albedo */
      }
      values->arrays[q] = make_room(values->arrays[q], report->place_count);
      for (size_t k = 0; k < part->radius_count; k++) {
        values->arrays[q][first + k] = f64 != NULL ? f64[k] : cli_number_of_single(f32[k]);
      }
    }
  }
  report->models[model].notes |= part->notes;
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* Returns what the numerical error of the wanted quantities is: that of ln R and its derivatives is
 * absolute. */
static const char *kind_of_error(const cli_eval_report *report, unsigned wanted) {
  const unsigned absolute = DIPOLE_LN_R | DIPOLE_BY_SIGMA_A | DIPOLE_BY_SIGMA_S;
  return report->place[0] == 'f'     ? "of the albedo, at most"
         : (wanted & absolute) == 0  ? "relative, at most"
         : (wanted & ~absolute) == 0 ? "absolute, at most"
                                     : "relative, of logarithms absolute, at most";
}

/* Returns the unit of the places. */
static const char *unit_of_places(const cli_eval_report *report) {
  return report->place[0] == 'r' ? "mm" : report->place[0] == 'f' ? "1/mm" : "1";
}

/* Returns the radius of a value, for its error: a place or, of drawn radii, the radius itself. */
static double radius_at(const cli_eval_report *report, const cli_eval_values *values, size_t at) {
  size_t q = 0;
  if (report->draw == NULL) {
    return report->place_count > 0 ? report->places[at] : 0;
  }
  while (q < report->quantities.count && report->quantities.items[q]->id != DIPOLE_RADIUS) {
    q++;
  }
  return q < report->quantities.count ? values->arrays[q][at] : (double)NAN;
}

/* Returns the numerical error of the values at a radius. */
static double numerical_error(const dipole_errors *errors, double r_mm) {
  /* 0 times infinity is not a number, but a rate of 0 adds nothing at any radius. */
  return errors->numerical_error +
         (errors->numerical_error_per_mm > 0 ? errors->numerical_error_per_mm * r_mm : 0);
}

enum { RANGE_BYTES = 64 };

/* Writes where the model error holds, such as "from 1 to 2 mm". */
static const char *range_of(const cli_eval_report *report, char text[RANGE_BYTES]) {
  if (report->draw != NULL) {
    return "at drawn radii";
  }
  if (report->place[0] == 'f' || report->place_count == 0) {
    return "relative";
  }
  snprintf(text, RANGE_BYTES, report->least < report->most ? "from %.6g to %.6g mm" : "at %.6g mm",
           report->least, report->most);
  return text;
}

/* Finds what rows say of all places. */
static void survey(cli_eval_report *report) {
  const unsigned diverging = DIPOLE_R | DIPOLE_S | DIPOLE_SLOPE | DIPOLE_LN_R;
  bool compared = false, any = false;
  for (size_t i = 0; i < report->place_count; i++) {
    const double place = report->places[i];
    if (isfinite(place)) {
      report->least = any ? fmin(report->least, place) : place;
      report->most = any ? fmax(report->most, place) : place;
      any = true;
    }
  }
  for (size_t i = 0; i < report->model_count * report->profile.channel_count; i++) {
    compared = compared || report->values[i].errors.model_error != 0;
  }
  report->diverges = any && report->least == 0 && report->draw == NULL && compared &&
                     (report->quantities.wanted & diverging) != 0;
}

/* ---- rows ------------------------------------------------------------------------------------ */

static const dipole_choice *evaluator_of(const cli_eval_report *report, size_t model) {
  return report->models[model].evaluator;
}

/* Puts errors under these names, at r_mm. */
static void put_errors_as(cli_rows *rows, const cli_eval_report *report,
                          const dipole_errors *errors, double r_mm, unsigned forms, unsigned wanted,
                          const char *of) {
  char range[RANGE_BYTES], numerical[64], model[64];
  const char *none = report->diverges && !(report->most > 0) ? "diverges" : "not solved";
  snprintf(numerical, sizeof numerical, "numerical_error%s%s", of[0] != '\0' ? "_" : "", of);
  snprintf(model, sizeof model, "model_error%s%s", of[0] != '\0' ? "_" : "", of);
  cli_put_number(rows,
                 CLI_COLUMN(numerical, "numerical error", NULL, "%.1e", .over = of,
                            .below = kind_of_error(report, wanted), .forms = forms),
                 numerical_error(errors, r_mm));
  cli_put_number(rows,
                 CLI_COLUMN(model, "model error", NULL, "%.1e", none, .over = of,
                            .below = range_of(report, range), .forms = forms),
                 errors->model_error);
}

/* Puts the errors of a model and channel; in a table those of all radii, else those at r_mm. Those of
 * each quantity follow if several have values at places, and stand alone in a table. */
static void put_errors(cli_rows *rows, const cli_eval_report *report, const cli_eval_values *values,
                       double r_mm) {
  const cli_quantities *quantities = &report->quantities;
  const unsigned beside = DIPOLE_ALBEDO | DIPOLE_RADIUS | DIPOLE_MODEL_ERRORS;
  const bool several = __builtin_popcount(quantities->wanted & ~beside) > 1;
  put_errors_as(rows, report, &values->errors, r_mm, several ? CLI_IN_CSV | CLI_IN_JSON : 0,
                quantities->wanted, "");
  for (size_t q = 0; several && q < quantities->count; q++) {
    if ((quantities->items[q]->id & (DIPOLE_RADIUS | DIPOLE_MODEL_ERRORS)) == 0) {
      put_errors_as(rows, report, &values->of_each[q], r_mm, 0, quantities->items[q]->id,
                    quantities->items[q]->name);
    }
  }
}

/* Puts what all reports of values begin with. */
static void put_facts(cli_rows *rows, const void *context, size_t index) {
  const cli_eval_report *report = context;
  (void)index;
  cli_put_profile(rows, &report->profile);
  if (report->draw != NULL) {
    cli_put_text(rows, CLI_COLUMN("draw"), report->draw->name);
    cli_put_count(rows, CLI_COLUMN("seed"), report->seed);
    cli_put_count(rows, CLI_COLUMN("first"), report->first);
  } else if (report->place[0] == 'f') {
    cli_put_text(rows, CLI_COLUMN("R_f", ""), "R_f, the reflectance of striped light");
  } else {
    cli_put_text(rows, CLI_COLUMN("R", "R in"), report->profile.info->R_unit);
  }
}

/* Without places, when only the albedo was wanted, there is one row for each model and channel. */
static size_t rows_of_channel(const cli_eval_report *report) {
  return report->place_count > 0 ? report->place_count : 1;
}

/* Puts the values of a model and channel at a place, for programs. */
static void put_value(cli_rows *rows, const void *context, size_t index) {
  const cli_eval_report *report = context;
  const size_t at = index % rows_of_channel(report), profile = index / rows_of_channel(report);
  const size_t model = profile / report->profile.channel_count;
  const cli_eval_values *values = &report->values[profile];
  const cli_channel *channel = &report->profile.channels[profile % report->profile.channel_count];
  cli_put_text(rows, CLI_COLUMN("model"), report->models[model].choice->name);
  cli_put_text(rows, CLI_COLUMN("channel"), channel->name);
  cli_put_medium(rows, &channel->medium);
  if (report->place_count > 0) {
    cli_put_number(rows, CLI_COLUMN(report->place, .unit = unit_of_places(report)),
                   report->places[at]);
  }
  for (size_t q = 0; q < report->quantities.count; q++) {
    const dipole_choice *quantity = report->quantities.items[q];
    cli_put_number(rows, CLI_COLUMN(quantity->name, .unit = quantity->about),
                   values->arrays[q] != NULL ? values->arrays[q][at] : values->albedo);
  }
  put_errors(rows, report, values, radius_at(report, values, at));
  cli_put_text(rows, CLI_COLUMN("evaluator"), evaluator_of(report, model)->name);
  cli_put_notes(rows, report->profile.info, report->models[model].notes);
}

/* ---- for people ------------------------------------------------------------------------------ */

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

/* Puts a place, and the values of all quantities, models and channels there. */
static void put_place(cli_rows *rows, const void *context, size_t index) {
  const block *of = context;
  const cli_eval_report *report = of->report;
  const size_t channels = report->profile.channel_count;
  /* A share of 1, a radius and a logarithm are read best plainly; all else spans magnitudes. */
  const unsigned plain =
      DIPOLE_RADIUS | DIPOLE_CDF | DIPOLE_LN_R | DIPOLE_BY_SIGMA_A | DIPOLE_BY_SIGMA_S;
  cli_put_number(rows, CLI_COLUMN(report->place, .unit = unit_of_places(report)),
                 report->places[index]);
  for (size_t k = 0; k < report->quantities.count * of->count * channels; k++) {
    const size_t q = k / (of->count * channels), model = of->first + k / channels % of->count;
    const dipole_choice *quantity = report->quantities.items[q];
    const double *array = report->values[model * channels + k % channels].arrays[q];
    char head[128];
    snprintf(head, sizeof head, "%s %s", quantity->name,
             report->profile.channels[k % channels].name);
    if (array != NULL) {
      cli_put_number(rows,
                     CLI_COLUMN(head, .unit = quantity->about,
                                .format = (quantity->id & plain) != 0 ? "%.6g" : "%.4e",
                                .over = report->models[model].choice->name),
                     array[index]);
    }
  }
}

/* Puts what holds for all places of a model and channel. */
static void put_channel(cli_rows *rows, const void *context, size_t index) {
  const cli_eval_report *report = context;
  const size_t channels = report->profile.channel_count;
  const cli_eval_values *values = &report->values[index];
  const cli_channel *channel = &report->profile.channels[index % channels];
  cli_put_text(rows, CLI_COLUMN("model"), report->models[index / channels].choice->name);
  cli_put_text(rows, CLI_COLUMN("evaluator"), evaluator_of(report, index / channels)->name);
  cli_put_text(rows, CLI_COLUMN("channel"), channel->name);
  cli_put_medium(rows, &channel->medium);
  if ((report->quantities.wanted & DIPOLE_ALBEDO) != 0) {
    cli_put_number(rows, CLI_COLUMN("albedo"), values->albedo);
  }
  put_errors(rows, report, values, report->draw == NULL ? report->most : 0);
}

/* Writes "note: NAME: what it says" for each note, and its models if those are not all. */
static void write_notes(const cli_eval_report *report) {
  const dipole_choice *note;
  for (size_t from = 0;
       (note = cli_next_choice(report->profile.info, DIPOLE_NOTE, &from)) != NULL;) {
    size_t noted = 0;
    for (size_t i = 0; i < report->model_count; i++) {
      noted += note->id != 0 && (report->models[i].notes & note->id) == note->id;
    }
    if (noted == 0) {
      continue;
    }
    printf("note: %s: %s", note->name, note->about);
    const char *before = " (";
    for (size_t i = 0; noted < report->model_count && i < report->model_count; i++) {
      if ((report->models[i].notes & note->id) == note->id) {
        printf("%s%s", before, report->models[i].choice->name);
        before = ", ";
      }
    }
    puts(noted < report->model_count ? ")" : "");
  }
}

static void write_table(const void *context) {
  const cli_eval_report *report = context;
  const cli_profile *profile = &report->profile;
  for (size_t first = 0; report->place_count > 0 && first < report->model_count;) {
    const block models = block_from(report, first);
    cli_rows_print(stdout, 0, report->place_count, put_place, &models);
    putchar('\n');
    first += models.count;
  }
  cli_rows_print(stdout, 3, report->model_count * profile->channel_count, put_channel, report);
  fputs("numerical error: against the model's formula", stdout);
  if (report->draw == NULL && report->most > 0) {
    printf(", up to %s = %.6g %s", report->place, report->most, unit_of_places(report));
  }
  puts("\nmodel error: of the model against radiative transport, relative");
  if (report->diverges) {
    puts("             at r > 0: transport diverges at r = 0");
  }
  cli_write_launched(profile->media, profile->channel_count);
  write_notes(report);
  if (report->chosen) {
    printf("took %s (%s), the cheapest that keeps the tolerance\n", report->models[0].choice->name,
           report->models[0].evaluator->name);
  }
}

void cli_eval_write(const cli_eval_report *report, enum cli_form form) {
  const cli_report output = {.facts = put_facts,
                             .rows = report->model_count * report->profile.channel_count *
                                     rows_of_channel(report),
                             .put_row = put_value,
                             .table = write_table};
  cli_eval_report surveyed = *report;
  survey(&surveyed);
  cli_write(&output, form, &surveyed);
}
