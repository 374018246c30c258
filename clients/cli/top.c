/* dipole top: shows again and again what a daemon does. */
#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "clients/cli/daemon.h"
#include "clients/cli/terminal.h"
#include "clients/cli/top_write.h"

#define INTERVAL_LEAST_S 0.05
#define INTERVAL_MOST_S 86400.0

typedef struct top_settings {
  cli_common common;
  cli_number interval_s;
  cli_count count;
} top_settings;

static double now_s(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + (double)now.tv_nsec / 1e9;
}

static void sleep_until(double at_s) {
  const struct timespec at = {.tv_sec = (time_t)at_s,
                              .tv_nsec = (long)((at_s - floor(at_s)) * 1e9)};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL) != 0) {
  }
}

/* ---- the screen: the terminal on which the table is shown again and again in one place ------- */

#define CLEAR "\033[2J"
#define HOME "\033[H"
#define CLEAR_LINE_REST "\033[K"
#define CLEAR_BELOW "\033[J"
#define HIDE_CURSOR "\033[?25l"
#define SHOW_CURSOR "\033[?25h"
#define BOLD "\033[1m"
#define NOT_BOLD "\033[0m"

static volatile sig_atomic_t has_screen;

/* Takes the screen if standard output is a terminal. */
static void begin_screen(void) {
  if (isatty(STDOUT_FILENO) == 1) {
    has_screen = 1;
    fputs(HIDE_CURSOR CLEAR, stdout);
  }
}

/* Gives the terminal back with the last table on it. A signal's handler may call this. */
static void restore_screen(void) {
  if (has_screen) {
    has_screen = 0;
    const ssize_t written = write(STDOUT_FILENO, SHOW_CURSOR, strlen(SHOW_CURSOR));
    (void)written; /* if it fails, the terminal is gone */
  }
}

/* Draws as much of a text as the terminal has room for, from its upper left corner. The first line
 * is bold. The last line of the terminal is left for the cursor. */
static void draw(const char *text) {
  const cli_terminal terminal = cli_terminal_look();
  const size_t columns = terminal.columns, rows = terminal.rows > 1 ? terminal.rows - 1 : 1;
  fputs(HOME, stdout);
  for (size_t row = 0; row < rows && *text != '\0'; row++) {
    const size_t length = strcspn(text, "\n");
    const bool bold = row == 0 && terminal.styled;
    printf("%s%.*s%s" CLEAR_LINE_REST "\n", bold ? BOLD : "",
           (int)(length < columns ? length : columns), text, bold ? NOT_BOLD : "");
    text += length + (text[length] == '\n');
  }
  fputs(CLEAR_BELOW, stdout);
}

static void show_on_screen(const dipole_info *info, const top_record *record) {
  char *text = NULL;
  size_t bytes = 0;
  FILE *file = open_memstream(&text, &bytes);
  if (file != NULL) {
    top_write_table(info, record, file);
    if (fclose(file) == 0) {
      draw(text);
    }
    free(text);
  }
}

/* ---- the end, at any time ---------------------------------------------------------------------- */

static void block_end(int how) {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  sigprocmask(how, &signals, NULL);
}

/* A signal ends the command at once, but only while it asks or waits, which may take long. So every
 * table is written whole, and there is nothing to tidy up but the screen. */
static void on_end(int signal_number) {
  (void)signal_number;
  restore_screen();
  _exit(CLI_OK);
}

static void end_on_signals(void) {
  const struct sigaction action = {.sa_handler = on_end};
  sigaction(SIGINT, &action, NULL);
  sigaction(SIGTERM, &action, NULL);
}

/* ---- looking ----------------------------------------------------------------------------------- */

static bool look(dipole_client *client, top_look *one) {
  dipole_error error;
  if (!dipole_statistics(client, &one->values, &one->count, &error)) {
    cli_fail_error(&error);
    return false;
  }
  one->at_s = now_s();
  return true;
}

/* Makes the later look the earlier one. */
static void turn_over(top_record *record) {
  free(record->before.values);
  record->before = record->now;
  record->now = (top_look){0};
}

