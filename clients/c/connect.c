#include "clients/c/connect.h"

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "clients/c/clock.h"
#include "clients/c/error.h"

extern char **environ;

/* Returns a socket under a number that is none of a standard stream, which the program may have
 * closed: what it writes there must not get into the socket. Keeps -1, and sets errno. */
static int above_standard(int fd) {
  if (fd < 0 || fd > STDERR_FILENO) {
    return fd;
  }
  const int moved = fcntl(fd, F_DUPFD_CLOEXEC, STDERR_FILENO + 1), number = errno;
  close(fd);
  errno = number;
  return moved;
}

/* ---- running daemons ----------------------------------------------------------------------- */

/* Connects to a Unix socket. Returns 0 or an errno. connect() on a non-blocking Unix socket fails
 * at once when the daemon's queue is full, so the socket becomes non-blocking only afterwards. */
static int connect_unix(const char *path, unsigned timeout_ms, int *connected) {
  struct sockaddr_un name = {.sun_family = AF_UNIX};
  const struct timeval timeout = {.tv_sec = timeout_ms / 1000,
                                  .tv_usec = (suseconds_t)(timeout_ms % 1000) * 1000};
  const int fd = above_standard(socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  if (fd < 0) {
    return errno;
  }
  memcpy(name.sun_path, path, strlen(path) + 1);
  setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &timeout, sizeof timeout);
  int result;
  do {
    result = connect(fd, (const struct sockaddr *)&name, sizeof name);
  } while (result != 0 && errno == EINTR);
  if (result == 0 && fcntl(fd, F_SETFL, O_NONBLOCK) == 0) {
    *connected = fd;
    return 0;
  }
  const int number = errno == EAGAIN ? ETIMEDOUT : errno;
  close(fd);
  return number;
}

/* Connects to one of a host's addresses. Returns 0 or an errno. */
static int connect_tcp_address(const struct addrinfo *to, unsigned timeout_ms, int *connected) {
  const int one = 1;
  const int fd = above_standard(
      socket(to->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, to->ai_protocol));
  if (fd < 0) {
    return errno;
  }
  int number = connect(fd, to->ai_addr, to->ai_addrlen) == 0 ? 0 : errno;
  if (number == EINPROGRESS || number == EINTR) { /* The kernel continues to connect. */
    short ready;
    socklen_t bytes = sizeof number;
    if (!libdipole_wait(fd, POLLOUT, timeout_ms, &ready) ||
        getsockopt(fd, SOL_SOCKET, SO_ERROR, &number, &bytes) != 0) {
      number = errno;
    }
  }
  if (number != 0) {
    close(fd);
    return number;
  }
  /* Small requests are sent at once, without waiting for the peer's acknowledgements. */
  setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
  *connected = fd;
  return 0;
}

static bool connect_unix_address(const libdipole_address *address, unsigned timeout_ms, int *fd,
                                 dipole_error *error) {
  char what[sizeof((struct sockaddr_un *)0)->sun_path + 64];
  const int number = connect_unix(address->path, timeout_ms, fd);
  snprintf(what, sizeof what, "cannot connect to the socket %.108s", address->path);
  return number == 0 || libdipole_fail_errno(error, DIPOLE_ERROR_CONNECT, number, what);
}

static bool connect_tcp(const libdipole_address *address, unsigned timeout_ms, int *fd,
                        dipole_error *error) {
  const struct addrinfo hints = {.ai_family = AF_UNSPEC, .ai_socktype = SOCK_STREAM};
  struct addrinfo *list;
  const int fault = getaddrinfo(address->host, address->port, &hints, &list);
  if (fault != 0) {
    return libdipole_fail(error, DIPOLE_ERROR_CONNECT, "cannot find the host '%s': %s",
                          address->host, gai_strerror(fault));
  }
  const int64_t until_ms = libdipole_now_ms() + timeout_ms;
  int number = EADDRNOTAVAIL;
  unsigned left_ms = timeout_ms;
  for (const struct addrinfo *to = list; to != NULL && number != 0; to = to->ai_next) {
    const int64_t now_ms = libdipole_now_ms();
    left_ms = timeout_ms == 0 ? 0 : now_ms < until_ms ? (unsigned)(until_ms - now_ms) : 1;
    number = connect_tcp_address(to, left_ms, fd);
  }
  freeaddrinfo(list);
  char what[sizeof address->host + 64];
  snprintf(what, sizeof what, "cannot connect to host %s, port %s", address->host, address->port);
  return number == 0 || libdipole_fail_errno(error, DIPOLE_ERROR_CONNECT, number, what);
}

/* ---- private daemons ----------------------------------------------------------------------- */

#define PROGRAM "dipoled"

enum {
  DAEMON_FD = 3,        /* the connection's file descriptor in the daemon */
  END_TIMEOUT_MS = 5000 /* how long to wait before SIGTERM, and then before SIGKILL */
};

/* Finds the daemon beside the running program. Sets path to "" if there is none. */
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
  struct stat file;
  if (stat(path, &file) != 0 || !S_ISREG(file.st_mode) || access(path, X_OK) != 0) {
    path[0] = '\0';
  }
}

