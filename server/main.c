/* dipoled: starts the workers and the listeners, and runs until a signal stops it. */
#include <errno.h>
#include <signal.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include "core/transport/table.h"
#include "proto/standard.h"
#include "server/http/header.h"
#include "server/http/service.h"
#include "server/jobs/mc_pool.h"
#include "server/modbus/service.h"
#include "server/net/handshake.h"
#include "server/net/listener.h"
#include "server/net/worker.h"
#include "server/observe/latency.h"
#include "server/observe/log.h"
#include "server/observe/metrics.h"
#include "server/scpi/connection.h"
#include "server/store/cache.h"
#include "server/store/media.h"

enum { PASSED_FIRST = 3, PASSED_MAX = 32 }; /* sockets that a service manager passes */

#define DEFAULT_TCP "tcp:127.0.0.1:4817"
#define DEFAULT_SOCKET "dipoled.sock"

/* The signals that stop the daemon; with TLS, SIGHUP makes it read its certificates again instead.
 * SIGHUP is left alone where it is ignored, as by nohup. */
static const int stop_signals[] = {SIGTERM, SIGINT, SIGHUP};
enum { STOP_SIGNALS = sizeof stop_signals / sizeof stop_signals[0] };

struct daemon {
  struct server server;
  uv_loop_t loop;
  uv_signal_t signals[STOP_SIGNALS];
  uv_work_t first_work;
  struct listener listeners[PASSED_MAX + (3 * OPTIONS_LIST_MAX + 2) * TCP_ADDRESSES_MAX];
  size_t listener_count;
  struct metrics *metrics;   /* NULL without --metrics */
  struct http_service *http; /* NULL without --http */
  uint64_t workers_started;
  bool ready; /* whether the daemon has started; if not, it stops without another message */
  bool stopping;
};

/* ---- the service manager: sd_listen_fds(3) and sd_notify(3) ---------------------------------- */

/* Returns how many sockets the manager has passed, from PASSED_FIRST on, or -1 if that is no number up
 * to PASSED_MAX. */
static int passed_sockets(void) {
  const char *process = getenv("LISTEN_PID"), *count = getenv("LISTEN_FDS");
  char *end;
  if (process == NULL || count == NULL || strtol(process, NULL, 10) != (long)getpid()) {
    return 0; /* The sockets were passed to another process, for example the parent. */
  }
  const long passed = strtol(count, &end, 10);
  return *end != '\0' || passed < 0 || passed > PASSED_MAX ? -1 : (int)passed;
}

/* Notifies the manager, if one waits for that. Ignores failures, because the manager has then ended.
 * state: lines NAME=VALUE */
static void tell_manager(const char *state) {
  struct sockaddr_un manager = {.sun_family = AF_UNIX};
  const char *path = getenv("NOTIFY_SOCKET");
  const size_t length = path != NULL ? strlen(path) : 0;
  if (length == 0 || length > sizeof manager.sun_path) {
    return;
  }
  memcpy(manager.sun_path, path, length);
  if (path[0] == '@') {
    manager.sun_path[0] = '\0'; /* an abstract socket */
  }
  const int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (fd >= 0) {
    sendto(fd, state, strlen(state), MSG_NOSIGNAL, (const struct sockaddr *)&manager,
           (socklen_t)(offsetof(struct sockaddr_un, sun_path) + length));
    close(fd);
  }
}

/* ---- stopping -------------------------------------------------------------------------------- */

/* Says how many clients the drain timeout has left without a complete reply. */
static void log_abandoned(const struct server *server, uint64_t workers) {
  unsigned count = 0;
  for (uint64_t i = 0; i < workers; i++) {
    count += server->workers[i].abandoned_count;
  }
  if (count > 0) {
    log_line(LOG_LEVEL_ERROR, "event=drain-timeout connections=%u drain_timeout_ms=%llu", count,
             (unsigned long long)server->options.drain_timeout_ms);
  }
}

