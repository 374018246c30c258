#include "clients/cli/bench_load.h"

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "clients/cli/daemon.h"

enum { SHOW_EVERY_MS = 50 };

/* ---- durations ----------------------------------------------------------------------------- */

/* Below BENCH_OCTAVE ns, every ns has a bucket of its own; from there on a bucket is a 64th of an
 * octave. */
static size_t bucket_of(uint64_t ns) {
  if (ns < BENCH_OCTAVE) {
    return (size_t)ns;
  }
  const unsigned octave = 63U - (unsigned)__builtin_clzll(ns) - 6; /* 2^6 = BENCH_OCTAVE */
  const size_t bucket = (size_t)octave * BENCH_OCTAVE + (size_t)(ns >> octave);
  return bucket < BENCH_BUCKETS ? bucket : BENCH_BUCKETS - 1;
}

/* Returns the middle of a bucket. */
static double ns_of(size_t bucket) {
  if (bucket < BENCH_OCTAVE) {
    return (double)bucket;
  }
  const int octave = (int)(bucket / BENCH_OCTAVE) - 1;
  return ldexp((double)(bucket - (size_t)octave * BENCH_OCTAVE) + 0.5, octave);
}

static void add_time(bench_times *times, uint64_t ns) {
  times->buckets[bucket_of(ns)]++;
  times->count++;
  times->most_ns = ns > times->most_ns ? ns : times->most_ns;
}

static void join_times(bench_times *times, const bench_times *more) {
  for (size_t i = 0; i < BENCH_BUCKETS; i++) {
    times->buckets[i] += more->buckets[i];
  }
  times->count += more->count;
  times->most_ns = more->most_ns > times->most_ns ? more->most_ns : times->most_ns;
}

double bench_times_quantile_us(const bench_times *times, double share) {
  const double wanted = ceil(share * (double)times->count);
  double before = 0;
  for (size_t i = 0; i < BENCH_BUCKETS; i++) {
    before += times->buckets[i];
    if (times->buckets[i] > 0 && before >= wanted) {
      return fmin(ns_of(i), (double)times->most_ns) / 1000;
    }
  }
  return 0;
}

/* ---- a connection: a thread, which keeps so many requests under way --------------------------- */

/* A request that is under way, or room for one. */
typedef struct slot {
  uint64_t id;
  uint64_t sent_ns;
  uint8_t *values; /* where its answer goes */
} slot;

typedef struct worker {
  pthread_t thread;
  dipole_client *client;
  const dipole_query *query;
  unsigned in_flight;
  uint64_t until_ns, ended_ns;
  uint8_t *values;
  slot *slots; /* [in_flight]; the first `used` are under way, oldest first */
  unsigned used;
  atomic_ullong answered;
  atomic_bool done;
  bool failed;
  dipole_error error;
  bench_times times;
} worker;

static uint64_t now_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (uint64_t)now.tv_sec * 1000000000 + (uint64_t)now.tv_nsec;
}

static bool submit(worker *of) {
  slot *to = &of->slots[of->used];
  dipole_query query = *of->query;
  query.into_values = to->values;
  to->sent_ns = now_ns();
  const bool good = dipole_submit(of->client, &query, &to->id, &of->error);
  of->used += good;
  return good;
}

/* Takes an answer: its slot moves behind those that are under way. The search starts with the oldest
 * request, whose answer is the likeliest to come. */
