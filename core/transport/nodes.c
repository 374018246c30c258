#include "core/transport/nodes.h"

#include <math.h>
#include <stdlib.h>

#include "core/transport/functions.h"

/* Below it the chords are short enough to be integrated along; above, their ends are. */
#define CHORDS_UP_TO 1.0

/* The smallest cosine that leaves: cos of the critical angle, 0 where there is none. */
static double critical_mu(double eta) {
  return eta > 1 ? sqrt((eta - 1) * (eta + 1)) / eta : 0;
}

/* u = asinh x, the rapidity, of the critical angle; eta > 1. */
static double critical_rapidity(double eta) {
  return 0.5 * fn_log((eta + 1) / (eta - 1));
}

/* Fresnel's transmittance, unpolarized, from the cosines inside and outside:
 * T = 2 eta mu mu_t [1 / (eta mu + mu_t)^2 + 1 / (mu + eta mu_t)^2]. */
static double complex transmittance(double eta, double complex mu, double complex mu_t) {
  const double complex s = eta * mu + mu_t;
  const double complex p = mu + eta * mu_t;
  return 2 * eta * mu * mu_t * (fn_inverse(s * s) + fn_inverse(p * p));
}

/* ---- how many points ------------------------------------------------------------------------ */

/* Found by comparing with twice as many, over eta from 0.25 to 4 and |k| up to 1e4: the exitance is
 * then off by about the accuracy. */

static size_t at_most(double count, size_t limit) {
  return count < (double)limit ? (size_t)count : limit;
}

/* How many e-folds of mu the critical angle is from grazing, or for eta < 1 the branch point of
 * mu_t from the real axis. */
static double nearness(double eta) {
  return eta == 1 ? 0 : fn_log(1 + 1 / sqrt(fabs((eta - 1) * (eta + 1))));
}

void transport_nodes_rules(nodes_rules *rules, double eta, double accuracy) {
  const double digits = -fn_log(accuracy);
  const double for_root = 6 + 0.6 * digits;
  rules->eta = eta;
  rules->accuracy = accuracy;
  transport_gauss(&rules->scattered, at_most(4 + 0.7 * digits, GAUSS_MAX));
  transport_gauss(&rules->chords, at_most(for_root * (1 + 0.1 * nearness(eta)), GAUSS_MAX));
  transport_gauss(&rules->transmitted, at_most(for_root * (1 + 0.2 * nearness(eta)), GAUSS_MAX));
  rules->chord_points = at_most(6 + 0.6 * digits, GAUSS_MAX);
}

/* What |k| is multiplied with where the arcs end: the tangent of the critical angle. */
static double arc_size(double eta, double complex k) {
  return eta > 1 ? fn_abs(k) / sqrt((eta - 1) * (eta + 1)) : fn_abs(k);
}

static size_t arc_points(const nodes_rules *rules, double complex k) {
  const double scales = fn_log(1 + arc_size(rules->eta, k));
  return at_most((3 - fn_log(rules->accuracy)) * (0.85 + 0.3 * scales), GAUSS_MAX);
}

/* ---- paths through many scales -------------------------------------------------------------- */

/* The parameter of a path: rho from 0 to infinity, and d(ln rho) / ds, for s from 0 to 1. */
struct stretch {
  double rho;
  double slope;
};

/* Things change from the scale 1 / size up to 1.
 * Two ends: rho = c A / B^2 with A = e^(L s) - 1 and B = e^(M (1 - s)) - 1 goes through these
 * scales towards 0 and towards infinity at an even pace, and beyond them as s and (1 - s)^-2.
 * One end: from rho = 1 on all decays; B = 1 - s. */
static struct stretch stretched(bool two_ends, double size, double s) {
  const double lower = fn_log(2 + 4 * size);
  const double at_s = fn_exp(lower * s);
  const double a = creal(fn_cexpm1(lower * s));
  if (!two_ends) {
    const double rho = a / creal(fn_cexpm1(lower)) / ((1 - s) * (1 - s));
    return (struct stretch){rho, lower * at_s / a + 2 / (1 - s)};
  }
  const double upper = 0.5 * lower;
  const double at_rest = fn_exp(upper * (1 - s));
  const double b = creal(fn_cexpm1(upper * (1 - s)));
  const double b_middle = creal(fn_cexpm1(0.5 * upper));
  const double c = b_middle * b_middle / creal(fn_cexpm1(0.5 * lower));
  return (struct stretch){c * a / (b * b), lower * at_s / a + 2 * upper * at_rest / b};
}

