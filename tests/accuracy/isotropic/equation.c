/* The source function S(z) of a beam e^(-z) solves, with the measures of nodes.h,
 *
 *   S(z) = a e^(-z) + a int_0^inf [K(|z - z'|) + (K - K_T)(z + z')] S(z') dz'.
 *
 * The H function inverts the part with the first kernel. The Laplace transform of S is then
 * int_0^inf e^(-qz) S dz = H(q) V(q), where V is smooth because H contains the diffusion mode:
 *
 *   V(q) = a H(1) / (1 + q) + a sum over nodes p of kernel H(p)^2 V(p) / (p + q).
 *
 * The matrix 1 / (p + q) has a low rank on the nodes. With pivots q_1, q_2, ... among the nodes and
 *
 *   g_1(p) = 1,   g_(l+1)(p) = g_l(p) (p - q_l) / (p + q_l),
 *   phi_l(p) = g_l(p) sqrt(2 q_l) / (p + q_l)
 *
 * (Takenaka 1925, Malmquist 1926), elimination gives the identity
 *
 *   1 / (p + q) = sum over l <= n of phi_l(p) phi_l(q) + g_(n+1)(p) g_(n+1)(q) / (p + q).
 *
 * So V(q) = a H(1) / (1 + q) + a sum over l of phi_l(q) Y_l with n unknowns Y_l, which solve
 *
 *   Y = b + a B Y,
 *   B_lm = sum of kernel H^2 phi_l phi_m,   b_l = sum of kernel H^2 phi_l a H(1) / (1 + p).
 *
 * The exitance of S is the sum of exit H V. The light scattered once contributes the sum of exit a
 * / (1 + p). The code leaves this part out of each term, because for large k it is by far the
 * larger part.
 */
#include "tests/accuracy/isotropic/equation.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/transport/functions.h"
#include "tests/accuracy/isotropic/h_function.h"

/* Pivots are added until the rest of the kernel, weighed as in choose_pivots(), is at most this
 * times the accuracy. Comparisons with the full system show that the exitance is then off by less
 * than the accuracy. */
#define LEFT_OVER_PER_ACCURACY 30.0

/* ---- what does not depend on the albedo ----------------------------------------------------- */

/* Chooses the pivots: each is the node where the rest of the kernel, |kernel g^2 / p|, is largest.
 * Returns false if memory runs out. */
static bool choose_pivots(equation *to) {
  const nodes *at = &to->nodes;
  double complex *g = malloc(at->n * (sizeof *g + sizeof(double)));
  if (g == NULL) {
    return false;
  }
  double *share = (double *)(g + at->n);
  double all = 0;
  for (size_t i = 0; i < at->n; i++) {
    g[i] = 1;
    share[i] = sqrt(fn_norm2(at->kernel[i]) / fn_norm2(at->p[i]));
    all += share[i];
  }
  double left = all;
  for (to->rank = 0; to->rank < EQUATION_RANK_MAX; to->rank++) {
    double most = 0;
    left = 0;
    for (size_t i = 0; i < at->n; i++) {
      const double here = share[i] * fn_norm2(g[i]);
      left += here;
      if (here > most) {
        most = here;
        to->pivot[to->rank] = (uint16_t)i;
      }
    }
    if (left <= LEFT_OVER_PER_ACCURACY * to->accuracy * all) {
      break;
    }
    const double complex q = at->p[to->pivot[to->rank]];
    for (size_t i = 0; i < at->n; i++) {
      g[i] *= (at->p[i] - q) * fn_inverse(at->p[i] + q);
    }
  }
  free(g);
  return true;
}

bool isotropic_equation_make(equation *to, const nodes_rules *rules, double complex k) {
  to->k = k;
  to->accuracy = rules->accuracy;
  if (!isotropic_nodes_make(&to->nodes, rules, k)) {
    return false;
  }
  if (!choose_pivots(to)) {
    isotropic_nodes_free(&to->nodes);
    return false;
  }
  return true;
}

void isotropic_equation_free(equation *of) {
  isotropic_nodes_free(&of->nodes);
}

/* ---- the unknowns' equation ----------------------------------------------------------------- */

/* Loops handle GROUP numbers at a time, which compilers turn into vectors. Rows are filled with
 * zeros to a multiple of GROUP. */
enum { GROUP = 4, RANK_PADDED = (EQUATION_RANK_MAX + GROUP - 1) / GROUP * GROUP };

struct isotropic_work {
  h_function *h;
  size_t nodes_reserved;
  size_t cells_reserved; /* number of nodes times number of functions phi */
  double complex *log_h;
  /* Arrays by node, with real and imaginary parts apart: phi contains phi_1, phi_2, ..., and
   * weighted contains kernel H^2 phi_1, kernel H^2 phi_2, ... All four share the block that phi_re
   * points to. */
  double *phi_re, *phi_im, *weighted_re, *weighted_im;
  double matrix_re[RANK_PADDED][RANK_PADDED];
  double matrix_im[RANK_PADDED][RANK_PADDED];
  double complex right[RANK_PADDED];
  double complex exit[RANK_PADDED]; /* sum of exit H phi_l */
};

