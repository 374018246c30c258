/* gnuplot reads its script from one nameless file and writes the picture into a second and its
 * error messages into a third. So no shell sees a file name, and no picture is half written. */
#include "clients/cli/picture.h"

#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "clients/c/error.h"

#define PROGRAM "gnuplot"
#define PACKAGE "gnuplot-nox"
#define TERMINAL "-" /* text on standard output */

cli_curve *cli_picture_add(cli_picture *picture) {
  picture->curves = cli_resize(picture->curves, picture->count + 1, sizeof(cli_curve));
  cli_curve *curve = &picture->curves[picture->count++];
  *curve = (cli_curve){0};
  return curve;
}

static bool is_text(const char *path) {
  return strcmp(path, TERMINAL) == 0;
}

int cli_picture_check(const cli_texts *paths, const cli_settings *settings) {
  for (size_t i = 0; i < paths->count; i++) {
    const char *path = paths->items[i];
    if (is_text(path) && settings->form >= CLI_CSV) {
      return cli_fail_usage("--plot - draws onto standard output, where the %s goes: name a file, "
                            "or leave --format out",
                            settings->format);
    }
    if (!is_text(path) && !cli_ends_with(path, ".svg") && !cli_ends_with(path, ".png")) {
      return cli_fail_usage("--plot %s: the name must end in .svg or .png; - is the terminal",
                            path);
    }
  }
  return CLI_OK;
}

/* ---- the script ------------------------------------------------------------------------------ */

/* Writes a text as a string of gnuplot. All ASCII characters except letters, digits and blanks
 * become octal numbers, and control characters question marks, so that no text of a file or a
 * daemon can end the string. */
static void write_quoted(FILE *script, const char *text) {
  char clean[256];
  snprintf(clean, sizeof clean, "%s", text);
  libdipole_clean_text(clean);
  fputc('"', script);
  for (const char *at = clean; *at != '\0'; at++) {
    const bool bare = *at == ' ' || isalnum((unsigned char)*at) || (unsigned char)*at >= 0x80;
    fprintf(script, bare ? "%c" : "\\0%03o", (unsigned char)*at);
  }
  fputc('"', script);
}

static void write_string(FILE *script, const char *name, const char *text) {
  fprintf(script, "%s = ", name);
  write_quoted(script, text);
  fputc('\n', script);
}

static void write_number(FILE *script, double number, char after) {
  if (isfinite(number)) {
    fprintf(script, "%.17g%c", number, after);
  } else {
    fprintf(script, "NaN%c", after);
  }
}

/* Writes what differs from picture to picture: $data, which has a block for each curve of lines
 * place, value, its error, and the two of the lower panel; and the look of each curve. */
static void write_curves(FILE *script, const cli_picture *picture) {
  static const char *const colours[] = {"#0072b2", "#d55e00", "#009e73", "#cc79a7",
                                        "#e69f00", "#56b4e9", "#7f7f7f", "#8c564b",
                                        "#d62728", "#2ca02c", "#1f4fd8"};
  size_t lines = 0;
  fputs("$data << END\n", script);
  for (size_t c = 0; c < picture->count; c++) {
    const cli_curve *curve = &picture->curves[c];
    lines += curve->error == NULL;
    for (size_t i = 0; i < curve->count; i++) {
      write_number(script, curve->x[i], ' ');
      write_number(script, curve->y[i], ' ');
      write_number(script, curve->error != NULL ? curve->error[i] : 0, ' ');
      write_number(script, curve->lower != NULL ? curve->lower[i] : (double)NAN, ' ');
      write_number(script, curve->lower_error != NULL ? curve->lower_error[i] : 0, '\n');
    }
    fputs("\n\n", script);
  }
  fprintf(script, "END\nlines = %zu\ncurves = %zu\narray C[%zu]\narray D[%zu]\narray T[%zu]\n",
          lines, picture->count, picture->count, picture->count, picture->count);
  for (size_t c = 0; c < picture->count; c++) {
    const cli_curve *curve = &picture->curves[c];
    fprintf(script, "C[%zu] = '%s'\nD[%zu] = %u\nT[%zu] = ", c + 1,
            colours[curve->colour % (sizeof colours / sizeof colours[0])], c + 1, 1 + curve->dash,
            c + 1);
    write_quoted(script, curve->title);
    fputc('\n', script);
  }
}

