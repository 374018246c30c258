/* batch: photons that are being walked, and their tally. Internal to core/montecarlo. */
#ifndef DIPOLED_CORE_MONTECARLO_BATCH_H
#define DIPOLED_CORE_MONTECARLO_BATCH_H

#include "core/montecarlo/plan.h"

struct core_mc_batch {
  const core_mc_plan *plan;
  uint64_t index;
  uint32_t launched; /* number of photons launched so far */
  size_t active;     /* number of lanes in use, which are the first ones */
  walk_lanes lanes;
  walk_launch launch; /* the next WALK_LANES photons, each at its first collision */
  uint64_t *photons;  /* number of photons that left: [side][slot] */
  /* [mc_rows()][albedos]: weights summed over the photons, each of which collides at least once */
  double *tally;
};

#endif
