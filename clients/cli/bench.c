/* dipole bench: how fast a daemon replies. */
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "clients/cli/rows.h"

enum {
  RADII_MAX = 1 << 22,
  CONNECTIONS_MAX = 256,
  MEASUREMENTS = 3,
  SHIFTS = 16, /* at how many radii requests begin in turn, so that neighbours differ */
  /* buckets of durations for each factor of two: quantiles are exact within 1 % */
  BUCKETS_OF_OCTAVE = 64,
  BUCKETS = 48 * BUCKETS_OF_OCTAVE
};

/* What was measured under a load, on all connections. */
typedef struct measured {
  const char *name;
  unsigned in_flight; /* requests under way on each connection */
  uint64_t radii;     /* how many radii each request has */
  atomic_uint_fast64_t requests;
  /* How long they took, from submitting one to having its reply. */
  atomic_uint_fast32_t buckets[BUCKETS];
  double took_s; /* from the first request to the last reply, on the first connection */
} measured;

/* A request that is under way, or room for one. */
typedef struct slot {
  uint64_t id, shift; /* shift: at which radius it begins */
  uint64_t sent_ns;
  uint8_t *values; /* the buffer for its reply */
} slot;

/* What a connection sends and what it has measured. */
typedef struct report {
  const cli_settings *settings;
  dipole_client *client;
  pthread_t thread; /* of any connection but the first */
  cli_profile profile;
  dipole_query query;
  const uint8_t *radii;
  dipole_result *known; /* the first reply, at all radii */
  uint8_t *values;      /* of its requests under way, which are in `slots` */
  slot *slots;
  cli_progress progress;
  uint64_t requests; /* those of all measurements so far */
  measured *results; /* of all connections */
  bool is_first, good;
  dipole_error error;
} report;

/* Returns the duration, in us, that this share of the durations did not exceed: the middle of its
 * bucket, or 0 if nothing was counted. */
static double quantile_us(const measured *result, double share) {
  const double wanted = ceil(share * (double)result->requests);
  double before = 0;
  for (size_t i = 0; i < BUCKETS; i++) {
    before += result->buckets[i];
    if (result->buckets[i] > 0 && before >= wanted) {
      return exp2(((double)i + 0.5) / BUCKETS_OF_OCTAVE) / 1000;
    }
  }
  return 0;
}

/* Returns the size in bytes of a radius, which is that of a value. */
static size_t value_bytes(const report *of) {
  return of->query.evaluator == DIPOLE_F64 ? sizeof(double) : sizeof(float);
}

/* ---- requests -------------------------------------------------------------------------------- */

/* Whether a reply has the bits that are known of its radii. */
static bool is_right(const report *of, uint64_t radii, const slot *found) {
  const size_t one = value_bytes(of), bytes = radii * one;
  bool right = true;
  for (uint32_t i = 0; i < of->query.medium_count; i++) {
    const void *known = one == sizeof(double)
                            ? (const void *)dipole_values_f64(of->known, i, DIPOLE_R)
                            : dipole_values_f32(of->known, i, DIPOLE_R);
    right = right && memcmp(found->values + i * bytes, (const uint8_t *)known + found->shift * one,
                            bytes) == 0;
  }
  return right;
}

/* Waits for a reply, counts its duration and checks it. Its slot moves behind the `used` ones that
 * are under way. The search starts with the oldest request, whose reply is the likeliest to come. */
static bool collect(report *of, measured *result, unsigned used) {
  slot *slots = of->slots;
  dipole_result *reply;
  uint64_t id;
  unsigned i = 0;
  if (!dipole_collect(of->client, &id, &reply, &of->error)) {
    return false;
  }
  dipole_result_free(reply);
  while (i + 1 < used && slots[i].id != id) {
    i++;
  }
  const slot found = slots[i];
  const uint64_t now_ns = cli_now_ns(), ns = now_ns > found.sent_ns ? now_ns - found.sent_ns : 1;
  result->buckets[(size_t)fmin(BUCKETS_OF_OCTAVE * log2((double)ns), BUCKETS - 1)]++;
  result->requests++;
  memmove(&slots[i], &slots[i + 1], (used - i - 1) * sizeof found);
  slots[used - 1] = found;
  if (found.id != id || !is_right(of, result->radii, &found)) {
    of->error = (dipole_error){.text = "a reply has other values than the first one"};
    return false;
  }
  return true;
}

/* Shows the progress. Returns whether the time is over. */
static bool is_over(report *of, const measured *result, uint64_t start_ns) {
  const double at = (double)(result - of->results), seconds = of->settings->seconds.value;
  const double share = (double)(cli_now_ns() - start_ns) / 1e9 / seconds;
  if (of->is_first) {
    cli_progress_show(&of->progress, (at + fmin(share, 1)) / MEASUREMENTS,
                      (double)(of->requests + result->requests));
  }
  return share >= 1;
}

/* Sends requests and keeps `in_flight` of them under way. */
static bool run_load(report *of, measured *result) {
  dipole_query query = of->query;
  query.radius_count = result->radii;
  const size_t bytes = (size_t)(query.medium_count * result->radii * value_bytes(of) + 7) / 8 * 8;
  for (unsigned i = 0; i < result->in_flight; i++) {
    of->slots[i].values = of->values + i * bytes;
  }
  const uint64_t start_ns = cli_now_ns();
  unsigned used = 0, shift = 0;
  bool good = true;
  for (bool over = false; good && !(over && used == 0);) {
    while (good && !over && used < result->in_flight) {
      slot *next = &of->slots[used];
      next->shift = shift++ % SHIFTS;
      query.radii = of->radii + next->shift * value_bytes(of);
      query.into_values = next->values;
      next->sent_ns = cli_now_ns();
      good = dipole_submit(of->client, &query, &next->id, &of->error);
      used += good;
    }
    good = good && collect(of, result, used);
    used -= good;
    over = over || is_over(of, result, start_ns);
  }
  if (of->is_first) {
    result->took_s = (double)(cli_now_ns() - start_ns) / 1e9;
    of->requests += result->requests;
  }
  return good;
}

