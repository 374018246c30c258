/* Compares dipoled as a service with an echo server, a process that knows its reply beforehand.
 * Servers run on the first core and the client on the last one. dipoled has one worker, because it
 * has one core. Sides take turns, a fraction of a second each. A figure is the median over the
 * rounds, a ratio the median of the rounds' ratios. Requests evaluate R by the better dipole in single
 * precision at listed radii, over a Unix socket. Each reply is compared with the first one, whose
 * values are compared with those of the kernel in this process; of large replies, every 16th.
 *
 *   service.bulk.<side>.p50        round trip of 65,536 radii, one at a time                   us
 *   service.bulk.kernel            the evaluation alone, in this process                       us
 *   ratio.service.bulk             dipoled over the sum of echo and kernel
 *   service.rtt.<side>.p50         round trip of 16 radii, one at a time                       us
 *   ratio.service.rtt              dipoled over echo
 *   ratio.service.<...>.epoll      an echo server that asks epoll for each request, over one that
 *                                  does not: the least that a server of many connections can have
 *
 * bulk and rtt are also measured with the client on the servers' core: names with .onecore. No two
 * processes then run at the same time, and no core has to be woken. These figures show the work,
 * that of the client included, and hardly depend on what else the machine does.
 */
#include <limits.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "proto/eval.h"
#include "tests/bench/bench.h"

enum {
  SMALL_RADII = 16,
  BULK_RADII = 65536,
  ROUNDS = 15,
  SAMPLES_MOST = 1 << 17,
  CHECK_LARGE_EVERY = 16, /* because a comparison takes a good part of the measured time */
  SILENCE_S = 10,
};
#define MS UINT64_C(1000000)
#define ROUND_NS (150 * MS)
#define WARM_UP_NS (20 * MS)

/* What is sent and what comes back. */
struct exchange {
  float *r, *R; /* [radius_count]: what is asked for, and what the kernel says */
  size_t radius_count, request_bytes, reply_bytes;
  uint8_t *request, *reply, *received;
};

struct side {
  const char *name;
  int fd;
  double p50_us[ROUNDS];
};

static core_profile profile; /* of what is asked for */
static double samples_us[SAMPLES_MOST];
static cpu_set_t cores; /* that this program was started on */
static char folder[] = "/tmp/dipoled-bench-XXXXXX";

/* ---- processes ---------------------------------------------------------------------------- */

enum place { FIRST_CORE, LAST_CORE };

static void pin(enum place place) {
  cpu_set_t one;
  int core = place == LAST_CORE ? CPU_SETSIZE - 1 : 0;
  while (!CPU_ISSET(core, &cores)) {
    core += place == LAST_CORE ? -1 : 1;
  }
  CPU_ZERO(&one);
  CPU_SET(core, &one);
  if (sched_setaffinity(0, sizeof one, &one) != 0) {
    bench_fail("cannot be pinned to a core");
  }
}

/* Like fork(). The child ends with this process at the latest. */
static pid_t fork_child(enum place place) {
  const pid_t child = fork();
  if (child < 0) {
    bench_fail("cannot start a process");
  }
  if (child == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    pin(place);
  }
  return child;
}

static void end_child(pid_t child) {
  kill(child, SIGTERM);
  waitpid(child, NULL, 0);
}

static struct sockaddr_un daemon_address(void) {
  struct sockaddr_un address = {.sun_family = AF_UNIX};
  snprintf(address.sun_path, sizeof address.sun_path, "%s/s", folder);
  return address;
}

/* Starts the dipoled beside this program. Its socket is in the temporary folder. */
static pid_t start_daemon(void) {
  char program[PATH_MAX] = "", listen[PATH_MAX];
  if (readlink("/proc/self/exe", program, sizeof program - 16) < 0) {
    bench_fail("cannot tell where this program is");
  }
  strcpy(strrchr(program, '/') + 1, "dipoled");
  snprintf(listen, sizeof listen, "unix:%s", daemon_address().sun_path);
  const pid_t child = fork_child(FIRST_CORE);
  if (child == 0) {
    char *arguments[] = {program, "--listen", listen, "--workers", "1", NULL};
    char *environment[] = {NULL}; /* variables are options of dipoled */
    if (freopen("/dev/null", "w", stderr) != NULL) {
      execve(program, arguments, environment);
    }
    _exit(EXIT_FAILURE);
  }
  return child;
}

/* Returns a socket whose reads and writes fail when the peer is silent. */
static int with_limit(int fd) {
  const struct timeval silence = {.tv_sec = SILENCE_S};
  if (setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &silence, sizeof silence) != 0 ||
      setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &silence, sizeof silence) != 0) {
    bench_fail("cannot limit a socket");
  }
  return fd;
}

