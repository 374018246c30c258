/* similarity: how far isotropic scattering is from anisotropic scattering with the same
 * sigma_s' = sigma_s (1 - g), |R / R_anisotropic - 1|. Both are transport: the first one solved, the
 * second one by Monte Carlo (Henyey and Greenstein's phase function). */
#ifndef TRADEOFF_SIMILARITY_H
#define TRADEOFF_SIMILARITY_H

#include "core/tools/tools.h"
#include "core/tools/tradeoff/nodes.h"

enum { SIMILARITY_GS = 8, SIMILARITY_RATIOS = 11 };

extern const double similarity_gs[SIMILARITY_GS];         /* rising; 0 is not among them */
extern const double similarity_ratios[SIMILARITY_RATIOS]; /* sigma_a / sigma_s', rising */

/* At one g and ratio: the largest deviation over eta 1, 1.4 and 2, plus two standard errors.
 * INFINITY where Monte Carlo does not know a ring within SIMILARITY_KNOWN. */
typedef struct similarity_node {
  double worst[NODES_BANDS];
  double albedo;
} similarity_node;

#define SIMILARITY_KNOWN 0.05

/* What similarity_measure() adds to the progress. */
double similarity_cost_us(void);

/* Fills nodes[g][ratio], by so many threads. Any number of threads gives the same bits. */
void similarity_measure(similarity_node nodes[SIMILARITY_GS][SIMILARITY_RATIOS], size_t threads,
                        tools_progress *progress);

#endif
