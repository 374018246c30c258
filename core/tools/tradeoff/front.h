/* front: draws the Pareto front of error against cost. */
#ifndef TRADEOFF_FRONT_H
#define TRADEOFF_FRONT_H

#include <stdio.h>

#include "core/tools/tradeoff/costs.h"
#include "core/tools/tradeoff/errors.h"

/* Draws an .svg or .png picture of two panels, with a point for each subject and the front as a
 * line. The error in the left panel is the median over radii, in the right panel the largest one;
 * both are medians over the paper's media. */
void front_draw(const char *path, const errors_table *errors, const costs_of *costs);

/* Prints a line for each subject on the fronts. */
void front_print(FILE *out, const errors_table *errors, const costs_of *costs);

#endif
