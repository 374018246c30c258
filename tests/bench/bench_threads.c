/* Two threading schemes for a server with two workers, as bare prototypes that know nothing of
 * dipoled (service/seat.h): `owners`, workers that own connections and work where they read, and
 * `front`, a thread that reads and writes, with the workers behind queues. Clients and threads run
 * on whatever core the scheduler likes, as in a daemon; both schemes take turns, and the figures
 * are medians over the rounds.
 *
 *   threads.<scheme>.<load>.rate       requests/s
 *   threads.<scheme>.<load>.cpu        processor time of the server for one request     us
 *   threads.<scheme>.<load>.p50, .p99  latency                                          us
 *   ratio.threads.<load>               the rate of owners over that of front
 *
 * Loads: requests of 16 radii, and of 65,536: `one`, one at a time; `many`, over 32 connections
 * with 16 in flight on each (large: 4 with 2); `alone`, 4 large ones in flight on a single
 * connection, of which owners' second worker has nothing.
 */
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "tests/bench/bench.h"
#include "tests/bench/service/child.h"
#include "tests/bench/service/load.h"
#include "tests/bench/service/seat.h"

enum { ROUNDS = 15, LIMIT_S = 120 };
#define ROUND_NS UINT64_C(100000000)
#define WARM_UP_NS UINT64_C(20000000)

static const struct {
  const char *name;
  size_t radii;
  size_t connections;
  size_t in_flight;
} loads[] = {
    {"16.one", 16, 1, 1},        {"16.many", 16, 32, SEAT_PLACES}, {"65536.one", 65536, 1, 1},
    {"65536.many", 65536, 4, 2}, {"65536.alone", 65536, 1, 4},
};

static const struct {
  const char *name;
  void (*run)(const struct target *target, int listener);
} schemes[] = {{"owners", scheme_run_owners}, {"front", scheme_run_front}};
enum { SCHEMES = sizeof schemes / sizeof schemes[0] };

struct side {
  struct target target;
  struct load *load;
  double rate_per_s[ROUNDS];
  double cpu_us[ROUNDS];
  double p50_us[ROUNDS];
  double p99_us[ROUNDS];
};

static struct samples samples;

static void start(struct side *side, size_t scheme, const struct target *eval) {
  target_make_echo(&side->target, eval);
  seat_expect(&side->target);
  side->target.name = schemes[scheme].name;
  side->target.address = target_unix(child_path(schemes[scheme].name));
  const int listener = target_listen(&side->target.address);
  side->target.server = child_fork(CHILD_ANYWHERE);
  if (side->target.server == 0) {
    schemes[scheme].run(&side->target, listener);
  }
  close(listener);
}

static void end(struct side *side) {
  load_free(side->load);
  child_end(side->target.server);
  target_free(&side->target);
}

static void run_round(struct side *side, size_t round) {
  const uint64_t cpu_ns = child_cpu_ns(side->target.server);
  side->rate_per_s[round] = load_closed(side->load, ROUND_NS, &samples);
  side->cpu_us[round] =
      (double)(child_cpu_ns(side->target.server) - cpu_ns) * 1e-3 / (double)samples.count;
  side->p50_us[round] = samples_us(&samples, 0.5);
  side->p99_us[round] = samples_us(&samples, 0.99);
}

static void report(struct side *side, const char *load) {
  const char *scheme = side->target.name;
  bench_figure(bench_median(side->rate_per_s, ROUNDS), "requests/s", "threads.%s.%s.rate", scheme,
               load);
  bench_figure(bench_median(side->cpu_us, ROUNDS), "us", "threads.%s.%s.cpu", scheme, load);
  bench_figure(bench_median(side->p50_us, ROUNDS), "us", "threads.%s.%s.p50", scheme, load);
  bench_figure(bench_median(side->p99_us, ROUNDS), "us", "threads.%s.%s.p99", scheme, load);
}

static void measure(size_t load) {
  static struct side sides[SCHEMES];
  struct target eval;
  double ratios[ROUNDS];
  target_make_eval(&eval, loads[load].radii);
  for (size_t i = 0; i < SCHEMES; i++) {
    start(&sides[i], i, &eval);
    sides[i].load = load_new(&sides[i].target, loads[load].connections, loads[load].in_flight);
    load_closed(sides[i].load, WARM_UP_NS, &samples);
  }
  for (size_t round = 0; round < ROUNDS; round++) {
    for (size_t i = 0; i < SCHEMES; i++) {
      run_round(&sides[i], round);
    }
    ratios[round] = sides[0].rate_per_s[round] / sides[1].rate_per_s[round];
  }
  for (size_t i = 0; i < SCHEMES; i++) {
    report(&sides[i], loads[load].name);
    end(&sides[i]);
  }
  bench_figure(bench_median(ratios, ROUNDS), "times", "ratio.threads.%s", loads[load].name);
  target_free(&eval);
}

void bench_threads(void) {
  for (size_t i = 0; i < sizeof loads / sizeof loads[0]; i++) {
    char what[64];
    snprintf(what, sizeof what, "threads: %s", loads[i].name);
    bench_progress(what);
    child_begin(LIMIT_S);
    measure(i);
    child_end_all();
  }
  samples_free(&samples);
}
