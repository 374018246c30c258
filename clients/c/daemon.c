#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "clients/c/client.h"

#define PROGRAM "dipoled"
#define DAEMON_FD 3 /* the number that the connection has in the daemon */

/* How long a private daemon may take to end by itself, and then after SIGTERM. */
#define END_TIMEOUT_MS 5000

extern char **environ;

/* The program beside the running one; "" when there is none. */
static void find_beside(char *path, size_t bytes) {
  const ssize_t length = readlink("/proc/self/exe", path, bytes - 1);
  path[length > 0 ? length : 0] = '\0';
  char *slash = strrchr(path, '/');
  const size_t room = slash != NULL ? bytes - (size_t)(slash + 1 - path) : 0;
  if (room < sizeof PROGRAM) {
    path[0] = '\0';
    return;
  }
  memcpy(slash + 1, PROGRAM, sizeof PROGRAM);
  if (access(path, X_OK) != 0) {
    path[0] = '\0';
  }
}

/* What the daemon inherits: its connection, standard error, and nothing else. The connection comes
 * first, because its number may be one of those that are opened afterwards. */
static int prepare_actions(posix_spawn_file_actions_t *actions, int fd) {
  int fault = posix_spawn_file_actions_adddup2(actions, fd, DAEMON_FD);
  if (fault == 0) {
    fault = posix_spawn_file_actions_addopen(actions, 0, "/dev/null", O_RDONLY, 0);
  }
  if (fault == 0) {
    fault = posix_spawn_file_actions_addopen(actions, 1, "/dev/null", O_WRONLY, 0);
  }
  if (fault == 0) {
    fault = posix_spawn_file_actions_addclosefrom_np(actions, DAEMON_FD + 1);
  }
  return fault;
}

/* A process group of its own, so that the interrupt key ends the program and not the daemon first;
 * and no blocked or ignored signals from the program. */
static int prepare_attributes(posix_spawnattr_t *attributes) {
  sigset_t none, some;
  sigemptyset(&none);
  sigemptyset(&some);
  sigaddset(&some, SIGTERM);
  sigaddset(&some, SIGINT);
  sigaddset(&some, SIGHUP);
  sigaddset(&some, SIGCHLD);
  int fault = posix_spawnattr_setsigmask(attributes, &none);
  if (fault == 0) {
    fault = posix_spawnattr_setsigdefault(attributes, &some);
  }
  if (fault == 0) {
    fault = posix_spawnattr_setpgroup(attributes, 0);
  }
  return fault != 0
             ? fault
             : posix_spawnattr_setflags(attributes, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF |
                                                        POSIX_SPAWN_SETPGROUP);
}

/* Whether a variable would make the daemon serve others, too. */
static bool serves_others(const char *variable) {
  static const char *const names[] = {"DIPOLED_LISTEN=", "DIPOLED_METRICS=", "DIPOLED_MODBUS="};
  for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
    if (strncmp(variable, names[i], strlen(names[i])) == 0) {
      return true;
    }
  }
  return false;
}

/* The program's environment, to be freed, without those. */
static char **private_environment(void) {
  size_t count = 0;
  while (environ[count] != NULL) {
    count++;
  }
  char **kept = calloc(count + 1, sizeof *kept);
  for (size_t i = 0, at = 0; kept != NULL && i < count; i++) {
    if (!serves_others(environ[i])) {
      kept[at++] = environ[i];
    }
  }
  return kept;
}

/* 0, or an errno. */
static int spawn(const char *program, int fd, pid_t *pid) {
  char number[16];
  char *arguments[] = {(char *)program, "--fd", number, "--log-level", "error", NULL};
  posix_spawn_file_actions_t actions;
  posix_spawnattr_t attributes;

  snprintf(number, sizeof number, "%d", DAEMON_FD);
  char **environment = private_environment();
  int fault = environment != NULL ? posix_spawn_file_actions_init(&actions) : ENOMEM;
  if (fault != 0) {
    free(environment);
    return fault;
  }
  fault = posix_spawnattr_init(&attributes);
  if (fault == 0) {
    fault = prepare_actions(&actions, fd);
    if (fault == 0) {
      fault = prepare_attributes(&attributes);
    }
    if (fault == 0) {
      fault = posix_spawnp(pid, program, &actions, &attributes, arguments, environment);
    }
    posix_spawnattr_destroy(&attributes);
  }
  posix_spawn_file_actions_destroy(&actions);
  free(environment);
  return fault;
}

bool libdipole_daemon_start(const char *program, int *fd, pid_t *pid, dipole_error *error) {
  char beside[PATH_MAX];
  int pair[2];
  if (program[0] == '\0') {
    find_beside(beside, sizeof beside);
    program = beside[0] != '\0' ? beside : PROGRAM;
  }
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) {
    return libdipole_fail_errno(error, DIPOLE_ERROR_CONNECT, errno, "socketpair");
  }
  const int fault = spawn(program, pair[1], pid);
  close(pair[1]);
  if (fault == 0 && fcntl(pair[0], F_SETFL, O_NONBLOCK) == 0) {
    *fd = pair[0];
    return true;
  }
  close(pair[0]);
  if (fault == ENOENT) {
    return libdipole_fail(error, DIPOLE_ERROR_CONNECT,
                          "cannot start a private daemon: %.120s is neither beside this program "
                          "nor in PATH; name a running daemon, for example in $DIPOLED",
                          program);
  }
  char what[PATH_MAX];
  snprintf(what, sizeof what, "cannot start %.120s", program);
  return libdipole_fail_errno(error, DIPOLE_ERROR_CONNECT, fault, what);
}

/* True when the child is gone. A program that collects all its children may have taken it already.
 * There is no wait with a timeout, hence short naps, each longer than the last. */
static bool wait_for(pid_t pid, int timeout_ms) {
  const int64_t deadline_ms = libdipole_now_ms() + timeout_ms;
  struct timespec nap = {.tv_nsec = 100000};
  for (;;) {
    const pid_t result = waitpid(pid, NULL, WNOHANG);
    if (result == pid || (result < 0 && errno != EINTR)) {
      return true;
    }
    if (libdipole_now_ms() >= deadline_ms) {
      return false;
    }
    nanosleep(&nap, NULL);
    if (nap.tv_nsec < 20000000) {
      nap.tv_nsec *= 2;
    }
  }
}

void libdipole_daemon_end(pid_t pid) {
  if (wait_for(pid, END_TIMEOUT_MS)) {
    return;
  }
  kill(pid, SIGTERM);
  if (wait_for(pid, END_TIMEOUT_MS)) {
    return;
  }
  kill(pid, SIGKILL);
  wait_for(pid, END_TIMEOUT_MS);
}
