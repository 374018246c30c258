/* batch: photons being walked, and their tally. Internal to core/montecarlo. */
#ifndef DIPOLED_CORE_MONTECARLO_BATCH_H
#define DIPOLED_CORE_MONTECARLO_BATCH_H

#include "core/montecarlo/plan.h"

struct core_mc_batch {
  const core_mc_plan *plan;
  uint64_t index;
  uint32_t launched; /* photons so far */
  size_t active;     /* lanes in use, the first ones */
  walk_lanes lanes;
  walk_launch launch; /* the next photons at their first collision */
  uint64_t *photons;  /* that left: [side][slot] */
  double *tally;      /* [mc_rows()][albedos], for photons that collide once at least */
};

#endif
