/* fits: prepared fits (core/fit/fit.h) in the cache, found by their designs. */
#ifndef DIPOLED_FITS_H
#define DIPOLED_FITS_H

#include "core/fit/fit.h"
#include "server/store/lookup.h"

/* Looks the fit of a design up: the bytes of fit_design_read(), a multiple of 8. */
enum lookup_answer fits_get(struct lookups *lookups, struct lookup *lookup, const uint8_t *design,
                            size_t design_bytes);

/* Returns the fit that fits_get() has found, until lookup_return(); NULL if there is none. */
static inline const core_fit *fits_found(const struct lookup *lookup) {
  core_fit *const *found = lookup_thing(lookup);
  return found != NULL ? *found : NULL;
}

#endif
