/* varyings: what media that vary share (core/varying.h) in the cache. */
#ifndef DIPOLED_VARYINGS_H
#define DIPOLED_VARYINGS_H

#include "core/varying.h"
#include "server/store/cache.h"

/* Looks up what all media of one g and eta share. core_profile_check() must have accepted the
 * arguments. */
enum lookup_state varyings_get(struct lookups *lookups, struct lookup *lookup, unsigned model,
                               unsigned moments, unsigned evaluator,
                               const core_parameters *parameters, double g, double eta);

/* Returns what varyings_get() has found, until lookup_return(); NULL if there is nothing. */
static inline const core_varying *varyings_found(const struct lookup *lookup) {
  return lookup_thing(lookup);
}

#endif