/* ---- the command line ------------------------------------------------------------------------ */

#define SECONDS_LEAST 0.01
#define SECONDS_MOST 3600.0
#define RADIUS_LEAST_MM 0.01
#define RADIUS_MOST_MM 10.0
enum { UNDER_WAY_MAX = 1 << 25 }; /* radii */

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
  if (counts[0].value * counts[1].value * counts[2].value > UNDER_WAY_MAX) {
    return cli_fail_usage(
        "--connections, --in-flight, --radii: give less: their product is at most %d",
        UNDER_WAY_MAX);
  }
  if (!cli_medium_given(settings) && settings->tissue.count == 0) {
    static char name[] = "skin1", *names[] = {name};
    settings->medium = (cli_texts){1, names, name};
  }
  return cli_medium_check(settings);
}

/* ---- what is requested --------------------------------------------------------------------------- */

static void make_query(report *of) {
  const uint64_t small = of->settings->radii.value, large = of->settings->large_radii.value;
  const uint64_t count = (small > large ? small : large) + SHIFTS;
  const double step_mm = (RADIUS_MOST_MM - RADIUS_LEAST_MM) / (double)count;
  const cli_numbers radii_mm = {count, cli_allocate(count, sizeof(double))};
  for (uint64_t i = 0; i < count; i++) {
    radii_mm.items[i] = RADIUS_LEAST_MM + (double)i * step_mm;
  }
  of->radii = cli_numbers_in(&radii_mm, of->profile.evaluator->id != DIPOLE_F64);
  of->query = (dipole_query){.model = of->profile.model->id,
                             .evaluator = of->profile.evaluator->id,
                             CLI_QUERY_OF(&of->profile),
                             .wanted = DIPOLE_R,
                             CLI_MEDIA_OF(&of->profile),
                             .spacing = DIPOLE_LIST,
                             .radius_count = count,
                             .radii = of->radii};
}

/* ---- measuring ------------------------------------------------------------------------------- */

/* Does all measurements on a connection. */
static void *measure(void *argument) {
  report *of = argument;
  of->good = true;
  for (size_t i = 0; of->good && i < MEASUREMENTS; i++) {
    of->good = run_load(of, &of->results[i]);
  }
  return NULL;
}

/* Measures on all connections, of which the first is open. Before that it sends a request with all
 * radii, which is not counted: then the daemon has prepared what it needs. */
static int measure_all(report *all) {
  const uint64_t small = all->settings->radii.value, large = all->settings->large_radii.value;
  const size_t count = all->settings->connections.value, in_flight = all->settings->in_flight.value;
  if (!dipole_eval(all->client, &all->query, &all->known, &all->error)) {
    return cli_fail_error(&all->error);
  }
  all->results[0] = (measured){"small", 1, small, .took_s = 0};
  all->results[1] = (measured){"pipelined", (unsigned)in_flight, small, .took_s = 0};
  all->results[2] = (measured){"large", 1, large, .took_s = 0};
  for (size_t i = 0; i < count; i++) {
    all[i] = all[0];
    all[i].is_first = i == 0;
    all[i].slots = cli_allocate(in_flight, sizeof(slot));
    all[i].values =
        cli_allocate(small * in_flight + large, all->query.medium_count * sizeof(double));
    if (i > 0 && (all[i].client = cli_open(all->settings)) == NULL) {
      return CLI_FAILED;
    }
  }
  for (size_t i = 1; i < count; i++) {
    if (pthread_create(&all[i].thread, NULL, measure, &all[i]) != 0) {
      return cli_fail("no thread could be started: give fewer --connections");
    }
  }
  cli_progress_start(&all->progress, "requests");
  measure(all);
  cli_progress_wipe(&all->progress);
  report *failed = all;
  for (size_t i = 1; i < count; i++) {
    pthread_join(all[i].thread, NULL);
    dipole_close(all[i].client);
    failed = all[i].good ? failed : &all[i];
  }
  dipole_result_free(all->known);
  return failed->good ? CLI_OK : cli_fail_error(&failed->error);
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Adds a figure. A table shows three digits of it without an exponent, in the unit of its head. */
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
  put_figure(rows, "max_us", "max us", 1, quantile_us(result, 1));
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
  cli_put_count(rows, of->settings->connections.value, "connections");
}

/* ---- the command ----------------------------------------------------------------------------- */

static int run_bench(const cli_settings *settings, dipole_client *client) {
  report *of = cli_allocate(settings->connections.value, sizeof *of);
  *of = (report){.settings = settings,
                 .client = client,
                 .results = cli_allocate(MEASUREMENTS, sizeof *of->results)};
  int status = cli_profile_take(settings, client, &of->profile);
  if (status == CLI_OK) {
    make_query(of);
    status = measure_all(of);
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
    CLI_OPTION(COUNT, connections, "1", "how many connections send at the same time"),
    CLI_OPTION(COUNT, in_flight, "64", "how many pipelined requests each has under way"),
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
        "requests one at a time. Each value is compared with that of a first reply, bit for bit. "
        "A time is that from submitting a request to having its values, "
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
