/* Writes the report of `dipole eval` as a table for people, as CSV and as JSON. */
#include <math.h>
#include <stdlib.h>

#include "clients/cli/daemon.h"
#include "clients/cli/eval.h"
#include "clients/cli/number.h"
#include "clients/cli/rows.h"

static const char *unit_of(const cli_eval_report *report, unsigned quantity) {
  const dipole_choice *choice = cli_choice_of_id(report->profile.info, DIPOLE_QUANTITY, quantity);
  return choice != NULL ? choice->about : "";
}

static bool has_albedo(const cli_eval_report *report) {
  return (report->quantities.wanted & DIPOLE_ALBEDO) != 0;
}

/* Returns the values of a quantity at the report's radii; NULL if it is not wanted. */
static const double *array_of(const cli_eval_report *report, const cli_eval_values *values,
                              unsigned quantity) {
  for (size_t q = 0; q < report->quantities.count; q++) {
    if (report->quantities.items[q]->id == quantity) {
      return values->arrays[q];
    }
  }
  return NULL;
}

/* Returns what the numerical error of the wanted quantities is: that of ln R and its derivatives is
 * absolute. */
static const char *kind_of_error(const cli_eval_report *report) {
  const unsigned absolute = DIPOLE_LN_R | DIPOLE_BY_SIGMA_A | DIPOLE_BY_SIGMA_S;
  const unsigned wanted = report->quantities.wanted;
  return cli_eval_is_by_f(report)    ? "of the albedo, at most"
         : (wanted & absolute) == 0  ? "relative, at most"
         : (wanted & ~absolute) == 0 ? "absolute, at most"
                                     : "relative, of logarithms absolute, at most";
}

/* Returns the numerical error of the values at a radius. */
static double numerical_error(const cli_eval_values *values, double r_mm) {
  /* 0 times infinity is not a number, but a rate of 0 adds nothing at any radius. */
  return values->numerical_error +
         (values->numerical_error_per_mm > 0 ? values->numerical_error_per_mm * r_mm : 0);
}

/* Returns the largest finite radius of the report; 0 if there is none. */
static double radius_max(const cli_eval_report *report) {
  double max = 0;
  for (size_t i = 0; i < report->radius_count; i++) {
    if (isfinite(report->radii[i]) && report->radii[i] > max) {
      max = report->radii[i];
    }
  }
  return max;
}

/* ---- what a tolerance has chosen, and the cheaper offers that it did not choose -------------- */

/* How many cheaper offers are listed for people. */
enum { LISTED_MAX = 4 };

/* Returns whether a tolerance instead of a model was given. */
static bool is_chosen(const cli_eval_report *report) {
  return report->chosen_from.offers != NULL;
}

static const char *name_of(const cli_eval_report *report, enum dipole_kind kind, unsigned id) {
  const dipole_choice *choice = cli_choice_of_id(report->profile.info, kind, id);
  return choice != NULL ? choice->name : "?";
}

/* Returns the offer that was taken; NULL if the daemon has taken one that it had not offered. */
static const dipole_offer *find_taken(const cli_eval_report *report) {
  const cli_eval_offers *from = &report->chosen_from;
  for (size_t i = 0; i < from->count; i++) {
    if (from->offers[i].model == report->models[0].choice->id &&
        from->offers[i].evaluator == report->models[0].evaluator->id) {
      return &from->offers[i];
    }
  }
  return NULL;
}

/* Both are in the same list, which is in the order of the costs for all radii. */
static bool is_cheaper_and_off(const dipole_offer *offer, const dipole_offer *taken) {
  return !offer->meets && offer < taken;
}

enum { RANGE_BYTES = 64 };

#define F_UNIT "1/mm"

/* Returns the unit of the report's radii or frequencies. */
static const char *unit_of_radii(const cli_eval_report *report) {
  return cli_eval_is_by_f(report) ? F_UNIT : unit_of(report, DIPOLE_RADIUS);
}

