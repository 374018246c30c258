/* A worker's local store of profiles, without a daemon: which profiles it keeps for how long, and
 * which ones it puts into the cache. */
#include "server/store/profiles.h"
#include "tests/unit/unit.h"

static const core_medium SKIN = {0.032, 0.74, 0, 1.3};

static void not_woken(void *context) {
  (void)context;
}

struct fixture {
  struct server server;
  struct profiles profiles;
};

static void open_fixture(struct fixture *f, uint64_t cache_bytes) {
  memset(f, 0, sizeof *f);
  f->server.isa = core_isa_select(NULL);
  f->server.options.cache_bytes = cache_bytes;
  f->server.cache = cache_new(f->server.isa, cache_bytes, 0, 1, &f->server.stats);
  assert_non_null(f->server.cache);
  profiles_init(&f->profiles, &f->server, not_woken, NULL);
}

static void close_fixture(struct fixture *f) {
  profiles_end(&f->profiles);
  cache_free(f->server.cache);
}

static uint64_t count_of(const struct fixture *f, enum stats_index index) {
  return stats_get(&f->server.stats, index);
}

static void set_woken(void *context) {
  *(bool *)context = true;
}

/* Gets a profile, waits for it if necessary, and returns its albedo. */
static double get_albedo(struct fixture *f, unsigned model, core_medium medium,
                         const core_parameters *parameters, double *cos_in) {
  bool woken = false;
  struct cache_owner own = {0}, *owner = &own;
  struct profiles_lookup lookup = {
      .cached = {.on_ready = set_woken, .context = &woken, .owner = &owner}};
  profiles_start(&lookup, model, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, parameters);
  enum lookup_state state = profiles_get(&f->profiles, &lookup, &medium);
  if (state == LOOKUP_WAIT) {
    struct cache_entry *entry = cache_begin_turn(f->server.cache, CACHE_SLOW);
    cache_prepare(entry);
    cache_end_turn(entry);
    lookups_wake(&f->profiles.lookups);
    assert_true(woken);
    state = profiles_get(&f->profiles, &lookup, &medium);
  }
  assert_int_equal(state, LOOKUP_READY);
  const double albedo = lookup.profile.albedo;
  *cos_in = lookup.profile.cos_in;
  profiles_return(&lookup);
  return albedo;
}

UNIT_TEST(little_ones_never_come_near_the_cache) {
  const core_parameters none = core_parameters_none();
  static struct fixture f;
  open_fixture(&f, 1 << 20);
  double cos_in;
  get_albedo(&f, CORE_MODEL_SINGLE, SKIN, &none, &cos_in);
  for (unsigned i = 0; i < 10000; i++) {
    get_albedo(&f, CORE_MODEL_BETTER, (core_medium){1e-4 * i, 1, 0, 1.3}, &none, &cos_in);
  }
  assert_int_equal(count_of(&f, STATS_CACHE_ENTRIES), 1);
  assert_int_equal(count_of(&f, STATS_CACHE_MISSES), 10001);
  const double albedo = get_albedo(&f, CORE_MODEL_BETTER, SKIN, &none, &cos_in);
  assert_true(get_albedo(&f, CORE_MODEL_BETTER, SKIN, &none, &cos_in) == albedo);
  get_albedo(&f, CORE_MODEL_SINGLE, SKIN, &none, &cos_in);
  assert_int_equal(count_of(&f, STATS_CACHE_HITS), 2);
  assert_int_equal(count_of(&f, STATS_CACHE_BUILDS), 10002);
  close_fixture(&f);
}

UNIT_TEST(nothing_is_kept_without_bytes) {
  const core_parameters none = core_parameters_none();
  static const unsigned models[] = {CORE_MODEL_BETTER, CORE_MODEL_SINGLE, CORE_MODEL_BEAM};
  static struct fixture f;
  open_fixture(&f, 0);
  double cos_in;
  for (size_t m = 0; m < sizeof models / sizeof models[0]; m++) {
    const double albedo = get_albedo(&f, models[m], SKIN, &none, &cos_in);
    assert_true(get_albedo(&f, models[m], SKIN, &none, &cos_in) == albedo);
  }
  assert_int_equal(count_of(&f, STATS_CACHE_HITS), 0);
  assert_int_equal(count_of(&f, STATS_CACHE_BUILDS), 6);
  assert_int_equal(count_of(&f, STATS_CACHE_ENTRIES), 0);
  assert_int_equal(count_of(&f, STATS_CACHE_EVICTIONS), 0);
  close_fixture(&f);
}

