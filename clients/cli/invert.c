/* dipole invert: the media that have given albedos, and a check that they do. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "clients/cli/rows.h"

typedef struct invert_settings {
  cli_profile_settings profile;
  cli_numbers albedo;
  cli_lengths lengths;
  cli_number g, eta;
} invert_settings;

#define FIELD(name) offsetof(invert_settings, name)

static const cli_option options[] = {
    {"Medium", NULL, NULL, CLI_HEADING, 0, NULL},
    {"albedo", "X[,X...]",
     "diffuse albedo: the share of the power that leaves, 0 to 1; one value for each channel",
     CLI_NUMBERS, FIELD(albedo), NULL},
    CLI_LENGTH_OPTIONS(invert_settings, lengths),
    {"g", "X", "mean cosine of the scattering angle (default: 0)", CLI_NUMBER, FIELD(g), NULL},
    {"eta", "X", "refractive index inside over outside", CLI_NUMBER, FIELD(eta), "1.3"},
    {"Evaluation", NULL, NULL, CLI_HEADING, 0, NULL},
    {"model", "NAME",
     "the model that gives the albedo; see `dipole info`. transport takes some 5 ms for each "
     "medium, better microseconds",
     CLI_TEXT, FIELD(profile.model), CLI_MODEL_DEFAULT},
    {CLI_MOMENTS_OPTION, NULL},
    {CLI_DEADLINE_OPTION, NULL},
    {0},
};

/* A medium that is asked for. */
typedef struct wanted {
  double wanted_albedo, length_mm;
  bool found;
  dipole_medium medium;
  double albedo; /* the albedo that the found medium has; NaN if no medium was found */
} wanted;

typedef struct report {
  cli_profile profile;
  const dipole_choice *given;
  double albedo_least, albedo_most;
  size_t count, missing;
  wanted *items;
  cli_progress progress;
} report;

/* ---- the command line ------------------------------------------------------------------------ */

static int check(void *given) {
  const invert_settings *settings = given;
  const char *name;
  const size_t albedos = settings->albedo.count;
  if (albedos == 0) {
    return cli_fail_usage("give --albedo, and --mean-free-path in mm");
  }
  const cli_numbers *lengths = cli_lengths_find(&settings->lengths, &name);
  if (lengths == NULL) {
    return CLI_USAGE;
  }
  if (albedos > 1 && lengths->count > 1 && albedos != lengths->count) {
    return cli_fail_usage("--%s has %zu values and --albedo has %zu: give one value or as many",
                          name, lengths->count, albedos);
  }
  return CLI_OK;
}

/* ---- asking ---------------------------------------------------------------------------------- */

static void take(report *of, const invert_settings *settings, size_t first,
                 const dipole_inversion *inversion) {
  of->albedo_least = inversion->albedo_least;
  of->albedo_most = inversion->albedo_most;
  of->missing += (size_t)inversion->missing_count;
  for (size_t i = 0; i < inversion->medium_count; i++) {
    wanted *one = &of->items[first + i];
    one->found = !isnan(inversion->sigma_a_per_mm[i]);
    one->medium = (dipole_medium){inversion->sigma_a_per_mm[i], inversion->sigma_s_per_mm[i],
                                  settings->g.value, settings->eta.value};
    one->albedo = (double)NAN;
  }
}

/* Asks for `count` media from number `first` on. */
static bool ask_some(dipole_client *client, const invert_settings *settings, report *of,
                     size_t first, size_t count, dipole_error *error) {
  double *albedos = cli_allocate(count, sizeof *albedos);
  double *lengths_mm = cli_allocate(count, sizeof *lengths_mm);
  for (size_t i = 0; i < count; i++) {
    albedos[i] = of->items[first + i].wanted_albedo;
    lengths_mm[i] = of->items[first + i].length_mm;
  }
  const dipole_invert_query query = {.model = of->profile.model->id,
                                     .moments = of->profile.moments->id,
                                     .given = of->given->id,
                                     .g = settings->g.value,
                                     .eta = settings->eta.value,
                                     .albedos = albedos,
                                     .lengths_mm = lengths_mm,
                                     .medium_count = count,
                                     .deadline_ms = (unsigned)settings->profile.deadline_ms.value};
  dipole_inversion *inversion;
  const bool good =
      CLI_ASK(&settings->profile.common, error, dipole_invert(client, &query, &inversion, error));
  if (good) {
    take(of, settings, first, inversion);
    dipole_inversion_free(inversion);
  }
  return good;
}

