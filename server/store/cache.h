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

/* The entries that one thread waits for. The cache calls `wake` on any thread whenever
 * cache_next_woken() has something new. `wake` may not call the cache. */
struct cache_queue {
  void (*wake)(void *context);
  void *context;
  struct cache_waiters woken;
};

/* Waits for one entry on behalf of a job. All members are 0 while it waits for nothing. */
struct cache_waiter {
  struct cache_entry *entry;
  struct cache_queue *queue;
  struct cache_waiters *list; /* the entry's or the queue's; NULL: neither */
  LIST_ENTRY(cache_waiter) in_list;
};

/* Keeps at most limit_bytes of prepared profiles. NULL: out of memory. */
struct cache *cache_new(const core_isa *isa, uint64_t limit_bytes, struct stats *stats);

/* Asserts that nothing is being prepared and that all references have been released. */
void cache_free(struct cache *cache);

enum cache_answer {
  CACHE_KEPT, /* *entry is prepared */
  CACHE_NEW,  /* the caller calls cache_prepare(*entry): at once if the profile is fast to prepare;
                    on another thread if it is slow, and then the waiter waits for it */
  CACHE_AWAITED, /* another thread prepares the profile, and the waiter waits for it */
  CACHE_NO_MEMORY,
};

/* Looks for a profile. After KEPT and NEW, *entry is a reference that the caller releases. Before
 * the call all members of *waiter are 0. After NEW with `slow`, and after AWAITED, it belongs to
 * `queue` until cache_leave(). */
enum cache_answer cache_look(struct cache *cache, const struct cache_key *key, bool slow,
                             struct cache_queue *queue, struct cache_waiter *waiter,
                             struct cache_entry **entry);

/* Prepares a NEW entry, on any thread, and wakes all who wait for it. If nobody waits any more for
 * a slow entry, it is removed from the cache instead. */
void cache_prepare(struct cache_entry *entry);

/* Calls cache_prepare() on a thread of libuv's pool. Takes over the caller's reference. Call this
 * on the loop's thread. It returns at once; the loop does not end before the entry is prepared. */
void cache_prepare_in_pool(struct cache_entry *entry, uv_loop_t *loop);

/* A waiter of this queue whose entry has been prepared or has a fault. NULL: there is none. */
struct cache_waiter *cache_next_woken(struct cache *cache, struct cache_queue *queue);

/* Ends the waiting, whether the waiter has been woken or not, and sets all its members to 0. */
void cache_leave(struct cache_waiter *waiter);

/* For an entry that was KEPT, that the caller has prepared, or that a waiter was woken for. The
 * profile is valid if the fault's field is NULL. It lives as long as the caller's reference. */
const core_profile *cache_profile(const struct cache_entry *entry);
core_fault cache_fault(const struct cache_entry *entry);

/* Whether the entry is in the cache. A local store releases entries that are not. */
bool cache_keeps(const struct cache_entry *entry);

/* Takes one more reference; releases one. */
void cache_hold(struct cache_entry *entry);
void cache_release(struct cache_entry *entry);

/* Marks an entry that a worker has found in its local store. Any thread with a reference may call
 * this at any time. */
void cache_used(struct cache_entry *entry);

#endif
