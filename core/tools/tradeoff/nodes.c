#include "core/tools/tradeoff/nodes.h"

#include <assert.h>
#include <math.h>

/* From 1e-4 on there are ten ratios to a decade, which include 1, 2 and 5 times its power of ten.
 */
const double nodes_ratios[NODES_RATIOS] = {
    0,      1e-6,  1e-5,    1e-4,    1.25e-4, 1.6e-4, 2e-4,   2.5e-4, 3.2e-4, 4e-4,   5e-4,
    6.3e-4, 8e-4,  1e-3,    1.25e-3, 1.6e-3,  2e-3,   2.5e-3, 3.2e-3, 4e-3,   5e-3,   6.3e-3,
    8e-3,   1e-2,  1.25e-2, 1.6e-2,  2e-2,    2.5e-2, 3.2e-2, 4e-2,   5e-2,   6.3e-2, 8e-2,
    0.1,    0.125, 0.16,    0.2,     0.25,    0.32,   0.4,    0.5,    0.63,   0.8,    1,
    1.25,   1.6,   2,       2.5,     3.2,     4,      5,      6.3,    8,      10};

const double nodes_edges[NODES_BANDS + 1] = {0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20};

double nodes_eta(size_t index) {
  return (double)(20 + index) / 20;
}

/* ---- the paper's figures --------------------------------------------------------------------- */

bool nodes_ratio_is_papers(size_t ratio) {
  static const double papers[NODES_PAPER_RATIOS] = {1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02,
                                                    0.05, 0.1,  0.2,  0.5,  1,    2,    5,    10};
  for (size_t i = 0; i < NODES_PAPER_RATIOS; i++) {
    if (nodes_ratios[ratio] == papers[i]) {
      return true;
    }
  }
  return false;
}

bool nodes_eta_is_papers(size_t eta) {
  return eta % 2 == 0;
}

core_medium nodes_medium(size_t ratio, size_t eta) {
  const double x = nodes_ratios[ratio];
  return (core_medium){x / (1 + x), 1 / (1 + x), 0, nodes_eta(eta)};
}

/* ---- radii ----------------------------------------------------------------------------------- */

static size_t band_steps(size_t band) {
  return nodes_edges[band + 1] / nodes_edges[band] > 2.2 ? 16 : 12;
}

size_t nodes_band_start(size_t band) {
  size_t start = 0;
  for (size_t b = 0; b < band; b++) {
    start += band_steps(b);
  }
  return start;
}

void nodes_radii(double r[NODES_RADII]) {
  for (size_t band = 0; band < NODES_BANDS; band++) {
    const size_t start = nodes_band_start(band), steps = band_steps(band);
    for (size_t i = 0; i <= steps; i++) {
      const double share = (double)i / (double)steps;
      r[start + i] = (double)(float)(nodes_edges[band] *
                                     pow(nodes_edges[band + 1] / nodes_edges[band], share));
    }
  }
  assert(nodes_band_start(NODES_BANDS) + 1 == NODES_RADII);
}