enum { SLOW_MEDIA = 64 };

/* steps: of two for each medium, which is found and then evaluated. */
static void show_progress(report *of, double steps) {
  cli_progress_show(&of->progress, steps / (2 * (double)of->count), steps / 2);
}

/* Transport takes milliseconds for each medium, so it is asked for few at a time: the daemon is then
 * not silent for long, however many media there are. */
static bool ask(dipole_client *client, const invert_settings *settings, report *of,
                dipole_error *error) {
  const bool slow = strcmp(of->profile.model->name, CLI_MODEL_DEFAULT) == 0;
  const size_t each = slow ? SLOW_MEDIA : of->count;
  bool good = true;
  of->missing = 0;
  cli_progress_start(&of->progress, "media");
  for (size_t first = 0; good && first < of->count; first += each) {
    const size_t left = of->count - first;
    good = ask_some(client, settings, of, first, left < each ? left : each, error);
    show_progress(of, fmin((double)(first + each), (double)of->count));
  }
  return good;
}

/* Evaluates the albedos of the media that were found. */
static bool verify(dipole_client *client, const invert_settings *settings, report *of,
                   dipole_error *error) {
  for (size_t i = 0; i < of->count; i++) {
    if (!of->items[i].found) {
      continue;
    }
    const dipole_query query = {.model = of->profile.model->id,
                                .evaluator = DIPOLE_F64,
                                .moments = of->profile.moments->id,
                                .wanted = DIPOLE_ALBEDO,
                                .media = &of->items[i].medium,
                                .medium_count = 1,
                                .spacing = DIPOLE_LIST,
                                .deadline_ms = (unsigned)settings->profile.deadline_ms.value};
    dipole_result *result;
    if (!CLI_ASK(&settings->profile.common, error, dipole_eval(client, &query, &result, error))) {
      return false;
    }
    of->items[i].albedo = result->channels[0].albedo;
    dipole_result_free(result);
    show_progress(of, (double)of->count + (double)(i + 1));
  }
  return true;
}

/* ---- writing --------------------------------------------------------------------------------- */

static const char *status_of(const report *of, const wanted *one) {
  if (one->found) {
    return "ok";
  }
  return one->wanted_albedo < of->albedo_least || one->wanted_albedo > of->albedo_most
             ? "out of reach"
             : "no such length";
}

static void put_medium(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const wanted *one = &of->items[index];
  const dipole_medium *medium = &one->medium;
  const double sigma_s = medium->sigma_s_per_mm;
  const double off = fabs(one->albedo - one->wanted_albedo);
  const double reduced = one->found ? sigma_s * (1 - medium->g) : (double)NAN;
  const char *reason = one->found ? NULL : status_of(of, one), *none = one->found ? NULL : "-";
  const unsigned programs = CLI_IN_CSV | CLI_IN_JSON;
  cli_put_text(rows, CLI_COLUMN("model", .forms = programs), of->profile.model->name);
  cli_put_count(rows, CLI_COLUMN("channel"), index + 1);
  cli_put_number(rows, CLI_COLUMN("wanted_albedo", "albedo", "wanted"), one->wanted_albedo);
  cli_put_text(rows, CLI_COLUMN("given", .forms = programs), of->given->name);
  cli_put_number(rows, CLI_COLUMN("length", of->given->name, "mm"), one->length_mm);
  cli_put_shown(rows, CLI_COLUMN("sigma_a", NULL, "1/mm", "%.9g"), medium->sigma_a_per_mm, reason);
  cli_put_shown(rows, CLI_COLUMN("sigma_s", NULL, "1/mm", "%.9g"), sigma_s, none);
  cli_put_shown(rows, CLI_COLUMN("sigma_s'", NULL, "1/mm", "%.9g", .forms = CLI_IN_TABLE), reduced,
                none);
  cli_put_shown(rows, CLI_COLUMN("g"), medium->g, none);
  cli_put_shown(rows, CLI_COLUMN("eta"), medium->eta, none);
  cli_put_shown(rows, CLI_COLUMN("albedo", "check: albedo"), one->albedo, none);
  cli_put_shown(rows, CLI_COLUMN("off by", .format = "%.1e", .forms = CLI_IN_TABLE), off, none);
  cli_put_text(rows, CLI_COLUMN("status", .forms = programs), status_of(of, one));
}

