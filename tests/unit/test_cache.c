/* The cache of prepared profiles, without a daemon: which keys are the same, which profiles are
 * kept for how long, and that many who ask for a profile at the same time cause one preparation. */
#include <limits.h>
#include <math.h>
#include <uv.h>

#include "server/store/profiles.h"
#include "tests/unit/unit.h"

static const core_medium SKIN = {0.032, 0.74, 0, 1.3};

/* Returns key number i. Its model is single scattering, whose profile is made quickly and has the
 * same size for all media. */
static struct profiles_key key_number(unsigned i) {
  const core_parameters none = core_parameters_none();
  const core_medium medium = {0.01 + 0.001 * i, 0.74, 0, 1.3};
  struct profiles_key key;
  profiles_key_start(&key, CORE_MODEL_SINGLE, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &none);
  profiles_key_set_medium(&key, &medium);
  return key;
}

static const core_profile *profile_of(const struct lookup *lookup) {
  return lookup_thing(lookup);
}

static enum lookup_state look(struct lookups *lookups, struct lookup *lookup,
                              const struct profiles_key *key, bool slow) {
  const struct cache_key plain = profiles_cache_key(key, &profiles_kind);
  return lookup_get(lookups, lookup, &plain, slow ? CACHE_SLOW : CACHE_FAST, false);
}

static void do_nothing(void *context) {
  (void)context;
}

enum { MAX_WAITING = 200 };

/* A cache, and an owner and a worker's end that ask it. */
struct fixture {
  struct server server;
  struct cache_owner own, *owner;
  struct lookups lookups;
};

static void open_cache(struct fixture *f, uint64_t limit_bytes) {
  *f = (struct fixture){.owner = &f->own, .lookups = {.server = &f->server, .wake = do_nothing}};
  f->server.cache = cache_new(core_isa_select(NULL), limit_bytes, 0, MAX_WAITING, &f->server.stats);
  assert_non_null(f->server.cache);
}

static struct lookup new_lookup(struct cache_owner **owner) {
  return (struct lookup){.on_ready = do_nothing, .owner = owner};
}

static uint64_t count(const struct fixture *f, enum stats_index index) {
  return stats_get(&f->server.stats, index);
}

/* Prepares slow entries on this thread, in at most `most` turns. Returns the number of turns. */
static unsigned take_turns(struct cache *cache, unsigned most) {
  unsigned turns = 0;
  struct cache_entry *entry;
  while (turns < most && (entry = cache_begin_turn(cache, CACHE_SLOW)) != NULL) {
    cache_prepare(entry);
    cache_end_turn(entry);
    turns++;
  }
  return turns;
}

/* Makes a lookup wait for a slow profile that is not prepared. */
static void wait_for(struct fixture *f, uint64_t number, struct lookup *lookup) {
  const struct profiles_key key = key_number(number);
  assert_true(look(&f->lookups, lookup, &key, true) == LOOKUP_WAIT);
}

/* Looks an entry up. *was_there: whether it was in the cache. If it was not, prepares it on this
 * thread. */
static void ask(struct fixture *f, struct lookup *lookup, const struct profiles_key *key, bool slow,
                bool *was_there) {
  const uint64_t builds = count(f, STATS_CACHE_BUILDS);
  *lookup = new_lookup(&f->owner);
  enum lookup_state state = look(&f->lookups, lookup, key, slow);
  *was_there = state == LOOKUP_READY && count(f, STATS_CACHE_BUILDS) == builds;
  if (state == LOOKUP_WAIT) {
    assert_true(slow);
    take_turns(f->server.cache, 1);
    lookups_wake(&f->lookups);
    assert_true(lookup->woken);
    state = look(&f->lookups, lookup, key, slow);
  }
  assert_true(state == LOOKUP_READY);
  assert_true(profile_of(lookup)->medium.sigma_a_per_mm == key->medium->sigma_a_per_mm);
}

/* Gets entry number i and releases it. Returns whether it was in the cache. */
static bool visit_as(struct fixture *f, unsigned i, bool slow) {
  const struct profiles_key key = key_number(i);
  struct lookup lookup;
  bool was_there;
  ask(f, &lookup, &key, slow, &was_there);
  lookup_return(&lookup);
  return was_there;
}