/* ---- what is scattered ---------------------------------------------------------------------- */

/* K(t) = int ds / (2 p) e^(-pt), p = sqrt(s^2 + k^2), s from 1 to infinity. In z = s + p this is
 * dz / (2 z) with p = (z + k^2 / z) / 2: no root is left. z runs from z0 = 1 + sqrt(1 + k^2) away
 * from 0, z = z0 / t^2 with t from 1 to 0. */
static void add_scattered(nodes *to, const nodes_rules *rules, double complex k) {
  const double complex z0 = 1 + fn_csqrt(1 + k * k);
  for (size_t i = 0; i < rules->scattered.n; i++) {
    const double t = rules->scattered.x[i];
    const double complex z = z0 / (t * t);
    to->p[to->n] = 0.5 * (z + k * k * fn_inverse(z));
    to->kernel[to->n] = rules->scattered.weight[i] / t;
    to->exit[to->n] = 0;
    to->n++;
  }
}

/* eta = 1: nothing is reflected, and X(t) = 1/2 int ds / s^2 e^(-pt). s starts at 1 and the rest
 * changes at |k|: z = z0 (1 + rho), with scales as on the arcs below. */
static void add_unreflected(nodes *to, double complex k, const gauss_rule *rule) {
  const double complex z0 = 1 + fn_csqrt(1 + k * k);
  for (size_t i = 0; i < rule->n; i++) {
    const struct stretch stretch = stretched(false, fn_abs(k), rule->x[i]);
    const double complex z = z0 * (1 + stretch.rho);
    const double complex p = 0.5 * (z + k * k * fn_inverse(z));
    const double complex s = 0.5 * (z - k * k * fn_inverse(z));
    const double dz_by_z = stretch.rho * stretch.slope / (1 + stretch.rho) * rule->weight[i];
    to->p[to->n] = p;
    to->kernel[to->n] = 0;
    to->exit[to->n] = 0.5 * dz_by_z * p * fn_inverse(s * s);
    to->n++;
  }
}

/* ---- what is transmitted, for small k ------------------------------------------------------- */

/* One angle: mu, the tangent x, and the weight of 1/2 dmu / mu T. */
struct angle {
  double mu;
  double x;
  double weight;
};

/* eta > 1: u = U (1 - t^2), t from 0 to 1, makes an analytic function of the root that T has at the
 * critical angle; mu_t^2 = eta^2 (mu - mu_c) (mu + mu_c) with
 * mu - mu_c = mu mu_c (cosh U - cosh u) = 2 mu mu_c sinh((U + u) / 2) sinh((U - u) / 2);
 * dmu / mu = tanh u du. */
static struct angle angle_inside_denser(double eta, double t, double weight) {
  const double limit = critical_rapidity(eta);
  const double mu_c = critical_mu(eta);
  const double u = limit * (1 - t * t);
  double complex sinh_u, cosh_u, sum, difference, unused;
  fn_csinhcosh(u, &sinh_u, &cosh_u);
  fn_csinhcosh(0.5 * (limit + u), &sum, &unused);
  fn_csinhcosh(0.5 * limit * t * t, &difference, &unused);
  const double mu = 1 / creal(cosh_u);
  const double beyond_critical = 2 * mu * mu_c * creal(sum) * creal(difference);
  const double mu_t = eta * sqrt(beyond_critical * (mu + mu_c));
  const double measure = creal(sinh_u) * mu * 2 * limit * t * weight;
  return (struct angle){mu, creal(sinh_u), 0.5 * measure * creal(transmittance(eta, mu, mu_t))};
}

/* eta < 1: every angle leaves; mu = t^2. */
static struct angle angle_outside_denser(double eta, double t, double weight) {
  const double mu = t * t;
  const double mu_t = sqrt((1 - eta) * (1 + eta) + eta * eta * mu * mu);
  const double measure = 2 * weight / t;
  return (struct angle){mu, sqrt((1 - mu) * (1 + mu)) / mu,
                        0.5 * measure * creal(transmittance(eta, mu, mu_t))};
}

/* J0(k t x) e^(-C t) is the mean of e^(-pt) over the chord p = C - i k x cos(phi), by the midpoint
 * rule in phi. */
