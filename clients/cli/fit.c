/* dipole fit: the coefficients of samples whose readings a CSV file holds. */
#include <math.h>
#include <search.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/csv.h"
#include "clients/cli/daemon.h"
#include "clients/cli/fit_tissue.h"
#include "clients/cli/options.h"
#include "clients/cli/picture.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "clients/cli/rows.h"

enum { REFERENCE_NUMBERS = 4 };

static const cli_option options[] = {
    CLI_TITLE("Samples"),
    CLI_OPTION(ONE, eta, NULL,
               "refractive index inside over outside, where the file does not say: it has no "
               "default (tissue in air has about 1.4)"),
    CLI_OPTION(ONE, g, NULL,
               "mean cosine of the scattering angle, where the file does not say (default: 0)"),
    CLI_OPTION(ONE, thickness, NULL, "of slabs, mm, for multipoles (default: half spaces)"),
    CLI_OPTION(TEXT, scale, NULL,
               "absolute: R is as the model has it; free: R of each sample is that times a factor, "
               "which is fitted, too (default: absolute)"),
    CLI_OPTION(NUMBERS, reference, NULL,
               "R is divided by the reading of a known medium at the same place: sigma_a, sigma_s "
               "(1/mm), g and eta of that medium"),
    {"layer",
     "in place of half spaces: a layer of a stack, from the top down, with x for each sigma_a, "
     "sigma_s and thickness that is sought, of the two upper layers; repeat it for each. A last "
     "one without thickness is a half space",
     CLI_FILES, offsetof(cli_settings, layer), NULL, "SIGMA_A,SIGMA_S,G,ETA[,THICKNESS]"},
    CLI_TITLE("Tissue"),
    {"unknown",
     "in place of sigma_a and sigma_s': amounts, a and b of a tissue that are sought, with limits "
     "if the usual ones do not do",
     CLI_NAMES, offsetof(cli_settings, unknown), NULL, "PROPERTY[=LOW:HIGH][,...]"},
    {"tissue", "what is known besides, and where the search starts; `dipole tissue` lists it",
     CLI_FILES, offsetof(cli_settings, tissue), NULL, "[NAME][,PROPERTY=X]..."},
    CLI_OPTION(TEXT, haemoglobin, "prahl", "the table of its absorption: prahl or ucl"),
    {"maps",
     "fit each pixel of images, which FILE lists, and write a map of each value (FILE.hbo2_uM.pfm) "
     "and of its error (FILE.hbo2_uM_error.pfm), of chi2 and of status",
     CLI_FILE, offsetof(cli_settings, output), NULL, "FILE.pfm"},
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAME, model, CLI_MODEL_DEFAULT, "the model that is fitted; see `dipole info`"),
    CLI_MOMENTS_OPTION,
    CLI_DEADLINE_OPTION,
    CLI_TITLE("Output"),
    CLI_OPTION(FILES, plot, NULL,
               "also draw readings, fit and residuals of the first samples into FILE.svg or "
               "FILE.png; -: as text. May be repeated"),
    {0},
};

/* The largest changes of a sample's coefficients for g +- G_CHANGE. */
typedef struct g_change {
  double a, s;    /* of sigma_a and sigma_s', 1/mm; NAN where one of the fits is no success */
  unsigned sides; /* which of the two g the model takes: index into sides_of_g */
} g_change;

#define G_CHANGE 0.05

enum { G_BELOW = 1, G_ABOVE = 2 };

static const char *const sides_of_g[] = {"none", "below", "above", "both"};

/* The readings of one medium: `count` of them from `first` on. */
typedef struct fit_sample {
  char *name;
  double of_sample[3]; /* g, eta and the aperture; NAN if the file does not say */
  double g, eta;       /* as taken */
  const char *g_from;  /* what g comes from, for messages */
  size_t first, count;
} fit_sample;

typedef struct report {
  const cli_settings *settings;
  cli_profile profile;
  const dipole_choice *axis, *scale;
  const char *source; /* name of the file, for messages */
  bool frequency;     /* the places are spatial frequencies */
  size_t sample_count;
  fit_sample *samples; /* samples in the order of their first lines */
  size_t count;
  /* [count], by samples and within them in the order of the file. A cell that is empty is NAN. */
  double *at, *values, *errors, *source_mm, *detector_mm;
  uint64_t *lines;       /* [count] line numbers in the file, from 1 on */
  dipole_fitted *fitted; /* [sample_count] */
  g_change *changes;     /* [sample_count] */
  dipole_medium layers[CORE_LAYERS_MAX];
  unsigned unknowns;          /* sum of enum dipole_unknown; 0: half spaces are fitted */
  dipole_layers_fit **stacks; /* [sample_count]; NULL where a sample is refused */
  double *residuals;          /* [count]; NAN where nothing was fitted */
  unsigned notes;
} report;

