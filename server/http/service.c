#include "server/http/service.h"

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "server/http/connection.h"
#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

enum { REFUSALS_AT_ONCE = 64 };

/* One address: the library has one listening socket for each of its daemons. */
struct port {
  uv_poll_t poll; /* polls libmicrohttpd's epoll descriptor */
  struct MHD_Daemon *daemon;
};

/* The service is a client of its worker: each turn lets the library read, reply and write. */
struct http_service {
  struct client client; /* first member: see client.h */
  struct http_host host;
  struct port ports[TCP_ADDRESSES_MAX];
  size_t count; /* of ports */
  bool ended;
};

static struct http_service *service_of(struct client *client) {
  return (struct http_service *)(void *)client;
}

static void on_event(uv_poll_t *poll, int status, int events) {
  struct http_service *service = poll->data;
  (void)status, (void)events;
  worker_run_later(&service->client);
}

static void on_closed(uv_handle_t *handle) {
  struct http_service *service = handle->data;
  MHD_stop_daemon(((struct port *)(void *)handle)->daemon);
  if (--service->count == 0) {
    worker_forget(&service->client);
  }
}

/* ---- the client of the worker ---------------------------------------------------------------- */

static void start_client(struct client *client) {
  struct http_service *service = service_of(client);
  for (struct port *port = service->ports; port < service->ports + service->count; port++) {
    const int fd = MHD_get_daemon_info(port->daemon, MHD_DAEMON_INFO_EPOLL_FD)->epoll_fd;
    uv_poll_init(&client->worker->loop, &port->poll, fd);
    port->poll.data = service;
    uv_poll_start(&port->poll, UV_READABLE, on_event);
  }
  client->worker->context.buffers = &service->host.buffers;
}

static void run_turn(struct client *client) {
  struct http_service *service = service_of(client);
  MHD_UNSIGNED_LONG_LONG wait_ms;
  if (service->ended) {
    return;
  }
  for (size_t i = 0; i < service->count; i++) {
    MHD_run(service->ports[i].daemon);
    if (MHD_get_timeout(service->ports[i].daemon, &wait_ms) == MHD_YES && wait_ms == 0) {
      worker_run_later(client);
    }
  }
  service->ended = service->host.stopping && service->host.connection_count == 0;
  for (size_t i = 0; service->ended && i < service->count; i++) {
    uv_close((uv_handle_t *)&service->ports[i].poll, on_closed);
  }
}

static void check_time(struct client *client, uint64_t now_ms) {
  (void)now_ms;
  worker_run_later(client); /* The library looks for connections that are too silent. */
}

static void stop_client(struct client *client) {
  struct http_service *service = service_of(client);
  service->host.stopping = true;
  for (size_t i = 0; i < service->count; i++) {
    close(MHD_quiesce_daemon(service->ports[i].daemon));
  }
  worker_run_later(client);
}

static const struct client_kind kind = {.start = start_client,
                                        .run = run_turn,
                                        .tick = check_time,
                                        .stop = stop_client,
                                        .abort = worker_run_later};

/* ---- opening --------------------------------------------------------------------------------- */

static enum MHD_Result admit(void *context, const struct sockaddr *peer, socklen_t peer_bytes) {
  const struct http_host *host = context;
  (void)peer, (void)peer_bytes;
  return host->connection_count < host->server->options.max_http_connections && tcp_has_descriptor()
             ? MHD_YES
             : MHD_NO;
}

static struct MHD_Daemon *start_daemon(struct http_host *host, int fd) {
  const struct options *options = &host->server->options;
  return MHD_start_daemon(
      MHD_USE_EPOLL | MHD_ALLOW_SUSPEND_RESUME, 0, admit, host, http_connection_take, host,
      MHD_OPTION_LISTEN_SOCKET, fd, MHD_OPTION_CONNECTION_LIMIT,
      (unsigned)options->max_http_connections + REFUSALS_AT_ONCE, MHD_OPTION_CONNECTION_TIMEOUT,
      (unsigned)(options->frame_timeout_ms + 999) / 1000, MHD_OPTION_CONNECTION_MEMORY_LIMIT,
      (size_t)HTTP_CONNECTION_BYTES, MHD_OPTION_UNESCAPE_CALLBACK, http_header_leave_escaped, NULL,
      MHD_OPTION_URI_LOG_CALLBACK, http_connection_begin, host, MHD_OPTION_NOTIFY_COMPLETED,
      http_connection_complete, host, MHD_OPTION_NOTIFY_CONNECTION, http_connection_notify, host,
      MHD_OPTION_END);
}

static bool open_port(struct http_service *service, struct port *port, int fd) {
  char bound[TCP_TEXT_BYTES];
  tcp_bound(fd, bound);
  port->daemon = start_daemon(&service->host, fd); /* start_daemon() owns the socket from here on */
  if (port->daemon == NULL) {
    fprintf(stderr, "dipoled: --http %s: the HTTP server does not start\n", bound);
    close(fd);
    return false;
  }
  log_line(LOG_LEVEL_INFO, "event=listening url=http://%s", bound);
  return true;
}

struct http_service *http_service_open(struct server *server, struct worker *worker) {
  int fds[TCP_ADDRESSES_MAX];
  struct http_service *service = calloc(1, sizeof *service);
  if (service == NULL) {
    return NULL;
  }
  service->client.kind = &kind;
  service->host = (struct http_host){
      .server = server,
      .worker = worker,
      .buffers = {.most = server->options.max_total_bytes / 2, .whole = &server->buffers},
      .service = &service->client};
  service->count = tcp_listen_option("http", server->options.http, fds);
  bool good = service->count > 0;
  for (size_t i = 0; i < service->count; i++) {
    good &= open_port(service, &service->ports[i], fds[i]);
  }
  if (!good) {
    for (size_t i = 0; i < service->count; i++) {
      MHD_stop_daemon(service->ports[i].daemon);
    }
    free(service);
    return NULL;
  }
  worker_give(worker, &service->client);
  return service;
}

void http_service_free(struct http_service *service) {
  free(service);
}
