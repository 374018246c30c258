/* worker: a thread with an event loop of its own, its clients, and their run queue.
 *
 * An eval that misses the cache enters 25 files by callgrind's count, in this order:
 *    1 server/net/worker.c       gives the connection a turn
 *    2 server/net/connection.c   has read the bytes, and writes the answer
 *    3 server/net/buffers.c      finds the frame, and has room for the reply
 *    4 server/jobs/requests.c    takes the request up and frames its reply
 *    5 server/jobs/run.c         drives its job from the start to the end
 *    6 proto/wire.c              reads and writes headers and structures
 *    7 server/observe/stats.c    counts
 *    8 server/jobs/job.c         starts the job of the message, admits and ends it
 *    9 server/jobs/batch.c       sees that it repeats no earlier request; gathers short requests
 *   10 server/jobs/eval.c        checks the request, works slice by slice, fills the reply in
 *   11 proto/eval.c              takes the payload apart and lays the reply out
 *   12 proto/channels.c          reads the media and parameters
 *   13 core/choice_lists.c       looks ids up
 *   14 core/profile.c            checks that there is such a profile, and prepares it
 *   15 core/medium.c             checks a medium
 *   16 core/radii.c              checks radii
 *   17 server/store/profiles.c   looks for the profile in the worker's store
 *   18 server/store/cache.c      computes its key
 *   19 core/models/dipole.c      prepares it (the file of its model)
 *   20 core/fresnel.c            computes its Fresnel moments
 *   21 core/model_error.c        looks up how far the model is from transport
 *   22 core/isa_kernels.c        chooses the kernels of the instruction set
 *   23 core/owned.c              tells how much memory the profile owns
 *   24 core/evaluate.c           calls the kernel
 *   25 server/observe/latency.c  notes how long the request took
 *
 * Threading: the main thread accepts each connection and gives it to the worker that has
 * the fewest. From then on that worker reads, evaluates and writes for it on its own thread, so a
 * request crosses no threads. In each round of its loop, a worker
 *   1. reads what has arrived for all of its clients,
 *   2. gives each client that something has arrived for one turn of bounded length,
 *   3. evaluates the short requests of these clients together (server/jobs/batch.h),
 *   4. writes their answers,
 *   5. does the same for the clients that go on with work of earlier rounds.
 * A large request takes one slice in each turn. So a short request waits for one slice, and one
 * write of bounded size, of each client with a large one.
 *
 * The alternative is an I/O thread that passes requests to workers and takes the answers back.
 * Prototypes of both designs were measured on two cores; they are in the history, as
 * tests/bench/bench_threads.c. In each column the first figure is for connections that belong to a
 * worker, the second for an I/O thread in front:
 *
 *   request and in flight          requests/s     CPU, us      median round trip, us
 *   16 radii, one                  73k / 12k      5.9 / 33     11 / 48
 *   16 radii, 32 connections x 16  932k / 799k    0.28 / 0.35  265 / 305
 *   65,536 radii, one              3059 / 2898    89 / 113     164 / 177
 *   65,536 radii, 4 x 2            6968 / 6998    93 / 125     1120 / 1123
 *   65,536 radii, 1 x 4            3389 / 3437    78 / 89      612 / 605
 *
 * The way to another thread and back costs more than a small request. Large requests gain no more
 * than they do from a second connection. So each connection belongs to one worker.
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
  uv_idle_t stay_awake; /* active in a poll that must not sleep */
  uv_timer_t clock;
  uv_timer_t deadline; /* fires at wake_ms */
  uint64_t wake_ms;    /* the next deadline of a client that waits; 0 if there is none */

  uv_mutex_t mutex; /* guards the inbox and stop_wanted */
  struct client *inbox;
  bool stop_wanted;

  LIST_HEAD(, client) clients;      /* all clients of this worker */
  struct client *next_client;       /* the next one that for_each() visits */
  struct client *running;           /* whose turn it is; NULL if it was forgotten in its turn */
  struct client_queue arrived;      /* clients to run that something has arrived for */
  struct client_queue going_on[2];  /* clients to run that came back in a round: work is left */
  unsigned next_going_on;           /* which of these the next round serves */
  struct client_queue finish_queue; /* clients whose finish() is called in this round */
  uint64_t run_count;               /* clients in the queues of clients to run */
  bool in_round;                    /* clients are having their turns */
  uint64_t round_ns; /* when this round of the loop began to read; 0 if it has not read anything */
  unsigned stop_rounds; /* rounds of the loop since worker_stop(); 0 before */
  uint64_t stop_began_ms;
  unsigned abandoned_requests, abandoned_clients; /* by the drain timeout; read after the join */
  _Atomic uint64_t client_count;                  /* number of clients with kind->counts */
  _Atomic uint64_t round_began_ms;                /* by uv_hrtime(); a round follows soon */
  struct job_context context;
};

/* Idle workers begin a round of the loop at least this often, for the sake of timeouts. */
enum { WORKER_CLOCK_MOST_MS = 250 };

/* Returns for how long none of these workers has begun a round of its loop, which means that each
 * has been busy with a single turn. Any thread may call this. */
uint64_t worker_silence_ms(const struct worker *workers, uint64_t count);

/* Sets up a worker without a thread. The thread that runs its loop is the worker's thread. Returns
 * 0 or an error code of libuv. */
int worker_open(struct worker *worker, struct server *server);

/* Opens the worker and starts its thread. Returns 0 or an error code of libuv. */
int worker_start(struct worker *worker, struct server *server);

/* Call these from any thread. worker_give() hands over a client (server/net/client.h). */
void worker_give(struct worker *worker, struct client *client);
void worker_stop(struct worker *worker); /* answers all requests, ends all clients and the thread */
void worker_join(struct worker *worker);

/* Clients call the functions that follow, on the worker's thread only. */
uv_loop_t *worker_loop(struct worker *worker);
struct job_context *worker_context(struct worker *worker);
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
/* Makes the worker call deadline() of all clients at the time at_ms of the loop, or a little later.
 */
void worker_wake_at(struct worker *worker, uint64_t at_ms);
#endif