/* Stops the daemon because of a signal, or, if that is 0, because nothing is left to serve. */
static void stop_daemon(struct daemon *daemon, int signal_number) {
  if (daemon->stopping) {
    return;
  }
  daemon->stopping = true;
  atomic_store(&daemon->server.draining, true);
  if (daemon->ready) {
    log_line(LOG_LEVEL_INFO, "event=stopping reason=%s",
             signal_number == 0        ? "connection-closed"
             : signal_number == SIGHUP ? "SIGHUP"
             : signal_number == SIGINT ? "SIGINT"
                                       : "SIGTERM");
  }
  if (daemon->server.options.fd == NULL) {
    tell_manager("STOPPING=1\nSTATUS=Serving what is in flight.");
  }
  for (size_t i = 0; i < daemon->listener_count; i++) {
    listener_close(&daemon->listeners[i]);
  }
  uint64_t running = daemon->workers_started;
  if (daemon->server.tls != NULL && running == server_worker_count(&daemon->server)) {
    /* The last worker hands connections to the others: it ends before they do. */
    worker_stop(&daemon->server.workers[--running]);
    worker_join(&daemon->server.workers[running]);
  }
  for (uint64_t i = 0; i < running; i++) {
    worker_stop(&daemon->server.workers[i]);
  }
  for (size_t i = 0; i < STOP_SIGNALS; i++) {
    uv_close((uv_handle_t *)&daemon->signals[i], NULL);
  }
  for (uint64_t i = 0; i < running; i++) {
    worker_join(&daemon->server.workers[i]);
  }
  log_abandoned(&daemon->server, daemon->workers_started);
  const uint64_t lost = stats_get(&daemon->server.stats, STATS_LOST_WAKEUPS);
  if (lost > 0) {
    log_line(LOG_LEVEL_ERROR, "event=fault lost_wakeups=%llu", (unsigned long long)lost);
  }
  metrics_close(daemon->metrics); /* It has served until now, so that a drain can be watched. */
  daemon->metrics = NULL;
  uv_close((uv_handle_t *)&daemon->server.inherited_closed, NULL);
}

static void on_signal(uv_signal_t *handle, int signal_number) {
  struct daemon *daemon = handle->data;
  if (signal_number == SIGHUP && daemon->server.tls != NULL) {
    tls_reload(daemon->server.tls);
  } else {
    stop_daemon(daemon, signal_number);
  }
}

static void on_inherited_closed(uv_async_t *handle) {
  stop_daemon(handle->data, 0);
}

/* ---- starting -------------------------------------------------------------------------------- */

static bool complain(const char *what, const char *why) {
  fprintf(stderr, "dipoled: %s: %s\n", what, why);
  return false;
}

static bool choose_isa(struct server *server) {
  server->isa = core_isa_select(server->options.isa);
  if (server->isa != NULL) {
    return true;
  }
  char have[128] = "";
  size_t length = strlen(have);
  const char *name;
  for (size_t i = 0; (name = core_isa_listed(i)) != NULL; i++) {
    if (core_isa_select(name) != NULL) {
      length += (size_t)snprintf(have + length, sizeof have - length, " %s", name);
    }
  }
  fprintf(stderr, "dipoled: --isa is one that this machine can run, not '%s':%s\n",
          server->options.isa, have);
  return false;
}

static void do_nothing(uv_work_t *work) {
  (void)work;
}

static bool start_workers(struct daemon *daemon) {
  struct server *server = &daemon->server;
  const uint64_t count = server_worker_count(server);
  server->workers = calloc(count, sizeof *server->workers);
  server->latencies = calloc(count, sizeof *server->latencies);
  server->cache = cache_new(server->isa, server->options.cache_bytes, server->options.points_bytes,
                            server->options.max_waiting_profiles, &server->stats);
  server->mc = mc_pool_new(server);
  /* A table that a request could not open would be taken as absent from then on. */
  if (transport_table_shipped() == NULL || server->workers == NULL || server->latencies == NULL ||
      server->cache == NULL || server->mc == NULL) {
    return complain("workers", "out of memory");
  }
  const int lacking = cache_start(server->cache);
  if (lacking != 0) {
    return complain("threads", uv_strerror(lacking));
  }
  /* libuv aborts if the threads of its pool, which drive RTS, cannot start. So they start now. */
  uv_queue_work(&daemon->loop, &daemon->first_work, do_nothing, NULL);
  for (; daemon->workers_started < count; daemon->workers_started++) {
    const int error = worker_start(&server->workers[daemon->workers_started], server);
    if (error != 0) {
      return complain("workers", uv_strerror(error));
    }
  }
  return true;
}

