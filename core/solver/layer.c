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
 * The half space is the limit of a layer that is doubled again and again. The first one's
 * operators come from Cayley transforms with a step beta,
 *
 *   T +- R = 2 (1 + beta (W -+ V))^-1 - 1,   and so for the beam, with e = (1 - beta) / (1 + beta),
 *
 * so that the limit solves the expanded equations exactly, for any beta. With Fresnel's
 * reflectance F at the boundary the light on its way up is I- = (1 - R F)^-1 r, and <mu T psi>.I-
 * leaves. Diffuse light has the radiance T(mu) / <mu T> behind the boundary: R <mu T psi> / <mu T>
 * in place of r.
 *
 * All matrices have the signs of expansion.h and are symmetric; S has these signs on its diagonal.
 */
#include "core/solver/layer.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/solver/dense.h"
#include "core/transport/functions.h"

enum { DOUBLINGS_MAX = 60, ALIGNMENT_BYTES = 64, SPARE = 3 };

/* Doubling ends when no number of the layer's transmission is larger than this: the next doubling
 * would change the reflection by its square. */
#define TRANSMISSION_LEAST 1e-8

typedef struct layer {
  dense reflected, transmitted; /* R and r, T and t */
  double passed;                /* e */
} layer;

/* What one wavenumber needs. */
struct work {
  const expansion *of;
  double complex k;
  dense spare[SPARE], alike, opposite;
  double complex *closing; /* what orders above M add to the block of order M */
};

static void put(const dense *to, size_t row, size_t column, double complex value) {
  to->re[row * to->stride + column] = creal(value);
  if (to->im != NULL) {
    to->im[row * to->stride + column] = cimag(value);
  }
}

static double complex number_at(const dense *of, size_t row, size_t column) {
  const size_t at = row * of->stride + column;
  return CMPLX(of->re[at], of->im == NULL ? 0 : of->im[at]);
}

/* Sets to = x a + y b. `to` may be a or b. */
static void combine(const dense *to, double x, const dense *a, double y, const dense *b) {
  for (size_t i = 0; i < to->rows * to->stride; i++) {
    to->re[i] = x * a->re[i] + y * b->re[i];
    if (to->im != NULL) {
      to->im[i] = x * a->im[i] + y * b->im[i];
    }
  }
}

static void clear(const dense *of) {
  combine(of, 0, of, 0, of);
}

/* Adds factor S. */
static void add_signs(const expansion *of, const dense *to, double factor) {
  for (size_t m = 0; m <= of->orders; m++) {
    for (size_t row = of->first[m]; row < of->first[m + 1]; row++) {
      to->re[row * to->stride + row] += m % 2 == 0 ? factor : -factor;
    }
  }
}

