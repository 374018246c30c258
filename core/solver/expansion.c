/* The intensity at a depth z is expanded on each hemisphere in the functions e_m(phi) psi_mj(mu),
 * with e_0 = 1 / sqrt(2 pi), e_m = cos(m phi) / sqrt(pi), and psi_mj = (1 - mu^2)^(m/2) times a
 * polynomial of degree j. They are orthonormal with the weight mu, mu from 0 to 1. Coefficients of
 * mode m are multiplied by (-i)^m. Then the Fourier transformed equations are
 *
 *   I+' = -W I+ + V I- + a b+ B,      W -+ V = E - a (P++ +- P+-),
 * -I-' = -W I- + V I+ + a b- B,      B' = -B,
 *
 * where I+ is the light on its way down, I- the light on its way up, B the beam, and
 *
 *   E = <psi psi> + k C,   C = +-<psi sqrt(1 - mu^2) psi> between m and m + 1 (antisymmetric),
 *   P++ +- P+- = 2 sum over l + m even (odd) of g_l t_l t_l^T,   t_lj = <psi_mj Theta_lm>,
 *   b+-_j = sum over l of (+-1)^l g_l t_lj sqrt((2 l + 1) / 2),   m = 0 only.
 *
 * For real k all of these are real. With the signs of its rows of odd orders changed, each matrix
 * is symmetric, by reciprocity.
 *
 * Light that is sent straight back adds -(-1)^m times its albedo to E in W - V, and as much with the
 * other sign in W + V.
 *
 * Orders above M are eliminated as if they were not scattered, with rates alpha and beta that every
 * second one shares: their continued fraction adds the matrix of (sqrt(alpha^2 + k^2 (1 - mu^2) alpha /
 * beta) - alpha) / 2 to the block m = M of E. */
#include "core/solver/expansion.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

#include "core/transport/gauss.h"
#include "core/transport/single.h"

/* Fresnel's transmittance is integrated over panels that halve towards the grazing angle. Polynomials of
 * more than FRESNEL_DEGREES degrees need more nodes, or totals are off by 0.04 where light is scattered
 * back: on the widest panel as many as degrees. */
enum { FRESNEL_PANELS = 14, FRESNEL_NODES = 16, FRESNEL_DEGREES = 36 };

/* ---- functions of angle --------------------------------------------------------------------- */

/* Sets values[j] to psi_mj(mu). sine: sqrt(1 - mu^2). */
static void functions_at(const expansion_recurrence *of, size_t m, size_t degrees, double mu,
                         double sine, double *values) {
  double before = 0, here = of->norm;
  for (size_t i = 0; i < m; i++) {
    here *= sine;
  }
  for (size_t j = 0; j < degrees; j++) {
    values[j] = here;
    const double next = ((mu - of->alpha[j]) * here - of->beta[j] * before) /
                        (j + 1 < degrees ? of->beta[j + 1] : 1);
    before = here;
    here = next;
  }
}

void solver_expansion_at(const expansion *of, size_t m, double mu, double sine, double *values) {
  const size_t degrees = (of->first[m + 1] - of->first[m]) / of->panels;
  size_t panel = 0;
  while (panel + 1 < of->panels && mu > of->edge[panel + 1]) {
    panel++;
  }
  for (size_t i = 0; of->panels > 1 && i < of->panels * degrees; i++) {
    values[i] = 0;
  }
  functions_at(&of->recurrence[m * of->panels + panel], m, degrees, mu, sine,
               values + panel * degrees);
}

