/* dd: double-double arithmetic, with about 106 bits, for preparing profiles. A coefficient computed
 * so and then rounded once has an error of half an ulp; a chain of double operations would have
 * several ulp. It uses only IEEE operations and fma, so results have the same bits on every
 * machine. Sources: Dekker 1971; Knuth, TAOCP 2, 4.2.2 (two_sum); Joldes, Muller, Popescu 2017
 * (products, quotients and roots). */
#ifndef DIPOLED_CORE_DD_H
#define DIPOLED_CORE_DD_H

#include <math.h>

typedef struct dd {
  double hi; /* the value rounded to double */
  double lo; /* the value less hi, at most half an ulp of hi */
} dd;

static inline dd dd_from(double a) {
  return (dd){a, 0};
}

static inline double dd_round(dd a) {
  return a.hi;
}

/* a + b. Requires |a| >= |b| or a == 0. */
static inline dd dd_fast_two_sum(double a, double b) {
  const double sum = a + b;
  return (dd){sum, b - (sum - a)};
}

static inline dd dd_two_sum(double a, double b) {
  const double sum = a + b;
  const double b_part = sum - a;
  return (dd){sum, (a - (sum - b_part)) + (b - b_part)};
}

static inline dd dd_two_product(double a, double b) {
  const double product = a * b;
  return (dd){product, fma(a, b, -product)};
}

static inline dd dd_negate(dd a) {
  return (dd){-a.hi, -a.lo};
}

static inline dd dd_add(dd a, dd b) {
  const dd high = dd_two_sum(a.hi, b.hi);
  const dd low = dd_two_sum(a.lo, b.lo);
  const dd sum = dd_fast_two_sum(high.hi, high.lo + low.hi);
  return dd_fast_two_sum(sum.hi, low.lo + sum.lo);
}

static inline dd dd_sub(dd a, dd b) {
  return dd_add(a, dd_negate(b));
}

static inline dd dd_mul(dd a, dd b) {
  const dd product = dd_two_product(a.hi, b.hi);
  return dd_fast_two_sum(product.hi, product.lo + fma(a.hi, b.lo, a.lo * b.hi));
}

/* a / b. Requires b.hi != 0. */
static inline dd dd_div(dd a, dd b) {
  const double first = a.hi / b.hi;
  const dd rest = dd_sub(a, dd_mul(b, dd_from(first)));
  const double second = rest.hi / b.hi;
  const dd rest2 = dd_sub(rest, dd_mul(b, dd_from(second)));
  const dd quotient = dd_fast_two_sum(first, second);
  return dd_add(quotient, dd_from(rest2.hi / b.hi));
}

/* The square root of a. Requires a.hi >= 0. */
static inline dd dd_sqrt(dd a) {
  if (a.hi == 0) {
    return dd_from(0);
  }
  const double first = sqrt(a.hi);
  const dd rest = dd_sub(a, dd_two_product(first, first));
  return dd_fast_two_sum(first, rest.hi / (2 * first));
}

static inline dd dd_scale(dd a, double power_of_two) {
  return (dd){a.hi * power_of_two, a.lo * power_of_two};
}

#endif
