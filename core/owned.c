/* Counts and frees the memory that a profile owns. This file is separate from profile.c, so that a
 * program that only evaluates tables need not link the code that prepares profiles. */
#include <stdlib.h>

#include "core/paths.h"

size_t core_profile_bytes(const core_profile *profile) {
  size_t bytes = profile->table_bytes + profile->lut_count * sizeof *profile->lut;
  const core_profile *const owned[] = {profile->source, profile->paths};
  for (int i = 0; i < 2; i++) {
    bytes += owned[i] != NULL ? sizeof *owned[i] + core_profile_bytes(owned[i]) : 0;
  }
  for (int i = 0; i < 2 && profile->parts != NULL; i++) {
    bytes += sizeof profile->parts[i] + core_profile_bytes(&profile->parts[i]);
  }
  const core_modulation *modulation = profile->modulation;
  for (unsigned i = 0; modulation != NULL && i < modulation->nodes.count; i++) {
    bytes += core_profile_bytes(&modulation->node[i]);
  }
  return bytes + (modulation != NULL ? sizeof *modulation : 0);
}

void core_profile_free(core_profile *profile) {
  free(profile->table);
  profile->table = NULL;
  free(profile->lut);
  profile->lut = NULL;
  core_profile **const owned[] = {&profile->source, &profile->paths};
  for (int i = 0; i < 2; i++) {
    if (*owned[i] != NULL) {
      core_profile_free(*owned[i]);
      free(*owned[i]);
      *owned[i] = NULL;
    }
  }
  if (profile->parts != NULL) {
    core_profile_free(&profile->parts[0]);
    core_profile_free(&profile->parts[1]);
    free(profile->parts);
    profile->parts = NULL;
  }
  if (profile->modulation != NULL) {
    for (unsigned i = 0; i < profile->modulation->nodes.count; i++) {
      core_profile_free(&profile->modulation->node[i]);
    }
    free(profile->modulation);
    profile->modulation = NULL;
  }
}
