/* service: sets Modbus up. It opens serial lines, decides who may connect, and gives connections,
 * lines and units to the first worker. */
#ifndef DIPOLED_MODBUS_SERVICE_H
#define DIPOLED_MODBUS_SERVICE_H

#include "server/server.h"

/* Sets the service up. Call this before the workers start. If it fails, prints a message to
 * standard error and returns NULL. */
struct modbus_service *modbus_service_new(struct server *server);

/* Frees the service, which may be NULL. Call this after the workers have ended. */
void modbus_service_free(struct modbus_service *service);

/* Opens rtu:DEVICE[,BAUD[,PARITY[,UNIT]]] and logs it, or logs that the device is missing, which
 * the worker opens later. Call this before modbus_service_begin(). If the option is wrong, prints a
 * message to standard error and returns false. */
bool modbus_service_open_line(struct modbus_service *service, const char *url);

/* Gives the lines to the worker. Call this when the workers have started and all lines are open. */
void modbus_service_begin(struct modbus_service *service);

/* Gives a connected socket to the worker, or closes it if its peer may not connect. Listeners call
 * this. */
void modbus_service_admit(struct server *server, int fd);

/* The same for MODBUS/TCP Security: a TLS handshake comes first. */
void modbus_service_admit_tls(struct server *server, int fd);

#endif
