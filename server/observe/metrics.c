#include "server/observe/metrics.h"

#include <dirent.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/queue.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "server/http/header.h"
#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/health.h"
#include "server/observe/log.h"
#include "server/observe/report.h"
#include "server/server.h"

enum {
  MOST_CONNECTIONS = 16, /* the most connections at a time: one more ends the oldest */
  SILENCE_S = 5,         /* seconds of silence after which a connection is closed */
  CONNECTION_BYTES = 16384,
};

#define PLAIN "text/plain; charset=utf-8"
#define EXPOSITION "text/plain; version=0.0.4; charset=utf-8"

/* ---- the text format of Prometheus, version 0.0.4 -------------------------------------------- */

struct text {
  FILE *file;
  const struct report_family *family; /* the family whose values are being written */
};

static void start_family(struct text *text, const struct report_value *value) {
  static const char *const types[] = {
      [REPORT_COUNTER] = "counter",
      [REPORT_GAUGE] = "gauge",
      [REPORT_HISTOGRAM] = "histogram",
  };
  const struct report_family *family = value->family;
  /* This version of the format wants the same name for a family of counters and for its values. */
  const char *suffix = family->type == REPORT_COUNTER ? value->suffix : "";
  fprintf(text->file, "# HELP dipoled_%s%s %s\n# TYPE dipoled_%s%s %s\n", family->name, suffix,
          family->help, family->name, suffix, types[family->type]);
  text->family = family;
}

static void write_value(void *context, const struct report_value *value) {
  struct text *text = context;
  if (value->family->type == REPORT_NO_METRIC) {
    return;
  }
  if (value->family != text->family) {
    start_family(text, value);
  }
  fprintf(text->file, "dipoled_%s%s", value->family->name, value->suffix);
  if (value->labels[0] != '\0') {
    fprintf(text->file, "{%s}", value->labels);
  }
  if (value->is_ns) {
    fprintf(text->file, " %.9f\n", (double)value->value / 1e9);
  } else {
    fprintf(text->file, " %llu\n", (unsigned long long)value->value);
  }
}

/* ---- what every program tells Prometheus about itself, under the usual names ----------------- */

static void write_gauge(FILE *file, const char *name, const char *help, double value) {
  fprintf(file, "# HELP %s %s\n# TYPE %s gauge\n%s %.17g\n", name, help, name, name, value);
}

/* Writes the pages that the process has, from /proc (man 5 proc); nothing if that is not there. */
static void write_memory(FILE *file) {
  unsigned long long all, resident;
  FILE *statm = fopen("/proc/self/statm", "re");
  if (statm != NULL && fscanf(statm, "%llu %llu", &all, &resident) == 2) {
    const double page_bytes = (double)sysconf(_SC_PAGESIZE);
    write_gauge(file, "process_virtual_memory_bytes", "address space", (double)all * page_bytes);
    write_gauge(file, "process_resident_memory_bytes", "memory", (double)resident * page_bytes);
  }
  if (statm != NULL) {
    fclose(statm);
  }
}

static void write_descriptors(FILE *file) {
  struct rlimit limit;
  DIR *folder = opendir("/proc/self/fd");
  int count = -3; /* not counting ".", ".." and the folder itself */
  while (folder != NULL && readdir(folder) != NULL) {
    count++;
  }
  if (folder != NULL) {
    closedir(folder);
    write_gauge(file, "process_open_fds", "open file descriptors", count);
  }
  if (getrlimit(RLIMIT_NOFILE, &limit) == 0) {
    write_gauge(file, "process_max_fds", "limit of open file descriptors", (double)limit.rlim_cur);
  }
}

static double seconds(const struct timeval *time) {
  return (double)time->tv_sec + (double)time->tv_usec / 1e6;
}

static void write_process(FILE *file, const struct server *server, double start_s) {
  struct rusage used;
  fprintf(file,
          "# HELP dipoled_build_info 1, with the version and the instruction set\n"
          "# TYPE dipoled_build_info gauge\n"
          "dipoled_build_info{version=\"" DIPOLED_VERSION "\",instruction_set=\"%s\"} 1\n",
          core_isa_name(server->isa));
  if (getrusage(RUSAGE_SELF, &used) == 0) {
    fprintf(file,
            "# HELP process_cpu_seconds_total processor time of all threads\n"
            "# TYPE process_cpu_seconds_total counter\nprocess_cpu_seconds_total %.6f\n",
            seconds(&used.ru_utime) + seconds(&used.ru_stime));
  }
  write_gauge(
      file, "dipoled_workers_silent_seconds",
      "for how long no worker has begun a round of its loop, which idle ones do every 0.25 s",
      (double)worker_silence_ms(server->workers, server->options.workers) / 1e3);
  write_gauge(file, "process_start_time_seconds", "since 1970, UTC", start_s);
  write_memory(file);
  write_descriptors(file);
}