/* Writes the range of the radii, such as "from 1 to 2 mm"; nothing if there are none. */
static const char *range_of(const cli_eval_report *report, char text[RANGE_BYTES]) {
  double least = (double)INFINITY, most = 0;
  for (size_t i = 0; i < report->radius_count; i++) {
    least = fmin(least, report->radii[i]);
    most = fmax(most, report->radii[i]);
  }
  text[0] = '\0';
  if (report->radius_count > 0 && least < most) {
    snprintf(text, RANGE_BYTES, "from %.6g to %.6g %s", least, most, unit_of_radii(report));
  } else if (report->radius_count > 0) {
    snprintf(text, RANGE_BYTES, "at %.6g %s", least, unit_of_radii(report));
  }
  return text;
}

/* Returns whether the model errors leave a radius out because transport diverges there: 0. */
static bool diverges(const cli_eval_report *report) {
  const unsigned diverging = DIPOLE_R | DIPOLE_S | DIPOLE_SLOPE | DIPOLE_LN_R;
  bool at_0 = false, compared = false;
  for (size_t i = 0; i < report->radius_count; i++) {
    at_0 = at_0 || report->radii[i] == 0;
  }
  for (size_t i = 0; i < report->model_count * report->profile.channel_count; i++) {
    compared = compared || report->values[i].model_error != 0;
  }
  return at_0 && compared && (report->quantities.wanted & diverging) != 0;
}

/* Returns a bound in two digits, rounded up so that it stays a bound. */
static double rounded_up(double bound) {
  const double unit = pow(10, floor(log10(bound)) - 1);
  return bound > 0 && bound < (double)INFINITY ? unit * ceil(bound / unit * (1 - 1e-12)) : bound;
}

/* Returns whether people see an offer in the list: it is cheaper, misses the tolerance, and is the
 * first such offer of its model. */
static bool is_listed(const cli_eval_offers *from, const dipole_offer *offer,
                      const dipole_offer *taken) {
  bool listed = is_cheaper_and_off(offer, taken);
  for (const dipole_offer *before = from->offers; before < offer; before++) {
    listed = listed && before->model != offer->model;
  }
  return listed;
}

/* Orders offers by error and, where that is the same, by cost; a NaN comes last. */
static int compare(const void *a, const void *b) {
  const dipole_offer *x = *(const dipole_offer *const *)a, *y = *(const dipole_offer *const *)b;
  const double x_error = isnan(x->error) ? (double)INFINITY : x->error;
  const double y_error = isnan(y->error) ? (double)INFINITY : y->error;
  return x_error != y_error ? (x_error > y_error) - (x_error < y_error) : (x > y) - (x < y);
}

/* Writes, for example, "; cheaper and not within 0.01: better (f32) 0.24 and 3 more". */
static void write_cheaper(const cli_eval_report *report, const dipole_offer *taken, FILE *file) {
  const cli_eval_offers *from = &report->chosen_from;
  const dipole_offer **listed = cli_allocate(from->count, sizeof(const dipole_offer *));
  char text[CLI_NUMBER_BYTES];
  size_t count = 0, written = 0;
  for (size_t i = 0; i < from->count; i++) {
    if (is_listed(from, &from->offers[i], taken)) {
      listed[count++] = &from->offers[i];
    }
  }
  qsort(listed, count, sizeof *listed, compare);
  if (count > 0) {
    fprintf(file, "; cheaper and not within %s: ", cli_number_format(from->tolerance, text));
  }
  for (; written < count && written < LISTED_MAX && listed[written]->error < (double)INFINITY;
       written++) {
    fprintf(file, "%s%s (%s) %.2g", written > 0 ? ", " : "",
            name_of(report, DIPOLE_MODEL, listed[written]->model),
            name_of(report, DIPOLE_EVALUATOR, listed[written]->evaluator), listed[written]->error);
  }
  if (written == 0 && count > 0) {
    fprintf(file, "%zu whose error is not known here", count);
  } else if (count > written) {
    fprintf(file, " and %zu more", count - written);
  }
  free(listed);
}

/* Writes what was chosen and why, as in "took transport by table (lut): ..."; nothing if a model
 * was named. */
