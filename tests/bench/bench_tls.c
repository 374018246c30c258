/* Compares dipoled through TLS 1.3 with an echo server that uses the same OpenSSL, and its
 * handshakes with those of `openssl s_server`. Servers run on one core and clients on another
 * (service/child.h). Both sides take turns, a fraction of a second each. A figure is the median
 * over the rounds, a ratio the median of the rounds' ratios. Certificates have keys on the curve
 * P-256.
 *
 *   tls.bulk.<side>          round trip of 65,536 radii, one at a time; the side kernel is the
 *                            evaluation alone, in this process                               us
 *   ratio.tls.bulk           dipoled over the sum of echo and kernel
 *   tls.rtt.<side>           round trip of 16 radii, one at a time                           us
 *   ratio.tls.rtt            dipoled over echo
 *   tls.handshakes.<side>    full handshakes of `openssl s_time -new`, one at a time        1/s
 *   ratio.tls.handshakes     dipoled over s_server
 */
#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <openssl/ssl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "tests/bench/bench.h"
#include "tests/bench/service/child.h"
#include "tests/bench/service/daemon.h"
#include "tests/bench/service/samples.h"

enum { SMALL_RADII = 16, BULK_RADII = 65536, ROUNDS = 11, HANDSHAKE_ROUNDS = 3, LIMIT_S = 200 };
#define MS UINT64_C(1000000)
#define ROUND_NS (150 * MS)
#define WARM_UP_NS (30 * MS)

static struct samples samples;
static const char *certificate, *key;

/* ---- the echo ------------------------------------------------------------------------------- */

static bool read_all(SSL *ssl, uint8_t *to, size_t bytes) {
  for (size_t have = 0; have < bytes;) {
    const int got = SSL_read(ssl, to + have, (int)(bytes - have));
    if (got <= 0) {
      return false;
    }
    have += (size_t)got;
  }
  return true;
}

static void echo_peer(SSL *ssl, const struct target *target) {
  uint8_t *request = malloc(target->request_bytes);
  uint8_t *reply = malloc(target->reply_bytes);
  if (request == NULL || reply == NULL || SSL_accept(ssl) != 1) {
    _exit(EXIT_FAILURE);
  }
  memcpy(reply, target->replies, target->reply_bytes);
  while (read_all(ssl, request, target->request_bytes)) {
    target_set_id(reply, target_id(request));
    if (SSL_write(ssl, reply, (int)target->reply_bytes) <= 0) {
      break;
    }
  }
  free(request);
  free(reply);
}

/* Starts a server for one client at a time. */
static void echo_start_tls(struct target *target) {
  target->address = target_tcp(0);
  const int listener = target_listen(&target->address);
  target->server = child_fork(CHILD_SERVER);
  if (target->server != 0) {
    close(listener);
    return;
  }
  SSL_CTX *context = SSL_CTX_new(TLS_server_method());
  if (SSL_CTX_use_certificate_chain_file(context, certificate) != 1 ||
      SSL_CTX_use_PrivateKey_file(context, key, SSL_FILETYPE_PEM) != 1) {
    _exit(EXIT_FAILURE);
  }
  for (;;) {
    const int on = 1;
    const int fd = accept(listener, NULL, NULL);
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    SSL *ssl = SSL_new(context);
    SSL_set_fd(ssl, fd);
    echo_peer(ssl, target);
    SSL_free(ssl);
    close(fd);
  }
}

/* ---- round trips ---------------------------------------------------------------------------- */

struct side {
  const struct target *target;
  SSL_CTX *context;
  SSL *ssl;
  int fd;
  uint8_t *reply;
  uint8_t *requests;
  uint64_t count;
  double us[ROUNDS];
};