static void put_facts(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  (void)index;
  cli_put_profile(rows, &of->profile);
  cli_put_text(rows, CLI_COLUMN("given"), of->given->name);
  cli_put_text(rows, CLI_COLUMN("formula", "="), of->given->about);
  cli_put_number(rows, CLI_COLUMN("albedo_least", "albedos from"), of->albedo_least);
  cli_put_number(rows, CLI_COLUMN("albedo_most", "to"), of->albedo_most);
}

static void write_foot(const void *context) {
  const report *of = context;
  puts("check: an evaluation of the medium");
  cli_write_launched(&of->items[0].medium, of->count > 0 ? 1 : 0); /* all have one eta */
}

/* Everything is written in any case; then the user is told which media there are not. */
static int write_and_judge(const invert_settings *settings, const report *of) {
  const cli_report output = {
      .facts = put_facts, .rows = of->count, .put_row = put_medium, .left = 1, .foot = write_foot};
  cli_write(&output, settings->profile.common.form, of);
  if (of->missing == 0) {
    return CLI_OK;
  }
  cli_fail(
      "%zu of %zu: there is no such medium: with this model, g and eta albedos above 0 go from "
      "%.3g to %.17g, and without absorption there is no diffuse path",
      of->missing, of->count, of->albedo_least, of->albedo_most);
  return CLI_BAD_ROWS;
}

/* ---- the command ----------------------------------------------------------------------------- */

static int ask_and_write(const invert_settings *settings, dipole_client *client, report *of) {
  const char *length = NULL;
  const cli_numbers *lengths = cli_lengths_find(&settings->lengths, &length);
  dipole_error error;
  of->count = settings->albedo.count > lengths->count ? settings->albedo.count : lengths->count;
  of->items = cli_allocate(of->count, sizeof *of->items);
  for (size_t i = 0; i < of->count; i++) {
    of->items[i].wanted_albedo = cli_numbers_pick(&settings->albedo, i, 0);
    of->items[i].length_mm = cli_numbers_pick(lengths, i, 0);
  }
  if (!cli_profile_take_names(&settings->profile, client, &of->profile)) {
    return CLI_USAGE;
  }
  of->given = cli_choice(of->profile.info, DIPOLE_LENGTH, length);
  if (of->given == NULL) {
    return cli_fail("--%s: this daemon does not know it; name another length", length);
  }
  const bool good = ask(client, settings, of, &error) && verify(client, settings, of, &error);
  cli_progress_wipe(&of->progress);
  if (good) {
    return write_and_judge(settings, of);
  }
  if (strcmp(error.field, "length") == 0) {
    return cli_fail("%s (--%s)", error.text, length);
  }
  return cli_fail_error(&error);
}

static int run(void *settings, dipole_client *client) {
  report of = {0};
  return ask_and_write(settings, client, &of);
}

const cli_command cli_command_invert = {
    .name = "invert",
    .about = "Find the medium that has a given albedo: sigma_a and sigma_s",
    .more =
        "\n"
        "Takes a diffuse albedo and a length, and finds the coefficients of a medium that has\n"
        "them by a model. sigma_t' is sigma_a + sigma_s (1 - g). As a check, the albedo of that\n"
        "medium is evaluated. The exit status is 3 if there is no such medium for some channel.\n",
    .formats = "table,csv,json",
    .options = {options},
    .settings_bytes = sizeof(invert_settings),
    .check = check,
    .run = run,
    .examples = "  dipole invert --albedo 0.44,0.22,0.13 --mean-free-path 1.3,0.95,0.67\n"
                "  dipole invert --albedo 0.8 --diffuse-mean-free-path 2 --g 0.9 --eta 1.4\n"
                "  dipole invert --albedo 0.1,0.5,0.9 --mean-free-path 1 --model classical "
                "--format csv\n"
                "  dipole invert --albedo 0.8 --mean-free-path 1 --model quantized --format json\n",
};
