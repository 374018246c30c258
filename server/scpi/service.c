#include "server/scpi/service.h"

#include <unistd.h>

#include "server/net/listener.h"
#include "server/net/worker.h"
#include "server/observe/log.h"
#include "server/scpi/connection.h"

void scpi_service_admit(struct server *server, int fd) {
  const uint64_t open = stats_get(&server->stats, STATS_SCPI_CONNECTIONS_OPEN);
  const char *why = !access_allows_peer(&server->scpi_allow, fd)   ? "not-allowed"
                    : open >= server->options.max_scpi_connections ? "max-scpi-connections"
                                                                   : NULL;
  struct scpi_connection *connection = why == NULL ? scpi_connection_new(server, fd) : NULL;
  if (connection == NULL) {
    char peer[TCP_TEXT_BYTES];
    tcp_peer(fd, peer);
    log_peer_line(LOG_LEVEL_INFO, "event=scpi-refused reason=%s%s%s",
                  why != NULL ? why : "out-of-memory", LOG_FIELD(" peer=", peer));
    stats_add(&server->stats, STATS_SCPI_CONNECTIONS_REFUSED, 1);
    close(fd);
    return;
  }
  stats_add(&server->stats, STATS_SCPI_CONNECTIONS_ACCEPTED, 1);
  stats_add(&server->stats, STATS_SCPI_CONNECTIONS_OPEN, 1);
  worker_give(listener_least_busy(server), &connection->transport.client);
}
