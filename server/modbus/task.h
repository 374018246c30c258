/* task: one kind of job of a unit, from the commit to its results in the registers.
 *
 * A commit starts the job and gives it a slice at once, which is enough for most jobs. The other
 * jobs go on in the turns of their unit, one slice after the other, or wait for a profile or for the
 * threads of Monte Carlo. The values of a job that is done may still be in the worker's batch; they
 * are in the registers after the batch has been evaluated.
 *
 * A task knows neither the master nor the functions of Modbus. Call all functions on the worker's
 * thread.
 */
#ifndef DIPOLED_MODBUS_TASK_H
#define DIPOLED_MODBUS_TASK_H

#include "server/jobs/call.h"
#include "server/modbus/translate.h"

struct modbus_task {
  struct call call; /* first member; its client is that of all units */
  enum registers_job_kind kind;
  uint16_t *registers; /* of the unit */
  uint16_t token;      /* value of `commit` that started the job */
  bool cancelled;      /* whether the job ends early, with its results so far */
  uint64_t owed_radii; /* owed_radii of the job when it started */
};

static inline bool modbus_task_busy(const struct modbus_task *task) {
  return task->call.state == CALL_RUNS || task->call.state == CALL_ENDS;
}

/* Returns whether the job has its next slice when the turn of its unit comes. */
static inline bool modbus_task_runs(const struct modbus_task *task) {
  return task->call.run.state == RUN_GOES_ON;
}

void modbus_task_init(struct modbus_task *task, enum registers_job_kind kind, uint16_t *registers,
                      struct client *client, struct budget *buffers);

/* Starts the job that the registers describe, for a master whose slow profiles are prepared in the
 * turns of `master`. The task must not be busy. If this returns OK, it is busy, and the registers say
 * so unless the job is evaluated. */
wire_error modbus_task_commit(struct modbus_task *task, struct client *master);

/* Lets the profiles of a job be prepared in the turns of `to` if they were in those of `from`. */
void modbus_task_move(struct modbus_task *task, struct client *from, struct client *to);

/* Call this when the batch has been evaluated: writes the results of a job that has ended, or why it
 * failed. */
void modbus_task_finish(struct modbus_task *task);

/* Ends the job if its deadline has passed, or, for Monte Carlo, if no request has named the unit since
 * named_ms for too long. */
void modbus_task_expire(struct modbus_task *task, uint64_t named_ms);

/* Writes the reason why a commit has failed into the task's registers. at: the register at
 * fault. */
void modbus_task_fail(struct modbus_task *task, const wire_error *error, unsigned at);

/* Ends the running job, if any: at once, or soon with its results so far if it is Monte Carlo. */
void modbus_task_cancel(struct modbus_task *task);

/* Writes the progress of the running job into the registers. */
void modbus_task_refresh(struct modbus_task *task);

#endif
