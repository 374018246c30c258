/* service: decides who may connect for SCPI, and gives connections to the workers. */
#ifndef DIPOLED_SCPI_SERVICE_H
#define DIPOLED_SCPI_SERVICE_H

#include "server/server.h"

/* Gives a connected socket to the worker with the fewest clients, or closes it if its peer may not
 * connect. Listeners call this. */
void scpi_service_admit(struct server *server, int fd);

#endif