static void write_chosen(const cli_eval_report *report, FILE *file) {
  if (!is_chosen(report)) {
    return;
  }
  const dipole_offer *taken = find_taken(report);
  fprintf(file, "took %s%s (%s)", report->models[0].choice->name,
          report->models[0].evaluator->id == DIPOLE_LUT ? " by table" : "",
          report->models[0].evaluator->name);
  if (taken != NULL) {
    char text[RANGE_BYTES];
    const char *range = range_of(report, text);
    fprintf(file, ": within %.2g of transport", rounded_up(taken->error));
    fprintf(file, "%s%s", range[0] != '\0' ? " " : "", range);
    fprintf(file, ", %.2g ns a value after %.2g ms of preparing", taken->cost_ns,
            taken->prepare_ns / 1e6);
    write_cheaper(report, taken, file);
  }
  fputc('\n', file);
}

/* Returns NaN, which JSON shows as null, for an error that is not known. */
static double known(double error) {
  return error < (double)INFINITY ? error : (double)NAN;
}

typedef struct offers {
  const cli_eval_report *report;
  const dipole_offer *items;
} offers;

static void put_offer(cli_rows *rows, const void *context, size_t index) {
  const offers *of = context;
  const dipole_offer *offer = &of->items[index];
  cli_put_text(rows, CLI_COLUMN("model"), name_of(of->report, DIPOLE_MODEL, offer->model));
  cli_put_text(rows, CLI_COLUMN("evaluator"),
               name_of(of->report, DIPOLE_EVALUATOR, offer->evaluator));
  cli_put_number(rows, CLI_COLUMN("error"), known(offer->error));
  cli_put_number(rows, CLI_COLUMN("numerical_error"), known(offer->numerical_error));
  cli_put_number(rows, CLI_COLUMN("cost_ns"), offer->cost_ns);
  cli_put_number(rows, CLI_COLUMN("prepare_ns"), offer->prepare_ns);
}

