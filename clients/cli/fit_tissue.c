#include "clients/cli/fit_tissue.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/csv.h"
#include "clients/cli/daemon.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "clients/cli/rows.h"
#include "proto/decimal.h"

/* The columns of the file. */
enum { WAVELENGTH, RADIUS, FREQUENCY, VALUE, ERROR, SOURCE, DETECTOR, COLUMNS };

static const char *const names[COLUMNS] = {"wavelength_nm", "r",         "f",          "R",
                                           "error",         "source_mm", "detector_mm"};

/* The readings of one tissue: a value for each wavelength and place. */
typedef struct tissue_sample {
  char *name;
  size_t *rows, count; /* of the sheet */
  dipole_tissue_fits *fits;
} tissue_sample;

typedef struct report {
  const cli_settings *settings;
  cli_profile profile;
  const dipole_choice *scale;
  cli_sheet sheet;
  bool frequency;
  size_t sample_count;
  tissue_sample *samples;
  dipole_tissue_fit_query query;
  dipole_parameter properties[CORE_PROPERTIES_END];
  dipole_sought sought[CORE_PROPERTIES_END];
  bool blood; /* whether saturation and total are written */
} report;

int cli_fit_tissue_check(const cli_settings *settings) {
  if (settings->tissue.count > 1) {
    return cli_fail_usage("--tissue: a fit of a tissue has no layers: give one");
  }
  return settings->layer.count + settings->reference.count + settings->g.count +
                     settings->eta.count + settings->thickness.count + settings->plot.count >
                 0
             ? cli_fail_usage("--unknown: leave --layer, --reference, --g, --eta, --thickness and "
                              "--plot out; g=X and eta=X are properties of --tissue")
             : CLI_OK;
}

/* ---- what is asked --------------------------------------------------------------------------- */

/* Reads PROPERTY or PROPERTY=LOW:HIGH. Says what is wrong and returns false. */
static bool read_unknown(const dipole_info *info, const char *text, dipole_sought *sought) {
  char *name = cli_copy(text, strlen(text)), *low = strchr(name, '='), *high = NULL;
  if (low != NULL) {
    *low++ = '\0';
    high = strchr(low, ':');
  }
  if (high != NULL) {
    *high++ = '\0';
  }
  const dipole_choice *property = cli_property(info, "--unknown", name);
  if (property == NULL) {
    return false;
  }
  *sought = (dipole_sought){.property = (uint16_t)property->id};
  return low == NULL ||
         (high != NULL && decimal_read(low, &sought->low) && decimal_read(high, &sought->high)) ||
         cli_fails_usage("--unknown %s: give %s, or limits as %s=LOW:HIGH", text, name, name);
}

static int take_query(report *of, dipole_client *client) {
  const cli_settings *settings = of->settings;
  dipole_tissue_fit_query *query = &of->query;
  if (!cli_profile_take_names(settings, client, &of->profile)) {
    return CLI_USAGE;
  }
  const dipole_info *info = of->profile.info;
  of->scale = cli_named(info, DIPOLE_SCALE, "scale",
                        settings->scale != NULL ? settings->scale : "absolute");
  of->profile.haemoglobin =
      cli_named(info, DIPOLE_HAEMOGLOBIN, "haemoglobin", settings->haemoglobin);
  if (of->scale == NULL || of->profile.haemoglobin == NULL) {
    return CLI_USAGE;
  }
  if (settings->unknown.count > CORE_PROPERTIES_END) {
    return cli_fail_usage("--unknown: too many");
  }
  if (settings->tissue.count > 0) {
    of->profile.tissue = settings->tissue.items[0];
    if (!cli_tissue_read(info, of->profile.tissue, &query->tissue, of->properties)) {
      return CLI_USAGE;
    }
  }
  for (size_t i = 0; i < settings->unknown.count; i++) {
    if (!read_unknown(info, settings->unknown.items[i], &of->sought[i])) {
      return CLI_USAGE;
    }
  }
  for (size_t i = 0; i < of->profile.parameters.count; i++) {
    if (of->profile.parameters.items[i].id != CORE_PARAMETER_DETECTOR_NA) {
      return cli_fail_usage("--unknown: no parameter but --detector-na goes with it");
    }
    query->detector_na = of->profile.parameters.items[i].value;
  }
  query->tissue.haemoglobin = of->profile.haemoglobin->id;
  query->tissue.deadline_ms = (uint32_t)settings->deadline_ms.value;
  query->model = of->profile.model->id;
  query->scale = of->scale->id;
  query->sought = of->sought;
  query->sought_count = (uint32_t)settings->unknown.count;
  query->set_count = 1;
  return CLI_OK;
}

/* ---- readings -------------------------------------------------------------------------------- */