/* What all pictures share. The variables that the lines above it set: text, lower (whether there is
 * a lower panel), legend (the width of the legend's texts as a share) and what is shown. */
static const char template[] =
    "set encoding utf8\n"
    "marks = '*o+x#@%&=$abcdefghijklmnpqrstuvwyzABCDEFGHIJKLMNOPQRSTUVWXYZ'\n"
    "mark(i) = marks[(i - 1) % strlen(marks) + 1 : (i - 1) % strlen(marks) + 1]\n"
    "set xlabel x_label\n"
    "set xzeroaxis lt 0\n"
    "set offsets graph 0.02, graph 0.02, 0, 0\n"
    "if (text) { set tmargin 1; set key below Left reverse; set title heading . ': ' . y_label }\n"
    "if (!text) { set grid; set ylabel y_label; set lmargin at screen 0.1;"
    " set rmargin at screen 0.97 - legend;"
    " set key at screen 0.99, screen 0.93 top right maxcols 1 Left reverse;"
    " set multiplot layout 1 + lower, 1 title heading }\n"
    "if (log_x) { set logscale x }\n"
    "if (log_y) { set logscale y; set format y '%.0e'; set yrange [least<*:*] }\n"
    "look = ' lc rgb C[i] title T[i]'\n"
    "drawn = 'for [i = 1 : lines] $data index i - 1 using 1:v smooth unique with '"
    " . (text ? 'linespoints lt 0 pt mark(i)' : 'lines lw 2 dt D[i]') . look\n"
    "marked = 'for [i = lines + 1 : curves] $data index i - 1 using 1:v' . (text ? ' with points"
    " pt mark(i)' : ':v + 1 with yerrorbars pt 7 ps 0.5') . look\n"
    "do for [panel = 0 : lower] {\n"
    "  v = 2 + 2 * panel\n"
    "  if (panel == 1) {\n"
    "    unset logscale y; set format y '%g'\n"
    "    if (most > 0) { set yrange [-most<*:*<most] } else { set yrange [*:*] }\n"
    "    if (text) { set title heading . ': ' . lower_label } else { unset key;"
    " set ylabel lower_label }\n"
    "  }\n"
    "  eval 'plot ' . (lines > 0 ? drawn : '') . (lines > 0 && lines < curves ? ', ' : '')"
    " . (lines < curves ? marked : '')\n"
    "}\n"
    "if (!text) { unset multiplot }\n";

/* On a logarithmic axis, values below this share of the largest are omitted. */
#define LEAST_SHARE 1e-12

enum { WIDTH = 900, HEIGHT = 540, HEIGHT_OF_TWO = 860, LEGEND_SAMPLE = 60, LEGEND_CHARACTER = 8 };

/* Returns the largest value that the axis shows; 0 if it shows none. */
static double largest(const cli_picture *picture) {
  double most = 0;
  for (size_t c = 0; c < picture->count; c++) {
    const cli_curve *curve = &picture->curves[c];
    for (size_t i = 0; i < curve->count; i++) {
      const bool shown = isfinite(curve->x[i]) && isfinite(curve->y[i]) &&
                         (!picture->logarithmic_x || curve->x[i] > 0) &&
                         (!picture->logarithmic_y || curve->y[i] > 0);
      most = shown ? fmax(most, fabs(curve->y[i])) : most;
    }
  }
  return most;
}

