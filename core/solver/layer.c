/* A layer that is lit from one side reflects R and transmits T of the light. Of a beam, whose part
 * e passes, it scatters r back and t on. The beam is one more direction: r and t are a column more
 * of R and T. Both faces are alike. Two equal layers that are lit alike from both sides, or with
 * opposite signs, have a mirror between them:
 *
 *   A = R + T (1 - R)^-1 T,   a = r + T (1 - R)^-1 (t + e r),
 *   O = R - T (1 + R)^-1 T,   o = r - T (1 + R)^-1 (t - e r),
 *
 * and together they reflect (A + O) / 2, (a + o) / 2 and transmit (A - O) / 2, (a - o) / 2 + e t.
 *
 * With u = I+ + I- and v = I+ - I-, the equations are v' = -Xm u and u' = -Xp v, and a half space has
 * v = G u with G Xp G = Xm: G is the geometric mean of Xm and Xp^-1, which is the limit of their
 * arithmetic and harmonic means A and B (Newton's iteration for a square root),
 *
 *   A' = (A + B) / 2,   B' = 2 (A^-1 + B^-1)^-1 = 2 A - A A'^-1 A,
 *
 * where A and B may be scaled by any number and its reciprocal. With Fresnel's reflectance F at the
 * boundary, and g the beam's column of G, the light on its way up is I- = -(1 - F + G (1 + F))^-1 g,
 * and <mu T psi>.I- leaves. Diffuse light has the radiance T(mu) / <mu T> behind the boundary: (1 -
 * G) <mu T psi> / <mu T> in place of -g. R = 2 (1 + G)^-1 - 1, r = -(1 + G)^-1 g.
 *
 * All matrices have the signs of expansion.h and are symmetric; S has these signs on its diagonal.
 */
#include "core/solver/layer.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/transport/functions.h"

enum { ALIGNMENT_BYTES = 64, SPARE = 4 };

typedef struct layer {
  dense reflected, transmitted; /* reflected: R and the column r; transmitted: T and the column t */
  double passed;                /* e: the share of the beam that passes */
} layer;

/* The matrices and inputs for one wavenumber. */
struct work {
  const expansion *of;
  double complex k;
  dense spare[SPARE], alike, opposite;
  double complex *closing; /* the contribution of orders above M to the block of order M */
};

/* Adds factor * S, the diagonal matrix of signs. */
static void add_signs(const expansion *of, const dense *to, double factor) {
  for (size_t m = 0; m <= of->orders; m++) {
    for (size_t row = of->first[m]; row < of->first[m + 1]; row++) {
      to->re[row * to->stride + row] += m % 2 == 0 ? factor : -factor;
    }
  }
}

static double sign_of_row(const expansion *of, size_t row) {
  size_t m = 0;
  while (m < of->orders && row >= of->first[m + 1]) {
    m++;
  }
  return m % 2 == 0 ? 1 : -1;
}

static double largest(const dense *of) {
  double most = 0;
  for (size_t row = 0; row < of->rows; row++) {
    for (size_t i = 0; i < of->columns; i++) {
      const double complex value = solver_dense_get(of, row, i);
      const double re = fabs(creal(value)), im = fabs(cimag(value));
      most = re > most ? re : most;
      most = im > most ? im : most;
    }
  }
  return most;
}

static void close_orders(const struct work *by) {
  const expansion *of = by->of;
  const size_t at = of->first[of->orders], n = of->n - at;
  memset(by->closing, 0, n * n * sizeof *by->closing);
  for (size_t node = 0; node < of->nodes && by->k != 0; node++) {
    const double mu = of->mu[node], alpha = of->alpha[node];
    const double complex streaming =
        fn_csqrt(alpha * alpha + by->k * by->k * ((1 - mu) * (1 + mu)));
    const double complex left =
        of->weight[node] * (of->orders % 2 == 0 ? 0.5 : -0.5) * (streaming - alpha);
    const double *psi = of->psi + node * of->n + at;
    for (size_t i = 0; i < n; i++) {
      for (size_t j = 0; j < n; j++) {
        by->closing[i * n + j] += left * (psi[i] * psi[j]);
      }
    }
  }
}

