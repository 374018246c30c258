/* Compares dipoled as a service with a peer that does less for as many bytes: an echo server, which
 * knows its reply beforehand, GET /healthz, or redis-server. Servers run on the first core and the
 * client on the last one. dipoled has one worker, because it has one core. Sides take turns, a
 * fraction of a second each. A figure is the median over the rounds, a ratio the median of the rounds'
 * ratios. Requests evaluate R by the better dipole. Each reply is compared with the first one, whose
 * values are compared with those of the kernel in this process (but for HTTP); of large replies,
 * every 16th.
 *
 *   service.bulk.<side>.p50        round trip of 65,536 radii, one at a time                   us
 *   service.bulk.kernel            the evaluation alone, in this process                       us
 *   ratio.service.bulk             dipoled over the sum of echo and kernel
 *   service.rtt.<side>.p50         round trip of 16 radii, one at a time                       us
 *   ratio.service.rtt              dipoled over echo
 *   tls.<...>, ratio.tls.<...>     the same through TLS over TCP, beside an echo through TLS
 *   modbus.rw.<side>.rate          function 23 writes a job of 16 radii and reads 16 values     1/s
 *   ratio.modbus.rw                dipoled over an echo server that waits with epoll
 *   http.eval.<side>.rate          GET /v1/eval of 16 radii, three media, and GET /healthz     1/s
 *   redis.requests.<side>.rate     requests of 16 radii, 16 in one write, and GET of redis     1/s
 *
 * A rate is that of 32 connections, each of which has one request under way, or one batch of them.
 * Each side also has .cpu: the processor time that the server takes for a reply, in us, whose ratio is
 * ratio.<...>.cpu. It hardly depends on what else the machine does, nor on the client.
 *
 * service.bulk and .rtt are also measured with the client on the servers' core: names with .onecore.
 * No two processes then run at the same time, and no core has to be woken. These figures show the
 * work, that of the client included, and hardly depend on what else the machine does.
 */
#include <limits.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <openssl/ssl.h>
#include <poll.h>
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

#include "proto/wire.h"
#include "tests/bench/bench.h"

enum {
  SMALL_RADII = 16,
  BULK_RADII = 65536,
  CONNECTIONS = 32,
  BATCH = 16,
  ROUNDS = 15,
  SAMPLES_MOST = 1 << 17,
  CHECK_LARGE_EVERY = 16, /* because a comparison takes a good part of the measured time */
  SILENCE_S = 10,
  LAST_BYTE_MS = 200, /* after such a silence, the first reply is whole */
  REPLY_MOST = 1 << 20,
};
#define MS UINT64_C(1000000)
#define ROUND_NS (150 * MS)
#define WARM_UP_NS (20 * MS)

/* What is sent and what comes back. */
struct exchange {
  size_t requests; /* how many these are */
  size_t request_bytes, reply_bytes;
  size_t same_from; /* where the bytes begin that are the same in each reply */
  uint8_t *request, *reply;
};

struct address {
  union {
    struct sockaddr any;
    struct sockaddr_un local;
    struct sockaddr_in tcp;
  };
  socklen_t bytes;
};

struct server {
  pid_t pid;
  struct address address;
  SSL_CTX *tls; /* what clients need; NULL: plain */
};

/* A connection. */
struct link {
  int fd;
  SSL *ssl; /* NULL: plain */
  uint8_t *received;
};

struct side {
  const char *name;
  pid_t pid; /* the server's */
  const struct exchange *exchange;
  struct link links[CONNECTIONS];
  size_t link_count;
  int epoll;
  size_t replies; /* that the last run has got */
  double figures[ROUNDS], cpu_us[ROUNDS];
};

static const core_medium medium = {0.03125, 0.75, 0, 1.25, 0}; /* exact in single precision */
static core_profile profile;
static float r[BULK_RADII], R[BULK_RADII]; /* what is asked for, and what the kernel says */
static double samples_us[SAMPLES_MOST];
static cpu_set_t cores; /* that this program was started on */
static char folder[32], certificate[64], key[64];

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
  bench_fail_if(sched_setaffinity(0, sizeof one, &one) != 0, "cannot be pinned to a core");
}

