/* The functions that the transport solver uses: elementary functions, Bessel functions, Gauss's
 * rules, dense systems. */
#include <complex.h>
#include <float.h>
#include <math.h>

#include "core/solver/dense.h"
#include "core/transport/bessel.h"
#include "core/transport/functions.h"
#include "core/transport/gauss.h"
#include "tests/accuracy/isotropic/nodes.h"
#include "tests/unit/unit.h"

/* Bounds of the errors, in epsilons. The reference is the C library's long double functions, whose
 * errors are far smaller.
 */
#define REAL_EPSILONS 2.0
#define COMPLEX_EPSILONS 4.0
enum { POINTS = 200000 };

static void assert_near(long double complex value, long double complex truth, long double scale,
                        double epsilons) {
  assert_true(cabsl(value - truth) <= epsilons * DBL_EPSILON * scale);
}

UNIT_TEST(real_functions_are_exact_to_the_last_digits) {
  uint64_t random = unit_seed();
  for (int i = 0; i < POINTS; i++) {
    const double x = unit_random_between(&random, -700, 700);
    assert_near(fn_exp(x), expl(x), expl(x), REAL_EPSILONS);
    const double y = unit_random_log(&random, 1e-300, 1e300);
    assert_near(fn_log(y), logl(y), fmaxl(1, fabsl(logl(y))), REAL_EPSILONS);
    const double angle = unit_random_between(&random, -1e4, 1e4);
    double sine, cosine;
    fn_sincos(angle, &sine, &cosine);
    assert_near(sine, sinl(angle), 1, REAL_EPSILONS);
    assert_near(cosine, cosl(angle), 1, REAL_EPSILONS);
  }
}

UNIT_TEST(real_functions_end_where_they_say) {
  double sine, cosine;
  assert_true(fn_exp(0) == 1 && fn_exp(-701) == 0 && fn_exp(-INFINITY) == 0);
  assert_true(isnan(fn_exp(701)) && isnan(fn_exp(NAN)));
  assert_true(fn_log(1) == 0);
  assert_true(isnan(fn_log(0)) && isnan(fn_log(-1)) && isnan(fn_log(INFINITY)));
  fn_sincos(1e6, &sine, &cosine);
  assert_true(isnan(sine) && isnan(cosine));
  fn_sincos(0, &sine, &cosine);
  assert_true(sine == 0 && cosine == 1);
}

/* Returns a random point of any quadrant or axis, over many scales. */
static double complex random_point(uint64_t *random) {
  const double x = unit_random_log(random, 1e-6, 1e6);
  const double y = unit_random_log(random, 1e-6, 1e6);
  const uint64_t bits = unit_random(random);
  const double re = (bits & 0x70) == 0 ? 0 : bits & 1 ? -x : x;
  const double im = (bits & 0x700) == 0 && re > 0 ? 0 : bits & 2 ? -y : y;
  return CMPLX(re, im);
}

UNIT_TEST(complex_functions_are_exact_to_the_last_digits) {
  uint64_t random = unit_seed();
  for (int i = 0; i < POINTS; i++) {
    const double complex z = random_point(&random);
    const long double complex root = csqrtl(z);
    const long double complex logarithm = clogl(z);
    assert_near(fn_csqrt(z), root, cabsl(root), COMPLEX_EPSILONS);
    assert_near(fn_clog(z), logarithm, fmaxl(1, cabsl(logarithm)), COMPLEX_EPSILONS);
    if (fn_abs(z) < 100) {
      const long double complex power = cexpl(z);
      assert_near(fn_cexp(z), power, cabsl(power), COMPLEX_EPSILONS);
      assert_near(fn_cexpm1(z), power - 1, 1 + cabsl(power), COMPLEX_EPSILONS);
    }
    if (fn_abs(z) < 20) {
      double complex sine, cosine;
      isotropic_sinhcosh(z, &sine, &cosine);
      const long double scale = expl(fabsl((long double)creal(z)));
      assert_near(cosine, ccoshl(z), scale, 2 * COMPLEX_EPSILONS);
      assert_near(sine, csinhl(z), fminl(scale, 2 * cabsl(z) * scale), 2 * COMPLEX_EPSILONS);
    }
    const double complex small = 1e-3 * z / fn_abs(z);
    const long double complex series = small + (long double complex)small * small / 2;
    assert_true(cabsl(fn_cexpm1(small) - series) <= 1.7e-10L);
    assert_near(fn_cexpm1(1e-9 * small), 1e-9 * small, 1e-12L, 1e4);
  }
}

