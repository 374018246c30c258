#include "clients/cli/fit_tissue.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/csv.h"
#include "clients/cli/daemon.h"
#include "clients/cli/image.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "clients/cli/rows.h"
#include "proto/decimal.h"

/* The columns of the file: a line is up to three readings, each with its error. */
enum {
  WAVELENGTH,
  RADIUS,
  FREQUENCY,
  SOURCE,
  DETECTOR,
  MHZ,
  RELATIVE,
  VALUES,
  KINDS = 3,
  COLUMNS = VALUES + 2 * KINDS
};

static const char *const names[COLUMNS] = {
    "wavelength_nm",   "r", "f",     "source_mm", "detector_mm", "mhz",
    "relative_error",  "R", "error", "phase",     "phase_error", "modulation",
    "modulation_error"};

static const double quantities[KINDS] = {0, DIPOLE_LAG, DIPOLE_MODULATION};

/* The readings of one tissue: a value for each wavelength and place. */
typedef struct tissue_sample {
  char *name;
  size_t *rows, count; /* of the sheet */
  size_t readings;
  struct reading *all; /* [readings], by wavelength and place */
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
  bool blood;        /* whether saturation and total are written */
  struct maps *maps; /* NULL: the file has the readings */
} report;

int cli_fit_tissue_check(const cli_settings *settings) {
  if (settings->output != NULL && !cli_ends_with(settings->output, ".pfm")) {
    return cli_fail_usage("--maps: %s does not end with .pfm", settings->output);
  }
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

/* images: whether a line is an image, whose pixels stand for R. */
static bool check_columns(const cli_sheet *sheet, const cli_csv_record *header, bool images) {
  const bool places =
      (sheet->at[RADIUS] == CLI_CSV_ABSENT) != (sheet->at[FREQUENCY] == CLI_CSV_ABSENT);
  const char *missing = sheet->at[WAVELENGTH] == CLI_CSV_ABSENT          ? names[WAVELENGTH]
                        : !places                                        ? "r or f (one of both)"
                        : images && sheet->at[COLUMNS] == CLI_CSV_ABSENT ? "image"
                                                                         : NULL;
  size_t kinds = images;
  for (size_t i = VALUES; i < COLUMNS && missing == NULL; i += 2) {
    const bool read = sheet->at[i] != CLI_CSV_ABSENT;
    const bool error = sheet->at[i + 1] != CLI_CSV_ABSENT ||
                       (i == VALUES && sheet->at[RELATIVE] != CLI_CSV_ABSENT);
    if (read && images) {
      return cli_fails("%s: the column %s is not read with --maps", sheet->source, names[i]);
    }
    missing = (read || (images && i == VALUES)) && !error ? names[i + 1] : NULL;
    kinds += read;
  }
  missing = missing == NULL && kinds == 0 ? names[VALUES] : missing;
  return missing == NULL ||
         cli_csv_fail_missing(
             sheet->source, header, missing,
             images
                 ? "wavelength_nm, r (mm) or f (1/mm), image (a file) and error, or "
                   "relative_error, for --maps, and may have source_mm, detector_mm, mhz"
                 : "wavelength_nm, r (mm) or f (1/mm), R and error for --unknown, and may have "
                   "sample, source_mm, detector_mm, relative_error; of modulated light mhz, phase "
                   "(degrees), phase_error, modulation, modulation_error");
}

static bool check_images(const cli_sheet *sheet, const cli_csv_record *header) {
  return check_columns(sheet, header, true);
}

static bool check_header(const cli_sheet *sheet, const cli_csv_record *header) {
  return check_columns(sheet, header, false);
}

/* Lists the samples, and the rows of each. */
static int read_samples(report *of) {
  cli_sheet *sheet = &of->sheet;
  const bool maps = of->maps != NULL;
  if (!cli_sheet_read(of->settings->operand, maps ? "image" : "sample", names, COLUMNS,
                      maps ? check_images : check_header, sheet)) {
    return CLI_FAILED;
  }
  of->frequency = sheet->at[FREQUENCY] != CLI_CSV_ABSENT;
  of->samples = cli_allocate(sheet->count + 1, sizeof *of->samples);
  for (size_t row = 0; row < sheet->count; row++) {
    size_t i = of->sample_count; /* a sample's lines are mostly adjacent */
    while (i > 0 && !maps && strcmp(of->samples[i - 1].name, sheet->labels[row]) != 0) {
      i--;
    }
    tissue_sample *one = &of->samples[i > 0 ? i - 1 : of->sample_count++];
    one->name = sheet->labels[row];
    one->rows = cli_resize(one->rows, one->count + 1, sizeof *one->rows);
    one->rows[one->count++] = row;
  }
  return sheet->count > 0 ? CLI_OK : cli_fail("%s: there are no readings", sheet->source);
}

enum { NM, PLACE, KEYS = 6 }; /* wavelength; r or f, discs, mhz, quantity */

typedef struct reading {
  double key[KEYS], value, error;
  size_t row;
} reading;

/* Compares two readings by the numbers from `first` on. */
static int compare_from(size_t first, const reading *a, const reading *b) {
  int order = 0;
  for (size_t k = first; k < KEYS && order == 0; k++) {
    order = (a->key[k] > b->key[k]) - (a->key[k] < b->key[k]);
  }
  return order;
}

static int compare_readings(const void *a, const void *b) {
  return compare_from(NM, a, b);
}

/* Returns the standard error of R in a row: that of the file, and what it says as a share of R. */
static double error_of(const cli_sheet *sheet, size_t row, double R) {
  const double error = cli_sheet_number(sheet, row, VALUES + 1);
  const double share = cli_sheet_number(sheet, row, RELATIVE);
  return isnan(share) ? error : hypot(isnan(error) ? 0 : error, share * R);
}

/* Lists the readings of a row. Returns how many. */
static size_t list_readings(const report *of, size_t row, reading *to) {
  const cli_sheet *sheet = &of->sheet;
  const bool alone = of->maps != NULL || (sheet->at[VALUES + 2] == CLI_CSV_ABSENT &&
                                          sheet->at[VALUES + 4] == CLI_CSV_ABSENT);
  reading one = {{cli_sheet_number(sheet, row, WAVELENGTH),
                  cli_sheet_number(sheet, row, of->frequency ? FREQUENCY : RADIUS)},
                 .row = row};
  size_t count = 0;
  for (size_t k = SOURCE; k <= MHZ; k++) {
    const double number = cli_sheet_number(sheet, row, k);
    one.key[PLACE + 1 + k - SOURCE] = isnan(number) ? 0 : number;
  }
  for (size_t kind = 0; kind < (of->maps != NULL ? 1 : KINDS); kind++) {
    one.key[KEYS - 1] = quantities[kind];
    one.value = cli_sheet_number(sheet, row, VALUES + 2 * kind);
    one.error = kind == 0 ? error_of(sheet, row, one.value)
                          : cli_sheet_number(sheet, row, VALUES + 2 * kind + 1);
    if (!isnan(one.value) || (kind == 0 && alone)) {
      to[count++] = one;
    }
  }
  return count;
}

/* Sorts readings by wavelength and place. Returns the number of places. Unless each wavelength has one
 * reading at each of them it says so, and returns 0. */
static size_t sort_readings(const report *of, const tissue_sample *one) {
  const reading *all = one->all;
  size_t places = 0, i = 1;
  qsort(one->all, one->readings, sizeof *all, compare_readings);
  while (places < one->readings && !(all[places].key[NM] > all->key[NM])) {
    places++;
  }
  while (i < one->readings && compare_from(PLACE, &all[i], &all[i % places]) == 0 &&
         compare_readings(&all[i - 1], &all[i]) != 0) {
    i++;
  }
  if (i >= one->readings && places > 0 && one->readings % places == 0) {
    return places;
  }
  const reading *bad = &all[i < one->readings ? i : i - 1];
  cli_fail(
      "%s: sample %s: each wavelength needs one reading at each of the same places: see %g nm, "
      "line %llu",
      of->sheet.source, one->name, bad->key[NM], (unsigned long long)of->sheet.lines[bad->row]);
  return 0;
}

/* Lists a sample's readings by wavelength and place, and sets these in the query or says why not. */
static bool arrange(const report *of, tissue_sample *one, dipole_tissue_fit_query *query) {
  const size_t room = KINDS * one->count;
  one->all = cli_allocate(room, sizeof *one->all);
  for (size_t i = 0; i < one->count; i++) {
    one->readings += list_readings(of, one->rows[i], one->all + one->readings);
  }
  const reading *all = one->all;
  const size_t places = sort_readings(of, one);
  if (places == 0) {
    return false;
  }
  double *keys =
      cli_allocate(KEYS * room, sizeof *keys); /* of the wavelengths, and of the places */
  for (size_t i = 0; i < one->readings; i++) {
    keys[i / places] = all[i].key[NM];
    for (size_t k = PLACE; k < KEYS; k++) {
      keys[k * room + i % places] = all[i].key[k];
    }
  }
  *query = of->query;
  query->tissue.properties = of->properties;
  query->tissue.wavelengths_nm = keys;
  query->tissue.wavelength_count = (uint32_t)(one->readings / places);
  query->axis = of->frequency ? DIPOLE_AXIS_FREQUENCY : DIPOLE_AXIS_RADIUS;
  query->place_count = (uint32_t)places;
  query->at = keys + PLACE * room;
  query->source_mm = query->at + room;
  query->detector_mm = query->source_mm + room;
  query->mhz = query->detector_mm + room;
  query->quantity = query->mhz + room;
  return true;
}

static int request(const report *of, dipole_client *client, tissue_sample *one,
                   const dipole_tissue_fit_query *query) {
  dipole_error error;
  char what[128];
  if (CLI_RETRY(of->settings, &error, dipole_fit_tissue(client, query, &one->fits, &error))) {
    return CLI_OK;
  }
  const int used = snprintf(what, sizeof what, "sample %.80s: ", one->name);
  if (strcmp(error.field, "wavelength") == 0 && error.index < query->tissue.wavelength_count) {
    snprintf(what + used, sizeof what - (size_t)used,
             "%g nm: ", query->tissue.wavelengths_nm[error.index]);
  }
  return cli_fail_error_of(what, &error);
}

/* Requests the fit of a sample. */
static int fit_sample(report *of, dipole_client *client, tissue_sample *one) {
  dipole_tissue_fit_query query;
  if (!arrange(of, one, &query)) {
    return CLI_FAILED;
  }
  double *values = cli_allocate(2 * one->readings, sizeof *values),
         *errors = values + one->readings;
  for (size_t i = 0; i < one->readings; i++) {
    values[i] = one->all[i].value;
    errors[i] = one->all[i].error;
  }
  query.values = values;
  query.errors = errors;
  return request(of, client, one, &query);
}

/* ---- writing --------------------------------------------------------------------------------- */

static void put_facts(cli_rows *rows, const void *context) {
  const report *of = context;
  cli_put_profile(rows, &of->profile);
  if (of->profile.tissue == NULL) {
    cli_put_text(rows, of->profile.haemoglobin->name, "haemoglobin");
  }
  cli_put_number(rows, of->samples[0].fits->g, "g");
  cli_put_number(rows, of->samples[0].fits->eta, "eta");
  cli_put_text(rows, of->scale->name, "scale");
}

static size_t rows_of_sample(const report *of) {
  return of->query.sought_count + (of->blood ? 2 : 0);
}

/* Returns unknown k of a set, or the saturation or the total, and sets its name. */
static dipole_tissue_estimate estimate_of(const report *of, const dipole_tissue_fits *fits,
                                          size_t set, size_t k, const char **name) {
  const size_t unknowns = of->query.sought_count;
  const dipole_fitted_tissue *one = &fits->sets[set];
  if (k < unknowns) {
    const dipole_tissue_estimate *found = &fits->estimates[set * unknowns + k];
    *name = cli_choice_of_id(of->profile.info, DIPOLE_PROPERTY, found->property)->name;
    return *found;
  }
  const bool share = k == unknowns;
  *name = share ? "saturation" : "total_uM";
  return (dipole_tissue_estimate){.status = share ? one->saturation_status : one->total_status,
                                  .value = share ? one->saturation : one->total_uM,
                                  .error = share ? one->saturation_error : one->total_error_uM,
                                  .numerical = (double)NAN};
}

/* Writes one unknown, the saturation or the total of a sample. */
static void put_estimate(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const size_t each = rows_of_sample(of);
  const tissue_sample *sample = &of->samples[index / each];
  const dipole_fitted_tissue *set = sample->fits->sets;
  const char *name;
  const dipole_tissue_estimate one = estimate_of(of, sample->fits, 0, index % each, &name);
  const bool is_free = of->scale->id == DIPOLE_FREE;
  const unsigned with_factor = is_free ? 0U : CLI_IN_CSV | CLI_IN_JSON;
  cli_put_text(rows, sample->name, "sample");
  cli_put_text(rows, name, "unknown");
  cli_put_number(rows, one.value, "value", .format = "%.5g", .missing = "-");
  cli_put_number(rows, one.error, "error", .format = "%.2g", .missing = "-");
  cli_put_number(rows, one.numerical, "numerical", .format = "%.1e", .missing = "-");
  cli_put_text(rows, cli_fit_status(of->profile.info, one.status), "status");
  cli_put_number(rows, set->factor, "scale", .format = "%.5g", .missing = "-",
                 .forms = with_factor);
  cli_put_number(rows, set->factor_error, "scale_error", "its error", .format = "%.2g",
                 .missing = "-", .forms = with_factor);
  cli_put_number(rows, set->chi_squared, "chi2", .format = "%.4g", .missing = "-");
  cli_put_count(rows, sample->readings, "readings");
  cli_put_number(rows, set->condition, "condition", .format = "%.3g", .missing = "-");
  cli_put_number(rows, set->model_error, "model_error", .forms = CLI_IN_JSON);
  cli_put_text(rows, cli_fit_status(of->profile.info, set->status), "sample_status", "sample is");
}

static void write_foot(const void *context) {
  (void)context;
  puts("\nerrors are standard errors, inf where a value has none; numerical: how far numerical "
       "errors of R may\nshift a value; chi2 is the sum of the squares of (reading - fit) / error");
}

/* ---- images ---------------------------------------------------------------------------------- */

/* A map of values and one of errors for each unknown, the saturation and the total; then one of
 * chi-squared and one of statuses. */
enum { ESTIMATES_MOST = CORE_PROPERTIES_END + 2 };

struct maps {
  size_t estimates, bad; /* bad: pixels that were not fitted whole */
  cli_image images[2 * ESTIMATES_MOST + 2];
  size_t fitted[ESTIMATES_MOST]; /* pixels */
};

/* Reads the images of all readings, [readings]. Says what is wrong and returns false. */
static bool read_images(const report *of, cli_image *images) {
  const reading *all = of->samples->all;
  for (size_t i = 0; i < of->samples->readings; i++) {
    const char *file = of->sheet.labels[all[i].row];
    const cli_image *one = &images[i];
    if (!cli_image_read(file, true, &images[i])) {
      return false;
    }
    if (one->channels != 1 || one->width != images->width || one->height != images->height) {
      return cli_fails("%s: all images have to be grey, and of the size of %s, %zu x %zu", file,
                       of->sheet.labels[all[0].row], images->width, images->height);
    }
  }
  return true;
}

/* Takes what was found for row y. */
static void take_row(report *of, const dipole_tissue_fits *fits, size_t y, const cli_image *like) {
  struct maps *maps = of->maps;
  cli_image *last = &maps->images[2 * maps->estimates];
  for (size_t x = 0, at = y * like->width; x < like->width; x++, at++) {
    for (size_t k = 0; k < maps->estimates; k++) {
      const char *name;
      const dipole_tissue_estimate one = estimate_of(of, fits, x, k, &name);
      const bool fitted = one.status == DIPOLE_FITTED;
      maps->images[2 * k].values[at] = fitted ? (float)one.value : NAN;
      maps->images[2 * k + 1].values[at] = fitted ? (float)one.error : NAN;
      maps->fitted[k] += fitted;
    }
    of->blood = of->blood || !isnan(fits->sets[x].saturation_error);
    last[0].values[at] = (float)fits->sets[x].chi_squared;
    last[1].values[at] = fits->sets[x].status;
    maps->bad += fits->sets[x].status != DIPOLE_FITTED;
  }
}

/* Makes room for the maps. */
static void prepare_maps(report *of, const cli_image *like) {
  struct maps *maps = of->maps;
  maps->estimates = of->query.sought_count + 2;
  for (size_t i = 0; i < 2 * maps->estimates + 2; i++) {
    maps->images[i] = *like;
    maps->images[i].values = cli_allocate(like->width * like->height, sizeof(float));
  }
}

/* Requests the fits of all pixels, row by row. */
static int fit_rows(report *of, dipole_client *client, const cli_image *images,
                    dipole_tissue_fit_query *query) {
  tissue_sample *one = of->samples;
  const size_t readings = one->readings, width = images->width, height = images->height;
  double *values = cli_allocate(2 * readings * width, sizeof *values);
  double *errors = values + readings * width;
  int status = CLI_OK;
  cli_progress progress;
  query->set_count = width;
  query->values = values;
  query->errors = errors;
  prepare_maps(of, images);
  cli_progress_start(&progress, "pixels");
  for (size_t y = 0; y < height && status == CLI_OK; y++) {
    for (size_t i = 0; i < readings * width; i++) {
      values[i] = (double)images[i % readings].values[y * width + i / readings];
      errors[i] = error_of(&of->sheet, one->all[i % readings].row, values[i]);
    }
    dipole_tissue_fits_free(one->fits);
    one->fits = NULL;
    status = request(of, client, one, query);
    if (status == CLI_OK) {
      take_row(of, one->fits, y, images);
    }
    cli_progress_show(&progress, (double)(y + 1) / (double)height, (double)((y + 1) * width));
  }
  cli_progress_wipe(&progress);
  return status;
}

/* Writes OUT.pfm as OUT.hbo2_uM.pfm, OUT.hbo2_uM_error.pfm and so on. */
static bool write_map(const report *of, const char *name, const char *what, size_t i) {
  const char *out = of->settings->output;
  const size_t bytes = strlen(out) + strlen(name) + strlen(what) + sizeof ".pfm";
  char *file = cli_allocate(bytes, 1);
  snprintf(file, bytes, "%.*s%s%s.pfm", (int)strlen(out) - 3, out, name, what);
  return cli_image_write(file, &of->maps->images[i]);
}

static bool write_maps(const report *of) {
  const size_t last = 2 * of->maps->estimates;
  bool good = write_map(of, "chi2", "", last) && write_map(of, "status", "", last + 1);
  for (size_t k = 0; good && k < rows_of_sample(of); k++) {
    const char *name;
    estimate_of(of, of->samples->fits, 0, k, &name);
    good = write_map(of, name, "", 2 * k) && write_map(of, name, "_error", 2 * k + 1);
  }
  return good;
}

static void put_map(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const char *name;
  estimate_of(of, of->samples->fits, 0, index, &name);
  cli_put_text(rows, name, "unknown");
  cli_put_count(rows, of->maps->images->width * of->maps->images->height, "pixels");
  cli_put_count(rows, of->maps->fitted[index], "fitted");
}

static int fit_images(report *of, dipole_client *client) {
  dipole_tissue_fit_query query;
  of->samples->name = cli_copy("images", sizeof "images" - 1);
  cli_image *images = cli_allocate(of->sheet.count, sizeof *images);
  int status = arrange(of, of->samples, &query) && read_images(of, images)
                   ? fit_rows(of, client, images, &query)
                   : CLI_FAILED;
  status = status == CLI_OK && !write_maps(of) ? CLI_FAILED : status;
  if (status == CLI_OK) {
    const cli_report output = {
        .facts = put_facts, .rows = rows_of_sample(of), .put_row = put_map, .left = 1};
    cli_write(&output, of->settings->form, of);
  }
  dipole_tissue_fits_free(of->samples->fits);
  for (size_t i = 0; i < of->sheet.count; i++) {
    free(images[i].values);
  }
  return status != CLI_OK || of->maps->bad == 0
             ? status
             : cli_say(
                   CLI_BAD_ROWS,
                   "%s: %zu of %zu pixels were not fitted whole: what is not fitted is NaN; the "
                   "map status has the ids of `dipole info`",
                   of->sheet.source, of->maps->bad, images->width * images->height);
}

/* ---- running --------------------------------------------------------------------------------- */

int cli_fit_tissue_run(const cli_settings *settings, dipole_client *client) {
  static struct maps maps;
  report of = {.settings = settings, .maps = settings->output != NULL ? &maps : NULL};
  cli_progress progress;
  int status = read_samples(&of);
  status = status == CLI_OK ? take_query(&of, client) : status;
  if (status == CLI_OK && of.maps != NULL) {
    return fit_images(&of, client);
  }
  cli_progress_start(&progress, "samples");
  for (size_t i = 0; status == CLI_OK && i < of.sample_count; i++) {
    status = fit_sample(&of, client, &of.samples[i]);
    cli_progress_show(&progress, (double)(i + 1) / (double)of.sample_count, (double)(i + 1));
  }
  cli_progress_wipe(&progress);
  if (status != CLI_OK) {
    return status;
  }
  for (size_t i = 0; i < of.sample_count; i++) { /* refused ones do not have it */
    of.blood = of.blood || !isnan(of.samples[i].fits->sets->saturation_error);
  }
  const cli_report output = {.facts = put_facts,
                             .rows = of.sample_count * rows_of_sample(&of),
                             .put_row = put_estimate,
                             .left = 2,
                             .foot = write_foot};
  cli_write(&output, settings->form, &of);
  size_t bad = 0, reported = 0;
  for (size_t i = 0; i < of.sample_count; i++) {
    const tissue_sample *one = &of.samples[i];
    const dipole_fitted_tissue *set = one->fits->sets;
    bad += set->status != DIPOLE_FITTED;
    if (set->status == DIPOLE_FIT_REFUSED && set->index < one->readings &&
        reported++ < CLI_FIT_REPORTED_MAX) {
      cli_fit_report_reading(one->name, of.sheet.lines[one->all[set->index].row], set->field == 2);
    }
    dipole_tissue_fits_free(one->fits);
  }
  return bad == 0 ? CLI_OK
                  : cli_say(CLI_BAD_ROWS,
                            "%s: %zu of %zu samples were not fitted whole: see the column status",
                            of.sheet.source, bad, of.sample_count);
}
