#include "server/store/cache.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>
#include <uv.h>

enum {
  BUCKETS = 65536,  /* the system gives memory to those that are used */
  FAST_SHARE = 4,   /* What is fast to prepare may hold a quarter of all bytes. */
  LISTS = 3,        /* things that are fast to prepare, slow ones, and those apart */
  APART = 2,        /* index of the list of things apart */
  OWN_TURNS = 2,    /* of one owner at a time in each lane */
  THREADS_MOST = 8, /* that solve: for so many owners at a time, if each has one turn */
  SOLVE_NICE = 5,   /* which gives a third of the share of a worker on its core */
};

struct cache_entry {
  struct cache *cache;
  struct cache_key key;
  enum cache_pace pace;
  _Atomic uint64_t references;
  _Atomic bool kept; /* whether the thing is prepared and in the cache */
  _Atomic bool used; /* whether it was used since it was put at the head of its list */
  _Atomic bool stop; /* whether the preparation is to stop, as nobody waits for it any more */

  /* The mutex guards the following members. */
  bool under_way;               /* whether the thing is still to be prepared */
  bool begun;                   /* whether its preparation has begun */
  struct cache_waiters waiters; /* those who wait for the preparation */
  LIST_ENTRY(cache_entry) in_bucket;
  TAILQ_ENTRY(cache_entry) in_list; /* one of the cache's lists, or that of evicted entries */

  /* The thread that prepares the thing sets these before other threads see them. */
  uint64_t bytes;
  core_fault fault;
  _Alignas(16) uint8_t memory[]; /* the thing, then the content of its key */
};

TAILQ_HEAD(entries, cache_entry);
LIST_HEAD(bucket, cache_entry);

/* Prepared entries, the newest first. */
struct list {
  struct entries entries;
  uint64_t bytes;
  uint64_t count;
};

/* The queues of one pace, and the threads that serve them. */
struct lane {
  TAILQ_HEAD(, cache_queue) turns; /* queues that have waiters; the first has the next turn */
  struct cache_queue *latest;      /* that of the latest turn, or NULL; new ones go before it */
  unsigned turn_count;             /* number of turns that have begun and not ended */
  unsigned turns_most;             /* at a time */
  uv_cond_t changed;               /* whether there is a turn to take, or the cache stops */
  struct cache *cache;
  uv_thread_t threads[THREADS_MOST];
  unsigned thread_count;
};

struct cache {
  const core_isa *isa;
  struct stats *stats;
  uint64_t limit_bytes;
  uint64_t apart_bytes;
  uv_mutex_t mutex;       /* guards the members that follow */
  struct bucket *buckets; /* [BUCKETS] */
  struct list lists[LISTS];
  struct lane lanes[CACHE_LANES];
  unsigned own_turns; /* of one owner at a time in each lane */
  uint64_t max_waiting;
  bool stopping;
};

/* ---- references ------------------------------------------------------------------------------ */

void cache_hold(struct cache_entry *entry) {
  atomic_fetch_add_explicit(&entry->references, 1, memory_order_relaxed);
}

static void release_source(struct cache_entry *entry) {
  if (entry->key.source != NULL) {
    entry->key.kind->release(entry->key.source);
    entry->key.source = NULL;
  }
}

void cache_release(struct cache_entry *entry) {
  /* This order makes all that other threads did with the entry come before it is freed. */
  if (atomic_fetch_sub_explicit(&entry->references, 1, memory_order_acq_rel) > 1) {
    return;
  }
  if (entry->bytes > 0) {
    entry->key.kind->free(entry->memory);
  }
  release_source(entry);
  free(entry);
}

static void release_all(struct entries *evicted) {
  struct cache_entry *entry;
  while ((entry = TAILQ_FIRST(evicted)) != NULL) {
    TAILQ_REMOVE(evicted, entry, in_list);
    cache_release(entry);
  }
}

bool cache_keeps(const struct cache_entry *entry) {
  return atomic_load_explicit(&entry->kept, memory_order_relaxed);
}

