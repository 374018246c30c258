/* tally: values of a kernel held against true ones; the worst error for each quantity beside the
 * bound that the core states for it. */
#ifndef DIPOLED_TESTS_TALLY_H
#define DIPOLED_TESTS_TALLY_H

#include <mpfr.h>

#include "core/core.h"

enum { TALLY_QUANTA = 16 }; /* a subnormal value may be off by so many of the smallest */

/* Where a value was taken, for messages. */
typedef struct tally_point {
  core_medium medium;
  enum core_moments moments;
  double r_mm;
  bool in_domain; /* if false, `bound` need not hold, save in tallies that check it everywhere */
  double bound;   /* the bound that core states for this point: relative, or absolute for ln R */
  double epsilon; /* the epsilon of the evaluator's precision */
  double unit;    /* what errors are counted in: epsilon (1 + mu_tr d_r), for ln R more */
} tally_point;

typedef struct tally {
  const char *model;
  const char *evaluator;
  const char *quantity;
  double lower_limit; /* no value may be below it */
  double upper_limit; /* or above it */
  bool absolute;      /* errors are absolute, instead of relative to the truth */
  bool everywhere;    /* the bound holds at every point, not in the promised domain alone */
  size_t points;
  size_t failures;
  size_t beyond;       /* points beyond the domain that are off by more than their bound */
  double worst;        /* error in units, normal values */
  double bound_there;  /* the bound in the same units, where the worst was found */
  double worst_share;  /* error over bound, at most 1 */
  double worst_quanta; /* error in the smallest subnormals, subnormal values */
} tally;

/* Takes one value in; a failure is printed with its inputs, the first few of each tally. */
void tally_add(tally *to, const tally_point *point, double value, const mpfr_t truth);

void tally_print_header(void);
void tally_print(const tally *of);

#endif