/* Reads a layer, and adds what is sought of it. */
static bool read_layer(const char *text, size_t index, report *of) {
  static const char members[] = {0, 1, -1, -1, 2};
  char *known = cli_copy(text, strlen(text));
  size_t cell = 0;
  for (char *at = known; *at != 0; at++) {
    cell += *at == ',';
    if (*at == 'x' && index < 2 && cell < sizeof members && members[cell] >= 0) {
      of->unknowns |= 1U << (3 * index + (size_t)members[cell]);
      *at = '1';
    }
  }
  return cli_layer_read(known, &of->layers[index]);
}

/* Reads the layers of the options. */
static int take_layers(const cli_settings *settings, report *of) {
  const size_t count = settings->layer.count;
  if (count > CORE_LAYERS_MAX) {
    return cli_fail_usage("--layer: %zu layers: give at most %d", count, CORE_LAYERS_MAX);
  }
  for (size_t i = 0; i < count; i++) {
    if (!read_layer(settings->layer.items[i], i, of)) {
      return cli_fail_usage("--layer %s: give SIGMA_A,SIGMA_S,G,ETA[,THICKNESS], of the two upper "
                            "layers x for SIGMA_A, SIGMA_S or THICKNESS if that is sought",
                            settings->layer.items[i]);
    }
  }
  return count == 0 || of->unknowns != 0
             ? CLI_OK
             : cli_fail_usage(
                   "--layer: give x for what is sought, as in --layer x,20,0.8,1.4,0.06");
}

static int check(cli_settings *settings) {
  if (settings->unknown.count > 0) {
    return cli_fit_tissue_check(settings);
  }
  if (settings->tissue.count > 0 || strcmp(settings->haemoglobin, "prahl") != 0 ||
      settings->output != NULL) {
    return cli_fail_usage(
        "--tissue, --haemoglobin and --maps are for what --unknown names: give it, too");
  }
  const size_t numbers = settings->reference.count;
  if (numbers != 0 && numbers != REFERENCE_NUMBERS) {
    return cli_fail_usage("--reference: give four numbers: sigma_a, sigma_s, g and eta");
  }
  if (numbers != 0 && settings->scale != NULL) {
    return cli_fail_usage("--reference says what the scale is: leave --scale out");
  }
  if (settings->scale != NULL && strcmp(settings->scale, "reference") == 0) {
    return cli_fail_usage("--scale reference: give --reference A,S,G,ETA in its place");
  }
  if (settings->layer.count > 0 &&
      (numbers != 0 || settings->g.count + settings->eta.count + settings->thickness.count > 0 ||
       settings->plot.count > 0 || settings->moments != NULL)) {
    return cli_fail_usage(
        "--layer gives a layer whole, and is fitted by transport: leave --g, --eta, "
        "--thickness, --moments, --reference and --plot out");
  }
  return cli_picture_check(&settings->plot, settings);
}

/* ---- readings -------------------------------------------------------------------------------- */

/* The columns of the file; those of samples come first. */
enum {
  G,
  ETA,
  APERTURE,
  OF_SAMPLE,
  RADIUS = OF_SAMPLE,
  FREQUENCY,
  VALUE,
  ERROR,
  SOURCE,
  DETECTOR,
  COLUMNS
};

static const char *const names[COLUMNS] = {"g", "eta",   "detector_na", "r",          "f",
                                           "R", "error", "source_mm",   "detector_mm"};

static bool check_header(const cli_sheet *sheet, const cli_csv_record *header) {
  size_t length;
  for (size_t i = 0; i < header->cell_count; i++) {
    const char *name = cli_csv_cell_text(header, i, &length);
    if (strcmp(name, "thickness") == 0 || strncmp(name, "phase", strlen("phase")) == 0) {
      return cli_fails(
          "%s: the column %s is of no medium that can be fitted: those are half spaces that "
          "scatter by Henyey-Greenstein's function",
          sheet->source, name);
    }
  }
  const char *missing =
      (sheet->at[RADIUS] == CLI_CSV_ABSENT) == (sheet->at[FREQUENCY] == CLI_CSV_ABSENT)
          ? "r or f (one of both)"
      : sheet->at[VALUE] == CLI_CSV_ABSENT ? "R"
      : sheet->at[ERROR] == CLI_CSV_ABSENT ? "error"
                                           : NULL;
  return missing == NULL ||
         cli_csv_fail_missing(
             sheet->source, header, missing,
             "r (distances in mm) or f (spatial frequencies in 1/mm), R and error, and may have "
             "sample, g, eta, detector_na, source_mm and detector_mm");
}

/* Returns the number of the sample of this name: `next` if it is new. table: the names so far. */
static size_t number_of(struct hsearch_data *table, char *name, size_t next) {
  ENTRY *found;
  if (hsearch_r((ENTRY){name, (void *)(uintptr_t)next}, ENTER, &found, table) == 0) {
    fputs("dipole: out of memory\n", stderr);
    exit(CLI_FAILED);
  }
  return (size_t)(uintptr_t)found->data;
}

/* Sets what all lines of a sample must agree about. */
static bool take_of_sample(const cli_sheet *sheet, size_t row, fit_sample *of) {
  for (size_t i = 0; i < OF_SAMPLE; i++) {
    const double given = cli_sheet_number(sheet, row, i), kept = of->of_sample[i];
    if (!isnan(given) && (kept < given || kept > given)) {
      return cli_fails("%s: line %llu: %s differs from that of the sample's other lines",
                       sheet->source, (unsigned long long)sheet->lines[row], names[i]);
    }
    of->of_sample[i] = isnan(given) ? kept : given;
  }
  return true;
}

