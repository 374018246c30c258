/* The intensity at a depth z is expanded on each hemisphere in the functions e_m(phi) psi_mj(mu),
 * with e_0 = 1 / sqrt(2 pi), e_m = cos(m phi) / sqrt(pi), and psi_mj = (1 - mu^2)^(m/2) times a
 * polynomial of degree j. They are orthonormal with the weight mu, mu from 0 to 1. Coefficients of
 * mode m are multiplied by (-i)^m. Then the Fourier transformed equations are
 *
 *   I+' = -W I+ + V I- + a b+ e^(-z),     W -+ V = E - a (P++ +- P+-),
 *  -I-' = -W I- + V I+ + a b- e^(-z),
 *
 * where I+ is the light on its way down and I- the light on its way up,
 *
 *   E = <psi psi> + k C,   C = +-<psi sqrt(1 - mu^2) psi> between m and m + 1 (antisymmetric),
 *   P++ +- P+- = 2 sum over l + m even (odd) of g_l t_l t_l^T,   t_lj = <psi_mj Theta_lm>,
 *   b+-_j = sum over l of (+-1)^l g_l t_lj sqrt((2 l + 1) / 2),   m = 0 only.
 *
 * For real k all of these are real.
 *
 * Orders above M are eliminated as if they were not scattered, with a rate alpha that all of them
 * share: their continued fraction adds the matrix of (sqrt(alpha^2 + k^2 (1 - mu^2)) - alpha) / 2
 * to the block m = M of E.
 *
 * The reflection rho of the half space is the limit of a thin layer that is doubled again and
 * again. The layer's operators come from Cayley transforms with a step beta, so that the limit
 * solves the expanded equations exactly, for any beta. With I-(0) = rho I+(0) + r_b, and with
 * Fresnel's reflectance between I-(0) and I+(0), both systems of linear equations follow:
 *
 *   (W + 1 - rho V) r_b = a (b- + rho b+),   (1 - rho F) I- = r_b,   exitance = <mu T psi>.I-.
 *
 * Diffuse light has the radiance T(mu) / <mu T> behind the boundary, per power that has entered:
 * (1 - rho F) I- = rho <mu T psi> / <mu T>.
 *
 * rho and r_b do not depend on eta.
 *
 * Of diffuse light that was scattered once, only m = 0 leaves at k = 0. In place of rho it has the
 * integral X of e^(-Uz) V e^(-Uz) over the depth z, U = <psi psi>. It solves U X + X U = V, and with
 * A = 2 (1 + beta U)^-1 - 1 also X = A X A + beta / 2 (A + 1) V (A + 1) (Smith 1968), which doubling
 * solves: X += A X A, A = A A.
 */
#include "core/transport/halfspace.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/transport/dense.h"
#include "core/transport/functions.h"
#include "core/transport/gauss.h"
#include "core/transport/single.h"

enum { ORDERS_MAX = 40, DEGREES_MAX = 72, DOUBLINGS_MAX = 60, ALIGNMENT_BYTES = 64 };

/* Doubling ends when no number of the layer's transmission is larger than this: the next doubling
 * would change the reflection by its square. */
#define TRANSMISSION_LEAST 1e-8
/* Fresnel's transmittance is integrated over panels that halve towards the grazing angle. */
enum { FRESNEL_PANELS = 14, FRESNEL_NODES = 16 };

/* Real blocks: one for each order, its numbers row by row. */
typedef struct blocks {
  double *order[ORDERS_MAX + 1];
} blocks;

