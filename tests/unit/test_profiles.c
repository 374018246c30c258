/* A worker's profiles, without a daemon: what comes near the cache, what is at hand, and for how
 * long. */
#include "server/store/profiles.h"
#include "tests/unit/unit.h"

static const core_medium SKIN = {0.032, 0.74, 0, 1.3};

static void not_woken(void *context) {
  (void)context;
}

struct desk {
  struct server server;
  uv_loop_t loop;
  struct profiles profiles;
};

static void open_desk(struct desk *desk, uint64_t cache_bytes) {
  memset(desk, 0, sizeof *desk);
  desk->server.isa = core_isa_select(NULL);
  desk->server.options.cache_bytes = cache_bytes;
  desk->server.cache = cache_new(desk->server.isa, cache_bytes, &desk->server.stats);
  assert_non_null(desk->server.cache);
  assert_int_equal(uv_loop_init(&desk->loop), 0);
  profiles_init(&desk->profiles, &desk->server, &desk->loop, not_woken, NULL);
}

static void close_desk(struct desk *desk) {
  uv_run(&desk->loop, UV_RUN_DEFAULT);
  profiles_end(&desk->profiles);
  assert_int_equal(uv_loop_close(&desk->loop), 0);
  cache_free(desk->server.cache);
}

static uint64_t desk_count(const struct desk *desk, enum stats_index index) {
  return stats_get(&desk->server.stats, index);
}

static void set_woken(void *context) {
  *(bool *)context = true;
}

/* Gets a profile, waiting for it if need be, and its albedo. */
static double get_albedo(struct desk *desk, unsigned model, core_medium medium,
                         const core_parameters *parameters, double *cos_in) {
  bool woken = false;
  struct profiles_order order = {.on_ready = set_woken, .context = &woken};
  profiles_start(&order, model, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, parameters);
  enum profiles_answer answer = profiles_get(&desk->profiles, &order, &medium);
  if (answer == PROFILES_WAIT) {
    uv_run(&desk->loop, UV_RUN_DEFAULT);
    profiles_wake(&desk->profiles);
    assert_true(woken);
    answer = profiles_get(&desk->profiles, &order, &medium);
  }
  assert_int_equal(answer, PROFILES_READY);
  const double albedo = order.profile.albedo;
  *cos_in = order.profile.cos_in;
  profiles_return(&order);
  return albedo;
}

UNIT_TEST(little_ones_never_come_near_the_cache) {
  const core_parameters none = core_parameters_none();
  static struct desk desk;
  open_desk(&desk, 1 << 20);
  double cos_in;
  get_albedo(&desk, CORE_MODEL_SINGLE, SKIN, &none, &cos_in);
  for (unsigned i = 0; i < 10000; i++) {
    get_albedo(&desk, CORE_MODEL_BETTER, (core_medium){1e-4 * i, 1, 0, 1.3}, &none, &cos_in);
  }
  assert_int_equal(desk_count(&desk, STATS_CACHE_ENTRIES), 1);
  assert_int_equal(desk_count(&desk, STATS_CACHE_MISSES), 10001);
  const double albedo = get_albedo(&desk, CORE_MODEL_BETTER, SKIN, &none, &cos_in);
  assert_true(get_albedo(&desk, CORE_MODEL_BETTER, SKIN, &none, &cos_in) == albedo);
  get_albedo(&desk, CORE_MODEL_SINGLE, SKIN, &none, &cos_in);
  assert_int_equal(desk_count(&desk, STATS_CACHE_HITS), 2);
  assert_int_equal(desk_count(&desk, STATS_CACHE_BUILDS), 10002);
  close_desk(&desk);
}

