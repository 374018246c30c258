/* mc_pool: threads that walk the photons of Monte Carlo jobs (mc.c), at a lower priority than the
 * workers. They start with the first job, and take turns among jobs, slice by slice. */
#ifndef DIPOLED_MC_POOL_H
#define DIPOLED_MC_POOL_H

struct mc_pool;
struct server;

/* Makes a pool. Returns NULL if there is no memory. */
struct mc_pool *mc_pool_new(struct server *server);

/* Ends the threads. Asserts that all jobs have ended. `pool` may be NULL. */
void mc_pool_free(struct mc_pool *pool);

#endif
