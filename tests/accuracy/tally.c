#include "tests/accuracy/tally.h"

#include <float.h>
#include <math.h>
#include <stdio.h>

#include "tests/accuracy/reference.h"

enum { PRINTED_MAX = 5 };

static void report(tally *to, const tally_point *point, double value, const mpfr_t truth) {
  if (to->failures++ >= PRINTED_MAX) {
    return;
  }
  const core_medium *m = &point->medium;
  mpfr_printf("%s %s %s: %.17g, true %.17Rg, at sigma_a %.17g sigma_s %.17g g %.17g eta %.17g "
              "moments %s r %.17g\n",
              to->model, to->evaluator, to->quantity, value, truth, m->sigma_a_per_mm,
              m->sigma_s_per_mm, m->g, m->eta,
              core_choice_by_id(core_moments_list, point->moments)->name, point->r_mm);
}

static double absolute_error(double value, const mpfr_t truth) {
  mpfr_t difference;
  mpfr_init2(difference, 64);
  mpfr_d_sub(difference, value, truth, MPFR_RNDN);
  const double error = fabs(mpfr_get_d(difference, MPFR_RNDN));
  mpfr_clear(difference);
  return error;
}

static double relative_error(double value, const mpfr_t truth) {
  mpfr_t difference;
  mpfr_init2(difference, 64);
  mpfr_d_sub(difference, value, truth, MPFR_RNDN);
  mpfr_div(difference, difference, truth, MPFR_RNDN);
  const double error = fabs(mpfr_get_d(difference, MPFR_RNDN));
  mpfr_clear(difference);
  return error;
}

/* True when the error of a normal value is within the bound. */
static bool add_normal(tally *to, const tally_point *point, double error) {
  if (error / point->unit > to->worst) {
    to->worst = error / point->unit;
    to->bound_there = point->bound / point->unit;
  }
  to->worst_share = fmax(to->worst_share, error / point->bound);
  return error <= point->bound;
}

/* Likewise for a subnormal value: its own rounding is not relative to it. */
static bool add_subnormal(tally *to, const tally_point *point, double error, double quantum,
                          double truth) {
  const double quanta = error / quantum;
  to->worst_quanta = fmax(to->worst_quanta, quanta);
  return quanta <= fmax(TALLY_QUANTA, point->bound * truth / quantum);
}

/* An infinite value is right where the truth is infinite, or beyond the largest number. */
static bool infinity_is_right(const tally_point *point, double value, const mpfr_t truth) {
  const double largest = point->epsilon == (double)FLT_EPSILON ? (double)FLT_MAX : DBL_MAX;
  const double rounded = mpfr_get_d(truth, MPFR_RNDN);
  return signbit(rounded) == signbit(value) && fabs(rounded) * (1 + point->bound) > largest;
}

/* The same judgement without taking the error in. */
static bool within_bound(const tally_point *point, double value, const mpfr_t truth, double size,
                         double quantum) {
  return absolute_error(value, truth) <= fmax(TALLY_QUANTA * quantum, point->bound * size);
}

static bool judge(tally *to, const tally_point *point, double value, const mpfr_t truth) {
  const bool single = point->epsilon == (double)FLT_EPSILON;
  const double smallest_normal = single ? (double)FLT_MIN : DBL_MIN;
  const double quantum = smallest_normal * point->epsilon;
  const double size = fabs(mpfr_get_d(truth, MPFR_RNDN));
  if (!(value >= to->lower_limit && value <= to->upper_limit)) { /* NaN is neither */
    return false;
  }
  if (mpfr_inf_p(truth)) {
    return mpfr_cmp_d(truth, value) == 0;
  }
  if (isinf(value)) {
    return !to->absolute && infinity_is_right(point, value, truth);
  }
  if (!to->everywhere && !point->in_domain) {
    to->beyond += !within_bound(point, value, truth, size, quantum);
    return true;
  }
  if (to->absolute) {
    return add_normal(to, point, absolute_error(value, truth));
  }
  if (mpfr_zero_p(truth)) {
    return value == 0;
  }
  if (size < smallest_normal) {
    return add_subnormal(to, point, absolute_error(value, truth), quantum, size);
  }
  return add_normal(to, point, relative_error(value, truth));
}

void tally_add(tally *to, const tally_point *point, double value, const mpfr_t truth) {
  to->points++;
  if (!judge(to, point, value, truth)) {
    report(to, point, value, truth);
  }
}

void tally_print_header(void) {
  printf("%-12s %-9s %-8s %9s %8s %8s %10s %8s   %s\n", "model", "evaluator", "quantity", "points",
         "worst", "bound", "subnormal", "beyond", "failures");
}

void tally_print(const tally *of) {
  printf("%-12s %-9s %-8s %9zu %8.2f %8.2f %10.1f %8zu   %zu\n", of->model, of->evaluator,
         of->quantity, of->points, of->worst, of->bound_there, of->worst_quanta, of->beyond,
         of->failures);
}