struct halfspace {
  const core_isa *isa;
  halfspace_medium medium;
  size_t orders;
  size_t n;
  size_t degrees[ORDERS_MAX + 1];
  size_t first[ORDERS_MAX + 2];
  gauss_rule rule;
  double *tables; /* what the pointers of the blocks point into */
  blocks psi;     /* [degree][node] */
  blocks unit;    /* <psi psi> */
  blocks slant;   /* <psi_m sqrt(1 - mu^2) psi_(m+1)> times 1 / sqrt 2 for m = 0, otherwise 1 / 2 */
  blocks even;    /* 2 sum over l + m even of g_l t_l t_l^T */
  blocks odd;
  double source[2][DEGREES_MAX]; /* b+, b- */
  double alpha_left[DEGREES_MAX], beta_left[DEGREES_MAX];
  size_t boundaries;
  blocks reflection[HALFSPACE_ETAS_MAX];        /* <psi mu F psi> */
  double exit[HALFSPACE_ETAS_MAX][DEGREES_MAX]; /* <mu T psi>, m = 0 */
  double entering[HALFSPACE_ETAS_MAX];          /* <mu T> */
  size_t cones;
  /* <mu T psi> over the angles of a cone */
  double cone[HALFSPACE_ETAS_MAX][HALFSPACE_CONES_MAX][DEGREES_MAX];
  double *memory; /* for the matrices of one solution */
};

/* ---- functions of angle --------------------------------------------------------------------- */

/* The polynomials of one order: alpha and beta of their three-term recurrence, and the norm of the
 * first. */
typedef struct recurrence {
  double norm;
  double alpha[DEGREES_MAX];
  double beta[DEGREES_MAX];
} recurrence;

/* Sets values[j] to psi_mj(mu). sine: sqrt(1 - mu^2). */
static void functions_at(const recurrence *of, size_t m, size_t degrees, double mu, double sine,
                         double *values) {
  double before = 0, here = of->norm;
  for (size_t i = 0; i < m; i++) {
    here *= sine;
  }
  for (size_t j = 0; j < degrees; j++) {
    values[j] = here;
    const double next = ((mu - of->alpha[j]) * here - (j > 0 ? of->beta[j] : 0) * before) /
                        (j + 1 < degrees ? of->beta[j + 1] : 1);
    before = here;
    here = next;
  }
}

/* Stieltjes' procedure with the weight mu (1 - mu^2)^m. */
static void find_recurrence(recurrence *of, const gauss_rule *rule, size_t m, size_t degrees) {
  double before[GAUSS_MAX], here[GAUSS_MAX], weight[GAUSS_MAX];
  double norm2 = 0;
  for (size_t i = 0; i < rule->n; i++) {
    const double mu = rule->x[i];
    weight[i] = rule->weight[i] * mu;
    for (size_t k = 0; k < m; k++) {
      weight[i] *= (1 - mu) * (1 + mu);
    }
    norm2 += weight[i];
    before[i] = 0;
  }
  of->norm = 1 / sqrt(norm2);
  of->beta[0] = 0;
  for (size_t i = 0; i < rule->n; i++) {
    here[i] = of->norm;
  }
  for (size_t j = 0; j < degrees; j++) {
    double alpha = 0;
    for (size_t i = 0; i < rule->n; i++) {
      alpha += weight[i] * rule->x[i] * here[i] * here[i];
    }
    of->alpha[j] = alpha;
    double beta2 = 0;
    for (size_t i = 0; i < rule->n; i++) {
      const double next = (rule->x[i] - alpha) * here[i] - of->beta[j] * before[i];
      before[i] = here[i];
      here[i] = next;
      beta2 += weight[i] * next * next;
    }
    if (j + 1 < degrees) {
      of->beta[j + 1] = sqrt(beta2);
      for (size_t i = 0; i < rule->n; i++) {
        here[i] /= of->beta[j + 1];
      }
    }
  }
}

/* Sets theta[l - m] to the associated Legendre function of degree l and order m at mu, for l from m
 * to before `moments`. Its square has the integral 1 over mu from -1 to 1. */
