/* With u = I+ + I- and v = I+ - I-, and the beam as one more direction, the equations are v' = -Xm u
 * and u' = -Xp v. A layer of half a thickness whose far side is a mirror has v = A u at the other
 * one, where A is like tanh, and one whose far side has u = 0 has v = B u, where B is like coth. A
 * layer of twice this thickness has their harmonic and arithmetic mean,
 *
 *   A' = 2 (A^-1 + B^-1)^-1 = 2 A - A B'^-1 A,   B' = (A + B) / 2.
 *
 * Light that passes thick layers has its digits in D = B - A: with S = A + B, D' = D S^-1 D / 2 and
 * S' = S - D'. A layer begins as tanh x = 1 / (1 / x + 1 / (3 / x + x / 5)), x = h Xm / 2 with
 * Xp in turn. Over what has v = Z u, it has v = (S - D (S / 2 + Z)^-1 D / 2) u / 2.
 *
 * A half space has v = G u with G Xp G = Xm: G is the geometric mean of Xm and Xp^-1, which is the
 * limit of the same means (Newton's iteration for a square root),
 * where A and B may be scaled by any number and its reciprocal first. With Fresnel's reflectance F at the
 * boundary, and g the beam's column of G, the light on its way up is I- = -(1 - F + G (1 + F))^-1 g
 * times u of the beam, and <mu T psi>.I- leaves. Diffuse light has the radiance T(mu) / <mu T> behind the boundary: (1 -
 * G) <mu T psi> / <mu T> in place of -g. R = 2 (1 + G)^-1 - 1, r = -(1 + G)^-1 g.
 *
 * All matrices have the signs of expansion.h and are symmetric; S there has these signs on its
 * diagonal.
 */
#include "core/solver/layer.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/solver/level.h"
#include "core/transport/functions.h"

enum { ALIGNMENT_BYTES = 64, SPARE = LAYER_SPARE + 1 };

