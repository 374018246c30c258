#include "server/store/profiles.h"

#include <assert.h>
#include <stdlib.h>

/* ---- preparing on another thread --------------------------------------------------------------
 */

struct task {
  uv_work_t work;
  struct cache_entry *entry; /* a reference */
};

static void prepare(uv_work_t *work) {
  const struct task *task = work->data;
  cache_prepare(task->entry);
}

static void on_prepared(uv_work_t *work, int status) {
  (void)status; /* never cancelled: cache_prepare() sees itself whether it is still wanted */
  struct task *task = work->data;
  cache_release(task->entry);
  free(task);
}

/* Takes the reference. Without memory for the task it is prepared at once. */
static void start_preparing(struct profiles *profiles, struct cache_entry *entry) {
  struct task *task = malloc(sizeof *task);
  if (task != NULL) {
    task->work.data = task;
    task->entry = entry;
    if (uv_queue_work(profiles->loop, &task->work, prepare, on_prepared) == 0) {
      return;
    }
  }
  free(task);
  cache_prepare(entry);
  cache_release(entry);
}

/* ---- at hand ----------------------------------------------------------------------------------
 */

static size_t set_of(const struct cache_key *key) {
  return key->hash % PROFILES_SETS;
}

/* The way of a set that this hash is in, PROFILES_WAYS: none. */
static size_t find(const struct profiles_set *set, uint64_t hash) {
  size_t way = 0;
  while (way < PROFILES_WAYS && set->hashes[way] != hash) {
    way++;
  }
  return way;
}

/* A way for this hash, in the place of another; at most one for each hash. */
static size_t place(struct profiles_set *set, uint64_t hash) {
  size_t way = find(set, hash);
  if (way == PROFILES_WAYS) {
    way = set->next;
    set->next = (set->next + 1) % PROFILES_WAYS;
    set->hashes[way] = hash;
  }
  return way;
}

static void let_go(struct cache_entry **slot) {
  if (*slot != NULL) {
    cache_release(*slot);
    *slot = NULL;
  }
}

/* A reference; NULL: it is not at hand. */
static struct cache_entry *take_at_hand(struct profiles *profiles, const struct cache_key *key) {
  const size_t set = set_of(key);
  const size_t way = find(&profiles->entry_sets[set], key->hash);
  struct cache_entry *entry = way < PROFILES_WAYS ? profiles->entries[set][way] : NULL;
  if (entry == NULL || !cache_is(entry, key)) {
    return NULL;
  }
  if (!cache_keeps(entry)) {
    let_go(&profiles->entries[set][way]);
    return NULL;
  }
  cache_used(entry);
  cache_hold(entry);
  return entry;
}

static void put_at_hand(struct profiles *profiles, const struct cache_key *key,
                        struct cache_entry *entry) {
  if (!cache_keeps(entry)) {
    return;
  }
  const size_t set = set_of(key);
  struct cache_entry **slot = &profiles->entries[set][place(&profiles->entry_sets[set], key->hash)];
  if (*slot != entry) {
    let_go(slot);
    cache_hold(entry);
    *slot = entry;
  }
}

static void let_go_of(struct profiles *profiles, bool all) {
  for (size_t set = 0; set < PROFILES_SETS; set++) {
    for (size_t way = 0; way < PROFILES_WAYS; way++) {
      struct cache_entry **slot = &profiles->entries[set][way];
      if (all || (*slot != NULL && !cache_keeps(*slot))) {
        let_go(slot);
      }
    }
  }
}

void profiles_sweep(struct profiles *profiles) {
  let_go_of(profiles, false);
}

static bool take_copy(const struct profiles *profiles, const struct cache_key *key,
                      core_profile *profile) {
  const size_t set = set_of(key);
  const size_t way = find(&profiles->copy_sets[set], key->hash);
  if (way == PROFILES_WAYS || !cache_key_equal(&profiles->copies[set][way].key, key)) {
    return false;
  }
  *profile = profiles->copies[set][way].profile;
  return true;
}

static void put_copy(struct profiles *profiles, const struct cache_key *key,
                     const core_profile *profile) {
  if (profiles->keeps && core_profile_bytes(profile) == 0) {
    const size_t set = set_of(key);
    const size_t way = place(&profiles->copy_sets[set], key->hash);
    profiles->copies[set][way] = (struct profiles_copy){*key, *profile};
  }
}

/* ---- getting ----------------------------------------------------------------------------------
 */

static void count(const struct profiles *profiles, bool hit) {
  stats_add(&profiles->server->stats, hit ? STATS_CACHE_HITS : STATS_CACHE_MISSES, 1);
}

