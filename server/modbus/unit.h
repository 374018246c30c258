/* unit: the registers and coils of the Modbus units, and the jobs that the registers describe.
 *
 * Masters that name the same unit share its registers. So their requests need an order, and each of
 * them has to be atomic. Both hold without a lock because all units, connections and lines belong
 * to one worker, the first. What is evaluated for them goes through that worker's profiles, batch
 * and repeated requests, together with those of its other clients.
 *
 * Writing to the register `commit` starts a job. If its profile takes long to prepare, the register
 * `status` says busy meanwhile, and the master asks again. Otherwise the job's values are in the
 * worker's batch, and the master gets its answer when the batch has been evaluated.
 */
#ifndef DIPOLED_MODBUS_UNIT_H
#define DIPOLED_MODBUS_UNIT_H

#include "server/jobs/job.h"
#include "server/modbus/translate.h"
#include "server/net/client.h"

enum { MODBUS_UNITS = 247 }; /* they have the numbers 1 to 247 */

struct modbus_unit {
  struct modbus_units *units; /* NULL: the unit has not been used yet */
  bool busy;                  /* the job waits for its profile */
  bool evaluating;            /* the job's values are in the batch */
  struct modbus_unit *next_evaluating;
  struct client
      *client;     /* finish() is called when the job has been evaluated; NULL: nobody waits */
  uint16_t token;  /* the value of `commit` that has started the job */
  struct job *job; /* in the slot */
  struct job_slot slot;
  uint16_t registers[REGISTERS_END];
  uint8_t coils[REGISTERS_COILS]; /* 0 or 1 each */
  _Alignas(8) uint8_t question[MODBUS_QUESTION_BYTES];
  _Alignas(8) uint8_t reply[MODBUS_REPLY_BYTES];
};

/* All units. As a client of the worker they take the results from the batch, and they stay until
 * the last connection or line has ended. */
struct modbus_units {
  struct client client; /* first */
  struct server *server;
  unsigned users; /* connections and lines */
  bool stopping;
  struct modbus_unit *evaluating; /* the list of those */
  struct modbus_unit units[MODBUS_UNITS + 1];
};

/* NULL: out of memory. Before the worker serves any Modbus client, `client` is given to it. */
struct modbus_units *modbus_units_new(struct server *server);

/* Call the functions that follow on the worker's thread only. */

/* A connection or line begins and ends to use the units. Its jobs that wait for a profile go on
 * waiting, because masters may come back for the results: all such jobs share one place among
 * those that wait. */
void modbus_units_join(struct modbus_units *units);
void modbus_units_leave(struct modbus_units *units, struct client *client);

/* The unit of a number from 1 to MODBUS_UNITS. If a job of it is in the batch, the batch is
 * evaluated first, so that requests take effect in their order. */
struct modbus_unit *modbus_units_get(struct modbus_units *units, unsigned number);

/* Writes registers, and starts the job if `commit` is among them. `values` are as in a PDU. Returns
 * 0 if that was done; if unit->evaluating is true then, client's finish() will be called when the
 * results are in the registers. Otherwise returns the Modbus exception; then nothing but the error
 * registers has changed. */
unsigned modbus_unit_write(struct modbus_unit *unit, unsigned address, unsigned count,
                           const uint8_t *values, struct client *client);

/* Notes in the error registers why a request to write was refused: the status, and the address of
 * the register at fault. */
void modbus_unit_note_refusal(struct modbus_unit *unit, const wire_error *error, unsigned at);

/* The client has ended and will not be called. */
void modbus_unit_forget(struct modbus_unit *unit, const struct client *client);

#endif
