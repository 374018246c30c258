/* Compares dipoled as a service with an echo server. Servers run on one core and clients on another
 * (service/child.h), each server in its own process. dipoled has one worker, because it has one core;
 * with two workers on that core, the processor time of a request is the same within 2 %. All sides
 * take turns, a fraction of a second each. A figure is the median over the rounds, a ratio the median
 * of the rounds' ratios. Requests evaluate R by the better dipole in single precision at listed radii,
 * over a Unix socket unless a name has tcp. The header of each answer is checked, and all its values
 * (of large answers, those of every 16th).
 *
 *   service.bulk[.tcp].<side>          round trip of 65,536 radii, one at a time; the side kernel
 *                                      is the evaluation alone, in this process               us
 *   service.bulk[.tcp].<side>.max      the largest of these times                               us
 *   service.bulk[.tcp].<side>.rate     bytes both ways over this time                       MB/s
 *   ratio.service.bulk[.tcp]           dipoled over the sum of echo and kernel
 *   service.rtt.<side>.p50 ...         round trip of 16 radii, one at a time                  us
 *   ratio.service.rtt[.p99]            dipoled over echo
 *   service.many.<side>.rate           requests of 16 radii over 32 connections with 16 in flight on
 *                                      each                                           requests/s
 *   service.many.<side>.p50 ...        latency of these requests                              us
 *   service.many.<side>.cpu            processor time of the server for one request           us
 *   service.varying.<model>.<side>     round trip of 65,536 values, each with a medium of its own
 *   ratio.service.varying.<model>      dipoled over the sum of echo and kernel
 *
 *   service.scale.workers              half of the cores, from 1 to 16
 *   service.scale.<one or all>         round trips of 65,536 radii a second over Unix sockets, with
 *                                      one worker and client, or as many of both as service.scale
 *                                      says, all of them on any core                  requests/s
 *   ratio.service.scale                all over one; the number of workers would be perfect
 *
 * bulk and rtt are also measured with clients on the servers' core: names with .onecore. No two
 * processes then run at the same time, and no core has to be woken. These figures show the work,
 * that of the client included, and hardly depend on what else the machine does.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/core.h"
#include "tests/bench/bench.h"
#include "tests/bench/service/child.h"
#include "tests/bench/service/daemon.h"
#include "tests/bench/service/echo.h"
#include "tests/bench/service/load.h"
#include "tests/bench/service/ping.h"

enum {
  SMALL_RADII = 16,
  BULK_RADII = 65536,
  ROUNDS = 15,
  CONNECTIONS = 32,
  IN_FLIGHT = 16,
  SCALE_MOST = 16,
  LIMIT_S = 300, /* five times as long as the group takes on a machine that does nothing else */
};
#define MS UINT64_C(1000000)
#define ROUND_NS (150 * MS)
#define WARM_UP_NS (20 * MS)
#define KERNEL_NS (20 * MS)

/* All servers, and the requests that they get. */
struct setting {
  struct daemon daemon;
  struct target eval;
  struct target echo;
  struct target bulk;
  struct target bulk_echo;
};

static struct samples samples;

/* ---- sides -------------------------------------------------------------------------------- */

/* A side: a server whose figures are measured in turn with those of the others. */
struct side {
  const char *name;
  const struct target *target;
  struct ping ping;
  struct load *load;
  size_t rounds; /* number of rounds so far */
  double p50_us[ROUNDS];
  double p99_us[ROUNDS];
  double p999_us[ROUNDS];
  double max_us; /* of all rounds */
  double rate_per_s[ROUNDS];
  double cpu_us[ROUNDS];
};

static struct side side_of(const struct target *target) {
  return (struct side){.name = target->name, .target = target};
}

static void note_percentiles(struct side *side) {
  const size_t round = side->rounds++;
  side->p50_us[round] = samples_us(&samples, 0.5);
  side->p99_us[round] = samples_us(&samples, 0.99);
  side->p999_us[round] = samples_us(&samples, 0.999);
  side->max_us = fmax(side->max_us, samples_us(&samples, 1));
}

