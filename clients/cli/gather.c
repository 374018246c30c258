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
  cli_number tolerance, least_distance;
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
    {"least-distance", "X",
     "no distance between a query and a point counts as less than X mm (default:\n"
     "0). Where R grows like 1/r, half the radius of a disc of a point's area is\n"
     "right: the mean of 1/r over the disc",
     CLI_NUMBER, offsetof(gather_settings, least_distance), NULL},
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
  const double least_mm = settings->least_distance.value;
  if (!(least_mm >= 0 && least_mm < (double)INFINITY)) {
    return cli_fail_usage("--least-distance: give a number of at least 0, in mm");
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

/* What is asked. The points are asked for in slices, so that where a query is too near to a point of
 * a slice, few points are summed one by one in its place. */
typedef struct work {
  const gather_settings *settings;
  dipole_client *client;
  dipole_gather_query query;
  const cli_cloud *points, *queries;
  cli_progress progress;
} work;

typedef struct slice {
  uint64_t first, count;
} slice;

static int compare_x(const void *a, const void *b) {
  const double x = **(const double *const *)a, y = **(const double *const *)b;
  return (x > y) - (x < y);
}

static double distance_mm(const double *a, const double *b) {
  return sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) +
              (a[2] - b[2]) * (a[2] - b[2]));
}

/* Returns whether a point is nearer to a query than least_mm. places: in the order of x. */
static bool is_near(const double *const *places, size_t count, const double *query_mm,
                    double least_mm) {
  size_t low = 0, high = count;
  while (low < high) {
    const size_t middle = low + (high - low) / 2;
    const bool before = places[middle][0] <= query_mm[0] - least_mm;
    low = before ? middle + 1 : low;
    high = before ? high : middle;
  }
  while (low < count && places[low][0] < query_mm[0] + least_mm &&
         distance_mm(places[low], query_mm) >= least_mm) {
    low++;
  }
  return low < count && places[low][0] < query_mm[0] + least_mm;
}

/* Sums the points of a slice one by one. r: room for a radius of each. */
static bool sum_directly(const work *of, const slice *some, const double *query_mm, double *r,
                         double *M, dipole_error *error) {
  const bool is_double = of->query.evaluator == DIPOLE_F64;
  const uint32_t channels = of->points->channels;
  for (uint64_t i = 0; i < some->count; i++) {
    const double *at_mm = of->points->xyz_mm + 3 * (some->first + i);
    const double r_mm = fmax(distance_mm(at_mm, query_mm), of->settings->least_distance.value);
    if (is_double) {
      r[i] = r_mm;
    } else {
      ((float *)(void *)r)[i] = (float)r_mm;
    }
  }
  const dipole_query query = {.model = of->query.model,
                              .evaluator = of->query.evaluator,
                              .moments = of->query.moments,
                              .wanted = DIPOLE_R,
                              .media = of->query.media,
                              .medium_count = channels,
                              .spacing = DIPOLE_LIST,
                              .radii = r,
                              .radius_count = some->count,
                              .deadline_ms = of->query.deadline_ms};
  dipole_result *result;
  if (!CLI_ASK(&of->settings->profile.common, error,
               dipole_eval(of->client, &query, &result, error))) {
    return false;
  }
  for (uint32_t c = 0; c < channels; c++) {
    const dipole_channel *channel = &result->channels[c];
    M[c] = 0;
    for (uint64_t i = 0; i < some->count; i++) {
      M[c] += (is_double ? channel->R_f64[i] : (double)channel->R_f32[i]) *
              (double)of->points->power_W[(some->first + i) * channels + c];
    }
  }
  dipole_result_free(result);
  return true;
}

/* Sums the slice directly for the queries that are too near to a point of it. */
static bool mend_near(const work *of, const slice *some, double *M, dipole_error *error) {
  const double least_mm = of->settings->least_distance.value;
  const double **places = cli_allocate(some->count, sizeof *places);
  double *r = cli_allocate(some->count, sizeof *r);
  for (uint64_t i = 0; i < some->count; i++) {
    places[i] = of->points->xyz_mm + 3 * (some->first + i);
  }
  qsort(places, some->count, sizeof *places, compare_x);
  bool good = true;
  for (uint64_t q = 0; good && q < of->queries->count && !cli_interrupted(); q++) {
    const double *query_mm = of->queries->xyz_mm + 3 * q;
    good = !is_near(places, some->count, query_mm, least_mm) ||
           sum_directly(of, some, query_mm, r, M + q * of->points->channels, error);
  }
  free(places);
  free(r);
  return good;
}

