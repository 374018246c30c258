/* profiles: a worker's one local store of prepared profiles, in front of the cache that all workers
 * share.
 *
 * The store is a table of constant size. A slot holds either a profile that owns no memory, or a
 * copy of a cache entry's profile together with a reference to the entry. What preparing a model
 * takes decides where its profiles come from:
 *   1 to 2 us (dipoles, Burley): the worker prepares them itself and keeps them in the table alone.
 *     So no stream of such media evicts anything from the cache.
 *   25 to 500 us (single scattering, multipoles, quantized diffusion): the worker that asks first
 *     prepares them. They are in the cache and in the table.
 *   milliseconds and more (transport, tables): likewise, but a thread of libuv's pool prepares
 *     them, so that neither the worker nor another client's cheap request waits.
 *
 * Others (server/jobs/batch.h) remember a profile by its place in this table
 * and hold no copies of their own.
 *
 * Why there is one table and no other store. Each store that the daemon once had was switched off
 * in a copy of the program, and both programs served the same load in turn: 25 ms each, 40 to 60
 * rounds, on two cores of a Xeon. A figure is how many times as much of the daemon's processor time
 * a request takes without the store (service.redis.dipoled.cpu, modbus.fc23.32.dipoled.cpu), as the
 * median of the rounds; two copies of the same program differ by up to 2 %. A store that earns less
 * than 5 % of a ratio is not kept.
 *
 *   switched off                              service.redis   modbus.fc23.32   kept
 *   repeated requests (server/jobs/batch.h)   2.8             1.11             yes
 *   with those off, and in relation to that:
 *     dipoles' profiles, prepared each time   3.4             1.38             yes: this table
 *     dipoles' profiles, into the cache       1.00            0.99             no: see above
 *     cache entries, looked up each time      1.04            1.00             no: in this table
 *   profiles held by batch and repeat         0.95            0.98             no: places here
 *   the cache: a table is built for each request, which takes 0.9 to 340 ms (lut.<model>.prepare),
 *   in place of 0.5 us.                                                       yes
 *
 * Cache entries are in this table because they cost it nothing: it is the same code for both kinds.
 * To repeat a row, let find() in profiles.c or repeat_find() in batch.c return NULL, and run
 * `build/bench service modbus` with that build and with the right one in turn.
 */
#ifndef DIPOLED_PROFILES_H
#define DIPOLED_PROFILES_H

#include "server/server.h"
#include "server/store/cache.h"

/* A profile is found by its hash: in one of PROFILES_SETS sets, in any of its PROFILES_WAYS
 * slots. */
enum { PROFILES_SETS = 64, PROFILES_WAYS = 4 };

struct profiles_slot {
  uint64_t version;          /* rises whenever the slot gets another profile or is emptied */
  unsigned pins;             /* the slot keeps its profile while this is above 0 */
  struct cache_entry *entry; /* a reference; NULL: the profile owns no memory */
  struct cache_key key;      /* of model 0 if the slot is empty: no model has this id */
  core_profile profile;
};

/* Names the profile that a slot had at one time. All members are 0 if there is none. */
struct profiles_place {
  struct profiles_slot *slot;
  uint64_t version;
};

/* Belongs to one worker and is used on its thread only. */
struct profiles {
  struct server *server;
  uv_loop_t *loop;
  bool keeps; /* false with a cache of 0 bytes: then the table stays empty */
  struct cache_queue queue;
  struct profiles_set {
    uint64_t hashes[PROFILES_WAYS];
    unsigned next; /* the slot that is replaced next */
    struct profiles_slot slots[PROFILES_WAYS];
  } sets[PROFILES_SETS];
};

/* Through this a job gets one profile after the other. Before profiles_start(), set on_ready,
 * context and owner, and all other members to 0. */
struct profiles_lookup {
  void (*on_ready)(void *context); /* called after PROFILES_WAIT: call profiles_get() again */
  void *context;
  struct cache_owner *owner; /* whose turns slow profiles are prepared in */
  struct cache_key key;
  core_parameters parameters;
  bool ready;                  /* `profile` may be evaluated until profiles_return() */
  core_profile profile;        /* a copy, with the angles of the request */
  struct profiles_place place; /* of the same profile without the angles, if the table has it */
  struct cache_entry *entry;   /* a reference to the entry that was copied; NULL: none */
  core_fault fault;            /* after PROFILES_FAULT: why there is no profile */
  struct cache_waiter waiter;
  bool woken;
};

/* When profiles_wake() should be called, wake(context) is called on any thread. */
void profiles_init(struct profiles *profiles, struct server *server, uv_loop_t *loop,
                   void (*wake)(void *context), void *context);

/* Empties the table. No job waits for a profile any more, and no slot is pinned. */
void profiles_end(struct profiles *profiles);

/* Calls on_ready() for the jobs whose profiles have been prepared. */
void profiles_wake(struct profiles *profiles);

/* Releases the entries that the cache has evicted, so that their memory is freed. Call this a few
 * times a second. */
void profiles_sweep(struct profiles *profiles);

enum profiles_answer { PROFILES_READY, PROFILES_FAULT, PROFILES_WAIT };

/* The field of a fault when max_waiting_profiles of the owner wait already. */
#define PROFILES_FIELD_BUSY "profiles"

/* Returns whether the same request may succeed later: memory is lacking, or too many profiles wait.
 */
bool profiles_is_busy(core_fault fault);

/* Sets what the next profiles have in common; core_profile_check() has accepted the arguments. */
void profiles_start(struct profiles_lookup *lookup, unsigned model, unsigned moments,
                    unsigned evaluator, const core_parameters *parameters);

/* Gets the profile for a medium; the one before has been returned. After PROFILES_WAIT and
 * on_ready(), call it again for the same medium. */
enum profiles_answer profiles_get(struct profiles *profiles, struct profiles_lookup *lookup,
                                  const core_medium *medium);

/* Returns the profile, or gives up waiting for it. Does nothing if there is neither. */
void profiles_return(struct profiles_lookup *lookup);

/* The profile at a place, without the angles of a request. NULL: the slot has another one now, or
 * the cache has evicted this one. It stays until the next call of profiles_get() or
 * profiles_sweep(), or while the slot is pinned. */
const core_profile *profiles_at(struct profiles_place place);

#endif