/* Like fork(). The child ends with this process at the latest. */
static pid_t fork_child(enum place place) {
  const pid_t child = fork();
  bench_fail_if(child < 0, "cannot start a process");
  if (child == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    pin(place);
  }
  return child;
}

/* Starts a silent program, with no variables, which are options of dipoled. */
static pid_t start_program(char *arguments[]) {
  const pid_t child = fork_child(FIRST_CORE);
  if (child == 0) {
    char *environment[] = {NULL};
    if (freopen("/dev/null", "w", stdout) != NULL && freopen("/dev/null", "w", stderr) != NULL) {
      execvpe(arguments[0], arguments, environment);
    }
    _exit(EXIT_FAILURE);
  }
  return child;
}

static void end_child(pid_t child) {
  kill(child, SIGTERM);
  waitpid(child, NULL, 0);
}

/* ---- connections -------------------------------------------------------------------------- */

static struct address at_path(const char *name) {
  struct address address = {.local.sun_family = AF_UNIX, .bytes = sizeof address.local};
  snprintf(address.local.sun_path, sizeof address.local.sun_path, "%s/%s", folder, name);
  return address;
}

static struct address at_any_port(void) {
  const struct in_addr here = {htonl(INADDR_LOOPBACK)};
  return (struct address){.tcp = {AF_INET, 0, here, ""}, .bytes = sizeof(struct sockaddr_in)};
}

/* Returns a socket that listens. Sets the address's port if it has none. */
static int listen_at(struct address *address) {
  const int fd = socket(address->any.sa_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (address->any.sa_family == AF_UNIX) {
    unlink(address->local.sun_path); /* of an earlier server */
  }
  bench_fail_if(bind(fd, &address->any, address->bytes) != 0 || listen(fd, CONNECTIONS) != 0 ||
                    getsockname(fd, &address->any, &address->bytes) != 0,
                "cannot listen");
  return fd;
}

/* Makes a connection whose reads and writes fail when the peer is silent. shake_hands: by TLS, with
 * a context. */
static struct link make_link(int fd, SSL_CTX *context, int (*shake_hands)(SSL *)) {
  const struct timeval silence = {.tv_sec = SILENCE_S};
  const int on = 1;
  struct link link = {.fd = fd, .received = bench_allocate(REPLY_MOST)};
  setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on); /* fails for others than TCP */
  bench_fail_if(setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &silence, sizeof silence) != 0 ||
                    setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &silence, sizeof silence) != 0,
                "cannot limit a socket");
  if (context != NULL) {
    link.ssl = SSL_new(context);
    bench_fail_if(link.ssl == NULL || SSL_set_fd(link.ssl, fd) != 1 || shake_hands(link.ssl) != 1,
                  "no handshake");
  }
  return link;
}