void cache_used(struct cache_entry *entry) {
  /* Read before writing, so that threads that use the same entry can share its cache line. */
  if (!atomic_load_explicit(&entry->used, memory_order_relaxed)) {
    atomic_store_explicit(&entry->used, true, memory_order_relaxed);
  }
}

/* ---- the table of all entries; from here to the public part, the mutex is held --------------- */

static bool is_equal(const struct cache_key *a, const struct cache_key *b) {
  return a->hash == b->hash && a->kind == b->kind && a->content_bytes == b->content_bytes &&
         memcmp(a->content, b->content, a->content_bytes) == 0;
}

static struct bucket *bucket_of(const struct cache *cache, uint64_t hash) {
  return &cache->buckets[hash % BUCKETS];
}

static struct cache_entry *find_entry(const struct cache *cache, const struct cache_key *key) {
  struct cache_entry *entry;
  LIST_FOREACH(entry, bucket_of(cache, key->hash), in_bucket) {
    if (is_equal(&entry->key, key)) {
      break;
    }
  }
  return entry;
}

/* ---- eviction -------------------------------------------------------------------------------- */

static bool is_slow(const struct cache_entry *entry) {
  return entry->pace != CACHE_FAST;
}

static struct list *list_of(struct cache *cache, const struct cache_entry *entry) {
  return &cache->lists[entry->key.kind->apart ? APART : (int)is_slow(entry)];
}

static void move_to_head(struct list *list, struct cache_entry *entry) {
  atomic_store_explicit(&entry->used, false, memory_order_relaxed);
  TAILQ_REMOVE(&list->entries, entry, in_list);
  TAILQ_INSERT_HEAD(&list->entries, entry, in_list);
}

/* Returns the entry of a non-empty list that is evicted next: the oldest one that was not used
 * since it was put at the head of the list. Older entries that were used move to the head again. */
static struct cache_entry *choose_evicted(struct list *list) {
  for (uint64_t left = list->count; left > 0; left--) {
    struct cache_entry *oldest = TAILQ_LAST(&list->entries, entries);
    if (!atomic_load_explicit(&oldest->used, memory_order_relaxed)) {
      break;
    }
    move_to_head(list, oldest);
  }
  return TAILQ_LAST(&list->entries, entries);
}

static void evict_one(struct cache *cache, struct list *list, struct entries *evicted) {
  struct cache_entry *entry = choose_evicted(list);
  TAILQ_REMOVE(&list->entries, entry, in_list);
  list->bytes -= entry->bytes;
  list->count--;
  LIST_REMOVE(entry, in_bucket);
  atomic_store_explicit(&entry->kept, false, memory_order_relaxed);
  TAILQ_INSERT_HEAD(evicted, entry, in_list);
  const bool apart = entry->key.kind->apart;
  stats_add(cache->stats, apart ? STATS_POINTS_EVICTIONS : STATS_CACHE_EVICTIONS, 1);
  stats_subtract(cache->stats, apart ? STATS_POINTS_SETS : STATS_CACHE_ENTRIES, 1);
  stats_subtract(cache->stats, apart ? STATS_POINTS_BYTES : STATS_CACHE_BYTES, entry->bytes);
}

/* Returns the limit of the entries of one list. */
static uint64_t limit_of(const struct cache *cache, const struct cache_entry *entry) {
  return entry->key.kind->apart ? cache->apart_bytes
         : is_slow(entry)       ? cache->limit_bytes
                                : cache->limit_bytes / FAST_SHARE;
}

/* Makes room for an entry that is not larger than the limit of its list. For a fast entry, first
 * evicts fast entries until all of them are within their limit. Then evicts slow entries, as long
 * as there are any, until all entries are within the cache's limit. */
