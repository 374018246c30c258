/* worker: a thread with its own event loop, its clients, and their run queue.
 *
 * Threading: the main thread accepts each connection and gives it to the worker that has the least
 * work, or else the fewest connections. From then on that worker reads, evaluates and writes for it on
 * its own thread, so a request crosses no threads. A worker with at least two clients more with large
 * requests than another one hands one over, between two requests: so of clients that outlive others, no
 * two share a worker while another has none. In each round of its loop, a worker
 *   1. reads what has arrived for all of its clients,
 *   2. gives each client that something has arrived for one turn of bounded length,
 *   3. evaluates the short requests of these clients together (server/jobs/batch.h),
 *   4. writes their replies,
 *   5. does the same for the clients that go on with work of earlier rounds.
 * A large request takes one slice in each turn. So a short request waits for one slice, and one
 * write of bounded size, of each client with a large one.
 *
 * A thread for the sockets in front of the workers would cost more than a small request takes, and
 * large requests would gain no more than by a second connection.
 */
#ifndef DIPOLED_WORKER_H
#define DIPOLED_WORKER_H

#include "server/jobs/job.h"
#include "server/net/client.h"

struct worker {
  struct server *server;
  uv_thread_t thread;
  uv_loop_t loop;
  uv_async_t wake;
  uv_prepare_t before_poll;
  uv_check_t after_poll;
  uv_idle_t stay_awake; /* active while the next poll must not sleep */
  uv_poll_t clock; /* a timer of the kernel's own: each wait with a time limit costs a timer anew */
  int clock_fd;
  uv_timer_t deadline; /* fires at wake_ms */
  uint64_t wake_ms;    /* the next deadline of a client that waits; 0 if there is none */

  uv_mutex_t mutex; /* guards the inbox and stop_wanted */
  STAILQ_HEAD(, client) inbox;
  bool stop_wanted;

  LIST_HEAD(, client) clients;     /* all clients of this worker */
  struct client *next_client;      /* the next one that for_each() visits */
  struct client *running;          /* whose turn it is; NULL if it was forgotten in its turn */
  struct client_queue arrived;     /* clients whose turn comes because something arrived for them */
  struct client_queue going_on[2]; /* clients to run that came back in a round: work is left */
  unsigned next_going_on;          /* which of the two queues the next round serves */
  struct client_queue finish_queue; /* clients whose finish() is called at the end of this round */
  uint64_t run_count;               /* number of clients in the queues of turns */
  uint64_t load_most;    /* of clients with work left after a round, since the clock's last tick */
  _Atomic uint64_t load; /* load_most at that tick */
  struct worker *relief; /* that is to take a client with much work; NULL: none */
  bool in_round;         /* whether clients are having their turns */
  uint64_t round_ns; /* when this round of the loop began to read; 0 if it has not read anything */
  unsigned stop_rounds; /* rounds of the loop since worker_stop(); 0 before */
  uint64_t stop_began_ms;
  /* number of clients aborted by the drain timeout; read after the join */
  unsigned abandoned_count;
  _Atomic uint64_t client_count;   /* number of clients whose kind counts */
  _Atomic uint64_t round_began_ms; /* start of this round, by uv_hrtime(), in ms */
  struct job_context context;
};

/* Idle workers begin a round of the loop at least this often, for the sake of timeouts. */
enum { WORKER_CLOCK_MOST_MS = 250 };

/* Returns for how long none of these workers has begun a round of its loop, which means that each
 * has been busy with a single turn. Any thread may call this. */
uint64_t worker_silence_ms(const struct worker *workers, uint64_t count);

/* Sets up a worker, whose bytes are 0, without a thread. The thread that runs its loop is the worker's
 * thread. Other workers may look at its load at any time. Returns 0 or an error code of libuv. */
int worker_open(struct worker *worker, struct server *server);

/* Opens the worker and starts its thread. Returns 0 or an error code of libuv. */
int worker_start(struct worker *worker, struct server *server);

/* Returns the worker with the least load, and of those the one with the fewest clients that count. */
struct worker *worker_least_busy(struct server *server);

/* Call these from any thread. worker_give() hands over a client (server/net/client.h). */
void worker_give(struct worker *worker, struct client *client);
void worker_stop(struct worker *worker); /* serves all requests, ends all clients and the thread */
void worker_join(struct worker *worker);

/* Clients call the functions that follow, on the worker's thread only. */
/* Returns when this round of the loop began to read: the arrival time of all bytes of the round. */
uint64_t worker_round_ns(struct worker *worker);
/* Gives the client a turn: in this round of the loop, or if clients are having their turns now, in
 * the next one, before which the loop does not sleep. Does nothing if it is to have a turn anyway. */
void worker_run_later(struct client *client);
/* Makes the worker call finish() in this round of the loop, after it has evaluated the batch. */
void worker_finish_later(struct client *client);
/* Makes the worker serve a client at once, as worker_give() does from other threads. */
void worker_adopt(struct worker *worker, struct client *client);
/* Removes a client that has ended, from all queues; the worker does not touch it again. The client
 * may be forgotten at any time, also in its own turn or in that of another. */
void worker_forget(struct client *client);
/* Makes the worker wait for a client, which counts, that another one hands over. Returns false if the
 * daemon stops. The other one then closes the client's handles, and calls worker_move(), which makes
 * this one start the client again. */
bool worker_expect(struct worker *worker);
void worker_move(struct client *client, struct worker *to);
/* Makes the worker call deadline() of all clients at the time at_ms of the loop, or a little later.
 */
void worker_wake_at(struct worker *worker, uint64_t at_ms);
#endif