static void show(enum cli_form form, const dipole_info *info, const top_record *record,
                 uint64_t number) {
  if (form == CLI_TABLE) {
    if (has_screen) {
      show_on_screen(info, record);
    } else {
      fputs(number > 0 ? "\n" : "", stdout);
      top_write_table(info, record, stdout);
    }
  } else if (form == CLI_CSV) {
    top_write_csv(record, number == 0, stdout);
  } else {
    top_write_json(record, stdout);
  }
  fflush(stdout);
}

/* On a screen, shows at once what has happened since the daemon's start. */
static void show_beginning(const dipole_info *info, top_record *record) {
  if (has_screen) {
    record->interval_s = (double)top_value(record, "uptime_ms") / 1000;
    show(CLI_TABLE, info, record, 0);
  }
}

static int watch(const top_settings *settings, dipole_client *client, top_record *record) {
  const dipole_info *info = dipole_get_info(client);
  const double interval_s = settings->interval_s.value;
  if (!look(client, &record->now)) {
    return CLI_FAILED;
  }
  block_end(SIG_BLOCK);
  show_beginning(info, record);
  double next_s = record->now.at_s + interval_s;
  for (uint64_t i = 0; !settings->count.given || i < settings->count.value; i++) {
    turn_over(record);
    block_end(SIG_UNBLOCK);
    sleep_until(next_s);
    const bool looked = look(client, &record->now);
    block_end(SIG_BLOCK);
    if (!looked) {
      return CLI_FAILED;
    }
    next_s = fmax(next_s + interval_s, record->now.at_s);
    record->interval_s = record->now.at_s - record->before.at_s;
    show(settings->common.form, info, record, i);
    if (ferror(stdout)) {
      return CLI_FAILED; /* main() will say why */
    }
  }
  return CLI_OK;
}

/* ---- the command ------------------------------------------------------------------------------- */

static int check(void *given) {
  const top_settings *settings = given;
  const double interval_s = settings->interval_s.value;
  if (!(interval_s >= INTERVAL_LEAST_S && interval_s <= INTERVAL_MOST_S)) {
    return cli_fail_usage("--interval: give a number from %g to %g seconds", INTERVAL_LEAST_S,
                          INTERVAL_MOST_S);
  }
  return !settings->count.given || settings->count.value > 0
             ? CLI_OK
             : cli_fail_usage("--count: give at least 1");
}

static int run(void *given, dipole_client *client) {
  const top_settings *settings = given;
  top_record record = {0};
  end_on_signals();
  if (settings->common.form == CLI_TABLE) {
    begin_screen();
  }
  const int status = watch(settings, client, &record);
  restore_screen();
  free(record.before.values);
  free(record.now.values);
  return status;
}

static const cli_option options[] = {
    {"How often", NULL, NULL, CLI_HEADING, 0, NULL},
    {"interval", "S", "seconds between two tables (default: 1)", CLI_NUMBER,
     offsetof(top_settings, interval_s), "1"},
    {"count", "N", "end after N intervals (default: only at Ctrl-C)", CLI_COUNT,
     offsetof(top_settings, count), NULL},
    {0},
};

const cli_command cli_command_top = {
    .name = "top",
    .about = "Watch a daemon: requests, radii and bytes each second, latencies, queues",
    .more =
        "\nOn a terminal, each table takes the place of the one before; Ctrl-C ends the command.\n"
        "Elsewhere, each interval gives a table, a line of CSV or a line of JSON. Names end\n"
        "with their units. Those that end in _per_s are rates over the interval. Latencies\n"
        "are those of all requests since the daemon's start. If NO_COLOR is set, there is no\n"
        "bold type.\n",
    .formats = "table,csv,json",
    .options = options,
    .examples = "  dipole top --connect unix:/tmp/dipoled.sock\n"
                "  dipole top --connect tcp:farm7:4817 --interval 60 --format csv > farm7.csv\n"
                "  dipole top --connect tcp:farm7:4817 --count 1 --format json\n",
    .settings_bytes = sizeof(top_settings),
    .check = check,
    .run = run,
};