/* Makes the text of all metrics, which the caller frees. Returns NULL if there is no memory. */
static char *make_text(const struct server *server, double start_s) {
  char *memory = NULL;
  size_t bytes;
  struct text text = {open_memstream(&memory, &bytes), NULL};
  if (text.file == NULL) {
    return NULL;
  }
  report_each(server, write_value, &text);
  write_process(text.file, server, start_s);
  const int failed = ferror(text.file);
  if (fclose(text.file) != 0 || failed != 0) {
    free(memory);
    return NULL;
  }
  return memory;
}

/* ---- serving ------------------------------------------------------------------------------- */

/* A connection that is open. */
struct holder {
  TAILQ_ENTRY(holder) in_holders;
  int fd;
};

/* One address: the library has one listening socket, and a thread, for each of its daemons. */
struct port {
  const struct metrics *metrics;
  struct MHD_Daemon *daemon;
  TAILQ_HEAD(, holder) holders; /* from the oldest on; only the library's thread touches them */
  unsigned count;
};

struct metrics {
  const struct server *server;
  double start_s; /* start of the daemon in s since 1970 */
  struct port ports[TCP_ADDRESSES_MAX];
};

/* Prints a text, which the caller frees. Returns NULL if there is no memory. */
__attribute__((format(printf, 1, 2))) static char *print_text(const char *format, ...) {
  char *text = NULL;
  va_list arguments;
  va_start(arguments, format);
  const int length = vasprintf(&text, format, arguments);
  va_end(arguments);
  return length >= 0 ? text : NULL;
}

static char *health_text(enum health health, unsigned *status) {
  const char *reason = health_texts[health].reason;
  *status = health == HEALTH_OK ? MHD_HTTP_OK : MHD_HTTP_SERVICE_UNAVAILABLE;
  return print_text("%s%s%s\n", health_texts[health].name, reason[0] != '\0' ? ": " : "", reason);
}

/* Returns the text of the reply to a request, which the caller frees, and its status. Returns NULL if
 * there is no memory. */
static char *reply_to(struct MHD_Connection *connection, const struct metrics *metrics,
                      const char *url, const char *method, const char *version, unsigned *status) {
  const struct server *server = metrics->server;
  const bool is_metrics = strcmp(url, "/metrics") == 0, is_ready = strcmp(url, "/readyz") == 0;
  wire_error error;
  *status = http_header_check(connection, &server->options, url, version, NULL, &error);
  if (*status != 0) {
    return print_text("%s: %s\n", error.field, error.allowed);
  }
  if (!is_metrics && !is_ready && strcmp(url, "/healthz") != 0) {
    *status = MHD_HTTP_NOT_FOUND;
    return print_text("There are /metrics, /healthz and /readyz.\n");
  }
  if (strcmp(method, MHD_HTTP_METHOD_GET) != 0 && strcmp(method, MHD_HTTP_METHOD_HEAD) != 0) {
    *status = MHD_HTTP_METHOD_NOT_ALLOWED;
    return print_text("It is only for reading: GET or HEAD.\n");
  }
  if (is_metrics) {
    *status = MHD_HTTP_OK;
    return make_text(server, metrics->start_s);
  }
  return health_text(is_ready ? health_readiness(server) : health_of(server), status);
}

/* The library calls this after it has read a request's header. The reply does not depend on the
 * body. Without memory for a reply, closes the connection. */
