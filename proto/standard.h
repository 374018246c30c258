/* standard: the standard streams of a program, which whoever starts it may have closed. */
#ifndef PROTO_STANDARD_H
#define PROTO_STANDARD_H

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

/* Opens those that are closed, so that no socket or file gets their numbers. It is still an error to
 * read from such a standard input, and to write to the others. Call this first. Returns false, with
 * errno, if there is no /dev/null. */
static inline bool standard_open(void) {
  for (int fd = STDIN_FILENO; fd <= STDERR_FILENO; fd++) {
    if (fcntl(fd, F_GETFD) < 0 &&
        open("/dev/null", fd == STDIN_FILENO ? O_WRONLY : O_RDONLY) != fd) {
      return false;
    }
  }
  return true;
}

/* Returns whether all of the output has been written. If not, says so on standard error. */
static inline bool standard_flush(const char *program) {
  errno = 0;
  if (ferror(stdout)) { /* the reason is lost: writing once more says it again */
    putchar('\n');
  }
  const bool written = fflush(stdout) == 0 && !ferror(stdout);
  if (!written) {
    fprintf(stderr, "%s: cannot write the output: %s\n", program,
            errno != 0 ? strerror(errno) : "it failed");
  }
  return written;
}

#endif
