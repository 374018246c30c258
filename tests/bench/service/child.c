#include "tests/bench/service/child.h"

#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "tests/bench/bench.h"

extern char **environ;

enum { CHILDREN_MAX = 32, FILES_MAX = 16, PATH_BYTES = 64, STOP_MS = 5000 };

/* The processes and files to clean up. The signal handler, which may interrupt this process at any
 * time, also reads them, so an entry is complete before it is counted. */
static struct {
  pid_t owner; /* 0 until child_begin() is called */
  cpu_set_t cores;
  char folder[PATH_BYTES - 16];
  char files[FILES_MAX][PATH_BYTES];
  volatile sig_atomic_t file_count;
  volatile pid_t children[CHILDREN_MAX]; /* 0: it has ended */
  volatile sig_atomic_t child_count;
} all;

/* ---- the end ------------------------------------------------------------------------------ */

/* Makes only system calls, because the signal handler calls it. Children inherit the handler and
 * what is registered with atexit(), but own nothing. */
static void clean_up(void) {
  if (all.owner != getpid()) {
    return;
  }
  for (int i = 0; i < all.child_count; i++) {
    if (all.children[i] != 0) {
      kill(all.children[i], SIGKILL);
      waitpid(all.children[i], NULL, 0);
      all.children[i] = 0;
    }
  }
  for (int i = 0; i < all.file_count; i++) {
    unlink(all.files[i]);
  }
  rmdir(all.folder);
  all.owner = 0;
}

static void on_signal(int number) {
  static const char late[] = "bench: takes too long; given up\n";
  if (number == SIGALRM && write(STDERR_FILENO, late, sizeof late - 1) < 0) {
    _exit(EXIT_FAILURE);
  }
  clean_up();
  _exit(EXIT_FAILURE);
}

void child_begin(unsigned limit_s) {
  static bool registered = false;
  if (sched_getaffinity(0, sizeof all.cores, &all.cores) != 0) {
    bench_fail("cannot find out which cores there are");
  }
  snprintf(all.folder, sizeof all.folder, "/tmp/dipoled-bench-XXXXXX");
  if (mkdtemp(all.folder) == NULL) {
    bench_fail("cannot make a folder in /tmp");
  }
  all.file_count = all.child_count = 0;
  all.owner = getpid();
  if (!registered) {
    registered = true;
    atexit(clean_up);
  }
  signal(SIGALRM, on_signal);
  signal(SIGINT, on_signal);
  signal(SIGTERM, on_signal);
  signal(SIGPIPE, SIG_IGN);
  alarm(limit_s);
}

void child_end_all(void) {
  alarm(0);
  child_pin(CHILD_ANYWHERE);
  clean_up();
  signal(SIGALRM, SIG_DFL);
  signal(SIGINT, SIG_DFL);
  signal(SIGTERM, SIG_DFL);
  signal(SIGPIPE, SIG_DFL);
}

const char *child_path(const char *name) {
  if (all.file_count == FILES_MAX) {
    bench_fail("too many temporary files");
  }
  char *path = all.files[all.file_count];
  snprintf(path, PATH_BYTES, "%s/%s", all.folder, name);
  all.file_count++;
  return path;
}

/* ---- cores -------------------------------------------------------------------------------- */

static int first_core(void) {
  int core = 0;
  while (!CPU_ISSET(core, &all.cores)) {
    core++;
  }
  return core;
}

static int last_core(void) {
  int core = CPU_SETSIZE - 1;
  while (!CPU_ISSET(core, &all.cores)) {
    core--;
  }
  return core;
}

void child_pin(enum child_side side) {
  cpu_set_t cores = all.cores;
  if (side != CHILD_ANYWHERE) {
    CPU_ZERO(&cores);
    CPU_SET(side == CHILD_SERVER ? first_core() : last_core(), &cores);
  }
  if (sched_setaffinity(0, sizeof cores, &cores) != 0) {
    bench_fail("cannot be pinned to a core");
  }
}

/* ---- children ----------------------------------------------------------------------------- */

static void remember(pid_t child) {
  int place = 0;
  while (place < all.child_count && all.children[place] != 0) {
    place++;
  }
  all.children[place] = child;
  if (place == all.child_count) {
    all.child_count++;
  }
}

pid_t child_fork(enum child_side side) {
  if (all.child_count == CHILDREN_MAX) {
    bench_fail("too many processes");
  }
  const pid_t parent = getpid();
  const pid_t child = fork();
  if (child < 0) {
    bench_fail("cannot start a process");
  }
  if (child == 0) {
    signal(SIGTERM, SIG_DFL);
    signal(SIGINT, SIG_DFL);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) {
      _exit(EXIT_FAILURE);
    }
    child_pin(side);
    return 0;
  }
  remember(child);
  return child;
}

static void drop_options_from_environment(void) {
  size_t kept = 0;
  for (size_t i = 0; environ[i] != NULL; i++) {
    if (strncmp(environ[i], "DIPOLED", strlen("DIPOLED")) != 0) {
      environ[kept++] = environ[i];
    }
  }
  environ[kept] = NULL;
}

pid_t child_run(enum child_side side, char *const *arguments, const char *log) {
  const pid_t child = child_fork(side);
  if (child != 0) {
    return child;
  }
  const int to = open(log, O_WRONLY | O_CREAT | O_TRUNC, 0600);
  const int from = open("/dev/null", O_RDONLY);
  if (to < 0 || from < 0 || dup2(from, STDIN_FILENO) < 0 || dup2(to, STDOUT_FILENO) < 0 ||
      dup2(to, STDERR_FILENO) < 0) {
    _exit(EXIT_FAILURE);
  }
  closefrom(STDERR_FILENO + 1);
  drop_options_from_environment();
  execvp(arguments[0], arguments);
  _exit(EXIT_FAILURE);
}

static void forget(pid_t child) {
  for (int i = 0; i < all.child_count; i++) {
    if (all.children[i] == child) {
      all.children[i] = 0;
    }
  }
}

void child_end(pid_t child) {
  const struct timespec nap = {.tv_nsec = 1000000};
  kill(child, SIGTERM);
  for (int ms = 0; ms < STOP_MS; ms++) {
    if (waitpid(child, NULL, WNOHANG) != 0) {
      forget(child);
      return;
    }
    nanosleep(&nap, NULL);
  }
  kill(child, SIGKILL);
  waitpid(child, NULL, 0);
  forget(child);
}

void child_must_run(pid_t child, const char *name) {
  if (waitpid(child, NULL, WNOHANG) != 0) {
    forget(child);
    fprintf(stderr, "bench: %s has ended too early\n", name);
    bench_fail("a server could not be measured");
  }
}

uint64_t child_cpu_ns(pid_t child) {
  clockid_t clock;
  struct timespec time;
  if (clock_getcpuclockid(child, &clock) != 0 || clock_gettime(clock, &time) != 0) {
    bench_fail("a server has ended too early");
  }
  return (uint64_t)time.tv_sec * 1000000000u + (uint64_t)time.tv_nsec;
}