static void make_room(struct cache *cache, const struct cache_entry *entry,
                      struct entries *evicted) {
  struct list *fast = &cache->lists[false];
  struct list *slow = &cache->lists[true];
  struct list *apart = &cache->lists[APART];
  if (entry->key.kind->apart) {
    while (entry->bytes > cache->apart_bytes - apart->bytes) {
      evict_one(cache, apart, evicted);
    }
    return;
  }
  while (!is_slow(entry) && entry->bytes > limit_of(cache, entry) - fast->bytes) {
    evict_one(cache, fast, evicted);
  }
  while (entry->bytes > cache->limit_bytes - fast->bytes - slow->bytes) {
    evict_one(cache, slow->count > 0 ? slow : fast, evicted);
  }
}

/* Keeps an entry of the table that has just been prepared. If the entry has a fault, or is larger
 * than the limit, removes it and adds it to the evicted entries. */
static void keep_entry(struct cache *cache, struct cache_entry *entry, struct entries *evicted) {
  if (entry->fault.field != NULL || entry->bytes > limit_of(cache, entry)) {
    LIST_REMOVE(entry, in_bucket);
    TAILQ_INSERT_HEAD(evicted, entry, in_list);
    return;
  }
  make_room(cache, entry, evicted);
  struct list *list = list_of(cache, entry);
  TAILQ_INSERT_HEAD(&list->entries, entry, in_list);
  list->bytes += entry->bytes;
  list->count++;
  atomic_store_explicit(&entry->kept, true, memory_order_relaxed);
  const bool apart = entry->key.kind->apart;
  stats_add(cache->stats, apart ? STATS_POINTS_SETS : STATS_CACHE_ENTRIES, 1);
  stats_add(cache->stats, apart ? STATS_POINTS_BYTES : STATS_CACHE_BYTES, entry->bytes);
}

/* ---- waiting --------------------------------------------------------------------------------- */

static struct lane *lane_of(const struct cache_entry *entry) {
  return &entry->cache->lanes[entry->pace - CACHE_SLOW];
}

static void join_queue(struct lookup *waiter, struct cache_owner *owner) {
  struct lane *lane = lane_of(waiter->awaited);
  struct cache_queue *queue = &owner->queues[waiter->awaited->pace - CACHE_SLOW];
  if (queue->count++ == 0) {
    TAILQ_INIT(&queue->waiters);
    if (lane->latest != NULL) {
      TAILQ_INSERT_BEFORE(lane->latest, queue, in_turns);
    } else {
      TAILQ_INSERT_TAIL(&lane->turns, queue, in_turns);
    }
  }
  waiter->queued_for = queue;
  TAILQ_INSERT_TAIL(&queue->waiters, waiter, in_queue);
  uv_cond_signal(&lane->changed);
}

/* Removes the waiter from its owner's queue, if it is there. */
static void leave_queue(struct lookup *waiter) {
  struct cache_queue *queue = waiter->queued_for;
  if (queue != NULL) {
    struct lane *lane = lane_of(waiter->awaited);
    TAILQ_REMOVE(&queue->waiters, waiter, in_queue);
    waiter->queued_for = NULL;
    if (--queue->count == 0) {
      TAILQ_REMOVE(&lane->turns, queue, in_turns);
      lane->latest = lane->latest == queue ? NULL : lane->latest;
    }
  }
}

/* Lets the owner have another turn if the lookup's is one of those that it may have at a time. */
static void end_own_turn(struct lookup *lookup) {
  if (lookup->has_turn) {
    struct lane *lane = lane_of(lookup->awaited);
    lookup->has_turn = false;
    (*lookup->owner)->queues[lookup->awaited->pace - CACHE_SLOW].begun--;
    uv_cond_signal(&lane->changed);
  }
}

static void wait_for(struct cache_entry *entry, struct lookups *at, struct lookup *waiter) {
  cache_hold(entry);
  waiter->awaited = entry;
  waiter->waits_at = at;
  waiter->queued_for = NULL;
  waiter->has_turn = false;
  waiter->list = &entry->waiters;
  LIST_INSERT_HEAD(waiter->list, waiter, in_list);
  atomic_store(&entry->stop, false);
  if (!entry->begun) {
    join_queue(waiter, *waiter->owner);
  }
}

