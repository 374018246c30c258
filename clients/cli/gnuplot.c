/* gnuplot reads its script from one nameless file and writes the picture into another and its
 * complaints into a third, so that no shell, no quoting of file names and no half-written picture
 * are involved. */
#include "clients/cli/gnuplot.h"

#include <errno.h>
#include <fcntl.h>
#include <spawn.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#define PROGRAM "gnuplot"
#define PACKAGE "gnuplot-nox"

extern char **environ;

typedef struct picture_format {
  const char *suffix;
  const char *terminal; /* with the size in pixels, and fonts of about the same size */
} picture_format;

static const picture_format formats[] = {
    {".svg", "svg size %zu,%zu dynamic background rgb 'white' font 'sans,14' noenhanced"},
    {".png", "pngcairo size %zu,%zu background rgb 'white' font 'sans,11' noenhanced"},
};

static const picture_format *format_of(const char *path) {
  const size_t length = strlen(path);
  for (size_t i = 0; i < sizeof formats / sizeof formats[0]; i++) {
    const size_t suffix = strlen(formats[i].suffix);
    if (length > suffix && strcmp(path + length - suffix, formats[i].suffix) == 0) {
      return &formats[i];
    }
  }
  return NULL;
}

bool cli_gnuplot_draws(const char *path) {
  return format_of(path) != NULL;
}

bool cli_gnuplot_check(const cli_command *command, const char *path) {
  if (!cli_gnuplot_draws(path)) {
    cli_fail_usage(command, "--plot %s: the name must end in .svg or .png", path);
    return false;
  }
  return true;
}

/* ---- the script ---------------------------------------------------------------------------- */

/* gnuplot knows no escape within single quotes but the doubled quote. */
void cli_gnuplot_text(FILE *script, const char *text) {
  fputc('\'', script);
  for (; *text != '\0'; text++) {
    if (*text == '\'') {
      fputc('\'', script);
    }
    fputc(*text, script);
  }
  fputc('\'', script);
}

/* The nameless files that gnuplot works with, in the order of its standard streams. */
enum { SCRIPT, PICTURE, COMPLAINTS, FILES };

/* 0, an errno, or -1 when gnuplot failed. */
static int run_gnuplot(FILE *const files[FILES]) {
  char *arguments[] = {PROGRAM, "-", NULL};
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

static bool copy(FILE *from, FILE *to) {
  char bytes[8192];
  size_t count;
  rewind(from);
  while ((count = fread(bytes, 1, sizeof bytes, from)) > 0) {
    fwrite(bytes, 1, count, to);
  }
  return !ferror(from) && !ferror(to);
}

static bool copy_to(FILE *from, const char *path) {
  FILE *to = fopen(path, "wbe");
  if (to == NULL) {
    return false;
  }
  const bool good = copy(from, to);
  return fclose(to) == 0 && good;
}

static int draw(const cli_command *command, FILE *const files[FILES], const char *path) {
  const int fault = run_gnuplot(files);
  if (fault == ENOENT) {
    return cli_fail(command,
                    "--plot %s: " PROGRAM " is not installed; install the package " PACKAGE
                    " (`dipole plot` and `dipole eval` draw in the terminal with --plot -)",
                    path);
  }
  if (fault != 0) {
    copy(files[COMPLAINTS], stderr);
    return cli_fail(command, "--plot %s: " PROGRAM " failed%s%s", path, fault > 0 ? ": " : "",
                    fault > 0 ? strerror(fault) : "");
  }
  fseek(files[PICTURE], 0, SEEK_END);
  if (ftell(files[PICTURE]) <= 0) {
    return cli_fail(command, "--plot %s: " PROGRAM " drew nothing", path);
  }
  if (!copy_to(files[PICTURE], path)) {
    return cli_fail(command, "--plot %s: cannot write it: %s", path, strerror(errno));
  }
  return CLI_OK;
}

int cli_gnuplot(const cli_command *command, const char *path, size_t width, size_t height,
                cli_gnuplot_script *write, const void *context) {
  FILE *files[FILES] = {NULL};
  int status = CLI_OK;
  for (int i = 0; status == CLI_OK && i < FILES; i++) {
    files[i] = tmpfile();
    if (files[i] == NULL || fcntl(fileno(files[i]), F_SETFD, FD_CLOEXEC) != 0) {
      status =
          cli_fail(command, "--plot %s: cannot make a temporary file: %s", path, strerror(errno));
    }
  }
  if (status == CLI_OK) {
    fputs("set terminal ", files[SCRIPT]);
    fprintf(files[SCRIPT], format_of(path)->terminal, width, height);
    fputs("\nset encoding utf8\n", files[SCRIPT]);
    write(files[SCRIPT], context);
    fflush(files[SCRIPT]);
    rewind(files[SCRIPT]);
    status = draw(command, files, path);
  }
  for (int i = 0; i < FILES; i++) {
    if (files[i] != NULL) {
      fclose(files[i]);
    }
  }
  return status;
}
