/* Compares requests over HTTP with those that cost least, and the binary protocol beside clients of
 * HTTP that do nothing with itself alone. The daemon runs on one core and clients on another
 * (service/child.h). All sides take turns, a fraction of a second each. A figure is the median over
 * the rounds, and a ratio is the median of the ratios of the rounds. Requests are sent over 16
 * connections with one in flight each; the body of each answer is compared with the first.
 *
 *   http.eval.rate                GET /v1/eval of 16 radii of skin1, three channels, better        1/s
 *   http.channel.rate             the same for one medium, in single precision                     1/s
 *   http.health.rate              GET /healthz                                                     1/s
 *   ratio.http.eval               the first over the last
 *   ratio.http.channel            the second over the last
 *   http.beside.<whom>.p50 ...    round trip of a binary eval beside nobody, or beside 1,000 idle
 *                                 connections and 50 that send a byte every 5 ms by turns            us
 *   ratio.http.beside             the 99th percentile beside them over that beside nobody
 */
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "tests/bench/bench.h"
#include "tests/bench/service/child.h"
#include "tests/bench/service/daemon.h"
#include "tests/bench/service/load.h"
#include "tests/bench/service/ping.h"

enum { ROUNDS = 15, LIMIT_S = 120, CONNECTIONS = 16, IDLE = 1000, SLOW = 50, REPLY_MAX = 65536 };
#define MS UINT64_C(1000000)
#define ROUND_NS (200 * MS)
#define WARM_UP_NS (50 * MS)
#define RADII "r=0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,1,1.5,2,3,4,5,6"

static struct samples samples;

/* ---- requests over HTTP ---------------------------------------------------------------------- */

/* Reads an answer of HTTP. Returns its length, and sets *body to where its body begins. */
static size_t read_answer(int fd, char *bytes, size_t *body) {
  size_t count = 0, wanted = REPLY_MAX - 1;
  while (count < wanted) {
    const ssize_t more = recv(fd, bytes + count, wanted - count, 0);
    if (more <= 0) {
      bench_fail("no answer over HTTP");
    }
    count += (size_t)more;
    bytes[count] = '\0';
    const char *end = strstr(bytes, "\r\n\r\n"), *length = strstr(bytes, "Content-Length: ");
    if (end != NULL && length != NULL) {
      *body = (size_t)(end + 4 - bytes);
      wanted = *body + strtoul(length + strlen("Content-Length: "), NULL, 10);
    }
  }
  return count;
}

/* Makes a target of one request, whose answer is the one that it gets now. */
static void make_target(struct target *target, const struct daemon *daemon, const char *name,
                        const char *path) {
  char request[512];
  const int length =
      snprintf(request, sizeof request, "GET %s HTTP/1.1\r\nHost: localhost\r\n\r\n", path);
  *target = (struct target){.name = name,
                            .server = daemon->child,
                            .address = daemon->at_http,
                            .variants = 1,
                            .request_bytes = (size_t)length,
                            .requests = (uint8_t *)strdup(request),
                            .replies = calloc(1, REPLY_MAX),
                            .check_every = 1};
  const int fd = target_connect(&target->address);
  if (target->requests == NULL || target->replies == NULL ||
      send(fd, request, (size_t)length, 0) != length) {
    bench_fail("no request over HTTP");
  }
  target->reply_bytes = read_answer(fd, (char *)target->replies, &target->values_from);
  close(fd);
  if (strncmp((const char *)target->replies, "HTTP/1.1 200", 12) != 0) {
    bench_fail("a request over HTTP was refused");
  }
}

static void measure_rates(const struct daemon *daemon) {
  static const struct {
    const char *name;
    const char *path;
  } requests[] = {
      {"eval", "/v1/eval?model=better&medium=skin1&" RADII},
      {"channel",
       "/v1/eval?model=better&evaluator=f32&wanted=R&sigma_a=0.032&sigma_s=0.74&eta=1.3&" RADII},
      {"health", "/healthz"}};
  enum { SIDES = sizeof requests / sizeof requests[0] };
  struct target targets[SIDES];
  struct load *loads[SIDES];
  double rates_per_s[SIDES][ROUNDS];
  bench_progress("http: requests");
  for (size_t i = 0; i < SIDES; i++) {
    make_target(&targets[i], daemon, requests[i].name, requests[i].path);
    loads[i] = load_new(&targets[i], CONNECTIONS, 1);
    load_closed(loads[i], WARM_UP_NS, &samples);
  }
  for (size_t round = 0; round < ROUNDS; round++) {
    for (size_t i = 0; i < SIDES; i++) {
      rates_per_s[i][round] = load_closed(loads[i], ROUND_NS, &samples);
    }
  }
  for (size_t i = 0; i < SIDES; i++) {
    bench_figure(bench_median_of(rates_per_s[i], ROUNDS), "requests/s", "http.%s.rate",
                 requests[i].name);
    load_free(loads[i]);
    target_free(&targets[i]);
  }
  for (size_t i = 0; i + 1 < SIDES; i++) {
    bench_figure(bench_median_ratio(rates_per_s[i], rates_per_s[SIDES - 1], ROUNDS), "times",
                 "ratio.http.%s", requests[i].name);
  }
}

