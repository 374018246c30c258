/* discs: the mean of R over the discs of two fibres, as a sum over a few distances. Internal to
 * core/fit. */
#ifndef DIPOLED_CORE_FIT_DISCS_H
#define DIPOLED_CORE_FIT_DISCS_H

#include <stddef.h>

/* The most nodes of two discs. */
enum { FIT_DISC_NODES = 50 };

/* Returns the number of nodes that fit_disc_nodes() sets. */
size_t fit_disc_count(double distance_mm, double source_mm, double detector_mm);

/* Sets at[] and weight[] such that sum weight R(at) is the mean of R(|p - q|) over the points p of
 * a disc of diameter source_mm and the points q of one of diameter detector_mm, whose centres are
 * distance_mm apart. Returns the number of nodes, at most FIT_DISC_NODES: 1 without discs. No
 * distance is 0 unless both diameters and distance_mm are. The error is below 1e-4 of the mean for
 * R that is in proportion to 1 / r near the source and smooth in ln r. */
size_t fit_disc_nodes(double distance_mm, double source_mm, double detector_mm, double *at,
                      double *weight);

#endif