static void legendre_at(size_t m, size_t moments, double mu, double sine, double *theta) {
  double before = 0, here = sqrt(0.5);
  for (size_t i = 1; i <= m; i++) {
    here *= sine * sqrt((double)(2 * i + 1) / (double)(2 * i));
  }
  const double mm = (double)(m * m);
  double beta = 0;
  for (size_t l = m; l < moments; l++) {
    theta[l - m] = here;
    const double ll = (double)((l + 1) * (l + 1));
    const double next_beta = sqrt((ll - mm) / (4 * ll - 1));
    const double next = (mu * here - beta * before) / next_beta;
    before = here;
    here = next;
    beta = next_beta;
  }
}

/* ---- integrals ------------------------------------------------------------------------------ */

static void add_outer(double *to, size_t n, double factor, const double *by) {
  for (size_t i = 0; i < n; i++) {
    for (size_t j = 0; j < n; j++) {
      to[i * n + j] += factor * by[i] * by[j];
    }
  }
}

static void integrate_order(halfspace *to, size_t m, const recurrence *of) {
  const size_t n = to->degrees[m], nodes = to->rule.n;
  double theta[HALFSPACE_MOMENTS_MAX], values[DEGREES_MAX];
  const size_t moments = to->medium.moments > m ? to->medium.moments - m : 0;
  double *t = calloc(moments * n + 1, sizeof *t);
  if (t == NULL) {
    to->n = 0;
    return;
  }
  for (size_t i = 0; i < nodes; i++) {
    const double mu = to->rule.x[i], weight = to->rule.weight[i];
    const double sine = sqrt((1 - mu) * (1 + mu));
    functions_at(of, m, n, mu, sine, values);
    legendre_at(m, to->medium.moments, mu, sine, theta);
    for (size_t j = 0; j < n; j++) {
      to->psi.order[m][j * nodes + i] = values[j];
    }
    add_outer(to->unit.order[m], n, weight, values);
    for (size_t l = 0; l < moments; l++) {
      for (size_t j = 0; j < n; j++) {
        t[l * n + j] += weight * values[j] * theta[l];
      }
    }
  }
  for (size_t l = 0; l < moments; l++) {
    const double moment = to->medium.moment[l + m];
    add_outer((l % 2 == 0 ? to->even : to->odd).order[m], n, 2 * moment, t + l * n);
    for (size_t j = 0; m == 0 && j < n; j++) {
      const double b = moment * t[l * n + j] * sqrt((double)(2 * l + 1) / 2);
      to->source[0][j] += b;
      to->source[1][j] += l % 2 == 0 ? b : -b;
    }
  }
  free(t);
}

/* Fills slant.order[m] from the functions of orders m and m + 1. */
static void integrate_slant(halfspace *to, size_t m) {
  const size_t rows = to->degrees[m], columns = to->degrees[m + 1], nodes = to->rule.n;
  for (size_t i = 0; i < nodes; i++) {
    const double mu = to->rule.x[i];
    const double weight =
        to->rule.weight[i] * sqrt((1 - mu) * (1 + mu)) * (m == 0 ? sqrt(0.5) : 0.5);
    for (size_t row = 0; row < rows; row++) {
      const double left = weight * to->psi.order[m][row * nodes + i];
      for (size_t column = 0; column < columns; column++) {
        to->slant.order[m][row * columns + column] +=
            left * to->psi.order[m + 1][column * nodes + i];
      }
    }
  }
}

/* A direction in which light meets the boundary: its cosine and sine inside, and the weight of an
 * integral of mu T over it. */
struct crossing {
  double mu;
  double sine;
  double weight;
};

/* Returns the direction of the variable x that T is integrated over: the cosine outside for eta > 1,
 * so that its root at the critical angle does no harm, and the cosine inside for eta < 1. */
static struct crossing crossing_at(double eta, double x, double weight) {
  double mu = x, mu_outside = x, sine = sqrt((1 - x) * (1 + x));
  if (eta > 1) {
    sine /= eta;
    mu = sqrt((1 - sine) * (1 + sine));
    weight *= x / (eta * eta * mu);
  } else if (eta < 1) {
    mu_outside = sqrt((1 - eta * sine) * (1 + eta * sine));
  }
  weight *= mu * (eta == 1 ? 1 : transport_transmittance(eta, mu, mu_outside));
  return (struct crossing){mu, sine, weight};
}

