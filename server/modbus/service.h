/* service: Modbus, beside the binary protocol: its connections, lines and registers.
 *
 * All of it belongs to one worker, the first. Masters that name the same unit share its registers,
 * so that their requests need one order and each has to be atomic: on one thread they are, without
 * a lock, and a request crosses no threads. What is evaluated for them goes through that worker's
 * profiles, batch and repeated requests, with those of its other connections; what takes long to
 * prepare is prepared on other threads, as for them.
 */
#ifndef DIPOLED_MODBUS_SERVICE_H
#define DIPOLED_MODBUS_SERVICE_H

#include "server/modbus/access.h"
#include "server/modbus/answer.h"
#include "server/modbus/codec.h"
#include "server/modbus/connection.h"
#include "server/modbus/line.h"

struct modbus_service {
  struct server *server;
  struct worker *worker;
  struct modbus_access access;
  struct modbus_codec codec;
  struct modbus_bank *banks; /* [MODBUS_UNITS + 1], by unit; memory is taken as they are used */
  struct modbus_banks_done done;

  uv_mutex_t mutex; /* guards the inbox */
  struct modbus_connection *inbox;
  bool begun;

  struct modbus_connection *connections;
  struct modbus_connection *run_first;
  struct modbus_connection *run_last;
  struct modbus_line lines[OPTIONS_LIST_MAX];
  size_t line_count;
  bool started; /* the lines */
};

/* Before the workers start. NULL, and a message on standard error: it cannot be set up. */
struct modbus_service *modbus_service_new(struct server *server);
void modbus_service_free(struct modbus_service *service); /* after they have ended; NULL: nothing */

/* Opens rtu:DEVICE,BAUD,PARITY[,UNIT] and logs it; before modbus_service_begin(). False, and a
 * message: it cannot be done. */
bool modbus_service_open_line(struct modbus_service *service, const char *url);

/* Any thread: all lines are open, the worker may serve them. */
void modbus_service_begin(struct modbus_service *service);

/* Takes a socket from a listener, on main's thread: it is given to the worker, or closed. */
void modbus_service_admit(struct server *server, int fd);

/* ---- on the worker's thread; with NULL for the service they do nothing ------------------------
 */

/* Something has come from other threads. */
void modbus_service_wake(struct modbus_service *service);

/* In a round of the loop, before batch_finish(): requests that have arrived and wait for a turn. */
void modbus_service_run(struct modbus_service *service);

/* After batch_finish(): results are put in place and answered. */
void modbus_service_finish(struct modbus_service *service);

/* Whether modbus_service_run() has something to do in the next round. */
bool modbus_service_has_work(const struct modbus_service *service);

/* Time has passed. */
void modbus_service_tick(struct modbus_service *service, uint64_t now_ms);

/* Answers what has arrived whole, then closes all; abort: at once. */
void modbus_service_stop(struct modbus_service *service);
void modbus_service_abort(struct modbus_service *service);
bool modbus_service_has_stopped(const struct modbus_service *service);

/* After it has stopped: jobs that are prepared in the background are given up. */
void modbus_service_end(struct modbus_service *service);

/* ---- for connections and lines ----------------------------------------------------------------
 */

/* The registers of a unit, 1 to MODBUS_UNITS, with the results of all that has been committed in
 * time. */
struct modbus_bank *modbus_service_bank(struct modbus_service *service, unsigned unit);

void modbus_service_run_later(struct modbus_service *service, struct modbus_connection *connection);
void modbus_service_remember(struct modbus_service *service, struct modbus_connection *connection);
void modbus_service_forget(struct modbus_service *service, struct modbus_connection *connection);

#endif