static double largest(const dense *of) {
  double most = 0;
  for (size_t row = 0; row < of->rows; row++) {
    for (size_t i = 0; i < of->columns; i++) {
      const double complex value = number_at(of, row, i);
      most = fmax(most, fmax(fabs(creal(value)), fabs(cimag(value))));
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
static void fill(const struct work *by, const dense *to, const double *base, double beta) {
  const expansion *of = by->of;
  const size_t n = of->n, last = of->first[of->orders];
  for (size_t i = 0; i < n; i++) {
    for (size_t j = 0; j < n; j++) {
      double complex value = base[i * n + j] + by->k * of->slant[i * n + j];
      if (i >= last && j >= last) {
        value += by->closing[(i - last) * (n - last) + j - last];
      }
      put(to, i, j, beta * value);
    }
  }
  add_signs(of, to, 1);
}

/* Sets *to to the Cayley transform of W -+ V, whose part for k = 0 is `base`, with the beam's
 * column. The beam is scattered by b+ + sign b-. */
static bool transform(const struct work *by, const dense *to, const double *base, double sign,
                      double beta) {
  const expansion *of = by->of;
  const dense *a = &by->spare[0], *b = &by->spare[1];
  fill(by, a, base, beta);
  clear(b);
  add_signs(of, b, 1);
  for (size_t i = 0; i < of->n; i++) {
    const double source = of->source[0][i] + sign * of->source[1][i];
    b->re[i * b->stride + of->n] = of->albedo * beta / (1 + beta) * source;
  }
  if (!solver_dense_congruence(to, a, b, &by->spare[2])) {
    return false;
  }
  combine(to, 2, to, 0, to);
  add_signs(of, to, -1);
  return true;
}

/* Sets *to to T (1 - sign R)^-1 T with the column T (1 - sign R)^-1 (t + sign e r). */
static bool mirror(const struct work *by, const dense *to, const layer *of, double sign) {
  const dense *a = &by->spare[0], *b = &by->spare[1];
  const size_t n = by->of->n;
  combine(a, -sign, &of->reflected, 0, &of->reflected);
  add_signs(by->of, a, 1);
  combine(b, 1, &of->transmitted, 0, &of->transmitted);
  for (size_t row = 0; row < n; row++) {
    put(b, row, n, number_at(b, row, n) + sign * of->passed * number_at(&of->reflected, row, n));
  }
  return solver_dense_congruence(to, a, b, &by->spare[2]);
}

/* Doubles a layer until nothing passes it. */
static bool double_up(const struct work *by, layer *of) {
  const dense *r = &of->reflected, *t = &of->transmitted, *a = &by->alike, *o = &by->opposite;
  const size_t n = by->of->n;
  for (int i = 0; i < DOUBLINGS_MAX && !(largest(t) < TRANSMISSION_LEAST); i++) {
    if (!mirror(by, a, of, 1) || !mirror(by, o, of, -1)) {
      return false;
    }
    combine(r, 1, r, 0.5, a);
    combine(r, 1, r, -0.5, o);
    for (size_t row = 0; row < n; row++) {
      put(a, row, n, number_at(a, row, n) + 2 * of->passed * number_at(t, row, n));
    }
    combine(t, 0.5, a, 0.5, o);
    of->passed *= of->passed;
  }
  return largest(t) < TRANSMISSION_LEAST;
}

static bool find_halfspace(const struct work *by, layer *to, double kappa) {
  const expansion *of = by->of;
  const dense *r = &to->reflected, *t = &to->transmitted;
  /* the step: the geometric mean of the decay rates' reciprocals */
  const double modulus = fn_abs(by->k), degrees = (double)of->first[1];
  const double slow = sqrt(fn_abs(kappa * kappa + by->k * by->k));
  const double fast = sqrt(1 + modulus * modulus) * degrees * degrees;
  const double beta = 1 / sqrt(slow * fast);
  if (!transform(by, &by->alike, of->even, 1, beta) ||
      !transform(by, &by->opposite, of->odd, -1, beta)) {
    return false;
  }
  combine(r, 0.5, &by->alike, -0.5, &by->opposite);
  combine(t, 0.5, &by->alike, 0.5, &by->opposite);
  to->passed = (1 - beta) / (1 + beta);
  return double_up(by, to);
}

/* Sets the light on its way up that a beam makes in one scattering: (E + 1) I- = a b-. */
static bool scatter_once(const struct work *by, const dense *to) {
  const expansion *of = by->of;
  const dense *a = &by->spare[0];
  fill(by, a, of->unit, 1);
  clear(to);
  for (size_t i = 0; i < of->n; i++) {
    put(to, i, 0, of->albedo * of->source[1][i]);
  }
  return solver_dense_solve(a, to);
}

/* Sets the light on its way up, of a beam and of diffuse light, within a boundary. */
static bool light_up(const struct work *by, const dense *to, const layer *half, size_t boundary) {
  const expansion *of = by->of;
  const dense *a = &by->spare[0], *f = &by->spare[1];
  const double *exit = of->exit[boundary][0];
  clear(f);
  for (size_t row = 0; row < of->n; row++) {
    double complex diffuse = 0;
    for (size_t i = 0; i < of->n; i++) {
      f->re[row * f->stride + i] = of->reflection[boundary][row * of->n + i];
      diffuse += number_at(&half->reflected, row, i) * exit[i];
    }
    put(to, row, 0, number_at(&half->reflected, row, of->n));
    put(to, row, 1, diffuse / of->entering[boundary]);
  }
  dense square = half->reflected;
  square.columns = of->n;
  solver_dense_multiply(a, &square, f);
  combine(a, -1, a, 0, a);
  add_signs(of, a, 1);
  return solver_dense_solve(a, to);
}

bool solver_layer_halfspace(const expansion *of, double complex k, double kappa,
                            layer_exitance *exitance) {
  enum { MATRICES = 7 };
  const bool is_complex = cimag(k) != 0;
  const size_t n = of->n, last = n - of->first[of->orders];
  const size_t bytes = sizeof(double) * (MATRICES * 2 * solver_dense_size(n, n + 1) +
                                         4 * solver_dense_size(n, 2) + 2 * last * last);
  double *memory = aligned_alloc(ALIGNMENT_BYTES,
                                 (bytes + ALIGNMENT_BYTES - 1) / ALIGNMENT_BYTES * ALIGNMENT_BYTES);
  if (memory == NULL) {
    return false;
  }
  memset(memory, 0, bytes);
  double *next = memory;
  dense matrix[MATRICES];
  for (size_t i = 0; i < MATRICES; i++) {
    matrix[i] = solver_dense_at(of->isa, &next, n, n + 1, is_complex);
  }
  struct work by = {of, k, {matrix[0], matrix[1], matrix[2]}, matrix[3], matrix[4], NULL};
  by.spare[0].columns = n;
  layer half = {matrix[5], matrix[6], 0};
  const dense once = solver_dense_at(of->isa, &next, n, 2, is_complex);
  const dense lit = solver_dense_at(of->isa, &next, n, 2, is_complex);
  by.closing = (double complex *)next;
  close_orders(&by);
  bool ok = find_halfspace(&by, &half, kappa) && scatter_once(&by, &once);
  for (size_t i = 0; i < of->boundaries.count && ok; i++) {
    ok = light_up(&by, &lit, &half, i);
    exitance[i] = (layer_exitance){0};
    for (size_t row = 0; row < of->first[1] && ok; row++) {
      exitance[i].single += of->exit[i][0][row] * number_at(&once, row, 0);
      exitance[i].diffuse += of->exit[i][0][row] * number_at(&lit, row, 1);
      for (size_t part = 0; part <= of->boundaries.cones; part++) {
        exitance[i].part[part] +=
            of->exit[i][part][row] * (number_at(&lit, row, 0) - number_at(&once, row, 0));
      }
    }
  }
  free(memory);
  return ok;
}
