/* dipole invert: the media that have given albedos. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/csv.h"
#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "clients/cli/rows.h"

static const cli_option options[] = {
    CLI_TITLE("Medium"),
    CLI_OPTION(
        NUMBERS, albedo, NULL,
        "diffuse albedo: the share that leaves of the power that entered, 0 to 1, linear; one "
        "value for each channel"),
    CLI_OPTION(SWITCH, srgb, NULL, "the albedos are sRGB values, 0 to 1"),
    CLI_COLOUR_OPTIONS,
    CLI_LENGTH_OPTIONS,
    CLI_OPTION(ONE, g, NULL, "mean cosine of the scattering angle (default: 0)"),
    CLI_OPTION(ONE, eta, "1.3", "refractive index inside over outside; 1: no interface"),
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAME, model, CLI_MODEL_DEFAULT,
               "the model that gives the albedo; see `dipole info`. transport takes some 5 ms for "
               "each medium, better microseconds"),
    CLI_MOMENTS_OPTION,
    CLI_DEADLINE_OPTION,
    {0},
};

/* A medium to find. */
typedef struct wanted {
  double wanted_albedo, length_mm;
  dipole_inversion *found; /* of one medium */
} wanted;

typedef struct report {
  cli_profile profile;
  const dipole_choice *given, *light;
  double g, eta, albedo_least, albedo_most;
  size_t count, requested, missing;
  wanted *items;
} report;

/* ---- the command line ------------------------------------------------------------------------ */

/* Columns of a file; g and eta are refused, because all rows have those of the options. */
enum { ALBEDO, LENGTHS = 4, G, ETA, COLUMNS };
static const char *const names[COLUMNS] = {"albedo",
                                           "mean_free_path",
                                           "diffuse_mean_free_path",
                                           "classical_diffuse_path",
                                           "extinction_path",
                                           "g",
                                           "eta"};

static bool has_columns(const cli_sheet *sheet, const cli_csv_record *header) {
  for (size_t i = G; i <= ETA; i++) {
    if (sheet->at[i] != CLI_CSV_ABSENT) {
      return cli_fails("%s: the header has the column %s: all rows have that of --%s; rename it",
                       sheet->source, names[i], names[i]);
    }
  }
  return sheet->at[ALBEDO] != CLI_CSV_ABSENT ||
         cli_csv_fail_missing(
             sheet->source, header, names[ALBEDO],
             "albedo, and a length such as mean_free_path unless an option gives it");
}

/* Takes the numbers of a file for those of options. Says what is wrong and returns false. */
static bool read_file(cli_settings *settings) {
  cli_numbers *const lists[] = {&settings->albedo, &settings->mean_free_path,
                                &settings->diffuse_mean_free_path,
                                &settings->classical_diffuse_path, &settings->extinction_path};
  cli_sheet sheet;
  if (!cli_sheet_read(settings->operand, NULL, names, COLUMNS, has_columns, &sheet)) {
    return false;
  }
  for (size_t c = 0; c <= LENGTHS; c++) {
    if (sheet.at[c] == CLI_CSV_ABSENT) {
      continue;
    }
    if (lists[c]->count > 0) {
      return cli_fails("%s: the header has the column %s: leave that option out", sheet.source,
                       names[c]);
    }
    lists[c]->count = sheet.count;
    lists[c]->items = cli_allocate(sheet.count, sizeof *lists[c]->items);
    for (size_t i = 0; i < sheet.count; i++) {
      lists[c]->items[i] = cli_sheet_number(&sheet, i, c);
      if (isnan(lists[c]->items[i])) {
        return cli_fails("%s: line %llu: %s: there is no number", sheet.source,
                         (unsigned long long)sheet.lines[i], names[c]);
      }
    }
  }
  return sheet.count > 0 || cli_fails("%s: it has no rows", sheet.source);
}