/* Lets the daemon inherit its connection and standard error, and nothing else. Duplicates the
 * connection first, because a file that is opened may get its number. Returns 0 or an errno. */
static int set_files(posix_spawn_file_actions_t *actions, int fd) {
  int fault = posix_spawn_file_actions_adddup2(actions, fd, DAEMON_FD);
  fault =
      fault != 0 ? fault : posix_spawn_file_actions_addopen(actions, 0, "/dev/null", O_RDONLY, 0);
  fault =
      fault != 0 ? fault : posix_spawn_file_actions_addopen(actions, 1, "/dev/null", O_WRONLY, 0);
  return fault != 0 ? fault : posix_spawn_file_actions_addclosefrom_np(actions, DAEMON_FD + 1);
}

/* Gives the daemon its own process group, so that the interrupt key does not end it before the
 * program. Resets blocked and ignored signals to their defaults. Returns 0 or an errno. */
static int set_attributes(posix_spawnattr_t *attributes) {
  const short flags = POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP;
  sigset_t none, reset;
  sigemptyset(&none);
  sigemptyset(&reset);
  sigaddset(&reset, SIGTERM);
  sigaddset(&reset, SIGINT);
  sigaddset(&reset, SIGHUP);
  sigaddset(&reset, SIGCHLD);
  int fault = posix_spawnattr_setsigmask(attributes, &none);
  fault = fault != 0 ? fault : posix_spawnattr_setsigdefault(attributes, &reset);
  fault = fault != 0 ? fault : posix_spawnattr_setpgroup(attributes, 0);
  return fault != 0 ? fault : posix_spawnattr_setflags(attributes, flags);
}

/* Starts a private daemon, which logs only errors. Returns 0 or an errno. */
static int spawn(const char *program, int fd, pid_t *pid) {
  char number[16];
  char *arguments[] = {(char *)program, "--fd", number, "--log-level", "error", NULL};
  posix_spawn_file_actions_t actions;
  posix_spawnattr_t attributes;
  snprintf(number, sizeof number, "%d", DAEMON_FD);
  int fault = posix_spawn_file_actions_init(&actions);
  if (fault == 0) {
    fault = posix_spawnattr_init(&attributes);
    if (fault == 0) {
      fault = set_files(&actions, fd);
      fault = fault != 0 ? fault : set_attributes(&attributes);
      fault = fault != 0 ? fault
                         : posix_spawnp(pid, program, &actions, &attributes, arguments, environ);
      posix_spawnattr_destroy(&attributes);
    }
    posix_spawn_file_actions_destroy(&actions);
  }
  return fault;
}

/* Starts a daemon. program: its path; "": the dipoled beside this program, else that in PATH. */
static bool start_daemon(const char *program, int *fd, pid_t *pid, dipole_error *error) {
  char beside[PATH_MAX];
  int pair[2];
  if (program[0] == '\0') {
    find_beside(beside, sizeof beside);
    program = beside[0] != '\0' ? beside : PROGRAM;
  }
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) {
    return libdipole_fail_errno(error, DIPOLE_ERROR_CONNECT, errno, "socketpair");
  }
  pair[0] = above_standard(pair[0]);
  const int fault = pair[0] >= 0 ? spawn(program, pair[1], pid) : errno;
  close(pair[1]);
  if (fault == 0 && fcntl(pair[0], F_SETFL, O_NONBLOCK) == 0) {
    *fd = pair[0];
    return true;
  }
  close(pair[0]);
  if (fault == ENOENT) {
    return libdipole_fail(error, DIPOLE_ERROR_CONNECT,
                          "cannot start a private daemon: there is no program %.80s beside this "
                          "program or in PATH. Install dipoled, or name a running daemon, as in "
                          "DIPOLED=tcp:HOST:PORT",
                          program);
  }
  char what[PATH_MAX];
  snprintf(what, sizeof what, "cannot start %.120s", program);
  return libdipole_fail_errno(error, DIPOLE_ERROR_CONNECT, fault, what);
}

/* Waits for the end of a child process. Returns whether it has ended; the host program may already
 * have collected it. Polls with growing sleeps, because waitpid() has no timeout. */
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

void libdipole_daemon_end(pid_t daemon) {
  if (!wait_for(daemon, END_TIMEOUT_MS)) {
    kill(daemon, SIGTERM);
    if (!wait_for(daemon, END_TIMEOUT_MS)) {
      kill(daemon, SIGKILL);
      wait_for(daemon, END_TIMEOUT_MS);
    }
  }
}

bool libdipole_connect(const libdipole_address *address, unsigned timeout_ms, int *fd,
                       pid_t *daemon, dipole_error *error) {
  *daemon = 0;
  switch (address->kind) {
  case LIBDIPOLE_TCP:
  case LIBDIPOLE_TLS:
    return connect_tcp(address, timeout_ms, fd, error);
  case LIBDIPOLE_UNIX:
    return connect_unix_address(address, timeout_ms, fd, error);
  default:
    return start_daemon(address->path, fd, daemon, error);
  }
}