static void report_percentiles(const struct side *side, const char *what, const char *where) {
  bench_figure(bench_median_of(side->p50_us, side->rounds), "us", "service.%s%s.%s.p50", what,
               where, side->name);
  bench_figure(bench_median_of(side->p99_us, side->rounds), "us", "service.%s%s.%s.p99", what,
               where, side->name);
  bench_figure(bench_median_of(side->p999_us, side->rounds), "us", "service.%s%s.%s.p99.9", what,
               where, side->name);
}

static void open_pings(struct side *sides, size_t count) {
  for (size_t i = 0; i < count; i++) {
    ping_open(&sides[i].ping, sides[i].target);
    ping_run(&sides[i].ping, WARM_UP_NS, &samples);
  }
}

static void close_pings(struct side *sides, size_t count) {
  for (size_t i = 0; i < count; i++) {
    ping_close(&sides[i].ping);
  }
}

static void ping_round(struct side *sides, size_t count) {
  for (size_t i = 0; i < count; i++) {
    ping_run(&sides[i].ping, ROUND_NS, &samples);
    note_percentiles(&sides[i]);
  }
}

/* ---- bulk --------------------------------------------------------------------------------- */

/* The evaluation of the values of a bulk request in this process. */
struct kernel {
  core_profile profile;        /* unless each value has a medium of its own */
  const core_varying *varying; /* if it has, else NULL */
  const float *arrays;         /* radii; or sigma_a, sigma_s and radii */
  float *R;
};

static struct kernel make_kernel(const struct target *bulk, const core_varying *varying) {
  struct kernel kernel = {.varying = varying};
  const size_t arrays = varying != NULL ? 3 : 1;
  const core_medium *medium = &core_measured_medium_by_name("skin1")->channel[0];
  const core_fault fault =
      core_profile_prepare(&kernel.profile, core_isa_select(NULL), CORE_MODEL_BETTER,
                           CORE_MOMENTS_EXACT, CORE_EVALUATOR_F32, medium, NULL);
  kernel.arrays = (const float *)(bulk->requests + bulk->request_bytes -
                                  arrays * BULK_RADII * sizeof *kernel.arrays);
  kernel.R = malloc(BULK_RADII * sizeof *kernel.R);
  if (fault.field != NULL || kernel.R == NULL) {
    bench_fail("a measured medium was refused, or out of memory");
  }
  return kernel;
}

static void evaluate(const struct kernel *kernel) {
  const float *arrays = kernel->arrays;
  if (kernel->varying != NULL) {
    core_varying_eval_f32(kernel->varying, CORE_QUANTITY_R, BULK_RADII, arrays, arrays + BULK_RADII,
                          arrays + 2 * (size_t)BULK_RADII, kernel->R);
  } else {
    core_eval_f32(&kernel->profile, CORE_QUANTITY_R, BULK_RADII, arrays, kernel->R);
  }
}

static double kernel_us(const struct kernel *kernel) {
  const uint64_t end_ns = bench_now_ns() + KERNEL_NS;
  samples_clear(&samples);
  for (uint64_t start_ns = bench_now_ns(); start_ns < end_ns;) {
    evaluate(kernel);
    const uint64_t now_ns = bench_now_ns();
    samples_add(&samples, now_ns - start_ns);
    start_ns = now_ns;
  }
  samples_sort(&samples);
  return samples_us(&samples, 0.5);
}

static void report_bulk(const struct side *side, const char *name) {
  const double us = bench_median_of(side->p50_us, side->rounds);
  const double bytes = (double)(side->target->request_bytes + side->target->reply_bytes);
  bench_figure(us, "us", "service.%s.%s", name, side->name);
  bench_figure(side->max_us, "us", "service.%s.%s.max", name, side->name);
  bench_figure(bytes / us, "MB/s", "service.%s.%s.rate", name, side->name);
}

/* varying: the model of values with media of their own, or NULL. name: that of the figures. */
static void measure_bulk(const struct target *bulk, const struct target *echo,
                         const core_varying *varying, const char *name) {
  bench_progress("service: bulk");
  struct side sides[] = {side_of(bulk), side_of(echo)};
  struct kernel kernel = make_kernel(bulk, varying);
  double kernels_us[ROUNDS], floor_us[ROUNDS];
  open_pings(sides, 2);
  kernel_us(&kernel);
  for (size_t round = 0; round < ROUNDS; round++) {
    ping_round(sides, 2);
    kernels_us[round] = kernel_us(&kernel);
    floor_us[round] = sides[1].p50_us[round] + kernels_us[round];
  }
  close_pings(sides, 2);
  report_bulk(&sides[0], name);
  report_bulk(&sides[1], name);
  bench_figure(bench_median_of(kernels_us, ROUNDS), "us", "service.%s.kernel", name);
  bench_figure(bench_median_ratio(sides[0].p50_us, floor_us, ROUNDS), "times", "ratio.service.%s",
               name);
  core_profile_free(&kernel.profile);
  free(kernel.R);
}

