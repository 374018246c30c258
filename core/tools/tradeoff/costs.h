/* costs: what preparing and evaluating cost, one core, the best instruction set of this machine. */
#ifndef TRADEOFF_COSTS_H
#define TRADEOFF_COSTS_H

#include "core/tools/tools.h"
#include "core/tools/tradeoff/subjects.h"

enum { COSTS_LENGTH = 4096 };

typedef struct costs_of {
  double evaluate_ns; /* of R at one radius of an array of COSTS_LENGTH */
  double prepare_ns;
  /* What profiles state of their numerical error: numerical_least when asked for tolerance_least,
   * the least power of ten that they accept. */
  double numerical_least;
  double tolerance_least;
} costs_of;

/* What costs_measure() adds to the progress. */
double costs_cost_us(void);

/* costs[of->count]. Evaluations of all subjects take turns, round after round, so that whatever
 * else the machine does meets all alike; each figure is the median over rounds, then over media;
 * NaN where no medium is accepted. */
void costs_measure(costs_of *costs, const subjects *of, tools_progress *progress);

#endif