/* The matrices and inputs for one wavenumber. */
struct work {
  const expansion *of;
  double complex k;
  dense spare[SPARE], alike, opposite;
  /* what orders above M contribute to the block of order M of `even` and of `odd` */
  double complex *closing[2];
  const atomic_bool *stop;
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

static void close_orders(const struct work *by, size_t odd) {
  const expansion *of = by->of;
  const size_t at = of->first[of->orders], n = of->n - at;
  double complex *closing = by->closing[odd];
  memset(closing, 0, n * n * sizeof *closing);
  for (size_t node = 0; node < of->nodes && by->k != 0; node++) {
    const double mu = of->mu[node], alpha = of->alpha[1 - odd][node];
    const double complex streaming = fn_csqrt(
        alpha * alpha + by->k * by->k * ((1 - mu) * (1 + mu)) * (alpha / of->alpha[odd][node]));
    const double complex left =
        of->weight[node] * (of->orders % 2 == 0 ? 0.5 : -0.5) * (streaming - alpha);
    const double *psi = of->psi + node * of->n + at;
    for (size_t i = 0; i < n; i++) {
      for (size_t j = 0; j < n; j++) {
        closing[i * n + j] += left * (psi[i] * psi[j]);
      }
    }
  }
}

/* Sets to = S + beta (base + k C + closure). */
static void fill_matrix(const struct work *by, const dense *to, const double *base, size_t odd,
                        double beta) {
  const expansion *of = by->of;
  const size_t n = of->n, last = of->first[of->orders];
  for (size_t i = 0; i < n; i++) {
    for (size_t j = 0; j < n; j++) {
      double complex value = base[i * n + j] + by->k * of->slant[i * n + j];
      if (i >= last && j >= last) {
        value += by->closing[odd][(i - last) * (n - last) + j - last];
      }
      solver_dense_put(to, i, j, beta * value);
    }
  }
  add_signs(of, to, 1);
}

static void copy(const dense *to, const dense *from) {
  solver_dense_combine(to, 1, from, 0, from);
}

/* Sets *to to step times the base + sign k C + the closure, and the beam's column. */
static void fill_relation(const struct work *by, layer_relation *to, const double *base,
                          double sign, double step) {
  const expansion *of = by->of;
  struct work mirrored = *by;
  mirrored.k *= sign;
  fill_matrix(&mirrored, &to->all, base, sign < 0, step);
  add_signs(of, &to->all, -1);
  for (size_t i = 0; i < of->n; i++) {
    const double source = of->source[0][i] + sign * of->source[1][i];
    solver_dense_put(&to->all, i, of->n, -step * of->albedo * source);
  }
  to->beam = step * (base == of->unit ? 1 : 1 - sign * of->reversed);
}

/* Adds to column n of `to` the one of `from`, times `factor`. */
static void add_column(const dense *to, double factor, const dense *from) {
  const size_t n = to->rows;
  for (size_t row = 0; row < n; row++) {
    solver_dense_put(to, row, n,
                     solver_dense_get(to, row, n) + factor * solver_dense_get(from, row, n));
  }
}

/* Returns a spare matrix as one of another's shape. */
static dense shaped_like(const dense *spare, const dense *like) {
  dense made = *like;
  made.re = spare->re;
  made.im = like->im == NULL ? NULL : spare->im;
  return made;
}

bool solver_layer_weigh(const dense spare[LAYER_SPARE], layer_relation *to, const layer_relation *g,
                        const layer_relation *s) {
  dense a = shaped_like(&spare[0], &s->all);
  const dense b = shaped_like(&spare[1], &s->all), more = shaped_like(&spare[2], &s->all);
  const double ratio = g->beam / s->beam;
  copy(&a, &s->all);
  copy(&b, &g->all);
  add_column(&b, -ratio, &s->all);
  a.columns = a.rows;
  if (!solver_dense_congruence(&to->all, &a, &b, &more)) {
    return false;
  }
  add_column(&to->all, ratio, &g->all);
  to->beam = ratio * g->beam;
  return true;
}

void solver_layer_combine(layer_relation *to, double x, const layer_relation *a, double y,
                          const layer_relation *b) {
  solver_dense_combine(&to->all, x, &a->all, y, &b->all);
  to->beam = x * a->beam + y * b->beam;
}

/* Sets *to to 2 / (1 + from) - 1, which may be `from`: the reflectance, I- = S R I+, if `from` is a
 * relation, and the relation if it is a reflectance. */
static bool exchange(const dense spare[LAYER_SPARE], const expansion *of, layer_relation *to,
                     const layer_relation *from) {
  dense a = shaped_like(&spare[0], &from->all);
  const dense b = shaped_like(&spare[1], &from->all), more = shaped_like(&spare[2], &from->all);
  copy(&a, &from->all);
  add_signs(of, &a, 1);
  a.columns = a.rows;
  solver_dense_clear(&b);
  add_signs(of, &b, 1);
  add_column(&b, -1 / (1 + from->beam), &from->all);
  if (!solver_dense_congruence(&to->all, &a, &b, &more)) {
    return false;
  }
  solver_dense_combine(&to->all, 2, &to->all, 0, &to->all);
  add_signs(of, &to->all, -1);
  to->beam = (1 - from->beam) / (1 + from->beam);
  return true;
}

/* Multiplies the rows of a matrix by their signs. */
static void change_signs(const expansion *of, const dense *to) {
  for (size_t row = 0; row < of->n; row++) {
    for (size_t i = 0; i < to->columns && sign_of_row(of, row) < 0; i++) {
      solver_dense_put(to, row, i, -solver_dense_get(to, row, i));
    }
  }
}

bool solver_layer_reflect(const dense spare[LAYER_SPARE], const expansion *of, const dense *to,
                          const layer_relation *from) {
  layer_relation mirrored = {*to, 0};
  mirrored.all.rows = of->n;
  solver_dense_clear(to);
  const bool ok = exchange(spare, of, &mirrored, from);
  change_signs(of, &mirrored.all);
  solver_dense_put(to, of->n, of->n, mirrored.beam);
  return ok;
}

bool solver_layer_relate(const dense spare[LAYER_SPARE], const expansion *of, layer_relation *to,
                         const dense *from) {
  dense rows = *from;
  rows.rows = of->n;
  copy(&to->all, &rows);
  to->beam = creal(solver_dense_get(from, of->n, of->n));
  change_signs(of, &to->all);
  return exchange(spare, of, to, to);
}

void solver_layer_apply(const dense *v, const expansion *of, const layer_relation *relation,
                        const dense *u) {
  dense rows = *v;
  rows.rows = of->n;
  solver_dense_multiply(&rows, &relation->all, u);
  change_signs(of, &rows);
  solver_dense_put(v, of->n, 0, relation->beam * solver_dense_get(u, of->n, 0));
}

static bool invert(const struct work *by, layer_relation *to, const layer_relation *of) {
  layer_relation one = {by->spare[3], 1};
  solver_dense_clear(&one.all);
  for (size_t i = 0; i < by->of->n; i++) {
    one.all.re[i * one.all.stride + i] = 1;
  }
  return solver_layer_weigh(by->spare, to, &one, of);
}

enum { MEANS_MAX = 60 };

/* Means that differ by this little, where the limit is some 1, are off by its square. */
#define MEANS_APART 1e-5

/* Sets *to to the relation of a half space: the limit of the means of two. */
static bool find_halfspace(const struct work *by, layer_relation *to, double kappa) {
  const expansion *of = by->of;
  layer_relation a = {by->alike, 0}, b = {by->opposite, 0}, apart = {by->spare[3], 0};
  layer_relation mean = *to;
  /* The first pair has the decay rates, times a step, and their reciprocals. Of many media, this
   * step and these scales of the next pairs led to the fewest means. */
  enum { SCALES = 3 };
  static const double scales[SCALES] = {1, 0.31, 0.78};
  const double modulus = fn_abs(by->k), degrees = (double)of->first[1];
  const double slow = fmin(1, sqrt(fn_abs(kappa * kappa + by->k * by->k)));
  const double step = 2 / (degrees * sqrt(slow) * sqrt((1 + modulus) * sqrt(1 + modulus)));
  fill_relation(by, &a, of->even, 1, step);
  fill_relation(by, &b, of->odd, -1, step);
  if (!invert(by, &b, &b)) {
    return false;
  }
  for (size_t i = 0; i < MEANS_MAX; i++) {
    const double scale = i < SCALES ? scales[i] : 1;
    solver_layer_combine(&mean, 0.5 * scale, &a, 0.5 / scale, &b);
    if (i >= SCALES) {
      solver_layer_combine(&apart, 1, &a, -1, &b);
      if (largest(&apart.all) < MEANS_APART) {
        solver_layer_combine(to, 1, &mean, 0, &mean);
        return true;
      }
    }
    if (solver_stops(by->stop) || !solver_layer_weigh(by->spare, &b, &a, &mean)) {
      return false;
    }
    solver_layer_combine(&b, 2 * scale, &a, -scale * scale, &b);
    const layer_relation before = a;
    a = mean;
    mean = before;
  }
  return false;
}

/* Sets the upward light of a beam after one scattering: (E + 1) I- = a b-. */
static bool scatter_once(const struct work *by, const dense *to) {
  const expansion *of = by->of;
  const dense *a = &by->spare[0];
  fill_matrix(by, a, of->unit, 0, 1);
  solver_dense_clear(to);
  for (size_t i = 0; i < of->n; i++) {
    solver_dense_put(to, i, 0, of->albedo * of->source[1][i]);
  }
  return solver_dense_solve(a, to);
}

bool solver_layer_light_up(const dense spare[LAYER_SPARE], const expansion *of, const dense *to,
                           const layer_relation *under, size_t boundary) {
  const dense a = shaped_like(&spare[0], &under->all), f = shaped_like(&spare[1], &under->all);
  const double *exit = of->exit[boundary][0];
  solver_dense_clear(&f);
  for (size_t row = 0; row < of->n; row++) {
    double complex diffuse = sign_of_row(of, row) * exit[row];
    for (size_t i = 0; i < of->n; i++) {
      f.re[row * f.stride + i] = of->reflection[boundary][row * of->n + i];
      diffuse -= solver_dense_get(&under->all, row, i) * exit[i];
    }
    solver_dense_put(to, row, 0, -solver_dense_get(&under->all, row, of->n));
    solver_dense_put(to, row, 1, diffuse / of->entering[boundary]);
  }
  dense square = under->all, left = a;
  square.columns = left.columns = of->n;
  solver_dense_multiply(&a, &square, &f);
  solver_dense_combine(&a, 1, &a, 1, &under->all);
  for (size_t row = 0; row < of->n; row++) {
    const double sign = sign_of_row(of, row);
    for (size_t i = 0; i < of->n; i++) {
      a.re[row * a.stride + i] -= sign * f.re[row * f.stride + i];
    }
    a.re[row * a.stride + row] += sign;
  }
  return solver_dense_solve(&left, to);
}

/* Memory for one wavenumber. */
enum { MATRICES = SPARE + 3 };
struct memory {
  double *all;
  struct work work;
  dense half;
  dense once, lit; /* [n][2] */
};

static bool reserve(struct memory *to, const expansion *of, double complex k) {
  const bool is_complex = cimag(k) != 0;
  const size_t n = of->n, last = n - of->first[of->orders];
  const size_t bytes = sizeof(double) * (MATRICES * 2 * solver_dense_size(n + 1, n + 1) +
                                         4 * solver_dense_size(n, 2) + 4 * last * last);
  to->all = aligned_alloc(ALIGNMENT_BYTES,
                          (bytes + ALIGNMENT_BYTES - 1) / ALIGNMENT_BYTES * ALIGNMENT_BYTES);
  if (to->all == NULL) {
    return false;
  }
  memset(to->all, 0, bytes);
  double *next = to->all;
  dense matrix[MATRICES];
  for (size_t i = 0; i < MATRICES; i++) {
    matrix[i] = solver_dense_at(of->isa, &next, n + 1, n + 1, is_complex);
    matrix[i].rows = n;
  }
  to->work = (struct work){of,        k,         {matrix[0], matrix[1], matrix[2], matrix[3]},
                           matrix[4], matrix[5], {NULL, NULL},
                           NULL};
  to->work.spare[0].columns = n;
  to->half = matrix[6];
  to->once = solver_dense_at(of->isa, &next, n, 2, is_complex);
  to->lit = solver_dense_at(of->isa, &next, n, 2, is_complex);
  for (size_t odd = 0; odd < 2; odd++, next += 2 * last * last) {
    to->work.closing[odd] = (double complex *)next;
    close_orders(&to->work, odd);
  }
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
  layer_relation half = {memory.half, 0};
  bool ok = find_halfspace(by, &half, kappa) && scatter_once(by, once);
  const double back = (1 - half.beam) / (1 + half.beam);
  for (size_t i = 0; i < of->boundaries.count && ok; i++) {
    ok = solver_layer_light_up(by->spare, of, lit, &half, i);
    const double r0 = solver_beam_reflectance(of->boundaries.etas[i], 1);
    const double down = 1 / (1 - r0 * back), u = (1 + back) * down;
    exitance[i] = (layer_exitance){.beam = (1 - r0) * (back * down - 0.5 * of->reversed)};
    for (size_t row = 0; row < of->first[1] && ok; row++) {
      exitance[i].diffuse += of->exit[i][0][row] * solver_dense_get(lit, row, 1);
      for (size_t part = 0; part <= of->boundaries.cones; part++) {
        exitance[i].part[part] += of->exit[i][part][row] * (u * solver_dense_get(lit, row, 0) -
                                                            solver_dense_get(once, row, 0));
      }
    }
  }
  free(memory.all);
  return ok;
}

/* ---- layers of finite thickness ------------------------------------------------------------ */

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
static void double_once(const struct work *by, const layer_operators *to, const dense *spare) {
  const size_t n = to->passed_once.rows - 1;
  const double passed = creal(solver_dense_get(&to->passed_once, n, n));
  const dense back = to->reflected_once, twice = shaped_like(spare, &to->passed_once);
  const dense more = shaped_like(spare, &back);
  solver_dense_put(&back, n, 0, 0);
  solver_dense_multiply(&more, &to->passed_once, &back);
  solver_dense_combine(&back, 1, &back, passed, &more);
  solver_dense_square(&twice, &to->passed_once);
  dense mirrored = twice;
  mirrored.rows = n;
  change_signs(by->of, &mirrored);
  solver_dense_mirror(&mirrored);
  change_signs(by->of, &mirrored);
  copy(&to->passed_once, &twice);
}

/* Sets A and B of a thin layer, half of which is `step` thick (see the head of this file). */
static bool begin_layer(const struct work *by, layer_relation *a, layer_relation *b,
                        layer_relation *sum, const double *even, const double *odd, double step) {
  layer_relation x = {by->alike, 0};
  fill_relation(by, &x, even, 1, step);
  fill_relation(by, b, odd, -1, step);
  if (!invert(by, b, b)) {
    return false;
  }
  solver_layer_combine(sum, 1.2, &x, 3, b);
  if (!solver_layer_weigh(by->spare, a, &x, sum)) {
    return false;
  }
  solver_layer_combine(a, 1, &x, -1, a);
  solver_layer_combine(sum, 1, &x, 15, b);
  if (!solver_layer_weigh(by->spare, sum, &x, sum)) {
    return false;
  }
  solver_layer_combine(&x, 1, &x, -1, sum);
  solver_layer_combine(b, 1, b, 1.0 / 3, &x);
  return true;
}

/* Sets what a layer scatters at most once: light is not scattered again, so that it passes and is not
 * reflected. */
static bool find_once(const struct work *by, layer_operators *to, double step, int halvings) {
  const expansion *of = by->of;
  layer_relation *sum = &to->sum, *a = &to->apart, b = {by->opposite, 0};
  if (!begin_layer(by, a, &b, sum, of->unit, of->unit, step) || !exchange(by->spare, of, a, a) ||
      !exchange(by->spare, of, &b, &b)) {
    return false;
  }
  dense passed = to->passed_once;
  passed.rows = of->n;
  solver_dense_clear(&to->passed_once);
  solver_dense_combine(&passed, 0.5, &a->all, -0.5, &b.all);
  change_signs(of, &passed);
  solver_dense_put(&to->passed_once, of->n, of->n, 0.5 * (a->beam - b.beam));
  solver_layer_combine(sum, 0.5, a, 0.5, &b);
  for (size_t row = 0; row < of->n; row++) {
    solver_dense_put(&to->reflected_once, row, 0,
                     sign_of_row(of, row) * solver_dense_get(&sum->all, row, of->n));
  }
  for (int i = 0; i < halvings && !solver_stops(by->stop); i++) {
    double_once(by, to, &by->spare[0]);
  }
  return !solver_stops(by->stop);
}

/* Light that passes a layer is not followed below this share. */
#define PASSED_LEAST 1e-20

static bool find_layer(const struct work *by, layer_operators *to, double depth) {
  const expansion *of = by->of;
  const int halvings = halvings_of(of, by->k, depth);
  const double step = 0.5 * ldexp(depth, -halvings);
  layer_relation *sum = &to->sum, *a = &to->apart, b = {by->opposite, 0};
  if (!find_once(by, to, step, halvings) || !begin_layer(by, a, &b, sum, of->even, of->odd, step)) {
    return false;
  }
  int i = 0;
  for (; i < halvings && ldexp(step, i) * (1 + fn_abs(by->k)) < 0.5; i++) {
    solver_layer_combine(sum, 0.5, a, 0.5, &b);
    if (solver_stops(by->stop) || !solver_layer_weigh(by->spare, &b, a, sum)) {
      return false;
    }
    solver_layer_combine(a, 2, a, -1, &b);
    solver_layer_combine(&b, 1, sum, 0, sum);
  }
  solver_layer_combine(sum, 1, a, 1, &b);
  solver_layer_combine(a, -1, a, 1, &b);
  for (; i < halvings && largest(&a->all) > PASSED_LEAST; i++) {
    if (solver_stops(by->stop) || !solver_layer_weigh(by->spare, &b, a, sum)) {
      return false;
    }
    solver_layer_combine(a, 0.5, &b, 0, &b);
    solver_layer_combine(sum, 1, sum, -1, a);
  }
  return true;
}

bool solver_layer_operators(layer_operators *to, const expansion *of, double complex k,
                            double kappa, double depth, const atomic_bool *stop) {
  struct memory memory;
  bool ok = reserve(&memory, of, k);
  memory.work.stop = stop;
  if (ok && isinf(depth)) {
    solver_dense_clear(&to->reflected_once);
    ok = find_halfspace(&memory.work, &to->sum, kappa) && scatter_once(&memory.work, &memory.once);
    for (size_t row = 0; row < of->n; row++) {
      solver_dense_put(&to->reflected_once, row, 0, solver_dense_get(&memory.once, row, 0));
    }
  } else if (ok) {
    ok = find_layer(&memory.work, to, depth);
  }
  free(memory.all);
  return ok;
}
