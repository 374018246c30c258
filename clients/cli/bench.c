/* dipole bench: how fast a daemon replies. */
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "clients/cli/daemon.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "clients/cli/rows.h"

enum {
  CONNECTIONS_MAX = 256,
  RADII_MAX = 1 << 22,
  MEASUREMENTS = 3,
  /* buckets of durations for each factor of two: quantiles are exact within 1 % */
  BUCKETS_OF_OCTAVE = 64,
  BUCKETS = 48 * BUCKETS_OF_OCTAVE
};

/* What was measured under a load. */
typedef struct measured {
  const char *name;
  unsigned connections;
  unsigned in_flight; /* requests under way on each connection */
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

/* ---- a connection: a thread, which keeps this many requests under way ------------------------ */

/* A request that is under way, or room for one. */
typedef struct slot {
  uint64_t id;
  uint64_t sent_ns;
  uint8_t *values; /* the buffer for its reply */
} slot;

typedef struct worker {
  pthread_t thread;
  dipole_client *client;
  const dipole_query *query;
  unsigned in_flight;
  uint64_t until_ns, ended_ns;
  slot *slots; /* [in_flight]; the first `used` are under way, oldest first */
  unsigned used;
  atomic_ullong done;
  bool failed;
  dipole_error error;
  uint64_t most_ns;
  uint32_t buckets[BUCKETS];
} worker;

static bool submit(worker *of) {
  slot *to = &of->slots[of->used];
  dipole_query query = *of->query;
  query.into_values = to->values;
  to->sent_ns = cli_now_ns();
  const bool good = dipole_submit(of->client, &query, &to->id, &of->error);
  of->used += good;
  return good;
}

/* Takes a reply: its slot moves behind those that are under way. The search starts with the
 * oldest request, whose reply is the likeliest to come. */
static void take_reply(worker *of, uint64_t id, uint64_t at_ns) {
  for (unsigned i = 0; i < of->used; i++) {
    if (of->slots[i].id == id) {
      const slot found = of->slots[i];
      const uint64_t ns = at_ns > found.sent_ns ? at_ns - found.sent_ns : 1;
      const double bucket = BUCKETS_OF_OCTAVE * log2((double)ns);
      of->buckets[(size_t)fmin(bucket, BUCKETS - 1)]++;
      of->most_ns = ns > of->most_ns ? ns : of->most_ns;
      memmove(&of->slots[i], &of->slots[i + 1], (of->used - i - 1) * sizeof found);
      of->slots[--of->used] = found;
      return;
    }
  }
}

static bool collect(worker *of) {
  dipole_result *result;
  uint64_t id;
  if (!dipole_collect(of->client, &id, &result, &of->error)) {
    return false;
  }
  dipole_result_free(result);
  take_reply(of, id, cli_now_ns());
  atomic_fetch_add_explicit(&of->done, 1, memory_order_relaxed);
  return true;
}

static void *run_worker(void *argument) {
  worker *of = argument;
  bool good = true;
  do {
    while (good && of->used < of->in_flight) {
      good = submit(of);
    }
    good = good && collect(of);
  } while (good && cli_now_ns() < of->until_ns);
  while (good && of->used > 0) {
    good = collect(of);
  }
  of->failed = !good;
  of->ended_ns = cli_now_ns();
  return NULL;
}

/* ---- all of them ----------------------------------------------------------------------------- */

/* Returns the size in bytes of a radius, which is that of a value. */
static size_t value_bytes(const report *of) {
  return of->query.evaluator == DIPOLE_F64 ? sizeof(double) : sizeof(float);
}

static void make_slots(const report *of, worker *one) {
  const size_t bytes =
      (size_t)(of->query.medium_count * one->query->radius_count * value_bytes(of) + 7) / 8 * 8;
  uint8_t *values = cli_allocate(one->in_flight, bytes);
  one->slots = cli_allocate(one->in_flight, sizeof *one->slots);
  for (unsigned i = 0; i < one->in_flight; i++) {
    one->slots[i].values = values + i * bytes;
  }
}

/* Opens another connection unless this is the first one, which is the client's own, and sends one
 * request that is not counted, so that the daemon has prepared all it needs. */
static bool open_and_warm_up(const report *of, worker *one, bool first, dipole_error *error) {
  dipole_options options;
  dipole_result *result;
  cli_connection_options(of->settings, &options);
  options.in_flight_max = 0;
  if ((!first && !dipole_open_with(of->settings->connect, &options, &one->client, error)) ||
      !dipole_eval(one->client, one->query, &result, error)) {
    return false;
  }
  dipole_result_free(result);
  return true;
}

/* Shows the progress while the workers of a measurement work. */
static void watch_workers(report *of, worker *workers, const measured *result, uint64_t start_ns) {
  const struct timespec nap = {.tv_nsec = 50 * 1000000L};
  const double at = (double)(result - of->results), seconds = of->settings->seconds.value;
  uint64_t before = 0;
  for (const measured *one = of->results; one < result; one++) {
    before += one->requests;
  }
  while (cli_now_ns() < start_ns + (uint64_t)(seconds * 1e9)) {
    uint64_t done = before;
    for (unsigned i = 0; i < result->connections; i++) {
      done += atomic_load_explicit(&workers[i].done, memory_order_relaxed);
    }
    const double share = fmin((double)(cli_now_ns() - start_ns) / 1e9 / seconds, 1);
    cli_progress_show(&of->progress, (at + share) / MEASUREMENTS, (double)done);
    nanosleep(&nap, NULL);
  }
}

/* Starts a thread for each worker and waits until they are done. */
static bool run_all(report *of, worker *workers, measured *result, dipole_error *error) {
  const uint64_t start_ns = cli_now_ns();
  uint64_t ended_ns = start_ns;
  unsigned running = 0;
  bool good = true;
  for (; good && running < result->connections; running += good) {
    workers[running].until_ns = start_ns + (uint64_t)(of->settings->seconds.value * 1e9);
    good = pthread_create(&workers[running].thread, NULL, run_worker, &workers[running]) == 0;
  }
  if (good) {
    watch_workers(of, workers, result, start_ns);
  } else {
    *error = (dipole_error){.kind = DIPOLE_ERROR_MEMORY, .text = "cannot start a thread"};
  }
  for (unsigned i = 0; i < running; i++) {
    worker *one = &workers[i];
    pthread_join(one->thread, NULL);
    ended_ns = one->ended_ns > ended_ns ? one->ended_ns : ended_ns;
    result->requests += one->done;
    result->most_ns = one->most_ns > result->most_ns ? one->most_ns : result->most_ns;
    for (size_t k = 0; k < BUCKETS; k++) {
      result->buckets[k] += one->buckets[k];
    }
    if (good && one->failed) {
      *error = one->error;
      good = false;
    }
  }
  result->took_s = (double)(ended_ns - start_ns) / 1e9;
  return good;
}

/* Sends requests under a load. Returns false, with *error, if a request failed. */
static bool run_load(report *of, measured *result, dipole_error *error) {
  worker *workers = cli_allocate(result->connections, sizeof *workers);
  dipole_query query = of->query;
  bool good = true;
  query.radius_count = result->radii;
  for (unsigned i = 0; i < result->connections; i++) {
    worker *one = &workers[i];
    one->client = of->client;
    one->query = &query;
    one->in_flight = result->in_flight;
    make_slots(of, one);
    good = good && open_and_warm_up(of, one, i == 0, error);
  }
  good = good && run_all(of, workers, result, error);
  for (unsigned i = 0; i < result->connections; i++) {
    if (workers[i].client != of->client) {
      dipole_close(workers[i].client);
    }
  }
  return good;
}

/* ---- the command line ------------------------------------------------------------------------ */

#define MEDIUM_DEFAULT "skin1"
#define SECONDS_LEAST 0.01
#define SECONDS_MOST 3600.0
#define RADIUS_LEAST_MM 0.01
#define RADIUS_MOST_MM 10.0

/* How much memory the values under way may take on all connections. */
#define VALUES_MAX_BYTES ((size_t)1 << 30)

static int check(cli_settings *settings) {
  const double seconds = settings->seconds.value;
  const struct {
    const char *option;
    uint64_t value, most;
  } counts[] = {{"connections", settings->connections.value, CONNECTIONS_MAX},
                {"in-flight", settings->in_flight.value, DIPOLE_IN_FLIGHT_MAX},
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

/* Checks those settings whose limits depend on the daemon. */
static int check_with_daemon(const report *of) {
  const cli_settings *settings = of->settings;
  const size_t bytes = (size_t)(settings->connections.value * settings->in_flight.value) *
                       (size_t)settings->radii.value * of->profile.channel_count * sizeof(double);
  const char *address = dipole_address(of->client);
  if (settings->connections.value > 1 && strncmp(address, "private:", strlen("private:")) == 0) {
    return cli_fail_usage("--connections: a private daemon has one connection; "
                          "--connect names another");
  }
  if (bytes > VALUES_MAX_BYTES) {
    return cli_fail_usage(
        "--connections, --in-flight, --radii: give less: together they take more than %zu "
        "MiB for values",
        VALUES_MAX_BYTES >> 20);
  }
  return CLI_OK;
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
                             .media = of->profile.media,
                             .layer_count = of->profile.layer_count,
                             .medium_count = (uint32_t)of->profile.channel_count,
                             .spacing = DIPOLE_LIST,
                             .radii = of->radii,
                             .parameters = of->profile.parameters.items,
                             .parameter_count = of->profile.parameters.count};
}

/* ---- measuring ------------------------------------------------------------------------------- */

static int measure(report *of) {
  const cli_settings *settings = of->settings;
  const uint64_t radii = settings->radii.value;
  of->results[0] = (measured){"small", 1, 1, radii, .took_s = 0};
  of->results[1] = (measured){"pipelined", (unsigned)settings->connections.value,
                              (unsigned)settings->in_flight.value, radii, .took_s = 0};
  of->results[2] = (measured){"large", 1, 1, settings->large_radii.value, .took_s = 0};
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
  cli_put_number(rows, result->connections, "connections", .format = "%.0f");
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

static void put_facts(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const dipole_info *info = of->profile.info;
  (void)index;
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
  status = status == CLI_OK ? check_with_daemon(of) : status;
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
    CLI_OPTION(COUNT, connections, "1", "how many connections the pipelined requests have"),
    CLI_OPTION(COUNT, in_flight, "64", "how many requests are under way on each connection"),
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
                "  dipole bench --connect tcp:farm7:4817 --connections 8 --in-flight 128\n"
                "  dipole bench --model transport --evaluator lut --seconds 5 --format json\n",
    .shows_service = true,
    .check = check,
    .run = run_bench,
};
