/* cache: keeps things that take time to prepare, such as profiles, found by what they are prepared
 * from. All workers share it, and its bytes are bounded. It knows no contents: a kind of things is a
 * struct cache_kind, in its own file in this folder, or beside its only job.
 *
 * An entry is a thing that is being prepared or has been prepared. After its preparation nothing
 * in it changes. The cache's table, the workers' local stores and the jobs each hold a reference to
 * the entries that they use. An entry is freed when the last reference is released, so an evicted
 * entry may still be in use; the cache then no longer counts its bytes.
 *
 * The first thread that requests a thing prepares it, or has it prepared. All threads that request
 * it in the meantime wait for the same entry and are woken. If the preparation fails, all of them
 * get the fault, which the cache does not keep.
 *
 * Slow things are prepared by threads of two lanes: those that take milliseconds by one lane, and
 * those for which transport is solved, in seconds, by the other, whose threads have a low priority. So
 * no solution delays a table. The first lane prepares one thing at a time, or two on a machine with
 * four cores or more. The second does so for each of up to eight owners: the system shares the
 * processors out among its threads, so that a short solution is soon ready beside long ones. Each waiter
 * waits in a queue of its owner, for example of a connection. Owners take turns: each turn prepares the
 * entry of one owner's first waiter, and wakes all waiters of that entry. So even an owner with hundreds
 * of waiters delays another owner by only one preparation in each turn. An entry without waiters whose
 * preparation has not begun is removed.
 *
 * Threading: one mutex guards the table, the lists for eviction and the lists of waiters. Nothing is
 * prepared or freed while the mutex is held. Things are used without it, and a worker finds the
 * entries in its local store (server/store/profiles.h) without it.
 *
 * Eviction: least recently used first, in lists. Things that are fast to prepare may take at
 * most a quarter of all bytes, so that a stream of them leaves three quarters to the slow ones. Kinds
 * that stand apart have a third list with its own limit, so that they evict nothing else. The
 * cache does not see when a worker finds an entry in its local store. The worker then sets a mark
 * in the entry. When a marked entry is the next to be evicted, it moves to the head of its list
 * instead.
 */
#ifndef DIPOLED_CACHE_H
#define DIPOLED_CACHE_H

#include <string.h>
#include <sys/queue.h>
#include <uv.h>

#include "server/server.h"

struct cache_key;

/* A kind of things. */
struct cache_kind {
  size_t thing_bytes; /* size of the thing's structure */

  /* Prepares a thing, all of whose bytes are 0, from its key and nothing else, so that the bits do not
   * depend on who needs it first. May give up with CORE_FIELD_STOPPED when *stop is set. */
  core_fault (*prepare)(void *thing, const struct cache_key *key, const core_isa *isa,
                        const atomic_bool *stop);
  void (*free)(void *thing);            /* frees what the thing owns */
  uint64_t (*bytes)(const void *thing); /* returns the bytes of what it owns */

  /* Take and release a reference to the source of a key. NULL: keys have none. */
  void (*hold)(void *source);
  void (*release)(void *source);

  bool apart; /* whether the limit and the statistics are those of sets of points */
};

/* What a thing is found by, and prepared from. Two keys are the same if their kinds and contents are:
 * contents have no padding. The caller owns the content; an entry has a copy. */
struct cache_key {
  const struct cache_kind *kind;
  const void *content;
  size_t content_bytes;
  uint64_t hash; /* hash of the content, see cache_hash() */
  void *source;  /* what is needed besides to prepare it; NULL: no new entry is made */
};

/* Adds words of 8 bytes to a hash: multiplies by 2^64 over the golden ratio (Knuth 1998, section 6.4),
 * and folds the high bits, which depend on all bits of the word, onto the low ones. */
static inline uint64_t cache_hash(uint64_t hash, const void *words, size_t bytes) {
  for (size_t i = 0; i < bytes; i += sizeof hash) {
    uint64_t word;
    memcpy(&word, (const uint8_t *)words + i, sizeof word);
    hash = (hash ^ word) * UINT64_C(0x9e3779b97f4a7c15);
    hash ^= hash >> 32;
  }
  return hash;
}

struct cache;
struct cache_entry;

LIST_HEAD(cache_waiters, lookup);

/* How long preparing takes: up to a millisecond, on the thread that asks; milliseconds, by the first
 * lane; or seconds, as transport is solved, by the second. */
enum cache_pace { CACHE_FAST, CACHE_SLOW, CACHE_SOLVED, CACHE_LANES = CACHE_SOLVED };

/* Waiters for entries whose preparation has not begun, in one lane. */
struct cache_queue {
  TAILQ_HEAD(cache_waiting, lookup) waiters;
  uint64_t count;                    /* number of waiters */
  unsigned begun;                    /* number of the owner's turns under way, in the second lane */
  TAILQ_ENTRY(cache_queue) in_turns; /* member of the list of turns if count > 0 */
};

/* The owner of waiters for slow things, for example a connection. Owners take turns. Before the
 * first use, set all members to 0. The cache's mutex guards them. */
struct cache_owner {
  struct cache_queue queues[CACHE_LANES];
};