static void add_chords(nodes *to, const nodes_rules *rules, double complex k) {
  for (size_t i = 0; i < rules->chords.n; i++) {
    const double t = rules->chords.x[i];
    const double weight = rules->chords.weight[i];
    const struct angle angle = rules->eta > 1 ? angle_inside_denser(rules->eta, t, weight)
                                              : angle_outside_denser(rules->eta, t, weight);
    for (size_t j = 0; j < rules->chord_points; j++) {
      double sine, cosine;
      fn_sincos(FN_PI * ((double)j + 0.5) / (double)rules->chord_points, &sine, &cosine);
      to->p[to->n] = 1 / angle.mu - CMPLX(0, 1) * k * (angle.x * cosine);
      to->kernel[to->n] = -angle.weight / (double)rules->chord_points;
      to->exit[to->n] = angle.weight * angle.mu / (double)rules->chord_points;
      to->n++;
    }
  }
}

/* ---- what is transmitted, for large k ------------------------------------------------------- */

/* The ends of all chords lie on the two arcs p = cosh u +- i k sinh u, u from 0 to the critical
 * rapidity U, which meet at p = 1. Each chord is deformed onto the part of the arcs between its
 * ends, which makes one measure of all of them: on an arc, with chords' C = cosh u beyond
 * C' = cosh u',
 *
 *   dnu = +-1 / (2 pi i) m(u') dp(u'),    m(u') = int dmu / mu T(mu) / D(u, u')
 *   D^2 = (p - C)^2 + k^2 sinh^2 u = (1 + k^2) (C - C') (C - C''),  C'' = cosh(u' + 2 i psi),
 *
 * tan(psi) = +-k: it is a density of p that is analytic, so that the path of u' may leave the real
 * axis. It is bent such that p keeps away from the imaginary axis, where p + q of nodes on opposite
 * arcs would be small beside k: in v = e^u' it is a circular arc that leaves its ends under the
 * angle `bend`. */

/* A point of the path, with v = e^u': v - 1, dv / ds for the path's parameter s from 0 to 1, the
 * cosine mu' = 1 / C' = 2 v / (v^2 + 1), and mu' - mu_c. */
struct path_point {
  double complex v_less_1;
  double complex dv;
  double complex mu;
  double complex beyond_critical;
};

/* bend: positive for the arc with +k, negative for the other. With V = e^U and
 * tau = rho e^(-i bend): for eta > 1 (v - 1) / (V - v) = tau, where
 * mu' - mu_c = mu' mu_c (cosh U - cosh u') = mu' mu_c (V - v) (V v - 1) / (2 V v);
 * for eta < 1 v - 1 = tau, which bends the path to infinity likewise. */
static struct path_point path_at(const nodes_rules *rules, double size, double bend, double s) {
  const double eta = rules->eta;
  const struct stretch stretch = stretched(eta > 1, size, s);
  double sine, cosine;
  fn_sincos(bend, &sine, &cosine);
  const double complex tau = stretch.rho * CMPLX(cosine, -sine);
  const double end = eta > 1 ? sqrt((eta + 1) / (eta - 1)) : 0; /* V */
  const double complex share = fn_inverse(1 + tau);
  struct path_point point;
  point.v_less_1 = eta > 1 ? (end - 1) * tau * share : tau;
  point.dv = (eta > 1 ? point.v_less_1 * share : tau) * stretch.slope;
  const double complex v = 1 + point.v_less_1;
  point.mu = 2 * v * fn_inverse(v * v + 1);
  point.beyond_critical = point.mu;
  if (eta > 1) {
    const double complex v_to_end = (end - 1) * share;
    const double complex less_critical = v_to_end * (end * v - 1) * fn_inverse(2 * end * v);
    point.beyond_critical = point.mu * critical_mu(eta) * less_critical;
  }
  return point;
}

/* The integrals of dmu / mu T / D and of dmu T / D from mu_c to mu', that is of C from C' to where
 * T ends. With mu = mu_c + (mu' - mu_c) cos^2(phi): C - C' = (mu' - mu_c) sin^2(phi) / (mu mu'),
 * which takes out the root of D, and mu_t^2 = eta^2 (mu - mu_c) (mu + mu_c) has one in cos(phi). */
struct densities {
  double complex kernel;
  double complex exit;
};

