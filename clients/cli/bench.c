/* dipole bench: how fast a daemon answers. */
#include <stdlib.h>
#include <string.h>

#include "clients/cli/bench.h"
#include "clients/cli/channels.h"
#include "clients/cli/parameters.h"
#include "clients/cli/progress.h"

#define MEDIUM_DEFAULT "skin1"
#define MODEL_DEFAULT "better"
#define EVALUATOR_DEFAULT "f32"
#define SECONDS_DEFAULT 1.0
#define SECONDS_LEAST 0.01
#define SECONDS_MOST 3600.0
#define RADIUS_LEAST_MM 0.01
#define RADIUS_MOST_MM 10.0

enum { IN_FLIGHT_DEFAULT = 64, SMALL_DEFAULT = 16, LARGE_DEFAULT = 65536 };

typedef struct bench_settings {
  cli_profile_settings profile;
  cli_medium_settings medium;
  const char *model, *evaluator;
  cli_number seconds;
  cli_count connections, in_flight, radii, large_radii;
} bench_settings;

/* What a command line asks for, with all that belongs to it. */
typedef struct bench_run_state {
  const cli_command *command;
  const bench_settings *settings;
  dipole_client *client;
  cli_channels channels;
  dipole_medium *media;
  cli_parameters parameters;
  void *radii;
  dipole_query query;
  cli_progress progress;
  unsigned measured;
  uint64_t requests; /* of the measurements that are over */
  bench_report report;
} bench_run_state;

/* ---- the command line ---------------------------------------------------------------------- */

static bool check_count(const cli_command *command, const char *option, cli_count *count,
                        uint64_t usual, uint64_t most) {
  if (!count->given) {
    count->value = usual;
  }
  if (count->value >= 1 && count->value <= most) {
    return true;
  }
  cli_fail_usage(command, "--%s: from 1 to %llu", option, (unsigned long long)most);
  return false;
}

static int check(const cli_command *command, bench_settings *settings) {
  cli_number *seconds = &settings->seconds;
  if (!seconds->given) {
    seconds->value = SECONDS_DEFAULT;
  }
  if (!(seconds->value >= SECONDS_LEAST && seconds->value <= SECONDS_MOST)) {
    return cli_fail_usage(command, "--seconds: from %g to %g", SECONDS_LEAST, SECONDS_MOST);
  }
  if (!check_count(command, "connections", &settings->connections, 1, BENCH_CONNECTIONS_MAX) ||
      !check_count(command, "in-flight", &settings->in_flight, IN_FLIGHT_DEFAULT,
                   DIPOLE_IN_FLIGHT_MAX) ||
      !check_count(command, "radii", &settings->radii, SMALL_DEFAULT, BENCH_RADII_MAX) ||
      !check_count(command, "large-radii", &settings->large_radii, LARGE_DEFAULT,
                   BENCH_RADII_MAX)) {
    return CLI_USAGE;
  }
  if (!cli_channels_given(&settings->medium)) {
    settings->medium.medium = MEDIUM_DEFAULT;
  }
  return cli_channels_check(command, &settings->medium);
}

/* What only shows once there is a daemon. */
static int check_with_daemon(const bench_run_state *state) {
  const bench_settings *settings = state->settings;
  const size_t bytes = (size_t)(settings->connections.value * settings->in_flight.value) *
                       (size_t)settings->radii.value * state->channels.count * sizeof(double);
  const char *address = dipole_address(state->client);
  if (settings->connections.value > 1 && strncmp(address, "private:", strlen("private:")) == 0) {
    return cli_fail_usage(state->command, "--connections: a daemon of its own has one connection; "
                                          "--connect names another");
  }
  if (bytes > BENCH_VALUES_MAX_BYTES) {
    return cli_fail_usage(state->command,
                          "--connections, --in-flight, --radii: together they take more than %zu "
                          "MiB for values",
                          BENCH_VALUES_MAX_BYTES >> 20);
  }
  return CLI_OK;
}

/* ---- what is asked ------------------------------------------------------------------------- */

static void make_radii(bench_run_state *state, uint64_t count) {
  const bool single = state->report.evaluator->id != DIPOLE_F64;
  const double step_mm = (RADIUS_MOST_MM - RADIUS_LEAST_MM) / (double)count;
  state->radii = cli_allocate(count, sizeof(double));
  for (uint64_t i = 0; i < count; i++) {
    const double r = RADIUS_LEAST_MM + (double)i * step_mm;
    if (single) {
      ((float *)state->radii)[i] = (float)r;
    } else {
      ((double *)state->radii)[i] = r;
    }
  }
}

static void make_query(bench_run_state *state) {
  const bench_settings *settings = state->settings;
  const uint64_t small = settings->radii.value, large = settings->large_radii.value;
  make_radii(state, small > large ? small : large);
  state->media = cli_allocate(state->channels.count, sizeof *state->media);
  for (size_t i = 0; i < state->channels.count; i++) {
    state->media[i] = state->channels.items[i].medium;
  }
  state->query = (dipole_query){.model = state->report.model->id,
                                .evaluator = state->report.evaluator->id,
                                .moments = DIPOLE_EXACT,
                                .wanted = DIPOLE_R,
                                .media = state->media,
                                .medium_count = (uint32_t)state->channels.count,
                                .spacing = DIPOLE_LIST,
                                .radii = state->radii,
                                .parameters = state->parameters.items,
                                .parameter_count = state->parameters.count};
}

