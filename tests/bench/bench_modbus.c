/* Compares dipoled's Modbus over TCP with an echo server. Servers run on one core and clients on
 * another (service/child.h), each server in its own process. All sides take turns, a fraction of a
 * second each. A figure is the median over the rounds, and a ratio is the median of the ratios of
 * the rounds. A transaction is function 23: it writes 20 registers (commit, model, medium, a grid
 * of 4 distances), evaluates, and reads 20 (status, errors, R). The values of each answer are
 * checked.
 *
 *   modbus.fc23.<n>.<side>.rate       transactions, over n connections with one in flight each   1/s
 *   modbus.fc23.<n>.<side>.p50 ...    latency of transactions                                     us
 *   modbus.fc23.<n>.<side>.cpu        processor time of the server for one transaction            us
 *   ratio.modbus.fc23.<n>             dipoled's rate over the echo's
 *   modbus.beside.<whom>.p50 ...      round trip of one master beside nobody, or beside one that sends
 *                                     a byte every 0.4 s, one that never reads, and one that asks
 *                                     for unknown functions                                       us
 *   ratio.modbus.beside               the 99th percentile beside all three over that beside nobody
 */
#include <string.h>

#include "tests/bench/bench.h"
#include "tests/bench/service/child.h"
#include "tests/bench/service/daemon.h"
#include "tests/bench/service/echo.h"
#include "tests/bench/service/load.h"
#include "tests/bench/service/modbus.h"
#include "tests/bench/service/ping.h"

enum { ROUNDS = 15, LIMIT_S = 120 };
#define MS UINT64_C(1000000)
#define ROUND_NS (200 * MS)
#define WARM_UP_NS (50 * MS)

static struct samples samples;

/* A side: a server or a situation whose figures are measured in turn with those of the others. */
struct side {
  const char *name;
  const struct target *target;
  struct load *load;
  double rate_per_s[ROUNDS];
  double cpu_us[ROUNDS];
  double p50_us[ROUNDS];
  double p99_us[ROUNDS];
  double p999_us[ROUNDS];
};

static void note_percentiles(struct side *side, size_t round) {
  side->p50_us[round] = samples_us(&samples, 0.5);
  side->p99_us[round] = samples_us(&samples, 0.99);
  side->p999_us[round] = samples_us(&samples, 0.999);
}

static void report_percentiles(const struct side *side, const char *what) {
  bench_figure(bench_median_of(side->p50_us, ROUNDS), "us", "modbus.%s.%s.p50", what, side->name);
  bench_figure(bench_median_of(side->p99_us, ROUNDS), "us", "modbus.%s.%s.p99", what, side->name);
  bench_figure(bench_median_of(side->p999_us, ROUNDS), "us", "modbus.%s.%s.p99.9", what,
               side->name);
}

/* ---- many masters ------------------------------------------------------------------------- */

static void load_round(struct side *side, size_t round) {
  const uint64_t cpu_ns = child_cpu_ns(side->target->server);
  side->rate_per_s[round] = load_closed(side->load, ROUND_NS, &samples);
  side->cpu_us[round] =
      (double)(child_cpu_ns(side->target->server) - cpu_ns) * 1e-3 / (double)samples.count;
  note_percentiles(side, round);
}

static void measure_load(const struct target *jobs, const struct target *echo, size_t connections,
                         const char *what) {
  struct side sides[] = {{.name = "dipoled", .target = jobs}, {.name = "echo", .target = echo}};
  bench_progress("modbus: many masters");
  for (size_t i = 0; i < 2; i++) {
    sides[i].load = load_new(sides[i].target, connections, 1);
    load_closed(sides[i].load, WARM_UP_NS, &samples);
  }
  for (size_t round = 0; round < ROUNDS; round++) {
    load_round(&sides[0], round);
    load_round(&sides[1], round);
  }
  for (size_t i = 0; i < 2; i++) {
    load_free(sides[i].load);
    bench_figure(bench_median_of(sides[i].rate_per_s, ROUNDS), "transactions/s",
                 "modbus.%s.%s.rate", what, sides[i].name);
    report_percentiles(&sides[i], what);
    bench_figure(bench_median_of(sides[i].cpu_us, ROUNDS), "us", "modbus.%s.%s.cpu", what,
                 sides[i].name);
  }
  bench_figure(bench_median_ratio(sides[0].rate_per_s, sides[1].rate_per_s, ROUNDS), "times",
               "ratio.modbus.%s", what);
}

/* ---- beside rude ones --------------------------------------------------------------------- */

static void ping_round(struct ping *ping, struct side *side, size_t round) {
  ping_run(ping, ROUND_NS, &samples);
  note_percentiles(side, round);
}

static void measure_beside(const struct target *jobs) {
  struct side quiet = {.name = "nobody"};
  struct side beside = {.name = "rude"};
  struct ping ping;
  pid_t rude[MODBUS_RUDE];
  bench_progress("modbus: beside rude masters");
  ping_open(&ping, jobs);
  ping_run(&ping, WARM_UP_NS, &samples);
  for (size_t round = 0; round < ROUNDS; round++) {
    ping_round(&ping, &quiet, round);
    modbus_start_rude(&jobs->address, rude);
    ping_run(&ping, WARM_UP_NS, &samples);
    ping_round(&ping, &beside, round);
    for (size_t i = 0; i < MODBUS_RUDE; i++) {
      child_must_run(rude[i], "a rude master");
      child_end(rude[i]);
    }
  }
  ping_close(&ping);
  report_percentiles(&quiet, "beside");
  report_percentiles(&beside, "beside");
  bench_figure(bench_median_ratio(beside.p99_us, quiet.p99_us, ROUNDS), "times",
               "ratio.modbus.beside");
}

/* ---- all of them -------------------------------------------------------------------------- */

void bench_modbus(void) {
  struct daemon daemon;
  struct target jobs, echo;
  child_begin(LIMIT_S);
  modbus_make_jobs(&jobs);
  daemon_start(&daemon, CHILD_SERVER, "dipoled", 1);
  jobs.address = daemon.at_modbus;
  jobs.server = daemon.child;
  target_make_echo(&echo, &jobs);
  echo.address = target_tcp(0);
  echo_start(&echo);
  child_pin(CHILD_CLIENT);
  measure_load(&jobs, &echo, 1, "fc23.1");
  measure_load(&jobs, &echo, MODBUS_UNITS, "fc23.32");
  measure_beside(&jobs);
  child_end(echo.server);
  daemon_end(&daemon);
  child_end_all();
  target_free(&jobs);
  target_free(&echo);
  samples_free(&samples);
}