static bool check_header(const cli_sheet *sheet, const cli_csv_record *header) {
  const bool places =
      (sheet->at[RADIUS] == CLI_CSV_ABSENT) != (sheet->at[FREQUENCY] == CLI_CSV_ABSENT);
  const char *missing = sheet->at[WAVELENGTH] == CLI_CSV_ABSENT ? "wavelength_nm"
                        : !places                               ? "r or f (one of both)"
                        : sheet->at[VALUE] == CLI_CSV_ABSENT    ? "R"
                        : sheet->at[ERROR] == CLI_CSV_ABSENT    ? "error"
                                                                : NULL;
  return missing == NULL ||
         cli_csv_fail_missing(
             sheet->source, header, missing,
             "wavelength_nm, r (mm) or f (1/mm), R and error for --unknown, and may "
             "have sample, source_mm and detector_mm");
}

/* Lists the samples, and the rows of each. */
static int read_samples(report *of) {
  cli_sheet *sheet = &of->sheet;
  if (!cli_sheet_read(of->settings->operand, "sample", names, COLUMNS, check_header, sheet)) {
    return CLI_FAILED;
  }
  of->frequency = sheet->at[FREQUENCY] != CLI_CSV_ABSENT;
  of->samples = cli_allocate(sheet->count + 1, sizeof *of->samples);
  for (size_t row = 0; row < sheet->count; row++) {
    size_t i = of->sample_count; /* a sample's lines are mostly adjacent */
    while (i > 0 && strcmp(of->samples[i - 1].name, sheet->labels[row]) != 0) {
      i--;
    }
    tissue_sample *one = &of->samples[i > 0 ? i - 1 : of->sample_count++];
    one->name = sheet->labels[row];
    one->rows = cli_resize(one->rows, one->count + 1, sizeof *one->rows);
    one->rows[one->count++] = row;
  }
  return sheet->count > 0 ? CLI_OK : cli_fail("%s: there are no readings", sheet->source);
}

/* Returns the position of a number in a list, to which it is added if it is new. */
static size_t place_of(double *list, size_t *count, double number) {
  size_t i = 0;
  while (i < *count && (list[i] < number || list[i] > number)) {
    i++;
  }
  list[i] = number;
  *count += i == *count;
  return i;
}

/* Arranges the readings of a sample by wavelength and place, and requests its fit. */
static int fit_sample(report *of, dipole_client *client, tissue_sample *one) {
  const cli_sheet *sheet = &of->sheet;
  const size_t count = one->count, column = of->frequency ? FREQUENCY : RADIUS;
  double *numbers = cli_allocate(6 * count, sizeof *numbers);
  double *nm = numbers, *at = nm + count, *discs[] = {at + count, at + 2 * count};
  double *values = at + 3 * count, *errors = at + 4 * count;
  size_t wavelengths = 0, places = 0;
  for (size_t i = 0; i < count; i++) {
    const size_t place = place_of(at, &places, cli_sheet_number(sheet, one->rows[i], column));
    place_of(nm, &wavelengths, cli_sheet_number(sheet, one->rows[i], WAVELENGTH));
    for (size_t k = 0; k < 2; k++) {
      const double disc = cli_sheet_number(sheet, one->rows[i], SOURCE + k);
      discs[k][place] = isnan(disc) ? 0 : disc;
    }
  }
  bool *known = cli_allocate(count, sizeof *known);
  bool whole = wavelengths * places == count;
  for (size_t i = 0; i < count && whole; i++) {
    const size_t row = one->rows[i];
    const size_t l = place_of(nm, &wavelengths, cli_sheet_number(sheet, row, WAVELENGTH));
    const size_t to = l * places + place_of(at, &places, cli_sheet_number(sheet, row, column));
    whole = !known[to];
    known[to] = true;
    values[to] = cli_sheet_number(sheet, row, VALUE);
    errors[to] = cli_sheet_number(sheet, row, ERROR);
  }
  if (!whole) {
    return cli_fail("%s: sample %s: each wavelength needs one reading at each of the same places",
                    sheet->source, one->name);
  }
  dipole_error error;
  dipole_tissue_fit_query query = of->query;
  query.tissue.properties = of->properties;
  query.tissue.wavelengths_nm = nm;
  query.tissue.wavelength_count = (uint32_t)wavelengths;
  query.axis = of->frequency ? DIPOLE_AXIS_FREQUENCY : DIPOLE_AXIS_RADIUS;
  query.place_count = (uint32_t)places;
  query.at = at;
  query.source_mm = discs[0];
  query.detector_mm = discs[1];
  query.values = values;
  query.errors = errors;
  const bool good =
      CLI_RETRY(of->settings, &error, dipole_fit_tissue(client, &query, &one->fits, &error));
  if (good) {
    return CLI_OK;
  }
  char what[96];
  snprintf(what, sizeof what, "sample %.80s: ", one->name);
  return cli_fail_error_of(what, &error);
}

