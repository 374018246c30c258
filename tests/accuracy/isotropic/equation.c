/* The source function S(z) of a beam e^(-z) solves, with the measures of nodes.c,
 *
 *   S(z) = a e^(-z) + a int_0^inf [K(|z - z'|) + (K - K_T)(z + z')] S(z') dz'.
 *
 * Without the second kernel a source e^(-pz) gives int_0^inf e^(-qz) S(z) dz = H(p) H(q) / (p + q)
 * (Chandrasekhar 1950 for k = 0; Rybicki 1971 for searchlights). So the Laplace transform of S is
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
#include <assert.h>
#include <math.h>
#include <stdlib.h>

#include "core/transport/functions.h"
#include "tests/accuracy/isotropic/parts.h"

/* ---- the H function -------------------------------------------------------------------------- */

/* With Q^2 = k^2 + w^2 and the dispersion function L(w) = ln(1 - a atan(Q) / Q),
 *
 *   ln H(p) = -(1 / pi) int_0^inf p L(w) / (p^2 + w^2) dw.
 *
 * L is even, so the integral is half of that over the whole line w = sigma sinh(y). The trapezoidal
 * rule with step h over y is exact up to e^(-2 pi d / h), where d is the distance from the real
 * axis to the next singularity in y. The singularities are the zero of the logarithm's argument at
 * w = +-i p0 with p0 = sqrt(k^2 + kappa^2), the branch points of atan at w = +-i sqrt(1 + k^2), and
 * the poles w = +-i p. sigma has the modulus of p0, and its direction lies half way between those
 * of the first two singularities; this keeps both at d > 1. The poles may come arbitrarily near,
 * because their contribution is known. By the theorem of residues (Trefethen and Weideman 2014 for
 * trapezoidal rules),
 *
 *   ln H(p) = -(h / 2 pi) sum over all j of p L(w_j) w'_j / (p^2 + w_j^2)
 *             + L(i p) / (e^(-2 pi i y* / h) - 1),     sinh(y*) = i p / sigma.
 */

/* least distance d from the line to a singularity other than the poles */
#define STRIP 1.05
#define BEYOND_LARGEST 100.0 /* the line ends at this multiple of the largest decay rate */
#define POLES_UP_TO 1.3      /* poles at a larger distance from the line are negligible */
enum { STEPS_MAX = 1024 };   /* the line needs at most about ln(1e12) / 0.2 steps */

/* The rule for ln H at one albedo and wavenumber. */
struct line {
  double albedo, cut, h; /* cut: argument of sigma */
  double complex k, sigma;
  size_t n;
  /* The terms of the sum for ln H(p), for j >= 0: w_j^2, and -(h / pi) L(w_j) w'_j, which counts the
   * terms of j and -j; half of that for j = 0. */
  double complex square[STEPS_MAX], weight[STEPS_MAX];
};

/* Returns ln(1 - a atan(Q) / Q) from Q^2. The principal branch of atan has its cut along Q^2 < -1.
 * This function turns the cut by 2 cut > 0 about Q^2 = -1, as far as make_line() turns the line w:
 * between the old cut and the new one it uses another branch of atan. Near Q = 0, where a may be 1,
 * it uses a series for 1 - atan(Q) / Q. */
static double complex dispersion(double albedo, double complex q2, double cut) {
  if (fabs(creal(q2)) + fabs(cimag(q2)) < 0.06) {
    double complex series = 0;
    for (int j = 13; j >= 1; j--) {
      series = q2 * ((j % 2 ? 1.0 : -1.0) / (2 * j + 1) + series);
    }
    return fn_clog((1 - albedo) + albedo * series);
  }
  const double complex q = fn_csqrt(q2);
  const double complex iq = CMPLX(-cimag(q), creal(q));
  double complex angle = CMPLX(0, -0.5) * (fn_clog(1 + iq) - fn_clog(1 - iq));
  if (cut > 0 && cimag(q2) < 0 && cimag(fn_clog(q2 + 1)) < 2 * cut - FN_PI) {
    angle -= FN_PI;
  }
  return fn_clog(1 - albedo * angle * fn_inverse(q));
}