/* Stieltjes' procedure with the weight mu (1 - mu^2)^m on a panel, whose nodes are those of *rule. */
static void find_recurrence(expansion_recurrence *of, const gauss_rule *rule, size_t m,
                            size_t degrees) {
  double before[GAUSS_MAX] = {0}, here[GAUSS_MAX], weight[GAUSS_MAX];
  double norm2 = 0;
  for (size_t i = 0; i < rule->n; i++) {
    const double mu = rule->x[i];
    weight[i] = rule->weight[i] * mu;
    for (size_t k = 0; k < m; k++) {
      weight[i] *= (1 - mu) * (1 + mu);
    }
    norm2 += weight[i];
  }
  of->norm = 1 / sqrt(norm2);
  of->beta[0] = 0;
  for (size_t i = 0; i < rule->n; i++) {
    here[i] = of->norm;
  }
  for (size_t j = 0; j < degrees; j++) {
    double alpha = 0, beta2 = 0;
    for (size_t i = 0; i < rule->n; i++) {
      alpha += weight[i] * rule->x[i] * here[i] * here[i];
    }
    of->alpha[j] = alpha;
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

void solver_expansion_add_outer(double *to, size_t stride, double factor, const double *left,
                                size_t rows, const double *right, size_t columns) {
  for (size_t i = 0; i < rows; i++) {
    for (size_t j = 0; j < columns; j++) {
      to[i * stride + j] += factor * left[i] * right[j];
    }
  }
}

/* The same to the block of a matrix that begins at row `row`, column `column`. */
static void add_outer(const expansion *of, double *to, size_t row, size_t column, double factor,
                      const double *left, size_t rows, const double *right, size_t columns) {
  solver_expansion_add_outer(to + row * of->n + column, of->n, factor, left, rows, right, columns);
}

static double sign_of(size_t m) {
  return m % 2 == 0 ? 1 : -1;
}

/* Adds what all nodes contribute to the matrices of order m. t: [moments][functions]. */
static void integrate_order(expansion *to, const expansion_medium *medium, size_t m, double *t) {
  const size_t at = to->first[m], n = to->first[m + 1] - at;
  const size_t next = to->first[m + 1], rest = m < to->orders ? to->first[m + 2] - next : 0;
  const size_t moments = medium->moments > m ? medium->moments - m : 0;
  double theta[EXPANSION_MOMENTS_MAX];
  for (size_t i = 0; i < moments * n; i++) {
    t[i] = 0;
  }
  for (size_t node = 0; node < to->nodes; node++) {
    const double mu = to->mu[node], weight = to->weight[node], sine = sqrt((1 - mu) * (1 + mu));
    const double *values = to->psi + node * to->n + at;
    legendre_at(m, medium->moments, mu, sine, theta);
    add_outer(to, to->unit, at, at, sign_of(m) * weight, values, n, values, n);
    const double slant = sign_of(m) * weight * sine * (m == 0 ? sqrt(0.5) : 0.5);
    add_outer(to, to->slant, at, next, slant, values, n, values + n, rest);
    add_outer(to, to->slant, next, at, slant, values + n, rest, values, n);
    for (size_t l = 0; l < moments; l++) {
      for (size_t j = 0; j < n; j++) {
        t[l * n + j] += weight * values[j] * theta[l];
      }
    }
  }
  for (size_t l = 0; l < moments; l++) {
    const double moment = medium->moment[l + m], *row = t + l * n;
    add_outer(to, l % 2 == 0 ? to->even : to->odd, at, at,
              -2 * medium->albedo * sign_of(m) * moment, row, n, row, n);
    for (size_t j = 0; m == 0 && j < n; j++) {
      const double b = moment * row[j] * sqrt((double)(2 * l + 1) / 2);
      to->source[0][j] += b;
      to->source[1][j] += sign_of(l) * b;
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

/* Returns the direction of the variable x that T is integrated over: the cosine outside for eta >
 * 1, so that its root at the critical angle does no harm, and the cosine inside for eta < 1. */
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

/* Returns the largest x below `upper` at which a panel ends, x being the variable of crossing_at();
 * 0 if there is none. */
static double next_edge(const expansion *of, double eta, double upper) {
  double next = 0;
  for (size_t i = 1; i < of->panels; i++) {
    const double mu = of->edge[i], sine2 = eta * eta * (1 - mu) * (1 + mu);
    const double x = eta > 1 ? sqrt(fmax(0, 1 - sine2)) : mu;
    next = x < upper ? fmax(next, x) : next;
  }
  return next;
}

/* Adds to exit[boundary][part] what leaves below the angle whose cosine, outside for eta > 1 and
 * inside otherwise, is `least`. For light of all angles it fills the reflection, too: F = 1 - T,
 * and <psi mu psi> = 1. */
static void integrate_boundary(expansion *to, size_t boundary, size_t part, double least) {
  gauss_rule rule;
  const size_t degrees = to->first[1] / to->panels;
  double values[EXPANSION_PANELS_MAX * EXPANSION_DEGREES_MAX];
  double *reflection = to->reflection[boundary];
  for (size_t i = 0; part == 0 && i < to->n; i++) {
    reflection[i * to->n + i] = 1;
  }
  double upper = 1;
  for (size_t panel = 0; panel < FRESNEL_PANELS && upper > least; panel++) {
    const double lower = panel + 1 < FRESNEL_PANELS ? fmax(upper / 2, least) : least;
    const size_t nodes = degrees > FRESNEL_DEGREES ? degrees >> panel : 0;
    transport_gauss(&rule, nodes > FRESNEL_NODES ? nodes : FRESNEL_NODES);
    while (upper > lower) {
      const double from = fmax(lower, next_edge(to, to->boundaries.etas[boundary], upper));
      for (size_t i = 0; i < rule.n; i++) {
        const struct crossing at =
            crossing_at(to->boundaries.etas[boundary], from + (upper - from) * rule.x[i],
                        (upper - from) * rule.weight[i]);
        to->entering[boundary] += part == 0 ? at.weight : 0;
        for (size_t m = 0; m <= (part == 0 ? to->orders : 0); m++) {
          const size_t first = to->first[m], n = to->first[m + 1] - first;
          solver_expansion_at(to, m, at.mu, at.sine, values);
          for (size_t j = 0; m == 0 && j < n; j++) {
            to->exit[boundary][part][j] += at.weight * values[j];
          }
          if (part == 0) {
            add_outer(to, reflection, first, first, -at.weight, values, n, values, n);
          }
        }
      }
      upper = from;
    }
  }
}

/* ---- making --------------------------------------------------------------------------------- */

/* Points the arrays of *to into a block of memory, and returns it, or NULL if memory runs out. */
static double *reserve(expansion *to) {
  const size_t n = to->n, parts = 1 + to->boundaries.cones, count = to->boundaries.count;
  const size_t squares = 4 + count, rows = 2 + to->nodes + count * parts;
  double *next = calloc(squares * n * n + rows * n + 4 * to->nodes + count, sizeof *next);
  if (next == NULL) {
    return NULL;
  }
  double **const square[] = {&to->unit, &to->even, &to->odd, &to->slant};
  for (size_t i = 0; i < squares; i++, next += n * n) {
    *(i < 4 ? square[i] : &to->reflection[i - 4]) = next;
  }
  for (size_t i = 0; i < 2 + count * parts; i++, next += n) {
    *(i < 2 ? &to->source[i] : &to->exit[(i - 2) / parts][(i - 2) % parts]) = next;
  }
  to->psi = next;
  to->alpha[0] = next += to->nodes * n;
  to->alpha[1] = next += to->nodes;
  to->mu = next += to->nodes;
  to->weight = next += to->nodes;
  to->entering = next + to->nodes;
  return to->unit;
}

/* Sets *mapped to the rule for integrals between two ends. */
static void map_rule(gauss_rule *mapped, const gauss_rule *rule, double from, double to) {
  mapped->n = rule->n;
  for (size_t i = 0; i < rule->n; i++) {
    mapped->x[i] = from + (to - from) * rule->x[i];
    mapped->weight[i] = (to - from) * rule->weight[i];
  }
}

size_t solver_expansion_degrees(const expansion_rules *rules, size_t m, size_t panels) {
  const bool many = rules->degrees >= m + rules->degrees_least;
  const size_t degrees = many ? rules->degrees - m : rules->degrees_least;
  return panels == 1 ? degrees : (degrees + panels - 1) / panels + 1;
}

expansion *solver_expansion_new(const core_isa *isa, const expansion_rules *rules,
                                const expansion_medium *medium,
                                const expansion_boundaries *boundaries) {
  assert(rules->orders <= EXPANSION_ORDERS_MAX && rules->degrees <= EXPANSION_DEGREES_MAX);
  assert(rules->degrees >= 2 && rules->degrees_least >= 2 &&
         rules->degrees_least <= EXPANSION_DEGREES_MAX && boundaries->edges < EXPANSION_PANELS_MAX);
  assert(medium->moments >= 1 && medium->moments <= EXPANSION_MOMENTS_MAX);
  assert(boundaries->count <= EXPANSION_ETAS_MAX && boundaries->cones <= EXPANSION_CONES_MAX);
  const size_t panels = 1 + boundaries->edges;
  expansion *made = calloc(1, sizeof *made);
  expansion_recurrence *by = calloc((rules->orders + 1) * panels, sizeof *by);
  double *t = calloc(EXPANSION_MOMENTS_MAX * panels * EXPANSION_DEGREES_MAX, sizeof *t);
  bool ok = made != NULL && by != NULL && t != NULL;
  gauss_rule rule, panel_rule;
  const size_t nodes =
      rules->degrees + rules->degrees_least + rules->orders + medium->moments / 2 + 4;
  transport_gauss(&rule, nodes < GAUSS_MAX ? nodes : GAUSS_MAX);
  if (ok) {
    *made = (expansion){.isa = isa,
                        .albedo = medium->albedo,
                        .reversed = medium->reversed,
                        .orders = rules->orders,
                        .nodes = panels * rule.n,
                        .panels = panels,
                        .recurrence = by,
                        .boundaries = *boundaries};
    made->edge[panels] = 1;
    for (size_t i = 0; i < boundaries->edges; i++) {
      made->edge[1 + i] = boundaries->edge[i];
    }
    for (size_t m = 0; m <= rules->orders; m++) {
      const size_t each = solver_expansion_degrees(rules, m, panels);
      for (size_t panel = 0; panel < panels; panel++) {
        map_rule(&panel_rule, &rule, made->edge[panel], made->edge[panel + 1]);
        find_recurrence(&by[m * panels + panel], &panel_rule, m, each);
      }
      made->n = made->first[m + 1] = made->first[m] + panels * each;
    }
    ok = reserve(made) != NULL;
  }
  for (size_t node = 0; ok && node < made->nodes; node++) {
    const size_t panel = node / rule.n, last = rules->orders + 1;
    map_rule(&panel_rule, &rule, made->edge[panel], made->edge[panel + 1]);
    const double mu = panel_rule.x[node % rule.n];
    made->mu[node] = mu;
    made->weight[node] = panel_rule.weight[node % rule.n];
    for (size_t i = 0; i < 2; i++) {
      const size_t l = medium->reversed > 0 ? last + i : last;
      made->alpha[i][node] = 1 - (l < medium->moments ? medium->albedo * medium->moment[l] : 0) -
                             sign_of(l) * medium->reversed + 0.65 * mu;
    }
    for (size_t m = 0; m < last; m++) {
      solver_expansion_at(made, m, mu, sqrt((1 - mu) * (1 + mu)),
                          made->psi + node * made->n + made->first[m]);
    }
  }
  for (size_t m = 0; ok && m <= rules->orders; m++) {
    integrate_order(made, medium, m, t);
  }
  for (size_t m = 0; ok && m <= rules->orders; m++) {
    for (size_t i = made->first[m] * made->n; i < made->first[m + 1] * made->n; i++) {
      made->even[i] += (1 - sign_of(m) * medium->reversed) * made->unit[i];
      made->odd[i] += (1 + sign_of(m) * medium->reversed) * made->unit[i];
    }
  }
  for (size_t i = 0; ok && i < boundaries->count; i++) {
    integrate_boundary(made, i, 0, 0);
    for (size_t cone = 0; cone < boundaries->cones; cone++) {
      /* For eta < 1 it is the sine inside that is at most 1: either way that of the variable. */
      const double sine = boundaries->sines[cone];
      integrate_boundary(made, i, 1 + cone, sqrt((1 - sine) * (1 + sine)));
    }
  }
  free(t);
  if (!ok) {
    free(by);
    free(made);
    return NULL;
  }
  return made;
}

void solver_expansion_free(expansion *of) {
  if (of != NULL) {
    free(of->unit);
    free(of->recurrence);
    free(of);
  }
}