static void take(worker *of, uint64_t id, uint64_t at_ns) {
  for (unsigned i = 0; i < of->used; i++) {
    if (of->slots[i].id == id) {
      const slot found = of->slots[i];
      add_time(&of->times, at_ns - found.sent_ns);
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
  take(of, id, now_ns());
  atomic_fetch_add_explicit(&of->answered, 1, memory_order_relaxed);
  return true;
}

static void *work(void *argument) {
  worker *of = argument;
  bool good = true;
  do {
    while (good && of->used < of->in_flight) {
      good = submit(of);
    }
    good = good && collect(of);
  } while (good && now_ns() < of->until_ns);
  while (good && of->used > 0) {
    good = collect(of);
  }
  of->failed = !good;
  of->ended_ns = now_ns();
  atomic_store(&of->done, true);
  return NULL;
}

/* ---- all of them --------------------------------------------------------------------------- */

static size_t quantities(unsigned wanted) {
  return (size_t)__builtin_popcount(wanted & ~(unsigned)(DIPOLE_ALBEDO | DIPOLE_RADIUS));
}

/* Returns how many bytes the values of an answer take. */
static size_t values_bytes(const dipole_query *query) {
  const size_t value_bytes = query->evaluator == DIPOLE_F64 ? sizeof(double) : sizeof(float);
  return quantities(query->wanted) * query->medium_count * query->radius_count * value_bytes;
}

static void make_slots(worker *of) {
  const size_t bytes = (values_bytes(of->query) + 7) / 8 * 8;
  of->slots = cli_allocate(of->in_flight, sizeof *of->slots);
  of->values = cli_allocate(of->in_flight, bytes);
  for (unsigned i = 0; i < of->in_flight; i++) {
    of->slots[i].values = of->values + i * bytes;
  }
}

static bool open_another(const cli_common *common, dipole_client **client, dipole_error *error) {
  dipole_options options;
  cli_connection_options(common, &options);
  options.in_flight_max = 0;
  return dipole_open_with(common->connect, &options, client, error);
}

/* Sends one request that is not counted, so that the daemon has prepared all it needs. */
static bool warm_up(worker *of, dipole_error *error) {
  dipole_result *result;
  if (!dipole_eval(of->client, of->query, &result, error)) {
    return false;
  }
  dipole_result_free(result);
  return true;
}

static uint64_t count_answers(worker *workers, unsigned count, bool *done) {
  uint64_t answered = 0;
  *done = true;
  for (unsigned i = 0; i < count; i++) {
    answered += atomic_load_explicit(&workers[i].answered, memory_order_relaxed);
    *done = *done && atomic_load(&workers[i].done);
  }
  return answered;
}

/* Shows the progress until all workers are done. */
static void watch(worker *workers, const bench_load *load, uint64_t start_ns,
                  void (*show)(void *context, double share, uint64_t requests), void *context) {
  const struct timespec nap = {.tv_nsec = SHOW_EVERY_MS * 1000000L};
  for (bool done = false; !done;) {
    const uint64_t answered = count_answers(workers, load->connections, &done);
    const double share = (double)(now_ns() - start_ns) / 1e9 / load->seconds;
    show(context, share < 1 ? share : 1, answered);
    if (!done) {
      nanosleep(&nap, NULL);
    }
  }
}

/* Starts a thread for each worker. Returns how many run; if that is not all, *error says why. */
static unsigned start(worker *workers, const bench_load *load, uint64_t start_ns,
                      dipole_error *error) {
  for (unsigned i = 0; i < load->connections; i++) {
    workers[i].until_ns = start_ns + (uint64_t)(load->seconds * 1e9);
    if (pthread_create(&workers[i].thread, NULL, work, &workers[i]) != 0) {
      *error = (dipole_error){.kind = DIPOLE_ERROR_MEMORY, .text = "cannot start a thread"};
      return i;
    }
  }
  return load->connections;
}

static bool run_all(worker *workers, const bench_load *load,
                    void (*show)(void *context, double share, uint64_t requests), void *context,
                    bench_result *result, dipole_error *error) {
  const uint64_t start_ns = now_ns();
  const unsigned running = start(workers, load, start_ns, error);
  bool good = running == load->connections;
  uint64_t ended_ns = start_ns;
  if (good) {
    watch(workers, load, start_ns, show, context);
  }
  for (unsigned i = 0; i < running; i++) {
    pthread_join(workers[i].thread, NULL);
    ended_ns = workers[i].ended_ns > ended_ns ? workers[i].ended_ns : ended_ns;
    join_times(&result->times, &workers[i].times);
    if (good && workers[i].failed) {
      *error = workers[i].error;
      good = false;
    }
  }
  result->took_s = (double)(ended_ns - start_ns) / 1e9;
  return good;
}

bool bench_run(dipole_client *client, const cli_common *common, const dipole_query *query,
               const bench_load *load, void (*show)(void *context, double share, uint64_t requests),
               void *context, bench_result *result, dipole_error *error) {
  worker *workers = cli_allocate(load->connections, sizeof *workers);
  dipole_query asked = *query;
  bool good = true;
  asked.radius_count = load->radii;
  *result =
      (bench_result){.load = *load,
                     .value_bytes = asked.evaluator == DIPOLE_F64 ? sizeof(double) : sizeof(float),
                     .values_per_radius = (double)(quantities(asked.wanted) * asked.medium_count)};
  for (unsigned i = 0; i < load->connections; i++) {
    worker *one = &workers[i];
    one->client = client;
    one->query = &asked;
    one->in_flight = load->in_flight;
    make_slots(one);
    good = good && (i == 0 || open_another(common, &one->client, error)) && warm_up(one, error);
  }
  good = good && run_all(workers, load, show, context, result, error);
  for (unsigned i = 0; i < load->connections; i++) {
    free(workers[i].values);
    free(workers[i].slots);
    if (workers[i].client != client) {
      dipole_close(workers[i].client);
    }
  }
  free(workers);
  return good;
}

/* ---- rates --------------------------------------------------------------------------------- */

double bench_requests_per_s(const bench_result *result) {
  return result->took_s > 0 ? (double)result->times.count / result->took_s : 0;
}

double bench_radii_per_s(const bench_result *result) {
  return bench_requests_per_s(result) * (double)result->load.radii * result->values_per_radius;
}

double bench_bytes_per_s(const bench_result *result) {
  return bench_requests_per_s(result) * (double)result->load.radii *
         (1 + result->values_per_radius) * result->value_bytes;
}
