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
  double at_s;          /* by a monotonic clock */
} top_look;

typedef struct top_record {
  const dipole_info *info;
  top_look before; /* not known: now is shown by itself, or since the daemon's start */
  top_look now;
  double interval_s;
  size_t listed_count;
  size_t listed[256]; /* positions of the statistics that are shown */
} top_record;

/* ---- statistics ------------------------------------------------------------------------------ */

static uint64_t find(const top_look *look, const char *name) {
  for (size_t i = 0; i < look->count; i++) {
    if (strcmp(look->values[i].name, name) == 0) {
      return look->values[i].value;
    }
  }
  return 0;
}

static bool ends_with(const char *name, const char *ending) {
  const size_t length = strlen(name), end = strlen(ending);
  return length >= end && strcmp(name + length - end, ending) == 0;
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
    if (ends_with(name, endings[i])) {
      return true;
    }
  }
  return false;
}

/* Returns by how much a statistic has risen each second; NaN if it is a state. */
static double rate(const top_record *record, const dipole_value *now) {
  const uint64_t before = find(&record->before, now->name);
  return is_state(now->name)      ? (double)NAN
         : now->value < before    ? 0
         : record->interval_s > 0 ? (double)(now->value - before) / record->interval_s
                                  : 0;
}

/* Lists the statistics that people see: states, without quantiles that are 0 or of less interest,
 * and what has risen. Programs get all of them, always in the same order. */
