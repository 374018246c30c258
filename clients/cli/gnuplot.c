/* gnuplot reads its script from one nameless file and writes the picture into a second and its
 * error messages into a third. So no shell sees a file name, and no picture is half written. */
#include "clients/cli/gnuplot.h"

#include <ctype.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "clients/c/error.h"
#include "clients/cli/cli.h"

#define PROGRAM "gnuplot"
#define PACKAGE "gnuplot-nox"

void cli_gnuplot_quote(FILE *script, const char *text) {
  char *clean = cli_allocate(strlen(text) + 1, 1);
  memcpy(clean, text, strlen(text));
  libdipole_clean_text(clean);
  fputc('"', script);
  for (const char *at = clean; *at != '\0'; at++) {
    const bool bare = *at == ' ' || isalnum((unsigned char)*at) || (unsigned char)*at >= 0x80;
    fprintf(script, bare ? "%c" : "\\0%03o", (unsigned char)*at);
  }
  fputc('"', script);
  free(clean);
}

/* ---- running --------------------------------------------------------------------------------- */

/* The nameless files that gnuplot works with, in the order of its standard streams. */
enum { SCRIPT, PICTURE, COMPLAINTS, FILES };

enum { NOT_THERE = 127 };

/* Returns gnuplot's exit status, NOT_THERE if it is not installed, or -1. */
static int run_program(FILE *const files[FILES]) {
  int outcome = -1;
  const pid_t pid = fork();
  if (pid == 0) {
    for (int i = 0; i < FILES; i++) {
      dup2(fileno(files[i]), i);
    }
    execlp(PROGRAM, PROGRAM, "-d", "-", (char *)NULL); /* -d: no settings of the user's own */
    _exit(NOT_THERE);
  }
  while (pid > 0 && waitpid(pid, &outcome, 0) < 0 && errno == EINTR) {
  }
  return pid > 0 && WIFEXITED(outcome) ? WEXITSTATUS(outcome) : -1;
}

/* Of text, form feeds become line ends if no line end is there, and blanks at line ends are left
 * out. */
static void copy_picture(FILE *from, FILE *to, bool text) {
  int blanks = 0, last = '\n';
  for (int byte; (byte = fgetc(from)) != EOF;) {
    if (text && byte == ' ') {
      blanks++;
      continue;
    }
    byte = text && byte == '\f' ? '\n' : byte;
    if (byte != '\n') {
      fprintf(to, "%*s", blanks, "");
    }
    if (!text || byte != '\n' || last != '\n' || blanks == 0) {
      fputc(byte, to);
    }
    blanks = 0;
    last = byte;
  }
}

static bool write_picture(FILE *from, const char *path) {
  const bool text = strcmp(path, CLI_PICTURE_TERMINAL) == 0;
  FILE *to = text ? stdout : fopen(path, "wbe");
  if (to == NULL) {
    return false;
  }
  rewind(from);
  copy_picture(from, to, text);
  const bool good = !ferror(from) && !ferror(to);
  return (text || fclose(to) == 0) && good;
}

int cli_gnuplot(FILE *script, const char *path) {
  FILE *const files[FILES] = {script, tmpfile(), tmpfile()};
  char complaints[512] = "";
  int status = CLI_OK;
  rewind(script); /* this flushes it as well */
  const bool open = files[PICTURE] != NULL && files[COMPLAINTS] != NULL;
  const int ended = open ? run_program(files) : -1;
  if (ended == NOT_THERE) {
    status =
        cli_fail("--plot %s: " PROGRAM " is not installed; install the package " PACKAGE, path);
  } else if (ended != 0 || lseek(fileno(files[PICTURE]), 0, SEEK_END) <= 0) {
    if (open) {
      rewind(files[COMPLAINTS]);
      complaints[fread(complaints, 1, sizeof complaints - 1, files[COMPLAINTS])] = '\0';
    }
    status = cli_fail("--plot %s: " PROGRAM " failed: %s", path, complaints);
  } else if (!write_picture(files[PICTURE], path)) {
    status = cli_fail("--plot %s: cannot write it: %s", path, strerror(errno));
  }
  for (int i = PICTURE; i < FILES; i++) {
    if (files[i] != NULL) {
      fclose(files[i]);
    }
  }
  return status;
}