/* Lists the samples, and counts their readings. numbers: [rows] those of the rows' samples */
static bool list_samples(const cli_sheet *sheet, report *of, size_t *numbers) {
  struct hsearch_data table = {0};
  bool good = hcreate_r(2 * sheet->count + 1, &table) != 0;
  of->samples = cli_allocate(sheet->count, sizeof *of->samples);
  for (size_t row = 0; good && row < sheet->count; row++) {
    char *name = sheet->labels[row];
    fit_sample *one = &of->samples[numbers[row] = number_of(&table, name, of->sample_count)];
    if (numbers[row] == of->sample_count) {
      const double none = (double)NAN;
      *one = (fit_sample){.name = name, .of_sample = {none, none, none}};
      of->sample_count++;
    }
    good = take_of_sample(sheet, row, one);
    one->count++;
  }
  hdestroy_r(&table);
  return good;
}

/* Writes the readings into their arrays, sample by sample. */
static void arrange(const cli_sheet *sheet, const size_t *numbers, report *of) {
  const struct {
    double **to;
    size_t column;
  } arrays[] = {{&of->at, of->frequency ? FREQUENCY : RADIUS},
                {&of->values, VALUE},
                {&of->errors, ERROR},
                {&of->source_mm, SOURCE},
                {&of->detector_mm, DETECTOR}};
  size_t next = 0;
  of->count = sheet->count;
  of->lines = cli_allocate(of->count, sizeof *of->lines);
  for (size_t i = 0; i < of->sample_count; i++) {
    of->samples[i].first = next;
    next += of->samples[i].count;
    of->samples[i].count = 0;
  }
  for (size_t k = 0; k < sizeof arrays / sizeof arrays[0]; k++) {
    *arrays[k].to = cli_allocate(of->count, sizeof(double));
  }
  for (size_t row = 0; row < of->count; row++) {
    fit_sample *one = &of->samples[numbers[row]];
    const size_t to = one->first + one->count++;
    for (size_t k = 0; k < sizeof arrays / sizeof arrays[0]; k++) {
      const double number = cli_sheet_number(sheet, row, arrays[k].column);
      (*arrays[k].to)[to] = isnan(number) && arrays[k].column >= SOURCE ? 0 : number;
    }
    of->lines[to] = sheet->lines[row];
  }
}

/* Sets g and eta where the file does not say them. A wrong eta gives wrong coefficients that fit as
 * well, so none is assumed. */
static int complete_samples(report *of) {
  const cli_settings *settings = of->settings;
  for (size_t i = 0; i < of->sample_count; i++) {
    fit_sample *one = &of->samples[i];
    const double g = one->of_sample[G], eta = one->of_sample[ETA];
    one->g = isnan(g) ? cli_numbers_pick(&settings->g, 0, 0) : g;
    one->g_from = !isnan(g) ? "file" : settings->g.count > 0 ? "option" : "default";
    one->eta = isnan(eta) ? cli_numbers_pick(&settings->eta, 0, (double)NAN) : eta;
    if (isnan(one->eta)) {
      return cli_fail_usage("sample %s: its eta is not known: give --eta X (the refractive index "
                            "inside over outside), or a column eta",
                            one->name);
    }
  }
  return CLI_OK;
}

/* Reads the file and groups its lines into samples. Returns an exit status. */
static int read_samples(report *of) {
  cli_sheet sheet;
  if (!cli_sheet_read(of->settings->operand, "sample", names, COLUMNS, check_header, &sheet)) {
    return CLI_FAILED;
  }
  if (sheet.count == 0) {
    return cli_fail("%s: there are no readings", sheet.source);
  }
  size_t *numbers = cli_allocate(sheet.count, sizeof *numbers);
  of->source = sheet.source;
  of->frequency = sheet.at[FREQUENCY] != CLI_CSV_ABSENT;
  if (!list_samples(&sheet, of, numbers)) {
    return CLI_FAILED;
  }
  arrange(&sheet, numbers, of);
  return CLI_OK;
}

/* ---- requests ---------------------------------------------------------------------------------- */

/* Looks up the names that options and the file give. */
static int choose(const cli_settings *settings, dipole_client *client, report *of) {
  const char *scale = settings->reference.count > 0 ? "reference"
                      : settings->scale != NULL     ? settings->scale
                                                    : "absolute";
  if (!cli_profile_take_names(settings, client, &of->profile)) {
    return CLI_USAGE;
  }
  of->scale = cli_named(of->profile.info, DIPOLE_SCALE, "scale", scale);
  of->axis = cli_named(of->profile.info, DIPOLE_AXIS, "axis", of->frequency ? "f" : "r");
  return of->scale != NULL && of->axis != NULL ? CLI_OK : CLI_USAGE;
}

/* Samples side by side of the same places and kind of medium, so that one request has them all. */
typedef struct batch {
  size_t first, count;
} batch;

