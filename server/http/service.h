/* service: serves HTTP and JSON (--http) on its own worker, so that what it does with texts
 * delays no client of the binary protocol. */
#ifndef DIPOLED_HTTP_SERVICE_H
#define DIPOLED_HTTP_SERVICE_H

#include "server/server.h"

struct http_service;
struct worker;

/* Listens at --http, and logs the address. The worker, which has started, serves what arrives. On
 * failure, prints a message to standard error and returns NULL. */
struct http_service *http_service_open(struct server *server, struct worker *worker);

/* Frees the service after its worker has ended. `service` may be NULL. */
void http_service_free(struct http_service *service);

#endif