/* ---- beside clients that do nothing ---------------------------------------------------------- */

/* Sends a byte of an endless header over each slow connection by turns, and opens those anew that
 * the daemon closes. */
static _Noreturn void do_nothing(const struct target_address *address, int ready) {
  static int idle[IDLE], slow[SLOW];
  const struct timespec nap = {.tv_nsec = 5000000};
  for (size_t i = 0; i < IDLE; i++) {
    idle[i] = target_connect(address);
  }
  for (size_t i = 0; i < SLOW; i++) {
    slow[i] = target_connect(address);
  }
  if (write(ready, "", 1) != 1) {
    _exit(EXIT_FAILURE);
  }
  for (size_t turn = 0;; turn++) {
    int *fd = &slow[turn % SLOW], *other = &idle[turn % IDLE];
    if (send(*fd, "G", 1, MSG_NOSIGNAL) != 1) {
      close(*fd);
      *fd = target_connect(address);
    }
    struct pollfd closed = {.fd = *other, .events = POLLIN};
    if (poll(&closed, 1, 0) == 1) {
      close(*other);
      *other = target_connect(address);
    }
    nanosleep(&nap, NULL);
  }
}

static pid_t start_nothing(const struct target_address *address) {
  int ready[2];
  char byte;
  if (pipe(ready) != 0) {
    bench_fail("no pipe");
  }
  const pid_t child = child_fork(CHILD_CLIENT);
  if (child == 0) {
    do_nothing(address, ready[1]);
  }
  if (read(ready[0], &byte, 1) != 1) {
    bench_fail("the idle clients have ended");
  }
  close(ready[0]);
  close(ready[1]);
  return child;
}

struct side {
  const char *name;
  double p50_us[ROUNDS];
  double p99_us[ROUNDS];
};

static void ping_round(struct ping *ping, struct side *side, size_t round) {
  ping_run(ping, ROUND_NS, &samples);
  side->p50_us[round] = samples_us(&samples, 0.5);
  side->p99_us[round] = samples_us(&samples, 0.99);
}

static void measure_beside(const struct daemon *daemon) {
  struct side sides[] = {{.name = "nobody"}, {.name = "idle"}};
  struct target eval;
  struct ping ping;
  bench_progress("http: beside idle clients");
  target_make_eval(&eval, 16);
  eval.name = "dipoled";
  eval.server = daemon->child;
  eval.address = daemon->at_tcp;
  ping_open(&ping, &eval);
  ping_run(&ping, WARM_UP_NS, &samples);
  for (size_t round = 0; round < ROUNDS; round++) {
    ping_round(&ping, &sides[0], round);
    const pid_t idle = start_nothing(&daemon->at_http);
    ping_run(&ping, WARM_UP_NS, &samples);
    ping_round(&ping, &sides[1], round);
    child_must_run(idle, "the idle clients");
    child_end(idle);
    ping_run(&ping, WARM_UP_NS, &samples);
  }
  ping_close(&ping);
  target_free(&eval);
  for (size_t i = 0; i < 2; i++) {
    bench_figure(bench_median_of(sides[i].p50_us, ROUNDS), "us", "http.beside.%s.p50",
                 sides[i].name);
    bench_figure(bench_median_of(sides[i].p99_us, ROUNDS), "us", "http.beside.%s.p99",
                 sides[i].name);
  }
  bench_figure(bench_median_ratio(sides[1].p99_us, sides[0].p99_us, ROUNDS), "times",
               "ratio.http.beside");
}

void bench_http(void) {
  struct daemon daemon;
  child_begin(LIMIT_S);
  daemon_start(&daemon, CHILD_SERVER, "dipoled", 1);
  child_pin(CHILD_CLIENT);
  measure_rates(&daemon);
  measure_beside(&daemon);
  daemon_end(&daemon);
  child_end_all();
  samples_free(&samples);
}
