/* front: the Pareto front of error against cost. */
#ifndef TRADEOFF_FRONT_H
#define TRADEOFF_FRONT_H

#include <stdio.h>

#include "core/tools/tradeoff/costs.h"
#include "core/tools/tradeoff/errors.h"

/* Draws a picture, .svg or .png: a point for each subject, the front as a line. The error is the
 * median over the paper's media, on the left of the median over radii, on the right of the worst.
 */
void front_draw(const char *path, const errors_table *errors, const costs_of *costs);

/* The subjects on the fronts, a line each. */
void front_print(FILE *out, const errors_table *errors, const costs_of *costs);

#endif
