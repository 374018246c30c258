/* The progress of `dipole mc`. */
#include <math.h>

#include "clients/cli/mc.h"

void cli_mc_progress(cli_progress *progress, const dipole_mc_progress *now) {
  if (now->worst_to_mm > 0 && isfinite(now->error_rings)) {
    snprintf(progress->note, sizeof progress->note, "worst ring %.3g to %.3g mm%s: %.2g %%",
             now->worst_from_mm, now->worst_to_mm,
             now->worst_side == DIPOLE_MC_TRANSMITTED ? " (transmitted)" : "",
             100 * now->error_rings);
  }
  cli_progress_show(progress,
                    now->photons_expected > 0 ? (double)now->photons / (double)now->photons_expected
                                              : (double)NAN,
                    (double)now->photons);
}
