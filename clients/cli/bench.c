/* dipole bench: how fast a daemon replies on one connection. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "clients/cli/rows.h"

enum {
  RADII_MAX = 1 << 22,
  MEASUREMENTS = 3,
  /* buckets of durations for each factor of two: quantiles are exact within 1 % */
  BUCKETS_OF_OCTAVE = 64,
  BUCKETS = 48 * BUCKETS_OF_OCTAVE
};

/* What was measured under a load. */
typedef struct measured {
  const char *name;
  unsigned in_flight; /* requests under way */
  uint64_t radii;     /* how many radii each request has */
  /* How long each request took, from submitting it to having its reply. */
  uint64_t requests, most_ns;
  uint32_t buckets[BUCKETS];
  double took_s; /* from the first request to the last reply */
} measured;

typedef struct report {
  const cli_settings *settings;
  dipole_client *client;
  cli_profile profile;
  void *radii;
  dipole_query query;
  cli_progress progress;
  uint64_t requests; /* those of all measurements so far */
  measured results[MEASUREMENTS];
} report;

/* Returns the duration, in us, that this share of the durations did not exceed: the middle of its
 * bucket, or 0 if nothing was counted. */
static double quantile_us(const measured *result, double share) {
  const double wanted = ceil(share * (double)result->requests);
  double before = 0;
  for (size_t i = 0; i < BUCKETS; i++) {
    before += result->buckets[i];
    if (result->buckets[i] > 0 && before >= wanted) {
      return fmin(exp2(((double)i + 0.5) / BUCKETS_OF_OCTAVE), (double)result->most_ns) / 1000;
    }
  }
  return 0;
}

/* Returns the size in bytes of a radius, which is that of a value. */
static size_t value_bytes(const report *of) {
  return of->query.evaluator == DIPOLE_F64 ? sizeof(double) : sizeof(float);
}

/* ---- requests -------------------------------------------------------------------------------- */

/* A request that is under way, or room for one. */
typedef struct slot {
  uint64_t id;
  uint64_t sent_ns;
  uint8_t *values; /* the buffer for its reply */
} slot;

/* Waits for a reply and counts its duration. Its slot moves behind the `used` ones that are under
 * way. The search starts with the oldest request, whose reply is the likeliest to come. */
static bool collect(report *of, measured *result, slot *slots, unsigned used, dipole_error *error) {
  dipole_result *reply;
  uint64_t id;
  unsigned i = 0;
  if (!dipole_collect(of->client, &id, &reply, error)) {
    return false;
  }
  dipole_result_free(reply);
  while (i + 1 < used && slots[i].id != id) {
    i++;
  }
  const slot found = slots[i];
  const uint64_t now_ns = cli_now_ns(), ns = now_ns > found.sent_ns ? now_ns - found.sent_ns : 1;
  result->buckets[(size_t)fmin(BUCKETS_OF_OCTAVE * log2((double)ns), BUCKETS - 1)]++;
  result->most_ns = ns > result->most_ns ? ns : result->most_ns;
  result->requests++;
  memmove(&slots[i], &slots[i + 1], (used - i - 1) * sizeof found);
  slots[used - 1] = found;
  return true;
}

/* Shows the progress. Returns whether the time is over. */
static bool is_over(report *of, const measured *result, uint64_t start_ns) {
  const double at = (double)(result - of->results), seconds = of->settings->seconds.value;
  const double share = (double)(cli_now_ns() - start_ns) / 1e9 / seconds;
  cli_progress_show(&of->progress, (at + fmin(share, 1)) / MEASUREMENTS,
                    (double)(of->requests + result->requests));
  return share >= 1;
}

/* Sends requests and keeps `in_flight` of them under way. Before that it sends one that is not
 * counted, so that the daemon has prepared all it needs. */
static bool run_load(report *of, measured *result, dipole_error *error) {
  dipole_query query = of->query;
  dipole_result *reply;
  query.radius_count = result->radii;
  if (!dipole_eval(of->client, &query, &reply, error)) {
    return false;
  }
  dipole_result_free(reply);
  const size_t bytes = (size_t)(query.medium_count * result->radii * value_bytes(of) + 7) / 8 * 8;
  uint8_t *values = cli_allocate(result->in_flight, bytes);
  slot *slots = cli_allocate(result->in_flight, sizeof *slots);
  for (unsigned i = 0; i < result->in_flight; i++) {
    slots[i].values = values + i * bytes;
  }
  const uint64_t start_ns = cli_now_ns();
  unsigned used = 0;
  bool good = true;
  for (bool over = false; good && !(over && used == 0);) {
    while (good && !over && used < result->in_flight) {
      query.into_values = slots[used].values;
      slots[used].sent_ns = cli_now_ns();
      good = dipole_submit(of->client, &query, &slots[used].id, error);
      used += good;
    }
    good = good && collect(of, result, slots, used, error);
    used -= good;
    over = over || is_over(of, result, start_ns);
  }
  result->took_s = (double)(cli_now_ns() - start_ns) / 1e9;
  of->requests += result->requests;
  cli_free(slots);
  cli_free(values);
  return good;
}

