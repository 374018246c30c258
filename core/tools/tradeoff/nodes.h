/* nodes: lists the media and the radii at which models are measured against transport.
 *
 * Scattering is isotropic and sigma_t' = 1 per mm, so that radii in mm are in mean free paths. The
 * media are all pairs of a ratio sigma_a / sigma_s' and an eta. Some of them are the panels of
 * Figures 1 to 16 of d'Eon 2012 for eta 1.0, 1.1, ..., 2.0; the others lie between them, so that
 * errors can be interpolated, and below, down to no absorption. */
#ifndef TRADEOFF_NODES_H
#define TRADEOFF_NODES_H

#include <stdbool.h>
#include <stddef.h>

#include "core/core.h"

enum {
  NODES_RATIOS = 54,
  NODES_ETAS = 21,
  NODES_BANDS = 10,
  NODES_RADII = 133,
  NODES_PAPER_RATIOS = 16,
  NODES_PAPER_ETAS = 11,
};

/* Ratios sigma_a / sigma_s' and edges of the bands of radii, both rising. */
extern const double nodes_ratios[NODES_RATIOS];
extern const double nodes_edges[NODES_BANDS + 1]; /* in mean free paths */
double nodes_eta(size_t index);

/* Whether a figure of the paper has the ratio, or the eta, at this position of the list. */
bool nodes_ratio_is_papers(size_t ratio);
bool nodes_eta_is_papers(size_t eta);

/* Returns the medium of a node, with sigma_t' = 1 per mm and g = 0. */
core_medium nodes_medium(size_t ratio, size_t eta);

/* Writes the radii of all bands. A band has 12 or 16 equal steps of ln r, and radii at both edges.
 * All radii are numbers of single precision, so that no evaluator rounds them. */
void nodes_radii(double r[NODES_RADII]);

/* Returns the position of a band's first radius. Its last radius is the first one of the next band;
 * band may be NODES_BANDS. */
size_t nodes_band_start(size_t band);

#endif