static int check(cli_settings *settings) {
  const char *name;
  if (settings->operand != NULL && !read_file(settings)) {
    return CLI_FAILED;
  }
  const size_t albedos = settings->albedo.count;
  if (albedos == 0) {
    return cli_fail_usage("give --albedo, and --mean-free-path; or FILE, which has them");
  }
  const cli_numbers *lengths = cli_lengths_find(settings, &name);
  if (lengths == NULL) {
    return CLI_USAGE;
  }
  if (albedos > 1 && lengths->count > 1 && albedos != lengths->count) {
    return cli_fail_usage("--%s has %zu values and --albedo has %zu: give one value or as many",
                          name, lengths->count, albedos);
  }
  return CLI_OK;
}

/* ---- requests ---------------------------------------------------------------------------------- */

/* Requests one medium after the other, so that the daemon is not silent for long. */
static bool request_media(dipole_client *client, const cli_settings *settings, report *of,
                          dipole_error *error) {
  cli_progress progress;
  bool good = true;
  cli_progress_start(&progress, "media");
  for (size_t i = 0; good && i < of->count; i++) {
    wanted *one = &of->items[i];
    const dipole_invert_query query = {.model = of->profile.model->id,
                                       .moments = of->profile.moments->id,
                                       .given = of->given->id,
                                       .light = of->light->id,
                                       .specular = settings->specular,
                                       .g = of->g,
                                       .eta = of->eta,
                                       .albedos = &one->wanted_albedo,
                                       .lengths_mm = &one->length_mm,
                                       .medium_count = 1,
                                       .deadline_ms = (unsigned)settings->deadline_ms.value};
    of->requested = i + 1;
    good = CLI_RETRY(settings, error, dipole_invert(client, &query, &one->found, error));
    if (good) {
      of->albedo_least = one->found->albedo_least;
      of->albedo_most = one->found->albedo_most;
      of->missing += one->found->missing_count;
    }
    cli_progress_show(&progress, (double)(i + 1) / (double)of->count, (double)(i + 1));
  }
  cli_progress_wipe(&progress);
  return good;
}

/* ---- writing --------------------------------------------------------------------------------- */

static const char *status_of(const report *of, const wanted *one) {
  return one->found->missing_count == 0 ? "ok"
         : one->wanted_albedo < of->albedo_least || one->wanted_albedo > of->albedo_most
             ? "out of reach"
             : "no such length";
}

static void put_medium(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const wanted *one = &of->items[index];
  const dipole_inversion *found = one->found;
  const double sigma_s = found->sigma_s_per_mm[0];
  const unsigned programs = CLI_IN_CSV | CLI_IN_JSON;
  cli_put_text(rows, of->profile.model->name, "model", .forms = programs);
  cli_put_count(rows, index + 1, "channel");
  cli_put_number(rows, one->wanted_albedo, "wanted_albedo", "albedo", .below = "wanted");
  cli_put_text(rows, of->given->name, "given", .forms = programs);
  cli_put_number(rows, one->length_mm, "length", of->given->name, "mm");
  cli_put_number(rows, found->sigma_a_per_mm[0], "sigma_a", NULL, "1/mm", "%.9g", "-");
  cli_put_number(rows, found->sigma_a_errors_per_mm[0], "sigma_a_error", "+-", "1/mm", "%.2g", "-");
  cli_put_number(rows, sigma_s, "sigma_s", NULL, "1/mm", "%.9g", "-");
  cli_put_number(rows, found->sigma_s_errors_per_mm[0], "sigma_s_error", "+-", "1/mm", "%.2g", "-");
  cli_put_number(rows, sigma_s * (1 - of->g), "sigma_s'", NULL, "1/mm", "%.9g", "-",
                 .forms = CLI_IN_TABLE);
  cli_put_number(rows, of->g, "g");
  cli_put_number(rows, of->eta, "eta");
  cli_put_number(rows, found->albedos[0], "albedo", "its albedo", .missing = "-");
  cli_put_number(rows, found->model_errors[0], "albedo_model_error", "model error", NULL, "%.2g",
                 "-");
  cli_put_text(rows, status_of(of, one), "status");
}

static void put_facts(cli_rows *rows, const void *context) {
  const report *of = context;
  cli_put_profile(rows, &of->profile);
  cli_put_text(rows, of->given->name, "given");
  cli_put_text(rows, of->given->about, "formula", "=");
  cli_put_number(rows, of->albedo_least, "albedo_least", "albedos from");
  cli_put_number(rows, of->albedo_most, "albedo_most", "to");
}