static int prepare(bench_run_state *state) {
  const bench_settings *settings = state->settings;
  const dipole_info *info = dipole_get_info(state->client);
  bench_report *report = &state->report;
  report->info = info;
  report->model = cli_named(state->command, info, DIPOLE_MODEL, "model",
                            settings->model != NULL ? settings->model : MODEL_DEFAULT);
  report->evaluator =
      cli_named(state->command, info, DIPOLE_EVALUATOR, "evaluator",
                settings->evaluator != NULL ? settings->evaluator : EVALUATOR_DEFAULT);
  if (report->model == NULL || report->evaluator == NULL ||
      !cli_parameters_take(state->command, info, &settings->profile, &state->parameters)) {
    return CLI_USAGE;
  }
  int status =
      cli_channels_take(state->command, &settings->medium, state->client, &state->channels);
  status = status == CLI_OK ? check_with_daemon(state) : status;
  if (status == CLI_OK) {
    report->medium = state->channels.medium;
    report->channels = state->channels.count;
    make_query(state);
  }
  return status;
}

/* ---- measuring ----------------------------------------------------------------------------- */

static void show(void *context, double share, uint64_t requests) {
  bench_run_state *state = context;
  cli_progress_show(&state->progress, ((double)state->measured + share) / BENCH_MEASUREMENTS,
                    (double)(state->requests + requests));
}

static int measure(bench_run_state *state) {
  const bench_settings *settings = state->settings;
  const double seconds = settings->seconds.value;
  const bench_load loads[BENCH_MEASUREMENTS] = {
      {"small", "one small request at a time", 1, 1, settings->radii.value, seconds},
      {"pipelined", "many small requests under way", (unsigned)settings->connections.value,
       (unsigned)settings->in_flight.value, settings->radii.value, seconds},
      {"large", "one large request at a time", 1, 1, settings->large_radii.value, seconds},
  };
  bool good = true;
  dipole_error error;
  cli_progress_start(&state->progress, "requests");
  for (state->measured = 0; good && state->measured < BENCH_MEASUREMENTS; state->measured++) {
    bench_result *result = &state->report.results[state->measured];
    good = bench_run(state->client, &settings->profile.common, &state->query,
                     &loads[state->measured], show, state, result, &error);
    state->requests += result->times.count;
  }
  cli_progress_wipe(&state->progress);
  return good ? CLI_OK : cli_fail(state->command, "%s", error.text);
}

static void write_report(const bench_run_state *state) {
  const char *format = state->settings->profile.common.format;
  if (format == NULL || strcmp(format, "table") == 0) {
    bench_write_table(&state->report, stdout);
  } else if (strcmp(format, "csv") == 0) {
    bench_write_csv(&state->report, stdout);
  } else {
    bench_write_json(&state->report, stdout);
  }
}

static int run_with_daemon(const cli_command *command, const bench_settings *settings) {
  bench_run_state *state = cli_allocate(1, sizeof *state);
  state->command = command;
  state->settings = settings;
  int status = CLI_FAILED;
  if (cli_open(command, &settings->profile.common, &state->client)) {
    status = prepare(state);
    status = status == CLI_OK ? measure(state) : status;
    if (status == CLI_OK) {
      write_report(state);
    }
    dipole_close(state->client);
  }
  free(state->channels.items);
  free(state->media);
  free(state->radii);
  free(state);
  return status;
}

static int run(const cli_command *command, int argc, char **argv) {
  bench_settings settings = {0};
  const char *operand;
  int status;
  if (cli_options_read(command, argc, argv, &settings, &operand, &status)) {
    status = check(command, &settings);
    if (status == CLI_OK) {
      status = run_with_daemon(command, &settings);
    }
  }
  cli_options_free(command, &settings);
  return status;
}

static const cli_option options[] = {
    CLI_MEDIUM_OPTIONS(bench_settings),
    {"Load", NULL, NULL, CLI_HEADING, 0},
    {"model", "NAME", "default: better", CLI_TEXT, offsetof(bench_settings, model)},
    {"evaluator", "NAME", "f64, f32 or lut (default: f32)", CLI_TEXT,
     offsetof(bench_settings, evaluator)},
    {"seconds", "S", "how long each of the three is measured (default: 1)", CLI_NUMBER,
     offsetof(bench_settings, seconds)},
    {"connections", "N", "when pipelining (default: 1)", CLI_COUNT,
     offsetof(bench_settings, connections)},
    {"in-flight", "N", "requests under way on each of them (default: 64)", CLI_COUNT,
     offsetof(bench_settings, in_flight)},
    {"radii", "N", "of a small request (default: 16)", CLI_COUNT, offsetof(bench_settings, radii)},
    {"large-radii", "N", "of a large request (default: 65536)", CLI_COUNT,
     offsetof(bench_settings, large_radii)},
    {0},
};

const cli_command cli_command_bench = {
    .name = "bench",
    .about = "Measure how fast a daemon answers: latency, pipelined requests, throughput",
    .more =
        "\n"
        "Requests are evaluations of R at listed radii, from 0.01 to 10 mm, of all channels of a\n"
        "medium (default: --medium skin1). Three things are measured, one after the other: small\n"
        "requests, of which each waits for the answer to the one before; small requests, of which\n"
        "many are under way; and large requests one at a time. Times are from submitting a\n"
        "request to holding its values, this program's share included, within 1 %. Radii and\n"
        "bytes count every channel; bytes are those of radii that go and values that come. On a\n"
        "daemon that others use at the same time it measures what is left, and takes its share.\n",
    .formats = "table,csv,json",
    .options = options,
    .shared_options = cli_parameter_options,
    .examples = "  dipole bench\n"
                "  dipole bench --connect tcp:farm7:4817 --connections 8 --in-flight 128\n"
                "  dipole bench --model transport --evaluator lut --seconds 5 --format json\n",
    .run = run,
};
