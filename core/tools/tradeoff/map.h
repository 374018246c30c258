/* map: which model and evaluator is the cheapest within an error, over ratio and eta. */
#ifndef TRADEOFF_MAP_H
#define TRADEOFF_MAP_H

#include <stdio.h>

#include "core/tools/tradeoff/costs.h"
#include "core/tools/tradeoff/errors.h"

/* Draws a picture, .svg or .png: panels for 1 %, 3 % and 10 %; above for all radii, below for
 * those from ERRORS_FAR on. The cheapest as core/choose.h has it: of costs that are alike the
 * nearest to transport. */
void map_draw(const char *path, const errors_table *errors, const costs_of *costs);

/* How many of the media each subject is the cheapest for. */
void map_print(FILE *out, const errors_table *errors, const costs_of *costs);

#endif