static struct side open_side(const struct target *target) {
  const size_t bytes = target->variants * target->request_bytes;
  struct side side = {.target = target, .context = SSL_CTX_new(TLS_client_method())};
  side.fd = target_connect(&target->address);
  side.ssl = SSL_new(side.context);
  side.reply = malloc(target->reply_bytes);
  side.requests = malloc(bytes);
  if (side.reply == NULL || side.requests == NULL || SSL_set_fd(side.ssl, side.fd) != 1 ||
      SSL_connect(side.ssl) != 1) {
    bench_fail("no handshake");
  }
  memcpy(side.requests, target->requests, bytes);
  return side;
}

static void close_side(struct side *side) {
  SSL_free(side->ssl);
  SSL_CTX_free(side->context);
  close(side->fd);
  free(side->reply);
  free(side->requests);
}

static uint64_t ask(struct side *side) {
  const struct target *target = side->target;
  const size_t variant = side->count % target->variants;
  uint8_t *request = side->requests + variant * target->request_bytes;
  target_set_id(request, ++side->count);
  const uint64_t start_ns = bench_now_ns();
  if (SSL_write(side->ssl, request, (int)target->request_bytes) <= 0 ||
      !read_all(side->ssl, side->reply, target->reply_bytes)) {
    bench_fail("a server does not answer");
  }
  const uint64_t taken_ns = bench_now_ns() - start_ns;
  target_check(target, variant, side->count, side->reply, side->count % target->check_every == 0);
  return taken_ns;
}

static double run_side(struct side *side, uint64_t duration_ns) {
  const uint64_t end_ns = bench_now_ns() + duration_ns;
  samples_clear(&samples);
  do {
    samples_add(&samples, ask(side));
  } while (bench_now_ns() < end_ns);
  samples_sort(&samples);
  return samples_us(&samples, 0.5);
}

/* The evaluation of a bulk request in this process. */
static double kernel_us(const struct target *bulk) {
  static float R[BULK_RADII];
  const core_medium *medium = &core_measured_medium_by_name("skin1")->channel[0];
  const float *r = (const float *)(const void *)(bulk->requests + bulk->request_bytes - sizeof R);
  core_profile profile;
  if (core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BETTER, CORE_MOMENTS_EXACT,
                           CORE_EVALUATOR_F32, medium, NULL)
          .field != NULL) {
    bench_fail("a measured medium was refused");
  }
  samples_clear(&samples);
  for (int i = 0; i < 200; i++) {
    const uint64_t start_ns = bench_now_ns();
    core_eval_f32(&profile, CORE_QUANTITY_R, BULK_RADII, r, R);
    samples_add(&samples, bench_now_ns() - start_ns);
  }
  samples_sort(&samples);
  core_profile_free(&profile);
  return samples_us(&samples, 0.5);
}

static void measure(const struct daemon *daemon, size_t radii, const char *name) {
  struct target eval, echo;
  double kernels_us[ROUNDS], ratios[ROUNDS];
  bench_progress(name);
  target_make_eval(&eval, radii);
  eval.address = daemon->at_tls;
  eval.server = daemon->child;
  target_make_echo(&echo, &eval);
  echo_start_tls(&echo);
  struct side sides[] = {open_side(&eval), open_side(&echo)};
  run_side(&sides[0], WARM_UP_NS);
  run_side(&sides[1], WARM_UP_NS);
  for (size_t round = 0; round < ROUNDS; round++) {
    for (size_t i = 0; i < 2; i++) {
      sides[i].us[round] = run_side(&sides[i], ROUND_NS);
    }
    kernels_us[round] = radii == BULK_RADII ? kernel_us(&eval) : 0;
    ratios[round] = sides[0].us[round] / (sides[1].us[round] + kernels_us[round]);
  }
  bench_figure(bench_median(sides[0].us, ROUNDS), "us", "tls.%s.dipoled", name);
  bench_figure(bench_median(sides[1].us, ROUNDS), "us", "tls.%s.echo", name);
  if (radii == BULK_RADII) {
    bench_figure(bench_median(kernels_us, ROUNDS), "us", "tls.%s.kernel", name);
  }
  bench_figure(bench_median(ratios, ROUNDS), "times", "ratio.tls.%s", name);
  close_side(&sides[0]);
  close_side(&sides[1]);
  child_end(echo.server);
  target_free(&eval);
  target_free(&echo);
}