static bool visit(struct fixture *f, unsigned i) {
  return visit_as(f, i, true);
}

/* Returns the size of an entry of key_number(). */
static uint64_t entry_bytes(void) {
  struct fixture f;
  open_cache(&f, 1 << 20);
  visit(&f, 0);
  const uint64_t bytes = count(&f, STATS_CACHE_BYTES);
  cache_free(f.server.cache);
  assert_true(bytes > sizeof(core_profile) && bytes < 1 << 20);
  return bytes;
}

/* ---- keys ------------------------------------------------------------------------------------ */

static struct profiles_key key_of(unsigned model, unsigned moments, unsigned evaluator,
                                  core_medium medium, core_parameters parameters) {
  const core_medium layers[] = {medium, {1, 2, 0.5, 1.4}};
  struct profiles_key key;
  memset(&key, 0xa5, sizeof key);
  profiles_key_start(&key, model, moments, evaluator, &parameters);
  profiles_key_set_medium(&key, layers);
  return key;
}

UNIT_TEST(keys_that_mean_the_same_are_equal) {
  const core_parameters none = core_parameters_none();
  core_parameters other = none;
  const struct profiles_key key = key_of(1, 2, 1, (core_medium){0, 1, 0, 1.3}, none);
  struct profiles_key same = key_of(1, 2, 1, (core_medium){-0.0, 1, -0.0, 1.3}, none);
  assert_true(profiles_key_equal(&key, &same));
  for (size_t i = 0; i < CORE_PARAMETERS_END; i++) {
    other.value[i] = -(double)NAN;
  }
  other.value[CORE_PARAMETER_COS_IN] = 0.5; /* Angles are not part of the key. */
  other.value[CORE_PARAMETER_COS_OUT] = 0.25;
  same = key_of(1, 2, 1, (core_medium){0, 1, 0, 1.3}, other);
  assert_true(profiles_key_equal(&key, &same));
}

UNIT_TEST(keys_that_differ_anywhere_are_not) {
  const core_parameters none = core_parameters_none();
  core_parameters two_layers = none;
  enum { KEYS = 10 + CORE_PARAMETERS_END };
  struct profiles_key keys[KEYS];
  size_t n = 0;
  keys[n++] = key_of(1, 1, 1, SKIN, none);
  keys[n++] = key_of(2, 1, 1, SKIN, none);
  keys[n++] = key_of(1, 2, 1, SKIN, none);
  keys[n++] = key_of(1, 1, 2, SKIN, none);
  keys[n++] = key_of(1, 1, 1, (core_medium){nextafter(0.032, 1), 0.74, 0, 1.3}, none);
  keys[n++] = key_of(1, 1, 1, (core_medium){0.032, nextafter(0.74, 1), 0, 1.3}, none);
  keys[n++] = key_of(1, 1, 1, (core_medium){0.032, 0.74, 5e-324, 1.3}, none);
  keys[n++] = key_of(1, 1, 1, (core_medium){0.032, 0.74, 0, nextafter(1.3, 1)}, none);
  keys[n++] = key_of(1, 1, 1, (core_medium){0.032, 0.74, 0, 1.3, 5e-324}, none);
  two_layers.layer_count = 2;
  keys[n++] = key_of(1, 1, 1, SKIN, two_layers);
  for (size_t i = 1; i < CORE_PARAMETERS_END; i++) {
    if (i != CORE_PARAMETER_COS_IN && i != CORE_PARAMETER_COS_OUT) {
      core_parameters given = none;
      given.value[i] = 0;
      keys[n++] = key_of(1, 1, 1, SKIN, given);
    }
  }
  for (size_t i = 0; i < n; i++) {
    for (size_t j = 0; j < n; j++) {
      assert_true(profiles_key_equal(&keys[i], &keys[j]) == (i == j));
    }
  }
}

/* ---- what is kept ---------------------------------------------------------------------------- */