static bool open_listener(struct daemon *daemon, const char *url, listener_take *modbus) {
  const size_t opened = listener_open(&daemon->listeners[daemon->listener_count], &daemon->server,
                                      &daemon->loop, url, modbus);
  daemon->listener_count += opened;
  return opened > 0;
}

static bool listen_at(struct daemon *daemon, const char *url) {
  return open_listener(daemon, url, NULL);
}

/* Opens the addresses of an option; [::] last, so that it leaves IPv4 to 0.0.0.0. */
static bool open_each(struct daemon *daemon, const struct options_list *urls,
                      bool (*open)(struct daemon *daemon, const char *url)) {
  for (size_t i = 0; i < 2 * urls->count; i++) {
    const char *url = urls->items[i % urls->count];
    if ((strstr(url, ":[::]:") != NULL) == (i >= urls->count) && !open(daemon, url)) {
      return false;
    }
  }
  return true;
}

static bool serve_modbus_at(struct daemon *daemon, const char *url) {
  if (strncmp(url, "rtu:", 4) == 0) {
    return modbus_service_open_line(daemon->server.modbus, url);
  }
  const bool secure = strncmp(url, "tls:", 4) == 0;
  return open_listener(daemon, url, secure ? modbus_service_admit_tls : modbus_service_admit);
}

static bool serve_scpi_at(struct daemon *daemon, const char *address) {
  const size_t opened =
      listener_open_option(&daemon->listeners[daemon->listener_count], &daemon->server,
                           &daemon->loop, "scpi", address, scpi_connection_admit);
  daemon->listener_count += opened;
  return opened > 0;
}

/* Returns the runtime directory: that of systemd, or of the user, or /run for root. NULL if there
 * is none. */
static const char *runtime_directory(void) {
  const char *directory = getenv("RUNTIME_DIRECTORY");
  if (directory == NULL || *directory == '\0') {
    directory = getenv("XDG_RUNTIME_DIR");
  }
  if (directory == NULL || *directory == '\0') {
    directory = geteuid() == 0 ? "/run" : NULL;
  }
  struct stat status;
  return directory != NULL && stat(directory, &status) == 0 && S_ISDIR(status.st_mode) ? directory
                                                                                       : NULL;
}

static bool listen_by_default(struct daemon *daemon) {
  const char *directory = runtime_directory();
  char url[256];
  if (directory == NULL) {
    log_line(LOG_LEVEL_INFO, "event=no-socket reason=no-runtime-directory");
  } else {
    snprintf(url, sizeof url, "unix:%s/" DEFAULT_SOCKET, directory);
    if (!listen_at(daemon, url)) {
      return false;
    }
  }
  return listen_at(daemon, DEFAULT_TCP);
}

static bool admit_inherited(struct server *server) {
  char *end;
  const long fd = strtol(server->options.fd, &end, 10);
  int type = 0;
  socklen_t length = sizeof type;
  if (*end != '\0' || fd < 0 || fd > 1048576 ||
      getsockopt((int)fd, SOL_SOCKET, SO_TYPE, &type, &length) != 0 || type != SOCK_STREAM) {
    fprintf(stderr,
            "dipoled: --fd %s is not the number of a connected stream socket that this "
            "process has inherited\n",
            server->options.fd);
    return false;
  }
  listener_admit(server, (int)fd, true);
  return true;
}

