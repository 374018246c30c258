/* dipole top: shows a daemon's statistics at regular intervals. */
#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "clients/cli/daemon.h"
#include "clients/cli/rows.h"

#define INTERVAL_LEAST_S 0.05
#define INTERVAL_MOST_S 86400.0

/* The statistics at one moment. */
typedef struct top_look {
  dipole_value *values; /* to be freed */
  size_t count;         /* 0: not known */
  double at_s;          /* time of a monotonic clock in s */
} top_look;

enum { LISTED_MAX = 256 };

typedef struct top_run {
  const cli_settings *settings;
  dipole_client *client; /* the present client; NULL while the daemon is gone */
  dipole_client *given;  /* the first client, which the caller closes */
  bool has_screen;       /* whether the table is redrawn in one place of a terminal */
  double gone_s;         /* when the daemon was lost, in s; 0 while it is there */
  top_look before; /* the statistics before; unknown at first: the table then shows `now` only */
  top_look now;
  double interval_s;
  size_t listed_count;
  size_t listed[LISTED_MAX]; /* indices of the statistics that are shown */
} top_run;

static double now_s(void) {
  return (double)cli_now_ns() / 1e9;
}

/* ---- statistics ------------------------------------------------------------------------------ */

static uint64_t find_value(const top_look *look, const char *name) {
  for (size_t i = 0; i < look->count; i++) {
    if (strcmp(look->values[i].name, name) == 0) {
      return look->values[i].value;
    }
  }
  return 0;
}

/* Returns whether a statistic is a state and no count, so that it has no rate. */
static bool is_state(const char *name) {
  static const char *const endings[] = {"_open",       "queued_connections",
                                        "owed_radii",  "cache_entries",
                                        "cache_bytes", "buffer_bytes",
                                        "uptime_ms",   "_p50_us",
                                        "_p90_us",     "_p99_us",
                                        "_p999_us",    "_max_us"};
  for (size_t i = 0; i < sizeof endings / sizeof endings[0]; i++) {
    if (strcmp(name, endings[i]) == 0 || cli_ends_with(name, endings[i])) {
      return true;
    }
  }
  return false;
}

/* Returns by how much a statistic has risen each second; NaN if it is a state. */
static double rate(const top_run *of, const dipole_value *now) {
  const uint64_t before = find_value(&of->before, now->name);
  return is_state(now->name)   ? (double)NAN
         : now->value < before ? 0
         : of->interval_s > 0  ? (double)(now->value - before) / of->interval_s
                               : 0;
}

/* Lists the statistics that people see: states, without quantiles that are 0 or of less interest,
 * and what has risen. Programs get all of them, always in the same order. */
