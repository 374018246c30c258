/* mc_task: the work of one Monte Carlo request: which photons are walked, when their errors are
 * small enough, and the table of results. It knows neither threads nor connections. */
#ifndef DIPOLED_MC_TASK_H
#define DIPOLED_MC_TASK_H

#include <stdatomic.h>

#include "proto/mc.h"
#include "server/server.h"

/* The fewest batches for which standard errors are trusted: they are then known to 13 %. */
enum { MC_TASK_BATCHES_MIN = 32 };

/* How many scatterings a thread walks before it checks whether the job is still wanted: this takes
 * 1 to 4 ms. */
enum { MC_TASK_SLICE_SCATTERINGS = 100000 };

struct mc_task {
  core_mc_request request;
  double error_total; /* the error of the total R that the client requested; 0 if it named none */
  double error_rings; /* the error of each ring that it requested; 0 if it named none */
  uint64_t batches_max;
  uint32_t side_count;
  uint32_t ring_count;
  mc_layout layout;
  core_mc_plan *plan;
  core_mc_total *total;
  core_mc_ring *rings; /* [ring_count], working space */
  uint8_t *table;      /* [layout.payload_bytes]: payload of the last reply */
  uint64_t next_check; /* the number of batches at which the errors are checked next */
  wire_mc_reply progress;
  atomic_bool ends; /* set by any thread: the job ends, so errors are not checked any more */
};

/* Checks a request. If it is valid, sets all members except those that mc_task_open() allocates. */
wire_error mc_task_check(struct mc_task *task, const struct server *server, const uint8_t *payload,
                         size_t payload_bytes);

/* Returns an upper bound of the memory for the task with this number of batches. */
uint64_t mc_task_bytes(const struct mc_task *task, uint64_t batches);

/* Allocates the memory of the task. Returns false if there is none. Call mc_task_close() in either
 * case. */
bool mc_task_open(struct mc_task *task);
void mc_task_close(struct mc_task *task);

/* Adds the next batch, which is complete, to the results, and updates task->progress. */
void mc_task_merge(struct mc_task *task, const core_mc_batch *batch);

/* Writes the table. state: why the task has ended. */
void mc_task_write_table(struct mc_task *task, enum mc_state state);

#endif