UNIT_TEST(the_least_recently_used_goes_first) {
  struct fixture f;
  open_cache(&f, 3 * entry_bytes());
  assert_false(visit(&f, 0) || visit(&f, 1) || visit(&f, 2));
  assert_true(visit(&f, 0) && visit(&f, 1) && visit(&f, 2) && visit(&f, 0));
  assert_false(visit(&f, 3)); /* evicts 1 */
  assert_true(visit(&f, 2) && visit(&f, 0) && visit(&f, 3));
  assert_false(visit(&f, 1)); /* evicts 2 */
  assert_true(visit(&f, 1) && visit(&f, 3) && visit(&f, 0));
  assert_int_equal(count(&f, STATS_CACHE_EVICTIONS), 2);
  assert_int_equal(count(&f, STATS_CACHE_BUILDS), 5);
  assert_int_equal(count(&f, STATS_CACHE_ENTRIES), 3);
  cache_free(f.server.cache);
}

UNIT_TEST(what_is_slow_goes_before_what_is_fast_and_few) {
  struct fixture f;
  open_cache(&f, 4 * entry_bytes());
  assert_false(visit_as(&f, 0, false) || visit(&f, 1) || visit(&f, 2) || visit(&f, 3));
  assert_false(visit(&f, 4)); /* evicts 1 */
  assert_true(visit_as(&f, 0, false) && visit(&f, 2) && visit(&f, 3) && visit(&f, 4));
  cache_free(f.server.cache);
}

UNIT_TEST(a_use_that_the_cache_did_not_see_counts_once) {
  struct fixture f;
  open_cache(&f, 2 * entry_bytes());
  const struct profiles_key key = key_number(0);
  bool was_there;
  struct lookup lookup;
  ask(&f, &lookup, &key, true, &was_there);
  struct cache_entry *entry = lookup.entry;
  visit(&f, 1);
  cache_used(entry);
  visit(&f, 2); /* evicts 1 and moves 0 to the head */
  assert_true(cache_keeps(entry));
  visit(&f, 3); /* evicts 0, which was not used again */
  assert_int_equal(count(&f, STATS_CACHE_ENTRIES), 2);
  assert_false(cache_keeps(entry));
  lookup_return(&lookup);
  cache_free(f.server.cache);
}

UNIT_TEST(the_bound_holds_to_the_byte) {
  const uint64_t bytes = entry_bytes();
  const struct {
    uint64_t limit_bytes;
    uint64_t kept;
  } cases[] = {{0, 0},
               {1, 0},
               {bytes - 1, 0},
               {bytes, 1},
               {2 * bytes - 1, 1},
               {2 * bytes, 2},
               {5 * bytes - 1, 4},
               {5 * bytes, 5}};
  for (size_t c = 0; c < sizeof cases / sizeof cases[0]; c++) {
    struct fixture f;
    open_cache(&f, cases[c].limit_bytes);
    for (unsigned i = 0; i < 20; i++) {
      assert_false(visit(&f, i));
      assert_true(count(&f, STATS_CACHE_BYTES) <= cases[c].limit_bytes);
    }
    assert_int_equal(count(&f, STATS_CACHE_ENTRIES), cases[c].kept);
    assert_int_equal(count(&f, STATS_CACHE_BYTES), cases[c].kept * bytes);
    assert_int_equal(count(&f, STATS_CACHE_EVICTIONS), cases[c].kept > 0 ? 20 - cases[c].kept : 0);
    cache_free(f.server.cache);
  }
}

UNIT_TEST(a_stream_of_fast_ones_leaves_the_slow_ones) {
  enum { ROOM = 40, SLOW = 3 * ROOM / 4, STREAM = 1000 };
  struct fixture f;
  open_cache(&f, ROOM * entry_bytes());
  for (unsigned i = 0; i < SLOW; i++) {
    visit(&f, i);
  }
  for (unsigned i = 0; i < STREAM; i++) {
    assert_false(visit_as(&f, SLOW + i, false));
  }
  assert_int_equal(count(&f, STATS_CACHE_ENTRIES), ROOM);
  for (unsigned i = 0; i < SLOW; i++) {
    assert_true(visit(&f, i));
  }
  for (unsigned i = STREAM - ROOM / 4; i < STREAM; i++) {
    assert_true(visit_as(&f, SLOW + i, false));
  }
  for (unsigned i = 0; i < ROOM; i++) { /* evicts all fast entries */
    visit(&f, 2000 + i);
  }
  assert_true(count(&f, STATS_CACHE_BYTES) <= ROOM * entry_bytes());
  cache_free(f.server.cache);
}