/* Sets to = S + beta (base + k C + closure). */
static void fill_matrix(const struct work *by, const dense *to, const double *base, double beta) {
  const expansion *of = by->of;
  const size_t n = of->n, last = of->first[of->orders];
  for (size_t i = 0; i < n; i++) {
    for (size_t j = 0; j < n; j++) {
      double complex value = base[i * n + j] + by->k * of->slant[i * n + j];
      if (i >= last && j >= last) {
        value += by->closing[(i - last) * (n - last) + j - last];
      }
      solver_dense_put(to, i, j, beta * value);
    }
  }
  add_signs(of, to, 1);
}

/* Sets *to to T (1 - sign R)^-1 T with the column T (1 - sign R)^-1 (t + sign e r). */
static bool mirror(const struct work *by, const dense *to, const layer *of, double sign) {
  const dense *a = &by->spare[0], *b = &by->spare[1];
  const size_t n = by->of->n;
  solver_dense_combine(a, -sign, &of->reflected, 0, &of->reflected);
  add_signs(by->of, a, 1);
  solver_dense_combine(b, 1, &of->transmitted, 0, &of->transmitted);
  for (size_t row = 0; row < n; row++) {
    solver_dense_put(b, row, n,
                     solver_dense_get(b, row, n) +
                         sign * of->passed * solver_dense_get(&of->reflected, row, n));
  }
  return solver_dense_congruence(to, a, b, &by->spare[2]);
}

/* Doubles a layer `times` times, or until no more than `least` passes it. */
static bool double_up(const struct work *by, layer *of, int times, double least) {
  const dense *r = &of->reflected, *t = &of->transmitted, *a = &by->alike, *o = &by->opposite;
  const size_t n = by->of->n;
  for (int i = 0; i < times && !(largest(t) < least); i++) {
    if (!mirror(by, a, of, 1) || !mirror(by, o, of, -1)) {
      return false;
    }
    solver_dense_combine(r, 1, r, 0.5, a);
    solver_dense_combine(r, 1, r, -0.5, o);
    for (size_t row = 0; row < n; row++) {
      solver_dense_put(a, row, n,
                       solver_dense_get(a, row, n) + 2 * of->passed * solver_dense_get(t, row, n));
    }
    solver_dense_combine(t, 0.5, a, 0.5, o);
    of->passed *= of->passed;
  }
  return true;
}

/* v = S A u at the upper face, where A is symmetric, with a column for the beam: v of the beam is
 * `beam` times its u. */
typedef struct relation {
  dense all;
  double beam;
} relation;

static void copy(const dense *to, const dense *from) {
  solver_dense_combine(to, 1, from, 0, from);
}

/* Sets *to to step times the base + sign k C + the closure, and the beam's column. */
static void fill_relation(const struct work *by, relation *to, const double *base, double sign,
                          double step) {
  const expansion *of = by->of;
  struct work mirrored = *by;
  mirrored.k *= sign;
  fill_matrix(&mirrored, &to->all, base, step);
  add_signs(of, &to->all, -1);
  for (size_t i = 0; i < of->n; i++) {
    const double source = of->source[0][i] + sign * of->source[1][i];
    solver_dense_put(&to->all, i, of->n, -step * of->albedo * source);
  }
  to->beam = step;
}

/* Adds to column n of `to` the one of `from`, times `factor`. */
static void add_column(const dense *to, double factor, const dense *from) {
  const size_t n = to->rows;
  for (size_t row = 0; row < n; row++) {
    solver_dense_put(to, row, n,
                     solver_dense_get(to, row, n) + factor * solver_dense_get(from, row, n));
  }
}

/* Sets *to to g s^-1 g, which may be s but not g. */
static bool weigh(const struct work *by, relation *to, const relation *g, const relation *s) {
  const dense *a = &by->spare[0], *b = &by->spare[1];
  const double ratio = g->beam / s->beam;
  copy(a, &s->all);
  copy(b, &g->all);
  add_column(b, -ratio, &s->all);
  if (!solver_dense_congruence(&to->all, a, b, &by->spare[2])) {
    return false;
  }
  add_column(&to->all, ratio, &g->all);
  to->beam = ratio * g->beam;
  return true;
}

