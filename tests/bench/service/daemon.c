#include "tests/bench/service/daemon.h"

#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "tests/bench/bench.h"

enum { READY_MS = 10000, LOG_BYTES = 8192 };

static void find_beside(char *path, size_t bytes, const char *name) {
  const ssize_t length = readlink("/proc/self/exe", path, bytes - 1);
  path[length > 0 ? length : 0] = '\0';
  char *slash = strrchr(path, '/');
  if (slash == NULL || (size_t)(slash + 1 - path) + strlen(name) >= bytes) {
    bench_fail("cannot tell where this program is");
  }
  strcpy(slash + 1, name);
  if (access(path, X_OK) != 0) {
    bench_fail("there is no dipoled beside this program: make builds both");
  }
}

static void read_log(const char *path, char *text, size_t bytes) {
  FILE *file = fopen(path, "r");
  const size_t length = file != NULL ? fread(text, 1, bytes - 1, file) : 0;
  text[length] = '\0';
  if (file != NULL) {
    fclose(file);
  }
}

/* Waits until the daemon's log says that all listeners are open. */
static void wait_until_ready(pid_t child, const char *path, char *log, size_t bytes) {
  const struct timespec nap = {.tv_nsec = 1000000};
  for (int ms = 0; ms < READY_MS; ms++) {
    child_must_run(child, "dipoled");
    read_log(path, log, bytes);
    if (strstr(log, "event=ready") != NULL) {
      return;
    }
    nanosleep(&nap, NULL);
  }
  bench_fail("dipoled does not get ready");
}

/* Finds in the daemon's log the port at which it listens. */
static struct target_address find_port(const char *log, const char *scheme) {
  char text[64];
  snprintf(text, sizeof text, "url=%s127.0.0.1:", scheme);
  const char *port = strstr(log, text);
  if (port == NULL) {
    bench_fail("dipoled does not say where it listens");
  }
  return target_tcp((unsigned)strtoul(port + strlen(text), NULL, 10));
}

void daemon_start(struct daemon *daemon, enum child_side side, const char *name, unsigned workers) {
  char program[PATH_MAX], listen[PATH_MAX], log_name[64], count[16], log[LOG_BYTES];
  const char *path = child_path(name);
  find_beside(program, sizeof program, "dipoled");
  snprintf(listen, sizeof listen, "unix:%s", path);
  snprintf(log_name, sizeof log_name, "%s.log", name);
  snprintf(count, sizeof count, "%u", workers);
  const char *log_path = child_path(log_name);
  char *arguments[] = {program,           "--listen",  listen, "--listen",
                       "tcp:127.0.0.1:0", "--workers", count,  NULL};
  daemon->child = child_run(side, arguments, log_path);
  wait_until_ready(daemon->child, log_path, log, sizeof log);
  daemon->at_unix = target_unix(path);
  daemon->at_tcp = find_port(log, "tcp:");
}

void daemon_end(struct daemon *daemon) {
  child_end(daemon->child);
}