/* Fills reflection[boundary] and exit[boundary]. F = 1 - T, and <psi mu psi> = 1. */
static void integrate_boundary(halfspace *to, size_t boundary, double eta, const recurrence *of) {
  for (size_t m = 0; m <= to->orders; m++) {
    for (size_t i = 0; i < to->degrees[m]; i++) {
      to->reflection[boundary].order[m][i * to->degrees[m] + i] = 1;
    }
  }
  gauss_rule rule;
  transport_gauss(&rule, FRESNEL_NODES);
  double values[DEGREES_MAX];
  double upper = 1;
  for (size_t panel = 0; panel < FRESNEL_PANELS; panel++) {
    const double lower = panel + 1 < FRESNEL_PANELS ? upper / 2 : 0;
    for (size_t i = 0; i < rule.n; i++) {
      const struct crossing at =
          crossing_at(eta, lower + (upper - lower) * rule.x[i], (upper - lower) * rule.weight[i]);
      to->entering[boundary] += at.weight;
      for (size_t m = 0; m <= to->orders; m++) {
        functions_at(&of[m], m, to->degrees[m], at.mu, at.sine, values);
        add_outer(to->reflection[boundary].order[m], to->degrees[m], -at.weight, values);
        for (size_t j = 0; m == 0 && j < to->degrees[0]; j++) {
          to->exit[boundary][j] += at.weight * values[j];
        }
      }
    }
    upper = lower;
  }
}

/* Fills cone[boundary][i]. */
static void integrate_cone(halfspace *to, size_t boundary, size_t i, double eta, double sine,
                           const recurrence *of) {
  /* For eta < 1 it is the sine inside that is at most 1: either way that where x is a cosine. */
  const double least = sqrt((1 - sine) * (1 + sine));
  gauss_rule rule;
  transport_gauss(&rule, FRESNEL_NODES);
  double values[DEGREES_MAX];
  double upper = 1;
  for (size_t panel = 0; panel < FRESNEL_PANELS && upper > least; panel++) {
    const double half = panel + 1 < FRESNEL_PANELS ? upper / 2 : 0;
    const double lower = half > least ? half : least;
    for (size_t k = 0; k < rule.n; k++) {
      const struct crossing at =
          crossing_at(eta, lower + (upper - lower) * rule.x[k], (upper - lower) * rule.weight[k]);
      functions_at(of, 0, to->degrees[0], at.mu, 0, values);
      for (size_t j = 0; j < to->degrees[0]; j++) {
        to->cone[boundary][i][j] += at.weight * values[j];
      }
    }
    upper = lower;
  }
}

/* ---- making --------------------------------------------------------------------------------- */

enum { MATRICES = 10 };

static bool reserve(halfspace *to) {
  size_t size = 0;
  for (size_t m = 0; m <= to->orders; m++) {
    const size_t n = to->degrees[m];
    size += n * to->rule.n + n * n * (3 + to->boundaries);
    size += m < to->orders ? n * to->degrees[m + 1] : 0;
  }
  to->tables = calloc(size, sizeof *to->tables);
  const size_t bytes =
      (MATRICES * 2 * transport_dense_size(to->n, to->n) + 4 * transport_dense_size(to->n, 1)) *
      sizeof(double);
  to->memory = aligned_alloc(ALIGNMENT_BYTES, bytes);
  if (to->tables == NULL || to->memory == NULL) {
    return false;
  }
  memset(to->memory, 0, bytes);
  double *next = to->tables;
  for (size_t m = 0; m <= to->orders; m++) {
    const size_t n = to->degrees[m];
    to->psi.order[m] = next;
    to->unit.order[m] = next += n * to->rule.n;
    to->even.order[m] = next += n * n;
    to->odd.order[m] = next += n * n;
    next += n * n;
    for (size_t i = 0; i < to->boundaries; i++) {
      to->reflection[i].order[m] = next;
      next += n * n;
    }
    to->slant.order[m] = next;
    next += m < to->orders ? n * to->degrees[m + 1] : 0;
  }
  return true;
}

