/* task: one kind of job of a unit, from the commit to its results in the registers.
 *
 * A commit starts the job and gives it a slice at once, which is enough for most jobs. The other
 * jobs go on in the turns of the queue, one slice after the other, or wait for a profile or for the
 * threads of Monte Carlo. The values of a job that is done may still be in the worker's batch; they
 * are in the registers after the batch has been evaluated.
 *
 * A task knows neither the master nor the functions of Modbus. Call all functions on the worker's
 * thread.
 */
#ifndef DIPOLED_MODBUS_TASK_H
#define DIPOLED_MODBUS_TASK_H

#include "server/jobs/run.h"
#include "server/modbus/translate.h"
#include "server/net/client.h"

enum modbus_task_state {
  MODBUS_TASK_IDLE,
  MODBUS_TASK_RUNS,      /* the job has its next slice when its turn comes */
  MODBUS_TASK_WAITS,     /* the job waits for a profile, or for the threads of Monte Carlo */
  MODBUS_TASK_EVALUATED, /* the results are in the registers after the batch */
  MODBUS_TASK_STATES
};

struct modbus_queue;
struct modbus_unit;

struct modbus_task {
  struct modbus_queue *queue;
  enum registers_job_kind kind;
  uint16_t *registers; /* registers of the unit */
  struct modbus_unit *owner;
  enum modbus_task_state state;
  TAILQ_ENTRY(modbus_task) in_queue; /* in the list of its state, unless the task is idle */
  uint16_t token;                    /* the value of `commit` that has started the job */
  bool cancelled;                    /* whether the job ends early with its results so far */
  uint64_t named_ms;                 /* when a request last named the unit, on the loop's clock */
  uint64_t owed_radii;               /* owed_radii of the job when it started */
  struct run run;
  wire_error error; /* after the run: why the job was refused; OK: it was not */
  size_t reply_bytes;
  _Alignas(8) uint8_t request[MODBUS_REQUEST_BYTES];
  _Alignas(8) uint8_t reply[MODBUS_REPLY_BYTES];
};

/* The tasks of all units that are not idle. */
struct modbus_queue {
  struct client *client; /* the client in whose turns all tasks run */
  struct server *server;
  /* A list for each state. The task that had the latest turn comes last. */
  TAILQ_HEAD(modbus_tasks, modbus_task) tasks[MODBUS_TASK_STATES];
};

void modbus_queue_init(struct modbus_queue *queue, struct server *server, struct client *client);

/* Takes one turn of the client: gives slices to the first tasks that run. */
void modbus_queue_run(struct modbus_queue *queue);

/* Call this when the batch has been evaluated. Writes the results of one task that was in the batch
 * into its registers and returns the task, which is then idle. Returns NULL if there is no such
 * task. */
struct modbus_task *modbus_queue_finish(struct modbus_queue *queue);

/* Ends the jobs whose deadline has passed, and the detached ones whose unit no request has named
 * for too long. */
void modbus_queue_expire(struct modbus_queue *queue);

/* Moves the jobs that `from` has committed, when `from` ends: they go on in the turns of `to`. */
void modbus_queue_move(struct modbus_queue *queue, struct client *from, struct client *to);

/* Ends all jobs without results. */
void modbus_queue_end(struct modbus_queue *queue);

static inline bool modbus_task_busy(const struct modbus_task *task) {
  return task->state != MODBUS_TASK_IDLE;
}

/* Starts the job that the registers describe, for a master whose slow profiles are prepared in the
 * turns of `master`. The task must be idle. If this returns OK, the task is in another state, and
 * the registers say busy unless the state is EVALUATED. */
wire_error modbus_task_commit(struct modbus_task *task, struct client *master);

/* Writes the reason why a commit has failed into the task's registers. at: the register at
 * fault. */
void modbus_task_fail(struct modbus_task *task, const wire_error *error, unsigned at);

/* Ends the running job, if any: at once, or soon with its results so far if it is Monte Carlo. */
void modbus_task_cancel(struct modbus_task *task);

/* Notes that a request has named the unit. */
void modbus_task_name(struct modbus_task *task);

/* Writes progress and place of the running job into the registers. */
void modbus_task_refresh(struct modbus_task *task);

#endif