/* The table starts with fewer buckets than this many entries. */
UNIT_TEST(many_entries_are_all_found) {
  enum { ENTRIES = 1500 };
  struct fixture f;
  open_cache(&f, UINT64_C(1) << 40);
  for (int time = 0; time < 2; time++) {
    for (unsigned i = 0; i < ENTRIES; i++) {
      assert_true(visit(&f, i) == (time == 1));
    }
  }
  assert_int_equal(count(&f, STATS_CACHE_ENTRIES), ENTRIES);
  assert_int_equal(count(&f, STATS_CACHE_BUILDS), ENTRIES);
  cache_free(f.server.cache);
}

/* ---- waiting --------------------------------------------------------------------------------- */

UNIT_TEST(what_nobody_waits_for_is_not_prepared) {
  struct fixture f;
  open_cache(&f, 1 << 20);
  struct lookup lookup = new_lookup(&f.owner);
  wait_for(&f, 0, &lookup);
  lookup_return(&lookup);
  assert_int_equal(take_turns(f.server.cache, 1), 0);
  wait_for(&f, 0, &lookup);
  struct cache_entry *entry = cache_begin_turn(f.server.cache, CACHE_SLOW);
  lookup_return(&lookup); /* It gives up after its turn has begun. */
  cache_prepare(entry);
  cache_end_turn(entry);
  assert_int_equal(count(&f, STATS_CACHE_BUILDS), 0);
  assert_false(visit(&f, 0));
  assert_int_equal(count(&f, STATS_CACHE_BUILDS), 1);
  cache_free(f.server.cache);
}

/* A thing whose only waiter leaves while it is prepared, and another one comes before that stops. */
struct change {
  struct fixture f;
  struct lookup leaves, comes;
  unsigned preparations;
};

static core_fault prepare_changing(void *thing, const struct cache_key *key, const core_isa *isa,
                                   const atomic_bool *stop) {
  struct change *change = key->source;
  (void)thing;
  (void)isa;
  if (change->preparations++ == 0) {
    lookup_return(&change->leaves);
    assert_true(atomic_load(stop));
    assert_true(lookup_get(&change->f.lookups, &change->comes, key, CACHE_SLOW, false) ==
                LOOKUP_WAIT);
    return (core_fault){CORE_FIELD_STOPPED, "", 0};
  }
  assert_false(atomic_load(stop));
  return (core_fault){NULL, NULL, 0};
}

static uint64_t no_bytes(const void *thing) {
  (void)thing;
  return 0;
}

UNIT_TEST(who_comes_while_it_stops_is_answered) {
  static const uint64_t content = 1;
  static const struct cache_kind kind = {.prepare = prepare_changing,
                                         .free = do_nothing,
                                         .bytes = no_bytes,
                                         .hold = do_nothing,
                                         .release = do_nothing};
  struct change change;
  const struct cache_key key = {&kind, &content, sizeof content, 1, &change};
  open_cache(&change.f, 1 << 20);
  change.preparations = 0;
  change.leaves = change.comes = new_lookup(&change.f.owner);
  assert_true(lookup_get(&change.f.lookups, &change.leaves, &key, CACHE_SLOW, false) ==
              LOOKUP_WAIT);
  assert_int_equal(take_turns(change.f.server.cache, 1), 1);
  lookups_wake(&change.f.lookups);
  assert_true(change.comes.woken && change.preparations == 2);
  lookup_return(&change.comes);
  cache_free(change.f.server.cache);
}

/* ---- turns ----------------------------------------------------------------------------------- */

