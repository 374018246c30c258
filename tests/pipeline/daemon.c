#include "tests/pipeline/daemon.h"

#include <limits.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

static bool find_beside(char *path, size_t bytes) {
  static const char name[] = "dipoled";
  const ssize_t length = readlink("/proc/self/exe", path, bytes - 1);
  path[length > 0 ? length : 0] = '\0';
  char *slash = strrchr(path, '/');
  if (slash == NULL || (size_t)(slash + 1 - path) + sizeof name > bytes) {
    return false;
  }
  memcpy(slash + 1, name, sizeof name);
  return access(path, X_OK) == 0;
}

static _Noreturn void become(const char *program, const char *address) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  execl(program, program, "--listen", address, "--log-level", "error", (char *)NULL);
  perror(program);
  _exit(127);
}

bool daemon_start(daemon_process *daemon) {
  char program[PATH_MAX];
  strcpy(daemon->folder, "/tmp/dipole-pipeline-XXXXXX");
  if (!find_beside(program, sizeof program) || mkdtemp(daemon->folder) == NULL) {
    fprintf(stderr, "there is no dipoled beside this program, or no room in /tmp\n");
    return false;
  }
  snprintf(daemon->address, sizeof daemon->address, "unix:%s/s", daemon->folder);
  daemon->pid = fork();
  if (daemon->pid == 0) {
    become(program, daemon->address);
  }
  return daemon->pid > 0;
}

bool daemon_stop(daemon_process *daemon) {
  int status = 0;
  kill(daemon->pid, SIGTERM);
  const bool ended = waitpid(daemon->pid, &status, 0) == daemon->pid;
  unlink(daemon->address + strlen("unix:"));
  rmdir(daemon->folder);
  if (!ended || !WIFEXITED(status) || WEXITSTATUS(status) != 0) {
    fprintf(stderr, "the daemon did not end well\n");
    return false;
  }
  return true;
}
