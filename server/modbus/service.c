#include "server/modbus/service.h"

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "server/net/worker.h"
#include "server/observe/log.h"

static struct modbus_service *complain(struct modbus_service *service, const char *what,
                                       const char *why) {
  fprintf(stderr, "dipoled: %s: %s\n", what, why);
  modbus_service_free(service);
  return NULL;
}

/* ---- beginning and end ------------------------------------------------------------------------
 */

struct modbus_service *modbus_service_new(struct server *server) {
  struct modbus_service *service = calloc(1, sizeof *service);
  if (service == NULL) {
    return complain(NULL, "--modbus", "out of memory");
  }
  service->server = server;
  uv_mutex_init(&service->mutex);
  service->banks = calloc(MODBUS_UNITS + 1, sizeof *service->banks);
  if (!modbus_codec_open(&service->codec) || service->banks == NULL) {
    return complain(service, "--modbus", "out of memory or file descriptors");
  }
  const char *wrong = "";
  if (!modbus_access_read(&server->options.modbus_allow, &service->access, &wrong)) {
    fprintf(stderr, "dipoled: '%s': ", wrong);
    return complain(service, "--modbus-allow", "an address, or ADDRESS/BITS");
  }
  return service;
}

void modbus_service_free(struct modbus_service *service) {
  if (service != NULL) {
    for (size_t i = 0; i < service->line_count; i++) {
      modbus_line_close(&service->lines[i]);
    }
    modbus_codec_close(&service->codec);
    uv_mutex_destroy(&service->mutex);
    free(service->banks);
    free(service);
  }
}

bool modbus_service_open_line(struct modbus_service *service, const char *url) {
  return modbus_line_open(&service->lines[service->line_count++], service, url);
}

/* ---- from other threads -----------------------------------------------------------------------
 */

void modbus_service_begin(struct modbus_service *service) {
  uv_mutex_lock(&service->mutex);
  service->begun = true;
  uv_mutex_unlock(&service->mutex);
  uv_async_send(&service->worker->wake);
}

static void give(struct modbus_service *service, struct modbus_connection *connection) {
  uv_mutex_lock(&service->mutex);
  connection->next = service->inbox;
  service->inbox = connection;
  uv_mutex_unlock(&service->mutex);
  uv_async_send(&service->worker->wake);
}

/* NULL: it may come in; else why not. */
static const char *refusal(const struct modbus_service *service, int fd) {
  struct sockaddr_storage peer = {0};
  socklen_t length = sizeof peer;
  if (getpeername(fd, (struct sockaddr *)&peer, &length) != 0 ||
      !modbus_access_allows(&service->access, (const struct sockaddr *)&peer)) {
    return "not-allowed";
  }
  const struct server *server = service->server;
  return stats_get(&server->stats, STATS_MODBUS_CONNECTIONS_OPEN) >=
                 server->options.max_modbus_connections
             ? "max-modbus-connections"
             : NULL;
}

void modbus_service_admit(struct server *server, int fd) {
  struct modbus_service *service = server->modbus;
  const char *why = refusal(service, fd);
  struct modbus_connection *connection = why == NULL ? modbus_connection_new(service, fd) : NULL;
  if (connection == NULL) {
    log_peer_line(LOG_LEVEL_INFO, "event=modbus-refused reason=%s",
                  why != NULL ? why : "out-of-memory");
    stats_add(&server->stats, STATS_MODBUS_CONNECTIONS_REFUSED, 1);
    close(fd);
    return;
  }
  stats_add(&server->stats, STATS_MODBUS_CONNECTIONS_ACCEPTED, 1);
  stats_add(&server->stats, STATS_MODBUS_CONNECTIONS_OPEN, 1);
  give(service, connection);
}

static void start_lines(struct modbus_service *service) {
  service->started = true;
  for (size_t i = 0; i < service->line_count; i++) {
    modbus_line_start(&service->lines[i]);
  }
}

void modbus_service_wake(struct modbus_service *service) {
  if (service == NULL) {
    return;
  }
  uv_mutex_lock(&service->mutex);
  struct modbus_connection *given = service->inbox;
  service->inbox = NULL;
  const bool begun = service->begun;
  uv_mutex_unlock(&service->mutex);
  if (begun && !service->started) {
    start_lines(service);
  }
  while (given != NULL) {
    struct modbus_connection *next = given->next;
    modbus_connection_start(given);
    given = next;
  }
}

