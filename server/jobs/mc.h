/* mc: the Monte Carlo jobs of one connection, on its worker's thread. They outlive the frames that
 * started them: the connection goes on with other requests meanwhile. */
#ifndef DIPOLED_MC_H
#define DIPOLED_MC_H

#include "server/jobs/mc_pool.h"
#include "server/net/output.h"

struct mc_desk;

/* on_news(context): mc_desk_answer() has something to say. The desk is opened with the first job,
 * so *desk is NULL until then. */
struct mc_caller {
  struct server *server;
  uv_loop_t *loop;
  void (*on_news)(void *context);
  void *context;
  struct mc_desk **desk;
};

/* Starts the job that a request asks for. */
wire_error mc_desk_start(const struct mc_caller *caller, uint64_t request_id,
                         const uint8_t *payload, size_t payload_bytes);

/* All that follow: a desk of NULL has no jobs. */

/* Ends jobs early, those with this request id or all; false: there is none. Their tables follow. */
bool mc_desk_end(struct mc_desk *desk, uint64_t request_id, enum mc_state state);
bool mc_desk_end_all(struct mc_desk *desk, enum mc_state state);

/* Whether there is a job whose last reply has not been committed. */
bool mc_desk_open(const struct mc_desk *desk);

/* Commits what the jobs have to say, as far as there is room for it: tables, and progress when
 * nothing else waits to be written. Nothing may be reserved in the output. */
void mc_desk_answer(struct mc_desk *desk, struct output *output);

/* Drops all jobs and the desk, at once. */
void mc_desk_close(struct mc_desk *desk);

#endif