/* p_max: the largest modulus of a decay rate of which log_h() is asked. */
static void make_line(struct line *to, double albedo, double kappa, double complex k, double p_max,
                      double accuracy) {
  const double complex log_p0 = 0.5 * fn_clog(k * k + kappa * kappa);
  const double scale = fn_exp(creal(log_p0));
  to->albedo = albedo;
  to->k = k;
  to->cut = 0.5 * (cimag(log_p0) + 0.5 * cimag(fn_clog(1 + k * k)));
  to->sigma = scale * fn_cexp(CMPLX(0, to->cut));
  to->h = 2 * FN_PI * STRIP / (2 - fn_log(accuracy));
  const double steps = 1 + fn_log(2 * BEYOND_LARGEST * p_max / scale) / to->h;
  to->n = steps < STEPS_MAX ? (size_t)steps : STEPS_MAX;
  for (size_t j = 0; j < to->n; j++) {
    const double e = fn_exp((double)j * to->h);
    const double complex w = to->sigma * (0.5 * (e - 1 / e));
    const double complex slope = to->sigma * (0.5 * (e + 1 / e));
    const double complex l = dispersion(albedo, k * k + w * w, 0);
    to->square[j] = w * w;
    to->weight[j] = (j == 0 ? -0.5 : -1.0) * to->h / FN_PI * l * slope;
  }
}

/* Returns the contribution of the pole, L(i p) / (e^(-2 pi i y* / h) - 1) with -i y* = asin(zeta)
 * and zeta = p / sigma. Of the two forms of asin, -+i ln(+-i zeta + sqrt(1 - zeta^2)), the code
 * uses the one whose sum does not cancel. */
static double complex pole(const struct line *of, double complex p) {
  const double complex zeta = p * fn_inverse(of->sigma);
  const double sign = cimag(zeta) > 0 ? -1 : 1;
  const double complex root = fn_csqrt(1 - zeta) * fn_csqrt(1 + zeta);
  const double complex asin_zeta = CMPLX(0, -sign) * fn_clog(CMPLX(0, sign) * zeta + root);
  if (creal(asin_zeta) > POLES_UP_TO) {
    return 0;
  }
  const double complex exponent = 2 * FN_PI / of->h * asin_zeta;
  return dispersion(of->albedo, of->k * of->k - p * p, of->cut) * fn_inverse(fn_cexpm1(exponent));
}

static double complex log_h(const struct line *of, double complex p) {
  const double complex square = p * p;
  double complex sum = 0;
  for (size_t j = 0; j < of->n; j++) {
    sum += of->weight[j] * fn_inverse(square + of->square[j]);
  }
  return p * sum + pole(of, p);
}

/* ---- the unknowns ---------------------------------------------------------------------------- */

enum { RANK_MAX = 160 };

/* Pivots are added until the rest of the kernel, weighed as in choose_pivots(), is at most this
 * times the accuracy. Comparisons with the full system show that the exitance is then off by less
 * than the accuracy. */
#define LEFT_OVER_PER_ACCURACY 30.0

/* The functions phi_1, phi_2, ..., phi_n, and what they make of the equation. */
struct unknowns {
  size_t n;
  double complex q[RANK_MAX], root[RANK_MAX];            /* pivots, and sqrt(2 q) */
  double re[RANK_MAX][RANK_MAX], im[RANK_MAX][RANK_MAX]; /* B_lm for m <= l */
  double complex row[RANK_MAX][RANK_MAX];                /* 1 - a B */
  double complex Y[RANK_MAX];                            /* b, and then the solution */
  double complex exit[RANK_MAX];                         /* sum of exit H phi_l */
};

/* Chooses the pivots: each is the node where the rest of the kernel, |kernel g^2 / p|, is largest. */
static void choose_pivots(struct unknowns *to, const nodes *at, double accuracy) {
  double complex g[sizeof at->p / sizeof at->p[0]];
  double share[sizeof at->p / sizeof at->p[0]], all = 0;
  for (size_t i = 0; i < at->n; i++) {
    g[i] = 1;
    share[i] = sqrt(fn_norm2(at->kernel[i]) / fn_norm2(at->p[i]));
    all += share[i];
  }
  for (to->n = 0; to->n < RANK_MAX; to->n++) {
    double most = 0, left = 0;
    double complex q = 1;
    for (size_t i = 0; i < at->n; i++) {
      const double here = share[i] * fn_norm2(g[i]);
      left += here;
      q = here > most ? at->p[i] : q;
      most = fmax(most, here);
    }
    if (left <= LEFT_OVER_PER_ACCURACY * accuracy * all) {
      break;
    }
    for (size_t i = 0; i < at->n; i++) {
      g[i] *= (at->p[i] - q) * fn_inverse(at->p[i] + q);
    }
    to->q[to->n] = q;
    to->root[to->n] = fn_csqrt(2 * q);
  }
}

