/* dipole invert: the media that have given albedos, and a check that they do. */
#include "clients/cli/invert.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define MODEL_DEFAULT "better"
#define MOMENTS_DEFAULT "exact"
#define G_DEFAULT 0.0
#define ETA_DEFAULT 1.3

typedef struct invert_settings {
  cli_common common;
  cli_numbers albedo;
  cli_numbers free_path, diffuse_path, classical_path;
  cli_number g, eta;
  const char *model, *moments;
  cli_count deadline_ms;
} invert_settings;

#define FIELD(name) offsetof(invert_settings, name)

static const cli_option options[] = {
    {"Medium", NULL, NULL, CLI_HEADING, 0},
    {"albedo", "X[,X...]",
     "diffuse albedo, from 0 to 1, per power that entered; one value for\neach channel",
     CLI_NUMBERS, FIELD(albedo)},
    {"mean-free-path", "X[,X...]", "1 / sigma_t', mm; a single value holds for all channels",
     CLI_NUMBERS, FIELD(free_path)},
    {"diffuse-mean-free-path", "X[,X...]",
     "instead: 1 / (sigma_t' sqrt(3 a / (1 + a))), a = sigma_a / sigma_t', mm", CLI_NUMBERS,
     FIELD(diffuse_path)},
    {"classical-diffuse-path", "X[,X...]", "instead: 1 / sqrt(3 sigma_a sigma_t'), mm", CLI_NUMBERS,
     FIELD(classical_path)},
    {"g", "X", "mean cosine of the scattering angle (default: 0)", CLI_NUMBER, FIELD(g)},
    {"eta", "X", "refractive index inside over outside (default: 1.3)", CLI_NUMBER, FIELD(eta)},
    {"Evaluation", NULL, NULL, CLI_HEADING, 0},
    {"model", "NAME", "whose albedo is given, see `dipole info` (default: better)", CLI_TEXT,
     FIELD(model)},
    {"moments", "NAME", "Fresnel moments, see `dipole info` (default: exact)", CLI_TEXT,
     FIELD(moments)},
    {"deadline-ms", "N",
     "the daemon shall answer within N ms, or not at all; 0: at any time\n"
     "(default: 0)",
     CLI_COUNT, FIELD(deadline_ms)},
    {0},
};

static const struct {
  const char *name;
  void (*write)(const cli_invert_report *report, FILE *file);
} formats[] = {
    {"table", cli_invert_write_table},
    {"csv", cli_invert_write_csv},
    {"json", cli_invert_write_json},
};

/* ---- lengths -------------------------------------------------------------------------------- */

/* The one length that is given; its name is that of the option and of the daemon's choice. NULL:
 * none or several. */
static const cli_numbers *length_of(const invert_settings *settings, const char **name) {
  const struct {
    const char *name;
    const cli_numbers *numbers;
  } lengths[] = {{"mean-free-path", &settings->free_path},
                 {"diffuse-mean-free-path", &settings->diffuse_path},
                 {"classical-diffuse-path", &settings->classical_path}};
  const cli_numbers *found = NULL;
  for (size_t i = 0; i < sizeof lengths / sizeof lengths[0]; i++) {
    if (lengths[i].numbers->count > 0) {
      if (found != NULL) {
        return NULL;
      }
      found = lengths[i].numbers;
      *name = lengths[i].name;
    }
  }
  return found;
}

/* What can be seen to be wrong without a daemon. */
static int check(const cli_command *command, const invert_settings *settings) {
  const char *name;
  const cli_numbers *lengths = length_of(settings, &name);
  const size_t albedos = settings->albedo.count;
  if (albedos == 0) {
    return cli_fail_usage(command, "give --albedo, and --mean-free-path in mm");
  }
  if (lengths == NULL) {
    return cli_fail_usage(command, "give one of --mean-free-path, --diffuse-mean-free-path and "
                                   "--classical-diffuse-path, in mm");
  }
  if (albedos > 1 && lengths->count > 1 && albedos != lengths->count) {
    return cli_fail_usage(command,
                          "--%s has %zu values and --albedo has %zu: give one value or as many",
                          name, lengths->count, albedos);
  }
  if (settings->deadline_ms.value > UINT32_MAX) {
    return cli_fail_usage(command, "--deadline-ms: at most %lu", (unsigned long)UINT32_MAX);
  }
  return CLI_OK;
}

