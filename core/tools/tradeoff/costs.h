/* costs: measures the time of preparing and evaluating, on one core, with this machine's best
 * instruction set. */
#ifndef TRADEOFF_COSTS_H
#define TRADEOFF_COSTS_H

#include "core/choose.h"
#include "core/tools/tools.h"
#include "core/tools/tradeoff/subjects.h"

enum { COSTS_LENGTH = 4096 };

typedef struct costs_of {
  /* With each of CORE_CHOOSE_TOLERANCES. */
  double evaluate_ns[CORE_CHOOSE_TOLERANCE_COUNT]; /* for R at one radius of COSTS_LENGTH */
  double prepare_ns[CORE_CHOOSE_TOLERANCE_COUNT];  /* for one medium */
  double prepare_with_g_ns; /* of `transport` with a g other than 0, NAN for other models */
  /* The numerical error that profiles state if the request's tolerance is tolerance_least, which is
   * the least power of ten that they accept. */
  double numerical_least;
  double tolerance_least;
} costs_of;

/* The work that costs_measure() adds to the progress. */
double costs_cost_us(void);

/* Fills in costs[of->count]. The subjects are timed in turns, round after round, so that other load
 * on the machine affects all of them equally. Each figure is the median over rounds, then over
 * media, and NaN if the subject accepts no medium. */
void costs_measure(costs_of *costs, const subjects *of, tools_progress *progress);

#endif