/* Returns the parameters of a sample: those of the options, and the aperture of the file. */
static cli_parameters parameters_of(const report *of, const fit_sample *one) {
  const dipole_choice *aperture = cli_choice(of->profile.info, DIPOLE_PARAMETER, "detector_na");
  cli_parameters parameters = of->profile.parameters;
  if (!isnan(one->of_sample[APERTURE])) {
    cli_parameters_set(&parameters, aperture != NULL ? aperture->id : CORE_PARAMETER_DETECTOR_NA,
                       one->of_sample[APERTURE]);
  }
  return parameters;
}

static dipole_fit_query query_of(const report *of, const fit_sample *one,
                                 const cli_parameters *parameters) {
  const cli_settings *settings = of->settings;
  const double *known = settings->reference.items;
  dipole_fit_query query = {
      .model = of->profile.model->id,
      .moments = of->profile.moments->id,
      .g = one->g,
      .eta = one->eta,
      .thickness_mm = cli_numbers_pick(&settings->thickness, 0, 0),
      .parameters = parameters->items,
      .parameter_count = parameters->count,
      .axis = of->axis->id,
      .scale = of->scale->id,
      .reading_count = one->count,
      .at = of->at + one->first,
      .source_mm = of->source_mm + one->first,
      .detector_mm = of->detector_mm + one->first,
      .residuals = true,
      .deadline_ms = (unsigned)settings->deadline_ms.value,
  };
  if (settings->reference.count == REFERENCE_NUMBERS) {
    query.reference = (dipole_medium){known[0], known[1], known[2], known[3], query.thickness_mm};
  }
  return query;
}

static void take_fits(report *of, const batch *some, const dipole_fits *fits) {
  const fit_sample *first = &of->samples[some->first];
  memcpy(of->fitted + some->first, fits->sets, some->count * sizeof *of->fitted);
  memcpy(of->residuals + first->first, fits->residuals,
         some->count * first->count * sizeof *of->residuals);
  of->notes |= fits->notes;
}

static void take_change(g_change *change, unsigned side, const dipole_fitted *one,
                        const dipole_fitted *other) {
  const bool good = one->status == DIPOLE_FITTED && other->status == DIPOLE_FITTED;
  const double a = fabs(other->sigma_a_per_mm - one->sigma_a_per_mm);
  const double s = fabs(other->sigma_s_prime_per_mm - one->sigma_s_prime_per_mm);
  change->a = cli_larger(change->a, good ? a : (double)NAN);
  change->s = cli_larger(change->s, good ? s : (double)NAN);
  change->sides |= side;
}

/* Fits the samples of a query again with g lower or higher by G_CHANGE, and takes the change of the
 * coefficients. Leaves this side out if the daemon refuses its g, or if transport has the note
 * *similarity* for it and not for the query's g. notes: those of the fit with the query's g. */
static bool request_side(dipole_client *client, report *of, const batch *some,
                         dipole_fit_query query, unsigned notes, unsigned side,
                         dipole_error *error) {
  const dipole_choice *similarity = cli_choice(of->profile.info, DIPOLE_NOTE, "similarity");
  const double g = query.g + (side == G_BELOW ? -G_CHANGE : G_CHANGE);
  query.g = round(g * 1e9) / 1e9; /* .9 + .05 exceeds .95, the table's largest g */
  query.residuals = false;
  dipole_fits *fits;
  if (!CLI_RETRY(of->settings, error, dipole_fit(client, &query, &fits, error))) {
    return error->kind == DIPOLE_ERROR_REFUSED &&
           (strcmp(error->field, "g") == 0 || strcmp(error->field, "detector_na") == 0);
  }
  const bool alike = similarity == NULL || strcmp(of->profile.model->name, "transport") != 0 ||
                     (fits->notes & ~notes & similarity->id) == 0;
  for (size_t i = 0; alike && i < some->count; i++) {
    const size_t sample = some->first + i;
    take_change(&of->changes[sample], side, &of->fitted[sample], &fits->sets[i]);
  }
  dipole_fits_free(fits);
  return true;
}

/* Returns whether a refusal is about one reading. */
static bool is_of_reading(const dipole_error *error) {
  return cli_in_list("at,source,detector,values,errors", error->field);
}

/* Returns whether a refusal is about what the file says of a sample, and not about an option. */
static bool is_of_file(const fit_sample *one, const dipole_error *error) {
  bool found = is_of_reading(error) || strcmp(error->field, "reading_count") == 0;
  for (size_t i = 0; i < OF_SAMPLE; i++) {
    found = found || (strcmp(error->field, names[i]) == 0 && !isnan(one->of_sample[i]));
  }
  return error->kind == DIPOLE_ERROR_REFUSED && found;
}

/* Returns whether the daemon refuses what the file says of a batch, and then says so. */
static bool is_fault_of_file(const report *of, const batch *some, const dipole_error *error) {
  const fit_sample *first = &of->samples[some->first];
  char line[64] = "";
  if (!is_of_file(first, error)) {
    return false;
  }
  if (error->index < first->count && is_of_reading(error)) {
    snprintf(line, sizeof line, ": reading %zu (line %llu)", (size_t)error->index + 1,
             (unsigned long long)of->lines[first->first + error->index]);
  }
  cli_fail("sample %s%s%s: %s", first->name, some->count > 1 ? " and others" : "", line,
           error->text);
  return true;
}

