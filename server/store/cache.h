/* cache: prepared profiles by content, shared by all workers, bounded in bytes.
 *
 * An entry is a profile that is being prepared or has been prepared. After its preparation nothing
 * in it changes. The cache's table, the workers' local stores and the jobs each hold a reference to
 * the entries that they use. An entry is freed when the last reference is released, so an evicted
 * entry may still be in use; the cache then no longer counts its bytes.
 *
 * The first thread that asks for a profile prepares it, or has it prepared. All threads that ask in
 * the meantime wait for the same entry and are woken. A fault goes to all of them and is not kept.
 *
 * Slow profiles are prepared on libuv's pool, one at a time, or two on a machine with four cores or
 * more. Each waiter waits in the queue of its owner, for example of a connection. Owners take
 * turns: each turn prepares what the first waiter of one owner wants, and wakes all who wait for
 * the same. So an owner with hundreds of waiters delays another one by one preparation in each
 * turn. An entry that nobody waits for any more, and whose preparation has not begun, is removed.
 *
 * Threading: one mutex guards the table, the lists for eviction and the lists of waiters. No
 * profile is prepared or freed while the mutex is held. Profiles are evaluated without it, and a
 * worker finds the entries in its local store (server/store/profiles.h) without it.
 *
 * Eviction: least recently used first, in two lists. Profiles that are fast to prepare may take at
 * most a quarter of all bytes, so that a stream of them leaves three quarters to the slow ones. The
 * cache does not see when a worker finds an entry in its local store. The worker then sets a mark
 * in the entry. When a marked entry is the next to be evicted, it moves to the head of its list
 * instead.
 */
#ifndef DIPOLED_CACHE_H
#define DIPOLED_CACHE_H

#include <sys/queue.h>
#include <uv.h>

#include "core/core.h"
#include "server/observe/stats.h"

/* What a profile is prepared from. Two profiles are the same when their keys have the same bytes:
 * there is no padding, and numbers that mean the same have the same bits (0 has no sign, and every
 * parameter that is not given is the same NaN). The angles of S are not in the key, because they
 * are set in a copy of the profile. */
struct cache_key {
  uint32_t model;
  uint32_t moments;
  uint32_t evaluator;
  uint32_t zero;
  double parameters[CORE_PARAMETERS_END];
  double medium[4]; /* sigma_a, sigma_s (1/mm), g, eta */
  uint64_t hash_before_medium;
  uint64_t hash;
};

/* Sets what the channels of a request have in common. */
void cache_key_start(struct cache_key *key, unsigned model, unsigned moments, unsigned evaluator,
                     const core_parameters *parameters);

/* Sets the medium of one channel; cache_key_start() came before. */
void cache_key_set_medium(struct cache_key *key, const core_medium *medium);

bool cache_key_equal(const struct cache_key *a, const struct cache_key *b);

/* Calls core_profile_prepare() with what the key holds and with nothing else: so the bits do not
 * depend on who asks first. */
core_fault cache_key_prepare(const struct cache_key *key, const core_isa *isa,
                             core_profile *profile);

struct cache;
struct cache_entry;

LIST_HEAD(cache_waiters, cache_waiter);

/* Somebody whose waiters share one place among all that wait for slow profiles. Before the first
 * use, set all members to 0. The cache's mutex guards them. */
struct cache_owner {
  TAILQ_HEAD(, cache_waiter) waiters; /* for entries whose preparation has not begun */
  uint64_t count;                     /* of these waiters */
  TAILQ_ENTRY(cache_owner) in_turns;  /* while count is above 0 */
};

/* The entries that one thread waits for. The cache calls `wake` on any thread whenever
 * cache_next_woken() has something new. `wake` may not call the cache. */
struct cache_queue {
  void (*wake)(void *context);
  void *context;
  struct cache_waiters woken;
};

/* Waits for one entry on behalf of a job. While it waits for nothing, `entry` is NULL, and the
 * other members have no meaning. */
struct cache_waiter {
  struct cache_entry *entry;
  struct cache_queue *queue;
  struct cache_owner *owner; /* in whose queue it is; NULL: the preparation has begun */
  TAILQ_ENTRY(cache_waiter) in_owner;
  struct cache_waiters *list; /* the entry's or the queue's; NULL: neither */
  LIST_ENTRY(cache_waiter) in_list;
};

/* Keeps at most limit_bytes of prepared profiles. At most max_waiting waiters of one owner wait for
 * preparations that have not begun. NULL: out of memory. */
struct cache *cache_new(const core_isa *isa, uint64_t limit_bytes, uint64_t max_waiting,
                        struct stats *stats);

/* Asserts that nothing is being prepared and that all references have been released. */
void cache_free(struct cache *cache);

enum cache_answer {
  CACHE_KEPT, /* *entry is prepared */
  CACHE_NEW,  /* the profile is fast to prepare: the caller calls cache_prepare(*entry) at once */
  CACHE_AWAITED, /* the waiter waits for the profile; the caller calls cache_prepare_in_pool() */
  CACHE_NO_MEMORY,
  CACHE_BUSY, /* max_waiting waiters of the owner wait already */
};

/* Looks for a profile. After KEPT and NEW, *entry is a reference that the caller releases. Before
 * the call waiter->entry is NULL. After AWAITED the waiter belongs to `queue` and `owner` until
 * cache_leave(). */
enum cache_answer cache_look(struct cache *cache, const struct cache_key *key, bool slow,
                             struct cache_owner *owner, struct cache_queue *queue,
                             struct cache_waiter *waiter, struct cache_entry **entry);

/* Begins the turn of the next owner: returns a reference to the slow entry that its first waiter
 * waits for. The caller calls cache_prepare(), releases the entry, and then calls cache_end_turn().
 * NULL: nobody waits for an entry that has not begun, or enough are being prepared. */
struct cache_entry *cache_begin_turn(struct cache *cache);
void cache_end_turn(struct cache *cache);

/* Prepares an entry, on any thread, and wakes all who wait for it. If nobody waits any more for a
 * slow entry, it is removed from the cache instead. */
void cache_prepare(struct cache_entry *entry);

/* Prepares slow entries, turn by turn, on threads of libuv's pool. Call this on the loop's thread.
 * It returns at once; the loop does not end before the entries that it has begun are prepared. */
void cache_prepare_in_pool(struct cache *cache, uv_loop_t *loop);

/* Makes all waiters of `from` waiters of `to`; `from` may then be freed. */
void cache_move_waiters(struct cache *cache, struct cache_owner *from, struct cache_owner *to);

/* A waiter of this queue whose entry has been prepared or has a fault. NULL: there is none. */
struct cache_waiter *cache_next_woken(struct cache *cache, struct cache_queue *queue);

/* Ends the waiting, if the waiter waits, whether it has been woken or not. */
void cache_leave(struct cache_waiter *waiter);

/* For an entry that was KEPT, that the caller has prepared, or that a waiter was woken for. The
 * profile is valid if the fault's field is NULL. It lives as long as the caller's reference. */
const core_profile *cache_profile(const struct cache_entry *entry);
core_fault cache_fault(const struct cache_entry *entry);

/* Returns whether the entry is in the cache. A local store releases entries that are not. */
bool cache_keeps(const struct cache_entry *entry);

/* Takes one more reference; releases one. */
void cache_hold(struct cache_entry *entry);
void cache_release(struct cache_entry *entry);

/* Marks an entry that a worker has found in its local store. Any thread with a reference may call
 * this at any time. */
void cache_used(struct cache_entry *entry);

#endif
