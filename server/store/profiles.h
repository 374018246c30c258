/* profiles: where a worker gets its prepared profiles from. Decides what is worth keeping, keeps at
 * hand what the worker used last, and has prepared on another thread what takes long.
 *
 * Three kinds of models, by what preparing them takes:
 *   little  (dipoles, Burley: 1 to 2 us, and nothing is allocated) The worker prepares them itself
 *           and keeps copies in a table of its own, of constant size. They never come near the
 *           cache: however many different media are asked for, nothing is evicted for them.
 *   some    (single scattering, multipoles, quantized diffusion: 25 to 500 us) In the cache;
 *           prepared by the worker that asks first.
 *   much    (slow: milliseconds and more) In the cache; prepared on a thread of libuv's pool, so
 *           that neither the worker nor anybody's cheap request waits.
 *
 * Measured, on one core of an EPYC: preparing a dipole 1940 ns, finding its copy 40 ns, not finding
 * it and making one 40 ns more than preparing it (2 %); an entry at hand 40 ns, one in the cache
 * 75 ns while no other thread wants its mutex.
 */
#ifndef DIPOLED_PROFILES_H
#define DIPOLED_PROFILES_H

#include "server/store/cache.h"
#include "server/server.h"

/* What is at hand is found by hash: in one of so many sets, where it may be in so many ways. */
enum { PROFILES_SETS = 32, PROFILES_WAYS = 4 };

struct profiles_set {
  uint64_t hashes[PROFILES_WAYS];
  unsigned next; /* way to be replaced */
};

/* Of one worker, on its thread. */
struct profiles {
  struct server *server;
  uv_loop_t *loop;
  bool keeps; /* anything at all: not with a cache of 0 bytes */
  struct cache_queue queue;
  struct profiles_set entry_sets[PROFILES_SETS];
  struct cache_entry *entries[PROFILES_SETS][PROFILES_WAYS]; /* a reference each, or NULL */
  struct profiles_set copy_sets[PROFILES_SETS];
  struct profiles_copy {
    struct cache_key key; /* of model 0: none, as no model has this id */
    core_profile profile; /* owns nothing */
  } copies[PROFILES_SETS][PROFILES_WAYS];
};

/* What a job wants: one profile after the other. All 0 but for the first two before the first. */
struct profiles_order {
  void (*on_ready)(void *context); /* called after PROFILES_WAIT: ask again now */
  void *context;
  struct cache_key key;
  core_parameters parameters;
  bool ready;                /* there is a profile, to be evaluated until it is returned */
  core_profile profile;      /* it */
  struct cache_entry *entry; /* that it is a copy of, and a reference; NULL: of none */
  core_fault fault;          /* why there is none: FAULT */
  struct cache_waiter waiter;
  bool woken;
};

/* wake(context) is called on any thread when profiles_wake() is due. */
void profiles_init(struct profiles *profiles, struct server *server, uv_loop_t *loop,
                   void (*wake)(void *context), void *context);

/* Lets go of all that is at hand; nobody waits any more. */
void profiles_end(struct profiles *profiles);

/* Calls on_ready() of the orders that waited and wait no more. */
void profiles_wake(struct profiles *profiles);

/* From time to time: lets go of what has been evicted meanwhile, so that its memory is free. */
void profiles_sweep(struct profiles *profiles);

enum profiles_answer { PROFILES_READY, PROFILES_FAULT, PROFILES_WAIT };

/* What the profiles that follow have in common: arguments that core_profile_check() has passed. */
void profiles_start(struct profiles_order *order, unsigned model, unsigned moments,
                    unsigned evaluator, const core_parameters *parameters);

/* The next profile; the one before has been returned. After WAIT and on_ready(): again for the same
 * medium. */
enum profiles_answer profiles_get(struct profiles *profiles, struct profiles_order *order,
                                  const core_medium *medium);

/* Its profile is needed no more, or waited for no more; if there is none, nothing. */
void profiles_return(struct profiles_order *order);

#endif