isotropic_work *isotropic_work_new(void) {
  isotropic_work *work = calloc(1, sizeof *work);
  if (work != NULL && (work->h = isotropic_h_new()) == NULL) {
    free(work);
    return NULL;
  }
  return work;
}

void isotropic_work_free(isotropic_work *of) {
  if (of != NULL) {
    isotropic_h_free(of->h);
    free(of->log_h);
    free(of->phi_re);
    free(of);
  }
}

static bool reserve(isotropic_work *work, size_t count, size_t padded) {
  if (count > work->nodes_reserved) {
    double complex *log_h = realloc(work->log_h, (count + 1) * sizeof *log_h);
    if (log_h == NULL) {
      return false;
    }
    work->log_h = log_h;
    work->nodes_reserved = count;
  }
  const size_t cells = count * padded;
  if (cells > work->cells_reserved) {
    double *block = malloc(4 * cells * sizeof *block);
    if (block == NULL) {
      return false;
    }
    free(work->phi_re);
    work->phi_re = block;
    work->phi_im = block + cells;
    work->weighted_re = block + 2 * cells;
    work->weighted_im = block + 3 * cells;
    work->cells_reserved = cells;
  }
  return true;
}

/* Fills a row for each node with phi_l, and another one with kernel H^2 phi_l. */
static void fill_rows(const equation *of, isotropic_work *work, size_t padded) {
  const nodes *at = &of->nodes;
  double complex q[RANK_PADDED], root[RANK_PADDED];
  for (size_t l = 0; l < of->rank; l++) {
    q[l] = at->p[of->pivot[l]];
    root[l] = fn_csqrt(2 * q[l]);
  }
  for (size_t i = 0; i < at->n; i++) {
    const double complex weight = at->kernel[i] * fn_cexp(2 * work->log_h[i]);
    double complex g = 1;
    for (size_t l = 0; l < padded; l++) {
      double complex phi = 0;
      if (l < of->rank) {
        const double complex quotient = g * fn_inverse(at->p[i] + q[l]);
        phi = root[l] * quotient;
        g = (at->p[i] - q[l]) * quotient;
      }
      const double complex weighted = weight * phi;
      work->phi_re[i * padded + l] = creal(phi);
      work->phi_im[i * padded + l] = cimag(phi);
      work->weighted_re[i * padded + l] = creal(weighted);
      work->weighted_im[i * padded + l] = cimag(weighted);
    }
  }
}

/* Computes rows l and l + 1 of the matrix 1 - a B, columns m to m + GROUP - 1, and their mirror
 * images. */
static void fill_tile(isotropic_work *work, size_t n, size_t padded, double albedo, size_t l,
                      size_t m) {
  double re[2][GROUP] = {{0}}, im[2][GROUP] = {{0}};
  for (size_t i = 0; i < n; i++) {
    const double *phi_re = work->phi_re + i * padded + m;
    const double *phi_im = work->phi_im + i * padded + m;
    for (size_t row = 0; row < 2; row++) {
      const double by_re = work->weighted_re[i * padded + l + row];
      const double by_im = work->weighted_im[i * padded + l + row];
      for (size_t c = 0; c < GROUP; c++) {
        re[row][c] += by_re * phi_re[c] - by_im * phi_im[c];
        im[row][c] += by_re * phi_im[c] + by_im * phi_re[c];
      }
    }
  }
  for (size_t row = 0; row < 2; row++) {
    for (size_t c = 0; c < GROUP; c++) {
      const size_t to_row = l + row, column = m + c;
      const double one = to_row == column ? 1 : 0;
      work->matrix_re[to_row][column] = work->matrix_re[column][to_row] = one - albedo * re[row][c];
      work->matrix_im[to_row][column] = work->matrix_im[column][to_row] = -albedo * im[row][c];
    }
  }
}

static void fill_matrix(isotropic_work *work, size_t n, size_t padded, double albedo) {
  for (size_t l = 0; l < padded; l += 2) {
    for (size_t m = l / GROUP * GROUP; m < padded; m += GROUP) {
      fill_tile(work, n, padded, albedo, l, m);
    }
  }
}

/* Subtracts factor times row `from` from row `to`, from the column `first`, rounded down to a
 * multiple of GROUP, on. Nothing uses the columns before `first` any more. */
static void subtract_row(isotropic_work *work, size_t padded, size_t to, size_t from, size_t first,
                         double complex factor) {
  const double re = creal(factor);
  const double im = cimag(factor);
  for (size_t m = first / GROUP * GROUP; m < padded; m += GROUP) {
    double *to_re = work->matrix_re[to] + m, *to_im = work->matrix_im[to] + m;
    const double *from_re = work->matrix_re[from] + m, *from_im = work->matrix_im[from] + m;
    for (size_t c = 0; c < GROUP; c++) {
      to_re[c] -= re * from_re[c] - im * from_im[c];
      to_im[c] -= re * from_im[c] + im * from_re[c];
    }
  }
  work->right[to] -= factor * work->right[from];
}