/* ---- asking --------------------------------------------------------------------------------- */

static double pick(const cli_numbers *numbers, size_t index) {
  return numbers->items[numbers->count == 1 ? 0 : index];
}

static bool choose(const cli_command *command, const invert_settings *settings, const char *given,
                   cli_invert_report *report) {
  const char *model = settings->model != NULL ? settings->model : MODEL_DEFAULT;
  const char *moments = settings->moments != NULL ? settings->moments : MOMENTS_DEFAULT;
  report->model = cli_named(command, report->info, DIPOLE_MODEL, "model", model);
  if (report->model == NULL) {
    return false;
  }
  report->moments = cli_named(command, report->info, DIPOLE_MOMENTS, "moments", moments);
  if (report->moments == NULL) {
    return false;
  }
  report->given = cli_choice(report->info, DIPOLE_LENGTH, given);
  if (report->given == NULL) {
    cli_fail(command, "--%s: this daemon does not know it", given);
  }
  return report->given != NULL;
}

/* Says what is wrong; an exit status. */
static int fail(const cli_command *command, const char *given, const dipole_error *error) {
  char option[64];
  const char *field = strcmp(error->field, "length") == 0 ? given : error->field;
  cli_fail(command, "%s%s", error->text, cli_option_of(command, field, option, sizeof option));
  return CLI_FAILED;
}

static void take(cli_invert_report *report, const dipole_inversion *inversion) {
  report->albedo_least = inversion->albedo_least;
  report->albedo_most = inversion->albedo_most;
  report->missing = (size_t)inversion->missing_count;
  for (size_t i = 0; i < report->count; i++) {
    cli_invert_row *row = &report->rows[i];
    row->found = !isnan(inversion->sigma_a_per_mm[i]);
    row->medium = (dipole_medium){inversion->sigma_a_per_mm[i], inversion->sigma_s_per_mm[i],
                                  report->g, report->eta};
    row->albedo = (double)NAN;
  }
}

static bool ask(dipole_client *client, const invert_settings *settings, cli_invert_report *report,
                dipole_error *error) {
  double *albedos = cli_allocate(report->count, sizeof *albedos);
  double *lengths_mm = cli_allocate(report->count, sizeof *lengths_mm);
  for (size_t i = 0; i < report->count; i++) {
    albedos[i] = report->rows[i].wanted_albedo;
    lengths_mm[i] = report->rows[i].length_mm;
  }
  const dipole_invert_query query = {.model = report->model->id,
                                     .moments = report->moments->id,
                                     .given = report->given->id,
                                     .g = report->g,
                                     .eta = report->eta,
                                     .albedos = albedos,
                                     .lengths_mm = lengths_mm,
                                     .medium_count = report->count,
                                     .deadline_ms = (unsigned)settings->deadline_ms.value};
  dipole_inversion *inversion;
  const bool good = cli_invert(client, &settings->common, &query, &inversion, error);
  if (good) {
    take(report, inversion);
    dipole_inversion_free(inversion);
  }
  free(albedos);
  free(lengths_mm);
  return good;
}

static bool take_albedo(void *context, const dipole_result *part, uint64_t radius_first) {
  (void)radius_first;
  *(double *)context = part->channels[0].albedo;
  return true;
}

/* The albedos of the media that were found, evaluated. */
static bool verify(dipole_client *client, const invert_settings *settings,
                   cli_invert_report *report, dipole_error *error) {
  for (size_t i = 0; i < report->count; i++) {
    cli_invert_row *row = &report->rows[i];
    const dipole_query query = {.model = report->model->id,
                                .evaluator = DIPOLE_F64,
                                .moments = report->moments->id,
                                .wanted = DIPOLE_ALBEDO,
                                .media = &row->medium,
                                .medium_count = 1,
                                .spacing = DIPOLE_LIST,
                                .deadline_ms = (unsigned)settings->deadline_ms.value};
    if (row->found &&
        !cli_eval_parts(client, &settings->common, &query, take_albedo, &row->albedo, error)) {
      return false;
    }
  }
  return true;
}

