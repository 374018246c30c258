/* unit: the registers and coils of the Modbus units, and the effect of a write to them.
 *
 * Masters that name the same unit share its registers. So their requests need an order, and each
 * request has to be atomic. Both hold without a lock because all units, connections and lines
 * belong to one worker, the first. Their jobs use that worker's profiles, batch and repeated
 * requests, like the jobs of its other clients.
 *
 * Writing to a register `commit` starts a job (server/modbus/task.h). If the job takes longer than
 * a slice, its register `status` says busy meanwhile, and the master reads again. Otherwise the
 * values are in the worker's batch, and the master gets its reply when the worker has evaluated
 * the batch. A fit takes some slices, but instruments read once: if its design is prepared, the
 * reply waits for it, up to MODBUS_FIT_MS and until another request names the unit.
 */
#ifndef DIPOLED_MODBUS_UNIT_H
#define DIPOLED_MODBUS_UNIT_H

#include "server/modbus/task.h"

enum { MODBUS_UNITS = 247 }; /* numbers of units go from 1 to this */

/* How long a reply waits for a fit: masters often wait for 0.2 s or more. */
enum { MODBUS_FIT_MS = 100 };

struct modbus_unit {
  struct modbus_units *units;  /* NULL: the unit is not in use yet */
  struct modbus_task *awaited; /* the task that the reply to the last commit waits for; or NULL */
  struct client *master;       /* its finish() is called after that; NULL: there is none */
  uint64_t reply_ms;           /* when the reply waits no longer for a fit, on the loop's clock */
  uint64_t named_ms;           /* when a request last named the unit, on the loop's clock */
  bool active;                 /* whether the unit is in units->active */
  TAILQ_ENTRY(modbus_unit) in_active;
  unsigned turns; /* so far: its tasks take turns, too */
  unsigned etas;  /* bits: which eta was written since the registers had their defaults */
  struct modbus_task tasks[REGISTERS_JOBS];
  uint16_t registers[REGISTERS_END];
  uint8_t coils[REGISTERS_COILS]; /* each is 0 or 1 */
};

/* All units. Together they are a client of the worker, which gives turns to their tasks and takes
 * results from the batch. They exist until the last connection or line has ended. */
struct modbus_units {
  struct client client; /* first member: see client.h */
  struct server *server;
  unsigned users; /* number of connections and lines that use the units */
  bool stopping;
  TAILQ_HEAD(modbus_active, modbus_unit)
  active; /* those with busy tasks; the latest turn is last */
  struct modbus_unit units[MODBUS_UNITS + 1];
};

/* Makes the units. The caller gives `client` to the worker before the first Modbus client. Returns
 * NULL if there is no memory. */
struct modbus_units *modbus_units_new(struct server *server);

/* Call the functions that follow on the worker's thread only. */

/* Call this when a connection or line, which has counted itself in `users`, ends to use the units. Its
 * jobs go on, because masters may come back for the results. Their slow profiles are prepared in the
 * turns of one client then. */
void modbus_units_leave(struct modbus_units *units, struct client *client);

/* Ends all jobs, and gives the registers of all units their defaults when they are next used. */
void modbus_units_reset(struct modbus_units *units);

/* Returns the unit of a number from 1 to MODBUS_UNITS. If a job of this unit is in the batch, first
 * evaluates the batch, so that requests take effect in their order. If a reply waits for a fit, it
 * waits no longer. */
struct modbus_unit *modbus_units_get(struct modbus_units *units, unsigned number);

/* Writes registers, and starts a job if a `commit` is among them, or ends one if a `cancel` is.
 * values: as in a PDU. Returns 0 on success; if unit->awaited is then set, the worker calls the
 * client's finish() when the results are in the registers. On failure, returns the Modbus exception
 * and changes only the error registers. */
unsigned modbus_unit_write(struct modbus_unit *unit, unsigned address, unsigned count,
                           const uint8_t *values, struct client *client);

/* Updates `progress`, if it is among these registers. */
void modbus_unit_refresh(struct modbus_unit *unit, unsigned address, unsigned count);

/* Writes the reason why a write was refused into the error registers. at: the address of the
 * register at fault. */
void modbus_unit_note_refusal(struct modbus_unit *unit, const wire_error *error, unsigned at);

/* Forgets a client that has ended: the unit will not call it. */
void modbus_unit_forget(struct modbus_unit *unit, const struct client *client);

#endif