static int connect_to(pid_t server) {
  const struct sockaddr_un address = daemon_address();
  const struct timespec nap = {.tv_nsec = 1000000};
  const int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const uint64_t end_ns = bench_now_ns() + SILENCE_S * 1000 * MS;
  while (connect(fd, (const struct sockaddr *)&address, sizeof address) != 0) {
    if (waitpid(server, NULL, WNOHANG) != 0 || bench_now_ns() > end_ns) {
      bench_fail("dipoled does not get ready; `make` builds it beside this program");
    }
    nanosleep(&nap, NULL);
  }
  return with_limit(fd);
}

/* ---- requests ----------------------------------------------------------------------------- */

/* Returns whether all bytes could be written, or read. */
static bool send_all(int fd, const uint8_t *bytes, size_t count) {
  for (ssize_t sent; count > 0; bytes += sent, count -= (size_t)sent) {
    sent = write(fd, bytes, count);
    if (sent <= 0) {
      return false;
    }
  }
  return true;
}

static bool receive_all(int fd, uint8_t *bytes, size_t count) {
  for (ssize_t got; count > 0; bytes += got, count -= (size_t)got) {
    got = read(fd, bytes, count);
    if (got <= 0) {
      return false;
    }
  }
  return true;
}

static void send_request(int fd, const struct exchange *exchange) {
  if (!send_all(fd, exchange->request, exchange->request_bytes)) {
    bench_fail("a server does not take a request");
  }
}

/* Asks the daemon for the first reply. */
static struct exchange make_exchange(size_t radius_count, int fd) {
  const core_medium *medium = &core_measured_medium_by_name("skin1")->channel[0];
  const size_t bytes = radius_count * sizeof(float);
  eval_layout layout;
  if (!eval_reply_layout(CORE_EVALUATOR_F32, CORE_QUANTITY_R, 1, radius_count, UINT32_MAX,
                         &layout)) {
    bench_fail("too many radii");
  }
  struct exchange exchange = {
      .radius_count = radius_count,
      .request_bytes = WIRE_BYTES_header + WIRE_BYTES_eval_request + WIRE_BYTES_medium + bytes,
      .reply_bytes = WIRE_BYTES_header + (size_t)layout.payload_bytes,
      .r = malloc(bytes),
      .R = malloc(bytes),
  };
  exchange.request = malloc(exchange.request_bytes);
  exchange.reply = malloc(exchange.reply_bytes);
  exchange.received = malloc(exchange.reply_bytes);
  if (exchange.r == NULL || exchange.R == NULL || exchange.request == NULL ||
      exchange.reply == NULL || exchange.received == NULL) {
    bench_fail("out of memory");
  }
  const wire_header header = {
      .magic = WIRE_MAGIC,
      .version = WIRE_VERSION,
      .type = WIRE_TYPE_EVAL,
      .payload_bytes = (uint32_t)(exchange.request_bytes - WIRE_BYTES_header),
  };
  const wire_eval_request fixed = {
      .model = CORE_MODEL_BETTER,
      .evaluator = CORE_EVALUATOR_F32,
      .moments = CORE_MOMENTS_EXACT,
      .wanted = CORE_QUANTITY_R,
      .medium_count = 1,
      .layer_count = 1,
      .spacing = CORE_SPACING_LIST,
      .radius_count = radius_count,
  };
  const wire_medium layer = {medium->sigma_a_per_mm, medium->sigma_s_per_mm, medium->g,
                             medium->eta};
  bench_fill_radii(sizeof *exchange.r, exchange.r, radius_count);
  wire_put_header(exchange.request, &header);
  wire_put_eval_request(exchange.request + WIRE_BYTES_header, &fixed);
  wire_put_medium(exchange.request + WIRE_BYTES_header + WIRE_BYTES_eval_request, &layer);
  memcpy(exchange.request + exchange.request_bytes - bytes, exchange.r, bytes);
  core_eval_f32(&profile, CORE_QUANTITY_R, radius_count, exchange.r, exchange.R);
  send_request(fd, &exchange);
  if (!receive_all(fd, exchange.reply, exchange.reply_bytes) ||
      memcmp(exchange.reply + WIRE_BYTES_header + layout.arrays_offset, exchange.R, bytes) != 0) {
    bench_fail("the daemon does not reply with the kernel's values");
  }
  return exchange;
}

static void free_exchange(const struct exchange *exchange) {
  free(exchange->r);
  free(exchange->R);
  free(exchange->request);
  free(exchange->reply);
  free(exchange->received);
}

/* ---- sides -------------------------------------------------------------------------------- */

/* Starts the echo server. With `waits` it asks epoll for each request, as an event loop does. Returns
 * the client's end of its connection. */
static int start_echo(pid_t *server, const struct exchange *exchange, bool waits) {
  int ends[2];
  if (socketpair(AF_UNIX, SOCK_STREAM, 0, ends) != 0) {
    bench_fail("there is no pair of sockets");
  }
  *server = fork_child(FIRST_CORE);
  if (*server == 0) {
    const int epoll = epoll_create1(0);
    struct epoll_event event = {.events = EPOLLIN};
    epoll_ctl(epoll, EPOLL_CTL_ADD, ends[1], &event);
    while ((!waits || epoll_wait(epoll, &event, 1, -1) == 1) &&
           receive_all(ends[1], exchange->received, exchange->request_bytes) &&
           send_all(ends[1], exchange->reply, exchange->reply_bytes)) {
    }
    _exit(EXIT_FAILURE);
  }
  close(ends[1]);
  return with_limit(ends[0]);
}

