/* task: one kind of job of a unit, from the commit to its results in the registers.
 *
 * A commit starts the job, which then gets a slice at once. Most jobs are done by then. The others
 * go on in the turns of the queue, one slice after the other, or wait for a profile or for the
 * threads of Monte Carlo. The values of a job that is done may still be in the worker's batch. They
 * are in the registers after the batch has been evaluated.
 *
 * A task knows neither the master nor the functions of Modbus. All functions belong on the worker's
 * thread.
 */
#ifndef DIPOLED_MODBUS_TASK_H
#define DIPOLED_MODBUS_TASK_H

#include "server/jobs/job.h"
#include "server/modbus/translate.h"
#include "server/net/client.h"

enum modbus_task_state {
  MODBUS_TASK_IDLE,
  MODBUS_TASK_RUNS,      /* has the next slice in its turn */
  MODBUS_TASK_WAITS,     /* for a profile, or for the threads of Monte Carlo */
  MODBUS_TASK_EVALUATED, /* its results come with the batch */
};

struct modbus_queue;
struct modbus_unit;

struct modbus_task {
  struct modbus_queue *queue;
  enum registers_job_kind kind;
  uint16_t *registers; /* the unit's */
  struct modbus_unit *owner;
  enum modbus_task_state state;
  TAILQ_ENTRY(modbus_task) in_queue; /* unless it is idle */
  uint16_t token;                    /* the value of `commit` that has started the job */
  bool cancelled;                    /* ends with what it has */
  uint64_t deadline_ms;              /* on the loop's clock; 0: there is none */
  uint64_t owed_radii;               /* of the job when it started */
  struct job *job;                   /* in the slot, or detached */
  struct job *detached;
  struct job_slot slot;
  size_t reply_bytes;
  _Alignas(8) uint8_t question[MODBUS_QUESTION_BYTES];
  _Alignas(8) uint8_t reply[MODBUS_REPLY_BYTES];
};

/* The tasks of all units that are not idle. */
struct modbus_queue {
  struct client *client; /* gets the turns of all of them */
  struct server *server;
  TAILQ_HEAD(modbus_tasks, modbus_task) tasks; /* those that had a turn come last */
};

void modbus_queue_init(struct modbus_queue *queue, struct server *server, struct client *client);

/* One turn of the client: slices for the first tasks that run. */
void modbus_queue_run(struct modbus_queue *queue);

/* The batch has been evaluated: puts the results of a task that was in it into its registers, and
 * returns the task, which is idle again. NULL: there is none. */
struct modbus_task *modbus_queue_finish(struct modbus_queue *queue);

/* Ends the jobs whose deadline has passed. */
void modbus_queue_expire(struct modbus_queue *queue);

/* `from` ends: the jobs that it has committed go on in the turns of `to`. */
void modbus_queue_move(struct modbus_queue *queue, struct client *from, struct client *to);

/* Ends all jobs without results. */
void modbus_queue_end(struct modbus_queue *queue);

static inline bool modbus_task_busy(const struct modbus_task *task) {
  return task->state != MODBUS_TASK_IDLE;
}

/* Starts the job that the registers describe, for a master whose profiles are prepared in the turns
 * of `master`. The task is idle. After OK it is in any other state, and the registers say busy
 * unless it is EVALUATED. */
wire_error modbus_task_commit(struct modbus_task *task, struct client *master);

/* Notes in the task's registers why a commit has failed. `at`: the register at fault. */
void modbus_task_fail(struct modbus_task *task, const wire_error *error, unsigned at);

/* Ends the job, if one is under way: at once, or a Monte Carlo job soon, with what it has. */
void modbus_task_cancel(struct modbus_task *task);

/* Writes progress and place of the job that is under way into the registers. */
void modbus_task_refresh(struct modbus_task *task);

#endif