static void write_script(FILE *script, const cli_picture *picture, const char *path) {
  const cli_terminal terminal = cli_terminal_look();
  const bool text = is_text(path), png = cli_ends_with(path, ".png");
  size_t longest = 0;
  for (size_t c = 0; c < picture->count; c++) {
    longest = fmax((double)longest, (double)strlen(picture->curves[c].title));
  }
  if (text) {
    fprintf(script, "set terminal dumb nofeed size %zu,%zu %s noenhanced\n",
            terminal.columns > 32 ? terminal.columns : 32,
            terminal.rows > 15 ? terminal.rows - 2 : 13, terminal.styled ? "ansi256" : "mono");
  } else {
    fprintf(script, "set terminal %s size %d,%d background rgb 'white' font 'sans,%d' noenhanced\n",
            png ? "pngcairo" : "svg dynamic", WIDTH,
            picture->lower_label != NULL ? HEIGHT_OF_TWO : HEIGHT, png ? 11 : 14);
  }
  write_string(script, "heading", picture->title);
  write_string(script, "x_label", picture->x_label);
  write_string(script, "y_label", picture->y_label);
  write_string(script, "lower_label", picture->lower_label != NULL ? picture->lower_label : "");
  fprintf(script, "text = %d\nlower = %d\nlog_x = %d\nlog_y = %d\nleast = %.9g\nmost = %.9g\n",
          text, picture->lower_label != NULL, picture->logarithmic_x, picture->logarithmic_y,
          LEAST_SHARE * largest(picture), picture->lower_most);
  fprintf(script, "legend = %.4f\n",
          (LEGEND_SAMPLE + LEGEND_CHARACTER * (double)longest) / (double)WIDTH);
  write_curves(script, picture);
  fputs(template, script);
}

/* ---- drawing --------------------------------------------------------------------------------- */

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
    execlp(PROGRAM, PROGRAM, "-d", "-", (char *)NULL); /* -d: without the user's settings */
    _exit(NOT_THERE);
  }
  while (pid > 0 && waitpid(pid, &outcome, 0) < 0 && errno == EINTR) {
  }
  return pid > 0 && WIFEXITED(outcome) ? WEXITSTATUS(outcome) : -1;
}

/* Copies a picture. Of text, blanks at line ends are left out, and form feeds become line ends. */
static bool copy_picture(FILE *from, const char *path) {
  FILE *to = is_text(path) ? stdout : fopen(path, "wbe");
  if (to == NULL) {
    return false;
  }
  rewind(from);
  for (int byte, blanks = 0; (byte = fgetc(from)) != EOF;) {
    if (to == stdout && byte == ' ') {
      blanks++;
      continue;
    }
    byte = to == stdout && byte == '\f' ? '\n' : byte;
    fprintf(to, "%*s", byte == '\n' ? 0 : blanks, "");
    fputc(byte, to);
    blanks = 0;
  }
  return cli_file_end(to, path, !ferror(from) && !ferror(to));
}

static int draw_file(const cli_picture *picture, const char *path, FILE *const files[FILES]) {
  char complaints[512] = "";
  write_script(files[SCRIPT], picture, path);
  rewind(files[SCRIPT]); /* this flushes it as well */
  const int ended = run_program(files);
  if (ended == NOT_THERE) {
    return cli_fail("--plot %s: " PROGRAM " is not installed; install the package " PACKAGE, path);
  }
  if (ended != 0 || lseek(fileno(files[PICTURE]), 0, SEEK_END) <= 0) {
    rewind(files[COMPLAINTS]);
    complaints[fread(complaints, 1, sizeof complaints - 1, files[COMPLAINTS])] = '\0';
    return cli_fail("--plot %s: " PROGRAM " failed: %s", path, complaints);
  }
  return copy_picture(files[PICTURE], path)
             ? CLI_OK
             : cli_fail("--plot %s: cannot write it: %s", path, strerror(errno));
}

int cli_picture_draw(cli_picture *picture, const cli_texts *paths) {
  int status = CLI_OK;
  if (!(largest(picture) > 0)) {
    status = cli_fail("--plot: %s is 0, negative or infinite everywhere, which these axes do not "
                      "show: try other radii%s",
                      picture->y_label,
                      picture->logarithmic_y ? ", or `dipole plot --axes linear`" : "");
  }
  for (size_t i = 0; status == CLI_OK && i < paths->count; i++) {
    FILE *files[FILES] = {tmpfile(), tmpfile(), tmpfile()};
    const bool open = files[0] != NULL && files[1] != NULL && files[2] != NULL;
    status = open ? draw_file(picture, paths->items[i], files)
                  : cli_fail("--plot %s: cannot make a temporary file: %s", paths->items[i],
                             strerror(errno));
    for (int k = 0; open && k < FILES; k++) {
      fclose(files[k]);
    }
  }
  return status;
}