/* ---- the command line ------------------------------------------------------------------------ */

#define MEDIUM_DEFAULT "skin1"
#define SECONDS_LEAST 0.01
#define SECONDS_MOST 3600.0
#define RADIUS_LEAST_MM 0.01
#define RADIUS_MOST_MM 10.0

/* How much memory the values under way may take. */
#define VALUES_MAX_BYTES ((size_t)1 << 30)

static int check(cli_settings *settings) {
  const double seconds = settings->seconds.value;
  const struct {
    const char *option;
    uint64_t value, most;
  } counts[] = {{"in-flight", settings->in_flight.value, DIPOLE_IN_FLIGHT_MAX},
                {"radii", settings->radii.value, RADII_MAX},
                {"large-radii", settings->large_radii.value, RADII_MAX}};
  if (!(seconds >= SECONDS_LEAST && seconds <= SECONDS_MOST)) {
    return cli_fail_usage("--seconds: give a number from %g to %g", SECONDS_LEAST, SECONDS_MOST);
  }
  for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++) {
    if (counts[i].value < 1 || counts[i].value > counts[i].most) {
      return cli_fail_usage("--%s: give a number from 1 to %llu", counts[i].option,
                            (unsigned long long)counts[i].most);
    }
  }
  if (!cli_medium_given(settings)) {
    static char name[] = MEDIUM_DEFAULT, *names[] = {name};
    settings->medium = (cli_texts){1, names, name};
  }
  return cli_medium_check(settings);
}

/* Checks how much memory the values take. */
static int check_memory(const report *of) {
  const size_t bytes = (size_t)(of->settings->in_flight.value * of->settings->radii.value) *
                       of->profile.channel_count * sizeof(double);
  return bytes <= VALUES_MAX_BYTES
             ? CLI_OK
             : cli_fail_usage("--in-flight, --radii: give less: together they take more than %zu "
                              "MiB for values",
                              VALUES_MAX_BYTES >> 20);
}

/* ---- what is requested --------------------------------------------------------------------------- */

static void make_query(report *of) {
  const uint64_t small = of->settings->radii.value, large = of->settings->large_radii.value;
  const uint64_t count = small > large ? small : large;
  const bool single = of->profile.evaluator->id != DIPOLE_F64;
  const double step_mm = (RADIUS_MOST_MM - RADIUS_LEAST_MM) / (double)count;
  of->radii = cli_allocate(count, sizeof(double));
  for (uint64_t i = 0; i < count; i++) {
    const double r = RADIUS_LEAST_MM + (double)i * step_mm;
    if (single) {
      ((float *)of->radii)[i] = (float)r;
    } else {
      ((double *)of->radii)[i] = r;
    }
  }
  of->query = (dipole_query){.model = of->profile.model->id,
                             .evaluator = of->profile.evaluator->id,
                             .moments = DIPOLE_EXACT,
                             .wanted = DIPOLE_R,
                             CLI_MEDIA_OF(&of->profile),
                             .spacing = DIPOLE_LIST,
                             .radii = of->radii,
                             .parameters = of->profile.parameters.items,
                             .parameter_count = of->profile.parameters.count};
}

/* ---- measuring ------------------------------------------------------------------------------- */