static struct densities arc_densities(const nodes_rules *rules, double complex k,
                                      const struct path_point *at, double complex c_other) {
  const double eta = rules->eta;
  const double mu_c = critical_mu(eta);
  const double complex root = fn_csqrt(at->beyond_critical);
  const double complex shared =
      2 * fn_csqrt(at->beyond_critical * at->mu) * fn_inverse(fn_csqrt(1 + k * k));
  struct densities sum = {0, 0};
  for (size_t i = 0; i < rules->transmitted.n; i++) {
    double sine, cosine;
    fn_sincos(0.5 * FN_PI * rules->transmitted.x[i], &sine, &cosine);
    const double complex mu = mu_c + at->beyond_critical * (cosine * cosine);
    const double complex mu_t = eta > 1 ? eta * cosine * root * fn_csqrt(mu + mu_c)
                                        : fn_csqrt((1 - eta) * (1 + eta) + eta * eta * mu * mu);
    const double complex d = fn_csqrt(mu) * fn_csqrt(fn_inverse(mu) - c_other);
    const double weight = 0.5 * FN_PI * rules->transmitted.weight[i] * cosine;
    const double complex term = weight * transmittance(eta, mu, mu_t) * fn_inverse(d);
    sum.kernel += term;
    sum.exit += term * mu;
  }
  return (struct densities){shared * sum.kernel, shared * sum.exit};
}

/* Not so far that it comes near u' = -i psi, where C' = C''. */
static double bend_angle(double complex k) {
  const double complex ik = CMPLX(-cimag(k), creal(k));
  const double psi = 0.5 * cimag(fn_clog((1 + ik) * fn_inverse(1 - ik))); /* Re atan(k) */
  return fmax(0.15, 0.75 * (psi - 0.55));
}

/* side: 1 for the arc with +k, -1 for the other. */
static void add_arc(nodes *to, const nodes_rules *rules, double complex k, int side,
                    const gauss_rule *rule) {
  const double eta = rules->eta;
  const double size = arc_size(eta, k);
  const double complex ik = CMPLX(0, side) * k;
  /* e^(2 i psi) = (1 + i tan(psi)) / (1 - i tan(psi)) */
  const double complex turn = (1 + ik) * fn_inverse(1 - ik);
  const double bend = side * bend_angle(k);
  for (size_t i = 0; i < rule->n; i++) {
    const struct path_point at = path_at(rules, size, bend, rule->x[i]);
    const double complex v = 1 + at.v_less_1;
    const double complex by_v = fn_inverse(v);
    const double complex sinh_u = 0.5 * at.v_less_1 * (v + 1) * by_v;
    const double complex cosh_u = 0.5 * (v + by_v);
    const double complex c_other = 0.5 * (v * turn + by_v * fn_inverse(turn));
    const struct densities m = arc_densities(rules, k, &at, c_other);
    const double complex dp = (sinh_u + ik * cosh_u) * at.dv * by_v;
    const double complex measure = CMPLX(0, -side * rule->weight[i] / (2 * FN_PI)) * dp;
    to->p[to->n] = cosh_u + ik * sinh_u;
    to->kernel[to->n] = -measure * m.kernel;
    to->exit[to->n] = measure * m.exit;
    to->n++;
  }
}

/* ---- all of them ---------------------------------------------------------------------------- */

bool transport_nodes_make(nodes *to, const nodes_rules *rules, double complex k) {
  const bool chords = rules->eta != 1 && fn_abs(k) < CHORDS_UP_TO;
  gauss_rule path; /* for each arc, or for what meets no boundary */
  transport_gauss(&path, arc_points(rules, k));
  const size_t room = rules->scattered.n + 2 * path.n + rules->chords.n * rules->chord_points;
  double complex *block = malloc(3 * room * sizeof *block);
  if (block == NULL) {
    *to = (nodes){0, NULL, NULL, NULL};
    return false;
  }
  *to = (nodes){0, block, block + room, block + 2 * room};
  if (rules->eta == 1) {
    add_unreflected(to, k, &path);
    return true;
  }
  add_scattered(to, rules, k);
  if (chords) {
    add_chords(to, rules, k);
  } else {
    add_arc(to, rules, k, 1, &path);
    add_arc(to, rules, k, -1, &path);
  }
  return true;
}

void transport_nodes_free(nodes *of) {
  free(of->p);
  *of = (nodes){0, NULL, NULL, NULL};
}
