/* C_k is the integral over mu in [0, 1] of F(mu) mu^k, where F is the mean of Fresnel's two
 * reflectances for light that strikes the boundary from inside at cosine mu, and 1 beyond the
 * critical angle. So
 *
 *   1 - 2 C1 = integral of 2 mu   (1 - F) dmu,     1 - 3 C2 = integral of 3 mu^2 (1 - F) dmu
 *
 * over those mu that let light out. F has a square root's singularity where the smaller of the two
 * cosines vanishes: at the critical angle for eta > 1, at mu = 0 for eta < 1. The integrals are
 * taken over that smaller cosine by the tanh-sinh rule, whose points crowd exponentially towards
 * the ends, which also takes care of poles near the end for very large, very small and nearly
 * matched indices. (For eta > 1 it is the outer cosine s: mu dmu = s ds / eta^2.) */
#include "tests/accuracy/reference_fresnel.h"

#include <stdbool.h>
#include <stdlib.h>

/* ---- the tanh-sinh rule on [0, 1] ------------------------------------------------------------ */

/* x = 1 / (1 + e^(-pi sinh t)), dx/dt = pi cosh t x (1 - x), at equal steps of t. Each level halves
 * the step and holds the new points only. At |t| = T_MAX the weights are below 2^-250. */
enum { FIRST_STEPS = 8, LEVELS_MAX = 10, T_MAX = 5 };
/* Two levels that agree to this are good to about the square. */
#define CONVERGED_BITS 110

struct node {
  mpfr_t x;
  mpfr_t weight; /* dx/dt */
};

struct level {
  struct node *nodes; /* NULL: not made yet */
  size_t count;
};

static struct level levels[LEVELS_MAX];

static void make_node(struct node *node, double t) {
  mpfr_t e, pi, sinh_t, cosh_t;
  mpfr_inits2(REFERENCE_BITS, e, pi, sinh_t, cosh_t, node->x, node->weight, (mpfr_ptr)NULL);
  mpfr_const_pi(pi, MPFR_RNDN);
  mpfr_set_d(e, t, MPFR_RNDN);
  mpfr_sinh_cosh(sinh_t, cosh_t, e, MPFR_RNDN);
  mpfr_mul(e, pi, sinh_t, MPFR_RNDN);
  mpfr_neg(e, e, MPFR_RNDN);
  mpfr_exp(e, e, MPFR_RNDN);
  mpfr_add_ui(node->x, e, 1, MPFR_RNDN);
  mpfr_ui_div(node->x, 1, node->x, MPFR_RNDN);
  mpfr_mul(node->weight, pi, cosh_t, MPFR_RNDN);
  mpfr_mul(node->weight, node->weight, node->x, MPFR_RNDN);
  mpfr_mul(e, e, node->x, MPFR_RNDN); /* 1 - x */
  mpfr_mul(node->weight, node->weight, e, MPFR_RNDN);
  mpfr_clears(e, pi, sinh_t, cosh_t, (mpfr_ptr)NULL);
}

static const struct level *level_nodes(int index) {
  struct level *level = &levels[index];
  if (level->nodes == NULL) {
    const int steps = FIRST_STEPS << index; /* for each unit of t */
    const int stride = index == 0 ? 1 : 2;
    level->nodes = calloc((size_t)(2 * T_MAX * steps + 1), sizeof *level->nodes);
    if (level->nodes == NULL) {
      abort();
    }
    for (int i = -T_MAX * steps + (stride - 1); i <= T_MAX * steps; i += stride) {
      make_node(&level->nodes[level->count++], (double)i / steps);
    }
  }
  return level;
}

/* ---- the integrands ----------------------------------------------------------------------- */

struct scratch {
  mpfr_t eta, squared_gap; /* |eta^2 - 1| */
  mpfr_t inside, outside;  /* the cosines */
  mpfr_t a, b, escaping;
};

/* The reflectance ((a - b) / (a + b))^2, left in a. */
static void reflectance(mpfr_t a, mpfr_t b, mpfr_t sum) {
  mpfr_add(sum, a, b, MPFR_RNDN);
  mpfr_sub(a, a, b, MPFR_RNDN);
  mpfr_div(a, a, sum, MPFR_RNDN);
  mpfr_sqr(a, a, MPFR_RNDN);
}