/* What all lookups of one worker share; only its thread uses it. */
struct lookups {
  struct server *server;
  void (*wake)(void *context); /* called on any thread: lookups_wake() has something to do */
  void *context;
  struct cache_waiters woken;
};

/* A job's lookup of one thing after the other. Before the first, set on_ready, context and owner, and
 * all other members to 0. */
struct lookup {
  void (*on_ready)(void *context); /* called after LOOKUP_WAIT: look the same thing up again */
  void *context;
  struct cache_owner **owner; /* the owner whose turns are used to prepare slow things */
  struct cache_entry *entry;  /* after LOOKUP_READY: a reference, until lookup_return() */
  core_fault fault;           /* after LOOKUP_FAULT: why there is nothing */
  bool admitted; /* the job has had a thing before: max_waiting does not stop it halfway */
  bool woken;
  bool has_turn; /* whether it is one of its owner's in cache_queue.begun */

  struct cache_entry *awaited;    /* NULL: it does not wait, and these have no meaning: */
  struct lookups *waits_at;       /* whose thread it is of */
  struct cache_queue *queued_for; /* that it is in; NULL: the preparation has begun */
  TAILQ_ENTRY(lookup) in_queue;
  struct cache_waiters *list; /* the list of the entry, or of the woken, that it is in; or NULL */
  LIST_ENTRY(lookup) in_list;
};

/* Makes a cache that keeps at most limit_bytes, and apart_bytes of kinds that stand apart. A lookup
 * that is not admitted yet is refused if its owner has max_waiting lookups that wait for preparations
 * that have not begun. Returns NULL if there is no memory. */
struct cache *cache_new(const core_isa *isa, uint64_t limit_bytes, uint64_t apart_bytes,
                        uint64_t max_waiting, struct stats *stats);

/* Starts the threads that prepare slow things; without them, the caller takes the turns. Returns 0, or
 * an error of libuv. */
int cache_start(struct cache *cache);

/* Ends the threads and frees the cache. Asserts that nothing is being prepared and all references are released. */
void cache_free(struct cache *cache);

enum lookup_state { LOOKUP_READY, LOOKUP_FAULT, LOOKUP_WAIT };

/* Looks a thing up, which is prepared if it has to be: here, if that is fast. counted: whether the
 * statistics of the cache count that. */
enum lookup_state lookup_get(struct lookups *lookups, struct lookup *lookup,
                             const struct cache_key *key, enum cache_pace pace, bool counted);

/* Returns what LOOKUP_READY has found; NULL if there is nothing. */
const void *lookup_thing(const struct lookup *lookup);

/* Releases the thing, or gives up waiting for it. Does nothing if there is neither. */
void lookup_end(struct lookup *lookup);
static inline void lookup_return(struct lookup *lookup) {
  if (lookup->entry != NULL || lookup->awaited != NULL) {
    lookup_end(lookup);
  }
}

/* Counts in the statistics of the cache. */
void lookup_count(const struct lookups *lookups, bool hit);

/* The fields of faults: the owner has max_waiting_profiles waiters already; the thing is not there
 * and cannot be prepared here. */
#define LOOKUP_FIELD_BUSY "max_waiting_profiles"
#define LOOKUP_FIELD_UNKNOWN "set"

/* Returns whether a fault is temporary: memory is lacking, or too much waits. */
bool lookup_is_busy(core_fault fault);

/* Returns whether a fault is LOOKUP_FIELD_UNKNOWN. */
bool lookup_is_unknown(core_fault fault);

/* Calls on_ready() for the jobs whose things have been prepared. */
void lookups_wake(struct lookups *lookups);

/* Begins the turn of the next owner in a lane: returns the entry of this pace for which its first
 * waiter waits. The caller calls cache_prepare() and then cache_end_turn(). Returns NULL if no owner
 * has a waiter, or if enough entries are being prepared. */
struct cache_entry *cache_begin_turn(struct cache *cache, enum cache_pace pace);
void cache_end_turn(struct cache_entry *entry);

/* Prepares an entry, on any thread, and wakes all its waiters. A slow entry that has no waiters any
 * more is not prepared but removed from the cache; if the last one leaves while transport is being
 * solved, that stops. */
void cache_prepare(struct cache_entry *entry);

/* Lowers the priority of this thread to this nice value, for work that takes long: 10 gives a tenth of
 * the share of a worker on its core. A daemon that was started with a still lower priority keeps it. A
 * thread may not raise its priority again. */
void cache_lower_priority(int nice_least);

/* Makes all waiters of `from` waiters of `to`; `from` may then be freed. */
void cache_move_waiters(struct cache *cache, struct cache_owner *from, struct cache_owner *to);

/* Returns whether the entry is in the cache. A local store releases entries that are not. */
bool cache_keeps(const struct cache_entry *entry);

/* These take one more reference to an entry, and release one. */
void cache_hold(struct cache_entry *entry);
void cache_release(struct cache_entry *entry);

/* Marks an entry as used, when a worker has found it in its local store. Any thread with a
 * reference may call this at any time. */
void cache_used(struct cache_entry *entry);

#endif