halfspace *transport_halfspace_new(const core_isa *isa, const halfspace_rules *rules,
                                   const halfspace_medium *medium, const double *etas, size_t count,
                                   const double *sines, size_t cones) {
  assert(rules->orders <= ORDERS_MAX && rules->degrees <= DEGREES_MAX && rules->degrees >= 2);
  assert(rules->degrees_least >= 2 && rules->degrees_least <= DEGREES_MAX);
  assert(medium->moments >= 1 && medium->moments <= HALFSPACE_MOMENTS_MAX);
  assert(count >= 1 && count <= HALFSPACE_ETAS_MAX && cones <= HALFSPACE_CONES_MAX);
  halfspace *made = calloc(1, sizeof *made);
  recurrence *of = calloc(rules->orders + 1, sizeof *of);
  if (made == NULL || of == NULL) {
    free(made);
    free(of);
    return NULL;
  }
  made->isa = isa;
  made->medium = *medium;
  made->orders = rules->orders;
  made->boundaries = count;
  made->cones = cones;
  for (size_t m = 0; m <= rules->orders; m++) {
    const bool many = rules->degrees >= m + rules->degrees_least;
    made->degrees[m] = many ? rules->degrees - m : rules->degrees_least;
    made->first[m + 1] = made->first[m] + made->degrees[m];
  }
  made->n = made->first[rules->orders + 1];
  const size_t nodes =
      rules->degrees + rules->degrees_least + rules->orders + medium->moments / 2 + 4;
  transport_gauss(&made->rule, nodes < GAUSS_MAX ? nodes : GAUSS_MAX);
  if (!reserve(made)) {
    made->n = 0;
  }
  for (size_t m = 0; m <= rules->orders && made->n > 0; m++) {
    find_recurrence(&of[m], &made->rule, m, made->degrees[m]);
    integrate_order(made, m, &of[m]);
  }
  for (size_t m = 0; m < rules->orders && made->n > 0; m++) {
    integrate_slant(made, m);
  }
  for (size_t i = 0; i < count && made->n > 0; i++) {
    integrate_boundary(made, i, etas[i], of);
    for (size_t k = 0; k < cones; k++) {
      integrate_cone(made, i, k, etas[i], sines[k], &of[0]);
    }
  }
  free(of);
  if (made->n == 0) {
    transport_halfspace_free(made);
    return NULL;
  }
  return made;
}

void transport_halfspace_free(halfspace *of) {
  if (of != NULL) {
    free(of->tables);
    free(of->memory);
    free(of);
  }
}

/* ---- solving -------------------------------------------------------------------------------- */

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

static void fill(const dense *to, double value) {
  const size_t size = to->rows * to->stride;
  for (size_t i = 0; i < size; i++) {
    to->re[i] = value;
    if (to->im != NULL) {
      to->im[i] = 0;
    }
  }
}

/* Sets to = x a + y b + z, with z on the diagonal. `to` may be a or b. */
static void combine(const dense *to, double x, const dense *a, double y, const dense *b, double z) {
  for (size_t row = 0; row < to->rows; row++) {
    const size_t at = row * to->stride;
    for (size_t i = 0; i < to->stride; i++) {
      to->re[at + i] = x * a->re[at + i] + y * b->re[at + i];
      if (to->im != NULL) {
        to->im[at + i] = x * a->im[at + i] + y * b->im[at + i];
      }
    }
    to->re[at + row] += z;
  }
}

/* The square root of alpha^2 + k^2 sine^2 with a real part that is not negative. */
static double complex streaming(double alpha, double complex k, double sine2) {
  return fn_csqrt(alpha * alpha + k * k * sine2);
}

