#include "server/store/varyings.h"

#include "server/store/profiles.h"

/* The key is that of a profile, whose medium has 0 in place of sigma_a and sigma_s. */
static core_fault prepare(void *thing, const struct cache_key *key, const core_isa *isa,
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

static uint64_t bytes_of(const void *thing) {
  return core_varying_bytes(thing);
}

static const struct cache_kind kind = {.thing_bytes = sizeof(core_varying),
                                       .prepare = prepare,
                                       .free = free_varying,
                                       .bytes = bytes_of};

enum lookup_state varyings_get(struct lookups *lookups, struct lookup *lookup, unsigned model,
                               unsigned moments, unsigned evaluator,
                               const core_parameters *parameters, double g, double eta) {
  struct profiles_key from;
  profiles_key_start(&from, model, moments, evaluator, parameters);
  profiles_key_set_medium(&from, &(core_medium){0, 0, g, eta});
  const struct cache_key key = profiles_cache_key(&from, &kind);
  return lookup_get(
      lookups, lookup, &key,
      core_prepares_slowly(model, evaluator, NULL, parameters) ? CACHE_SLOW : CACHE_FAST, true);
}
