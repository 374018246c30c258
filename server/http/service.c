#include "server/http/service.h"

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "server/http/connection.h"
#include "server/http/fields.h"
#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

enum { REFUSALS_AT_ONCE = 64 };

/* The service is a client of its worker: each turn lets the library read, answer and write. */
struct http_service {
  struct client client; /* first member: see client.h */
  struct http_host host;
  struct MHD_Daemon *daemon;
  uv_poll_t poll; /* on the library's epoll descriptor */
  int fd;         /* the listening socket, which the library owns */
  bool ended;
};

static struct http_service *of(struct client *client) {
  return (struct http_service *)(void *)client;
}

static void on_resumed(struct http_host *host) {
  struct http_service *service =
      (struct http_service *)(void *)((char *)host - offsetof(struct http_service, host));
  worker_run_later(&service->client);
}

static void on_event(uv_poll_t *poll, int status, int events) {
  struct http_service *service = poll->data;
  (void)status, (void)events;
  worker_run_later(&service->client);
}

static void on_closed(uv_handle_t *handle) {
  struct http_service *service = handle->data;
  service->host.library.stop_daemon(service->daemon);
  worker_forget(&service->client);
}

/* ---- the client of the worker ---------------------------------------------------------------- */

static void start(struct client *client) {
  struct http_service *service = of(client);
  const int fd =
      service->host.library.get_daemon_info(service->daemon, MHD_DAEMON_INFO_EPOLL_FD)->epoll_fd;
  uv_poll_init(worker_loop(client->worker), &service->poll, fd);
  service->poll.data = service;
  uv_poll_start(&service->poll, UV_READABLE, on_event);
  worker_context(client->worker)->buffers = &service->host.buffers;
}

static void run(struct client *client) {
  struct http_service *service = of(client);
  MHD_UNSIGNED_LONG_LONG wait_ms;
  if (service->ended) {
    return;
  }
  service->host.library.run(service->daemon);
  if (service->host.library.get_timeout(service->daemon, &wait_ms) == MHD_YES && wait_ms == 0) {
    worker_run_later(client);
  }
  if (service->host.stopping && service->host.connection_count == 0) {
    service->ended = true;
    uv_close((uv_handle_t *)&service->poll, on_closed);
  }
}

static void tick(struct client *client, uint64_t now_ms) {
  (void)now_ms;
  worker_run_later(client); /* The library looks for connections that are too silent. */
}

static void stop(struct client *client) {
  struct http_service *service = of(client);
  service->host.stopping = true;
  close(service->host.library.quiesce_daemon(service->daemon));
  worker_run_later(client);
}

static void abort_client(struct client *client) {
  worker_run_later(client);
}

static const struct client_kind kind = {
    .start = start, .run = run, .tick = tick, .stop = stop, .abort = abort_client};

/* ---- opening --------------------------------------------------------------------------------- */

static enum MHD_Result admit(void *context, const struct sockaddr *peer, socklen_t peer_bytes) {
  const struct http_host *host = context;
  (void)peer, (void)peer_bytes;
  return host->connection_count < host->server->options.max_http_connections && tcp_has_descriptor()
             ? MHD_YES
             : MHD_NO;
}

static struct MHD_Daemon *start_daemon(struct http_service *service) {
  struct http_host *host = &service->host;
  const struct options *options = &host->server->options;
  return host->library.start_daemon(
      MHD_USE_EPOLL | MHD_ALLOW_SUSPEND_RESUME, 0, admit, host, http_connection_take, host,
      MHD_OPTION_LISTEN_SOCKET, service->fd, MHD_OPTION_CONNECTION_LIMIT,
      (unsigned)options->max_http_connections + REFUSALS_AT_ONCE, MHD_OPTION_CONNECTION_TIMEOUT,
      (unsigned)(options->frame_timeout_ms + 999) / 1000, MHD_OPTION_CONNECTION_MEMORY_LIMIT,
      (size_t)HTTP_CONNECTION_BYTES, MHD_OPTION_UNESCAPE_CALLBACK, http_library_leave_escaped, NULL,
      MHD_OPTION_URI_LOG_CALLBACK, http_connection_begin, host, MHD_OPTION_NOTIFY_COMPLETED,
      http_connection_complete, host, MHD_OPTION_NOTIFY_CONNECTION, http_connection_notify, host,
      MHD_OPTION_END);
}

static struct http_service *fail(struct http_service *service, const char *why) {
  fprintf(stderr, "dipoled: --http %s: %s\n", service->host.server->options.http, why);
  close(service->fd);
  free(service);
  return NULL;
}

struct http_service *http_service_open(struct server *server, struct worker *worker) {
  char bound[TCP_TEXT_BYTES];
  const char *why;
  struct http_service *service = calloc(1, sizeof *service);
  if (service == NULL) {
    return NULL;
  }
  service->client.kind = &kind;
  service->host = (struct http_host){
      .server = server,
      .worker = worker,
      .buffers = {.most = server->options.max_total_bytes / 2, .whole = &server->buffers},
      .on_resumed = on_resumed};
  service->fd = http_library_listen("http", server->options.http);
  if (service->fd < 0) {
    free(service);
    return NULL;
  }
  http_fields_init();
  tcp_bound(service->fd, bound);
  if (!http_library_load(&service->host.library, &why)) {
    return fail(service, why);
  }
  service->daemon = start_daemon(service);
  if (service->daemon == NULL) {
    return fail(service, "the HTTP server does not start");
  }
  worker_give(worker, &service->client);
  log_line(LOG_LEVEL_INFO, "event=listening url=http://%s", bound);
  return service;
}

void http_service_free(struct http_service *service) {
  free(service);
}
