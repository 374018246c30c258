#include "server/store/profiles.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/ruler.h"

/* ---- keys ------------------------------------------------------------------------------------ */

static_assert(offsetof(struct profiles_key, medium) == 32 + 8 * CORE_PARAMETERS_END &&
                  sizeof(core_medium) == 40,
              "no padding");

static size_t key_bytes(const struct profiles_key *key) {
  return offsetof(struct profiles_key, medium) + key->layer_count * sizeof key->medium[0];
}

/* Copies numbers so that equal ones have the same bytes: there is one NaN, and 0 has no sign. */
static void normalize(double *to, const double *from, size_t count) {
  for (size_t i = 0; i < count; i++) {
    to[i] = isnan(from[i]) ? (double)NAN : from[i] + 0.0;
  }
}

void profiles_key_start(struct profiles_key *key, unsigned model, unsigned moments,
                        unsigned evaluator, const core_parameters *parameters) {
  key->model = model;
  key->moments = moments;
  key->evaluator = evaluator;
  key->layer_count = parameters->layer_count;
  normalize(key->parameters, parameters->value, CORE_PARAMETERS_END);
  key->parameters[CORE_PARAMETER_COS_IN] = key->parameters[CORE_PARAMETER_COS_OUT] = (double)NAN;
  const size_t start = offsetof(struct profiles_key, model);
  key->hash_before_medium =
      cache_hash(0, &key->model, offsetof(struct profiles_key, medium) - start);
}

void profiles_key_set_medium(struct profiles_key *key, const core_medium *medium) {
  const size_t bytes = key->layer_count * sizeof *medium;
  normalize(&key->medium->sigma_a_per_mm, &medium->sigma_a_per_mm, bytes / sizeof(double));
  key->hash = cache_hash(key->hash_before_medium, key->medium, bytes);
}

bool profiles_key_equal(const struct profiles_key *a, const struct profiles_key *b) {
  return a->hash == b->hash && memcmp(a, b, key_bytes(b)) == 0;
}

struct cache_key profiles_cache_key(const struct profiles_key *key, const struct cache_kind *kind) {
  return (struct cache_key){
      .kind = kind, .content = key, .content_bytes = key_bytes(key), .hash = key->hash};
}

/* ---- profiles in the cache ------------------------------------------------------------------- */

static core_fault prepare_profile(core_profile *profile, const struct profiles_key *key,
                                  const core_isa *isa, const atomic_bool *stop) {
  core_parameters parameters = {.layer_count = key->layer_count};
  memcpy(parameters.value, key->parameters, sizeof parameters.value);
  return core_profile_prepare_until(profile, isa, key->model, key->moments, key->evaluator,
                                    key->medium, &parameters, stop);
}

static core_fault prepare_thing(void *thing, const struct cache_key *key, const core_isa *isa,
                                const atomic_bool *stop) {
  return prepare_profile(thing, key->content, isa, stop);
}

static void free_profile(void *thing) {
  core_profile_free(thing);
}

static uint64_t bytes_of(const void *thing) {
  return core_profile_bytes(thing);
}

const struct cache_kind profiles_kind = {.thing_bytes = sizeof(core_profile),
                                         .prepare = prepare_thing,
                                         .free = free_profile,
                                         .bytes = bytes_of};

/* ---- the table ------------------------------------------------------------------------------- */

static struct profiles_set *set_of(struct profiles *profiles, uint64_t hash) {
  return &profiles->sets[hash % PROFILES_SETS];
}