static void write_foot(const void *context) {
  const report *of = context;
  cli_write_launched(&(dipole_medium){.eta = of->eta}, 1, 1);
}

/* ---- the command ----------------------------------------------------------------------------- */

static int fail_request(const report *of, const char *length, const dipole_error *error) {
  char place[96] = "";
  if (of->count > 1) {
    snprintf(place, sizeof place, "channel %zu: ", of->requested);
  }
  return strcmp(error->field, "length") == 0 ? cli_fail("%s%s (--%s)", place, error->text, length)
                                             : cli_fail_error_of(place, error);
}

static int run_invert(const cli_settings *settings, dipole_client *client) {
  report of = {.g = cli_numbers_pick(&settings->g, 0, 0), .eta = settings->eta.items[0]};
  const char *length = NULL;
  const cli_numbers *lengths = cli_lengths_find(settings, &length);
  dipole_error error;
  of.count = settings->albedo.count > lengths->count ? settings->albedo.count : lengths->count;
  of.items = cli_allocate(of.count, sizeof *of.items);
  for (size_t i = 0; i < of.count; i++) {
    const double albedo = cli_numbers_pick(&settings->albedo, i, 0);
    of.items[i].wanted_albedo = settings->srgb ? cli_srgb_to_linear(albedo) : albedo;
    of.items[i].length_mm = cli_unit_mm(settings) * cli_numbers_pick(lengths, i, 0);
  }
  if (!cli_profile_take_names(settings, client, &of.profile)) {
    return CLI_USAGE;
  }
  of.light = cli_named(of.profile.info, DIPOLE_LIGHT, "light", settings->light);
  of.given = cli_named(of.profile.info, DIPOLE_LENGTH, "length", length);
  if (of.light == NULL || of.given == NULL) {
    return CLI_USAGE;
  }
  const bool good = request_media(client, settings, &of, &error);
  const cli_report output = {
      .facts = put_facts, .rows = of.count, .put_row = put_medium, .left = 1, .foot = write_foot};
  if (good) {
    cli_write(&output, settings->form, &of);
  }
  for (size_t i = 0; i < of.count; i++) {
    dipole_inversion_free(of.items[i].found);
  }
  return !good ? fail_request(&of, length, &error)
         : of.missing == 0
             ? CLI_OK
             : cli_say(
                   CLI_BAD_ROWS,
                   "%zu of %zu: there is no such medium: with this model, g and eta albedos above "
                   "0 go from %.3g to %.17g, and without absorption there is no diffuse path",
                   of.missing, of.count, of.albedo_least, of.albedo_most);
}

const cli_command cli_command_invert = {
    .name = "invert",
    .operand = "[FILE]",
    .about = "Find the medium that has a given albedo: sigma_a and sigma_s",
    .more = "Takes a diffuse albedo and a length, and finds the coefficients of a medium that has "
            "them by a model. sigma_t' is sigma_a + sigma_s (1 - g). The errors of coefficients "
            "are the most by which they are off the model's exact formula; the model error is how "
            "far the albedo is from radiative transport's, relative. The exit status is 3 if there "
            "is no such medium for some channel.\n"
            "FILE is CSV with the columns albedo and mean_free_path (or another length; as the "
            "options, with _ for -); - is standard input. Each row is a channel. For images, see "
            "`dipole texture`." CLI_CSV_TEXT,
    .formats = "table,csv,json",
    .options = {options},
    .check = check,
    .run = run_invert,
    .examples = "  dipole invert --albedo 0.44,0.22,0.13 --mean-free-path 1.3,0.95,0.67\n"
                "  dipole invert colours.csv --format csv | dipole points --r 1 > with_R.csv\n"
                "  dipole invert --albedo 0.8 --diffuse-mean-free-path 2 --g 0.9 --eta 1.4\n"
                "  dipole invert --albedo 0.8,0.5,0.2 --srgb --extinction-path 1 --light diffuse "
                "--model transport\n"
                "  dipole invert --albedo 0.1,0.5,0.9 --mean-free-path 1 --model classical "
                "--format csv\n"
                "  dipole invert --albedo 0.8 --mean-free-path 1 --model quantized --format json\n",
};
