/* dipole top: what a daemon does, looked at again and again. */
#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "clients/cli/cli.h"
#include "clients/cli/top_screen.h"
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

/* ---- the end, at any time ---------------------------------------------------------------------- */

static void block_end(int how) {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  sigprocmask(how, &signals, NULL);
}

/* Asking and waiting may take long, and leave nothing behind that would have to be put in order: so
 * that is when a signal ends the command, at once. What is written is written whole. */
static void on_end(int signal_number) {
  (void)signal_number;
  top_screen_restore();
  _exit(CLI_OK);
}

static void end_on_signals(void) {
  const struct sigaction action = {.sa_handler = on_end};
  sigaction(SIGINT, &action, NULL);
  sigaction(SIGTERM, &action, NULL);
}

/* ---- looking ----------------------------------------------------------------------------------- */

static bool look(const cli_command *command, dipole_client *client, top_look *one) {
  dipole_error error;
  if (!dipole_statistics(client, &one->values, &one->count, &error)) {
    cli_fail(command, "%s", error.text);
    return false;
  }
  one->at_s = now_s();
  return true;
}

/* The next look follows the last one. */
static void turn_over(top_record *record) {
  free(record->before.values);
  record->before = record->now;
  record->now = (top_look){0};
}

static void show(const char *format, const dipole_info *info, const top_record *record,
                 uint64_t number) {
  if (format == NULL || strcmp(format, "table") == 0) {
    if (top_screen_is_on()) {
      top_screen_show(info, record);
    } else {
      fputs(number > 0 ? "\n" : "", stdout);
      top_write_table(info, record, stdout);
    }
  } else if (strcmp(format, "csv") == 0) {
    top_write_csv(record, number == 0, stdout);
  } else {
    top_write_json(record, stdout);
  }
  fflush(stdout);
}

/* On a screen there is something to see at once: what has happened since the daemon's start. */
static void show_beginning(const dipole_info *info, top_record *record) {
  if (top_screen_is_on()) {
    record->interval_s = (double)top_value(record, "uptime_ms") / 1000;
    show(NULL, info, record, 0);
  }
}

static int watch(const cli_command *command, const top_settings *settings, dipole_client *client,
                 top_record *record) {
  const dipole_info *info = dipole_get_info(client);
  const double interval_s = settings->interval_s.value;
  if (!look(command, client, &record->now)) {
    return CLI_FAILED;
  }
  block_end(SIG_BLOCK);
  show_beginning(info, record);
  double next_s = record->now.at_s + interval_s;
  for (uint64_t i = 0; !settings->count.given || i < settings->count.value; i++) {
    turn_over(record);
    block_end(SIG_UNBLOCK);
    sleep_until(next_s);
    const bool looked = look(command, client, &record->now);
    block_end(SIG_BLOCK);
    if (!looked) {
      return CLI_FAILED;
    }
    next_s = fmax(next_s + interval_s, record->now.at_s);
    record->interval_s = record->now.at_s - record->before.at_s;
    show(settings->common.format, info, record, i);
    if (ferror(stdout)) {
      return CLI_FAILED; /* main says why */
    }
  }
  return CLI_OK;
}

/* ---- the command ------------------------------------------------------------------------------- */

static bool check(const cli_command *command, top_settings *settings, int *status) {
  cli_number *interval_s = &settings->interval_s;
  if (!interval_s->given) {
    interval_s->value = 1;
  }
  if (!(interval_s->value >= INTERVAL_LEAST_S && interval_s->value <= INTERVAL_MOST_S)) {
    *status = cli_fail_usage(command, "--interval: from %g to %g seconds", INTERVAL_LEAST_S,
                             INTERVAL_MOST_S);
    return false;
  }
  if (settings->count.given && settings->count.value == 0) {
    *status = cli_fail_usage(command, "--count: at least 1");
    return false;
  }
  return true;
}

static int run(const cli_command *command, int argc, char **argv) {
  top_settings settings = {0};
  top_record record = {0};
  dipole_client *client;
  const char *operand;
  int status;
  if (!cli_options_read(command, argc, argv, &settings, &operand, &status) ||
      !check(command, &settings, &status)) {
    return status;
  }
  if (!cli_open(command, &settings.common, &client)) {
    return CLI_FAILED;
  }
  const char *format = settings.common.format;
  end_on_signals();
  if (format == NULL || strcmp(format, "table") == 0) {
    top_screen_begin();
  }
  status = watch(command, &settings, client, &record);
  top_screen_restore();
  free(record.before.values);
  free(record.now.values);
  dipole_close(client);
  return status;
}

static const cli_option options[] = {
    {"How often", NULL, NULL, CLI_HEADING, 0},
    {"interval", "S", "seconds between two looks (default: 1)", CLI_NUMBER,
     offsetof(top_settings, interval_s)},
    {"count", "N", "end after N intervals (default: at Ctrl-C)", CLI_COUNT,
     offsetof(top_settings, count)},
    {0},
};

const cli_command cli_command_top = {
    .name = "top",
    .about = "Watch a daemon: requests, radii and bytes each second, latencies, queues",
    .more = "\nOn a terminal the table is shown anew in its place; Ctrl-C ends it. Elsewhere each\n"
            "interval is a table, a CSV line or a line of JSON. Names end with their units; those\n"
            "that end in _per_s are of the interval, latencies are of all requests since the\n"
            "daemon's start. NO_COLOR in the environment: no bold type.\n",
    .formats = "table,csv,json",
    .options = options,
    .examples = "  dipole top --connect unix:/tmp/dipoled.sock\n"
                "  dipole top --connect tcp:farm7:4817 --interval 60 --format csv > farm7.csv\n"
                "  dipole top --connect tcp:farm7:4817 --count 1 --format json\n",
    .run = run,
};