static void empty_slot(struct profiles_slot *slot) {
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
static struct profiles_slot *find_slot(struct profiles *profiles, const struct profiles_key *key) {
  struct profiles_set *set = set_of(profiles, key->hash);
  for (size_t way = 0; way < PROFILES_WAYS; way++) {
    struct profiles_slot *slot = &set->slots[way];
    if (set->hashes[way] == key->hash && profiles_key_equal(&slot->key, key) && !is_evicted(slot)) {
      return slot;
    }
  }
  return NULL;
}

/* Returns the slot of a set that is replaced next. NULL if all slots are pinned. */
static struct profiles_slot *choose_slot(struct profiles_set *set, uint64_t hash) {
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
static struct profiles_slot *put_profile(struct profiles *profiles, const struct profiles_key *key,
                                         const core_profile *profile, struct cache_entry *entry) {
  const bool may_be_kept = entry != NULL ? cache_keeps(entry) : core_profile_bytes(profile) == 0;
  if (!profiles->keeps || !may_be_kept) {
    return NULL;
  }
  struct profiles_slot *slot = find_slot(profiles, key);
  if (slot != NULL) { /* Another job of this worker waited for the same profile. */
    return slot;
  }
  slot = choose_slot(set_of(profiles, key->hash), key->hash);
  if (slot != NULL) {
    empty_slot(slot);
    memcpy(&slot->key, key, key_bytes(key));
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
      empty_slot(slot);
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

static void set_place(struct profiles_lookup *lookup, struct profiles_slot *slot) {
  lookup->place =
      slot != NULL ? (struct profiles_place){slot, slot->version} : (struct profiles_place){0};
}

static enum lookup_state get_from_table(struct profiles *profiles, struct profiles_lookup *lookup,
                                        struct profiles_slot *slot) {
  lookup_count(&profiles->lookups, true);
  set_place(lookup, slot);
  lookup->profile = slot->profile;
  lookup->cached.entry = slot->entry;
  if (slot->entry != NULL) {
    cache_used(slot->entry);
    cache_hold(slot->entry);
  }
  return LOOKUP_READY;
}

/* Prepares a profile that does not go into the cache. */
static enum lookup_state prepare_here(struct profiles *profiles, struct profiles_lookup *lookup) {
  struct server *server = profiles->lookups.server;
  lookup_count(&profiles->lookups, false);
  stats_add(&server->stats, STATS_CACHE_BUILDS, 1);
  lookup->fault = prepare_profile(&lookup->profile, &lookup->key, server->isa, NULL);
  if (lookup->fault.field != NULL) {
    return LOOKUP_FAULT;
  }
  set_place(lookup, put_profile(profiles, &lookup->key, &lookup->profile, NULL));
  return LOOKUP_READY;
}

static enum lookup_state get_from_cache(struct profiles *profiles, struct profiles_lookup *lookup,
                                        const core_medium *medium) {
  const struct cache_key key = profiles_cache_key(&lookup->key, &profiles_kind);
  const enum cache_pace pace =
      core_has_to_solve(lookup->key.model, medium, &lookup->parameters) ? CACHE_SOLVED
      : core_prepares_slowly(lookup->key.model, lookup->key.evaluator, medium, &lookup->parameters)
          ? CACHE_SLOW
          : CACHE_FAST;
  const enum lookup_state state = lookup_get(&profiles->lookups, &lookup->cached, &key, pace, true);
  lookup->fault = lookup->cached.fault;
  if (state == LOOKUP_READY) {
    lookup->profile = *(const core_profile *)lookup_thing(&lookup->cached);
    set_place(lookup, put_profile(profiles, &lookup->key, &lookup->profile, lookup->cached.entry));
  }
  return state;
}

static enum lookup_state get_profile(struct profiles *profiles, struct profiles_lookup *lookup,
                                     const core_medium *medium) {
  if (lookup->cached.awaited != NULL) {
    return get_from_cache(profiles, lookup, medium);
  }
  struct profiles_slot *slot = find_slot(profiles, &lookup->key);
  if (slot != NULL) {
    return get_from_table(profiles, lookup, slot);
  }
  return core_worth_keeping(lookup->key.model, lookup->key.evaluator, &lookup->parameters)
             ? get_from_cache(profiles, lookup, medium)
             : prepare_here(profiles, lookup);
}

/* ---- public ---------------------------------------------------------------------------------- */

void profiles_start(struct profiles_lookup *lookup, unsigned model, unsigned moments,
                    unsigned evaluator, const core_parameters *parameters) {
  lookup->parameters = *parameters;
  profiles_key_start(&lookup->key, model, moments, evaluator, parameters);
}

enum lookup_state profiles_get(struct profiles *profiles, struct profiles_lookup *lookup,
                               const core_medium *medium) {
  assert(!lookup->ready);
  profiles_key_set_medium(&lookup->key, medium);
  const enum lookup_state state = get_profile(profiles, lookup, medium);
  lookup->ready = state == LOOKUP_READY;
  lookup->cached.admitted |= state != LOOKUP_FAULT;
  if (lookup->ready) {
    core_profile_set_angles(&lookup->profile, &lookup->parameters);
  }
  return state;
}

enum lookup_state profiles_get_ruler(struct profiles *profiles, struct profiles_lookup *lookup,
                                     unsigned model, const core_parameters *parameters,
                                     const core_medium *medium, bool solves) {
  if (lookup->ready || !core_ruler_is_needed(model, parameters, medium, solves)) {
    return LOOKUP_READY;
  }
  const core_parameters none = core_parameters_none();
  profiles_start(lookup, core_ruler_of(model, parameters), CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64,
                 &none);
  return profiles_get(profiles, lookup, medium);
}

void profiles_return(struct profiles_lookup *lookup) {
  if (lookup->cached.entry == NULL && lookup->ready) {
    core_profile_free(&lookup->profile);
  }
  lookup->ready = false;
  lookup_return(&lookup->cached);
}

void profiles_init(struct profiles *profiles, struct server *server, void (*wake)(void *context),
                   void *context) {
  *profiles = (struct profiles){
      .lookups = {.server = server, .wake = wake, .context = context},
      .keeps = server->options.cache_bytes > 0,
  };
}

void profiles_end(struct profiles *profiles) {
  assert(LIST_EMPTY(&profiles->lookups.woken));
  empty_slots(profiles, true);
}

/* ---- what media that vary share --------------------------------------------------------------- */

/* The key is that of a profile, whose medium has 0 in place of sigma_a and sigma_s. */
static core_fault prepare_varying(void *thing, const struct cache_key *key, const core_isa *isa,
                                  const atomic_bool *stop) {
  const struct profiles_key *from = key->content;
  core_parameters parameters = {.layer_count = 1};
  (void)stop;
  memcpy(parameters.value, from->parameters, sizeof parameters.value);
  return core_varying_prepare(thing, isa, from->model, from->moments, from->evaluator,
                              from->medium->g, from->medium->eta, &parameters);
}

static void free_varying(void *thing) {
  core_varying_free(thing);
}

static uint64_t varying_bytes(const void *thing) {
  return core_varying_bytes(thing);
}

static const struct cache_kind varyings_kind = {.thing_bytes = sizeof(core_varying),
                                                .prepare = prepare_varying,
                                                .free = free_varying,
                                                .bytes = varying_bytes};

enum lookup_state varyings_get(struct lookups *lookups, struct lookup *lookup, unsigned model,
                               unsigned moments, unsigned evaluator,
                               const core_parameters *parameters, double g, double eta) {
  struct profiles_key from;
  profiles_key_start(&from, model, moments, evaluator, parameters);
  profiles_key_set_medium(&from, &(core_medium){0, 0, g, eta});
  const struct cache_key key = profiles_cache_key(&from, &varyings_kind);
  return lookup_get(
      lookups, lookup, &key,
      core_prepares_slowly(model, evaluator, NULL, parameters) ? CACHE_SLOW : CACHE_FAST, true);
}