static int measure(report *of) {
  const cli_settings *settings = of->settings;
  const uint64_t radii = settings->radii.value;
  of->results[0] = (measured){"small", 1, radii, .took_s = 0};
  of->results[1] = (measured){"pipelined", (unsigned)settings->in_flight.value, radii, .took_s = 0};
  of->results[2] = (measured){"large", 1, settings->large_radii.value, .took_s = 0};
  bool good = true;
  dipole_error error;
  cli_progress_start(&of->progress, "requests");
  for (size_t i = 0; good && i < MEASUREMENTS; i++) {
    good = run_load(of, &of->results[i], &error);
  }
  cli_progress_wipe(&of->progress);
  return good ? CLI_OK : cli_fail_error(&error);
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Adds a figure to the rows. A table shows three digits of it without an exponent, in the unit of
 * its head. */
static void put_figure(cli_rows *rows, const char *name, const char *head, double unit,
                       double value) {
  char text[64];
  const double shown = value / unit;
  snprintf(text, sizeof text, "%.*f", shown >= 99.95 ? 0 : shown >= 9.995 ? 1 : 2, shown);
  cli_put_shown(rows, value, text, name, head);
}

static void put_result(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const measured *result = &of->results[index];
  const double channels = (double)of->profile.channel_count;
  const double per_s = result->took_s > 0 ? (double)result->requests / result->took_s : 0;
  const double radii_per_s = per_s * (double)result->radii;
  cli_put_text(rows, result->name, "measurement", "requests");
  cli_put_number(rows, (double)result->radii, "radii", .format = "%.0f");
  cli_put_number(rows, result->in_flight, "in_flight", "in flight", .format = "%.0f");
  cli_put_number(rows, (double)result->requests, "requests", .forms = CLI_IN_CSV | CLI_IN_JSON);
  cli_put_number(rows, result->took_s, "seconds", .forms = CLI_IN_CSV | CLI_IN_JSON);
  put_figure(rows, "p50_us", "p50 us", 1, quantile_us(result, 0.5));
  put_figure(rows, "p99_us", "p99 us", 1, quantile_us(result, 0.99));
  put_figure(rows, "max_us", "max us", 1, (double)result->most_ns / 1000);
  put_figure(rows, "requests_per_s", "requests/s", 1, per_s);
  put_figure(rows, "radii_per_s", "M radii/s", 1e6, radii_per_s * channels);
  put_figure(rows, "bytes_per_s", "MB/s", 1e6,
             radii_per_s * (1 + channels) * (double)value_bytes(of));
}

static void put_facts(cli_rows *rows, const void *context) {
  const report *of = context;
  const dipole_info *info = of->profile.info;
  cli_put_text(rows, info->software, "daemon");
  cli_put_text(rows, info->address, "address", "at");
  cli_put_text(rows, info->instruction_set, "instruction_set", "");
  cli_put_count(rows, info->workers, "workers");
  cli_put_profile(rows, &of->profile);
  cli_put_count(rows, of->profile.channel_count, "channels");
}

/* ---- the command ----------------------------------------------------------------------------- */

static int run_bench(const cli_settings *settings, dipole_client *client) {
  report *of = cli_allocate(1, sizeof *of);
  *of = (report){.settings = settings, .client = client};
  int status = cli_profile_take(settings, client, &of->profile);
  status = status == CLI_OK ? check_memory(of) : status;
  if (status == CLI_OK) {
    make_query(of);
    status = measure(of);
  }
  if (status == CLI_OK) {
    const cli_report output = {
        .facts = put_facts, .rows = MEASUREMENTS, .put_row = put_result, .left = 1};
    cli_write(&output, settings->form, of);
  }
  return status;
}

static const cli_option options[] = {
    CLI_TITLE("Load"),
    CLI_OPTION(NAME, model, "better", "which model is evaluated"),
    CLI_OPTION(TEXT, evaluator, "f32", "f64, f32 or lut"),
    CLI_OPTION(NUMBER, seconds, "1", "how long each of the three is measured"),
    CLI_OPTION(COUNT, in_flight, "64", "how many pipelined requests are under way"),
    CLI_OPTION(COUNT, radii, "16", "how many radii a small request has"),
    CLI_OPTION(COUNT, large_radii, "65536", "how many radii a large request has"),
    {0},
};

const cli_command cli_command_bench = {
    .name = "bench",
    .about = "Measure how fast a daemon replies: latency, pipelined requests, throughput",
    .more =
        "Requests are evaluations of R at listed radii, from 0.01 to 10 mm, of all channels of "
        "a medium (default: --medium skin1). Three things are measured, one after the other: "
        "small requests one at a time; small requests of which many are under way; and large "
        "requests one at a time. A time is that from submitting a request to having its values, "
        "within 1 %; the time that this program takes is part of it. Radii and bytes count "
        "every channel; bytes are those of radii sent and values received. If others use the "
        "daemon at the same time, each of you gets a share of it.",
    .formats = "table,csv,json",
    .options = {cli_medium_options, cli_layer_options, options},
    .parameters = CLI_OF_MODELS,
    .examples = "  dipole bench\n"
                "  dipole bench --connect tcp:farm7:4817 --in-flight 128\n"
                "  dipole bench --model transport --evaluator lut --seconds 5 --format json\n",
    .shows_service = true,
    .check = check,
    .run = run_bench,
};
