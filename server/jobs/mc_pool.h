/* mc_pool: the threads that walk Monte Carlo jobs, at low priority beside the workers.
 *
 * They are threads of their own, and not libuv's, because a thread that has lowered its priority
 * may not raise it again. They start with the first job. Jobs take turns, slice by slice; a job's
 * batches may be walked by several threads at a time, and are merged in the order of their indices,
 * so that the result does not depend on who walked what.
 */
#ifndef DIPOLED_MC_POOL_H
#define DIPOLED_MC_POOL_H

#include "server/jobs/mc_task.h"

/* Progress is told so often at the most. */
enum { MC_PROGRESS_EVERY_MS = 200 };

struct mc_pool;

/* A job. It belongs to one connection's worker until it is dropped. */
struct mc_job;

/* NULL: out of memory. */
struct mc_pool *mc_pool_new(struct server *server);

/* Ends the threads. All jobs have been dropped (asserted). */
void mc_pool_free(struct mc_pool *pool);

/* Checks a request and starts its job; *job is then the caller's, to be dropped. `wake` is sent
 * whenever mc_job_look() has something new, until the job is dropped. */
wire_error mc_job_start(struct mc_pool *pool, const uint8_t *payload, size_t payload_bytes,
                        uv_async_t *wake, struct mc_job **job);

/* Ends it early: its table is what has been walked by now. */
void mc_job_end(struct mc_job *job, enum mc_state state);

/* Nobody wants it any more. It is freed when no thread is at it. */
void mc_job_drop(struct mc_job *job);

enum mc_news {
  MC_NOTHING_NEW,
  MC_PROGRESS,  /* *progress is set */
  MC_TABLE,     /* the table is complete: mc_job_table() */
  MC_NO_MEMORY, /* there was none for the job, and it has ended */
};

enum mc_news mc_job_look(struct mc_job *job, wire_mc_reply *progress);

/* The payload of the last reply; stays until the job is dropped. */
const uint8_t *mc_job_table(const struct mc_job *job, size_t *payload_bytes);

#endif