/* Snell's law: eta^2 (1 - mu^2) = 1 - s^2. The smaller cosine is given. */
static void cosines(struct scratch *s, bool dense_inside, const mpfr_t x) {
  mpfr_t *smaller = dense_inside ? &s->outside : &s->inside;
  mpfr_t *larger = dense_inside ? &s->inside : &s->outside;
  mpfr_set(*smaller, x, MPFR_RNDN);
  mpfr_sqr(*larger, x, MPFR_RNDN);
  if (!dense_inside) {
    mpfr_mul(*larger, *larger, s->eta, MPFR_RNDN);
    mpfr_mul(*larger, *larger, s->eta, MPFR_RNDN);
  }
  mpfr_add(*larger, *larger, s->squared_gap, MPFR_RNDN);
  mpfr_sqrt(*larger, *larger, MPFR_RNDN);
  if (dense_inside) {
    mpfr_div(*larger, *larger, s->eta, MPFR_RNDN);
  }
}

/* 1 - F at the cosines, left in s->escaping. */
static void escaping(struct scratch *s) {
  mpfr_t *sum = &s->escaping;
  mpfr_t perpendicular;
  mpfr_init2(perpendicular, REFERENCE_BITS);
  mpfr_mul(perpendicular, s->eta, s->inside, MPFR_RNDN);
  mpfr_set(s->b, s->outside, MPFR_RNDN);
  reflectance(perpendicular, s->b, *sum);
  mpfr_set(s->a, s->inside, MPFR_RNDN);
  mpfr_mul(s->b, s->eta, s->outside, MPFR_RNDN);
  reflectance(s->a, s->b, *sum);
  mpfr_add(s->a, s->a, perpendicular, MPFR_RNDN);
  mpfr_div_2ui(s->a, s->a, 1, MPFR_RNDN);
  mpfr_ui_sub(s->escaping, 1, s->a, MPFR_RNDN);
  mpfr_clear(perpendicular);
}

/* Adds the nodes of one quadrature level. x is the cosine on the side of the nodes, mu the cosine
 * inside. Adds weight (1 - F) x to `first` and weight (1 - F) x mu to `second`. */
static void add_level(struct scratch *s, bool dense_inside, int index, mpfr_t first,
                      mpfr_t second) {
  const struct level *level = level_nodes(index);
  for (size_t i = 0; i < level->count; i++) {
    const struct node *node = &level->nodes[i];
    cosines(s, dense_inside, node->x);
    escaping(s);
    mpfr_mul(s->a, s->escaping, node->weight, MPFR_RNDN);
    mpfr_mul(s->a, s->a, node->x, MPFR_RNDN);
    mpfr_add(first, first, s->a, MPFR_RNDN);
    mpfr_mul(s->a, s->a, s->inside, MPFR_RNDN);
    mpfr_add(second, second, s->a, MPFR_RNDN);
  }
}

static bool agree(const mpfr_t a, const mpfr_t b) {
  bool close;
  mpfr_t difference;
  mpfr_init2(difference, REFERENCE_BITS);
  mpfr_reldiff(difference, a, b, MPFR_RNDN);
  close = mpfr_zero_p(difference) || mpfr_get_exp(difference) < -CONVERGED_BITS;
  mpfr_clear(difference);
  return close;
}

/* Integrates (1 - F) x and (1 - F) x mu over x from 0 to 1. x is the smaller cosine, which is the
 * one on the optically thinner side. mu is the cosine inside. */
static void integrate(struct scratch *s, bool dense_inside, mpfr_t first, mpfr_t second) {
  mpfr_t first_sum, second_sum, first_before, second_before;
  mpfr_inits2(REFERENCE_BITS, first_sum, second_sum, first_before, second_before, (mpfr_ptr)NULL);
  mpfr_set_zero(first_sum, 1);
  mpfr_set_zero(second_sum, 1);
  mpfr_set_zero(first, 1);
  mpfr_set_zero(second, 1);
  bool converged = false;
  for (int index = 0; index < LEVELS_MAX && !converged; index++) {
    mpfr_set(first_before, first, MPFR_RNDN);
    mpfr_set(second_before, second, MPFR_RNDN);
    add_level(s, dense_inside, index, first_sum, second_sum);
    mpfr_div_ui(first, first_sum, (unsigned long)FIRST_STEPS << index, MPFR_RNDN);
    mpfr_div_ui(second, second_sum, (unsigned long)FIRST_STEPS << index, MPFR_RNDN);
    converged = agree(first, first_before) && agree(second, second_before);
  }
  if (!converged) {
    fprintf(stderr, "reference: the moments' quadrature does not converge\n");
    abort();
  }
  mpfr_clears(first_sum, second_sum, first_before, second_before, (mpfr_ptr)NULL);
}