/* Sets *to to E. */
static void fill_streaming(const halfspace *of, const dense *to, double complex k) {
  fill(to, 0);
  const size_t last = of->orders, nodes = of->rule.n;
  for (size_t m = 0; m <= last; m++) {
    const size_t n = of->degrees[m], at = of->first[m];
    for (size_t i = 0; i < n; i++) {
      for (size_t j = 0; j < n; j++) {
        put(to, at + i, at + j, of->unit.order[m][i * n + j]);
      }
    }
    const size_t next = m < last ? of->degrees[m + 1] : 0;
    for (size_t i = 0; i < n; i++) {
      for (size_t j = 0; j < next; j++) {
        const double complex value = k * of->slant.order[m][i * next + j];
        put(to, at + i, at + n + j, value);
        put(to, at + n + j, at + i, -value);
      }
    }
  }
  if (k == 0 || last == 0) {
    return;
  }
  const double moment = last + 1 < of->medium.moments ? of->medium.moment[last + 1] : 0;
  const size_t n = of->degrees[last], at = of->first[last];
  for (size_t node = 0; node < nodes; node++) {
    const double mu = of->rule.x[node];
    const double alpha = 1 - of->medium.albedo * moment + 0.65 * mu;
    const double complex left =
        of->rule.weight[node] * 0.5 * (streaming(alpha, k, (1 - mu) * (1 + mu)) - alpha);
    for (size_t i = 0; i < n; i++) {
      for (size_t j = 0; j < n; j++) {
        const double product =
            of->psi.order[last][i * nodes + node] * of->psi.order[last][j * nodes + node];
        put(to, at + i, at + j, number_at(to, at + i, at + j) + left * product);
      }
    }
  }
}

