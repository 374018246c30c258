#include "server/store/profiles.h"

#include <assert.h>
#include <string.h>

#include "core/ruler.h"

/* ---- the table ------------------------------------------------------------------------------- */

static struct profiles_set *set_of(struct profiles *profiles, uint64_t hash) {
  return &profiles->sets[hash % PROFILES_SETS];
}

static void empty(struct profiles_slot *slot) {
  if (slot->entry != NULL) {
    cache_release(slot->entry);
    slot->entry = NULL;
  }
  slot->key.model = 0;
  slot->version++;
}

static bool is_evicted(const struct profiles_slot *slot) {
  return slot->entry != NULL && !cache_keeps(slot->entry);
}

/* Finds the slot of a profile. Returns NULL if the table does not have it. */
static struct profiles_slot *find(struct profiles *profiles, const struct cache_key *key) {
  struct profiles_set *set = set_of(profiles, key->hash);
  for (size_t way = 0; way < PROFILES_WAYS; way++) {
    struct profiles_slot *slot = &set->slots[way];
    if (set->hashes[way] == key->hash && cache_key_equal(&slot->key, key) && !is_evicted(slot)) {
      return slot;
    }
  }
  return NULL;
}

/* Returns the slot of a set that is replaced next. NULL if all slots are pinned. */
static struct profiles_slot *choose(struct profiles_set *set, uint64_t hash) {
  for (size_t tries = 0; tries < PROFILES_WAYS; tries++) {
    const unsigned way = set->next;
    set->next = (way + 1) % PROFILES_WAYS;
    if (set->slots[way].pins == 0) {
      set->hashes[way] = hash;
      return &set->slots[way];
    }
  }
  return NULL;
}

/* Puts a profile into the table. Returns its slot, or NULL if all slots of its set are pinned or
 * the table keeps nothing. */
static struct profiles_slot *put(struct profiles *profiles, const struct cache_key *key,
                                 const core_profile *profile, struct cache_entry *entry) {
  const bool may_be_kept = entry != NULL ? cache_keeps(entry) : core_profile_bytes(profile) == 0;
  if (!profiles->keeps || !may_be_kept) {
    return NULL;
  }
  struct profiles_slot *slot = find(profiles, key);
  if (slot != NULL) { /* Another job of this worker waited for the same profile. */
    return slot;
  }
  slot = choose(set_of(profiles, key->hash), key->hash);
  if (slot != NULL) {
    empty(slot);
    slot->key = *key;
    slot->profile = *profile;
    slot->entry = entry;
    if (entry != NULL) {
      cache_hold(entry);
    }
  }
  return slot;
}

static void empty_slots(struct profiles *profiles, bool all) {
  for (size_t i = 0; i < PROFILES_SETS * PROFILES_WAYS; i++) {
    struct profiles_slot *slot = &profiles->sets[i / PROFILES_WAYS].slots[i % PROFILES_WAYS];
    if (slot->pins == 0 && (all || is_evicted(slot))) {
      empty(slot);
    }
  }
}

void profiles_sweep(struct profiles *profiles) {
  empty_slots(profiles, false);
}

const core_profile *profiles_at(struct profiles_place place) {
  struct profiles_slot *slot = place.slot;
  if (slot == NULL || slot->version != place.version || is_evicted(slot)) {
    return NULL;
  }
  if (slot->entry != NULL) {
    cache_used(slot->entry);
  }
  return &slot->profile;
}

/* ---- getting --------------------------------------------------------------------------------- */

static void count(const struct profiles *profiles, bool hit) {
  stats_add(&profiles->server->stats, hit ? STATS_CACHE_HITS : STATS_CACHE_MISSES, 1);
}

static void set_place(struct profiles_lookup *lookup, struct profiles_slot *slot) {
  lookup->place =
      slot != NULL ? (struct profiles_place){slot, slot->version} : (struct profiles_place){0};
}

static enum profiles_answer get_from_table(struct profiles *profiles,
                                           struct profiles_lookup *lookup,
                                           struct profiles_slot *slot) {
  count(profiles, true);
  set_place(lookup, slot);
  lookup->profile = slot->profile;
  lookup->entry = slot->entry;
  if (slot->entry != NULL) {
    cache_used(slot->entry);
    cache_hold(slot->entry);
  }
  return PROFILES_READY;
}

