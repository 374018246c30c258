/* The measures of the transport equation. All kernels are means of exponentials e^(-pt) over complex
 * decay rates p, where t is a sum or a difference of depths in mean free paths. For a wavenumber k
 * across the plane, with mu the cosine and x the tangent of the angle to the normal, and C = 1 / mu:
 *
 *   K(t)   = 1/2 int dmu / mu        J0(k t x) e^(-C t)   light that reaches another depth
 *   K_T(t) = 1/2 int dmu / mu T(mu)  J0(k t x) e^(-C t)   the part that the boundary lets out
 *   X(t)   = 1/2 int dmu      T(mu)  J0(k t x) e^(-C t)   the exitance of a source at depth t
 *
 * T = 1 - F is Fresnel's transmittance from inside. The kernel of the light that the boundary
 * reflects is K - K_T. The weights `kernel` represent it and the weights `exit` represent X: K -
 * K_T = sum of kernel[i] e^(-p[i] t) and X = sum of exit[i] e^(-p[i] t).
 */
#include <assert.h>
#include <math.h>
#include <stdbool.h>

#include "core/transport/functions.h"
#include "core/transport/gauss.h"
#include "tests/accuracy/isotropic/parts.h"

/* For Re z >= 0 and m = e^z - 1, sinh z = (m + m / (1 + m)) / 2 and cosh z = 1 + m^2 / (2 (1 + m)).
 */
void isotropic_sinhcosh(double complex z, double complex *sine, double complex *cosine) {
  const double sign = creal(z) < 0 ? -1 : 1;
  const double complex m = fn_cexpm1(sign * z);
  const double complex quotient = m * fn_inverse(1 + m);
  *sine = sign * 0.5 * (m + quotient);
  *cosine = 1 + 0.5 * m * quotient;
}

/* Adds a node. */
static void add(nodes *to, double complex p, double complex kernel, double complex exit) {
  assert(to->n < sizeof to->p / sizeof to->p[0]);
  to->p[to->n] = p;
  to->kernel[to->n] = kernel;
  to->exit[to->n] = exit;
  to->n++;
}

/* Below this |k| the measure of the boundary is integrated along chords in the plane of p, which
 * are short then. Above it, it is integrated along the two arcs on which the chords end. */
#define CHORDS_UP_TO 1.0

/* Returns the smallest cosine of light that leaves: that of the critical angle, or 0 if there is
 * none. */
static double critical_mu(double eta) {
  return eta > 1 ? sqrt((eta - 1) * (eta + 1)) / eta : 0;
}

/* Returns the rapidity u = asinh x of the critical angle, for eta > 1. */
static double critical_rapidity(double eta) {
  return 0.5 * fn_log((eta + 1) / (eta - 1));
}

/* Returns Fresnel's transmittance for unpolarized light, from the cosines mu inside and mu_t
 * outside: T = 2 eta mu mu_t [1 / (eta mu + mu_t)^2 + 1 / (mu + eta mu_t)^2]. */
static double complex transmittance(double eta, double complex mu, double complex mu_t) {
  const double complex s = eta * mu + mu_t;
  const double complex p = mu + eta * mu_t;
  return 2 * eta * mu * mu_t * (fn_inverse(s * s) + fn_inverse(p * p));
}

/* ---- how many points ------------------------------------------------------------------------ */

/* The numbers of points below were found by comparing with twice as many, over eta from 0.25 to 4
 * and |k| up to 1e4. With these numbers the error of the exitance is about the accuracy. */

static void make_rule(gauss_rule *rule, double count) {
  transport_gauss(rule, count < GAUSS_MAX ? (size_t)count : GAUSS_MAX);
}

/* Returns how many e-folds of mu separate the critical angle from grazing incidence or, for eta <
 * 1, the branch point of mu_t from the real axis. */
static double nearness(double eta) {
  return eta == 1 ? 0 : fn_log(1 + 1 / sqrt(fabs((eta - 1) * (eta + 1))));
}

/* Returns |k| times the tangent of the critical angle, at which the arcs end; returns |k| if eta <=
 * 1. */
static double arc_size(double eta, double complex k) {
  return eta > 1 ? fn_abs(k) / sqrt((eta - 1) * (eta + 1)) : fn_abs(k);
}

/* ---- paths through many scales -------------------------------------------------------------- */