static void list(top_record *record, enum cli_form form) {
  record->listed_count = 0;
  for (size_t i = 0; i < record->now.count && record->listed_count < 256; i++) {
    const dipole_value *one = &record->now.values[i];
    const bool quantile = ends_with(one->name, "_us"), latency = strncmp(one->name, "lat", 3) == 0;
    const bool shown = quantile ? one->value > 0 && (ends_with(one->name, "_p50_us") ||
                                                     ends_with(one->name, "_p99_us"))
                                : !latency && !(rate(record, one) <= 0);
    if (form != CLI_TABLE || shown) {
      record->listed[record->listed_count++] = i;
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
  const top_record *record = context;
  const dipole_value *one =
      index < record->listed_count ? &record->now.values[record->listed[index]] : &none;
  const double now = (double)one->value, per_s = rate(record, one);
  const unsigned programs = CLI_IN_CSV | CLI_IN_JSON;
  char text[32];
  cli_put_number(rows, CLI_COLUMN("uptime_ms", .forms = programs),
                 (double)find(&record->now, "uptime_ms"));
  cli_put_number(rows, CLI_COLUMN("interval_s", .forms = programs), record->interval_s);
  cli_put_text(rows, CLI_COLUMN("statistic"), one->name);
  cli_put_shown(rows, CLI_COLUMN("now"), now, figures(now, true, text));
  cli_put_shown(rows, CLI_COLUMN("per_s", "each second"), per_s, figures(per_s, false, text));
}

/* Writes a table for people. */
static void write_table(const top_record *record, FILE *file) {
  const dipole_info *info = record->info;
  const uint64_t up_s = find(&record->now, "uptime_ms") / 1000;
  fprintf(file, "%s at %s: up %llu:%02u:%02u, %u workers, %s\n", info->software, info->address,
          (unsigned long long)(up_s / 3600), (unsigned)(up_s / 60 % 60), (unsigned)(up_s % 60),
          info->workers, info->instruction_set);
  if (record->before.count > 0) {
    fprintf(file, "over the last %.1f s\n\n", record->interval_s);
  } else {
    fputs("since its start\n\n", file);
  }
  cli_rows_print(file, 1, record->listed_count, put_statistic, record);
}

/* ---- time ------------------------------------------------------------------------------------ */

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

/* Clears the terminal and hides its cursor, if standard output is a terminal. */
static void begin_screen(void) {
  if (isatty(STDOUT_FILENO) == 1) {
    has_screen = 1;
    fputs(HIDE_CURSOR CLEAR, stdout);
  }
}

/* Shows the cursor again and leaves the last table in place. A signal handler may call this. */
static void restore_screen(void) {
  if (has_screen) {
    has_screen = 0;
    const ssize_t written = write(STDOUT_FILENO, SHOW_CURSOR, strlen(SHOW_CURSOR));
    (void)written; /* if it fails, the terminal is gone */
  }
}

/* Draws as much of a text as the terminal has room for, from its upper left corner. Lines that are
 * too long go on in the next row. The first row is bold. The last row of the terminal is left for
 * the cursor. */
static void draw(const char *text) {
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

static void show_on_screen(const top_record *record) {
  char *text = NULL;
  size_t bytes = 0;
  FILE *file = open_memstream(&text, &bytes);
  if (file != NULL) {
    write_table(record, file);
    if (fclose(file) == 0) {
      draw(text);
    }
    free(text);
  }
}

/* ---- signals that end the command ------------------------------------------------------------ */

static void block_end(int how) {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  sigprocmask(how, &signals, NULL);
}

/* SIGINT and SIGTERM end the command at once. They are blocked while a table is written, so that
 * every table is whole. */
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

/* ---- looking --------------------------------------------------------------------------------- */

static bool look(dipole_client *client, top_look *one, dipole_error *error) {
  if (!dipole_statistics(client, &one->values, &one->count, error)) {
    return false;
  }
  one->at_s = (double)cli_now_ns() / 1e9;
  return true;
}

/* Makes the statistics of now those of before. */
static void turn_over(top_record *record) {
  free(record->before.values);
  record->before = record->now;
  record->now = (top_look){0};
}

static void show(enum cli_form form, top_record *record, uint64_t number) {
  list(record, form);
  if (form == CLI_TABLE && has_screen) {
    show_on_screen(record);
  } else if (form == CLI_TABLE) {
    fputs(number > 0 ? "\n" : "", stdout);
    write_table(record, stdout);
  } else if (form == CLI_CSV) {
    cli_rows_csv(number == 0, record->listed_count, put_statistic, record);
  }
  for (size_t i = 0; form == CLI_JSON && i < record->listed_count; i++) {
    cli_rows_object(put_statistic, record, i);
    putchar('\n');
  }
  fflush(stdout);
}

/* On a terminal, shows the statistics since the daemon's start before the first interval ends. */
static void show_beginning(top_record *record) {
  if (has_screen) {
    record->interval_s = (double)find(&record->now, "uptime_ms") / 1000;
    show(CLI_TABLE, record, 0);
  }
}

/* ---- a daemon that has gone ------------------------------------------------------------------ */

enum { ANSWER_MS = 2000 }; /* how long the daemon may take before the screen says that it is gone */

typedef struct watched {
  const cli_settings *settings;
  dipole_client *client; /* the present one; NULL while the daemon is gone */
  dipole_client *given;  /* the first one, which the caller closes */
  double gone_s;         /* since when the daemon is gone */
} watched;

static void forget(watched *of) {
  if (of->client != of->given) {
    dipole_close(of->client);
  }
  of->client = NULL;
}

/* On a screen, answers are awaited for a short time only: numbers that are out of date must not
 * stay. */
static void hurry(dipole_client *client) {
  dipole_set_retry_ms(client, 0);
  dipole_set_timeout_ms(client, ANSWER_MS);
}

static bool connect_again(watched *of, dipole_error *error) {
  dipole_options options;
  cli_connection_options(of->settings, &options);
  options.retry_ms = 0;
  options.connect_timeout_ms = ANSWER_MS;
  if (!dipole_open_with(of->settings->connect, &options, &of->client, error)) {
    return false;
  }
  hurry(of->client);
  return true;
}

/* Replaces the numbers on the screen by the reason why there are none. */
static void show_gone(const watched *of, const dipole_error *error) {
  char text[512];
  const char *address = of->settings->connect;
  snprintf(text, sizeof text,
           "No answer from %s for %.0f s\n%s\n\nTrying again. Ctrl-C ends this.\n",
           address != NULL ? address : dipole_get_info(of->given)->address,
           (double)cli_now_ns() / 1e9 - of->gone_s, error->text);
  draw(text);
  fflush(stdout);
}

/* Looks at the daemon. If it does not answer, returns false and, on a screen, says so. */
static bool look_or_tell(watched *of, top_look *now) {
  dipole_error error;
  if ((of->client != NULL || connect_again(of, &error)) && look(of->client, now, &error)) {
    of->gone_s = 0;
    return true;
  }
  if (!has_screen) {
    cli_fail_error(&error);
    return false;
  }
  of->gone_s = of->gone_s > 0 ? of->gone_s : (double)cli_now_ns() / 1e9;
  forget(of);
  show_gone(of, &error);
  return false;
}

/* Shows one interval. Returns false if the command has to end. */
static bool watch_once(watched *of, top_record *record, uint64_t number, double *next_s) {
  const double interval_s = of->settings->interval.value;
  turn_over(record);
  block_end(SIG_UNBLOCK);
  sleep_until(*next_s);
  block_end(SIG_BLOCK);
  const bool looked = look_or_tell(of, &record->now);
  *next_s = fmax(*next_s + interval_s, (double)cli_now_ns() / 1e9);
  if (looked && record->before.count > 0) {
    record->interval_s = record->now.at_s - record->before.at_s;
    show(of->settings->form, record, number);
  } else if (looked) { /* It is back. */
    show_beginning(record);
  }
  return (looked || has_screen) && !ferror(stdout); /* main() will say why */
}

static int watch(const cli_settings *settings, dipole_client *client, top_record *record) {
  watched of = {.settings = settings, .client = client, .given = client};
  bool good = true;
  if (has_screen) {
    hurry(client);
  }
  if (!look_or_tell(&of, &record->now) && !has_screen) {
    return CLI_FAILED;
  }
  block_end(SIG_BLOCK);
  if (record->now.count > 0) {
    show_beginning(record);
  }
  double next_s = (double)cli_now_ns() / 1e9 + settings->interval.value;
  for (uint64_t i = 0; good && (!settings->count.given || i < settings->count.value); i++) {
    good = watch_once(&of, record, i, &next_s);
  }
  forget(&of);
  return good && (record->now.count > 0 || !has_screen) ? CLI_OK : CLI_FAILED;
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

static int run(const cli_settings *settings, dipole_client *client) {
  top_record record = {.info = dipole_get_info(client)};
  end_on_signals();
  if (settings->form == CLI_TABLE) {
    begin_screen();
  }
  const int status = watch(settings, client, &record);
  restore_screen();
  free(record.before.values);
  free(record.now.values);
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
    .more =
        "\nOn a terminal, each table takes the place of the one before; Ctrl-C ends the command.\n"
        "While the daemon does not answer, its reason stands there, and `top` tries again.\n"
        "Elsewhere, each interval gives a table, or a line of CSV or JSON for each statistic.\n"
        "Names end with their units; per_s is the rate over the interval. Latencies are those of\n"
        "all requests since the daemon's start. Tables leave out what has not risen.\n",
    .formats = "table,csv,json",
    .options = {options},
    .examples = "  dipole top --connect unix:/tmp/dipoled.sock\n"
                "  dipole top --connect tcp:farm7:4817 --interval 60 --format csv > farm7.csv\n"
                "  dipole top --connect tcp:farm7:4817 --count 1 --format json\n",
    .shows_service = true,
    .check = check,
    .run = run,
};