/* K0, K1 and 1 / w - K1, computed with 30 digits (mpmath 1.2). */
static const double bessel_values[][8] = {
    {1e-6, 0, 13.9314420736264195, 0, 999999.999992784324, 0, 7.21572103681229181e-6, 0},
    {0.1, -0.07, 2.22536195729795446, 0.600227771769104098, 6.55411266952589928,
     4.76301873886666895, 0.157296726447254532, -0.0650321616854610911},
    {1, -1, 0.0801977269465178187, 0.357277459285330251, 0.0245683055237403486,
     0.459719473801189365, 0.475431694476259651, 0.0402805261988106352},
    {1.9, -0.6, 0.0932918963432369924, 0.08510650474247779, 0.108352795373489714,
     0.109836057245651317, 0.370236625281422146, 0.0412974440137945351},
    {2.2, -0.4, 0.0785209190970015624, 0.0411458827982754229, 0.0930278465351359584,
     0.0521887300858877019, 0.346972153464864007, 0.0278112699141122897},
    {3, -2.9, -0.0296786347912744932, -0.00372336978053055114, -0.0319198267768713381,
     -0.00633335135938374236, 0.204234588408117753, 0.172904287602921939},
    {40, -30, 3.43786936207492358e-19, -6.68255874889854873e-19, 3.50510379486474013e-19,
     -6.71545812022782148e-19, 0.0159999999999999996, 0.0120000000000000007},
};

UNIT_TEST(bessel_functions_have_known_values) {
  for (size_t i = 0; i < sizeof bessel_values / sizeof bessel_values[0]; i++) {
    const double *row = bessel_values[i];
    const bessel_k k = transport_bessel_k(CMPLX(row[0], row[1]));
    const double complex truths[] = {CMPLX(row[2], row[3]), CMPLX(row[4], row[5]),
                                     CMPLX(row[6], row[7])};
    const double complex values[] = {k.k0, k.k1, k.pole_less_k1};
    for (size_t j = 0; j < 3; j++) {
      assert_true(fn_abs(values[j] - truths[j]) <= 1e-14 * fn_abs(truths[j]));
    }
  }
}

/* The series and the continued fraction agree where they meet, at |w| = 2. */
UNIT_TEST(bessel_functions_have_no_seam) {
  for (int i = 0; i <= 15; i++) {
    double sine, cosine;
    fn_sincos(-0.1 * i, &sine, &cosine);
    const double complex w = CMPLX(2 * cosine, 2 * sine);
    const bessel_k inside = transport_bessel_k(w * (1 - 1e-15));
    const bessel_k outside = transport_bessel_k(w * (1 + 1e-15));
    assert_true(fn_abs(inside.k0 - outside.k0) <= 2e-14 * fn_abs(outside.k0));
    assert_true(fn_abs(inside.k1 - outside.k1) <= 2e-14 * fn_abs(outside.k1));
  }
  assert_true(transport_bessel_k(1000).k0 == 0);
}

/* A rule with n points integrates x^(2n - 1) exactly. */
UNIT_TEST(rules_are_exact_for_polynomials) {
  static gauss_rule rule;
  for (size_t n = 1; n <= GAUSS_MAX; n++) {
    transport_gauss(&rule, n);
    assert_int_equal(rule.n, n);
    double whole = 0, highest = 0, cosine = 0;
    for (size_t i = 0; i < n; i++) {
      assert_true(rule.x[i] > (i > 0 ? rule.x[i - 1] : 0) && rule.x[i] < 1);
      whole += rule.weight[i];
      highest += rule.weight[i] * pow(rule.x[i], 2 * (double)n - 1);
      cosine += rule.weight[i] * cos(rule.x[i]);
    }
    assert_true(fabs(whole - 1) < 4e-15);
    assert_true(fabs(highest * 2 * (double)n - 1) < 1e-12);
    assert_true(n < 8 || fabs(cosine - sin(1)) < 4e-15);
  }
}

/* ---- dense systems ------------------------------------------------------------------------------ */

enum { ROWS_MAX = 150, MATRICES = 9, SYSTEM = MATRICES * 2 * ROWS_MAX * (ROWS_MAX + 8) };