static void exact_moments(double eta, reference_fresnel *moments) {
  struct scratch s;
  mpfr_inits2(REFERENCE_BITS, s.eta, s.squared_gap, s.inside, s.outside, s.a, s.b, s.escaping,
              (mpfr_ptr)NULL);
  const bool dense_inside = eta >= 1;
  mpfr_set_d(s.eta, eta, MPFR_RNDN);
  mpfr_sqr(s.squared_gap, s.eta, MPFR_RNDN);
  mpfr_sub_ui(s.squared_gap, s.squared_gap, 1, MPFR_RNDN);
  mpfr_abs(s.squared_gap, s.squared_gap, MPFR_RNDN);
  integrate(&s, dense_inside, moments->one_minus_2c1, moments->one_minus_3c2);
  mpfr_mul_ui(moments->one_minus_2c1, moments->one_minus_2c1, 2, MPFR_RNDN);
  mpfr_mul_ui(moments->one_minus_3c2, moments->one_minus_3c2, 3, MPFR_RNDN);
  if (dense_inside) {
    mpfr_sqr(s.eta, s.eta, MPFR_RNDN);
    mpfr_div(moments->one_minus_2c1, moments->one_minus_2c1, s.eta, MPFR_RNDN);
    mpfr_div(moments->one_minus_3c2, moments->one_minus_3c2, s.eta, MPFR_RNDN);
  }
  mpfr_clears(s.eta, s.squared_gap, s.inside, s.outside, s.a, s.b, s.escaping, (mpfr_ptr)NULL);
}

/* ---- the fits ----------------------------------------------------------------------------- */

/* A sum of powers of eta; it ends with a term without a coefficient. */
struct term {
  int power;
  const char *coefficient; /* exact decimals */
};

/* d'Eon 2012, Eq. 2 */
static const struct term two_c1_below_1[] = {
    {0, "0.919317"},
    {1, "-3.4793"},
    {2, "6.75335"},
    {3, "-7.80989"},
    {4, "4.98554"},
    {5, "-1.36881"},
    {0},
};
static const struct term two_c1_from_1[] = {
    {0, "-9.23372"},
    {1, "22.2272"},
    {2, "-20.9292"},
    {3, "10.2291"},
    {4, "-2.54396"},
    {5, "0.254913"},
    {0},
};
static const struct term three_c2_below_1[] = {
    {0, "0.828421"},
    {1, "-2.62051"},
    {2, "3.36231"},
    {3, "-1.95284"},
    {4, "0.236494"},
    {5, "0.145787"},
    {0},
};
static const struct term three_c2_from_1[] = {
    {0, "-1641.1"},  {-3, "135.926"}, {-2, "-656.175"}, {-1, "1376.53"}, {1, "1213.67"},
    {2, "-568.556"}, {3, "164.798"},  {4, "-27.0181"},  {5, "1.91826"},  {0},
};

/* C1 and C2 themselves, as renderers print them: Pharr, Jakob, Humphreys, "Physically Based
 * Rendering", 3rd edition, section 11.4.2. */
static const struct term c1_below_1[] = {
    {0, "0.45966"},
    {1, "-1.73965"},
    {2, "3.37668"},
    {3, "-3.904945"},
    {4, "2.49277"},
    {5, "-0.68441"},
    {0},
};
static const struct term c1_from_1[] = {
    {0, "-4.61686"},
    {1, "11.1136"},
    {2, "-10.4646"},
    {3, "5.11455"},
    {4, "-1.27198"},
    {5, "0.12746"},
    {0},
};
static const struct term c2_below_1[] = {
    {0, "0.27614"},
    {1, "-0.87350"},
    {2, "1.12077"},
    {3, "-0.65095"},
    {4, "0.07883"},
    {5, "0.04860"},
    {0},
};
static const struct term c2_from_1[] = {
    {0, "-547.033"}, {-3, "45.3087"}, {-2, "-218.725"}, {-1, "458.843"}, {1, "404.557"},
    {2, "-189.519"}, {3, "54.9327"},  {4, "-9.00603"},  {5, "0.63942"},  {0},
};

/* F_dr, which is 2 C1: Egan and Hilgeman 1973, as in Jensen et al. 2001; Donner and Jensen 2005
 * have both sides of 1. */