/* ---- handshakes ----------------------------------------------------------------------------- */

static unsigned port_of(const struct target_address *address) {
  struct sockaddr_in name;
  memcpy(&name, &address->name, sizeof name);
  return ntohs(name.sin_port);
}

/* Returns the rate at which `openssl s_time` shakes hands with a port. */
static double shake_hands(unsigned port) {
  char command[160], line[256];
  double count = 0;
  snprintf(command, sizeof command, "openssl s_time -connect 127.0.0.1:%u -new -time 2 2>/dev/null",
           port);
  const uint64_t start_ns = bench_now_ns();
  FILE *said = popen(command, "r");
  while (said != NULL && fgets(line, sizeof line, said) != NULL) {
    if (strstr(line, "real seconds") != NULL) {
      count = strtod(line, NULL);
    }
  }
  if (said == NULL || pclose(said) != 0 || count == 0) {
    bench_fail("openssl s_time does not work");
  }
  return count / ((double)(bench_now_ns() - start_ns) * 1e-9);
}

static void measure_handshakes(const struct daemon *daemon) {
  char accept[32];
  struct target_address free_port = target_tcp(0);
  close(target_listen(&free_port));
  snprintf(accept, sizeof accept, "127.0.0.1:%u", port_of(&free_port));
  char *arguments[] = {"openssl",           "s_server", "-accept",   accept, "-cert",
                       (char *)certificate, "-key",     (char *)key, "-www", "-quiet",
                       "-num_tickets",      "0",        NULL};
  bench_progress("tls: handshakes");
  const pid_t other = child_run(CHILD_SERVER, arguments, child_path("s_server.log"));
  const struct timespec nap = {.tv_nsec = 500000000};
  nanosleep(&nap, NULL);
  child_must_run(other, "openssl s_server");
  double ours[HANDSHAKE_ROUNDS], theirs[HANDSHAKE_ROUNDS], ratios[HANDSHAKE_ROUNDS];
  for (size_t round = 0; round < HANDSHAKE_ROUNDS; round++) {
    ours[round] = shake_hands(port_of(&daemon->at_tls));
    theirs[round] = shake_hands(port_of(&free_port));
    ratios[round] = ours[round] / theirs[round];
  }
  child_end(other);
  bench_figure(bench_median(ours, HANDSHAKE_ROUNDS), "1/s", "tls.handshakes.dipoled");
  bench_figure(bench_median(theirs, HANDSHAKE_ROUNDS), "1/s", "tls.handshakes.s_server");
  bench_figure(bench_median(ratios, HANDSHAKE_ROUNDS), "times", "ratio.tls.handshakes");
}

/* ---- all of them ---------------------------------------------------------------------------- */

static void make_certificate(void) {
  char command[512];
  certificate = child_path("bench.pem");
  key = child_path("bench.key");
  snprintf(command, sizeof command,
           "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=bench "
           "-keyout %s -out %s 2>/dev/null",
           key, certificate);
  const int status = system(command);
  if (status != 0) {
    bench_fail("the command openssl makes no certificate: is it installed?");
  }
}

void bench_tls(void) {
  struct daemon daemon;
  child_begin(LIMIT_S);
  make_certificate();
  daemon_start_tls(&daemon, "dipoled", 1, certificate, key);
  child_pin(CHILD_CLIENT);
  measure(&daemon, BULK_RADII, "bulk");
  measure(&daemon, SMALL_RADII, "rtt");
  measure_handshakes(&daemon);
  daemon_end(&daemon);
  child_end_all();
  samples_free(&samples);
}