/* Requests a batch. If the daemon refuses what the file says of its samples, they stay refused. */
static bool request_batch(dipole_client *client, report *of, const batch *some,
                          dipole_error *error) {
  const fit_sample *first = &of->samples[some->first];
  const cli_parameters parameters = parameters_of(of, first);
  dipole_fit_query query = query_of(of, first, &parameters);
  query.set_count = some->count;
  query.values = of->values + first->first;
  query.errors = of->errors + first->first;
  dipole_fits *fits;
  if (CLI_RETRY(of->settings, error, dipole_fit(client, &query, &fits, error))) {
    const unsigned notes = fits->notes;
    take_fits(of, some, fits);
    dipole_fits_free(fits);
    return request_side(client, of, some, query, notes, G_BELOW, error) &&
           request_side(client, of, some, query, notes, G_ABOVE, error);
  }
  return is_fault_of_file(of, some, error);
}

/* Requests the fit of a stack to a sample, which is a batch of its own. */
static bool request_stack(dipole_client *client, report *of, const batch *some,
                          dipole_error *error) {
  const fit_sample *one = &of->samples[some->first];
  dipole_layers_fit **fit = &of->stacks[some->first];
  const dipole_layers_query query = {.layers = of->layers,
                                     .layer_count = (uint32_t)of->settings->layer.count,
                                     .unknowns = of->unknowns,
                                     .scale = of->scale->id,
                                     .reading_count = one->count,
                                     .at = of->at + one->first,
                                     .values = of->values + one->first,
                                     .errors = of->errors + one->first,
                                     CLI_DEADLINE_OF(of->settings)};
  if (CLI_RETRY(of->settings, error, dipole_fit_layers(client, &query, fit, error))) {
    of->fitted[some->first].status = (uint16_t)(*fit)->status;
    return true;
  }
  return is_fault_of_file(of, some, error);
}

/* Returns whether two samples can be in one request. */
static bool is_alike(const report *of, const fit_sample *a, const fit_sample *b) {
  const double *const places[] = {of->at, of->source_mm, of->detector_mm};
  bool alike = a->count == b->count && memcmp(a->of_sample, b->of_sample, sizeof a->of_sample) == 0;
  for (size_t i = 0; alike && i < 3; i++) {
    alike = memcmp(places[i] + a->first, places[i] + b->first, a->count * sizeof(double)) == 0;
  }
  return alike;
}

/* Readings in one request: about a tenth of a second of work, so that the progress moves. */
enum { BATCH_READINGS = 65536 };

/* Requests all samples. */
static bool request_fits(dipole_client *client, report *of, dipole_error *error) {
  const size_t count = of->sample_count;
  cli_progress progress;
  bool good = true;
  cli_progress_start(&progress, "samples");
  for (batch some = {0}; good && some.first < count; some.first += some.count) {
    const fit_sample *first = &of->samples[some.first];
    some.count = 1;
    while (of->unknowns == 0 && some.first + some.count < count &&
           some.count * first->count < BATCH_READINGS && is_alike(of, first, first + some.count)) {
      some.count++;
    }
    good = (of->unknowns != 0 ? request_stack : request_batch)(client, of, &some, error);
    const double done = (double)(some.first + some.count);
    cli_progress_show(&progress, done / (double)count, done);
  }
  cli_progress_wipe(&progress);
  return good;
}

/* ---- writing --------------------------------------------------------------------------------- */

const char *cli_fit_status(const dipole_info *info, unsigned id) {
  const dipole_choice *status = cli_choice_of_id(info, DIPOLE_FIT_STATUS, id);
  return status != NULL ? status->name : "unknown";
}

static bool is_free(const report *of) {
  return of->scale->id == DIPOLE_FREE;
}

