#include "server/store/cache_key.h"

#include <assert.h>
#include <math.h>
#include <string.h>

static_assert(sizeof(struct cache_key) == 16 + 8 * CORE_PARAMETERS_END + 32 + 16, "no padding");

static double normalized(double value) {
  if (isnan(value)) {
    return (double)NAN;
  }
  return value == 0 ? 0.0 : value;
}

/* One word more: a multiplication by 2^64 over the golden ratio (Knuth 1998, section 6.4), and its
 * high bits, which depend on all of the word, folded onto the low ones. */
static uint64_t mix(uint64_t hash, double word) {
  uint64_t bits;
  memcpy(&bits, &word, sizeof bits);
  hash = (hash ^ bits) * UINT64_C(0x9e3779b97f4a7c15);
  return hash ^ (hash >> 32);
}

void cache_key_start(struct cache_key *key, unsigned model, unsigned moments, unsigned evaluator,
                     const core_parameters *parameters) {
  *key = (struct cache_key){.model = model, .moments = moments, .evaluator = evaluator};
  key->hash_before_medium = model + ((uint64_t)moments << 16) + ((uint64_t)evaluator << 32);
  for (size_t i = 0; i < CORE_PARAMETERS_END; i++) {
    const bool angle = i == CORE_PARAMETER_COS_IN || i == CORE_PARAMETER_COS_OUT;
    key->parameters[i] = angle ? (double)NAN : normalized(parameters->value[i]);
    key->hash_before_medium = mix(key->hash_before_medium, key->parameters[i]);
  }
}

void cache_key_set_medium(struct cache_key *key, const core_medium *medium) {
  key->medium[0] = normalized(medium->sigma_a_per_mm);
  key->medium[1] = normalized(medium->sigma_s_per_mm);
  key->medium[2] = normalized(medium->g);
  key->medium[3] = normalized(medium->eta);
  key->hash = key->hash_before_medium;
  for (size_t i = 0; i < 4; i++) {
    key->hash = mix(key->hash, key->medium[i]);
  }
}

bool cache_key_equal(const struct cache_key *a, const struct cache_key *b) {
  return a->hash == b->hash && memcmp(a, b, sizeof *a) == 0;
}

core_fault cache_key_prepare(const struct cache_key *key, const core_isa *isa,
                             core_profile *profile) {
  const core_medium medium = {key->medium[0], key->medium[1], key->medium[2], key->medium[3]};
  core_parameters parameters;
  memcpy(parameters.value, key->parameters, sizeof parameters.value);
  return core_profile_prepare(profile, isa, key->model, key->moments, key->evaluator, &medium,
                              &parameters);
}
