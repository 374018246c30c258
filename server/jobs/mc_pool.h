/* mc_pool: threads that walk the photons of Monte Carlo jobs, at a lower priority than the workers.
 *
 * libuv's pool is not used, because a thread that has lowered its priority may not raise it again.
 * The threads start with the first job. Jobs take turns, slice by slice. Several threads may walk
 * batches of the same job at a time. The batches are merged in the order of their indices, so the
 * result does not depend on which thread walked which batch.
 */
#ifndef DIPOLED_MC_POOL_H
#define DIPOLED_MC_POOL_H

#include "server/jobs/mc_task.h"

/* A job reports progress at most this often. */
enum { MC_PROGRESS_EVERY_MS = 200 };

struct mc_pool;

/* A Monte Carlo job. Only the worker that has started a job calls mc_job_...() for it. */
struct mc_job;

/* Makes a pool. Returns NULL if there is no memory. */
struct mc_pool *mc_pool_new(struct server *server);

/* Ends the threads. Asserts that all jobs have been dropped. */
void mc_pool_free(struct mc_pool *pool);

/* Checks a request and starts its job, which the caller drops with mc_job_drop(). Until then, the
 * pool sends `wake` whenever mc_job_look() has something new to return. */
wire_error mc_job_start(struct mc_pool *pool, const uint8_t *payload, size_t payload_bytes,
                        uv_async_t *wake, struct mc_job **job);

/* Ends the job early: its table holds the results of the photons so far. */
void mc_job_end(struct mc_job *job, enum mc_state state);

/* Gives the job up. The pool frees it when no thread works on it any more. */
void mc_job_drop(struct mc_job *job);

enum mc_news {
  MC_NOTHING_NEW,
  MC_PROGRESS,  /* *progress has been set */
  MC_TABLE,     /* the table is complete; mc_job_table() returns it */
  MC_NO_MEMORY, /* the job has ended because there was no memory for it */
};

/* Returns what has changed since the last call. */
enum mc_news mc_job_look(struct mc_job *job, wire_mc_reply *progress);

/* Returns the payload of the last reply, the table. It stays valid until the job is dropped. */
const uint8_t *mc_job_table(const struct mc_job *job, size_t *payload_bytes);

#endif