/* Adds a node's terms. weight: kernel H^2; source: a H(1) / (1 + p); exit: exit H. */
static void add_node(struct unknowns *to, double complex p, double complex weight,
                     double complex source, double complex exit) {
  double re[RANK_MAX], im[RANK_MAX];
  double complex g = 1;
  for (size_t l = 0; l < to->n; l++) {
    const double complex quotient = g * fn_inverse(p + to->q[l]);
    const double complex phi = to->root[l] * quotient, weighted = weight * phi;
    g = (p - to->q[l]) * quotient;
    re[l] = creal(phi);
    im[l] = cimag(phi);
    to->Y[l] += source * weighted;
    to->exit[l] += exit * phi;
    for (size_t m = 0; m <= l; m++) {
      to->re[l][m] += creal(weighted) * re[m] - cimag(weighted) * im[m];
      to->im[l][m] += creal(weighted) * im[m] + cimag(weighted) * re[m];
    }
  }
}

/* Solves Y = b + a B Y by Gauss's elimination with partial pivoting. With some tens of unknowns no
 * library would be faster, and a library's bits would differ between machines. */
static void eliminate(struct unknowns *to, double albedo) {
  const size_t n = to->n;
  for (size_t l = 0; l < n; l++) {
    for (size_t m = 0; m <= l; m++) {
      to->row[l][m] = to->row[m][l] = (l == m ? 1 : 0) - albedo * CMPLX(to->re[l][m], to->im[l][m]);
    }
  }
  for (size_t column = 0; column < n; column++) {
    size_t largest = column;
    for (size_t l = column + 1; l < n; l++) {
      if (fn_norm2(to->row[l][column]) > fn_norm2(to->row[largest][column])) {
        largest = l;
      }
    }
    for (size_t m = column; m < n; m++) {
      const double complex kept = to->row[column][m];
      to->row[column][m] = to->row[largest][m];
      to->row[largest][m] = kept;
    }
    const double complex kept = to->Y[column];
    to->Y[column] = to->Y[largest];
    to->Y[largest] = kept;
    const double complex inverse = fn_inverse(to->row[column][column]);
    for (size_t l = column + 1; l < n; l++) {
      const double complex factor = to->row[l][column] * inverse;
      for (size_t m = column; m < n; m++) {
        to->row[l][m] -= factor * to->row[column][m];
      }
      to->Y[l] -= factor * to->Y[column];
    }
  }
  for (size_t l = n; l-- > 0;) {
    for (size_t m = l + 1; m < n; m++) {
      to->Y[l] -= to->row[l][m] * to->Y[m];
    }
    to->Y[l] *= fn_inverse(to->row[l][l]);
  }
}

/* The part of the exitance that does not contain the unknowns is, with h = H - 1,
 *
 *   sum of exit [H(p) a H(1) / (1 + p) - a / (1 + p)]
 *     = sum of exit a / (1 + p) [h(p) H(1) + h(1)].
 */
double complex isotropic_exitance(double eta, double accuracy, double complex k, double albedo,
                                  double kappa) {
  struct parts {
    nodes nodes;
    struct line line;
    struct unknowns unknowns;
  } *parts = calloc(1, sizeof *parts);
  assert(parts != NULL);
  const nodes *at = &parts->nodes;
  struct unknowns *unknowns = &parts->unknowns;
  isotropic_nodes(&parts->nodes, eta, accuracy, k);
  choose_pivots(unknowns, at, accuracy);
  double p_max = 1;
  for (size_t i = 0; i < at->n; i++) {
    p_max = fmax(p_max, fn_abs(at->p[i]));
  }
  make_line(&parts->line, albedo, kappa, k, p_max, accuracy);
  const double complex h_1 = fn_cexpm1(log_h(&parts->line, 1));
  double complex exitance = 0;
  for (size_t i = 0; i < at->n; i++) {
    const double complex log = log_h(&parts->line, at->p[i]), h = fn_cexpm1(log);
    const double complex source = albedo * fn_inverse(1 + at->p[i]);
    exitance += at->exit[i] * source * (h * (1 + h_1) + h_1);
    add_node(unknowns, at->p[i], at->kernel[i] * fn_cexp(2 * log), source * (1 + h_1),
             at->exit[i] * (1 + h));
  }
  eliminate(unknowns, albedo);
  for (size_t l = 0; l < unknowns->n; l++) {
    exitance += albedo * unknowns->exit[l] * unknowns->Y[l];
  }
  free(parts);
  return exitance;
}