/* ---- the command ---------------------------------------------------------------------------- */

const char *cli_invert_reason(const cli_invert_report *report, const cli_invert_row *row) {
  if (row->found) {
    return "ok";
  }
  return row->wanted_albedo < report->albedo_least || row->wanted_albedo > report->albedo_most
             ? "out of reach"
             : "no such length";
}

/* All is written in any case; whoever asked for what there is not is told. */
static int write_and_judge(const cli_command *command, const invert_settings *settings,
                           const cli_invert_report *report) {
  const char *format = settings->common.format != NULL ? settings->common.format : formats[0].name;
  for (size_t i = 0; i < sizeof formats / sizeof formats[0]; i++) {
    if (strcmp(formats[i].name, format) == 0) {
      formats[i].write(report, stdout);
    }
  }
  if (report->missing == 0) {
    return CLI_OK;
  }
  cli_fail(
      command,
      "%zu of %zu: there is no such medium: with this model, g and eta albedos go from %.3g to "
      "%.17g, and without absorption there is no diffuse path",
      report->missing, report->count, report->albedo_least, report->albedo_most);
  return CLI_BAD_ROWS;
}

static int run_with_daemon(const cli_command *command, const invert_settings *settings,
                           dipole_client *client, cli_invert_report *report) {
  const char *given = NULL;
  const cli_numbers *lengths = length_of(settings, &given);
  dipole_error error;
  report->info = dipole_get_info(client);
  report->g = settings->g.given ? settings->g.value : G_DEFAULT;
  report->eta = settings->eta.given ? settings->eta.value : ETA_DEFAULT;
  report->count = settings->albedo.count > lengths->count ? settings->albedo.count : lengths->count;
  report->rows = cli_allocate(report->count, sizeof *report->rows);
  for (size_t i = 0; i < report->count; i++) {
    report->rows[i].wanted_albedo = pick(&settings->albedo, i);
    report->rows[i].length_mm = pick(lengths, i);
  }
  if (!choose(command, settings, given, report)) {
    return report->moments != NULL ? CLI_FAILED : CLI_USAGE;
  }
  if (!ask(client, settings, report, &error) || !verify(client, settings, report, &error)) {
    return fail(command, given, &error);
  }
  return write_and_judge(command, settings, report);
}

static int run(const cli_command *command, int argc, char **argv) {
  invert_settings settings = {0};
  cli_invert_report report = {0};
  dipole_client *client;
  const char *operand;
  int status;
  if (cli_options_read(command, argc, argv, &settings, &operand, &status)) {
    status = check(command, &settings);
    if (status == CLI_OK && !cli_open(command, &settings.common, &client)) {
      status = CLI_FAILED;
    } else if (status == CLI_OK) {
      status = run_with_daemon(command, &settings, client, &report);
      free(report.rows);
      dipole_close(client);
    }
  }
  cli_options_free(command, &settings);
  return status;
}

const cli_command cli_command_invert = {
    .name = "invert",
    .about = "Find the medium that has a given albedo: sigma_a and sigma_s",
    .more =
        "\n"
        "From a diffuse albedo and a length to the coefficients of a medium that has them under\n"
        "a model, sigma_t' = sigma_a + sigma_s (1 - g). Beside it stands the albedo of this\n"
        "medium, evaluated. The exit status is 3 when some of the media cannot be.\n",
    .formats = "table,csv,json",
    .options = options,
    .examples = "  dipole invert --albedo 0.44,0.22,0.13 --mean-free-path 1.3,0.95,0.67\n"
                "  dipole invert --albedo 0.8 --diffuse-mean-free-path 2 --g 0.9 --eta 1.4\n"
                "  dipole invert --albedo 0.1,0.5,0.9 --mean-free-path 1 --model classical "
                "--format csv\n"
                "  dipole invert --albedo 0.8 --mean-free-path 1 --model quantized --format json\n",
    .run = run,
};