static void measure_bulk_tcp(const struct setting *setting) {
  struct target bulk = setting->bulk;
  struct target echo = setting->bulk_echo;
  bulk.address = setting->daemon.at_tcp;
  echo.address = target_tcp(0);
  echo_start(&echo);
  measure_bulk(&bulk, &echo, NULL, "bulk.tcp");
  child_end(echo.server);
}

/* Measures a request of values with media of their own over the Unix socket. */
static void measure_varying(const struct setting *setting, enum core_model model,
                            const char *name) {
  core_varying varying;
  struct target bulk, echo;
  if (core_varying_prepare(&varying, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                           CORE_EVALUATOR_F32, 0, 1.3, NULL)
          .field != NULL) {
    bench_fail("media cannot vary with a model");
  }
  target_make_varying(&bulk, &varying, BULK_RADII);
  bulk.address = setting->daemon.at_unix;
  target_make_echo(&echo, &bulk);
  echo.address = target_unix(child_path(name));
  echo_start(&echo);
  measure_bulk(&bulk, &echo, &varying, name);
  child_end(echo.server);
  target_free(&bulk);
  target_free(&echo);
  core_varying_free(&varying);
}

/* ---- round trips -------------------------------------------------------------------------- */

static void measure_rtt(const struct setting *setting, const char *where) {
  bench_progress("service: round trips");
  struct side sides[] = {side_of(&setting->eval), side_of(&setting->echo)};
  open_pings(sides, 2);
  for (size_t round = 0; round < ROUNDS; round++) {
    ping_round(sides, 2);
  }
  close_pings(sides, 2);
  report_percentiles(&sides[0], "rtt", where);
  report_percentiles(&sides[1], "rtt", where);
  bench_figure(bench_median_ratio(sides[0].p50_us, sides[1].p50_us, ROUNDS), "times",
               "ratio.service.rtt%s", where);
  bench_figure(bench_median_ratio(sides[0].p99_us, sides[1].p99_us, ROUNDS), "times",
               "ratio.service.rtt%s.p99", where);
}

/* ---- many requests ------------------------------------------------------------------------ */

static void load_round(struct side *side) {
  const size_t round = side->rounds;
  const uint64_t cpu_ns = child_cpu_ns(side->target->server);
  side->rate_per_s[round] = load_closed(side->load, ROUND_NS, &samples);
  side->cpu_us[round] =
      (double)(child_cpu_ns(side->target->server) - cpu_ns) * 1e-3 / (double)samples.count;
  note_percentiles(side);
}

static void measure_many(const struct setting *setting) {
  bench_progress("service: many requests");
  struct side sides[] = {side_of(&setting->eval), side_of(&setting->echo)};
  const size_t count = sizeof sides / sizeof sides[0];
  for (size_t i = 0; i < count; i++) {
    sides[i].load = load_new(sides[i].target, CONNECTIONS, IN_FLIGHT);
    load_closed(sides[i].load, WARM_UP_NS, &samples);
  }
  for (size_t round = 0; round < ROUNDS; round++) {
    for (size_t i = 0; i < count; i++) {
      load_round(&sides[i]);
    }
  }
  for (size_t i = 0; i < count; i++) {
    load_free(sides[i].load);
    bench_figure(bench_median_of(sides[i].rate_per_s, ROUNDS), "requests/s", "service.many.%s.rate",
                 sides[i].name);
    report_percentiles(&sides[i], "many", "");
    bench_figure(bench_median_of(sides[i].cpu_us, ROUNDS), "us", "service.many.%s.cpu",
                 sides[i].name);
  }
}

/* ---- scaling ------------------------------------------------------------------------------ */

