/* similarity: measures the error |R / R_anisotropic - 1| of isotropic scattering that replaces
 * anisotropic scattering with the same sigma_s' = sigma_s (1 - g). R is transport's solution.
 * R_anisotropic comes from Monte Carlo with Henyey and Greenstein's phase function. */
#ifndef TRADEOFF_SIMILARITY_H
#define TRADEOFF_SIMILARITY_H

#include "core/tools/tools.h"
#include "core/tools/tradeoff/nodes.h"

enum { SIMILARITY_GS = 2, SIMILARITY_RATIOS = 11 };

extern const double similarity_gs[SIMILARITY_GS];         /* rising; 0 is not among them */
extern const double similarity_ratios[SIMILARITY_RATIOS]; /* sigma_a / sigma_s', rising */

/* The largest deviations over eta 1, 1.4 and 2 at one g and ratio, plus two standard errors. A
 * value is INFINITY if Monte Carlo's relative standard error in a ring is SIMILARITY_KNOWN or more.
 */
typedef struct similarity_node {
  double worst[NODES_BANDS];
  double albedo;
} similarity_node;

#define SIMILARITY_KNOWN 0.05

/* The work that similarity_measure() adds to the progress. */
double similarity_cost_us(void);

/* Fills in nodes[g][ratio]. Any number of threads gives the same bits. */
void similarity_measure(similarity_node nodes[SIMILARITY_GS][SIMILARITY_RATIOS], size_t threads,
                        tools_progress *progress);

#endif