UNIT_TEST(nothing_is_kept_without_bytes) {
  const core_parameters none = core_parameters_none();
  static const unsigned models[] = {CORE_MODEL_BETTER, CORE_MODEL_SINGLE, CORE_MODEL_BEAM};
  static struct desk desk;
  open_desk(&desk, 0);
  double cos_in;
  for (size_t m = 0; m < sizeof models / sizeof models[0]; m++) {
    const double albedo = get_albedo(&desk, models[m], SKIN, &none, &cos_in);
    assert_true(get_albedo(&desk, models[m], SKIN, &none, &cos_in) == albedo);
  }
  assert_int_equal(desk_count(&desk, STATS_CACHE_HITS), 0);
  assert_int_equal(desk_count(&desk, STATS_CACHE_BUILDS), 6);
  assert_int_equal(desk_count(&desk, STATS_CACHE_ENTRIES), 0);
  assert_int_equal(desk_count(&desk, STATS_CACHE_EVICTIONS), 0);
  close_desk(&desk);
}

UNIT_TEST(one_preparation_serves_all_angles) {
  static const unsigned models[] = {CORE_MODEL_BETTER, CORE_MODEL_SINGLE, CORE_MODEL_BEAM};
  static struct desk desk;
  open_desk(&desk, 1 << 20);
  for (size_t m = 0; m < sizeof models / sizeof models[0]; m++) {
    for (unsigned i = 0; i < 5; i++) {
      core_parameters parameters = core_parameters_none();
      parameters.value[CORE_PARAMETER_COS_IN] = 0.2 * i;
      double cos_in;
      get_albedo(&desk, models[m], SKIN, &parameters, &cos_in);
      assert_true(cos_in == 0.2 * i);
      parameters = core_parameters_none();
      get_albedo(&desk, models[m], SKIN, &parameters, &cos_in);
      assert_true(cos_in == 1);
    }
  }
  assert_int_equal(desk_count(&desk, STATS_CACHE_BUILDS), 3);
  close_desk(&desk);
}

/* What is at hand of a worker and has been evicted is freed at its next look at the time. */
UNIT_TEST(what_has_been_evicted_is_not_held) {
  const core_parameters none = core_parameters_none();
  static struct desk desk;
  open_desk(&desk, 4 * 20000); /* a quarter of it: one of these, and no second */
  const core_medium other = {0.1, 1, 0, 1.3};
  struct cache_key key;
  cache_key_start(&key, CORE_MODEL_SINGLE, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &none);
  cache_key_set_medium(&key, &other);
  double cos_in;
  get_albedo(&desk, CORE_MODEL_SINGLE, other, &none, &cos_in);
  struct cache_queue queue = {.wake = not_woken};
  struct cache_waiter waiter = {0};
  struct cache_entry *entry = NULL;
  assert_true(cache_look(desk.server.cache, &key, false, &queue, &waiter, &entry) == CACHE_KEPT);
  get_albedo(&desk, CORE_MODEL_SINGLE, SKIN, &none, &cos_in);
  assert_false(cache_keeps(entry));
  cache_release(entry);
  profiles_sweep(&desk.profiles);
  size_t held = 0;
  for (size_t i = 0; i < PROFILES_SETS * PROFILES_WAYS; i++) {
    held += desk.profiles.sets[i / PROFILES_WAYS].slots[i % PROFILES_WAYS].entry != NULL;
  }
  assert_int_equal(held, 1);
  close_desk(&desk);
}

/* The list says which models are worth keeping: all that are slow, and of the others those that own
 * a table that is worth the name. */
UNIT_TEST(the_list_knows_what_is_worth_keeping) {
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    if (core_prepares_slowly(model->id, CORE_EVALUATOR_F64)) {
      assert_true(core_worth_keeping(model->id, CORE_EVALUATOR_F64));
      continue;
    }
    const core_parameters parameters = unit_parameters(model->id, &SKIN);
    core_profile profile;
    unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), model->id,
                                           CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &SKIN,
                                           &parameters),
                      NULL, 0);
    assert_true(core_worth_keeping(model->id, CORE_EVALUATOR_F64) ==
                (core_profile_bytes(&profile) > 1024));
    core_profile_free(&profile);
  }
  assert_false(core_worth_keeping(0, CORE_EVALUATOR_LUT));
}
