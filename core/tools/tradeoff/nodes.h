/* nodes: the media and the radii at which models are measured against transport.
 *
 * Scattering is isotropic and sigma_t' = 1 per mm, so that radii in mm are in mean free paths. The
 * media are all pairs of a ratio sigma_a / sigma_s' and an eta. Some of them are the panels of
 * Figures 1 to 16 of d'Eon 2012 for eta 1.0, 1.1, ..., 2.0; the others lie between, so that what is
 * measured may be interpolated, and below, down to no absorption at all. */
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

/* Rising. */
extern const double nodes_ratios[NODES_RATIOS];
extern const double nodes_edges[NODES_BANDS + 1]; /* of the bands of radii, in mean free paths */
double nodes_eta(size_t index);

/* Whether the paper's figures have this medium's ratio, or its eta. */
bool nodes_ratio_is_papers(size_t ratio);
bool nodes_eta_is_papers(size_t eta);

core_medium nodes_medium(size_t ratio, size_t eta);

/* Writes the radii: equal steps of ln r within a band (nearly the same in all), 12 or 16 of them,
 * both edges included. They are numbers of single precision, so that no evaluator rounds them. */
void nodes_radii(double r[NODES_RADII]);

/* The first radius of a band; its last is the first of the next band. band: up to NODES_BANDS. */
size_t nodes_band_start(size_t band);

#endif