/* Three owners have 6, 3 and 1 waiters, and take turns. */
UNIT_TEST(owners_take_turns) {
  enum { MANY = 10 };
  struct fixture f;
  open_cache(&f, 1 << 20);
  struct cache_owner others[2] = {0}, *second = &others[0], *third = &others[1];
  struct lookup waiters[MANY] = {new_lookup(&f.owner)};
  static const uint64_t turns[MANY] = {0, 3, 5, 7, 8, 9, 1, 4, 6, 2};
  for (size_t i = 0; i < MANY; i++) {
    waiters[i] = new_lookup(i < 6 ? &f.owner : i < 9 ? &second : &third);
    wait_for(&f, i, &waiters[i]);
  }
  for (uint64_t turn = 0; turn < MANY; turn++) {
    for (size_t i = 0; i < MANY; i++) {
      assert_int_equal(waiters[i].queued_for != NULL, turns[i] >= turn);
    }
    assert_int_equal(take_turns(f.server.cache, 1), 1);
  }
  for (size_t i = 0; i < MANY; i++) {
    lookup_return(&waiters[i]);
  }
  cache_free(f.server.cache);
}

UNIT_TEST(at_most_two_turns_at_a_time) {
  struct fixture f;
  open_cache(&f, 1 << 20);
  struct lookup waiters[3];
  struct cache_entry *entries[3] = {NULL};
  for (size_t i = 0; i < 3; i++) {
    waiters[i] = new_lookup(&f.owner);
    wait_for(&f, i, &waiters[i]);
  }
  const unsigned most = uv_available_parallelism() < 4 ? 1 : 2;
  unsigned begun = 0;
  while (begun < 3 && (entries[begun] = cache_begin_turn(f.server.cache, CACHE_SLOW)) != NULL) {
    begun++;
  }
  assert_int_equal(begun, most);
  for (unsigned i = 0; i < begun; i++) {
    cache_prepare(entries[i]);
    cache_end_turn(entries[i]);
  }
  assert_int_equal(take_turns(f.server.cache, 3), 3 - most);
  for (size_t i = 0; i < 3; i++) {
    lookup_return(&waiters[i]);
  }
  cache_free(f.server.cache);
}

static enum lookup_state look_at_pace(struct fixture *f, struct lookup *lookup, unsigned number,
                                      enum cache_pace pace) {
  const struct profiles_key key = key_number(number);
  const struct cache_key plain = profiles_cache_key(&key, &profiles_kind);
  return lookup_get(&f->lookups, lookup, &plain, pace, false);
}

/* While as much is solved for an owner as may be at a time, and more waits, what takes milliseconds is
 * prepared, even for the same owner, and another owner's medium is solved. */
UNIT_TEST(solutions_hold_up_nothing_else) {
  enum { MANY = 4 };
  struct fixture f;
  open_cache(&f, 1 << 20);
  struct cache_owner own = {0}, *other = &own;
  struct lookup solved[MANY], table = new_lookup(&f.owner), short_one = new_lookup(&other);
  struct cache_entry *begun[MANY];
  unsigned most = 0;
  for (unsigned i = 0; i < MANY; i++) {
    solved[i] = new_lookup(&f.owner);
    assert_true(look_at_pace(&f, &solved[i], i, CACHE_SOLVED) == LOOKUP_WAIT);
  }
  while ((begun[most] = cache_begin_turn(f.server.cache, CACHE_SOLVED)) != NULL) {
    most++;
  }
  assert_in_range(most, 1, MANY - 1);
  assert_true(look_at_pace(&f, &table, MANY, CACHE_SLOW) == LOOKUP_WAIT);
  assert_int_equal(take_turns(f.server.cache, MANY), 1);
  lookups_wake(&f.lookups);
  assert_true(look_at_pace(&f, &table, MANY, CACHE_SLOW) == LOOKUP_READY);
  assert_true(look_at_pace(&f, &short_one, MANY + 1, CACHE_SOLVED) == LOOKUP_WAIT);
  struct cache_entry *others = cache_begin_turn(f.server.cache, CACHE_SOLVED);
  cache_prepare(others);
  cache_end_turn(others);
  lookups_wake(&f.lookups);
  assert_true(look_at_pace(&f, &short_one, MANY + 1, CACHE_SOLVED) == LOOKUP_READY);
  for (unsigned i = 0; i < most; i++) {
    assert_null(cache_begin_turn(f.server.cache, CACHE_SOLVED));
    cache_prepare(begun[i]);
    cache_end_turn(begun[i]);
    lookups_wake(&f.lookups);
    assert_true(look_at_pace(&f, &solved[i], i, CACHE_SOLVED) == LOOKUP_READY);
    begun[i] = cache_begin_turn(f.server.cache, CACHE_SOLVED);
    assert_non_null(begun[i]);
  }
  for (unsigned i = 0; i < most; i++) {
    cache_prepare(begun[i]);
    cache_end_turn(begun[i]);
  }
  lookup_return(&table);
  lookup_return(&short_one);
  for (unsigned i = 0; i < MANY; i++) {
    lookup_return(&solved[i]);
  }
  cache_free(f.server.cache);
}