/* A profile that takes little to prepare: a copy, or prepared now. */
static enum profiles_answer get_copy(struct profiles *profiles, struct profiles_order *order) {
  const bool hit = take_copy(profiles, &order->key, &order->profile);
  count(profiles, hit);
  if (hit) {
    return PROFILES_READY;
  }
  stats_add(&profiles->server->stats, STATS_CACHE_BUILDS, 1);
  order->fault = cache_key_prepare(&order->key, profiles->server->isa, &order->profile);
  if (order->fault.field != NULL) {
    return PROFILES_FAULT;
  }
  put_copy(profiles, &order->key, &order->profile);
  return PROFILES_READY;
}

/* Takes over a reference to an entry that is prepared, or has a fault. */
static enum profiles_answer take(struct profiles *profiles, struct profiles_order *order,
                                 struct cache_entry *entry) {
  order->fault = cache_fault(entry);
  if (order->fault.field != NULL) {
    cache_release(entry);
    return PROFILES_FAULT;
  }
  put_at_hand(profiles, &order->key, entry);
  order->entry = entry;
  order->profile = *cache_profile(entry);
  return PROFILES_READY;
}

static enum profiles_answer get_from_cache(struct profiles *profiles, struct profiles_order *order,
                                           bool slow) {
  struct cache_entry *entry;
  const enum cache_answer answer = cache_look(profiles->server->cache, &order->key, slow,
                                              &profiles->queue, &order->waiter, &entry);
  count(profiles, answer == CACHE_KEPT);
  switch (answer) {
  case CACHE_KEPT:
    return take(profiles, order, entry);
  case CACHE_NEW:
    if (!slow) {
      cache_prepare(entry);
      return take(profiles, order, entry);
    }
    start_preparing(profiles, entry);
    return PROFILES_WAIT;
  case CACHE_AWAITED:
    return PROFILES_WAIT;
  case CACHE_NO_MEMORY:
    break;
  }
  order->fault = (core_fault){CORE_FIELD_MEMORY, "less than what is left: try again", 0};
  return PROFILES_FAULT;
}

/* The entry that was waited for; it is there even if it has been evicted again. */
static enum profiles_answer get_awaited(struct profiles *profiles, struct profiles_order *order) {
  assert(order->woken);
  struct cache_entry *entry = order->waiter.entry;
  cache_hold(entry);
  cache_leave(&order->waiter);
  order->woken = false;
  return take(profiles, order, entry);
}

static enum profiles_answer get_kept(struct profiles *profiles, struct profiles_order *order) {
  if (order->waiter.entry != NULL) {
    return get_awaited(profiles, order);
  }
  struct cache_entry *entry = take_at_hand(profiles, &order->key);
  if (entry != NULL) {
    count(profiles, true);
    return take(profiles, order, entry);
  }
  return get_from_cache(profiles, order,
                        core_prepares_slowly(order->key.model, order->key.evaluator));
}

/* ---- public -----------------------------------------------------------------------------------
 */

void profiles_start(struct profiles_order *order, unsigned model, unsigned moments,
                    unsigned evaluator, const core_parameters *parameters) {
  order->parameters = *parameters;
  cache_key_start(&order->key, model, moments, evaluator, parameters);
}

enum profiles_answer profiles_get(struct profiles *profiles, struct profiles_order *order,
                                  const core_medium *medium) {
  assert(!order->ready);
  cache_key_set_medium(&order->key, medium);
  const enum profiles_answer answer = core_worth_keeping(order->key.model, order->key.evaluator)
                                          ? get_kept(profiles, order)
                                          : get_copy(profiles, order);
  order->ready = answer == PROFILES_READY;
  if (order->ready) {
    core_profile_set_angles(&order->profile, &order->parameters);
  }
  return answer;
}

void profiles_return(struct profiles_order *order) {
  if (order->entry != NULL) {
    cache_release(order->entry);
    order->entry = NULL;
  } else if (order->ready) {
    core_profile_free(&order->profile); /* of what it owns, if anything */
  }
  order->ready = false;
  cache_leave(&order->waiter);
  order->woken = false;
}

void profiles_wake(struct profiles *profiles) {
  struct cache_waiter *waiter;
  while ((waiter = cache_next_woken(profiles->server->cache, &profiles->queue)) != NULL) {
    struct profiles_order *order =
        (void *)((char *)waiter - offsetof(struct profiles_order, waiter));
    order->woken = true;
    order->on_ready(order->context);
  }
}

void profiles_init(struct profiles *profiles, struct server *server, uv_loop_t *loop,
                   void (*wake)(void *context), void *context) {
  *profiles = (struct profiles){
      .server = server,
      .loop = loop,
      .keeps = server->options.cache_bytes > 0,
      .queue = {.wake = wake, .context = context},
  };
}

void profiles_end(struct profiles *profiles) {
  assert(profiles->queue.woken == NULL);
  let_go_of(profiles, true);
}
