/* cache_key: what a prepared profile is made from, and so the name that it is found by. */
#ifndef DIPOLED_CACHE_KEY_H
#define DIPOLED_CACHE_KEY_H

#include "core/core.h"

/* Two profiles are the same when their keys are, byte for byte: there is no padding, and numbers
 * that mean the same have the same bits (0 has no sign, all that is not given is one NaN). The
 * angles of S are none of it: they are set in a copy of the profile. */
struct cache_key {
  uint32_t model;
  uint32_t moments;
  uint32_t evaluator;
  uint32_t zero;
  double parameters[CORE_PARAMETERS_END];
  double medium[4]; /* sigma_a, sigma_s, g, eta */
  uint64_t hash_before_medium;
  uint64_t hash;
};

/* What the channels of a request share; then, for each, the medium. */
void cache_key_start(struct cache_key *key, unsigned model, unsigned moments, unsigned evaluator,
                     const core_parameters *parameters);
void cache_key_set_medium(struct cache_key *key, const core_medium *medium);

bool cache_key_equal(const struct cache_key *a, const struct cache_key *b);

/* core_profile_prepare() from what the key holds, and from nothing else: so whoever asks first, all
 * get the same bits. */
core_fault cache_key_prepare(const struct cache_key *key, const core_isa *isa,
                             core_profile *profile);

#endif