static void put_sample(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const fit_sample *sample = &of->samples[index];
  const dipole_fitted *one = &of->fitted[index];
  const double a = sqrt(one->variance_a), s = sqrt(one->variance_s);
  const double scale_error = sqrt(one->variance_factor);
  const g_change *change = &of->changes[index];
  const unsigned with_factor = is_free(of) ? 0u : CLI_IN_CSV | CLI_IN_JSON;
  cli_put_text(rows, sample->name, "sample");
  cli_put_number(rows, one->sigma_a_per_mm, "sigma_a", NULL, "1/mm", "%.5g", "-");
  cli_put_number(rows, one->sigma_s_prime_per_mm, "sigma_s_prime", "sigma_s'", "1/mm", "%.5g", "-");
  cli_put_number(rows, a, "sigma_a_error", "error of a", "1/mm", "%.2g", "-");
  cli_put_number(rows, s, "sigma_s_prime_error", "error of s'", "1/mm", "%.2g", "-");
  cli_put_number(rows, change->sides != 0 ? change->a : (double)NAN, "sigma_a_by_g", "a by g",
                 "1/mm", "%.2g", "-");
  cli_put_number(rows, change->sides != 0 ? change->s : (double)NAN, "sigma_s_prime_by_g",
                 "s' by g", "1/mm", "%.2g", "-");
  cli_put_number(rows, one->covariance_a_s / (a * s), "correlation", NULL, NULL, "%.3f", "-");
  cli_put_number(rows, one->factor, "scale", NULL, NULL, "%.5g", "-", .forms = with_factor);
  cli_put_number(rows, scale_error, "scale_error", "its error", NULL, "%.2g", "-",
                 .forms = with_factor);
  cli_put_number(rows, one->chi_squared, "chi2", NULL, NULL, "%.4g", "-");
  cli_put_count(rows, sample->count, "readings");
  cli_put_number(rows, one->model_error, "model_error", "model error", NULL, "%.1e", "not known",
                 .below = "relative", .forms = CLI_IN_TABLE | CLI_IN_JSON);
  cli_put_number(rows, sample->g, "g");
  cli_put_text(rows, sample->g_from, "g_from", "g from");
  cli_put_text(rows, sides_of_g[change->sides], "g_sides", "g sides");
  cli_put_number(rows, sample->eta, "eta");
  cli_put_text(rows, cli_fit_status(of->profile.info, one->status), "status");
  const unsigned json = CLI_IN_JSON;
  cli_put_number(rows, one->reduced_chi_squared, "reduced_chi2", .forms = json);
  cli_put_number(rows, one->condition, "condition", .forms = json);
  cli_put_number(rows, one->second_sigma_a_per_mm, "second_sigma_a", .unit = "1/mm", .forms = json);
  cli_put_number(rows, one->second_sigma_s_prime_per_mm, "second_sigma_s_prime", .unit = "1/mm",
                 .forms = json);
  cli_put_number(rows, one->second_chi_squared, "second_chi2", .forms = json);
}

static void put_facts(cli_rows *rows, const void *context) {
  const report *of = context;
  cli_put_profile(rows, &of->profile);
  cli_put_text(rows, of->axis->name, "axis", .forms = CLI_IN_JSON);
  cli_put_text(rows, of->scale->name, "scale");
  if (rows->form == CLI_JSON) {
    cli_put_notes(rows, of->profile.info, of->notes);
  }
}

static void write_foot(const void *context) {
  const report *of = context;
  puts("\nerrors are standard errors; chi2 is the sum of the squares of (reading - fit) / error");
  puts("model error: of R against radiative transport, which is not in the standard errors");
  puts("by g: the largest change for g +- .05, since the readings may not determine g");
  cli_write_notes(of->profile.info, of->notes);
}

/* ---- what is no success ---------------------------------------------------------------------- */

void cli_fit_report_reading(const char *sample, uint64_t line, bool is_error) {
  cli_fail("sample %s: line %llu: its %s must be %sfinite", sample, (unsigned long long)line,
           is_error ? "error" : "reading", is_error ? "above 0, and " : "");
}

/* Everything is written in any case; then reports what is no success. */
static int judge(const report *of) {
  size_t bad = 0, reported = 0;
  for (size_t i = 0; i < of->sample_count; i++) {
    const dipole_fitted *one = &of->fitted[i];
    bad += one->status != DIPOLE_FITTED;
    const fit_sample *sample = &of->samples[i];
    if (one->status == DIPOLE_FIT_REFUSED && one->field != 0 && one->index < sample->count &&
        reported++ < CLI_FIT_REPORTED_MAX) {
      cli_fit_report_reading(sample->name, of->lines[sample->first + one->index], one->field == 2);
    }
  }
  return bad == 0 ? CLI_OK
                  : cli_say(CLI_BAD_ROWS,
                            "%s: %zu of %zu samples were not fitted: see the column status",
                            of->source, bad, of->sample_count);
}

/* ---- the command ----------------------------------------------------------------------------- */

enum { DRAWN_MAX = 8 }; /* samples in a picture; the first ones of a file */

static bool spans_decades(const report *of) {
  double least = (double)INFINITY, most = 0;
  for (size_t i = 0; i < of->count; i++) {
    least = fmin(least, of->at[i]);
    most = fmax(most, of->at[i]);
  }
  return least > 0 && most >= 10 * least;
}