/* Listens at the sockets that a service manager passes. */
static bool adopt_passed(struct daemon *daemon) {
  const int count = passed_sockets();
  if (count < 0) {
    return complain("LISTEN_FDS", "it is no number up to 32");
  }
  for (int fd = PASSED_FIRST; fd < PASSED_FIRST + count; fd++) {
    if (!listener_adopt(&daemon->listeners[daemon->listener_count], &daemon->server, &daemon->loop,
                        fd)) {
      return false;
    }
    daemon->listener_count++;
  }
  return true;
}

/* Opens all addresses. A daemon with --fd is private to the program that has started it: it ignores
 * the variables of a service manager, which are meant for that program. */
static bool open_addresses(struct daemon *daemon) {
  const struct options *options = &daemon->server.options;
  if (options->fd == NULL && !adopt_passed(daemon)) {
    return false;
  }
  if (!open_each(daemon, &options->listen, listen_at)) {
    return false;
  }
  if (options->fd != NULL) {
    return admit_inherited(&daemon->server);
  }
  return daemon->listener_count > 0 || listen_by_default(daemon);
}

/* Reads the certificates, if there is an address with TLS. Called before the workers start, because
 * one of them serves handshakes. */
static bool set_up_tls(struct server *server) {
  const struct options *options = &server->options;
  const bool wanted = tls_is_wanted(options);
  const bool names_clients = options->client_ca != NULL || options->roles != NULL;
  /* In the environment, clients of this machine may have named their own certificate. */
  const bool names_key = options->key != NULL && options->key != getenv("DIPOLED_KEY");
  const bool names_ours =
      (options->certificate != NULL && options->certificate != getenv("DIPOLED_CERTIFICATE")) ||
      names_key;
  if (options->roles != NULL && options->client_ca == NULL && (wanted || options->fd == NULL)) {
    return complain("--roles",
                    "it needs --client-ca FILE: roles are those of clients' certificates");
  }
  if (!wanted && options->fd == NULL && (names_clients || names_ours)) {
    return complain(names_clients                    ? "--client-ca"
                    : options->certificate != NULL ? "--certificate"
                                                     : "--key",
                    "no address has TLS: give --listen or --modbus tls:HOST:PORT, too");
  }
  server->tls = wanted ? tls_new(&server->options) : NULL;
  return !wanted || server->tls != NULL;
}

/* Called after the workers have started. */
static bool set_up_handshakes(struct server *server) {
  if (server->tls != NULL) {
    struct worker *worker = &server->workers[server_worker_count(server) - 1];
    server->handshakes = handshakes_new(server, server->tls, worker, listener_admit_tls);
  }
  return (server->tls == NULL || server->handshakes != NULL) || complain("tls", "out of memory");
}

/* Starts the workers and opens all addresses. What has to be there for a worker comes before them;
 * metrics come before clients can connect, so that a daemon that is ready can be monitored; the requests
 * of HTTP run on the last worker. */
static bool start_services(struct daemon *daemon) {
  struct server *server = &daemon->server;
  const struct options *options = &server->options;
  char why[160];
  if (options->media != NULL && !media_read(options->media, why, sizeof why)) {
    return complain(options->media, why);
  }
  if (!set_up_tls(server) ||
      (options->modbus.count > 0 && (server->modbus = modbus_service_new(server)) == NULL) ||
      !start_workers(daemon) || !set_up_handshakes(server) ||
      (options->metrics != NULL &&
       (daemon->metrics = metrics_open(server, options->metrics)) == NULL) ||
      !open_addresses(daemon) || !open_each(daemon, &options->modbus, serve_modbus_at) ||
      !open_each(daemon, &options->scpi, serve_scpi_at)) {
    return false;
  }
  if (server->modbus != NULL) {
    modbus_service_begin(server->modbus);
  }
  if (options->http != NULL) {
    daemon->http = http_service_open(server, &server->workers[options->workers]);
  }
  return options->http == NULL || daemon->http != NULL;
}

static bool is_ignored(int signal_number) {
  struct sigaction action;
  return sigaction(signal_number, NULL, &action) == 0 && action.sa_handler == SIG_IGN;
}