static void combine(relation *to, double x, const relation *a, double y, const relation *b) {
  solver_dense_combine(&to->all, x, &a->all, y, &b->all);
  to->beam = x * a->beam + y * b->beam;
}

static bool invert(const struct work *by, relation *to, const relation *of) {
  relation one = {by->spare[3], 1};
  solver_dense_clear(&one.all);
  for (size_t i = 0; i < by->of->n; i++) {
    one.all.re[i * one.all.stride + i] = 1;
  }
  return weigh(by, to, &one, of);
}

enum { MEANS_MAX = 60 };

/* Means that differ by this little, relative, are off by its square. */
#define MEANS_APART 1e-6

/* Sets *to to the relation of a half space: the limit of the means of two. */
static bool find_halfspace(const struct work *by, relation *to, double kappa) {
  const expansion *of = by->of;
  relation a = {by->alike, 0}, b = {by->opposite, 0}, apart = {by->spare[3], 0};
  /* The first pair has the decay rates, times a step, and their reciprocals. Of many media, this
   * step and these scales of the next pairs led to the fewest means. */
  static const double scales[] = {1, 0.31, 0.78};
  const double modulus = fn_abs(by->k), degrees = (double)of->first[1];
  const double slow = fmin(1, sqrt(fn_abs(kappa * kappa + by->k * by->k)));
  const double step = 2 / (degrees * sqrt(slow) * sqrt((1 + modulus) * sqrt(1 + modulus)));
  fill_relation(by, &a, of->even, 1, step);
  fill_relation(by, &b, of->odd, -1, step);
  if (!invert(by, &b, &b)) {
    return false;
  }
  for (size_t i = 0; i < MEANS_MAX; i++) {
    const double scale = i < sizeof scales / sizeof *scales ? scales[i] : 1;
    combine(&a, scale, &a, 0, &a);
    combine(to, 0.5, &a, 0.5 / scale, &b);
    combine(&apart, 1, &a, -1 / scale, &b);
    if (largest(&apart.all) < MEANS_APART * largest(&to->all)) {
      return true;
    }
    if (!weigh(by, &b, &a, to)) {
      return false;
    }
    combine(&b, 2, &a, -1, &b);
    combine(&a, 1, to, 0, to);
  }
  return false;
}

/* Sets *to to the R of a half space. */
static bool reflect(const struct work *by, const dense *to, const relation *half) {
  const dense *a = &by->spare[0], *b = &by->spare[1];
  copy(a, &half->all);
  add_signs(by->of, a, 1);
  solver_dense_clear(b);
  add_signs(by->of, b, 1);
  add_column(b, -0.5, &half->all);
  if (!solver_dense_congruence(to, a, b, &by->spare[2])) {
    return false;
  }
  solver_dense_combine(to, 2, to, 0, to);
  add_signs(by->of, to, -1);
  return true;
}

/* Sets the upward light of a beam after one scattering: (E + 1) I- = a b-. */
static bool scatter_once(const struct work *by, const dense *to) {
  const expansion *of = by->of;
  const dense *a = &by->spare[0];
  fill_matrix(by, a, of->unit, 1);
  solver_dense_clear(to);
  for (size_t i = 0; i < of->n; i++) {
    solver_dense_put(to, i, 0, of->albedo * of->source[1][i]);
  }
  return solver_dense_solve(a, to);
}

/* Sets the upward light of a beam, and of diffuse light, under a boundary: with F its reflectance,
 * (S (1 - F) + A (1 + F)) I- is minus the beam's column, or S - A times the diffuse light. */
