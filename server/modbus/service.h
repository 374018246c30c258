/* service: sets Modbus up. It opens serial lines, decides who may connect, and gives connections,
 * lines and units to the first worker. */
#ifndef DIPOLED_MODBUS_SERVICE_H
#define DIPOLED_MODBUS_SERVICE_H

#include "server/server.h"

/* Call this before the workers start. NULL, with a message on standard error: it failed. */
struct modbus_service *modbus_service_new(struct server *server);

/* Call this after the workers have ended. `service` may be NULL. */
void modbus_service_free(struct modbus_service *service);

/* Opens rtu:DEVICE,BAUD,PARITY[,UNIT] and logs it. Call this before modbus_service_begin(). False,
 * with a message on standard error: it failed. */
bool modbus_service_open_line(struct modbus_service *service, const char *url);

/* The workers have started and all lines are open: gives the lines to the worker. */
void modbus_service_begin(struct modbus_service *service);

/* Takes a connected socket: gives it to the worker or closes it. For listeners. */
void modbus_service_admit(struct server *server, int fd);

#endif
