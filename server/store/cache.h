/* cache: keeps prepared profiles, and prepared fits, found by what they are prepared from. All
 * workers share it, and its bytes are bounded. What is said of profiles holds for fits, too.
 *
 * An entry is a profile that is being prepared or has been prepared. After its preparation nothing
 * in it changes. The cache's table, the workers' local stores and the jobs each hold a reference to
 * the entries that they use. An entry is freed when the last reference is released, so an evicted
 * entry may still be in use; the cache then no longer counts its bytes.
 *
 * The first thread that asks for a profile prepares it, or has it prepared. All threads that ask in
 * the meantime wait for the same entry and are woken. If the preparation fails, all of them get the
 * fault, which the cache does not keep.
 *
 * Slow profiles are prepared on libuv's pool, one at a time, or two on a machine with four cores or
 * more. Each waiter waits in the queue of its owner, for example of a connection. Owners take
 * turns: each turn prepares the entry of one owner's first waiter, and wakes all waiters of that
 * entry. So even an owner with hundreds of waiters delays another owner by only one preparation in
 * each turn. An entry without waiters whose preparation has not begun is removed.
 *
 * Threading: one mutex guards the table, the lists for eviction and the lists of waiters. No
 * profile is prepared or freed while the mutex is held. Profiles are evaluated without it, and a
 * worker finds the entries in its local store (server/store/profiles.h) without it.
 *
 * Eviction: least recently used first, in lists. Profiles that are fast to prepare may take at
 * most a quarter of all bytes, so that a stream of them leaves three quarters to the slow ones. Sets
 * of points have a third list with a limit of their own, so that they evict nothing else. The
 * cache does not see when a worker finds an entry in its local store. The worker then sets a mark
 * in the entry. When a marked entry is the next to be evicted, it moves to the head of its list
 * instead.
 */
#ifndef DIPOLED_CACHE_H
#define DIPOLED_CACHE_H

#include <sys/queue.h>
#include <uv.h>

#include "core/fit/fit.h"
#include "core/gather/gather.h"
#include "core/varying.h"
#include "server/observe/stats.h"

struct points;

/* The key of a profile: everything from which it is prepared. Two profiles are the same if their
 * keys have the same bytes: there is no padding, 0 has no sign, and all parameters that are not
 * given are the same NaN. The angles of S are not in the key, because a job sets them in its copy
 * of the profile.
 *
 * The key of a prepared fit (core/fit/fit.h) has a `design`: the bytes of fit_design_read(), which
 * are compared one by one. Its other members, except the hash, are 0. The design belongs to the
 * caller; an entry of the cache has a copy. */
struct cache_key {
  uint32_t model;
  uint32_t moments;
  uint32_t evaluator;
  uint32_t varying; /* 1: the preparation of media that vary (core/varying.h), 0: a profile */
  double parameters[CORE_PARAMETERS_END];
  double medium[4]; /* sigma_a, sigma_s (1/mm), g, eta; the first two are 0 if media vary */
  uint64_t set[2];  /* name of a set of points (server/store/points.h); 0 for all other keys */
  uint64_t hash_before_medium;
  uint64_t hash;
  const uint8_t *design; /* NULL for a profile */
  uint64_t design_bytes; /* a multiple of 8 */
  struct points *points; /* the points of a set, from which its tree is built; else NULL */
};

/* Sets the members of the key that all channels of a request share. */
void cache_key_start(struct cache_key *key, unsigned model, unsigned moments, unsigned evaluator,
                     const core_parameters *parameters);

/* Sets the medium of one channel, and the hash. Call it after cache_key_start(). */
void cache_key_set_medium(struct cache_key *key, const core_medium *medium);

/* Returns the medium of a profile's key. */
core_medium cache_key_medium(const struct cache_key *key);

/* Makes the key of a prepared fit. */
void cache_key_set_design(struct cache_key *key, const uint8_t *design, size_t design_bytes);

/* Makes the key of a set of points. points: what a new entry is built from, of which it takes a
 * reference; NULL: cache_look() makes no new entry. */
void cache_key_set_points(struct cache_key *key, const uint64_t set[2], struct points *points);

bool cache_key_equal(const struct cache_key *a, const struct cache_key *b);

/* These call core_profile_prepare_until() and core_varying_prepare() with the members of the key and
 * nothing else, so that the bits do not depend on who asks first. */
core_fault cache_key_prepare(const struct cache_key *key, const core_isa *isa,
                             core_profile *profile, const atomic_bool *stop);
core_fault cache_key_prepare_varying(const struct cache_key *key, const core_isa *isa,
                                     core_varying *varying);

struct cache;
struct cache_entry;

LIST_HEAD(cache_waiters, cache_waiter);

/* The owner of waiters for slow profiles, for example a connection. Owners take turns. Before the
 * first use, set all members to 0. The cache's mutex guards them. */
struct cache_owner {
  TAILQ_HEAD(cache_waiting, cache_waiter) waiters; /* for entries whose preparation has not begun */
  uint64_t count;                                  /* number of these waiters */
  TAILQ_ENTRY(cache_owner) in_turns;               /* while count is above 0 */
};

