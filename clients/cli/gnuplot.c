/* gnuplot reads its script from one nameless file and writes the picture into a second and its
 * error messages into a third. So no shell sees a file name, and no picture is half written. */
#include "clients/cli/gnuplot.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <spawn.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "clients/c/error.h"
#include "clients/cli/cli.h"

#define PROGRAM "gnuplot"
#define PACKAGE "gnuplot-nox"

extern char **environ;

static const struct {
  const char *suffix;
  const char *terminal; /* with the size in pixels, and fonts of about the same size */
} formats[] = {
    {".svg", "svg size %zu,%zu dynamic background rgb 'white' font 'sans,14' noenhanced"},
    {".png", "pngcairo size %zu,%zu background rgb 'white' font 'sans,11' noenhanced"},
};

/* Returns gnuplot's terminal for a file of this name; NULL if the name ends in neither .svg nor
 * .png. */
static const char *terminal_of(const char *path) {
  const size_t length = strlen(path);
  for (size_t i = 0; i < sizeof formats / sizeof formats[0]; i++) {
    const size_t suffix = strlen(formats[i].suffix);
    if (length > suffix && strcmp(path + length - suffix, formats[i].suffix) == 0) {
      return formats[i].terminal;
    }
  }
  return NULL;
}

bool cli_gnuplot_draws(const char *path) {
  return terminal_of(path) != NULL;
}

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

static bool fail(char error[CLI_GNUPLOT_ERROR_BYTES], const char *what, const char *why) {
  snprintf(error, CLI_GNUPLOT_ERROR_BYTES, "%s%s%s", what, why[0] != '\0' ? ": " : "", why);
  return false;
}

/* Returns 0, an errno, or -1 when gnuplot failed. */
static int spawn(FILE *const files[FILES]) {
  char *arguments[] = {PROGRAM, "-d", "-", NULL}; /* -d: the user's own settings are not read */
  posix_spawn_file_actions_t actions;
  pid_t pid;
  int outcome;
  int fault = posix_spawn_file_actions_init(&actions);
  if (fault != 0) {
    return fault;
  }
  for (int i = 0; fault == 0 && i < FILES; i++) {
    fault = posix_spawn_file_actions_adddup2(&actions, fileno(files[i]), i);
  }
  if (fault == 0) {
    fault = posix_spawnp(&pid, PROGRAM, &actions, NULL, arguments, environ);
  }
  posix_spawn_file_actions_destroy(&actions);
  if (fault != 0) {
    return fault;
  }
  while (waitpid(pid, &outcome, 0) < 0) {
    if (errno != EINTR) {
      return errno;
    }
  }
  return WIFEXITED(outcome) && WEXITSTATUS(outcome) == 0 ? 0 : -1;
}

static bool run(FILE *const files[FILES], char error[CLI_GNUPLOT_ERROR_BYTES]) {
  const int fault = spawn(files);
  if (fault == ENOENT) {
    return fail(error, PROGRAM " is not installed; install the package " PACKAGE, "");
  }
  if (fault >= 0) {
    return fault == 0 || fail(error, PROGRAM " failed", strerror(fault));
  }
  char complaints[CLI_GNUPLOT_ERROR_BYTES / 2];
  rewind(files[COMPLAINTS]);
  complaints[fread(complaints, 1, sizeof complaints - 1, files[COMPLAINTS])] = '\0';
  return fail(error, PROGRAM " failed", complaints);
}

static void close_all(FILE *const files[FILES]) {
  for (int i = 0; i < FILES; i++) {
    if (files[i] != NULL) {
      fclose(files[i]);
    }
  }
}

static bool open_all(FILE *files[FILES], char error[CLI_GNUPLOT_ERROR_BYTES]) {
  for (int i = 0; i < FILES; i++) {
    files[i] = tmpfile();
    if (files[i] == NULL || fcntl(fileno(files[i]), F_SETFD, FD_CLOEXEC) != 0) {
      return fail(error, "cannot make a temporary file", strerror(errno));
    }
  }
  return true;
}

/* ---- drawing --------------------------------------------------------------------------------- */

/* Runs gnuplot on a script whose first lines are in files[SCRIPT] already. */
static bool draw(FILE *const files[FILES], cli_gnuplot_script *write, const void *context,
                 char error[CLI_GNUPLOT_ERROR_BYTES]) {
  fputs("\nset encoding utf8\n", files[SCRIPT]);
  write(files[SCRIPT], context);
  rewind(files[SCRIPT]); /* rewind() flushes the script as well */
  if (!run(files, error)) {
    return false;
  }
  if (lseek(fileno(files[PICTURE]), 0, SEEK_END) <= 0) {
    return fail(error, PROGRAM " drew nothing", "");
  }
  rewind(files[PICTURE]);
  return true;
}

static bool copy_to(FILE *from, const char *path) {
  char bytes[8192];
  size_t count;
  FILE *to = fopen(path, "wbe");
  if (to == NULL) {
    return false;
  }
  while ((count = fread(bytes, 1, sizeof bytes, from)) > 0) {
    fwrite(bytes, 1, count, to);
  }
  const bool good = !ferror(from) && !ferror(to);
  return fclose(to) == 0 && good;
}

bool cli_gnuplot(const char *path, size_t width, size_t height, cli_gnuplot_script *write,
                 const void *context, char error[CLI_GNUPLOT_ERROR_BYTES]) {
  FILE *files[FILES] = {NULL};
  bool good = open_all(files, error);
  if (good) {
    fputs("set terminal ", files[SCRIPT]);
    fprintf(files[SCRIPT], terminal_of(path), width, height);
    good = draw(files, write, context, error);
  }
  if (good && !copy_to(files[PICTURE], path)) {
    good = fail(error, "cannot write it", strerror(errno));
  }
  close_all(files);
  return good;
}

/* Copies gnuplot's pages. Form feeds become line ends if no line end is there; blanks at line ends
 * are left out. */
static void copy_text(FILE *from, FILE *to) {
  size_t blanks = 0;
  int last = '\n';
  for (int byte = fgetc(from); byte != EOF || last != '\n'; byte = fgetc(from)) {
    if (byte == ' ') {
      blanks++;
      continue;
    }
    const bool ends = byte == '\n' || byte == '\f' || byte == EOF;
    if (!ends) {
      fprintf(to, "%*s", (int)blanks, "");
    }
    blanks = 0;
    if (byte == '\n' || !ends || last != '\n') {
      last = ends ? '\n' : byte;
      fputc(last, to);
    }
  }
}

bool cli_gnuplot_text(FILE *to, bool coloured, size_t width, size_t height,
                      cli_gnuplot_script *write, const void *context,
                      char error[CLI_GNUPLOT_ERROR_BYTES]) {
  FILE *files[FILES] = {NULL};
  bool good = open_all(files, error);
  if (good) {
    fprintf(files[SCRIPT], "set terminal dumb nofeed size %zu,%zu %s noenhanced", width, height,
            coloured ? "ansi256" : "mono");
    good = draw(files, write, context, error);
  }
  if (good) {
    copy_text(files[PICTURE], to);
  }
  close_all(files);
  return good;
}