/* Removes a waiter from the list of its entry or of its queue, if it is in one. */
static void leave_list(struct lookup *waiter) {
  if (waiter->list != NULL) {
    LIST_REMOVE(waiter, in_list);
    waiter->list = NULL;
  }
}

/* Wakes the queues of all waiters of an entry. These queues are valid: the thread of a queue takes
 * its waiters out of this list before it ends. */
static void wake_all(struct cache_entry *entry) {
  struct lookup *waiter;
  while ((waiter = LIST_FIRST(&entry->waiters)) != NULL) {
    struct lookups *queue = waiter->waits_at;
    leave_list(waiter);
    waiter->list = &queue->woken;
    LIST_INSERT_HEAD(waiter->list, waiter, in_list);
    queue->wake(queue->context);
  }
}

/* Removes a slow entry from the table if nobody waits for it any more. Returns whether it did. */
static bool give_up(struct cache_entry *entry) {
  if (!is_slow(entry) || !LIST_EMPTY(&entry->waiters)) {
    return false;
  }
  LIST_REMOVE(entry, in_bucket);
  entry->under_way = false;
  return true;
}

static struct cache_entry *begin_turn(struct cache *cache, struct lane *lane) {
  struct cache_queue *queue;
  TAILQ_FOREACH(queue, &lane->turns, in_turns) {
    if (queue->begun < cache->own_turns) {
      break;
    }
  }
  if (queue == NULL || lane->turn_count == lane->turns_most) {
    return NULL;
  }
  TAILQ_REMOVE(&lane->turns, queue, in_turns);
  TAILQ_INSERT_TAIL(&lane->turns, queue, in_turns);
  lane->latest = queue;
  struct lookup *waiter = TAILQ_FIRST(&queue->waiters);
  struct cache_entry *entry = waiter->awaited;
  waiter->has_turn = lane->turns_most > cache->own_turns;
  queue->begun += waiter->has_turn;
  LIST_FOREACH(waiter, &entry->waiters, in_list) {
    leave_queue(waiter);
  }
  entry->begun = true;
  lane->turn_count++;
  cache_hold(entry);
  return entry;
}

/* Returns how far behind the thing the content of the key begins. */
static size_t content_offset(const struct cache_kind *kind) {
  return (kind->thing_bytes + 15) / 16 * 16;
}

/* Makes an entry with one reference, which the table holds. Returns NULL if there is no memory. */
static struct cache_entry *new_entry(struct cache *cache, const struct cache_key *key,
                                     enum cache_pace pace) {
  const size_t offset = content_offset(key->kind);
  struct cache_entry *entry = calloc(1, sizeof *entry + offset + key->content_bytes);
  if (entry != NULL) {
    entry->cache = cache;
    entry->key = *key;
    entry->key.content = memcpy(entry->memory + offset, key->content, key->content_bytes);
    if (key->source != NULL) {
      key->kind->hold(key->source);
    }
    entry->pace = pace;
    entry->under_way = true;
    entry->begun = pace == CACHE_FAST;
    atomic_init(&entry->references, 1);
    LIST_INSERT_HEAD(bucket_of(cache, entry->key.hash), entry, in_bucket);
  }
  return entry;
}

static uint64_t waiter_count(const struct cache_owner *owner) {
  uint64_t count = 0;
  for (size_t i = 0; i < CACHE_LANES; i++) {
    count += owner->queues[i].count;
  }
  return count;
}

static enum lookup_state refuse_lookup(struct lookup *lookup, const char *field,
                                       const char *allowed) {
  lookup->fault = (core_fault){field, allowed, 0};
  return LOOKUP_FAULT;
}

/* Sets lookup->entry to a reference if the thing is there. *is_new: whether the entry is new and fast,
 * so that the caller has to prepare it. */