/* ---- threads --------------------------------------------------------------------------------- */

enum { THREADS = 4, ROUNDS = 3000, KEYS = 40 };

struct thread {
  uv_thread_t id;
  struct fixture *f;
  uv_sem_t woken;
  struct cache_owner own, *owner;
  struct lookups lookups;
  uint64_t seed;
  uint64_t found;
  uint64_t wrong; /* how often another profile came than was asked for */
};

static void on_woken(void *context) {
  struct thread *thread = context;
  uv_sem_post(&thread->woken);
}

/* Asks for a random profile. If it is new, prepares it on this thread, as workers and the cache's
 * threads do. If another thread prepares it, waits for it or gives up. */
static void ask_at_random(struct thread *thread) {
  const unsigned i = (unsigned)unit_random_below(&thread->seed, KEYS);
  const bool slow = i % 2 == 0;
  const struct profiles_key key = key_number(i);
  struct lookup lookup = new_lookup(&thread->owner);
  const bool waits = look(&thread->lookups, &lookup, &key, slow) == LOOKUP_WAIT;
  if (waits && unit_random_below(&thread->seed, 8) == 0) {
    lookup_return(&lookup);
  }
  if (waits) {
    take_turns(thread->f->server.cache, UINT_MAX);
  }
  if (lookup.awaited != NULL) {
    while (lookups_wake(&thread->lookups), !lookup.woken) {
      uv_sem_wait(&thread->woken);
    }
    assert_true(look(&thread->lookups, &lookup, &key, slow) == LOOKUP_READY);
  }
  if (lookup.entry != NULL) {
    cache_used(lookup.entry);
    thread->wrong += profile_of(&lookup)->medium.sigma_a_per_mm != key.medium->sigma_a_per_mm;
    thread->found += slow && !waits; /* what is fast may have been prepared just now */
  }
  lookup_return(&lookup);
}

static void thread_main(void *argument) {
  struct thread *thread = argument;
  for (int round = 0; round < ROUNDS; round++) {
    ask_at_random(thread);
  }
}

/* Under the thread sanitizer, this test finds data without a guard. Under the address sanitizer, it
 * finds memory that is freed too early or never. */
UNIT_TEST(threads_share_it) {
  const uint64_t seed = unit_seed();
  const uint64_t limits[] = {0, KEYS / 3 * entry_bytes(), 1 << 24};
  for (size_t l = 0; l < sizeof limits / sizeof limits[0]; l++) {
    struct fixture f;
    open_cache(&f, limits[l]);
    struct thread threads[THREADS];
    for (size_t t = 0; t < THREADS; t++) {
      threads[t] = (struct thread){
          .f = &f,
          .owner = &threads[t].own,
          .lookups = {.server = &f.server, .wake = on_woken, .context = &threads[t]},
          .seed = seed + t};
      assert_int_equal(uv_sem_init(&threads[t].woken, 0), 0);
    }
    for (size_t t = 0; t < THREADS; t++) {
      assert_int_equal(uv_thread_create(&threads[t].id, thread_main, &threads[t]), 0);
    }
    uint64_t found = 0;
    for (size_t t = 0; t < THREADS; t++) {
      uv_thread_join(&threads[t].id);
      uv_sem_destroy(&threads[t].woken);
      found += threads[t].found;
      assert_int_equal(threads[t].wrong, 0);
    }
    assert_true(count(&f, STATS_CACHE_BYTES) <= limits[l]);
    if (l == 0) {
      assert_int_equal(found, 0);
    } else if (l == 2) {
      assert_int_equal(count(&f, STATS_CACHE_BUILDS), KEYS);
      assert_true(found > THREADS * ROUNDS / 4);
    }
    cache_free(f.server.cache);
  }
}