/* Sends one request after the other. Returns how many: samples_us[] has their times. */
static size_t ping(int fd, const struct exchange *exchange, uint64_t duration_ns) {
  const size_t check_every = exchange->radius_count > SMALL_RADII ? CHECK_LARGE_EVERY : 1;
  const uint64_t end_ns = bench_now_ns() + duration_ns;
  size_t count = 0;
  do {
    const uint64_t start_ns = bench_now_ns();
    send_request(fd, exchange);
    if (!receive_all(fd, exchange->received, exchange->reply_bytes)) {
      bench_fail("a server does not reply");
    }
    samples_us[count++] = (double)(bench_now_ns() - start_ns) * 1e-3;
    if (count % check_every == 0 &&
        memcmp(exchange->received, exchange->reply, exchange->reply_bytes) != 0) {
      bench_fail("a reply is another than the first one");
    }
  } while (count < SAMPLES_MOST && bench_now_ns() < end_ns);
  return count;
}

/* ---- measurements ------------------------------------------------------------------------- */

static double kernel_us(const struct exchange *exchange) {
  const uint64_t end_ns = bench_now_ns() + WARM_UP_NS;
  size_t count = 0;
  do {
    const uint64_t start_ns = bench_now_ns();
    core_eval_f32(&profile, CORE_QUANTITY_R, exchange->radius_count, exchange->r, exchange->R);
    samples_us[count++] = (double)(bench_now_ns() - start_ns) * 1e-3;
  } while (count < SAMPLES_MOST && bench_now_ns() < end_ns);
  return bench_median(samples_us, count);
}

/* Round trips. The ratio's base is echo, with the kernel's time if with_kernel. */
static void measure_pings(const struct exchange *exchange, pid_t server, bool with_kernel,
                          const char *name) {
  enum { DIPOLED, ECHO, WAITING_ECHO, SIDES };
  pid_t echo, waiting_echo;
  struct side sides[SIDES] = {{.name = "dipoled", .fd = connect_to(server)},
                              {.name = "echo", .fd = start_echo(&echo, exchange, false)},
                              {.name = "epoll", .fd = start_echo(&waiting_echo, exchange, true)}};
  double kernels_us[ROUNDS] = {0}, floor_us[ROUNDS];
  bench_progress(name);
  for (size_t i = 0; i < SIDES; i++) {
    ping(sides[i].fd, exchange, WARM_UP_NS);
  }
  for (size_t round = 0; round < ROUNDS; round++) {
    for (size_t i = 0; i < SIDES; i++) {
      const size_t count = ping(sides[i].fd, exchange, ROUND_NS);
      sides[i].p50_us[round] = bench_median(samples_us, count);
    }
    kernels_us[round] = with_kernel ? kernel_us(exchange) : 0;
    floor_us[round] = sides[ECHO].p50_us[round] + kernels_us[round];
  }
  end_child(echo);
  end_child(waiting_echo);
  for (size_t i = 0; i < SIDES; i++) {
    close(sides[i].fd);
    bench_figure(bench_median_of(sides[i].p50_us, ROUNDS), "us", "service.%s.%s.p50", name,
                 sides[i].name);
  }
  if (with_kernel) {
    bench_figure(bench_median_of(kernels_us, ROUNDS), "us", "service.%s.kernel", name);
  }
  bench_figure(bench_median_ratio(sides[DIPOLED].p50_us, floor_us, ROUNDS), "times",
               "ratio.service.%s", name);
  bench_figure(bench_median_ratio(sides[WAITING_ECHO].p50_us, sides[ECHO].p50_us, ROUNDS), "times",
               "ratio.service.%s.epoll", name);
}

void bench_service(void) {
  signal(SIGPIPE, SIG_IGN);
  if (sched_getaffinity(0, sizeof cores, &cores) != 0 || mkdtemp(folder) == NULL) {
    bench_fail("cannot find the cores, or make a folder in /tmp");
  }
  profile = bench_profile(core_isa_select(NULL), CORE_MODEL_BETTER, CORE_EVALUATOR_F32);
  const pid_t server = start_daemon();
  const int fd = connect_to(server);
  const struct exchange bulk = make_exchange(BULK_RADII, fd);
  const struct exchange small = make_exchange(SMALL_RADII, fd);
  close(fd);
  pin(LAST_CORE);
  measure_pings(&bulk, server, true, "bulk");
  measure_pings(&small, server, false, "rtt");
  pin(FIRST_CORE);
  measure_pings(&bulk, server, true, "bulk.onecore");
  measure_pings(&small, server, false, "rtt.onecore");
  end_child(server);
  rmdir(folder);
  free_exchange(&bulk);
  free_exchange(&small);
  core_profile_free(&profile);
}