/* A point of a path: its parameter rho, from 0 to infinity, and d(ln rho) / ds, for s from 0 to 1.
 */
struct stretch {
  double rho;
  double slope;
};

/* Returns the point at s of a path whose integrand varies on the scales from 1 / size to 1.
 *
 * With two ends, rho = c A / B^2 with A = e^(L s) - 1 and B = e^(M (1 - s)) - 1. This rho goes
 * through the scales towards 0 and towards infinity at an even pace, and continues beyond them as s
 * and (1 - s)^-2. With one end the integrand decays from rho = 1 on, and B = 1 - s.
 */
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

/* Adds the nodes of K(t) = int ds / (2 p) e^(-pt), p = sqrt(s^2 + k^2), s from 1 to infinity. In z
 * = s + p this is dz / (2 z) with p = (z + k^2 / z) / 2, which contains no root. z runs from z0 = 1
 * + sqrt(1 + k^2) away from 0: z = z0 / t^2 with t from 1 to 0. */
static void add_scattered(nodes *to, double digits, double complex k) {
  const double complex z0 = 1 + fn_csqrt(1 + k * k);
  gauss_rule rule;
  make_rule(&rule, 4 + 0.7 * digits);
  for (size_t i = 0; i < rule.n; i++) {
    const double t = rule.x[i];
    const double complex z = z0 / (t * t);
    add(to, 0.5 * (z + k * k * fn_inverse(z)), rule.weight[i] / t, 0);
  }
}

/* Adds the nodes for eta = 1. Nothing is reflected, and X(t) = 1/2 int ds / s^2 e^(-pt). The factor
 * 1 / s^2 varies on the scale 1 of s, and p on the scale |k|. So z = z0 (1 + rho), with rho from
 * stretched(). */
static void add_unreflected(nodes *to, double complex k, const gauss_rule *rule) {
  const double complex z0 = 1 + fn_csqrt(1 + k * k);
  for (size_t i = 0; i < rule->n; i++) {
    const struct stretch stretch = stretched(false, fn_abs(k), rule->x[i]);
    const double complex z = z0 * (1 + stretch.rho);
    const double complex p = 0.5 * (z + k * k * fn_inverse(z));
    const double complex s = 0.5 * (z - k * k * fn_inverse(z));
    const double dz_by_z = stretch.rho * stretch.slope / (1 + stretch.rho) * rule->weight[i];
    add(to, p, 0, 0.5 * dz_by_z * p * fn_inverse(s * s));
  }
}

/* ---- what is transmitted, for small k ------------------------------------------------------- */

/* One angle: the cosine mu, the tangent x, and the weight, which is that of 1/2 dmu / mu T. */
struct angle {
  double mu;
  double x;
  double weight;
};

/* Returns the angle at t in (0, 1) for eta > 1. The substitution u = U (1 - t^2) removes the square
 * root that T has at the critical angle. In it dmu / mu = tanh u du, mu_t^2 = eta^2 (mu - mu_c) (mu
 * + mu_c) and mu - mu_c = mu mu_c (cosh U - cosh u) = 2 mu mu_c sinh((U + u) / 2) sinh((U - u) /
 * 2). */
static struct angle angle_inside_denser(double eta, double t, double weight) {
  const double limit = critical_rapidity(eta);
  const double mu_c = critical_mu(eta);
  const double u = limit * (1 - t * t);
  double complex sinh_u, cosh_u, sum, difference, unused;
  isotropic_sinhcosh(u, &sinh_u, &cosh_u);
  isotropic_sinhcosh(0.5 * (limit + u), &sum, &unused);
  isotropic_sinhcosh(0.5 * limit * t * t, &difference, &unused);
  const double mu = 1 / creal(cosh_u);
  const double beyond_critical = 2 * mu * mu_c * creal(sum) * creal(difference);
  const double mu_t = eta * sqrt(beyond_critical * (mu + mu_c));
  const double measure = creal(sinh_u) * mu * 2 * limit * t * weight;
  return (struct angle){mu, creal(sinh_u), 0.5 * measure * creal(transmittance(eta, mu, mu_t))};
}