/* ---- all connections ---------------------------------------------------------------------------
 */

void modbus_service_remember(struct modbus_service *service, struct modbus_connection *c) {
  c->previous = NULL;
  c->next = service->connections;
  if (service->connections != NULL) {
    service->connections->previous = c;
  }
  service->connections = c;
}

static void remove_from_run_queue(struct modbus_service *service, struct modbus_connection *c) {
  struct modbus_connection *last = NULL;
  struct modbus_connection **link = &service->run_first;
  while (*link != NULL) {
    if (*link == c) {
      *link = c->next_to_run;
    } else {
      last = *link;
      link = &(*link)->next_to_run;
    }
  }
  service->run_last = last;
  c->to_run = false;
}

void modbus_service_forget(struct modbus_service *service, struct modbus_connection *c) {
  if (c->to_run) {
    remove_from_run_queue(service, c);
  }
  if (c->previous != NULL) {
    c->previous->next = c->next;
  } else {
    service->connections = c->next;
  }
  if (c->next != NULL) {
    c->next->previous = c->previous;
  }
}

static void for_each(struct modbus_service *service, void (*act)(struct modbus_connection *c)) {
  struct modbus_connection *next;
  for (struct modbus_connection *c = service->connections; c != NULL; c = next) {
    next = c->next;
    act(c);
  }
}

/* ---- a round of the loop ----------------------------------------------------------------------
 */

void modbus_service_run_later(struct modbus_service *service, struct modbus_connection *c) {
  if (c->to_run) {
    return;
  }
  c->to_run = true;
  c->next_to_run = NULL;
  if (service->run_last == NULL) {
    service->run_first = c;
  } else {
    service->run_last->next_to_run = c;
  }
  service->run_last = c;
}

void modbus_service_run(struct modbus_service *service) {
  struct modbus_connection *c = service != NULL ? service->run_first : NULL;
  if (c == NULL) {
    return;
  }
  service->run_first = service->run_last = NULL; /* those that come back have the next turn */
  while (c != NULL) {
    struct modbus_connection *next = c->next_to_run;
    c->to_run = false;
    modbus_connection_run(c);
    c = next;
  }
}

bool modbus_service_has_work(const struct modbus_service *service) {
  return service != NULL && service->run_first != NULL;
}

void modbus_service_finish(struct modbus_service *service) {
  while (service != NULL && service->done.first != NULL) {
    struct modbus_bank *bank = service->done.first;
    service->done.first = bank->next_done;
    modbus_bank_finish(bank);
  }
}

/* A request for a unit whose last commit is still being gathered in the batch comes after it. */
struct modbus_bank *modbus_service_bank(struct modbus_service *service, unsigned unit) {
  struct modbus_bank *bank = &service->banks[unit];
  if (bank->worker == NULL) {
    modbus_bank_start(bank, service->worker, &service->done);
  } else if (bank->evaluating) {
    batch_finish(&worker_context(service->worker)->batch, &service->server->stats);
    modbus_service_finish(service);
  }
  return bank;
}

void modbus_service_tick(struct modbus_service *service, uint64_t now_ms) {
  if (service == NULL) {
    return;
  }
  struct modbus_connection *next;
  for (struct modbus_connection *c = service->connections; c != NULL; c = next) {
    next = c->next;
    modbus_connection_tick(c, now_ms);
  }
}

/* ---- stopping ---------------------------------------------------------------------------------
 */

void modbus_service_stop(struct modbus_service *service) {
  if (service != NULL) {
    for_each(service, modbus_connection_stop);
    for (size_t i = 0; i < service->line_count; i++) {
      modbus_line_stop(&service->lines[i]);
    }
  }
}

void modbus_service_end(struct modbus_service *service) {
  for (unsigned unit = 1; service != NULL && unit <= MODBUS_UNITS; unit++) {
    if (service->banks[unit].busy) {
      modbus_bank_end(&service->banks[unit]);
    }
  }
}

void modbus_service_abort(struct modbus_service *service) {
  if (service != NULL) {
    for_each(service, modbus_connection_abort);
  }
}

bool modbus_service_has_stopped(const struct modbus_service *service) {
  if (service == NULL) {
    return true;
  }
  for (size_t i = 0; i < service->line_count; i++) {
    if (!modbus_line_has_stopped(&service->lines[i])) {
      return false;
    }
  }
  return service->connections == NULL;
}
