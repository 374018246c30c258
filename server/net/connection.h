/* connection: one client. Reads what arrives, has it answered in its order (server/jobs/answer.h), and
 * writes the answers.
 *
 * A connection belongs to one worker and is only touched on that worker's thread, once it has been
 * given to it. It is in the worker's run queue while it has something to do; each turn is bounded,
 * so that connections take turns.
 */
#ifndef DIPOLED_CONNECTION_H
#define DIPOLED_CONNECTION_H

#include "server/jobs/invert_job.h"
#include "server/jobs/job.h"
#include "server/jobs/mc.h"
#include "server/jobs/table_job.h"
#include "server/net/client.h"
#include "server/net/input.h"
#include "server/net/output.h"

enum connection_purpose {
  CONNECTION_SERVE,
  CONNECTION_INHERITED, /* the one of --fd: when it is gone, so is the daemon */
  CONNECTION_REFUSE,    /* one too many: is told so and closed */
};

/* Whose answer is not complete; its frame stays in the input. */
enum connection_answering {
  CONNECTION_ANSWERS_NOTHING,
  CONNECTION_ANSWERS_EVAL, /* or a sample */
  CONNECTION_ANSWERS_TABLE,
  CONNECTION_ANSWERS_INVERT,
};

struct connection {
  struct client client; /* first: the worker knows the connection by it */
  struct server *server;
  int fd;
  enum connection_purpose purpose;

  union {
    uv_handle_t handle;
    uv_stream_t stream;
    uv_tcp_t tcp;
    uv_pipe_t pipe;
  } uv;
  uv_write_t write;
  uv_shutdown_t shutdown;
  uint64_t writing_bytes; /* handed to the loop, not yet written */

  struct input input;
  struct output output;
  enum connection_answering answering;
  struct job job;
  struct table_job table;
  struct invert_job invert;
  wire_header job_header;
  struct mc_desk *mc; /* its Monte Carlo jobs; NULL: it has had none */

  bool more_to_do;    /* after its turn */
  bool between_parts; /* of an answer; the next waits until there is room */
  bool reading;
  bool stopping;  /* the daemon stops: ends when what has arrived is answered */
  bool peer_done; /* nothing more will arrive */
  bool ending;    /* no more frames are taken; closes when all is written */
  bool lingering; /* shut down; waits for the peer to close, so that it can read the last answer */
  bool closing;   /* uv_close() has been called */
  bool waiting;   /* for a profile */

  uint64_t arrived_ns;       /* the request that is being answered */
  uint64_t deadline_ms;      /* of it, on the loop's clock; 0: none */
  uint64_t active_ms;        /* when bytes last arrived or left */
  uint64_t frame_started_ms; /* when the unfinished frame began to arrive; 0: there is none */
  uint64_t lingering_ms;
};

/* A connection for a connected stream socket, to be given to a worker by worker_give(&c->client);
 * the connection owns fd from now on. NULL if there is no memory; fd is still the caller's then.
 * May be called on any thread; call the other functions on the worker's thread only. */
struct connection *connection_new(struct server *server, int fd, enum connection_purpose purpose);

/* Says why, if there is room to say it, and takes no more frames. Monte Carlo jobs that have not
 * answered by now never will. */
void connection_end(struct connection *connection, uint64_t request_id, wire_error error);

/* A reader that does not keep up: its requests wait. */
static inline bool connection_blocked(const struct connection *connection) {
  return connection->output.ready_bytes > connection->server->options.max_queued_bytes;
}

/* At once, whatever is under way. */
void connection_abort(struct connection *connection);

#endif