static enum MHD_Result on_request(void *context, struct MHD_Connection *connection, const char *url,
                                  const char *method, const char *version, const char *body,
                                  size_t *body_bytes, void **state) {
  unsigned status;
  (void)body, (void)body_bytes, (void)state;
  char *text =
      reply_to(connection, ((const struct port *)context)->metrics, url, method, version, &status);
  struct MHD_Response *response =
      text != NULL ? MHD_create_response_from_buffer(strlen(text), text, MHD_RESPMEM_MUST_FREE)
                   : NULL;
  if (response == NULL) {
    free(text);
    return MHD_NO;
  }
  MHD_add_response_header(response, MHD_HTTP_HEADER_CONTENT_TYPE,
                          status == MHD_HTTP_OK && strcmp(url, "/metrics") == 0 ? EXPOSITION
                                                                                : PLAIN);
  if (status == MHD_HTTP_BAD_REQUEST) {
    MHD_add_response_header(response, MHD_HTTP_HEADER_CONNECTION, "close");
  }
  if (status == MHD_HTTP_METHOD_NOT_ALLOWED) {
    MHD_add_response_header(response, MHD_HTTP_HEADER_ALLOW, "GET, HEAD");
  }
  const enum MHD_Result sent = MHD_queue_response(connection, status, response);
  MHD_destroy_response(response);
  return sent;
}

/* The library accepts nothing while it has its most connections, or no descriptor is left. So the
 * last connection ends the oldest, and a probe is served however many clients are silent. */
static void on_connection(void *context, struct MHD_Connection *connection, void **state,
                          enum MHD_ConnectionNotificationCode what) {
  struct port *port = context;
  struct holder *holder = *state;
  if (what == MHD_CONNECTION_NOTIFY_CLOSED) {
    if (holder != NULL) {
      TAILQ_REMOVE(&port->holders, holder, in_holders);
      port->count--;
      free(holder);
    }
    return;
  }
  *state = holder = malloc(sizeof *holder);
  if (holder == NULL) {
    return;
  }
  holder->fd = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD)->connect_fd;
  TAILQ_INSERT_TAIL(&port->holders, holder, in_holders);
  port->count++;
  const bool is_full = port->count >= MOST_CONNECTIONS || tcp_lowest_descriptor() < 0;
  if (is_full && TAILQ_FIRST(&port->holders) != holder) {
    shutdown(TAILQ_FIRST(&port->holders)->fd, SHUT_RDWR);
  }
}

static struct MHD_Daemon *start_library(struct port *port, int fd) {
  return MHD_start_daemon(
      MHD_USE_AUTO | MHD_USE_INTERNAL_POLLING_THREAD | MHD_USE_ITC, 0, NULL, NULL, on_request, port,
      MHD_OPTION_LISTEN_SOCKET, fd, MHD_OPTION_CONNECTION_LIMIT, (unsigned)MOST_CONNECTIONS,
      MHD_OPTION_CONNECTION_TIMEOUT, (unsigned)SILENCE_S, MHD_OPTION_CONNECTION_MEMORY_LIMIT,
      (size_t)CONNECTION_BYTES, MHD_OPTION_UNESCAPE_CALLBACK, http_header_leave_escaped, NULL,
      MHD_OPTION_NOTIFY_CONNECTION, on_connection, port, MHD_OPTION_END);
}

static bool open_port(struct metrics *metrics, struct port *port, int fd) {
  char bound[TCP_TEXT_BYTES];
  tcp_bound(fd, bound);
  port->metrics = metrics;
  TAILQ_INIT(&port->holders);
  port->daemon = start_library(port, fd); /* libmicrohttpd owns the socket from here on. */
  if (port->daemon == NULL) {
    fprintf(stderr, "dipoled: --metrics %s: the HTTP server does not start\n", bound);
    close(fd);
    return false;
  }
  log_line(LOG_LEVEL_INFO, "event=metrics url=http://%s/metrics", bound);
  return true;
}

struct metrics *metrics_open(struct server *server, const char *address) {
  struct timespec now;
  int fds[TCP_ADDRESSES_MAX];
  struct metrics *metrics = calloc(1, sizeof *metrics);
  if (metrics == NULL) {
    return NULL;
  }
  clock_gettime(CLOCK_REALTIME, &now);
  metrics->start_s = (double)now.tv_sec + (double)now.tv_nsec / 1e9 -
                     (double)(uv_hrtime() - server->started_ns) / 1e9;
  metrics->server = server;
  const size_t count = tcp_listen_option("metrics", address, fds);
  bool good = count > 0;
  for (size_t i = 0; i < count; i++) {
    good &= open_port(metrics, &metrics->ports[i], fds[i]);
  }
  if (!good) {
    metrics_close(metrics);
    return NULL;
  }
  return metrics;
}

void metrics_close(struct metrics *metrics) {
  for (size_t i = 0; metrics != NULL && i < TCP_ADDRESSES_MAX; i++) {
    MHD_stop_daemon(metrics->ports[i].daemon);
  }
  free(metrics);
}