static bool light_up(const struct work *by, const dense *to, const relation *half,
                     size_t boundary) {
  const expansion *of = by->of;
  const dense *a = &by->spare[0], *f = &by->spare[1];
  const double *exit = of->exit[boundary][0];
  solver_dense_clear(f);
  for (size_t row = 0; row < of->n; row++) {
    double complex diffuse = sign_of_row(of, row) * exit[row];
    for (size_t i = 0; i < of->n; i++) {
      f->re[row * f->stride + i] = of->reflection[boundary][row * of->n + i];
      diffuse -= solver_dense_get(&half->all, row, i) * exit[i];
    }
    solver_dense_put(to, row, 0, -solver_dense_get(&half->all, row, of->n));
    solver_dense_put(to, row, 1, diffuse / of->entering[boundary]);
  }
  dense square = half->all;
  square.columns = of->n;
  solver_dense_multiply(a, &square, f);
  solver_dense_combine(a, 1, a, 1, &half->all);
  for (size_t row = 0; row < of->n; row++) {
    const double sign = sign_of_row(of, row);
    for (size_t i = 0; i < of->n; i++) {
      a->re[row * a->stride + i] -= sign * f->re[row * f->stride + i];
    }
    a->re[row * a->stride + row] += sign;
  }
  return solver_dense_solve(a, to);
}

/* Memory for one wavenumber. */
enum { MATRICES = SPARE + 4 };
struct memory {
  double *all;
  struct work work;
  layer half;
  dense once, lit; /* [n][2] */
};

static bool reserve(struct memory *to, const expansion *of, double complex k) {
  const bool is_complex = cimag(k) != 0;
  const size_t n = of->n, last = n - of->first[of->orders];
  const size_t bytes = sizeof(double) * (MATRICES * 2 * solver_dense_size(n, n + 1) +
                                         4 * solver_dense_size(n, 2) + 2 * last * last);
  to->all = aligned_alloc(ALIGNMENT_BYTES,
                          (bytes + ALIGNMENT_BYTES - 1) / ALIGNMENT_BYTES * ALIGNMENT_BYTES);
  if (to->all == NULL) {
    return false;
  }
  memset(to->all, 0, bytes);
  double *next = to->all;
  dense matrix[MATRICES];
  for (size_t i = 0; i < MATRICES; i++) {
    matrix[i] = solver_dense_at(of->isa, &next, n, n + 1, is_complex);
  }
  to->work = (struct work){of,        k,         {matrix[0], matrix[1], matrix[2], matrix[3]},
                           matrix[4], matrix[5], NULL};
  to->work.spare[0].columns = n;
  to->half = (layer){matrix[6], matrix[7], 0};
  to->once = solver_dense_at(of->isa, &next, n, 2, is_complex);
  to->lit = solver_dense_at(of->isa, &next, n, 2, is_complex);
  to->work.closing = (double complex *)next;
  close_orders(&to->work);
  return true;
}

bool solver_layer_halfspace(const expansion *of, double complex k, double kappa,
                            layer_exitance *exitance) {
  struct memory memory;
  if (!reserve(&memory, of, k)) {
    return false;
  }
  const struct work *by = &memory.work;
  const dense *once = &memory.once, *lit = &memory.lit;
  relation half = {memory.half.reflected, 0};
  bool ok = find_halfspace(by, &half, kappa) && scatter_once(by, once);
  for (size_t i = 0; i < of->boundaries.count && ok; i++) {
    ok = light_up(by, lit, &half, i);
    exitance[i] = (layer_exitance){0};
    for (size_t row = 0; row < of->first[1] && ok; row++) {
      exitance[i].single += of->exit[i][0][row] * solver_dense_get(once, row, 0);
      exitance[i].diffuse += of->exit[i][0][row] * solver_dense_get(lit, row, 1);
      for (size_t part = 0; part <= of->boundaries.cones; part++) {
        exitance[i].part[part] += of->exit[i][part][row] *
                                  (solver_dense_get(lit, row, 0) - solver_dense_get(once, row, 0));
      }
    }
  }
  free(memory.all);
  return ok;
}

/* ---- layers of finite thickness ------------------------------------------------------------ */

/* Sets *to to step times the matrix of -v' = Xm u or -u' = Xp v: the base for k = 0 with k C and
 * the closure, the beam's column -a (b+ + sign b-), and 1 in the corner; with a column and a row
 * more, those are apart: -a b+, -a sign b-, and 1 in both corners. */