static double complex element(const isotropic_work *work, size_t l, size_t m) {
  return CMPLX(work->matrix_re[l][m], work->matrix_im[l][m]);
}

static void swap_rows(isotropic_work *work, size_t padded, size_t one, size_t other) {
  for (size_t m = 0; m < padded; m++) {
    const double re = work->matrix_re[one][m];
    const double im = work->matrix_im[one][m];
    work->matrix_re[one][m] = work->matrix_re[other][m];
    work->matrix_im[one][m] = work->matrix_im[other][m];
    work->matrix_re[other][m] = re;
    work->matrix_im[other][m] = im;
  }
  const double complex right = work->right[one];
  work->right[one] = work->right[other];
  work->right[other] = right;
}

/* Solves the system by Gauss's elimination with partial pivoting; work->right becomes the solution.
 * With some tens of unknowns no library would be faster, and a library's bits would differ between
 * machines. */
static void eliminate(isotropic_work *work, size_t rank, size_t padded) {
  for (size_t column = 0; column < rank; column++) {
    size_t largest = column;
    for (size_t l = column + 1; l < rank; l++) {
      if (fn_norm2(element(work, l, column)) > fn_norm2(element(work, largest, column))) {
        largest = l;
      }
    }
    if (largest != column) {
      swap_rows(work, padded, column, largest);
    }
    const double complex inverse = fn_inverse(element(work, column, column));
    for (size_t l = column + 1; l < rank; l++) {
      subtract_row(work, padded, l, column, column, element(work, l, column) * inverse);
    }
  }
  for (size_t l = rank; l-- > 0;) {
    double complex rest = work->right[l];
    for (size_t m = l + 1; m < rank; m++) {
      rest -= element(work, l, m) * work->right[m];
    }
    work->right[l] = rest * fn_inverse(element(work, l, l));
  }
}

/* ---- solving -------------------------------------------------------------------------------- */

/* Returns the part of the exitance that does not contain the unknowns, with h = H - 1:
 *
 *   sum of exit [H(p) a H(1) / (1 + p) - a / (1 + p)]
 *     = sum of exit a / (1 + p) [h(p) H(1) + h(1)].
 */
static double complex first_terms(const equation *of, const isotropic_work *work, double albedo) {
  const nodes *at = &of->nodes;
  const double complex h_1 = fn_cexpm1(work->log_h[at->n]);
  double complex sum = 0;
  for (size_t i = 0; i < at->n; i++) {
    if (at->exit[i] != 0) {
      const double complex h = fn_cexpm1(work->log_h[i]);
      sum += at->exit[i] * (h * (1 + h_1) + h_1) * fn_inverse(1 + at->p[i]);
    }
  }
  return albedo * sum;
}

/* Sets work->right to b_l and work->exit to the sums of exit H phi_l. */
static void fill_vectors(const equation *of, isotropic_work *work, size_t padded, double albedo) {
  const nodes *at = &of->nodes;
  const double complex h_1 = fn_cexp(work->log_h[at->n]);
  memset(work->right, 0, sizeof work->right);
  memset(work->exit, 0, sizeof work->exit);
  for (size_t i = 0; i < at->n; i++) {
    const double complex source = albedo * h_1 * fn_inverse(1 + at->p[i]);
    const double complex exit = at->exit[i] * fn_cexp(work->log_h[i]);
    for (size_t l = 0; l < of->rank; l++) {
      const size_t here = i * padded + l;
      work->right[l] += source * CMPLX(work->weighted_re[here], work->weighted_im[here]);
      work->exit[l] += exit * CMPLX(work->phi_re[here], work->phi_im[here]);
    }
  }
}

bool isotropic_equation_solve(const equation *of, isotropic_work *work, double albedo, double kappa,
                              double complex *exitance) {
  const nodes *at = &of->nodes;
  const size_t padded = (of->rank + GROUP - 1) / GROUP * GROUP;
  if (!reserve(work, at->n, padded)) {
    return false;
  }
  double p_max = 1;
  for (size_t i = 0; i < at->n; i++) {
    p_max = fmax(p_max, sqrt(fn_norm2(at->p[i])));
  }
  const double complex source = 1;
  isotropic_h_set(work->h, albedo, kappa, of->k, p_max, of->accuracy);
  isotropic_h_log(work->h, at->n, at->p, work->log_h);
  isotropic_h_log(work->h, 1, &source, work->log_h + at->n);
  *exitance = first_terms(of, work, albedo);
  if (of->rank > 0) {
    fill_rows(of, work, padded);
    fill_matrix(work, at->n, padded, albedo);
    fill_vectors(of, work, padded, albedo);
    eliminate(work, of->rank, padded);
    double complex sum = 0;
    for (size_t l = 0; l < of->rank; l++) {
      sum += work->exit[l] * work->right[l];
    }
    *exitance += albedo * sum;
  }
  return true;
}