/* Returns the angle at t in (0, 1) for eta < 1, where light leaves at every angle; mu = t^2. */
static struct angle angle_outside_denser(double eta, double t, double weight) {
  const double mu = t * t;
  const double mu_t = sqrt((1 - eta) * (1 + eta) + eta * eta * mu * mu);
  const double measure = 2 * weight / t;
  return (struct angle){mu, sqrt((1 - mu) * (1 + mu)) / mu,
                        0.5 * measure * creal(transmittance(eta, mu, mu_t))};
}

/* Adds the nodes of K_T and X for small k. J0(k t x) e^(-C t) is the mean of e^(-pt) over the chord
 * p = C - i k x cos(phi), which the midpoint rule in phi computes. */
static void add_chords(nodes *to, double eta, double for_root, double complex k) {
  const int points = (int)for_root;
  gauss_rule rule;
  make_rule(&rule, for_root * (1 + 0.1 * nearness(eta)));
  for (size_t i = 0; i < rule.n; i++) {
    const struct angle angle = eta > 1 ? angle_inside_denser(eta, rule.x[i], rule.weight[i])
                                       : angle_outside_denser(eta, rule.x[i], rule.weight[i]);
    for (int j = 0; j < points; j++) {
      double sine, cosine;
      fn_sincos(FN_PI * (j + 0.5) / points, &sine, &cosine);
      add(to, 1 / angle.mu - CMPLX(0, 1) * k * (angle.x * cosine), -angle.weight / points,
          angle.weight * angle.mu / points);
    }
  }
}

/* ---- what is transmitted, for large k ------------------------------------------------------- */

/* The ends of all chords lie on the two arcs p = cosh u +- i k sinh u, u from 0 to the critical
 * rapidity U, which meet at p = 1. Each chord can be deformed onto the part of the arcs between its
 * ends. This makes one measure of all chords. On an arc, at C' = cosh u', the chords with C = cosh
 * u > C' give
 *
 *   dnu = +-1 / (2 pi i) m(u') dp(u'),    m(u') = int dmu / mu T(mu) / D(u, u')
 *   D^2 = (p - C)^2 + k^2 sinh^2 u = (1 + k^2) (C - C') (C - C''),  C'' = cosh(u' + 2 i psi),
 *
 * with tan(psi) = +-k. This density is an analytic function of p, so the path of u' may leave the
 * real axis. The code bends the path so that p keeps away from the imaginary axis, where p + q of
 * nodes on opposite arcs would be small compared with k. In v = e^u' the path is a circular arc
 * that leaves its ends under the angle `bend`.
 */

/* A point of the path, with v = e^u': v - 1, dv / ds where s from 0 to 1 is the path's parameter,
 * the cosine mu' = 1 / C' = 2 v / (v^2 + 1), and mu' - mu_c. */
struct path_point {
  double complex v_less_1;
  double complex dv;
  double complex mu;
  double complex beyond_critical;
};

/* Returns the point of the path at s. bend is the angle at the path's ends, positive for the arc
 * with +k and negative for the arc with -k. stretched() gives rho at s, and tau = rho e^(-i bend).
 *
 *   eta > 1:   (v - 1) / (V - v) = tau with V = e^U. The path goes from v = 1 to v = V.
 *   eta < 1:   v - 1 = tau. The path goes from v = 1 to infinity.
 *
 * For eta > 1 the critical cosine is mu_c = 1 / cosh U, and mu' = 1 / cosh u' with v = e^u'. So
 * mu' - mu_c = mu' mu_c (cosh U - cosh u') = mu' mu_c (V - v) (V v - 1) / (2 V v). */
