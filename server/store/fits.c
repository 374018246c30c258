#include "server/store/fits.h"

#include "proto/fit.h"

static core_fault prepare(void *thing, const struct cache_key *key, const core_isa *isa,
                          const atomic_bool *stop) {
  fit_design read;
  (void)stop;
  fit_design_read(key->content, &read);
  return core_fit_create(thing, isa, &read.design);
}

static void free_fit(void *thing) {
  core_fit_free(*(core_fit **)thing);
}

static uint64_t bytes_of(const void *thing) {
  return core_fit_bytes(*(core_fit *const *)thing);
}

static const struct cache_kind kind = {
    .thing_bytes = sizeof(core_fit *), .prepare = prepare, .free = free_fit, .bytes = bytes_of};

enum lookup_answer fits_get(struct lookups *lookups, struct lookup *lookup, const uint8_t *design,
                            size_t design_bytes) {
  const struct cache_key key = {.kind = &kind,
                                .content = design,
                                .content_bytes = design_bytes,
                                .hash = cache_hash(0, design, design_bytes)};
  return lookup_get(lookups, lookup, &key, true, true);
}