/* The woken waiters of one thread. The cache calls `wake`, on any thread, whenever
 * cache_next_woken() has another waiter to return. `wake` must not call the cache. */
struct cache_queue {
  void (*wake)(void *context);
  void *context;
  struct cache_waiters woken;
};

/* A waiter: waits for one entry on behalf of a job. `entry` is NULL while there is none, and the
 * other members except `admitted` then have no meaning. */
struct cache_waiter {
  bool admitted; /* the job has had a profile before: max_waiting does not stop it halfway */
  struct cache_entry *entry;
  struct cache_queue *queue;
  struct cache_owner *owner; /* the owner whose queue it is in; NULL: the preparation has begun */
  TAILQ_ENTRY(cache_waiter) in_owner;
  struct cache_waiters *list; /* the list of the entry or of the queue that it is in; or NULL */
  LIST_ENTRY(cache_waiter) in_list;
};

/* Makes a cache that keeps at most limit_bytes of prepared profiles, and points_bytes of sets of
 * points. A waiter that is not admitted yet is refused if its owner has max_waiting waiters for
 * preparations that have not begun. Returns NULL if there is no memory. */
struct cache *cache_new(const core_isa *isa, uint64_t limit_bytes, uint64_t points_bytes,
                        uint64_t max_waiting, struct stats *stats);

/* Frees the cache. Asserts that no profile is being prepared and all references are released. */
void cache_free(struct cache *cache);

enum cache_answer {
  CACHE_KEPT, /* *entry is prepared */
  CACHE_NEW,  /* the profile is fast to prepare: the caller calls cache_prepare(*entry) at once */
  CACHE_AWAITED, /* the waiter waits; the caller calls cache_prepare_in_pool() */
  CACHE_NO_MEMORY,
  CACHE_UNKNOWN, /* there is no such set of points, and the key has no points */
  CACHE_BUSY,    /* the owner has max_waiting waiters already, and this one is not admitted */
};

/* Looks a profile up. After KEPT and NEW, *entry is a reference that the caller releases. After
 * AWAITED, the waiter belongs to `queue` and `owner` until cache_leave(). Before the call,
 * waiter->entry must be NULL. */
enum cache_answer cache_look(struct cache *cache, const struct cache_key *key, bool slow,
                             struct cache_owner *owner, struct cache_queue *queue,
                             struct cache_waiter *waiter, struct cache_entry **entry);

/* Begins the turn of the next owner: returns a reference to the slow entry for which its first
 * waiter waits. The caller calls cache_prepare(), releases the entry, and calls cache_end_turn().
 * Returns NULL if no owner has a waiter, or if enough entries are being prepared. */
struct cache_entry *cache_begin_turn(struct cache *cache);
void cache_end_turn(struct cache *cache);

/* Prepares an entry, on any thread, and wakes all its waiters. A slow entry that has no waiters any
 * more is not prepared but removed from the cache; if the last one leaves while transport is being
 * solved, that stops. */
void cache_prepare(struct cache_entry *entry);

/* Prepares slow entries, turn by turn, on threads of libuv's pool. Call this on the loop's thread.
 * It returns at once; the loop does not end before the preparations that have begun. */
void cache_prepare_in_pool(struct cache *cache, uv_loop_t *loop);

/* Makes all waiters of `from` waiters of `to`; `from` may then be freed. */
void cache_move_waiters(struct cache *cache, struct cache_owner *from, struct cache_owner *to);

/* Returns a waiter of this queue whose entry has been prepared or has a fault, or NULL. */
struct cache_waiter *cache_next_woken(struct cache *cache, struct cache_queue *queue);

/* Returns how many preparations come before that of the waiter's entry; 0 if it has begun, or the
 * waiter does not wait. Waiters that come or give up change the number. */
uint64_t cache_place(const struct cache_waiter *waiter);

/* Ends the waiting of a waiter, woken or not. Does nothing if it does not wait. */
void cache_leave(struct cache_waiter *waiter);

/* These return the profile, the fit, what media that vary share or a set of points, and the fault,
 * of a prepared entry: one that was KEPT, that the caller has prepared, or whose waiter was woken. What its key
 * asked for is valid if the fault's field is NULL, and as long as the caller holds a reference. */
const core_profile *cache_profile(const struct cache_entry *entry);
const core_fit *cache_fit(const struct cache_entry *entry);
const core_varying *cache_varying(const struct cache_entry *entry);
const core_gather_points *cache_gather(const struct cache_entry *entry);
core_fault cache_fault(const struct cache_entry *entry);

/* Returns whether the entry is in the cache. A local store releases entries that are not. */
bool cache_keeps(const struct cache_entry *entry);

/* These take one more reference to an entry, and release one. */
void cache_hold(struct cache_entry *entry);
void cache_release(struct cache_entry *entry);

/* Marks an entry as used, when a worker has found it in its local store. Any thread with a
 * reference may call this at any time. */
void cache_used(struct cache_entry *entry);

#endif
