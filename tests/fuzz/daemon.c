/* The daemon in this process, with one worker, whose loop the fuzzing thread runs; and the peer of
 * a connection. */
#include "tests/fuzz/daemon.h"

#include <errno.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/jobs/mc_pool.h"
#include "server/observe/log.h"

struct server fuzz_server;
struct worker fuzz_worker;

void fuzz_daemon_start(void) {
  char *arguments[] = {"dipoled", "--max-frame-bytes", "65536",  "--max-part-bytes",
                       "4096",    "--max-radii",       "20000",  "--max-media",
                       "16",      "--max-mc-photons",  "64",     "--max-mc-jobs",
                       "1024",    "--mc-threads",      "1",      "--workers",
                       "1",       "--cache-bytes",     "1000000"};
  CHECK(options_read((int)(sizeof arguments / sizeof *arguments), arguments,
                     &fuzz_server.options) == OPTIONS_RUN);
  fuzz_server.buffers.most = fuzz_server.options.max_total_bytes;
  signal(SIGPIPE, SIG_IGN); /* as the daemon does */
  log_set_level(LOG_LEVEL_ERROR);
  fuzz_server.isa = core_isa_select(NULL);
  fuzz_server.workers = &fuzz_worker;
  fuzz_server.latencies = calloc(1, sizeof *fuzz_server.latencies);
  fuzz_server.cache = cache_new(fuzz_server.isa, fuzz_server.options.cache_bytes,
                                fuzz_server.options.points_bytes,
                                fuzz_server.options.max_waiting_profiles, &fuzz_server.stats);
  CHECK(cache_start(fuzz_server.cache) == 0);
  fuzz_server.mc = mc_pool_new(&fuzz_server);
  CHECK(worker_open(&fuzz_worker, &fuzz_server) == 0);
  stats_claim(1);
}

static void read_answers(int fd, struct fuzz_bytes *answers, bool *end) {
  ssize_t got;
  while ((got = read(fd, fuzz_gather(answers, 65536), 65536)) > 0) {
    answers->count += (size_t)got;
  }
  *end = got == 0 || errno != EAGAIN;
}

void fuzz_daemon_run(uv_run_mode mode) {
  uv_run(&fuzz_worker.loop, mode);
}

static bool send_pieces(int fd, struct fuzz_delivery *delivery, struct fuzz_bytes *answers,
                        bool reads) {
  const uint8_t *piece;
  size_t bytes;
  bool end = false;
  while ((bytes = fuzz_delivery_next(delivery, &piece)) > 0) {
    while (bytes > 0 && !end) {
      const ssize_t sent = send(fd, piece, bytes, MSG_NOSIGNAL);
      if (sent > 0) {
        piece += sent;
        bytes -= (size_t)sent;
      } else if (errno != EAGAIN) {
        return true;
      }
      fuzz_daemon_run(UV_RUN_NOWAIT);
      if (reads || sent <= 0) {
        read_answers(fd, answers, &end);
      }
    }
  }
  return end;
}

void fuzz_daemon_check_freed(void) {
  for (int ms = 0; ms < 10000 && atomic_load(&fuzz_server.buffers.bytes) > 0; ms++) {
    usleep(1000);
  }
  CHECK(atomic_load(&fuzz_server.buffers.bytes) == 0 && fuzz_worker.context.owed_radii == 0);
}

void fuzz_daemon_talk(int fd, struct fuzz_delivery *delivery, unsigned manners,
                      struct fuzz_bytes *answers) {
  const bool rude = manners & 1, reads = !(manners & 2);
  bool end = send_pieces(fd, delivery, answers, reads);
  if (!rude) {
    shutdown(fd, SHUT_WR);
    while (!end) {
      fuzz_daemon_run(UV_RUN_ONCE);
      read_answers(fd, answers, &end);
    }
  }
  close(fd);
}