/* Draws readings and what was fitted to them, and below them the residuals. */
static int draw_fit(const report *of) {
  const size_t drawn = of->sample_count < DRAWN_MAX ? of->sample_count : DRAWN_MAX;
  cli_picture picture = {.x_label =
                             of->frequency ? "spatial frequency f (1/mm)" : "distance r (mm)",
                         .lower_label = "residual / error",
                         .logarithmic_x = spans_decades(of),
                         .logarithmic_y = true};
  double *fitted = cli_allocate(of->count, sizeof *fitted);
  double *zeros = cli_allocate(of->count, sizeof *zeros);
  snprintf(picture.title, sizeof picture.title, "fit of %s, scale %s", of->profile.model->name,
           of->scale->name);
  snprintf(picture.y_label, sizeof picture.y_label, "%s: readings, fit (lines)",
           of->frequency ? "R(f)" : "R (1/mm^2)");
  for (size_t i = 0; i < of->count; i++) {
    fitted[i] = of->values[i] - of->residuals[i] * of->errors[i];
  }
  for (size_t k = 0; k < 2 * drawn; k++) { /* first the lines */
    const fit_sample *sample = &of->samples[k % drawn];
    cli_curve *curve = cli_picture_add(&picture);
    curve->colour = (unsigned)(k % drawn);
    curve->count = sample->count;
    curve->x = of->at + sample->first;
    curve->y = (k < drawn ? fitted : of->values) + sample->first;
    curve->lower = zeros;
    if (k >= drawn) {
      curve->error = of->errors + sample->first;
      curve->lower = of->residuals + sample->first;
      snprintf(curve->title, sizeof curve->title, "%s", sample->name);
    }
  }
  const int status = cli_picture_draw(&picture, &of->settings->plot);
  if (status == CLI_OK && of->sample_count > DRAWN_MAX) {
    cli_say(CLI_OK, "the picture shows the first %d of %zu samples", DRAWN_MAX, of->sample_count);
  }
  return status;
}

/* Without a reply, samples are refused, and all numbers NaN, whose bytes may be 255. */
static void refuse_all(report *of) {
  const size_t count = of->sample_count;
  of->fitted = cli_allocate(count, sizeof *of->fitted);
  of->changes = cli_allocate(count, sizeof *of->changes);
  of->stacks = cli_allocate(count, sizeof(dipole_layers_fit *));
  of->residuals = cli_allocate(of->count, sizeof *of->residuals);
  memset(of->fitted, 0xff, count * sizeof *of->fitted);
  memset(of->residuals, 0xff, of->count * sizeof *of->residuals);
  for (size_t i = 0; i < count; i++) {
    of->fitted[i].status = DIPOLE_FIT_REFUSED;
    of->fitted[i].field = 0;
  }
}

/* ---- layers -------------------------------------------------------------------------------- */

/* Returns an exit status: fits of layers take readings of R and nothing else. */
static int check_readings(const report *of) {
  bool more = of->frequency || of->profile.parameters.count > 0 ||
              strcmp(of->profile.model->name, CLI_MODEL_DEFAULT) != 0;
  for (size_t i = 0; i < of->sample_count; i++) {
    for (size_t k = 0; k < OF_SAMPLE; k++) {
      more = more || !isnan(of->samples[i].of_sample[k]);
    }
  }
  for (size_t i = 0; i < of->count; i++) {
    more = more || of->source_mm[i] > 0 || of->detector_mm[i] > 0;
  }
  return more ? cli_fail_usage("--layer: layers are fitted by transport to the columns r, R and "
                               "error, without parameters")
              : CLI_OK;
}

/* Writes an estimate: the samples one after the other, with their unknowns. */
static void put_estimate(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const size_t each = (size_t)__builtin_popcount(of->unknowns), sample = index / each;
  const dipole_layers_fit *fit = of->stacks[sample];
  unsigned bits = of->unknowns;
  for (size_t i = 0; i < index % each; i++) {
    bits &= bits - 1;
  }
  const double none = (double)NAN;
  const dipole_estimate refused = {
      .status = DIPOLE_FIT_REFUSED, .value = none, .error = (double)INFINITY};
  const dipole_estimate *one = fit != NULL ? &fit->estimates[index % each] : &refused;
  const dipole_choice *name =
      cli_choice_of_id(of->profile.info, DIPOLE_UNKNOWN, bits & (~bits + 1));
  const unsigned with_factor = is_free(of) ? 0U : CLI_IN_CSV | CLI_IN_JSON;
  cli_put_text(rows, of->samples[sample].name, "sample");
  cli_put_text(rows, name != NULL ? name->name : "unknown", "unknown");
  cli_put_number(rows, one->value, "value", .unit = "1/mm, mm", .format = "%.5g", .missing = "-");
  cli_put_number(rows, one->error, "error", .unit = "1/mm, mm", .format = "%.2g");
  cli_put_text(rows, cli_fit_status(of->profile.info, one->status), "status");
  cli_put_number(rows, fit != NULL ? fit->factor : none, "scale", .missing = "-",
                 .forms = with_factor);
  cli_put_number(rows, fit != NULL ? fit->factor_error : none, "scale_error", "its error",
                 .format = "%.2g", .missing = "-", .forms = with_factor);
  cli_put_number(rows, fit != NULL ? fit->chi_squared : none, "chi2", .format = "%.4g",
                 .missing = "-");
  cli_put_count(rows, of->samples[sample].count, "readings");
  cli_put_number(rows, fit != NULL ? fit->numerical_error : none, "numerical_error",
                 "numerical error", .format = "%.1e", .missing = "-");
  cli_put_text(rows, cli_fit_status(of->profile.info, of->fitted[sample].status), "sample_status",
               "sample is");
}

static void write_layers_foot(const void *context) {
  (void)context;
  puts("\nerrors are standard errors, inf where a value is not fitted; chi2 is the sum of the "
       "squares of (reading - fit) / error");
}

/* ---- running ------------------------------------------------------------------------------- */

