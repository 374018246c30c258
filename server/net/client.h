/* client: the interface of everything that a worker serves in turns, for example a connection.
 *
 * The worker (server/net/worker.h) knows its clients through this interface alone. A new kind of
 * client joins like this:
 *
 *   1. Its structure has a `struct client` as its first member, so that a pointer to one is a
 *      pointer to the other. The file that implements it defines one constant `struct client_kind`
 *      and sets client.kind to it. All other members of `struct client` start as 0.
 *   2. worker_give() hands the client to a worker, from any thread. The worker then calls start()
 *      on its own thread. From there on only that thread touches the client.
 *   3. Whenever the client has something to do, for example in a callback of the loop, it calls
 *      worker_run_later(). The worker then calls run() once, which must do a bounded amount of
 *      work. After all clients have run, the worker evaluates what they have put into the batch.
 *      Then it calls finish(), which may write the results and call worker_run_later() again.
 *   4. A client whose values are in the batch although its run() was not called in this round calls
 *      worker_finish_later(): the worker then calls its finish() at the end of this round.
 *   5. When the daemon stops, the worker calls stop(). The client serves what has arrived and ends
 *      itself. After the drain timeout the worker calls abort(), after which it ends at once.
 *   6. A client that has ended (its handles are closed) calls worker_forget(), and may then free
 *      itself. The worker's thread ends when stop() has been called and no client is left.
 */
#ifndef DIPOLED_CLIENT_H
#define DIPOLED_CLIENT_H

#include <stdbool.h>
#include <stdint.h>
#include <sys/queue.h>

#include "server/store/cache.h"

struct client;
struct worker;

/* The functions of clients of one kind. The worker calls them on its own thread only. A member may
 * be NULL where its comment says so. */
struct client_kind {
  void (*start)(struct client *client);                 /* once after worker_give(); or NULL */
  void (*run)(struct client *client);                   /* one turn of bounded length */
  void (*finish)(struct client *client);                /* see 3 and 4 above; or NULL */
  void (*tick)(struct client *client, uint64_t now_ms); /* called several times a second; or NULL */
  void (*deadline)(struct client *client); /* called at the time of worker_wake_at(); or NULL */
  void (*stop)(struct client *client);     /* called once when the daemon stops */
  void (*abort)(struct client *client);    /* once after the drain timeout; or NULL */
  /* returns whether abort() would lose replies; or NULL */
  bool (*busy)(const struct client *client);
  /* Of workers with as much work, the one with the fewest clients that count gets the next. */
  bool counts;
};

TAILQ_HEAD(client_queue, client);

struct client {
  const struct client_kind *kind;
  struct worker *worker;         /* set before start() is called */
  STAILQ_ENTRY(client) in_inbox; /* before start() */
  struct cache_owner profiles;   /* its profiles that wait for slow preparation */
  LIST_ENTRY(client) in_clients;
  /* the queue in which the client waits for its turn; NULL: it waits in none */
  struct client_queue *run_queue;
  TAILQ_ENTRY(client) in_run_queue;
  TAILQ_ENTRY(client) in_finish_queue;
  bool to_finish; /* whether the client is in the finish queue */
};

#endif