/* Prepares a profile that does not go into the cache. */
static enum profiles_answer prepare_here(struct profiles *profiles,
                                         struct profiles_lookup *lookup) {
  count(profiles, false);
  stats_add(&profiles->server->stats, STATS_CACHE_BUILDS, 1);
  lookup->fault = cache_key_prepare(&lookup->key, profiles->server->isa, &lookup->profile, NULL);
  if (lookup->fault.field != NULL) {
    return PROFILES_FAULT;
  }
  set_place(lookup, put(profiles, &lookup->key, &lookup->profile, NULL));
  return PROFILES_READY;
}

/* Takes the profile of an entry that is prepared or has a fault, and the caller's reference to the
 * entry. */
static enum profiles_answer take(struct profiles *profiles, struct profiles_lookup *lookup,
                                 struct cache_entry *entry) {
  lookup->fault = cache_fault(entry);
  if (lookup->fault.field != NULL) {
    cache_release(entry);
    return PROFILES_FAULT;
  }
  lookup->entry = entry;
  lookup->fit = cache_fit(entry);
  lookup->varying = lookup->key.varying != 0 ? cache_varying(entry) : NULL;
  lookup->gather = cache_gather(entry);
  if (lookup->fit != NULL || lookup->varying != NULL || lookup->gather != NULL) {
    return PROFILES_READY;
  }
  lookup->profile = *cache_profile(entry);
  set_place(lookup, put(profiles, &lookup->key, &lookup->profile, entry));
  return PROFILES_READY;
}

static const core_fault unknown_set = {
    PROFILES_FIELD_SET, "sets of points that were sent to this daemon and are kept", 0};

/* Looks the key up in the cache. counted: whether the statistics of the cache count that. */
static enum profiles_answer look(struct profiles *profiles, struct profiles_lookup *lookup,
                                 bool slow, bool counted) {
  struct cache_entry *entry;
  const enum cache_answer answer =
      cache_look(profiles->server->cache, &lookup->key, slow, lookup->owner, &profiles->queue,
                 &lookup->waiter, &entry);
  if (counted) {
    count(profiles, answer == CACHE_KEPT);
  }
  switch (answer) {
  case CACHE_KEPT:
    return take(profiles, lookup, entry);
  case CACHE_NEW:
    cache_prepare(entry);
    return take(profiles, lookup, entry);
  case CACHE_AWAITED:
    cache_prepare_in_pool(profiles->server->cache, profiles->loop);
    return PROFILES_WAIT;
  case CACHE_UNKNOWN:
    lookup->fault = unknown_set;
    return PROFILES_FAULT;
  case CACHE_BUSY:
    lookup->fault = (core_fault){PROFILES_FIELD_BUSY, "fewer profiles that wait at a time", 0};
    return PROFILES_FAULT;
  case CACHE_NO_MEMORY:
    break;
  }
  lookup->fault = (core_fault){CORE_FIELD_MEMORY, "less than what is left: try again", 0};
  return PROFILES_FAULT;
}

static enum profiles_answer get_from_cache(struct profiles *profiles,
                                           struct profiles_lookup *lookup) {
  const struct cache_key *key = &lookup->key;
  const core_medium medium = cache_key_medium(key);
  core_parameters parameters;
  memcpy(parameters.value, key->parameters, sizeof parameters.value);
  const bool slow =
      key->design != NULL ||
      core_prepares_slowly(key->model, key->evaluator, key->varying ? NULL : &medium, &parameters);
  return look(profiles, lookup, slow, true);
}

/* Takes the entry for which the job waited. The entry is valid even if it has been evicted since.
 */
static enum profiles_answer get_awaited(struct profiles *profiles, struct profiles_lookup *lookup) {
  assert(lookup->woken);
  struct cache_entry *entry = lookup->waiter.entry;
  cache_hold(entry);
  cache_leave(&lookup->waiter);
  lookup->woken = false;
  return take(profiles, lookup, entry);
}

static enum profiles_answer get(struct profiles *profiles, struct profiles_lookup *lookup) {
  if (lookup->waiter.entry != NULL) {
    return get_awaited(profiles, lookup);
  }
  struct profiles_slot *slot = find(profiles, &lookup->key);
  if (slot != NULL) {
    return get_from_table(profiles, lookup, slot);
  }
  return core_worth_keeping(lookup->key.model, lookup->key.evaluator)
             ? get_from_cache(profiles, lookup)
             : prepare_here(profiles, lookup);
}

/* ---- public ---------------------------------------------------------------------------------- */