/* Sets M to the sums over a slice. Returns an exit status. */
static int ask(work *of, const slice *some, double *M) {
  dipole_error error;
  dipole_points *set;
  dipole_gather_result result;
  const cli_cloud *points = of->points;
  if (!dipole_points_make(some->count, points->channels, points->xyz_mm + 3 * some->first,
                          points->power_W + some->first * points->channels, &set, &error)) {
    return cli_fail("%s: %s", points->file, error.text);
  }
  of->query.points = set;
  const bool good =
      CLI_ASK(&of->settings->profile.common, &error,
              dipole_gather(of->client, &of->query, follow, &of->progress, M, &result, &error)) &&
      (!(of->settings->least_distance.value > 0) || mend_near(of, some, M, &error));
  cli_progress_wipe(&of->progress);
  dipole_points_free(set);
  if (!good) {
    error.index += strcmp(error.field, "queries") == 0 ? 0 : some->first;
    return fail_at(&error, points, of->queries);
  }
  return cli_interrupted() ? cli_fail("interrupted; nothing was written") : CLI_OK;
}

/* Slices have so many points at least, and there are so many slices at most. */
enum { SLICE_POINTS = 1024, SLICES = 16 };

/* Sets M to the sums. Returns an exit status. */
static int ask_all(work *of, double *M) {
  const uint64_t count = of->points->count, sums = of->queries->count * of->points->channels;
  const bool is_cut = of->settings->least_distance.value > 0 && count > SLICE_POINTS;
  const uint64_t even = (count + SLICES - 1) / SLICES;
  const uint64_t most = !is_cut ? count : even > SLICE_POINTS ? even : SLICE_POINTS;
  if (count == 0) {
    return cli_fail("%s: it has no points", of->points->file);
  }
  double *part = cli_allocate((size_t)sums + 1, sizeof *part);
  int status = CLI_OK;
  cli_catch_interrupt();
  cli_progress_start(&of->progress, "queries");
  for (uint64_t first = 0; status == CLI_OK && first < count; first += most) {
    const slice some = {first, count - first < most ? count - first : most};
    status = ask(of, &some, part);
    for (uint64_t i = 0; i < sums; i++) {
      M[i] += part[i];
    }
  }
  free(part);
  return status;
}

/* Says how many sums are infinite, and what helps. */
static void tell_infinite(const work *of, const double *M) {
  const uint32_t channels = of->points->channels;
  uint64_t found = 0;
  for (uint64_t q = 0; q < of->queries->count; q++) {
    bool infinite = false;
    for (uint32_t c = 0; c < channels; c++) {
      infinite = infinite || isinf(M[q * channels + c]);
    }
    found += infinite;
  }
  if (found > 0) {
    cli_say(CLI_OK,
            "%llu of %llu queries are at a point, where R of %s is infinite: M is inf there; give "
            "--least-distance, half the radius of a disc of a point's area",
            (unsigned long long)found, (unsigned long long)of->queries->count,
            cli_choice_of_id(dipole_get_info(of->client), DIPOLE_MODEL, of->query.model)->name);
  }
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
  work of = {.settings = settings, .client = client, .points = points, .queries = queries};
  int status = take_query(settings, profile, points, queries, &of.query);
  if (status != CLI_OK) {
    return status;
  }
  double *M = cli_allocate((size_t)queries->count * points->channels + 1, sizeof *M);
  status = ask_all(&of, M);
  if (status == CLI_OK) {
    tell_infinite(&of, M);
  }
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
        "input. What is written has the columns M_1, M_2 and so on. At a point's own position R "
        "is\n"
        "infinite for most models, and so is the sum: see --least-distance.\n" CLI_CSV_TEXT,
    .formats = "none",
    .options = {cli_medium_options, options},
    .examples =
        "  dipole gather points.csv queries.csv --medium skin1 --tolerance 1e-3\n"
        "  dipole gather points.ply queries.ply --medium marble --model better --output M.ply\n",
    .settings_bytes = sizeof(gather_settings),
    .check = check,
    .run = run,
};