static void fill_rates(const struct work *by, const dense *to, const double *base, double sign,
                       double step) {
  const expansion *of = by->of;
  const size_t n = of->n, last = of->first[of->orders];
  const bool apart = to->columns == n + 2;
  solver_dense_clear(to);
  for (size_t i = 0; i < n; i++) {
    const double factor = step * sign_of_row(of, i);
    for (size_t j = 0; j < n; j++) {
      double complex value = base[i * n + j] + by->k * of->slant[i * n + j];
      if (i >= last && j >= last) {
        value += by->closing[(i - last) * (n - last) + j - last];
      }
      solver_dense_put(to, i, j, factor * value);
    }
    const double on = -step * of->albedo * of->source[0][i];
    const double back = -step * of->albedo * sign * of->source[1][i];
    solver_dense_put(to, i, n, apart ? on : on + back);
    if (apart) {
      solver_dense_put(to, i, n + 1, back);
    }
  }
  for (size_t i = n; i < to->columns; i++) {
    solver_dense_put(to, i, i, step);
  }
}

static void add_identity(const dense *to, double factor) {
  for (size_t i = 0; i < to->rows; i++) {
    to->re[i * to->stride + i] += factor;
  }
}

/* Matrices [n + 2][n + 2] of a thin layer. */
enum { THIN = 6 };

/* Sets *to to (1 - K) / (1 + K), where K = (15 + Z) a / (15 + 6 Z), Z = a b: the [3/3] Pade
 * approximant of the light that leaves a thin layer which is lit alike from both sides (opposite:
 * a and b exchanged). a and b are half a thickness times Xm and Xp. */
static bool pade(const dense *to, const dense *a, const dense *b, const dense *z,
                 const dense *left) {
  solver_dense_multiply(z, a, b);
  solver_dense_multiply(to, z, a);
  solver_dense_combine(to, 15, a, 1, to);  /* left: (15 + Z) a */
  solver_dense_combine(left, 6, z, 1, to); /* left: 15 + 6 Z + (15 + Z) a */
  solver_dense_combine(to, 6, z, -1, to);
  add_identity(left, 15);
  add_identity(to, 15);
  return solver_dense_solve(left, to);
}

/* How often a layer is halved until its start is exact: the stiffest modes, whose rate is G, are
 * lost by repetition. */
static int halvings_of(const expansion *of, double complex k, double depth) {
  enum { LEAST = 4 };
  const double functions = (double)of->first[1] / (double)of->panels;
  const double rate =
      (1 + fn_abs(k)) * fmax(100, 0.5 * functions * functions) / (of->edge[1] - of->edge[0]);
  int halvings = LEAST;
  while (ldexp(1, 2 * halvings) < 1.25 * rate * depth) {
    halvings++;
  }
  return halvings;
}

/* Replaces Ts and s+ of a layer by those of two such layers, and adds what the second one scatters
 * back of a beam. */
static void double_once(const layer_operators *to, const dense *spare) {
  const size_t n = to->passed_once.rows - 1;
  const double passed = creal(solver_dense_get(&to->passed_once, n, n));
  dense back = to->reflected_once, more = *spare;
  more.columns = 1;
  more.stride = back.stride;
  solver_dense_put(&back, n, 0, 0);
  solver_dense_multiply(&more, &to->passed_once, &back);
  solver_dense_combine(&back, 1, &back, passed, &more);
  solver_dense_multiply(spare, &to->passed_once, &to->passed_once);
  solver_dense_combine(&to->passed_once, 1, spare, 0, spare);
}

/* Converts R and T with the beam from the signs of this file to the outer ones, or `inwards`. */
static void exchange(const struct work *by, const dense *outer, const dense *inner, bool inwards) {
  const size_t n = by->of->n;
  for (size_t row = 0; row < n; row++) {
    const double sign = sign_of_row(by->of, row);
    for (size_t column = 0; column <= n; column++) {
      const dense *from = inwards ? outer : inner, *to = inwards ? inner : outer;
      solver_dense_put(to, row, column, sign * solver_dense_get(from, row, column));
    }
  }
}

static dense shaped(const dense *of, size_t rows) {
  dense made = *of;
  made.rows = made.columns = rows;
  made.stride = solver_dense_size(1, rows);
  return made;
}