static void list(top_run *of) {
  of->listed_count = 0;
  for (size_t i = 0; i < of->now.count && of->listed_count < LISTED_MAX; i++) {
    const dipole_value *one = &of->now.values[i];
    const bool quantile = cli_ends_with(one->name, "_us"),
               latency = strncmp(one->name, "lat", 3) == 0;
    const bool shown = quantile ? one->value > 0 && (cli_ends_with(one->name, "_p50_us") ||
                                                     cli_ends_with(one->name, "_p99_us"))
                                : !latency && !(rate(of, one) <= 0);
    if (of->settings->form != CLI_TABLE || shown) {
      of->listed[of->listed_count++] = i;
    }
  }
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Writes a number with three figures, such as 950, 12.3 k or 4.56 M; "" for NaN. */
static const char *figures(double value, bool is_count, char text[32]) {
  static const char *const units[] = {"", " k", " M", " G", " T", " P"};
  size_t unit = 0;
  while (value >= 999.5 && unit + 1 < sizeof units / sizeof units[0]) {
    value /= 1000;
    unit++;
  }
  const bool is_whole = value >= 99.95 || value <= 0 || (is_count && unit == 0);
  snprintf(text, 32, "%.*f%s", is_whole ? 0 : value >= 9.995 ? 1 : 2, value, units[unit]);
  return isnan(value) ? "" : text;
}

static void put_statistic(cli_rows *rows, const void *context, size_t index) {
  static const dipole_value none = {.name = ""};
  const top_run *of = context;
  const dipole_value *one = index < of->listed_count ? &of->now.values[of->listed[index]] : &none;
  const double now = (double)one->value, per_s = rate(of, one);
  const unsigned programs = CLI_IN_CSV | CLI_IN_JSON;
  char text[32];
  cli_put_number(rows, (double)find_value(&of->now, "uptime_ms"), "uptime_ms", .forms = programs);
  cli_put_number(rows, of->interval_s, "interval_s", .forms = programs);
  cli_put_text(rows, one->name, "statistic");
  cli_put_shown(rows, now, figures(now, true, text), "now");
  cli_put_shown(rows, per_s, figures(per_s, false, text), "per_s", "each second");
}

/* Writes a table for people. */
static void write_table(const top_run *of, FILE *file) {
  const dipole_info *info = dipole_get_info(of->given);
  const uint64_t up_s = find_value(&of->now, "uptime_ms") / 1000;
  fprintf(file, "%s at %s: up %llu:%02u:%02u, %u workers, %s\n", info->software, info->address,
          (unsigned long long)(up_s / 3600), (unsigned)(up_s / 60 % 60), (unsigned)(up_s % 60),
          info->workers, info->instruction_set);
  if (of->before.count > 0) {
    fprintf(file, "over the last %.1f s\n\n", of->interval_s);
  } else {
    fputs("since its start\n\n", file);
  }
  cli_rows_print(file, 1, of->listed_count, put_statistic, of);
}

/* ---- the screen ------------------------------------------------------------------------------ */

#define CLEAR "\033[2J"
#define HOME "\033[H"
#define CLEAR_LINE_REST "\033[K"
#define CLEAR_BELOW "\033[J"
#define HIDE_CURSOR "\033[?25l"
#define SHOW_CURSOR "\033[?25h"
#define BOLD "\033[1m"
#define NOT_BOLD "\033[0m"

/* Draws as much of a text as the terminal has room for, from its upper left corner. Lines that are
 * too long go on in the next row. The first row is bold. The last row of the terminal is left for
 * the cursor. */
static void draw_screen(const char *text) {
  const cli_terminal terminal = cli_terminal_look();
  const size_t columns = terminal.columns, rows = terminal.rows > 1 ? terminal.rows - 1 : 1;
  fputs(HOME, stdout);
  for (size_t row = 0; row < rows && *text != '\0'; row++) {
    const size_t all = strcspn(text, "\n"), length = all < columns ? all : columns;
    const bool bold = row == 0 && terminal.styled;
    printf("%s%.*s%s" CLEAR_LINE_REST "\n", bold ? BOLD : "", (int)length, text,
           bold ? NOT_BOLD : "");
    text += length + (text[length] == '\n');
  }
  fputs(CLEAR_BELOW, stdout);
}

static void show_on_screen(const top_run *of) {
  char *text = NULL;
  size_t bytes = 0;
  FILE *file = open_memstream(&text, &bytes);
  if (file != NULL) {
    write_table(of, file);
    if (fclose(file) == 0) {
      draw_screen(text);
    }
    free(text);
  }
}

/* Replaces the numbers on the screen by the reason why there are none. */
static void show_gone(const top_run *of, const dipole_error *error) {
  char text[512];
  const char *address = of->settings->connect;
  snprintf(text, sizeof text,
           "No reply from %s for %.0f s\n%s\n\nTrying again. Ctrl-C ends this.\n",
           address != NULL ? address : dipole_get_info(of->given)->address, now_s() - of->gone_s,
           error->text);
  draw_screen(text);
}

/* Shows one interval, or on a screen what was since the daemon's start. */
static void show_look(top_run *of, bool first) {
  list(of);
  if (of->has_screen) {
    show_on_screen(of);
  } else if (of->settings->form == CLI_TABLE) {
    fputs(first ? "" : "\n", stdout);
    write_table(of, stdout);
  } else if (of->settings->form == CLI_CSV) {
    cli_rows_csv(first, of->listed_count, put_statistic, of);
  }
  for (size_t i = 0; of->settings->form == CLI_JSON && i < of->listed_count; i++) {
    cli_rows_object(put_statistic, of, i);
    putchar('\n');
  }
}

/* ---- requests -------------------------------------------------------------------------------- */

enum { REPLY_MS = 2000 }; /* how long the daemon may take before the screen says that it is gone */

static bool connect_again(top_run *of, dipole_error *error) {
  dipole_options options;
  cli_connection_options(of->settings, &options);
  options.retry_ms = 0;
  options.connect_timeout_ms = REPLY_MS;
  return dipole_open_with(of->settings->connect, &options, &of->client, error);
}

static void forget(top_run *of) {
  if (of->client != of->given) {
    dipole_close(of->client);
  }
  of->client = NULL;
}

/* Looks at the daemon. If it does not reply, says so and returns false; on a screen, numbers that
 * are out of date do not stay. */
static bool look(top_run *of) {
  dipole_error error;
  free(of->before.values);
  of->before = of->now;
  of->now = (top_look){0};
  if (of->client != NULL && of->has_screen) {
    dipole_set_retry_ms(of->client, 0);
    dipole_set_timeout_ms(of->client, REPLY_MS);
  }
  if ((of->client != NULL || connect_again(of, &error)) &&
      dipole_statistics(of->client, &of->now.values, &of->now.count, &error)) {
    of->gone_s = 0;
    of->now.at_s = now_s();
    of->interval_s = of->before.count > 0 ? of->now.at_s - of->before.at_s
                                          : (double)find_value(&of->now, "uptime_ms") / 1000;
    return true;
  }
  if (!of->has_screen) {
    cli_fail_error(&error);
    return false;
  }
  of->gone_s = of->gone_s > 0 ? of->gone_s : now_s();
  forget(of);
  show_gone(of, &error);
  return false;
}

/* Waits until a time. Returns whether SIGINT or SIGTERM, which are blocked, ended the waiting: they
 * come between two tables, so that every table is whole. */
static bool is_ended_until(double at_s) {
  sigset_t ends;
  sigemptyset(&ends);
  sigaddset(&ends, SIGINT);
  sigaddset(&ends, SIGTERM);
  sigprocmask(SIG_BLOCK, &ends, NULL);
  const double left_s = fmax(at_s - now_s(), 0);
  const struct timespec left = {.tv_sec = (time_t)left_s,
                                .tv_nsec = (long)((left_s - floor(left_s)) * 1e9)};
  return sigtimedwait(&ends, NULL, &left) > 0;
}

/* Looks at the beginning and after each interval. Returns an exit status. */
static int watch_daemon(top_run *of) {
  const cli_settings *settings = of->settings;
  bool looked, first = true;
  double next_s = now_s();
  for (uint64_t i = 0;; i++) {
    looked = look(of);
    if ((!looked && !of->has_screen) || ferror(stdout)) { /* main() reports the error */
      return CLI_FAILED;
    }
    if (looked && (of->has_screen || of->before.count > 0)) {
      show_look(of, first);
      first = false;
    }
    fflush(stdout);
    next_s = fmax(next_s + settings->interval.value, now_s());
    if (settings->count.given && i == settings->count.value) {
      return looked ? CLI_OK : CLI_FAILED;
    }
    if (is_ended_until(next_s)) {
      return CLI_OK;
    }
  }
}

/* ---- the command ----------------------------------------------------------------------------- */

static int check(cli_settings *settings) {
  const double interval_s = settings->interval.value;
  if (!(interval_s >= INTERVAL_LEAST_S && interval_s <= INTERVAL_MOST_S)) {
    return cli_fail_usage("--interval: give a number from %g to %g seconds", INTERVAL_LEAST_S,
                          INTERVAL_MOST_S);
  }
  return !settings->count.given || settings->count.value > 0
             ? CLI_OK
             : cli_fail_usage("--count: give at least 1");
}

static int run_top(const cli_settings *settings, dipole_client *client) {
  top_run of = {.settings = settings,
                .client = client,
                .given = client,
                .has_screen = settings->form == CLI_TABLE && isatty(STDOUT_FILENO) == 1};
  if (of.has_screen) {
    is_ended_until(0); /* from here on, the cursor is restored at any exit */
    fputs(HIDE_CURSOR CLEAR, stdout);
  }
  const int status = watch_daemon(&of);
  fputs(of.has_screen ? SHOW_CURSOR : "", stdout);
  forget(&of);
  free(of.before.values);
  free(of.now.values);
  return status;
}

static const cli_option options[] = {
    CLI_TITLE("How often"),
    CLI_OPTION(NUMBER, interval, "1", "seconds between two tables"),
    CLI_OPTION(COUNT, count, NULL, "end after N intervals (default: only at Ctrl-C)"),
    {0},
};

const cli_command cli_command_top = {
    .name = "top",
    .about = "Watch a daemon: requests, radii and bytes each second, latencies, queues",
    .more = "On a terminal, each table takes the place of the one before; Ctrl-C ends the command. "
            "While the daemon does not reply, its reason stands there, and `top` tries again. "
            "Elsewhere, each interval gives a table, or a line of CSV or JSON for each statistic. "
            "Names end with their units; per_s is the rate over the interval. Latencies are those "
            "of all requests since the daemon's start. Tables leave out what has not risen.",
    .formats = "table,csv,json",
    .options = {options},
    .examples = "  dipole top --connect unix:/tmp/dipoled.sock\n"
                "  dipole top --connect tcp:farm7:4817 --interval 60 --format csv > farm7.csv\n"
                "  dipole top --connect tcp:farm7:4817 --count 1 --format json\n",
    .shows_service = true,
    .check = check,
    .run = run_top,
};
