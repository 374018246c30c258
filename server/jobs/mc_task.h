/* mc_task: one Monte Carlo request: which photons are walked, when the errors are small enough, and
 * the table of results. It knows neither threads nor connections. */
#ifndef DIPOLED_MC_TASK_H
#define DIPOLED_MC_TASK_H

#include <stdatomic.h>

#include "proto/mc.h"
#include "server/server.h"

/* Standard errors are trusted from this number of batches on: they are then known to 13 %. */
enum { MC_TASK_BATCHES_MIN = 32 };

/* How many scatterings a thread walks at a time: 1 to 4 ms. Then it checks whether the job is still
 * wanted. */
enum { MC_TASK_SLICE_SCATTERINGS = 100000 };

struct mc_task {
  core_mc_request request;
  double error_total; /* small enough for the client; 0 if it named none */
  double error_rings; /* likewise */
  uint64_t batches_max;
  uint32_t side_count;
  uint32_t ring_count;
  mc_layout layout;
  core_mc_plan *plan;
  core_mc_total *total;
  core_mc_ring *rings; /* [ring_count], working space */
  uint8_t *table;      /* [layout.payload_bytes]: payload of the last reply */
  uint64_t next_check; /* number of batches after which the errors are checked again */
  wire_mc_reply progress;
  atomic_bool ends; /* set by any thread: the job ends, so errors are not checked any more */
};

/* Checks all of a request. On OK, all members are set except those that mc_task_open() allocates.
 */
wire_error mc_task_check(struct mc_task *task, const struct server *server, const uint8_t *payload,
                         size_t payload_bytes);

/* An upper bound of the memory for the task and so many batches. */
uint64_t mc_task_bytes(const struct mc_task *task, uint64_t batches);

/* Allocates what the task needs; returns false if there is no memory. Call mc_task_close() in
 * either case. */
bool mc_task_open(struct mc_task *task);
void mc_task_close(struct mc_task *task);

/* Adds the next batch, which has been walked, to the results and updates task->progress. */
void mc_task_merge(struct mc_task *task, const core_mc_batch *batch);

/* Writes the table. state: why the task has ended. */
void mc_task_write_table(struct mc_task *task, enum mc_state state);

#endif