static enum lookup_state look_up(struct cache *cache, struct lookups *at, struct lookup *lookup,
                                 const struct cache_key *key, enum cache_pace pace, bool *is_new) {
  struct cache_entry *entry = find_entry(cache, key);
  const bool new = entry == NULL;
  if (new && key->kind->hold != NULL && key->source == NULL) {
    return refuse_lookup(lookup, LOOKUP_FIELD_UNKNOWN,
                         "sets of points that were sent to this daemon and are kept");
  }
  if ((new ? pace != CACHE_FAST : !entry->begun) && !lookup->admitted &&
      waiter_count(*lookup->owner) >= cache->max_waiting) {
    return refuse_lookup(lookup, LOOKUP_FIELD_BUSY, "fewer profiles that wait at a time");
  }
  if (new) {
    entry = new_entry(cache, key, pace);
    if (entry == NULL) {
      return refuse_lookup(lookup, CORE_FIELD_MEMORY,
                           "less than the memory that is free: try again");
    }
  }
  *is_new = new &&pace == CACHE_FAST;
  if (entry->under_way && !*is_new) {
    wait_for(entry, at, lookup);
    return LOOKUP_WAIT;
  }
  if (!new) {
    move_to_head(list_of(cache, entry), entry);
  }
  cache_hold(entry);
  lookup->entry = entry;
  return LOOKUP_READY;
}

/* ---- public: takes the mutex ----------------------------------------------------------------- */

struct cache *cache_new(const core_isa *isa, uint64_t limit_bytes, uint64_t apart_bytes,
                        uint64_t max_waiting, struct stats *stats) {
  struct cache *cache = calloc(1, sizeof *cache);
  if (cache == NULL) {
    return NULL;
  }
  cache->isa = isa;
  cache->limit_bytes = limit_bytes;
  cache->apart_bytes = apart_bytes;
  cache->max_waiting = max_waiting;
  /* leaves processors for the workers */
  cache->own_turns = uv_available_parallelism() < 4 ? 1 : OWN_TURNS;
  cache->stats = stats;
  cache->buckets = calloc(BUCKETS, sizeof *cache->buckets);
  for (int i = 0; i < LISTS; i++) {
    TAILQ_INIT(&cache->lists[i].entries);
  }
  if (cache->buckets == NULL || uv_mutex_init(&cache->mutex) != 0) {
    free(cache->buckets);
    free(cache);
    return NULL;
  }
  for (size_t i = 0; i < CACHE_LANES; i++) {
    struct lane *lane = &cache->lanes[i];
    TAILQ_INIT(&lane->turns);
    lane->cache = cache;
    lane->turns_most = i + CACHE_SLOW == CACHE_SOLVED ? THREADS_MOST : cache->own_turns;
    if (uv_cond_init(&lane->changed) != 0) {
      abort(); /* On Linux this takes nothing that could be lacking. */
    }
  }
  return cache;
}

static void stop_threads(struct cache *cache) {
  uv_mutex_lock(&cache->mutex);
  cache->stopping = true;
  for (size_t i = 0; i < CACHE_LANES; i++) {
    uv_cond_broadcast(&cache->lanes[i].changed);
  }
  uv_mutex_unlock(&cache->mutex);
  for (size_t i = 0; i < CACHE_LANES; i++) {
    struct lane *lane = &cache->lanes[i];
    while (lane->thread_count > 0) {
      uv_thread_join(&lane->threads[--lane->thread_count]);
    }
  }
}

void cache_free(struct cache *cache) {
  if (cache == NULL) {
    return;
  }
  stop_threads(cache);
  for (size_t i = 0; i < LISTS; i++) { /* hold all entries, since none is under way */
    struct cache_entry *entry;
    TAILQ_FOREACH(entry, &cache->lists[i].entries, in_list) {
      assert(!entry->under_way && atomic_load(&entry->references) == 1);
    }
    release_all(&cache->lists[i].entries);
  }
  for (size_t i = 0; i < CACHE_LANES; i++) {
    uv_cond_destroy(&cache->lanes[i].changed);
  }
  uv_mutex_destroy(&cache->mutex);
  free(cache->buckets);
  free(cache);
}

struct cache_entry *cache_begin_turn(struct cache *cache, enum cache_pace pace) {
  uv_mutex_lock(&cache->mutex);
  struct cache_entry *entry = begin_turn(cache, &cache->lanes[pace - CACHE_SLOW]);
  uv_mutex_unlock(&cache->mutex);
  return entry;
}

