/* The progress of `dipole mc`. */
#include <math.h>

#include "clients/cli/mc.h"

enum { BAR_WIDTH = 20 };

static void write_worst(const dipole_mc_progress *now) {
  if (now->worst_to_mm > 0 && isfinite(now->error_rings)) {
    fprintf(stderr, "  worst ring %.3g to %.3g mm%s: %.2g %%", now->worst_from_mm, now->worst_to_mm,
            now->worst_side == DIPOLE_MC_TRANSMITTED ? " (transmitted)" : "",
            100 * now->error_rings);
  }
}

void cli_mc_progress(cli_progress *progress, const dipole_mc_progress *now) {
  static const char full[] = "####################";
  if (!progress->watched || now->photons_expected == 0) {
    return;
  }
  const double share = fmin((double)now->photons / (double)now->photons_expected, 1);
  const double seconds = (double)(cli_now_ms() - progress->start_ms) / 1000;
  progress->shown = true;
  fprintf(stderr, "\r[%-*.*s] %3.0f %%  %.3g of %.3g photons", BAR_WIDTH, (int)(share * BAR_WIDTH),
          full, 100 * share, (double)now->photons, (double)now->photons_expected);
  if (now->photons > 0) {
    fputs("  ", stderr);
    cli_progress_write_time(seconds * (1 / share - 1));
    fputs(" left", stderr);
  }
  write_worst(now);
  fputs("\033[K", stderr);
}