/* Adds factor times real blocks to a matrix. */
static void add_blocks(const halfspace *of, const dense *to, double factor, const blocks *b) {
  for (size_t m = 0; m <= of->orders; m++) {
    const size_t n = of->degrees[m], at = of->first[m];
    for (size_t i = 0; i < n; i++) {
      for (size_t j = 0; j < n; j++) {
        to->re[(at + i) * to->stride + at + j] += factor * b->order[m][i * n + j];
      }
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

/* Sets *to to the Cayley transform 2 (1 + beta (W -+ V))^-1 - 1, where *minus is W -+ V. */
static bool transform(const dense *to, const dense *spare, const dense *minus, double beta) {
  combine(spare, beta, minus, 0, minus, 1);
  fill(to, 0);
  for (size_t i = 0; i < to->rows; i++) {
    put(to, i, i, 2);
  }
  if (!transport_dense_solve(spare, to)) {
    return false;
  }
  for (size_t i = 0; i < to->rows; i++) {
    put(to, i, i, number_at(to, i, i) - 1);
  }
  return true;
}

/* Changes the signs of the rows of odd orders. This makes a reflection or a transmission symmetric, by
 * reciprocity: the blocks of E between orders are antisymmetric, all others symmetric. */
static void change_signs(const halfspace *of, const dense *to) {
  for (size_t m = 1; m <= of->orders; m += 2) {
    for (size_t row = of->first[m]; row < of->first[m + 1]; row++) {
      for (size_t i = 0; i < to->columns; i++) {
        put(to, row, i, -number_at(to, row, i));
      }
    }
  }
}

/* Sets *to to T (1 - sign R)^-1 T. All have the signs of change_signs(). */
static bool reflect(const halfspace *of, const dense *to, double sign, const dense *r,
                    const dense *t, const dense spare[3]) {
  combine(&spare[0], -sign, r, 0, r, 1);
  for (size_t m = 1; m <= of->orders; m += 2) {
    for (size_t row = of->first[m]; row < of->first[m + 1]; row++) {
      spare[0].re[row * spare[0].stride + row] -= 2;
    }
  }
  combine(&spare[1], 1, t, 0, t, 0);
  return transport_dense_congruence(to, &spare[0], &spare[1], &spare[2]);
}

/* Makes *r the reflection of the half space. At first *r and *t are the reflection and the
 * transmission of a layer; afterwards *t and the spare ones have no meaning.
 *
 * Two layers that are lit alike from both sides, or with opposite signs, have a mirror between them:
 * R + T (1 - R)^-1 T is the sum of their R and T, R - T (1 + R)^-1 T the difference. */
static bool double_layers(const halfspace *of, const dense *r, const dense *t,
                          const dense spare[5]) {
  const dense *alike = &spare[3], *opposite = &spare[4];
  change_signs(of, r);
  change_signs(of, t);
  for (int i = 0; i < DOUBLINGS_MAX; i++) {
    if (largest(t) < TRANSMISSION_LEAST) {
      change_signs(of, r);
      return true;
    }
    if (!reflect(of, alike, 1, r, t, spare) || !reflect(of, opposite, -1, r, t, spare)) {
      return false;
    }
    combine(t, 0.5, alike, 0.5, opposite, 0);
    combine(alike, 0.5, alike, -0.5, opposite, 0);
    combine(r, 1, r, 1, alike, 0);
  }
  return false;
}

bool transport_halfspace_solve(halfspace *of, double complex k, double kappa,
                               halfspace_exitance *exitance) {
  const size_t n = of->n;
  const double albedo = of->medium.albedo;
  const bool is_complex = cimag(k) != 0;
  double *memory = of->memory;
  dense matrix[MATRICES];
  for (size_t i = 0; i < MATRICES; i++) {
    matrix[i] = transport_dense_at(of->isa, &memory, n, n, is_complex);
  }
  const dense up = transport_dense_at(of->isa, &memory, n, 1, is_complex);
  const dense once = transport_dense_at(of->isa, &memory, n, 1, is_complex);
  const dense *e = &matrix[0], *minus = &matrix[1], *plus = &matrix[2], *r = &matrix[3],
              *t = &matrix[4], *spare = &matrix[5];
  fill_streaming(of, e, k);
  /* minus = W - V, plus = W + V */
  combine(minus, 1, e, 0, e, 0);
  add_blocks(of, minus, -albedo, &of->even);
  combine(plus, 1, e, 0, e, 0);
  add_blocks(of, plus, -albedo, &of->odd);

  /* the step: the geometric mean of the decay rates' reciprocals */
  const double slow = sqrt(fn_abs(kappa * kappa + k * k));
  const double fast = sqrt(1 + fn_abs(k) * fn_abs(k)) * (double)(of->degrees[0] * of->degrees[0]);
  const double beta = 1 / sqrt(slow * fast);

  if (!transform(r, &spare[0], minus, beta) || !transform(t, &spare[0], plus, beta)) {
    return false;
  }
  combine(&spare[0], 0.5, r, -0.5, t, 0);
  combine(t, 0.5, r, 0.5, t, 0);
  combine(r, 1, &spare[0], 0, t, 0);
  if (!double_layers(of, r, t, spare)) {
    return false;
  }

  /* t becomes W + 1 - r V, because V = (plus - minus) / 2 and W = (plus + minus) / 2. */
  combine(t, 0.5, plus, -0.5, minus, 0);
  transport_dense_multiply(&spare[0], r, t);
  combine(t, 0.5, plus, 0.5, minus, 1);
  combine(t, 1, t, -1, &spare[0], 0);
  fill(&up, 0);
  fill(&once, 0);
  for (size_t i = 0; i < n; i++) {
    double complex source = i < of->degrees[0] ? of->source[1][i] : 0;
    put(&once, i, 0, albedo * source);
    for (size_t j = 0; j < of->degrees[0]; j++) {
      source += number_at(r, i, j) * of->source[0][j];
    }
    put(&up, i, 0, albedo * source);
  }
  combine(&spare[0], 1, e, 0, e, 1);
  if (!transport_dense_solve(t, &up) || !transport_dense_solve(&spare[0], &once)) {
    return false;
  }
  for (size_t boundary = 0; boundary < of->boundaries; boundary++) {
    fill(t, 0);
    add_blocks(of, t, 1, &of->reflection[boundary]);
    transport_dense_multiply_blocks(&spare[0], r, t, of->first, of->orders + 1);
    combine(&spare[0], -1, &spare[0], 0, t, 1);
    /* the light on its way up, of a beam and of diffuse light */
    dense lit = spare[1];
    lit.columns = 2;
    lit.stride = up.stride;
    for (size_t i = 0; i < n; i++) {
      double complex diffuse = 0;
      for (size_t j = 0; j < of->degrees[0]; j++) {
        diffuse += number_at(r, i, j) * of->exit[boundary][j];
      }
      put(&lit, i, 0, number_at(&up, i, 0));
      put(&lit, i, 1, diffuse / of->entering[boundary]);
    }
    if (!transport_dense_solve(&spare[0], &lit)) {
      return false;
    }
    exitance[boundary] = (halfspace_exitance){0};
    for (size_t i = 0; i < of->degrees[0]; i++) {
      exitance[boundary].all += of->exit[boundary][i] * number_at(&lit, i, 0);
      exitance[boundary].single += of->exit[boundary][i] * number_at(&once, i, 0);
      exitance[boundary].diffuse += of->exit[boundary][i] * number_at(&lit, i, 1);
      for (size_t cone = 0; cone < of->cones; cone++) {
        exitance[boundary].cone[cone] +=
            of->cone[boundary][cone][i] * (number_at(&lit, i, 0) - number_at(&once, i, 0));
      }
    }
  }
  return true;
}

bool transport_halfspace_diffuse_single(halfspace *of, double *single) {
  const size_t n = of->degrees[0];
  double *memory = of->memory;
  dense matrix[5];
  for (size_t i = 0; i < 5; i++) {
    matrix[i] = transport_dense_at(of->isa, &memory, n, n, false);
  }
  const dense *a = &matrix[0], *x = &matrix[1], *v = &matrix[2], *spare = &matrix[3];
  fill(v, 0);
  fill(x, 0);
  for (size_t i = 0; i < n; i++) {
    for (size_t j = 0; j < n; j++) {
      const size_t at = i * n + j;
      put(x, i, j, of->unit.order[0][at]);
      put(v, i, j, 0.5 * of->medium.albedo * (of->even.order[0][at] - of->odd.order[0][at]));
    }
  }
  const double beta = 1 / (double)n; /* the decay rates are from 1 to some n^2 */
  if (!transform(a, &spare[0], x, beta)) {
    return false;
  }
  combine(&spare[0], 1, a, 0, a, 1);
  transport_dense_multiply(&spare[1], v, &spare[0]);
  transport_dense_multiply(x, &spare[0], &spare[1]);
  combine(x, 0.5 * beta, x, 0, x, 0);
  for (int i = 0; i < DOUBLINGS_MAX && !(largest(a) < TRANSMISSION_LEAST); i++) {
    transport_dense_multiply(&spare[0], x, a);
    transport_dense_multiply(&spare[1], a, &spare[0]);
    combine(x, 1, x, 1, &spare[1], 0);
    transport_dense_multiply(&spare[0], a, a);
    combine(a, 1, &spare[0], 0, a, 0);
  }
  for (size_t boundary = 0; boundary < of->boundaries; boundary++) {
    const double *exit = of->exit[boundary];
    double sum = 0;
    for (size_t i = 0; i < n; i++) {
      for (size_t j = 0; j < n; j++) {
        sum += exit[i] * x->re[i * x->stride + j] * exit[j];
      }
    }
    single[boundary] = sum / of->entering[boundary];
  }
  return true;
}