/* A symmetric matrix with random numbers. On the diagonal, `size` is added to the real part in some
 * rows and subtracted in the others, as in Vanderbei's quasidefinite matrices. */
static void fill_symmetric(const dense *to, double size, uint64_t *random) {
  for (size_t row = 0; row < to->rows; row++) {
    const double diagonal = row / 5 % 2 == 0 ? size : -size;
    for (size_t i = 0; i <= row; i++) {
      const size_t at = row * to->stride + i, mirror = i * to->stride + row;
      to->re[at] = to->re[mirror] = unit_random_between(random, -1, 1) + (i == row ? diagonal : 0);
      if (to->im != NULL) {
        to->im[at] = to->im[mirror] = unit_random_between(random, -1, 1);
      }
    }
  }
}

static void copy_matrix(const dense *to, const dense *from) {
  memcpy(to->re, from->re, from->rows * from->stride * sizeof *to->re);
  if (to->im != NULL) {
    memcpy(to->im, from->im, from->rows * from->stride * sizeof *to->im);
  }
}

static double difference(const dense *one, const dense *other) {
  double most = 0;
  for (size_t row = 0; row < one->rows; row++) {
    for (size_t i = 0; i < one->columns; i++) {
      const size_t at = row * one->stride + i;
      most = fmax(most, fabs(one->re[at] - other->re[at]));
      most = one->im == NULL ? most : fmax(most, fabs(one->im[at] - other->im[at]));
    }
  }
  return most;
}

/* g^T a^-1 [g, h] by elimination without pivoting, against a solution with it, on every instruction
 * set. */
static void compare_congruence(size_t rows, bool is_complex, double *memory, uint64_t *random) {
  const uint64_t seed = *random;
  dense of[MATRICES];
  for (size_t level = 0; core_isa_listed(level) != NULL; level++) {
    const core_isa *isa = core_isa_select(core_isa_listed(level));
    if (isa == NULL) {
      continue; /* this machine does not have it */
    }
    *random = seed;
    double *next = memory;
    for (size_t k = 0; k < MATRICES; k++) {
      of[k] = solver_dense_at(isa, &next, rows, k < 3 ? rows : rows + 1, is_complex);
    }
    const dense *a = &of[0], *copy = &of[1], *g = &of[2], *b = &of[3], *x = &of[4];
    const dense *result = &of[5], *truth = &of[6], *first = &of[7], *spare = &of[8];
    fill_symmetric(a, 3 * (double)rows, random);
    copy_matrix(copy, a);
    fill_symmetric(g, 0, random);
    for (size_t row = 0; row < rows; row++) {
      for (size_t i = 0; i <= rows; i++) {
        const size_t to = row * b->stride + i, from = row * g->stride + i;
        b->re[to] = i < rows ? g->re[from] : unit_random_between(random, -1, 1);
        if (is_complex) {
          b->im[to] = i < rows ? g->im[from] : unit_random_between(random, -1, 1);
        }
      }
    }
    copy_matrix(x, b);
    assert_true(solver_dense_solve(copy, x));
    solver_dense_multiply(truth, g, x);
    assert_true(solver_dense_congruence(result, a, b, spare));
    assert_true(difference(result, truth) < 1e-13 * (double)rows);
    if (level == 0) {
      copy_matrix(first, result);
    }
    assert_true(difference(result, first) == 0);
  }
}

UNIT_TEST(symmetric_systems_are_solved_without_pivots) {
  static const size_t sizes[] = {1, 2, 7, 8, 15, 16, 17, 33, 63, 64, 65, 81, 127, 129, ROWS_MAX};
  uint64_t random = unit_seed();
  double *memory = aligned_alloc(64, SYSTEM * sizeof *memory);
  assert_non_null(memory);
  memset(memory, 0, SYSTEM * sizeof *memory);
  for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
    compare_congruence(sizes[i], false, memory, &random);
    compare_congruence(sizes[i], true, memory, &random);
  }
  memset(memory, 0, SYSTEM * sizeof *memory);
  double *next = memory;
  dense of[4];
  for (size_t k = 0; k < 4; k++) {
    of[k] = solver_dense_at(core_isa_select(NULL), &next, 9, 9, true);
  }
  assert_false(solver_dense_congruence(&of[0], &of[1], &of[2], &of[3])); /* a is 0 */
  free(memory);
}