void profiles_start(struct profiles_lookup *lookup, unsigned model, unsigned moments,
                    unsigned evaluator, const core_parameters *parameters) {
  lookup->parameters = *parameters;
  cache_key_start(&lookup->key, model, moments, evaluator, parameters);
}

enum profiles_answer profiles_get(struct profiles *profiles, struct profiles_lookup *lookup,
                                  const core_medium *medium) {
  assert(!lookup->ready);
  cache_key_set_medium(&lookup->key, medium);
  const enum profiles_answer answer = get(profiles, lookup);
  lookup->ready = answer == PROFILES_READY;
  lookup->waiter.admitted |= answer != PROFILES_FAULT;
  if (lookup->ready) {
    core_profile_set_angles(&lookup->profile, &lookup->parameters);
  }
  return answer;
}

enum profiles_answer profiles_get_ruler(struct profiles *profiles, struct profiles_lookup *lookup,
                                        unsigned model, const core_parameters *parameters,
                                        const core_medium *medium) {
  if (lookup->ready || !core_ruler_is_needed(model, parameters, medium, false)) {
    return PROFILES_READY;
  }
  const core_parameters none = core_parameters_none();
  profiles_start(lookup, CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &none);
  return profiles_get(profiles, lookup, medium);
}

enum profiles_answer profiles_get_fit(struct profiles *profiles, struct profiles_lookup *lookup,
                                      const uint8_t *design, size_t design_bytes) {
  assert(!lookup->ready);
  cache_key_set_design(&lookup->key, design, design_bytes);
  const enum profiles_answer answer = lookup->waiter.entry != NULL
                                          ? get_awaited(profiles, lookup)
                                          : get_from_cache(profiles, lookup);
  lookup->ready = answer == PROFILES_READY;
  lookup->waiter.admitted |= answer != PROFILES_FAULT;
  return answer;
}

enum profiles_answer profiles_get_varying(struct profiles *profiles, struct profiles_lookup *lookup,
                                          double g, double eta) {
  assert(!lookup->ready && lookup->varying == NULL);
  lookup->key.varying = 1;
  cache_key_set_medium(&lookup->key, &(core_medium){0, 0, g, eta});
  const enum profiles_answer answer = lookup->waiter.entry != NULL
                                          ? get_awaited(profiles, lookup)
                                          : get_from_cache(profiles, lookup);
  lookup->waiter.admitted |= answer != PROFILES_FAULT;
  return answer;
}

enum profiles_answer profiles_get_points(struct profiles *profiles, struct profiles_lookup *lookup,
                                         const uint64_t set[2], struct points *points) {
  assert(!lookup->ready && lookup->gather == NULL);
  if ((set[0] | set[1]) == 0) { /* no set's name: in a key, it stands for anything but a set */
    lookup->fault = unknown_set;
    return PROFILES_FAULT;
  }
  cache_key_set_points(&lookup->key, set, points);
  const enum profiles_answer answer = lookup->waiter.entry != NULL
                                          ? get_awaited(profiles, lookup)
                                          : look(profiles, lookup, true, false);
  lookup->waiter.admitted |= answer != PROFILES_FAULT;
  return answer;
}

void profiles_return(struct profiles_lookup *lookup) {
  if (lookup->entry != NULL) {
    cache_release(lookup->entry);
    lookup->entry = NULL;
  } else if (lookup->ready) {
    core_profile_free(&lookup->profile);
  }
  lookup->varying = NULL;
  lookup->gather = NULL;
  lookup->ready = false;
  cache_leave(&lookup->waiter);
  lookup->woken = false;
}

bool profiles_is_busy(core_fault fault) {
  return strcmp(fault.field, CORE_FIELD_MEMORY) == 0 ||
         strcmp(fault.field, PROFILES_FIELD_BUSY) == 0;
}

bool profiles_is_unknown(core_fault fault) {
  return strcmp(fault.field, PROFILES_FIELD_SET) == 0;
}

void profiles_wake(struct profiles *profiles) {
  struct cache_waiter *waiter;
  while ((waiter = cache_next_woken(profiles->server->cache, &profiles->queue)) != NULL) {
    struct profiles_lookup *lookup =
        (void *)((char *)waiter - offsetof(struct profiles_lookup, waiter));
    lookup->woken = true;
    lookup->on_ready(lookup->context);
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
  assert(LIST_EMPTY(&profiles->queue.woken));
  empty_slots(profiles, true);
}
