/* mc_task: one Monte Carlo request being worked off: what is walked, when it is enough, and the
 * table. Independent of threads and connections. */
#ifndef DIPOLED_MC_TASK_H
#define DIPOLED_MC_TASK_H

#include <stdatomic.h>

#include "proto/mc.h"
#include "server/server.h"

/* Standard errors are not believed before so many batches: they are then known to 13 %. */
enum { MC_TASK_BATCHES_MIN = 32 };

/* What a batch walks at a time, in scatterings: 1 to 4 ms, after which whoever walks it looks
 * whether it is still wanted. */
enum { MC_TASK_SLICE_SCATTERINGS = 100000 };

struct mc_task {
  core_mc_request request;
  double error_total; /* enough, 0: not asked for */
  double error_rings;
  uint64_t batches_max;
  uint32_t side_count;
  uint32_t ring_count;
  mc_layout layout;
  core_mc_plan *plan;
  core_mc_total *total;
  core_mc_ring *rings; /* [ring_count], scratch */
  uint8_t *table;      /* layout.payload_bytes: the last reply's payload */
  uint64_t next_look;  /* after so many batches the errors are looked at again */
  wire_mc_reply progress;
  atomic_bool ends; /* set by any thread: no more looks, the table is wanted, or nothing at all */
};

/* Checks all of a request; on OK the task is set but for what mc_task_open() allocates. */
wire_error mc_task_check(struct mc_task *task, const struct server *server, const uint8_t *payload,
                         size_t payload_bytes);

/* Upper bound of what the task and so many batches take. */
uint64_t mc_task_bytes(const struct mc_task *task, uint64_t batches);

/* False: out of memory. In either case to be closed. */
bool mc_task_open(struct mc_task *task);
void mc_task_close(struct mc_task *task);

/* Merges the next batch, done; task->progress is up to date then. */
void mc_task_merge(struct mc_task *task, const core_mc_batch *batch);

/* Writes the table, with the state that it ends in. */
void mc_task_write_table(struct mc_task *task, enum mc_state state);

#endif