static bool set_up_loop(struct daemon *daemon) {
  const int error = uv_loop_init(&daemon->loop);
  if (error != 0) {
    return complain("loop", uv_strerror(error));
  }
  uv_async_init(&daemon->loop, &daemon->server.inherited_closed, on_inherited_closed);
  daemon->server.inherited_closed.data = daemon;
  for (size_t i = 0; i < STOP_SIGNALS; i++) {
    uv_signal_init(&daemon->loop, &daemon->signals[i]);
    daemon->signals[i].data = daemon;
    if (stop_signals[i] != SIGHUP || !is_ignored(SIGHUP)) {
      uv_signal_start(&daemon->signals[i], on_signal, stop_signals[i]);
    }
  }
  return true;
}

static bool set_log_level(const struct options *options) {
  enum log_level level = LOG_LEVEL_INFO;
  if (options->log_level != NULL && !log_level_by_name(options->log_level, &level)) {
    fprintf(stderr, "dipoled: --log-level is error or info, not '%s'\n", options->log_level);
    return false;
  }
  log_set_level(level);
  return true;
}

/* Raises the limit of file descriptors as far as the system allows, because each connection needs
 * one. */
static void raise_descriptor_limit(void) {
  struct rlimit limit;
  if (getrlimit(RLIMIT_NOFILE, &limit) == 0) {
    limit.rlim_cur = limit.rlim_max;
    setrlimit(RLIMIT_NOFILE, &limit);
  }
}

static int run_daemon(struct daemon *daemon) {
  struct server *server = &daemon->server;
  if (!set_log_level(&server->options) || !choose_isa(server) ||
      !access_read_option("allow", &server->options.allow, &access_anyone, &server->allow) ||
      !access_read_option("scpi-allow", &server->options.scpi_allow, &access_this_machine,
                          &server->scpi_allow) ||
      !http_header_check_names(&server->options.http_name)) {
    return 2;
  }
  server->buffers.most = server->options.max_total_bytes;
  signal(SIGPIPE, SIG_IGN);
  raise_descriptor_limit();
  if (!set_up_loop(daemon)) {
    return EXIT_FAILURE;
  }
  const int error = log_start();
  if (error != 0) {
    complain("log", strerror(error));
    return EXIT_FAILURE;
  }
  daemon->ready = start_services(daemon);
  if (daemon->ready) {
    log_line(LOG_LEVEL_INFO, "event=ready workers=%llu isa=%s",
             (unsigned long long)server->options.workers, core_isa_name(server->isa));
    if (server->options.fd == NULL) {
      tell_manager("READY=1\nSTATUS=Serving.");
    }
  } else {
    stop_daemon(daemon, 0);
  }
  uv_run(&daemon->loop, UV_RUN_DEFAULT);
  uv_loop_close(&daemon->loop);
  modbus_service_free(server->modbus);
  http_service_free(daemon->http);
  handshakes_free(server->handshakes);
  tls_free(server->tls);
  free(server->workers);
  free(server->latencies);
  cache_free(server->cache);
  mc_pool_free(server->mc);
  if (daemon->ready) {
    log_line(LOG_LEVEL_INFO, "event=stopped");
  }
  log_finish();
  return daemon->ready ? EXIT_SUCCESS : EXIT_FAILURE;
}

int main(int argc, char **argv) {
  static struct daemon daemon;
  daemon.server.started_ns = uv_hrtime();
  if (!standard_open()) {
    complain("/dev/null", strerror(errno));
    return EXIT_FAILURE;
  }
  int status = EXIT_SUCCESS;
  switch (options_read(argc, argv, &daemon.server.options)) {
  case OPTIONS_RUN:
    status = run_daemon(&daemon);
    break;
  case OPTIONS_EXIT_OK:
    status = standard_flush("dipoled") ? EXIT_SUCCESS : EXIT_FAILURE;
    break;
  case OPTIONS_EXIT_USAGE:
    status = 2;
    break;
  }
  options_free(&daemon.server.options);
  return status;
}