static void write_chosen_json(const cli_eval_report *report, cli_json *json) {
  if (!is_chosen(report)) {
    return;
  }
  const cli_eval_offers *from = &report->chosen_from;
  const dipole_offer *taken = find_taken(report);
  cli_json_begin(json, "chosen", '{');
  cli_json_number(json, "tolerance", from->tolerance);
  if (taken != NULL) {
    cli_rows_members(json, put_offer, &(const offers){report, taken}, 0);
  }
  cli_json_begin(json, "cheaper", '[');
  for (size_t i = 0; taken != NULL && i < from->count; i++) {
    if (is_cheaper_and_off(&from->offers[i], taken)) {
      cli_json_begin(json, NULL, '{');
      cli_rows_members(json, put_offer, &(const offers){report, from->offers}, i);
      cli_json_end(json, '}');
    }
  }
  cli_json_end(json, ']');
  cli_json_end(json, '}');
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

/* Puts a radius and, of R_f, the spatial frequency, which is the same number. */
static void put_place(cli_rows *rows, const cli_eval_report *report, double place) {
  if (!cli_eval_is_by_f(report)) {
    cli_put_number(rows, CLI_COLUMN("r", .unit = unit_of(report, DIPOLE_RADIUS)), place);
  }
  if ((report->quantities.wanted & DIPOLE_TRANSFER) != 0) {
    cli_put_number(rows, CLI_COLUMN("f", .unit = F_UNIT), place);
  }
}

/* Puts a radius, and the values of all quantities, models and channels there. */
static void put_radius(cli_rows *rows, const void *context, size_t index) {
  const block *of = context;
  const cli_eval_report *report = of->report;
  const size_t channels = report->profile.channel_count;
  put_place(rows, report, rows->pass == CLI_ROWS_VALUES ? report->radii[index] : 0);
  for (size_t q = 0; q < report->quantities.count; q++) {
    const dipole_choice *quantity = report->quantities.items[q];
    /* A share of 1 and a logarithm are read best plainly; all else spans many magnitudes. */
    const unsigned plain_ones = DIPOLE_CDF | DIPOLE_LN_R | DIPOLE_BY_SIGMA_A | DIPOLE_BY_SIGMA_S;
    const bool plain = (quantity->id & plain_ones) != 0;
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
      rows,
      CLI_COLUMN("numerical error", NULL, kind_of_error(report), "%.1e", .forms = CLI_IN_TABLE),
      numerical_error(values, radius_max(report)));
  cli_put_number(rows, CLI_COLUMN("numerical_error", .forms = CLI_IN_JSON),
                 values->numerical_error);
  cli_put_number(rows, CLI_COLUMN("numerical_error_per_mm", .forms = CLI_IN_JSON),
                 values->numerical_error_per_mm);
  char range[RANGE_BYTES];
  const bool ranged = range_of(report, range)[0] != '\0' && !cli_eval_is_by_f(report);
  cli_put_number(
      rows,
      CLI_COLUMN("model_error", "model error", ranged ? range : "relative", "%.1e",
                 diverges(report) && !(radius_max(report) > 0) ? "diverges" : "not solved"),
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

/* Returns the evaluator of most models: that of the first without a table, if there is one. */
static const dipole_choice *usual_evaluator(const cli_eval_report *report) {
  const dipole_choice *usual = report->models[0].evaluator;
  for (size_t i = 1; i < report->model_count && (usual == NULL || usual->id == DIPOLE_LUT); i++) {
    usual = report->models[i].evaluator != NULL ? report->models[i].evaluator : usual;
  }
  return usual;
}

/* Writes, for example, "f64, lut for transport". */
static void write_evaluators(const cli_eval_report *report) {
  const dipole_choice *usual = usual_evaluator(report);
  printf("; evaluator %s", usual->name);
  for (size_t i = 0; i < report->model_count; i++) {
    const cli_eval_model *model = &report->models[i];
    if (model->evaluator != NULL && model->evaluator != usual) {
      printf(", %s for %s", model->evaluator->name, model->choice->name);
    }
  }
}

static void write_table(const void *context) {
  const cli_eval_report *report = context;
  const cli_profile *profile = &report->profile;
  cli_write_medium(profile, stdout);
  if (cli_eval_is_by_f(report)) {
    fputs("R_f, the reflectance of striped light", stdout);
  } else {
    printf("R in %s", profile->info->R_unit);
  }
  write_evaluators(report);
  printf(", moments %s", profile->moments->name);
  cli_write_parameters(profile, stdout);
  fputs("\n\n", stdout);
  for (size_t first = 0; report->quantities.count > 0 && first < report->model_count;) {
    const block models = block_from(report, first);
    cli_rows_print(stdout, 0, report->radius_count, put_radius, &models);
    putchar('\n');
    first += models.count;
  }
  cli_rows_print(stdout, 2, report->model_count * profile->channel_count, put_channel, report);
  if (radius_max(report) > 0) {
    printf("numerical error: against the model's formula, up to %s = %.6g %s\n",
           cli_eval_is_by_f(report) ? "f" : "r", radius_max(report), unit_of_radii(report));
  }
  puts("model error: of the model against radiative transport, relative");
  if (diverges(report)) {
    puts("             at r > 0: transport diverges at r = 0");
  }
  cli_write_launched(profile->media, profile->channel_count, stdout);
  write_notes(report);
  write_chosen(report, stdout);
}

/* ---- CSV ------------------------------------------------------------------------------------- */

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
  const double *R = any ? array_of(report, values, DIPOLE_R) : NULL;
  const double *cdf = any ? array_of(report, values, DIPOLE_CDF) : NULL;
  const double r_mm = any ? report->radii[radius] : (double)NAN;
  char notes[256];
  cli_put_text(rows, CLI_COLUMN("model"), model->choice->name);
  cli_put_text(rows, CLI_COLUMN("channel"), channel->name);
  cli_put_medium(rows, &channel->medium);
  put_place(rows, report, r_mm);
  cli_put_number(rows, CLI_COLUMN("R"), R != NULL ? R[radius] : (double)NAN);
  cli_put_number(rows, CLI_COLUMN("albedo"), values->albedo);
  cli_put_number(rows, CLI_COLUMN("cdf"), cdf != NULL ? cdf[radius] : (double)NAN);
  cli_put_number(rows, CLI_COLUMN("numerical_error"), numerical_error(values, any ? r_mm : 0));
  cli_put_number(rows, CLI_COLUMN("model_error"), values->model_error);
  cli_put_text(rows, CLI_COLUMN("notes"),
               join_notes(&report->profile, model->notes, notes, sizeof notes));
  for (size_t q = 0; q < report->quantities.count; q++) {
    if (is_appended(report->quantities.items[q])) {
      cli_put_number(rows, CLI_COLUMN(report->quantities.items[q]->name),
                     any ? values->arrays[q][radius] : (double)NAN);
    }
  }
  if (is_chosen(report)) { /* the user does not know it beforehand */
    cli_put_text(rows, CLI_COLUMN("evaluator"), report->models[0].evaluator->name);
  }
}

/* ---- JSON ------------------------------------------------------------------------------------ */

static void put_model(cli_rows *rows, const void *context, size_t index) {
  const cli_eval_report *report = context;
  const cli_eval_model *model = &report->models[index];
  const size_t channels = report->profile.channel_count;
  cli_put_text(rows, CLI_COLUMN("model"), model->choice->name);
  cli_put_text(rows, CLI_COLUMN("source"), model->choice->about);
  if (model->evaluator != NULL) {
    cli_put_text(rows, CLI_COLUMN("evaluator"), model->evaluator->name);
  }
  cli_json_notes(rows->json, report->profile.info, model->notes);
  cli_json_begin(rows->json, "channels", '[');
  for (size_t channel = 0; channel < channels; channel++) {
    cli_json_begin(rows->json, NULL, '{');
    cli_rows_members(rows->json, put_channel, report, index * channels + channel);
    cli_json_end(rows->json, '}');
  }
  cli_json_end(rows->json, ']');
}

static void put_members(cli_json *json, const void *context) {
  const cli_eval_report *report = context;
  const cli_profile *profile = &report->profile;
  const char *const places[] = {cli_eval_is_by_f(report) ? NULL : "r",
                                (report->quantities.wanted & DIPOLE_TRANSFER) != 0 ? "f" : NULL};
  cli_json_head(json, profile);
  cli_json_text(json, "evaluator", usual_evaluator(report)->name);
  cli_json_text(json, "moments", profile->moments->name);
  cli_json_parameters(json, profile);
  write_chosen_json(report, json);
  cli_json_begin(json, "units", '{');
  cli_json_text(json, "sigma_a", "1/mm");
  cli_json_text(json, "sigma_s", "1/mm");
  for (size_t i = 0; i < 2; i++) {
    if (places[i] != NULL) {
      cli_json_text(json, places[i], i == 0 ? unit_of(report, DIPOLE_RADIUS) : F_UNIT);
    }
  }
  cli_json_text(json, "R", profile->info->R_unit);
  cli_json_text(json, "albedo", unit_of(report, DIPOLE_ALBEDO));
  cli_json_text(json, "cdf", unit_of(report, DIPOLE_CDF));
  for (size_t q = 0; q < report->quantities.count; q++) {
    if (is_appended(report->quantities.items[q])) {
      cli_json_text(json, report->quantities.items[q]->name, report->quantities.items[q]->about);
    }
  }
  cli_json_end(json, '}');
  for (size_t i = 0; i < 2; i++) {
    if (places[i] != NULL) {
      cli_json_numbers(json, places[i], report->radii, report->radius_count);
    }
  }
  cli_rows_json(json, "models", report->model_count, put_model, report);
}

void cli_eval_write(const cli_eval_report *report, enum cli_form form) {
  const cli_output output = {.table = write_table,
                             .rows = report->model_count * report->profile.channel_count *
                                     rows_of_channel(report),
                             .put_row = put_value,
                             .members = put_members};
  cli_write(&output, form, report);
}