UNIT_TEST(one_preparation_serves_all_angles) {
  static const unsigned models[] = {CORE_MODEL_BETTER, CORE_MODEL_SINGLE, CORE_MODEL_BEAM};
  static struct fixture f;
  open_fixture(&f, 1 << 20);
  for (size_t m = 0; m < sizeof models / sizeof models[0]; m++) {
    for (unsigned i = 0; i < 5; i++) {
      core_parameters parameters = core_parameters_none();
      parameters.value[CORE_PARAMETER_COS_IN] = 0.2 * i;
      double cos_in;
      get_albedo(&f, models[m], SKIN, &parameters, &cos_in);
      assert_true(cos_in == 0.2 * i);
      parameters = core_parameters_none();
      get_albedo(&f, models[m], SKIN, &parameters, &cos_in);
      assert_true(cos_in == 1);
    }
  }
  assert_int_equal(count_of(&f, STATS_CACHE_BUILDS), 3);
  close_fixture(&f);
}

/* profiles_sweep() releases the entries that the cache has evicted. */
UNIT_TEST(what_has_been_evicted_is_not_held) {
  const core_parameters none = core_parameters_none();
  static struct fixture f;
  open_fixture(&f, 4 * 20000); /* A quarter of it holds one fast profile, but not two. */
  const core_medium other = {0.1, 1, 0, 1.3};
  struct profiles_key key;
  profiles_key_start(&key, CORE_MODEL_SINGLE, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &none);
  profiles_key_set_medium(&key, &other);
  const struct cache_key plain = profiles_cache_key(&key, &profiles_kind);
  double cos_in;
  get_albedo(&f, CORE_MODEL_SINGLE, other, &none, &cos_in);
  struct cache_owner own = {0}, *owner = &own;
  struct lookup lookup = {.owner = &owner};
  const uint64_t builds = stats_get(&f.server.stats, STATS_CACHE_BUILDS);
  assert_true(lookup_get(&f.profiles.lookups, &lookup, &plain, false, false) == LOOKUP_READY);
  assert_true(stats_get(&f.server.stats, STATS_CACHE_BUILDS) == builds);
  get_albedo(&f, CORE_MODEL_SINGLE, SKIN, &none, &cos_in);
  assert_false(cache_keeps(lookup.entry));
  lookup_return(&lookup);
  profiles_sweep(&f.profiles);
  size_t held = 0;
  for (size_t i = 0; i < PROFILES_SETS * PROFILES_WAYS; i++) {
    held += f.profiles.sets[i / PROFILES_WAYS].slots[i % PROFILES_WAYS].entry != NULL;
  }
  assert_int_equal(held, 1);
  close_fixture(&f);
}

/* The list of models says which profiles the cache keeps: the slow ones, and of the fast ones those
 * that own a large table. */
UNIT_TEST(the_list_knows_what_is_worth_keeping) {
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    if (core_prepares_slowly(model->id, CORE_EVALUATOR_F64, NULL, NULL)) {
      assert_true(core_worth_keeping(model->id, CORE_EVALUATOR_F64, NULL));
      continue;
    }
    const core_medium medium = unit_medium(model->id, &SKIN);
    core_profile profile = unit_profile(model->id, CORE_EVALUATOR_F64, &medium, NULL);
    assert_true(core_worth_keeping(model->id, CORE_EVALUATOR_F64, NULL) ==
                (core_profile_bytes(&profile) > 1024));
    core_profile_free(&profile);
  }
  assert_false(core_worth_keeping(0, CORE_EVALUATOR_LUT, NULL));
}