static int run_fit(const cli_settings *settings, dipole_client *client) {
  if (settings->unknown.count > 0) {
    return cli_fit_tissue_run(settings, client);
  }
  report of = {.settings = settings};
  dipole_error error;
  int status = take_layers(settings, &of);
  const bool layers = of.unknowns != 0;
  status = status == CLI_OK ? read_samples(&of) : status;
  status = status == CLI_OK ? choose(settings, client, &of) : status;
  status = status != CLI_OK ? status : layers ? check_readings(&of) : complete_samples(&of);
  if (status != CLI_OK) {
    return status;
  }
  refuse_all(&of);
  if (!request_fits(client, &of, &error)) {
    return cli_fail_error(&error);
  }
  const size_t each = layers ? (size_t)__builtin_popcount(of.unknowns) : 1;
  const cli_report output = {.facts = put_facts,
                             .rows = of.sample_count * each,
                             .put_row = layers ? put_estimate : put_sample,
                             .left = layers ? 2 : 1,
                             .foot = layers ? write_layers_foot : write_foot};
  cli_write(&output, settings->form, &of);
  for (size_t i = 0; i < of.sample_count; i++) {
    dipole_layers_fit_free(of.stacks[i]);
  }
  status = settings->plot.count > 0 ? draw_fit(&of) : CLI_OK;
  const int judged = judge(&of);
  return status != CLI_OK ? status : judged;
}

const cli_command cli_command_fit = {
    .name = "fit",
    .operand = "[FILE]",
    .about = "Find sigma_a and sigma_s' of samples from readings of their reflectance",
    .more =
        "FILE is CSV; without it, standard input is read. The header names the columns: r "
        "(distance from the light, mm) or f (spatial frequency of striped light, 1/mm), R (the "
        "reading, 1/mm^2 per unit of power that entered; at f the share R_f) and error (its "
        "standard "
        "error). These may be absent: sample (a name; lines of the same name belong together), "
        "eta, g, source_mm and detector_mm (diameters of the discs that light enters through and "
        "is detected on), and detector_na (see --detector-na). Each sample has at least as many "
        "readings as unknowns: 2, or 3 with --scale free. Without a column eta, --eta has to be "
        "given. The output has the g and eta that were taken, and g_from, where g comes from: "
        "file, option or default. Beyond two mean free paths readings hardly depend on g: they are "
        "fitted with a wrong one, too. sigma_a_by_g and sigma_s_prime_by_g say how much sigma_a "
        "and sigma_s' change at most for g +- .05 (about twice that for +- .1), and g_sides which "
        "of these two g the model takes: both, below, above or none. They have no value where one "
        "of the fits is no success. They are 0 where the model does not see g (notes similarity "
        "and gamma), though the light does." CLI_CSV_TEXT "\n"
        "status is fitted, or says why a sample is no success: at-bound, undetermined, "
        "implausible, ambiguous, unfinished or refused; `dipole info` describes them. The exit "
        "status is then 3, and all samples are written nevertheless. sigma_s' is sigma_s (1 - g). "
        "chi2 is the sum of the squares of (R - fit) / error: about readings less unknowns if "
        "model and errors are right; a sample is implausible if noise would make it as large less "
        "than once in a million times. The model error (in tables and JSON) is that of R against "
        "radiative transport, at the distances of a sample and between them. With --detector-na it "
        "contains that of the share that is detected. It is not part of the standard errors.\n"
        "With --layer the file has r, R, error and sample alone, and a row of output is one "
        "unknown: sample_status is that of its sample.\n"
        "With --unknown the file has wavelength_nm, too, and for each wavelength of a sample the "
        "same places. A property is named with or without its unit, as hbo2 for hbo2_uM. The "
        "saturation and the total of haemoglobin have their errors from the covariance. A column "
        "relative_error is part of the error of R, as a share of R, besides error or in its place. "
        "With --maps a line of FILE is an image in place of R, whose pixels have these errors: the "
        "column image has a file, PFM or PNG (its values as shares of 1), all grey and of one "
        "size. "
        "What is not fitted is NaN in the maps, and counted.",
    .formats = "table,csv,json",
    .options = {options},
    .parameters = CLI_OF_INVERTED | CLI_PARAMETER_BIT(DETECTOR_NA),
    .check = check,
    .run = run_fit,
    .examples =
        "  dipole fit readings.csv --eta 1.4\n"
        "  dipole fit readings.csv --model better --eta 1.4 --scale free --format csv > found.csv\n"
        "  dipole fit readings.csv --g 0.8 --eta 1.4 --plot fit.svg\n"
        "  dipole fit readings.csv --layer x,20,0.8,1.4,0.06 --layer x,15,0.8,1.4\n"
        "  dipole fit bands.csv --unknown hbo2,hb,water=0.2:0.9,a,b --tissue fat=0.1,eta=1.4\n"
        "  dipole fit images.csv --unknown hbo2,hb,a,b --tissue water=0.65 --maps skin.pfm\n"
        "  printf 'r,R,error\\n1,.0234,.0005\\n2,.00787,.0002\\n4,.00159,.00003\\n' |\n"
        "    dipole fit --model better --eta 1.4\n",
};
