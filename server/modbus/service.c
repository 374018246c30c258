#include "server/modbus/service.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/modbus/connection.h"
#include "server/modbus/line.h"
#include "server/net/access.h"
#include "server/net/handshake.h"
#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

struct modbus_service {
  struct server *server;
  struct access connect; /* masters that may connect */
  struct access write;   /* masters that may also write */
  struct modbus_units *units;
  struct modbus_line lines[OPTIONS_LIST_MAX];
  size_t line_count;
};

struct modbus_service *modbus_service_new(struct server *server) {
  struct modbus_service *service = calloc(1, sizeof *service);
  struct modbus_units *units = service != NULL ? modbus_units_new(server) : NULL;
  if (units == NULL) {
    fprintf(stderr, "dipoled: --modbus: out of memory\n");
    free(service);
    return NULL;
  }
  service->server = server;
  service->units = units;
  const struct options *options = &server->options;
  if (!access_read_option("modbus-allow", &options->modbus_allow, &access_this_machine,
                          &service->connect) ||
      !access_read_option("modbus-allow-write", &options->modbus_allow_write, &access_anyone,
                          &service->write)) {
    modbus_service_free(service);
    return NULL;
  }
  return service;
}

void modbus_service_free(struct modbus_service *service) {
  if (service != NULL) {
    for (size_t i = 0; i < service->line_count; i++) {
      modbus_line_close(&service->lines[i]);
    }
    free(service->units);
    free(service);
  }
}

bool modbus_service_open_line(struct modbus_service *service, const char *url) {
  const struct modbus_line *line = &service->lines[service->line_count];
  bool good = modbus_line_open(&service->lines[service->line_count++], service->units, url);
  for (size_t i = 0; good && &service->lines[i] < line; i++) {
    good = strcmp(service->lines[i].device.path, line->device.path) != 0;
    if (!good) {
      fprintf(stderr, "dipoled: --modbus %s: name each device once\n", url);
    }
  }
  return good;
}

void modbus_service_begin(struct modbus_service *service) {
  struct worker *worker = &service->server->workers[0];
  worker_give(worker, &service->units->client);
  for (size_t i = 0; i < service->line_count; i++) {
    worker_give(worker, &service->lines[i].client);
  }
}

/* Returns the reason why a peer may not connect, or NULL if it may. */
static const char *refusal(const struct modbus_service *service, int fd) {
  if (!access_allows_peer(&service->connect, fd)) {
    return "not-allowed";
  }
  const struct server *server = service->server;
  return stats_get(&server->stats, STATS_MODBUS_CONNECTIONS_OPEN) >=
                 server->options.max_modbus_connections
             ? "max-modbus-connections"
             : NULL;
}

static void refuse_socket(struct server *server, int fd, const char *why) {
  char peer[TCP_TEXT_BYTES];
  tcp_peer(fd, peer);
  log_peer_line(LOG_LEVEL_INFO, "event=modbus-refused reason=%s%s%s", why,
                LOG_FIELD(" peer=", peer));
  stats_add(&server->stats, STATS_MODBUS_CONNECTIONS_REFUSED, 1);
  close(fd);
}

/* Gives a connection to the worker. session: NULL if its bytes are plain. */
static void give_to_worker(struct server *server, int fd, struct tls_session *session) {
  struct modbus_service *service = server->modbus;
  const unsigned roles = (session != NULL ? tls_session_roles(session) : ROLE_ALL) &
                         (access_allows_peer(&service->write, fd) ? ROLE_ALL : ~ROLE_WRITE);
  const char *why = refusal(service, fd);
  struct modbus_connection *connection =
      why == NULL ? modbus_connection_new(service->units, fd, session, roles) : NULL;
  if (connection == NULL) {
    tls_session_free(session);
    refuse_socket(server, fd, why != NULL ? why : "out-of-memory");
    return;
  }
  stats_add(&server->stats, STATS_MODBUS_CONNECTIONS_ACCEPTED, 1);
  stats_add(&server->stats, STATS_MODBUS_CONNECTIONS_OPEN, 1);
  worker_give(&server->workers[0], &connection->transport.client);
}

void modbus_service_admit(struct server *server, int fd) {
  give_to_worker(server, fd, NULL);
}

void modbus_service_admit_tls(struct server *server, int fd) {
  const char *why = refusal(server->modbus, fd);
  if (why != NULL) {
    refuse_socket(server, fd, why);
  } else {
    handshakes_begin(server, fd, give_to_worker);
  }
}