void cache_end_turn(struct cache_entry *entry) {
  struct cache *cache = entry->cache;
  uv_mutex_lock(&cache->mutex);
  lane_of(entry)->turn_count--;
  uv_mutex_unlock(&cache->mutex);
  cache_release(entry);
}

void cache_move_waiters(struct cache *cache, struct cache_owner *from, struct cache_owner *to) {
  uv_mutex_lock(&cache->mutex);
  for (size_t i = 0; i < CACHE_LANES; i++) {
    while (from->queues[i].count > 0) {
      struct lookup *waiter = TAILQ_FIRST(&from->queues[i].waiters);
      leave_queue(waiter);
      join_queue(waiter, to);
    }
    to->queues[i].begun += from->queues[i].begun;
  }
  uv_mutex_unlock(&cache->mutex);
}

/* Prepares the thing, or sets the fault. Returns the bytes of the entry; 0 with a fault. */
static uint64_t prepare_entry(struct cache_entry *entry) {
  const struct cache_kind *kind = entry->key.kind;
  entry->fault = kind->prepare(entry->memory, &entry->key, entry->cache->isa, &entry->stop);
  return entry->fault.field == NULL ? sizeof *entry + content_offset(kind) +
                                          entry->key.content_bytes + kind->bytes(entry->memory)
                                    : 0;
}

void cache_prepare(struct cache_entry *entry) {
  struct cache *cache = entry->cache;
  uv_mutex_lock(&cache->mutex);
  const bool given_up = give_up(entry);
  uv_mutex_unlock(&cache->mutex);
  if (given_up) {
    cache_release(entry); /* the table's */
    return;
  }
  stats_add(cache->stats, STATS_CACHE_BUILDS, 1);
  struct entries evicted = TAILQ_HEAD_INITIALIZER(evicted);
  entry->bytes = prepare_entry(entry);
  uv_mutex_lock(&cache->mutex);
  while (entry->fault.field != NULL && strcmp(entry->fault.field, CORE_FIELD_STOPPED) == 0 &&
         !LIST_EMPTY(&entry->waiters)) { /* waiters that came after it had stopped */
    uv_mutex_unlock(&cache->mutex);
    entry->bytes = prepare_entry(entry);
    uv_mutex_lock(&cache->mutex);
  }
  release_source(entry);
  entry->under_way = false;
  keep_entry(cache, entry, &evicted);
  wake_all(entry);
  uv_mutex_unlock(&cache->mutex);
  release_all(&evicted);
}

void cache_lower_priority(int nice_least) {
  const id_t thread = (id_t)gettid(); /* On Linux, these functions take the id of a thread. */
  if (getpriority(PRIO_PROCESS, thread) < nice_least) {
    setpriority(PRIO_PROCESS, thread, nice_least); /* which every thread may do */
  }
}

static void take_turns(void *argument) {
  struct lane *lane = argument;
  struct cache *cache = lane->cache;
  if (lane == &cache->lanes[CACHE_SOLVED - CACHE_SLOW]) {
    cache_lower_priority(SOLVE_NICE);
  }
  uv_mutex_lock(&cache->mutex);
  while (!cache->stopping) {
    struct cache_entry *entry = begin_turn(cache, lane);
    if (entry == NULL) {
      uv_cond_wait(&lane->changed, &cache->mutex);
      continue;
    }
    uv_mutex_unlock(&cache->mutex);
    cache_prepare(entry);
    cache_end_turn(entry);
    uv_mutex_lock(&cache->mutex);
  }
  uv_mutex_unlock(&cache->mutex);
}

int cache_start(struct cache *cache) {
  for (size_t i = 0; i < CACHE_LANES; i++) {
    struct lane *lane = &cache->lanes[i];
    for (; lane->thread_count < lane->turns_most; lane->thread_count++) {
      const int error = uv_thread_create(&lane->threads[lane->thread_count], take_turns, lane);
      if (error != 0) {
        return error;
      }
    }
  }
  return 0;
}