/* Sets what a thin layer scatters at most once. Without more scattering Xm and Xp are alike but for
 * the sign of b-, so that one approximant has what passes, with the columns of b+ and b-. */
static bool find_once(const struct work *by, const layer_operators *to, const dense *thin,
                      double step) {
  const expansion *of = by->of;
  const size_t n = of->n;
  fill_rates(by, &thin[2], of->unit, 1, step);
  fill_rates(by, &thin[3], of->unit, -1, step);
  if (!pade(&thin[0], &thin[2], &thin[3], &thin[4], &thin[5])) {
    return false;
  }
  for (size_t row = 0; row <= n; row++) {
    for (size_t column = 0; column <= n; column++) {
      solver_dense_put(&to->passed_once, row, column, solver_dense_get(&thin[0], row, column));
    }
    solver_dense_put(&to->reflected_once, row, 0, solver_dense_get(&thin[0], row, n + 1));
  }
  return true;
}

#define PASSED_LEAST 1e-20

static bool find_layer(const struct work *by, layer *half, const layer_operators *to,
                       const dense *thin, double depth) {
  const expansion *of = by->of;
  const int halvings = halvings_of(of, by->k, depth);
  const double step = 0.5 * ldexp(depth, -halvings);
  const size_t n = of->n;
  if (!find_once(by, to, thin, step)) {
    return false;
  }
  dense square[THIN];
  for (size_t i = 0; i < THIN; i++) {
    square[i] = shaped(&thin[i], n + 1);
  }
  for (int i = 0; i < halvings; i++) {
    double_once(to, &square[0]);
  }
  const dense *alike = &square[0], *opposite = &square[1], *xm = &square[2], *xp = &square[3];
  fill_rates(by, xm, of->even, 1, step);
  fill_rates(by, xp, of->odd, -1, step);
  if (!pade(alike, xm, xp, &square[4], &square[5]) ||
      !pade(opposite, xp, xm, &square[4], &square[5])) {
    return false;
  }
  solver_dense_combine(&to->reflected, 0.5, alike, -0.5, opposite);
  solver_dense_combine(&to->transmitted, 0.5, alike, 0.5, opposite);
  exchange(by, &to->reflected, &half->reflected, true);
  exchange(by, &to->transmitted, &half->transmitted, true);
  half->passed = creal(solver_dense_get(&to->transmitted, n, n));
  if (!double_up(by, half, halvings, PASSED_LEAST)) {
    return false;
  }
  exchange(by, &to->reflected, &half->reflected, false);
  exchange(by, &to->transmitted, &half->transmitted, false);
  solver_dense_put(&to->transmitted, n, n, half->passed);
  return true;
}

bool solver_layer_operators(const layer_operators *to, const expansion *of, double complex k,
                            double kappa, double depth) {
  const size_t n = of->n, size = solver_dense_size(n + 2, n + 2);
  struct memory memory;
  double *more = NULL;
  bool ok = reserve(&memory, of, k);
  if (ok && isinf(depth)) {
    solver_dense_clear(&to->reflected);
    solver_dense_clear(&to->reflected_once);
    relation half = {memory.half.transmitted, 0};
    ok = find_halfspace(&memory.work, &half, kappa) && scatter_once(&memory.work, &memory.once) &&
         reflect(&memory.work, &memory.half.reflected, &half);
    exchange(&memory.work, &to->reflected, &memory.half.reflected, false);
    for (size_t row = 0; row < n; row++) {
      solver_dense_put(&to->reflected_once, row, 0, solver_dense_get(&memory.once, row, 0));
    }
  } else if (ok) {
    more = aligned_alloc(ALIGNMENT_BYTES, (THIN * 2 * size * sizeof *more + ALIGNMENT_BYTES - 1) /
                                              ALIGNMENT_BYTES * ALIGNMENT_BYTES);
    ok = more != NULL;
    dense thin[THIN];
    double *next = more;
    for (size_t i = 0; i < THIN && ok; i++) {
      thin[i] = solver_dense_at(of->isa, &next, n + 2, n + 2, cimag(k) != 0);
    }
    ok = ok && find_layer(&memory.work, &memory.half, to, thin, depth);
  }
  free(more);
  free(memory.all);
  return ok;
}