static struct path_point path_at(double eta, double size, double bend, double s) {
  const struct stretch stretch = stretched(eta > 1, size, s);
  double sine, cosine;
  fn_sincos(bend, &sine, &cosine);
  const double complex tau = stretch.rho * CMPLX(cosine, -sine);
  /* V, the end of the path in v = e^u'; 0 for eta < 1, which does not use it */
  const double end = eta > 1 ? sqrt((eta + 1) / (eta - 1)) : 0;
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

/* The integrals of dmu / mu T / D (kernel) and of dmu T / D (exit) over mu from mu_c to mu', which
 * is C from C' to where T ends. The substitution mu = mu_c + (mu' - mu_c) cos^2(phi) makes C - C' =
 * (mu' - mu_c) sin^2(phi) / (mu mu'). This removes the root of D, and also the root of mu_t^2 =
 * eta^2 (mu - mu_c) (mu + mu_c), which becomes a factor cos(phi) of mu_t. */
struct densities {
  double complex kernel;
  double complex exit;
};

static struct densities arc_densities(double eta, const gauss_rule *rule, double complex k,
                                      const struct path_point *at, double complex c_other) {
  const double mu_c = critical_mu(eta);
  const double complex root = fn_csqrt(at->beyond_critical);
  const double complex shared =
      2 * fn_csqrt(at->beyond_critical * at->mu) * fn_inverse(fn_csqrt(1 + k * k));
  struct densities sum = {0, 0};
  for (size_t i = 0; i < rule->n; i++) {
    double sine, cosine;
    fn_sincos(0.5 * FN_PI * rule->x[i], &sine, &cosine);
    const double complex mu = mu_c + at->beyond_critical * (cosine * cosine);
    const double complex mu_t = eta > 1 ? eta * cosine * root * fn_csqrt(mu + mu_c)
                                        : fn_csqrt((1 - eta) * (1 + eta) + eta * eta * mu * mu);
    const double complex d = fn_csqrt(mu) * fn_csqrt(fn_inverse(mu) - c_other);
    const double weight = 0.5 * FN_PI * rule->weight[i] * cosine;
    const double complex term = weight * transmittance(eta, mu, mu_t) * fn_inverse(d);
    sum.kernel += term;
    sum.exit += term * mu;
  }
  return (struct densities){shared * sum.kernel, shared * sum.exit};
}

/* Returns the angle under which the path leaves its ends. It is small enough that the path keeps
 * away from u' = -i psi, where C' = C''. */
static double bend_angle(double complex k) {
  const double complex ik = CMPLX(-cimag(k), creal(k));
  const double psi = 0.5 * cimag(fn_clog((1 + ik) * fn_inverse(1 - ik))); /* Re atan(k) */
  return fmax(0.15, 0.75 * (psi - 0.55));
}

/* Adds the nodes of one of the two arcs of decay rates, p = cosh u + side i k sinh u. side: 1 or -1.
 * angles: a rule for what is transmitted. */
static void add_arc(nodes *to, double eta, double complex k, int side, const gauss_rule *rule,
                    const gauss_rule *angles) {
  const double size = arc_size(eta, k);
  const double complex ik = CMPLX(0, side) * k;
  /* turn = e^(2 i psi) = (1 + i tan(psi)) / (1 - i tan(psi)) */
  const double complex turn = (1 + ik) * fn_inverse(1 - ik);
  const double bend = side * bend_angle(k);
  for (size_t i = 0; i < rule->n; i++) {
    const struct path_point at = path_at(eta, size, bend, rule->x[i]);
    const double complex v = 1 + at.v_less_1;
    const double complex by_v = fn_inverse(v);
    const double complex sinh_u = 0.5 * at.v_less_1 * (v + 1) * by_v;
    const double complex cosh_u = 0.5 * (v + by_v);
    const double complex c_other = 0.5 * (v * turn + by_v * fn_inverse(turn));
    const struct densities m = arc_densities(eta, angles, k, &at, c_other);
    const double complex dp = (sinh_u + ik * cosh_u) * at.dv * by_v;
    const double complex measure = CMPLX(0, -side * rule->weight[i] / (2 * FN_PI)) * dp;
    add(to, cosh_u + ik * sinh_u, -measure * m.kernel, measure * m.exit);
  }
}

/* ---- all nodes ------------------------------------------------------------------------------ */

void isotropic_nodes(nodes *to, double eta, double accuracy, double complex k) {
  const double digits = -fn_log(accuracy), for_root = 6 + 0.6 * digits;
  gauss_rule path, angles; /* path: a rule for each arc, or for all of X if eta is 1 */
  make_rule(&path, (3 + digits) * (0.85 + 0.3 * fn_log(1 + arc_size(eta, k))));
  to->n = 0;
  if (eta == 1) {
    add_unreflected(to, k, &path);
    return;
  }
  add_scattered(to, digits, k);
  if (fn_abs(k) < CHORDS_UP_TO) {
    add_chords(to, eta, for_root, k);
    return;
  }
  make_rule(&angles, for_root * (1 + 0.2 * nearness(eta)));
  add_arc(to, eta, k, 1, &path, &angles);
  add_arc(to, eta, k, -1, &path, &angles);
}
