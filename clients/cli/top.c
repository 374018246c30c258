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

typedef struct top_settings {
  cli_common common;
  cli_number interval_s;
  cli_count count;
} top_settings;

/* The statistics at one moment. All 0 stands for the daemon's start. */
typedef struct top_look {
  dipole_value *values; /* to be freed */
  size_t count;
  double at_s; /* by a monotonic clock */
} top_look;

typedef struct top_record {
  top_look before;
  top_look now;
  double interval_s;
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

/* Returns a statistic of now; 0 if the daemon has none of this name. */
static uint64_t top_value(const top_record *record, const char *name) {
  return find(&record->now, name);
}

static uint64_t rise(const top_record *record, const char *name) {
  const uint64_t before = find(&record->before, name), now = find(&record->now, name);
  return now > before ? now - before : 0;
}

/* Returns by how much a statistic has risen each second. */
static double rate(const top_record *record, const char *name) {
  return record->interval_s > 0 ? (double)rise(record, name) / record->interval_s : 0;
}

/* Returns the name of the next statistic, from position *from on, that begins with a prefix, and
 * sets *from behind it; NULL if there is no more. */
static const char *next(const top_record *record, const char *prefix, size_t *from) {
  while (*from < record->now.count) {
    const char *name = record->now.values[(*from)++].name;
    if (strncmp(name, prefix, strlen(prefix)) == 0) {
      return name;
    }
  }
  return NULL;
}

/* Returns the sum of the rates of all statistics that begin with a prefix, except for `but`. */
static double sum_of_rates(const top_record *record, const char *prefix, const char *but) {
  double sum = 0;
  const char *name;
  for (size_t from = 0; (name = next(record, prefix, &from)) != NULL;) {
    sum += strcmp(name, but) == 0 ? 0 : rate(record, name);
  }
  return sum;
}

static double requests_rate(const top_record *record) {
  return sum_of_rates(record, "requests_", "");
}

static double errors_rate(const top_record *record) {
  return sum_of_rates(record, "answers_", "answers_ok");
}

/* Returns how many requests were evaluated in one pass, on average over the interval; 0 if none
 * were. */
static double batch_mean(const top_record *record) {
  const uint64_t batches = rise(record, "batches_evaluated");
  return batches > 0 ? (double)rise(record, "batched_requests") / (double)batches : 0;
}

/* The quantiles of latencies: their names in statistics, and those in the table. */
static const char *const latencies[][2] = {{"p50_us", "p50"},
                                           {"p90_us", "p90"},
                                           {"p99_us", "p99"},
                                           {"p999_us", "p99.9"},
                                           {"max_us", "max"}};
enum { LATENCIES = sizeof latencies / sizeof latencies[0] };

/* Copies the name of the next class of requests with known latencies into `kind`. Returns false if
 * there is none left. */
static bool next_latency(const top_record *record, size_t *from, char *kind, size_t bytes) {
  static const char prefix[] = "latency_", suffix[] = "_count";
  const char *name;
  while ((name = next(record, prefix, from)) != NULL) {
    const char *rest = name + strlen(prefix);
    const size_t length = strlen(rest);
    if (length > strlen(suffix) && strcmp(rest + length - strlen(suffix), suffix) == 0) {
      snprintf(kind, bytes, "%.*s", (int)(length - strlen(suffix)), rest);
      return true;
    }
  }
  return false;
}

static uint64_t latency(const top_record *record, const char *kind, const char *what) {
  char name[96];
  snprintf(name, sizeof name, "latency_%s_%s", kind, what);
  return top_value(record, name);
}

/* ---- for people ------------------------------------------------------------------------------ */

/* Writes a number with three figures, such as 950, 12.3 k or 4.56 M. A count below 1000 has no
 * decimals. */
static void put_figures(cli_rows *rows, const char *head, double value, bool is_count) {
  static const char *const units[] = {"", " k", " M", " G", " T", " P"};
  char text[32];
  size_t unit = 0;
  while (value >= 999.5 && unit + 1 < sizeof units / sizeof units[0]) {
    value /= 1000;
    unit++;
  }
  const bool is_whole = value >= 99.95 || value <= 0 || (is_count && unit == 0);
  snprintf(text, sizeof text, "%.*f%s", is_whole ? 0 : value >= 9.995 ? 1 : 2, value, units[unit]);
  cli_put_text(rows, CLI_COLUMN(head), text);
}

static void put_rates(cli_rows *rows, const void *context, size_t index) {
  const top_record *record = context;
  (void)index;
  put_figures(rows, "requests", requests_rate(record), false);
  put_figures(rows, "radii", rate(record, "radii_evaluated"), false);
  cli_put_number(rows, CLI_COLUMN("MB in", .format = "%.2f"), rate(record, "received_bytes") / 1e6);
  cli_put_number(rows, CLI_COLUMN("MB out", .format = "%.2f"), rate(record, "sent_bytes") / 1e6);
  cli_put_number(rows, CLI_COLUMN("batch", .format = "%.1f"), batch_mean(record));
  put_figures(rows, "errors", errors_rate(record), false);
  put_figures(rows, "cache hits", rate(record, "cache_hits"), false);
  put_figures(rows, "misses", rate(record, "cache_misses"), false);
}

static void put_gauges(cli_rows *rows, const void *context, size_t index) {
  static const char *const gauges[][2] = {
      {"connections_open", "connections"}, {"queued_connections", "queued"},
      {"owed_radii", "radii owed"},        {"mc_jobs_open", "mc jobs"},
      {"cache_entries", "profiles"},       {"cache_bytes", "their bytes"},
      {"buffer_bytes", "buffer bytes"},
  };
  (void)index;
  for (size_t i = 0; i < sizeof gauges / sizeof gauges[0]; i++) {
    put_figures(rows, gauges[i][1], (double)top_value(context, gauges[i][0]), true);
  }
}

/* Writes a class of requests and its latencies. */
static void put_latency(cli_rows *rows, const void *context, size_t index) {
  char kind[64] = "";
  size_t from = 0;
  for (size_t i = 0; i <= index; i++) {
    next_latency(context, &from, kind, sizeof kind);
  }
  cli_put_text(rows, CLI_COLUMN("us, since its start"), kind);
  for (size_t i = 0; i < LATENCIES; i++) {
    cli_put_count(rows, CLI_COLUMN(latencies[i][1]), latency(context, kind, latencies[i][0]));
  }
  put_figures(rows, "requests", (double)latency(context, kind, "count"), true);
}

/* Writes the rates of those statistics that rose and begin with a prefix, except for `but`. */
static void write_active(const top_record *record, const char *prefix, const char *but,
                         const char *head, FILE *file) {
  cli_table table = {.columns = 2, .left = 1, .heads = 1};
  cli_rows rows = {.form = CLI_TABLE, .table = &table, .pass = CLI_ROWS_VALUES};
  const char *name;
  for (size_t from = 0; (name = next(record, prefix, &from)) != NULL;) {
    const double each_second = rate(record, name);
    if (each_second > 0 && strcmp(name, but) != 0) {
      if (table.cell_count == 0) {
        cli_table_add(&table, "%s", head);
        cli_table_add(&table, "each second");
      }
      cli_table_add(&table, "%s", name + strlen(prefix));
      put_figures(&rows, "", each_second, false);
    }
  }
  if (table.cell_count > 0) {
    fputs("\n", file);
    cli_table_print(&table, file);
  }
}

/* Writes a table for people, about 80 columns wide. It lists models that were evaluated and errors
 * that were sent, if there are any. width: that of the terminal; 0 if there is none. */
static void top_write_table(const dipole_info *info, const top_record *record, size_t width,
                            FILE *file) {
  const uint64_t up_s = top_value(record, "uptime_ms") / 1000;
  char kind[64];
  size_t kinds = 0;
  fprintf(file, "%s at %s: up %llu:%02u:%02u, %u workers, %s\n", info->software, info->address,
          (unsigned long long)(up_s / 3600), (unsigned)(up_s / 60 % 60), (unsigned)(up_s % 60),
          info->workers, info->instruction_set);
  if (record->before.count > 0) {
    fprintf(file, "Each second, over the last %.1f s\n\n", record->interval_s);
  } else {
    fputs("Each second, since its start\n\n", file);
  }
  cli_rows_print(file, width, 0, 1, put_rates, record);
  fputs("\nNow\n", file);
  cli_rows_print(file, width, 0, 1, put_gauges, record);
  fputs("\n", file);
  for (size_t from = 0; next_latency(record, &from, kind, sizeof kind);) {
    kinds++;
  }
  cli_rows_print(file, width, 1, kinds, put_latency, record);
  write_active(record, "radii_", "radii_evaluated", "radii of model", file);
  write_active(record, "answers_", "answers_ok", "errors", file);
}

/* ---- for programs: always the same names from the same daemon -------------------------------- */

static void put_rates_of(cli_rows *rows, const top_record *record, const char *prefix) {
  const char *name;
  for (size_t from = 0; (name = next(record, prefix, &from)) != NULL;) {
    char per_s[96];
    snprintf(per_s, sizeof per_s, "%s_per_s", name);
    cli_put_number(rows, CLI_COLUMN(per_s), rate(record, name));
  }
}

static void put_record(cli_rows *rows, const void *context, size_t index) {
  static const char *const rates[] = {"received_bytes", "sent_bytes", "cache_hits", "cache_misses",
                                      "radii_",         "requests_",  "answers_"};
  static const char *const gauges[] = {"uptime_ms",   "connections_open", "queued_connections",
                                       "owed_radii",  "buffer_bytes",     "cache_entries",
                                       "cache_bytes", "mc_jobs_open"};
  const top_record *record = context;
  char kind[64];
  (void)index;
  cli_put_number(rows, CLI_COLUMN("interval_s"), record->interval_s);
  for (size_t i = 0; i < sizeof gauges / sizeof gauges[0]; i++) {
    cli_put_number(rows, CLI_COLUMN(gauges[i]), (double)top_value(record, gauges[i]));
  }
  cli_put_number(rows, CLI_COLUMN("requests_per_s"), requests_rate(record));
  cli_put_number(rows, CLI_COLUMN("errors_per_s"), errors_rate(record));
  cli_put_number(rows, CLI_COLUMN("requests_per_batch"), batch_mean(record));
  for (size_t i = 0; i < sizeof rates / sizeof rates[0]; i++) {
    put_rates_of(rows, record, rates[i]);
  }
  for (size_t from = 0; next_latency(record, &from, kind, sizeof kind);) {
    for (size_t i = 0; i < LATENCIES; i++) {
      char name[96];
      snprintf(name, sizeof name, "latency_%s_%s", kind, latencies[i][0]);
      cli_put_number(rows, CLI_COLUMN(name), (double)top_value(record, name));
    }
  }
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

static void show_on_screen(const dipole_info *info, const top_record *record) {
  char *text = NULL;
  size_t bytes = 0;
  FILE *file = open_memstream(&text, &bytes);
  if (file != NULL) {
    top_write_table(info, record, cli_terminal_look().columns, file);
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

static void show(enum cli_form form, const dipole_info *info, const top_record *record,
                 uint64_t number) {
  if (form == CLI_TABLE) {
    if (has_screen) {
      show_on_screen(info, record);
    } else {
      fputs(number > 0 ? "\n" : "", stdout);
      top_write_table(info, record, 0, stdout);
    }
  } else if (form == CLI_CSV) {
    cli_rows_csv(number == 0, 1, put_record, record);
  } else {
    cli_rows_object(put_record, record, 0);
    putchar('\n');
  }
  fflush(stdout);
}

/* On a terminal, shows the statistics since the daemon's start before the first interval ends. */
static void show_beginning(const dipole_info *info, top_record *record) {
  if (has_screen) {
    record->interval_s = (double)top_value(record, "uptime_ms") / 1000;
    show(CLI_TABLE, info, record, 0);
  }
}

/* ---- a daemon that has gone ------------------------------------------------------------------ */

enum { ANSWER_MS = 2000 }; /* how long the daemon may take before the screen says that it is gone */

typedef struct watched {
  const top_settings *settings;
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
  cli_connection_options(&of->settings->common, &options);
  options.retry_ms = 0;
  options.connect_timeout_ms = ANSWER_MS;
  if (!dipole_open_with(of->settings->common.connect, &options, &of->client, error)) {
    return false;
  }
  hurry(of->client);
  return true;
}

/* Replaces the numbers on the screen by the reason why there are none. */
static void show_gone(const watched *of, const dipole_error *error) {
  char text[512];
  const char *address = of->settings->common.connect;
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
  const double interval_s = of->settings->interval_s.value;
  turn_over(record);
  block_end(SIG_UNBLOCK);
  sleep_until(*next_s);
  block_end(SIG_BLOCK);
  const bool looked = look_or_tell(of, &record->now);
  *next_s = fmax(*next_s + interval_s, (double)cli_now_ns() / 1e9);
  if (looked && record->before.count > 0) {
    record->interval_s = record->now.at_s - record->before.at_s;
    show(of->settings->common.form, dipole_get_info(of->client), record, number);
  } else if (looked) { /* It is back. */
    show_beginning(dipole_get_info(of->client), record);
  }
  return (looked || has_screen) && !ferror(stdout); /* main() will say why */
}

static int watch(const top_settings *settings, dipole_client *client, top_record *record) {
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
    show_beginning(dipole_get_info(client), record);
  }
  double next_s = (double)cli_now_ns() / 1e9 + settings->interval_s.value;
  for (uint64_t i = 0; good && (!settings->count.given || i < settings->count.value); i++) {
    good = watch_once(&of, record, i, &next_s);
  }
  forget(&of);
  return good && (record->now.count > 0 || !has_screen) ? CLI_OK : CLI_FAILED;
}

/* ---- the command ----------------------------------------------------------------------------- */

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
    {"interval", "S", "seconds between two tables", CLI_NUMBER, offsetof(top_settings, interval_s),
     "1"},
    {"count", "N", "end after N intervals (default: only at Ctrl-C)", CLI_COUNT,
     offsetof(top_settings, count), NULL},
    {0},
};

const cli_command cli_command_top = {
    .name = "top",
    .about = "Watch a daemon: requests, radii and bytes each second, latencies, queues",
    .more =
        "\nOn a terminal, each table takes the place of the one before; Ctrl-C ends the command.\n"
        "While the daemon does not answer, its reason stands there, and `top` tries again.\n"
        "Elsewhere, each interval gives a table, a line of CSV or a line of JSON. Names end\n"
        "with their units. Those that end in _per_s are rates over the interval. Latencies\n"
        "are those of all requests since the daemon's start. If NO_COLOR is set, there is no\n"
        "bold type.\n",
    .formats = "table,csv,json",
    .options = {options},
    .examples = "  dipole top --connect unix:/tmp/dipoled.sock\n"
                "  dipole top --connect tcp:farm7:4817 --interval 60 --format csv > farm7.csv\n"
                "  dipole top --connect tcp:farm7:4817 --count 1 --format json\n",
    .shows_service = true,
    .settings_bytes = sizeof(top_settings),
    .check = check,
    .run = run,
};
