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
  double bound;   /* relative, as core states it for this point */
  double epsilon; /* of the evaluator's precision */
  double unit;    /* epsilon (1 + mu_tr d_r): what errors are counted in */
} tally_point;

typedef struct tally {
  const char *model;
  const char *evaluator;
  const char *quantity;
  double upper_limit; /* no value may be above it */
  size_t points;
  size_t failures;
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