static struct link connect_to(const struct server *server) {
  const struct address *address = &server->address;
  const struct timespec nap = {.tv_nsec = 1000000};
  const int fd = socket(address->any.sa_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const uint64_t end_ns = bench_now_ns() + SILENCE_S * 1000 * MS;
  while (connect(fd, &address->any, address->bytes) != 0) {
    bench_fail_if(waitpid(server->pid, NULL, WNOHANG) != 0 || bench_now_ns() > end_ns,
                  "a server does not get ready; `make` builds dipoled beside this program");
    nanosleep(&nap, NULL);
  }
  return make_link(fd, server->tls, SSL_connect);
}

static void close_link(const struct link *link) {
  SSL_free(link->ssl);
  close(link->fd);
  free(link->received);
}

static ssize_t read_some(const struct link *link, uint8_t *bytes, size_t count) {
  return link->ssl != NULL ? SSL_read(link->ssl, bytes, (int)count) : read(link->fd, bytes, count);
}

/* Returns whether all bytes could be written, or read. */
static bool send_all(const struct link *link, const uint8_t *bytes, size_t count) {
  for (ssize_t sent; count > 0; bytes += sent, count -= (size_t)sent) {
    sent =
        link->ssl != NULL ? SSL_write(link->ssl, bytes, (int)count) : write(link->fd, bytes, count);
    if (sent <= 0) {
      return false;
    }
  }
  return true;
}

static bool receive_all(const struct link *link, uint8_t *bytes, size_t count) {
  for (ssize_t got; count > 0; bytes += got, count -= (size_t)got) {
    got = read_some(link, bytes, count);
    if (got <= 0) {
      return false;
    }
  }
  return true;
}

/* ---- requests ----------------------------------------------------------------------------- */

static void send_request(const struct link *link, const struct exchange *exchange) {
  bench_fail_if(!send_all(link, exchange->request, exchange->request_bytes),
                "a server does not take a request");
}

/* Asks a server for the first reply, which ends with `end` if that is given. */
static struct exchange first_exchange(const struct server *server, const void *request,
                                      size_t request_bytes, const void *end, size_t end_bytes) {
  struct exchange exchange = {.requests = 1,
                              .request_bytes = request_bytes,
                              .request = bench_allocate(request_bytes),
                              .reply = bench_allocate(REPLY_MOST)};
  const struct link link = connect_to(server);
  struct pollfd readable = {.fd = link.fd, .events = POLLIN};
  memcpy(exchange.request, request, request_bytes);
  send_request(&link, &exchange);
  while (poll(&readable, 1, exchange.reply_bytes > 0 ? LAST_BYTE_MS : SILENCE_S * 1000) == 1) {
    const ssize_t got =
        read_some(&link, exchange.reply + exchange.reply_bytes, REPLY_MOST - exchange.reply_bytes);
    bench_fail_if(got <= 0, "a server does not reply");
    exchange.reply_bytes += (size_t)got;
  }
  bench_fail_if(exchange.reply_bytes < end_bytes ||
                    memcmp(exchange.reply + exchange.reply_bytes - end_bytes, end, end_bytes) != 0,
                "a server does not reply with the right values");
  close_link(&link);
  return exchange;
}

static struct exchange make_eval(const struct server *server, size_t radius_count) {
  const size_t bytes = radius_count * sizeof(float);
  const size_t request_bytes =
      WIRE_BYTES_header + WIRE_BYTES_eval_request + WIRE_BYTES_medium + bytes;
  uint8_t *request = bench_allocate(request_bytes);
  const wire_header header = {
      .magic = WIRE_MAGIC,
      .version = WIRE_VERSION,
      .type = WIRE_TYPE_EVAL,
      .payload_bytes = (uint32_t)(request_bytes - WIRE_BYTES_header),
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
  const wire_medium layer = {medium.sigma_a_per_mm, medium.sigma_s_per_mm, medium.g, medium.eta};
  bench_fill_radii(sizeof *r, r, radius_count);
  wire_put_header(request, &header);
  wire_put_eval_request(request + WIRE_BYTES_header, &fixed);
  wire_put_medium(request + WIRE_BYTES_header + WIRE_BYTES_eval_request, &layer);
  memcpy(request + request_bytes - bytes, r, bytes);
  core_eval_f32(&profile, CORE_QUANTITY_R, radius_count, r, R);
  const struct exchange exchange = first_exchange(server, request, request_bytes, R, bytes);
  free(request);
  return exchange;
}

static uint8_t *put_words(uint8_t *at, size_t count, const uint16_t *words) {
  for (size_t i = 0; i < count; i++) {
    *at++ = (uint8_t)(words[i] >> 8);
    *at++ = (uint8_t)words[i];
  }
  return at;
}

static uint8_t *put_floats(uint8_t *at, size_t count, const float *values) {
  for (size_t i = 0; i < count; i++) {
    uint32_t bits;
    memcpy(&bits, &values[i], sizeof bits);
    at = put_words(at, 2, (const uint16_t[]){(uint16_t)(bits >> 16), (uint16_t)bits});
  }
  return at;
}

/* Function 23 writes a job of 16 radii from register 100 on, and reads its values up to register 343;
 * proto/REGISTERS.md has an example. */
static struct exchange make_read_write(const struct server *server) {
  enum { WRITTEN = 20 + 2 * SMALL_RADII, READ = 12 + 2 * SMALL_RADII, LENGTH = 11 + 2 * WRITTEN };
  const float layer[] = {0, (float)medium.sigma_a_per_mm, (float)medium.sigma_s_per_mm,
                         (float)medium.g, (float)medium.eta}; /* the tolerance stands before */
  const uint16_t head[] = {1, 0, LENGTH, 1 << 8 | 23, 300, READ, 100, WRITTEN};
  const uint16_t job[] = {1, CORE_MODEL_BETTER, CORE_EVALUATOR_F32, CORE_MOMENTS_EXACT};
  uint8_t request[6 + LENGTH], values[SMALL_RADII * sizeof *R], *at = put_words(request, 8, head);
  bench_fill_radii(sizeof *r, r, SMALL_RADII);
  *at++ = 2 * WRITTEN;
  at = put_floats(put_words(at, 4, job), 5, layer);
  at = put_words(at, 2, (const uint16_t[]){CORE_SPACING_LIST, SMALL_RADII});
  put_floats(put_floats(at, 2, (const float[]){0, 0}), SMALL_RADII, r);
  core_eval_f32(&profile, CORE_QUANTITY_R, SMALL_RADII, r, R);
  put_floats(values, SMALL_RADII, R);
  struct exchange exchange = first_exchange(server, request, sizeof request, values, sizeof values);
  exchange.same_from = exchange.reply_bytes - sizeof values; /* the sequence counts */
  return exchange;
}

static struct exchange make_get(const struct server *server, const char *path) {
  char request[512];
  snprintf(request, sizeof request, "GET %s HTTP/1.1\r\nHost: localhost\r\n\r\n", path);
  struct exchange exchange = first_exchange(server, request, strlen(request), "", 0);
  exchange.reply[exchange.reply_bytes] = '\0';
  const char *reply = (const char *)exchange.reply, *body = strstr(reply, "\r\n\r\n");
  bench_fail_if(strncmp(reply, "HTTP/1.1 200", 12) != 0 || body == NULL,
                "a request over HTTP was refused");
  exchange.same_from = (size_t)(body - reply); /* the time stands before */
  return exchange;
}

/* Repeats requests, which are then sent together. */
static void repeat(struct exchange *exchange, size_t times) {
  const size_t request_bytes = exchange->request_bytes, reply_bytes = exchange->reply_bytes;
  exchange->request = realloc(exchange->request, times * request_bytes);
  bench_fail_if(exchange->request == NULL || times * reply_bytes > REPLY_MOST, "out of memory");
  for (size_t i = 1; i < times; i++) {
    memcpy(exchange->request + i * request_bytes, exchange->request, request_bytes);
    memcpy(exchange->reply + i * reply_bytes, exchange->reply, reply_bytes);
  }
  exchange->requests = times;
  exchange->request_bytes = times * request_bytes;
  exchange->reply_bytes = times * reply_bytes;
}

static void free_exchange(const struct exchange *exchange) {
  free(exchange->request);
  free(exchange->reply);
}

/* ---- sides -------------------------------------------------------------------------------- */

static struct side open_side(const char *name, const struct server *server,
                             const struct exchange *exchange, size_t link_count) {
  struct side side = {.name = name,
                      .pid = server->pid,
                      .exchange = exchange,
                      .link_count = link_count,
                      .epoll = epoll_create1(EPOLL_CLOEXEC)};
  for (size_t i = 0; i < link_count; i++) {
    side.links[i] = connect_to(server);
    struct epoll_event event = {.events = EPOLLIN, .data.u64 = i};
    epoll_ctl(side.epoll, EPOLL_CTL_ADD, side.links[i].fd, &event);
  }
  return side;
}

static void close_side(const struct side *side) {
  for (size_t i = 0; i < side->link_count; i++) {
    close_link(&side->links[i]);
  }
  close(side->epoll);
}

/* Waits with epoll only if there are several connections. */
static _Noreturn void echo(int listener, const struct exchange *exchange, size_t link_count,
                           SSL_CTX *context) {
  struct link links[CONNECTIONS];
  struct epoll_event events[CONNECTIONS] = {{.data.u64 = 0}};
  const int epoll = epoll_create1(0);
  for (size_t i = 0; i < link_count; i++) {
    links[i] = make_link(accept(listener, NULL, NULL), context, SSL_accept);
    struct epoll_event event = {.events = EPOLLIN, .data.u64 = i};
    epoll_ctl(epoll, EPOLL_CTL_ADD, links[i].fd, &event);
  }
  for (;;) {
    const int ready = link_count > 1 ? epoll_wait(epoll, events, CONNECTIONS, -1) : 1;
    for (int i = 0; i < ready; i++) {
      const struct link *link = &links[events[i].data.u64];
      if (!receive_all(link, link->received, exchange->request_bytes) ||
          !send_all(link, exchange->reply, exchange->reply_bytes)) {
        _exit(EXIT_FAILURE);
      }
    }
  }
}

/* Starts an echo server and connects to it. tls: contexts of client and server, or NULL twice. */
static struct side open_echo(struct address address, const struct exchange *exchange,
                             size_t link_count, SSL_CTX *const tls[2]) {
  const int listener = listen_at(&address);
  const struct server server = {fork_child(FIRST_CORE), address, tls[0]};
  if (server.pid == 0) {
    echo(listener, exchange, link_count, tls[1]);
  }
  close(listener);
  return open_side("echo", &server, exchange, link_count);
}

/* checks: whether it compares the reply with the first one. */
static void receive_reply(const struct link *link, const struct exchange *exchange, bool checks) {
  bench_fail_if(!receive_all(link, link->received, exchange->reply_bytes),
                "a server does not reply");
  if (checks && memcmp(link->received + exchange->same_from, exchange->reply + exchange->same_from,
                       exchange->reply_bytes - exchange->same_from) != 0) {
    bench_fail("a reply is another than the first one");
  }
}

/* Sends one request after the other. Returns the median of their times in us. */
static double ping(struct side *side, uint64_t duration_ns) {
  const struct exchange *exchange = side->exchange;
  const size_t check_every = exchange->reply_bytes > BULK_RADII ? CHECK_LARGE_EVERY : 1;
  const uint64_t end_ns = bench_now_ns() + duration_ns;
  size_t count = 0;
  do {
    const uint64_t start_ns = bench_now_ns();
    send_request(&side->links[0], exchange);
    receive_reply(&side->links[0], exchange, count % check_every == 0);
    samples_us[count++] = (double)(bench_now_ns() - start_ns) * 1e-3;
  } while (count < SAMPLES_MOST && bench_now_ns() < end_ns);
  side->replies = count;
  return bench_median(samples_us, count);
}

/* Has a request under way on each connection. Returns how many are answered per second. */
static double load(struct side *side, uint64_t duration_ns) {
  const uint64_t start_ns = bench_now_ns();
  size_t under_way = side->link_count;
  side->replies = 0;
  for (size_t i = 0; i < side->link_count; i++) {
    send_request(&side->links[i], side->exchange);
  }
  while (under_way > 0) {
    struct epoll_event events[CONNECTIONS];
    const int ready = epoll_wait(side->epoll, events, CONNECTIONS, SILENCE_S * 1000);
    const bool goes_on = bench_now_ns() < start_ns + duration_ns;
    bench_fail_if(ready <= 0, "a server does not reply");
    for (int i = 0; i < ready; i++) {
      const struct link *link = &side->links[events[i].data.u64];
      receive_reply(link, side->exchange, true);
      side->replies += side->exchange->requests;
      if (goes_on) {
        send_request(link, side->exchange);
      } else {
        under_way--;
      }
    }
  }
  return (double)side->replies * 1e9 / (double)(bench_now_ns() - start_ns);
}

/* ---- measurements ------------------------------------------------------------------------- */

static double kernel_us(void) {
  const uint64_t end_ns = bench_now_ns() + WARM_UP_NS;
  size_t count = 0;
  do {
    const uint64_t start_ns = bench_now_ns();
    core_eval_f32(&profile, CORE_QUANTITY_R, BULK_RADII, r, R);
    samples_us[count++] = (double)(bench_now_ns() - start_ns) * 1e-3;
  } while (count < SAMPLES_MOST && bench_now_ns() < end_ns);
  return bench_median(samples_us, count);
}

/* Returns the processor time that a server has taken, in us. */
static double cpu_us(pid_t server) {
  clockid_t clock;
  struct timespec taken;
  bench_fail_if(clock_getcpuclockid(server, &clock) != 0 || clock_gettime(clock, &taken) != 0,
                "a server has ended");
  return (double)taken.tv_sec * 1e6 + (double)taken.tv_nsec * 1e-3;
}

/* Compares dipoled with a peer. run: ping() or load(). with_kernel: its time is added to the peer's. */
static void measure(double (*run)(struct side *, uint64_t), struct side sides[2], bool with_kernel,
                    const char *name) {
  double kernels_us[ROUNDS] = {0};
  bench_progress(name);
  for (size_t i = 0; i < 2; i++) {
    run(&sides[i], WARM_UP_NS);
  }
  for (size_t round = 0; round < ROUNDS; round++) {
    kernels_us[round] = with_kernel ? kernel_us() : 0;
    for (size_t i = 0; i < 2; i++) {
      const double start_us = cpu_us(sides[i].pid);
      sides[i].figures[round] = run(&sides[i], ROUND_NS);
      sides[i].cpu_us[round] = (cpu_us(sides[i].pid) - start_us) / (double)sides[i].replies;
    }
  }
  for (size_t i = 0; i < 2; i++) {
    bench_figure(bench_median_of(sides[i].figures, ROUNDS), run == ping ? "us" : "requests/s",
                 "%s.%s.%s", name, sides[i].name, run == ping ? "p50" : "rate");
    bench_figure(bench_median_of(sides[i].cpu_us, ROUNDS), "us", "%s.%s.cpu", name, sides[i].name);
    close_side(&sides[i]);
  }
  if (sides[1].pid != sides[0].pid) {
    end_child(sides[1].pid);
  }
  if (with_kernel) {
    bench_figure(bench_median_of(kernels_us, ROUNDS), "us", "%s.kernel", name);
  }
  for (size_t round = 0; round < ROUNDS; round++) {
    sides[1].figures[round] += kernels_us[round];
    sides[1].cpu_us[round] += kernels_us[round];
  }
  bench_figure(bench_median_ratio(sides[0].figures, sides[1].figures, ROUNDS), "times", "ratio.%s",
               name);
  bench_figure(bench_median_ratio(sides[0].cpu_us, sides[1].cpu_us, ROUNDS), "times",
               "ratio.%s.cpu", name);
}

/* ---- groups ------------------------------------------------------------------------------- */

static SSL_CTX *const plain[2] = {NULL, NULL};

static void make_certificate(SSL_CTX *server) {
  char command[512];
  snprintf(command, sizeof command,
           "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=bench "
           "-keyout %s -out %s 2>/dev/null",
           key, certificate);
  bench_fail_if(system(command) != 0 ||
                    SSL_CTX_use_certificate_chain_file(server, certificate) != 1 ||
                    SSL_CTX_use_PrivateKey_file(server, key, SSL_FILETYPE_PEM) != 1,
                "the command openssl makes no certificate: is it installed?");
}

/* Starts the dipoled beside this program, at a Unix socket and at a port. option: that of the port;
 * scheme: how its address begins. tls: see open_echo(). */
static void begin(const char *option, const char *scheme, SSL_CTX *const tls[2],
                  struct server *local, struct server *front) {
  char program[PATH_MAX] = "", path[PATH_MAX], port[64];
  signal(SIGPIPE, SIG_IGN);
  strcpy(folder, "/tmp/dipoled-bench-XXXXXX");
  bench_fail_if(sched_getaffinity(0, sizeof cores, &cores) != 0 || mkdtemp(folder) == NULL ||
                    readlink("/proc/self/exe", program, sizeof program - 16) < 0,
                "cannot find the cores or this program, or make a folder in /tmp");
  core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BETTER, CORE_MOMENTS_EXACT,
                       CORE_EVALUATOR_F32, &medium, NULL);
  snprintf(certificate, sizeof certificate, "%s/pem", folder);
  snprintf(key, sizeof key, "%s/key", folder);
  if (tls[1] != NULL) {
    make_certificate(tls[1]);
  }
  *local = (struct server){.address = at_path("s")};
  *front = (struct server){.address = at_any_port(), .tls = tls[0]};
  close(listen_at(&front->address));
  strcpy(strrchr(program, '/') + 1, "dipoled");
  snprintf(path, sizeof path, "unix:%s", local->address.local.sun_path);
  snprintf(port, sizeof port, "%s127.0.0.1:%d", scheme, ntohs(front->address.tcp.sin_port));
  char *arguments[] = {program, "--workers",     "1",         "--listen",
                       path,    (char *)option,  port,        tls[1] != NULL ? "--key" : NULL,
                       key,     "--certificate", certificate, NULL};
  local->pid = front->pid = start_program(arguments);
  pin(LAST_CORE);
}

static void end(const struct server *server) {
  char command[64];
  end_child(server->pid);
  core_profile_free(&profile);
  snprintf(command, sizeof command, "rm -r %s", folder);
  bench_fail_if(system(command) != 0 || sched_setaffinity(0, sizeof cores, &cores) != 0,
                "cannot remove a folder in /tmp");
}

/* Round trips, beside an echo server. */
static void measure_evals(const struct server *server, size_t radius_count, SSL_CTX *const tls[2],
                          const char *name) {
  const struct exchange eval = make_eval(server, radius_count);
  const struct address echo_at = tls == plain ? at_path("echo") : at_any_port();
  struct side sides[] = {open_side("dipoled", server, &eval, 1), open_echo(echo_at, &eval, 1, tls)};
  measure(ping, sides, radius_count == BULK_RADII, name);
  free_exchange(&eval);
}

void bench_service(void) {
  struct server local, front;
  begin("--listen", "tcp:", plain, &local, &front);
  measure_evals(&local, BULK_RADII, plain, "service.bulk");
  measure_evals(&local, SMALL_RADII, plain, "service.rtt");
  pin(FIRST_CORE);
  measure_evals(&local, BULK_RADII, plain, "service.bulk.onecore");
  measure_evals(&local, SMALL_RADII, plain, "service.rtt.onecore");
  end(&local);
}

void bench_tls(void) {
  struct server local, front;
  SSL_CTX *const tls[] = {SSL_CTX_new(TLS_client_method()), SSL_CTX_new(TLS_server_method())};
  begin("--listen", "tls:", tls, &local, &front);
  measure_evals(&front, BULK_RADII, tls, "tls.bulk");
  measure_evals(&front, SMALL_RADII, tls, "tls.rtt");
  end(&local);
  SSL_CTX_free(tls[0]);
  SSL_CTX_free(tls[1]);
}

void bench_modbus(void) {
  struct server local, front;
  begin("--modbus", "tcp:", plain, &local, &front);
  const struct exchange job = make_read_write(&front);
  struct side sides[] = {open_side("dipoled", &front, &job, CONNECTIONS),
                         open_echo(at_any_port(), &job, CONNECTIONS, plain)};
  measure(load, sides, false, "modbus.rw");
  free_exchange(&job);
  end(&local);
}

void bench_http(void) {
  struct server local, front;
  begin("--http", "", plain, &local, &front);
  const struct exchange eval =
      make_get(&front, "/v1/eval?model=better&medium=skin1&"
                       "r=0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,1,1.5,2,3,4,5,6");
  const struct exchange health = make_get(&front, "/healthz");
  struct side sides[] = {open_side("dipoled", &front, &eval, CONNECTIONS),
                         open_side("healthz", &front, &health, CONNECTIONS)};
  measure(load, sides, false, "http.eval");
  free_exchange(&eval);
  free_exchange(&health);
  end(&local);
}

void bench_redis(void) {
  static const char set[] = "*3\r\n$3\r\nSET\r\n$1\r\nk\r\n$64\r\n"
                            "0123456789012345678901234567890123456789012345678901234567890123\r\n";
  static const char get[] = "*2\r\n$3\r\nGET\r\n$1\r\nk\r\n";
  struct server local, front;
  if (system("command -v redis-server >/dev/null") != 0) {
    fprintf(stderr, "bench: redis is skipped: Debian's package redis-server is not there\n");
    return;
  }
  begin("--listen", "tcp:", plain, &local, &front);
  struct server redis = {.address = at_path("redis")};
  char *arguments[] = {
      "redis-server", "--port", "0", "--unixsocket", redis.address.local.sun_path, "--save", "",
      "--appendonly", "no",     NULL};
  redis.pid = start_program(arguments);
  struct exchange eval = make_eval(&local, SMALL_RADII);
  const struct exchange ok = first_exchange(&redis, set, strlen(set), "+OK\r\n", 5);
  struct exchange value = first_exchange(&redis, get, strlen(get), set + sizeof set - 67, 66);
  repeat(&eval, BATCH);
  repeat(&value, BATCH);
  struct side sides[] = {open_side("dipoled", &local, &eval, CONNECTIONS),
                         open_side("redis", &redis, &value, CONNECTIONS)};
  measure(load, sides, false, "redis.requests");
  free_exchange(&eval);
  free_exchange(&ok);
  free_exchange(&value);
  end(&local);
}