/* Returns how many requests a second the clients get answered, each in a process of its own. */
static double rate_of_clients(const struct target *target, unsigned clients) {
  double sum = 0, rate;
  pid_t children[SCALE_MOST];
  int ends[2];
  if (pipe(ends) != 0) {
    bench_fail("there is no pipe");
  }
  for (unsigned i = 0; i < clients; i++) {
    children[i] = child_fork(CHILD_ANYWHERE);
    if (children[i] == 0) {
      struct ping ping;
      ping_open(&ping, target);
      ping_run(&ping, WARM_UP_NS, &samples);
      const uint64_t start_ns = bench_now_ns();
      ping_run(&ping, ROUND_NS, &samples);
      rate = (double)samples.count * 1e9 / (double)(bench_now_ns() - start_ns);
      _exit(write(ends[1], &rate, sizeof rate) != sizeof rate);
    }
  }
  close(ends[1]);
  while (read(ends[0], &rate, sizeof rate) == sizeof rate) {
    sum += rate;
  }
  close(ends[0]);
  for (unsigned i = 0; i < clients; i++) {
    child_end(children[i]);
  }
  return sum;
}

static void measure_scale(const struct setting *setting) {
  const long cores = sysconf(_SC_NPROCESSORS_ONLN);
  const unsigned half = cores < 4 ? 1 : (unsigned)cores / 2;
  const unsigned counts[] = {1, half < SCALE_MOST ? half : SCALE_MOST};
  static const char *const names[] = {"one", "all"};
  struct daemon daemons[2];
  struct target targets[] = {setting->bulk, setting->bulk};
  double rates[2][ROUNDS];
  bench_progress("service: scaling");
  child_pin(CHILD_ANYWHERE);
  for (size_t i = 0; i < 2; i++) {
    daemon_start(&daemons[i], CHILD_ANYWHERE, names[i], counts[i]);
    targets[i].address = daemons[i].at_unix;
  }
  for (size_t round = 0; round < ROUNDS; round++) {
    for (size_t i = 0; i < 2; i++) {
      rates[i][round] = rate_of_clients(&targets[i], counts[i]);
    }
  }
  for (size_t i = 0; i < 2; i++) {
    daemon_end(&daemons[i]);
    bench_figure(bench_median_of(rates[i], ROUNDS), "requests/s", "service.scale.%s", names[i]);
  }
  bench_figure(counts[1], "workers", "service.scale.workers");
  bench_figure(bench_median_ratio(rates[1], rates[0], ROUNDS), "times", "ratio.service.scale");
}

/* ---- all of them -------------------------------------------------------------------------- */

static void start_servers(struct setting *setting) {
  target_make_eval(&setting->eval, SMALL_RADII);
  target_make_eval(&setting->bulk, BULK_RADII);
  target_make_echo(&setting->echo, &setting->eval);
  target_make_echo(&setting->bulk_echo, &setting->bulk);
  daemon_start(&setting->daemon, CHILD_SERVER, "dipoled", 1);
  setting->eval.address = setting->bulk.address = setting->daemon.at_unix;
  setting->eval.server = setting->bulk.server = setting->daemon.child;
  setting->echo.address = target_unix(child_path("echo"));
  setting->bulk_echo.address = target_unix(child_path("bulk-echo"));
  echo_start(&setting->echo);
  echo_start(&setting->bulk_echo);
}

void bench_service(void) {
  static struct setting setting;
  child_begin(LIMIT_S);
  start_servers(&setting);
  child_pin(CHILD_CLIENT);
  measure_bulk(&setting.bulk, &setting.bulk_echo, NULL, "bulk");
  measure_bulk_tcp(&setting);
  measure_varying(&setting, CORE_MODEL_BETTER, "varying.better");
  measure_varying(&setting, CORE_MODEL_TRANSPORT, "varying.transport");
  measure_rtt(&setting, "");
  measure_many(&setting);
  child_pin(CHILD_SERVER);
  measure_bulk(&setting.bulk, &setting.bulk_echo, NULL, "bulk.onecore");
  measure_rtt(&setting, ".onecore");
  daemon_end(&setting.daemon);
  measure_scale(&setting);
  child_end_all();
  target_free(&setting.eval);
  target_free(&setting.echo);
  target_free(&setting.bulk);
  target_free(&setting.bulk_echo);
  samples_free(&samples);
}
