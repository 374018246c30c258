/* map: draws the cheapest model and evaluator within a given error, over ratio and eta. */
#ifndef TRADEOFF_MAP_H
#define TRADEOFF_MAP_H

#include <stdio.h>

#include "core/tools/tradeoff/costs.h"
#include "core/tools/tradeoff/errors.h"

/* Draws an .svg or .png picture with panels for the errors 1 %, 3 % and 10 %. The upper ones are
 * for all radii, the lower ones for those from ERRORS_FAR on. Among costs within
 * CORE_CHOOSE_COST_ALIKE the subject nearest to transport counts as the cheapest. */
void map_draw(const char *path, const errors_table *errors, const costs_of *costs);

/* Prints for how many of the media each subject is the cheapest. */
void map_print(FILE *out, const errors_table *errors, const costs_of *costs);

#endif
