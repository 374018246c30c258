/* R over r as a picture, drawn by gnuplot. gnuplot reads its script from one nameless file and
 * writes the picture into another and its complaints into a third, so that no shell, no quoting of
 * file names and no half-written picture are involved. */
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <spawn.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "clients/cli/eval.h"

#define PROGRAM "gnuplot"
#define PACKAGE "gnuplot-nox"

extern char **environ;

static const struct {
  const char *suffix;
  const char *terminal;
} formats[] = {
    {".svg", "svg size 900,600 dynamic background rgb 'white' font 'sans,14'"},
    {".png", "pngcairo size 900,600 background rgb 'white' font 'sans,11'"},
};

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

bool cli_plot_check(const cli_command *command, const char *path) {
  if (terminal_of(path) == NULL) {
    cli_fail_usage(command, "--plot %s: the name must end in .svg or .png", path);
    return false;
  }
  return true;
}

/* ---- the script ---------------------------------------------------------------------------- */

/* A text for gnuplot, which knows no escape within single quotes but the doubled quote. */
static void write_quoted(FILE *file, const char *text) {
  fputc('\'', file);
  for (; *text != '\0'; text++) {
    if (*text == '\'') {
      fputc('\'', file);
    }
    fputc(*text, file);
  }
  fputc('\'', file);
}

/* A radius and value that a logarithmic axis can show. */
static bool is_drawn(double r_mm, double R) {
  return isfinite(r_mm) && isfinite(R) && R > 0;
}

static size_t count_drawn(const cli_eval_report *report) {
  size_t drawn = 0;
  for (size_t p = 0; p < report->model_count * report->channel_count; p++) {
    const double *R = cli_eval_array(report, &report->values[p], DIPOLE_R);
    for (size_t i = 0; i < report->radius_count; i++) {
      drawn += is_drawn(report->radii[i], R[i]);
    }
  }
  return drawn;
}

/* The points of each line as a named block. A line has at least one, if only an undefined one. */
static void write_data(FILE *script, const cli_eval_report *report) {
  for (size_t p = 0; p < report->model_count * report->channel_count; p++) {
    const double *R = cli_eval_array(report, &report->values[p], DIPOLE_R);
    fprintf(script, "$line%zu << END\n", p);
    for (size_t i = 0; i < report->radius_count; i++) {
      if (is_drawn(report->radii[i], R[i])) {
        fprintf(script, "%.17g %.17g\n", report->radii[i], R[i]);
      } else {
        fputs("NaN NaN\n", script);
      }
    }
    fputs("END\n", script);
  }
}

static const char *colour_of(const cli_eval_report *report, size_t channel) {
  static const char *const rgb[] = {"#d62728", "#2ca02c", "#1f4fd8"};
  static const char *const others[] = {"#000000", "#e69f00", "#56b4e9", "#009e73",
                                       "#cc79a7", "#d55e00", "#0072b2", "#999999"};
  return report->channel_count == 3 ? rgb[channel]
                                    : others[channel % (sizeof others / sizeof others[0])];
}

static void write_lines(FILE *script, const cli_eval_report *report) {
  char title[128];
  fputs("plot ", script);
  for (size_t p = 0; p < report->model_count * report->channel_count; p++) {
    const size_t model = p / report->channel_count, channel = p % report->channel_count;
    fprintf(script, "%s$line%zu using 1:2 with ", p > 0 ? ", " : "", p);
    fprintf(script, report->radius_count > 1 ? "lines dt %zu" : "points pt %zu", model + 1);
    fprintf(script, " lw 2 lc rgb '%s' title ", colour_of(report, channel));
    snprintf(title, sizeof title, "%s, %s%s", report->models[model]->name,
             report->medium != NULL ? "" : "channel ", report->channels[channel].name);
    write_quoted(script, title);
  }
  fputc('\n', script);
}

static void write_script(FILE *script, const cli_eval_report *report, const char *terminal,
                         bool logarithmic_r) {
  char label[96];
  fprintf(script, "set terminal %s noenhanced\nset encoding utf8\n", terminal);
  fputs("set logscale y\nset format y '%.0e'\nset grid\nset key top right\n", script);
  fputs(logarithmic_r ? "set logscale x\n" : "", script);
  fputs("set xlabel 'r (mm)'\nset ylabel ", script);
  snprintf(label, sizeof label, "R (%s)", report->info->R_unit);
  write_quoted(script, label);
  fputs("\nset title ", script);
  write_quoted(script, report->medium != NULL ? report->medium : "R(r)");
  fputc('\n', script);
  write_data(script, report);
  write_lines(script, report);
}

/* ---- drawing ------------------------------------------------------------------------------- */

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
                    "--plot %s: " PROGRAM " is not installed; install the package " PACKAGE, path);
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

/* Radii in equal ratios are evenly spread on a logarithmic axis only. */
static bool has_equal_ratios(const cli_eval_report *report) {
  const double *r = report->radii;
  const size_t n = report->radius_count;
  return n > 2 && r[0] > 0 && isfinite(r[n - 1]) && r[n - 1] > r[0] &&
         fabs(r[1] / r[0] / (r[n - 1] / r[n - 2]) - 1) < 1e-3;
}

int cli_plot(const cli_command *command, const cli_eval_report *report, const char *path) {
  FILE *files[FILES] = {NULL};
  int status = CLI_OK;
  if (count_drawn(report) == 0) {
    return cli_fail(command, "--plot %s: R is 0 at every radius: a logarithmic axis shows nothing",
                    path);
  }
  for (int i = 0; status == CLI_OK && i < FILES; i++) {
    files[i] = tmpfile();
    if (files[i] == NULL || fcntl(fileno(files[i]), F_SETFD, FD_CLOEXEC) != 0) {
      status =
          cli_fail(command, "--plot %s: cannot make a temporary file: %s", path, strerror(errno));
    }
  }
  if (status == CLI_OK) {
    write_script(files[SCRIPT], report, terminal_of(path), has_equal_ratios(report));
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
