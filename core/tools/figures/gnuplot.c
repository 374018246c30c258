#include "core/tools/figures/gnuplot.h"

#include <errno.h>
#include <fcntl.h>
#include <spawn.h>
#include <stdbool.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/tools/figures/fail.h"
#include "core/tools/figures/table.h"

#define PROGRAM "gnuplot"
#define PACKAGE "gnuplot-nox"

extern char **environ;

/* Its exit status is 0. in, out: file descriptors for its standard input and output. */
static bool run(char *const arguments[], int in, int out) {
  posix_spawn_file_actions_t actions;
  pid_t pid;
  int outcome;
  if (posix_spawn_file_actions_init(&actions) != 0 ||
      posix_spawn_file_actions_adddup2(&actions, in, STDIN_FILENO) != 0 ||
      posix_spawn_file_actions_adddup2(&actions, out, STDOUT_FILENO) != 0) {
    fail("out of memory");
  }
  const int fault = posix_spawnp(&pid, PROGRAM, &actions, NULL, arguments, environ);
  posix_spawn_file_actions_destroy(&actions);
  if (fault == ENOENT) {
    fail(PROGRAM " is not installed; install the package " PACKAGE);
  }
  if (fault != 0) {
    fail("cannot run " PROGRAM ": %s", strerror(fault));
  }
  while (waitpid(pid, &outcome, 0) < 0) {
    if (errno != EINTR) {
      fail("cannot wait for " PROGRAM ": %s", strerror(errno));
    }
  }
  return WIFEXITED(outcome) && WEXITSTATUS(outcome) == 0;
}

void gnuplot_draw(FILE *script, const char *path) {
  char *arguments[] = {PROGRAM, "-", NULL};
  FILE *picture = table_open(path);
  rewind(script); /* which flushes it, and puts its descriptor at the start */
  const bool good = run(arguments, fileno(script), fileno(picture));
  fclose(script);
  if (!good || lseek(fileno(picture), 0, SEEK_END) <= 0) {
    fail(PROGRAM " failed to draw %s", path);
  }
  table_close(picture, path);
}

void gnuplot_require(void) {
  char *arguments[] = {PROGRAM, "--version", NULL};
  const int null = open("/dev/null", O_RDWR | O_CLOEXEC);
  if (null < 0 || !run(arguments, null, null)) {
    fail(PROGRAM " does not run");
  }
  close(null);
}