static const struct term f_dr_below_1[] = {
    {0, "-0.4399"}, {-1, "0.7099"}, {-2, "-0.3319"}, {-3, "0.0636"}, {0},
};
static const struct term f_dr_from_1[] = {
    {-2, "-1.4399"}, {-1, "0.7099"}, {0, "0.6681"}, {1, "0.0636"}, {0},
};

/* 1 - the sum of the terms at eta */
static void complement_of_fit(mpfr_t complement, const struct term *terms, double eta) {
  mpfr_t power, coefficient;
  mpfr_inits2(REFERENCE_BITS, power, coefficient, (mpfr_ptr)NULL);
  mpfr_set_ui(complement, 1, MPFR_RNDN);
  for (; terms->coefficient != NULL; terms++) {
    mpfr_set_d(power, eta, MPFR_RNDN);
    mpfr_pow_si(power, power, terms->power, MPFR_RNDN);
    mpfr_set_str(coefficient, terms->coefficient, 10, MPFR_RNDN);
    mpfr_mul(coefficient, coefficient, power, MPFR_RNDN);
    mpfr_sub(complement, complement, coefficient, MPFR_RNDN);
  }
  mpfr_clears(power, coefficient, (mpfr_ptr)NULL);
}

/* 1 - factor times the sum of the terms at eta */
static void complement_of_multiple(mpfr_t complement, unsigned long factor,
                                   const struct term *terms, double eta) {
  complement_of_fit(complement, terms, eta);
  mpfr_ui_sub(complement, 1, complement, MPFR_RNDN);
  mpfr_mul_ui(complement, complement, factor, MPFR_RNDN);
  mpfr_ui_sub(complement, 1, complement, MPFR_RNDN);
}

/* ---- what is kept ------------------------------------------------------------------------- */

/* Entries are linked, not in an array, so that what was returned stays where it is. */
struct entry {
  enum core_moments moments;
  double eta;
  reference_fresnel value;
  struct entry *next;
};

static struct entry *entries;

static void make_moments(enum core_moments moments, double eta, reference_fresnel *value) {
  switch (moments) {
  case CORE_MOMENTS_EXACT:
    exact_moments(eta, value);
    break;
  case CORE_MOMENTS_FIT:
    complement_of_fit(value->one_minus_2c1, eta < 1 ? two_c1_below_1 : two_c1_from_1, eta);
    complement_of_fit(value->one_minus_3c2, eta < 1 ? three_c2_below_1 : three_c2_from_1, eta);
    break;
  case CORE_MOMENTS_JENSEN:
    exact_moments(eta, value);
    complement_of_fit(value->one_minus_2c1, eta < 1 ? f_dr_below_1 : f_dr_from_1, eta);
    break;
  case CORE_MOMENTS_PBRT:
    complement_of_multiple(value->one_minus_2c1, 2, eta < 1 ? c1_below_1 : c1_from_1, eta);
    complement_of_multiple(value->one_minus_3c2, 3, eta < 1 ? c2_below_1 : c2_from_1, eta);
    break;
  }
}

const reference_fresnel *reference_fresnel_moments(enum core_moments moments, double eta) {
  for (struct entry *entry = entries; entry != NULL; entry = entry->next) {
    if (entry->moments == moments && entry->eta == eta) {
      return &entry->value;
    }
  }
  struct entry *entry = malloc(sizeof *entry);
  if (entry == NULL) {
    abort();
  }
  entry->moments = moments;
  entry->eta = eta;
  mpfr_inits2(REFERENCE_BITS, entry->value.one_minus_2c1, entry->value.one_minus_3c2,
              (mpfr_ptr)NULL);
  make_moments(moments, eta, &entry->value);
  entry->next = entries;
  entries = entry;
  return &entry->value;
}

void reference_fresnel_forget(void) {
  while (entries != NULL) {
    struct entry *entry = entries;
    entries = entry->next;
    mpfr_clears(entry->value.one_minus_2c1, entry->value.one_minus_3c2, (mpfr_ptr)NULL);
    free(entry);
  }
  for (int index = 0; index < LEVELS_MAX; index++) {
    for (size_t i = 0; i < levels[index].count; i++) {
      mpfr_clears(levels[index].nodes[i].x, levels[index].nodes[i].weight, (mpfr_ptr)NULL);
    }
    free(levels[index].nodes);
    levels[index] = (struct level){0};
  }
  mpfr_free_cache();
}