/* ---- lookups --------------------------------------------------------------------------------- */

void lookup_count(const struct lookups *lookups, bool hit) {
  stats_add(&lookups->server->stats, hit ? STATS_CACHE_HITS : STATS_CACHE_MISSES, 1);
}

/* Ends the waiting for an entry, woken or not. */
static void leave_entry(struct lookup *lookup) {
  struct cache_entry *entry = lookup->awaited;
  struct cache *cache = entry->cache;
  uv_mutex_lock(&cache->mutex);
  leave_list(lookup);
  leave_queue(lookup);
  end_own_turn(lookup);
  const bool given_up = !entry->begun && give_up(entry);
  if (is_slow(entry) && LIST_EMPTY(&entry->waiters)) {
    atomic_store(&entry->stop, true);
  }
  uv_mutex_unlock(&cache->mutex);
  lookup->awaited = NULL;
  lookup->woken = false;
  if (given_up) {
    cache_release(entry); /* the table's */
  }
  cache_release(entry);
}

static enum lookup_state look_up_first(struct lookups *lookups, struct lookup *lookup,
                                       const struct cache_key *key, enum cache_pace pace,
                                       bool counted) {
  struct cache *cache = lookups->server->cache;
  bool is_new = false;
  uv_mutex_lock(&cache->mutex);
  const enum lookup_state state = look_up(cache, lookups, lookup, key, pace, &is_new);
  uv_mutex_unlock(&cache->mutex);
  if (counted) {
    lookup_count(lookups, state == LOOKUP_READY && !is_new);
  }
  if (is_new) {
    cache_prepare(lookup->entry);
  }
  return state;
}

enum lookup_state lookup_get(struct lookups *lookups, struct lookup *lookup,
                             const struct cache_key *key, enum cache_pace pace, bool counted) {
  enum lookup_state state = LOOKUP_READY;
  assert(lookup->entry == NULL);
  if (lookup->awaited != NULL) { /* The entry is valid even if it has been evicted since. */
    assert(lookup->woken);
    cache_hold(lookup->awaited);
    lookup->entry = lookup->awaited;
    leave_entry(lookup);
  } else {
    state = look_up_first(lookups, lookup, key, pace, counted);
  }
  if (state == LOOKUP_READY && lookup->entry->fault.field != NULL) {
    lookup->fault = lookup->entry->fault;
    lookup_end(lookup);
    state = LOOKUP_FAULT;
  }
  lookup->admitted |= state != LOOKUP_FAULT;
  return state;
}

void lookup_end(struct lookup *lookup) {
  if (lookup->entry != NULL) {
    cache_release(lookup->entry);
    lookup->entry = NULL;
  }
  if (lookup->awaited != NULL) {
    leave_entry(lookup);
  }
}

const void *lookup_thing(const struct lookup *lookup) {
  return lookup->entry != NULL ? lookup->entry->memory : NULL;
}

bool lookup_is_busy(core_fault fault) {
  return strcmp(fault.field, CORE_FIELD_MEMORY) == 0 || strcmp(fault.field, LOOKUP_FIELD_BUSY) == 0;
}

bool lookup_is_unknown(core_fault fault) {
  return strcmp(fault.field, LOOKUP_FIELD_UNKNOWN) == 0;
}

/* Returns a lookup whose entry has been prepared or has a fault, or NULL. */
static struct lookup *next_woken(struct lookups *lookups) {
  struct cache *cache = lookups->server->cache;
  uv_mutex_lock(&cache->mutex);
  struct lookup *lookup = LIST_FIRST(&lookups->woken);
  if (lookup != NULL) {
    leave_list(lookup);
  }
  uv_mutex_unlock(&cache->mutex);
  return lookup;
}

void lookups_wake(struct lookups *lookups) {
  struct lookup *lookup;
  while ((lookup = next_woken(lookups)) != NULL) {
    lookup->woken = true;
    lookup->on_ready(lookup->context);
  }
}