/* ---- writing --------------------------------------------------------------------------------- */

static void put_facts(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  (void)index;
  cli_put_profile(rows, &of->profile);
  if (of->profile.tissue == NULL) {
    cli_put_text(rows, of->profile.haemoglobin->name, "haemoglobin");
  }
  cli_put_number(rows, of->samples[0].fits->g, "g");
  cli_put_number(rows, of->samples[0].fits->eta, "eta");
  cli_put_text(rows, of->scale->name, "scale");
}

static const char *status_name(const report *of, unsigned status) {
  const dipole_choice *one = cli_choice_of_id(of->profile.info, DIPOLE_FIT_STATUS, status);
  return one != NULL ? one->name : "unknown";
}

static size_t rows_of_sample(const report *of) {
  return of->query.sought_count + (of->blood ? 2 : 0);
}

/* Writes one unknown, the saturation or the total of a sample. */
static void put_estimate(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const size_t k = index % rows_of_sample(of), unknowns = of->query.sought_count;
  const tissue_sample *sample = &of->samples[index / rows_of_sample(of)];
  const dipole_fitted_tissue *set = sample->fits->sets;
  const bool share = k == unknowns;
  const char *name = share ? "saturation" : "total_uM";
  dipole_tissue_estimate one = {.status = share ? set->saturation_status : set->total_status,
                                .value = share ? set->saturation : set->total_uM,
                                .error = share ? set->saturation_error : set->total_error_uM,
                                .numerical = (double)NAN};
  if (k < unknowns) {
    one = sample->fits->estimates[k];
    name = cli_choice_of_id(of->profile.info, DIPOLE_PROPERTY, one.property)->name;
  }
  const bool is_free = of->scale->id == DIPOLE_FREE;
  const unsigned with_factor = is_free ? 0U : CLI_IN_CSV | CLI_IN_JSON;
  cli_put_text(rows, sample->name, "sample");
  cli_put_text(rows, name, "unknown");
  cli_put_number(rows, one.value, "value", .format = "%.5g", .missing = "-");
  cli_put_number(rows, one.error, "error", .format = "%.2g", .missing = "-");
  cli_put_number(rows, one.numerical, "numerical", .format = "%.1e", .missing = "-");
  cli_put_text(rows, status_name(of, one.status), "status");
  cli_put_number(rows, set->factor, "scale", .format = "%.5g", .missing = "-",
                 .forms = with_factor);
  cli_put_number(rows, set->factor_error, "scale_error", "its error", .format = "%.2g",
                 .missing = "-", .forms = with_factor);
  cli_put_number(rows, set->chi_squared, "chi2", .format = "%.4g", .missing = "-");
  cli_put_count(rows, sample->count, "readings");
  cli_put_number(rows, set->condition, "condition", .format = "%.3g", .missing = "-");
  cli_put_number(rows, set->model_error, "model_error", .forms = CLI_IN_JSON);
  cli_put_text(rows, status_name(of, set->status), "sample_status", "sample is");
}

static void write_foot(const void *context) {
  (void)context;
  puts("\nerrors are standard errors, inf where a value has none; numerical: how far numerical "
       "errors of R may\nshift a value; chi2 is the sum of the squares of (reading - fit) / error");
}

int cli_fit_tissue_run(const cli_settings *settings, dipole_client *client) {
  report of = {.settings = settings};
  cli_progress progress;
  int status = read_samples(&of);
  status = status == CLI_OK ? take_query(&of, client) : status;
  cli_progress_start(&progress, "samples");
  for (size_t i = 0; status == CLI_OK && i < of.sample_count; i++) {
    status = fit_sample(&of, client, &of.samples[i]);
    cli_progress_show(&progress, (double)(i + 1) / (double)of.sample_count, (double)(i + 1));
  }
  cli_progress_wipe(&progress);
  if (status != CLI_OK) {
    return status;
  }
  of.blood = !isnan(of.samples[0].fits->sets->saturation_error);
  const cli_report output = {.facts = put_facts,
                             .rows = of.sample_count * rows_of_sample(&of),
                             .put_row = put_estimate,
                             .left = 2,
                             .foot = write_foot};
  cli_write(&output, settings->form, &of);
  size_t bad = 0;
  for (size_t i = 0; i < of.sample_count; i++) {
    bad += of.samples[i].fits->sets->status != DIPOLE_FITTED;
  }
  if (bad == 0) {
    return CLI_OK;
  }
  cli_fail("%s: %zu of %zu samples were not fitted whole: see the column status", of.sheet.source,
           bad, of.sample_count);
  return CLI_BAD_ROWS;
}
