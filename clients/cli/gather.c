/* dipole gather: the light that points leave at other positions. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/cloud.h"
#include "clients/cli/csv.h"
#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"

typedef struct gather_settings {
  cli_profile_settings profile;
  cli_number tolerance;
  const char *output;
} gather_settings;

static const cli_option options[] = {
    {"Evaluation", NULL, NULL, CLI_HEADING, 0, NULL},
    {"model", "NAME", "the model; `dipole info` lists them (default: transport)", CLI_TEXT,
     offsetof(gather_settings, profile.model), CLI_MODEL_DEFAULT},
    {"evaluator", "NAME",
     "f64 or f32: double or single precision; lut: single, by a table\n(default: lut)", CLI_TEXT,
     offsetof(gather_settings, profile.evaluator), "lut"},
    {CLI_MOMENTS_OPTION, "exact"},
    {"tolerance", "X",
     "largest relative error, at each query, that groups of points may cause which\n"
     "stand for their points: 1e-9 to .5, or 0 for none (default: .01)",
     CLI_NUMBER, offsetof(gather_settings, tolerance), "0.01"},
    {CLI_DEADLINE_OPTION, NULL},
    {"Output", NULL, NULL, CLI_HEADING, 0, NULL},
    {"output", "FILE",
     "write to this file: CSV, or PLY with colours if it ends with .ply (default:\n"
     "CSV to standard output)",
     CLI_TEXT, offsetof(gather_settings, output), NULL},
    {0},
};

static int check(void *given) {
  const gather_settings *settings = given;
  const cli_common *common = &settings->profile.common;
  if (common->operand == NULL || common->second_operand == NULL) {
    return cli_fail_usage("name two files: the points, and the queries");
  }
  const int status = cli_medium_check(&settings->profile);
  return status != CLI_OK ? status : cli_deadline_check(&settings->profile);
}

/* ---- asking ---------------------------------------------------------------------------------- */

static bool follow(void *context, uint64_t answered, uint64_t count) {
  cli_progress_show(context, (double)answered / (double)count, (double)answered);
  return !cli_interrupted();
}

/* Says what was refused, and where the point or query at fault stands. */
static int fail_at(const dipole_error *error, const cli_cloud *points, const cli_cloud *queries) {
  char place[512];
  const bool of_queries = strcmp(error->field, "queries") == 0;
  const bool of_points = strcmp(error->field, "points") == 0 || strcmp(error->field, "power") == 0;
  if (error->kind != DIPOLE_ERROR_REFUSED || (!of_queries && !of_points)) {
    return cli_fail_error(error);
  }
  cli_cloud_place(of_queries ? queries : points, error->index, place, sizeof place);
  return cli_fail_error_of(place, error);
}

static int ask(const gather_settings *settings, dipole_client *client, dipole_gather_query *query,
               const cli_cloud *points, const cli_cloud *queries, double *M) {
  dipole_error error;
  dipole_points *set;
  dipole_gather_result result;
  cli_progress progress;
  if (points->count == 0) {
    return cli_fail("%s: it has no points", points->file);
  }
  if (!dipole_points_make(points->count, points->channels, points->xyz_mm, points->power_W, &set,
                          &error)) {
    return cli_fail("%s: %s", points->file, error.text);
  }
  query->points = set;
  cli_catch_interrupt();
  cli_progress_start(&progress, "queries");
  const bool good = CLI_ASK(&settings->profile.common, &error,
                            dipole_gather(client, query, follow, &progress, M, &result, &error));
  cli_progress_wipe(&progress);
  dipole_points_free(set);
  if (!good) {
    return fail_at(&error, points, queries);
  }
  return cli_interrupted() && result.answered_count < queries->count
             ? cli_fail("interrupted after %llu of %llu queries; nothing was written",
                        (unsigned long long)result.answered_count,
                        (unsigned long long)queries->count)
             : CLI_OK;
}

/* ---- the command ----------------------------------------------------------------------------- */

/* Makes the query of the profile. Returns an exit status. */
static int take_query(const gather_settings *settings, const cli_profile *profile,
                      const cli_cloud *points, const cli_cloud *queries,
                      dipole_gather_query *query) {
  if (profile->channel_count != points->channels) {
    return cli_fail_usage("%s has %u powers for each point, and the medium %zu channels: give as "
                          "many media, or choose with --channel",
                          points->file, points->channels, profile->channel_count);
  }
  *query = (dipole_gather_query){
      .model = profile->model->id,
      .evaluator = profile->evaluator->id,
      .moments = profile->moments->id,
      .media = profile->media,
      .queries_mm = queries->xyz_mm,
      .query_count = queries->count,
      .tolerance = settings->tolerance.value,
      .deadline_ms = (unsigned)settings->profile.deadline_ms.value,
  };
  return CLI_OK;
}

static int gather(const gather_settings *settings, dipole_client *client,
                  const cli_profile *profile, const cli_cloud *points, const cli_cloud *queries) {
  dipole_gather_query query;
  int status = take_query(settings, profile, points, queries, &query);
  if (status != CLI_OK) {
    return status;
  }
  double *M = cli_allocate((size_t)queries->count * points->channels + 1, sizeof *M);
  status = ask(settings, client, &query, points, queries, M);
  if (status == CLI_OK && !cli_cloud_write(settings->output, queries, points->channels, M)) {
    status = CLI_FAILED;
  }
  free(M);
  return status;
}

static int run(void *given, dipole_client *client) {
  const gather_settings *settings = given;
  const cli_common *common = &settings->profile.common;
  cli_profile profile = {0};
  cli_cloud points = {0}, queries = {0};
  int status = cli_profile_take(&settings->profile, client, &profile);
  if (status == CLI_OK) {
    status = cli_cloud_read(common->operand, true, &points) &&
                     cli_cloud_read(common->second_operand, false, &queries)
                 ? gather(settings, client, &profile, &points, &queries)
                 : CLI_FAILED;
  }
  cli_cloud_free(&points);
  cli_cloud_free(&queries);
  cli_profile_free(&profile);
  return status;
}

const cli_command cli_command_gather = {
    .name = "gather",
    .operand = "POINTS",
    .second_operand = "QUERIES",
    .about = "Sum the light that points leave at other positions",
    .more =
        "\n"
        "Each point holds power that entered the medium there: irradiance times area. Each query\n"
        "gets the sum of R(distance) times power over all points, in W/mm^2, for each channel\n"
        "(Jensen and Buhler 2002). POINTS and QUERIES are CSV with a header, or binary PLY if "
        "they\n"
        "end with .ply: columns x, y, z in mm, and power_1, power_2 and so on in W; - is standard\n"
        "input. What is written has the columns M_1, M_2 and so on.\n" CLI_CSV_TEXT,
    .formats = "none",
    .options = {cli_medium_options, options},
    .examples =
        "  dipole gather points.csv queries.csv --medium skin1 --tolerance 1e-3\n"
        "  dipole gather points.ply queries.ply --medium marble --model better --output M.ply\n",
    .settings_bytes = sizeof(gather_settings),
    .check = check,
    .run = run,
};
