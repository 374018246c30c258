/* The beam goes down to the depth t, scatters into the angle whose tangent is x = r / t and leaves:
 *
 *   R1(r) = a / (4 pi r) int_0^X (1 + x^2)^(-3/2) T(x) e^(-(r / x) (1 + sqrt(1 + x^2))) dx,
 *
 * where X is the tangent of the critical angle. The exponent is -r E with E = coth(u / 2), x = sinh
 * u and mu = 1 / cosh u = (E^2 - 1) / (E^2 + 1), so that
 *
 *   R1(r) = a / (4 pi r) int_E0^inf w(E) e^(-rE) dE,   w(E) = 2 (E^2 - 1) / (E^2 + 1)^2 T,
 *   energy within r = a / 2 int_E0^inf w(E) (1 - e^(-rE)) / E dE,
 *
 * with E0 = eta + sqrt(eta^2 - 1), or 1 if eta < 1. In y = ln(E - E0) the trapezoidal rule
 * converges exponentially for every r, because both the root of T at E0 and the scale 1 / r are
 * smooth in y.
 *
 * Light of a cone of angles has a larger E0, that of the cosine at the cone's edge inside: E0^2 =
 * (1 + mu) / (1 - mu). Its E0 is where w begins, and y = ln(E - E0).
 *
 * Diffuse light has the radiance T(mu) / <mu T> behind the boundary, with <f> = int_0^1 f dmu. It is
 * scattered from the cosine mu' to mu with p, the mean of the phase function over the azimuth:
 *
 *   energy = a / (2 <mu T>) <<T(mu) T(mu') mu mu' / (mu + mu') p(mu, -mu')>>,
 *   p(mu, -mu') = sum over l of (-1)^l (2 l + 1) g_l P_l(mu) P_l(mu').
 */
#include "core/transport/single.h"

#include <math.h>
#include <stdbool.h>

#include "core/transport/functions.h"
#include "core/transport/gauss.h"

/* The rule covers y from Y_MIN to Y_MAX. The rest is below 1e-13 for r up to 1e8, and for r = 0. */
#define Y_MIN (-40.0)
#define Y_MAX 32.0

double transport_transmittance(double eta, double mu, double mu_outside) {
  const double s = eta * mu + mu_outside;
  const double p = mu + eta * mu_outside;
  return 2 * eta * mu * mu_outside * (1 / (s * s) + 1 / (p * p));
}

/* Returns the transmittance T at E = E0 + distance, where mu is the cosine inside. */
static double transmittance(double eta, double e0, double distance, double mu) {
  const double e = e0 + distance;
  double mu_t;
  if (eta > 1) {
    /* beyond = mu - mu_c = 2 (E^2 - E0^2) / ((E^2 + 1) (E0^2 + 1)) */
    const double mu_c = sqrt((eta - 1) * (eta + 1)) / eta;
    const double beyond = 2 * distance * (e + e0) / ((e * e + 1) * (e0 * e0 + 1));
    mu_t = eta * sqrt(beyond * (mu + mu_c));
  } else {
    mu_t = sqrt((1 - eta) * (1 + eta) + eta * eta * mu * mu);
  }
  return transport_transmittance(eta, mu, mu_t);
}

single_node transport_single_node(double eta, double e0, double distance) {
  const double e = e0 + distance;
  /* above_one = E^2 - 1 = (E0^2 - 1) + (E^2 - E0^2), and E0^2 - 1 = 2 root E0 */
  const double root = eta > 1 ? sqrt((eta - 1) * (eta + 1)) : 0;
  const double above_one = 2 * root * e0 + distance * (e + e0);
  const double sum = e * e + 1, mu = above_one / sum;
  const double t = eta == 1 ? 1 : transmittance(eta, e0, distance, mu);
  return (single_node){e, mu, 2 * above_one / (sum * sum) * t};
}

void transport_single_rule(single_rule *rule, double eta, double sine, double step) {
  const double e0 = eta > 1 ? eta + sqrt((eta - 1) * (eta + 1)) : 1;
  const double inside = sine / eta; /* sine of the cone's edge */
  const bool all = sine >= 1 || inside >= 1;
  /* (1 + mu) / sqrt(1 - mu^2), less E0 */
  const double cone = all ? 0 : (1 + sqrt((1 - inside) * (1 + inside))) / inside - e0;
  rule->n = 0;
  for (double y = Y_MIN; y <= Y_MAX && rule->n < SINGLE_MAX; y += step) {
    const double beyond = fn_exp(y);
    const single_node node = transport_single_node(eta, e0, cone + beyond);
    rule->rate[rule->n] = node.rate;
    rule->weight[rule->n] = node.weight * beyond * step;
    rule->n++;
  }
}

single_values transport_single_at(const single_rule *rule, double r) {
  single_values sum = {0, 0};
  for (size_t i = 0; i < rule->n; i++) {
    const double exponent = r * rule->rate[i];
    const double left = fn_exp(-exponent);
    const double absorbed = exponent < 0.5 ? -creal(fn_cexpm1(-exponent)) : 1 - left;
    sum.r += rule->weight[i] * left;
    sum.within += rule->weight[i] * absorbed / rule->rate[i];
  }
  sum.within *= 0.5;
  sum.r = sum.r / (4 * FN_PI * r);
  return sum;
}

/* ---- diffuse light --------------------------------------------------------------------------- */

enum { ANGLE_PANELS = 10, ANGLE_NODES = 8, ANGLES = ANGLE_PANELS * ANGLE_NODES };

/* Cosines inside, with weights for integrals of mu T f(mu). */
struct angles {
  double mu[ANGLES], weight[ANGLES];
};

/* The rule is in the cosine outside for eta > 1, and in that inside otherwise. Its panels halve
 * towards the grazing angle, around which light is scattered forward from its way down to its way
 * up. */
static void find_angles(struct angles *to, double eta) {
  gauss_rule rule;
  transport_gauss(&rule, ANGLE_NODES);
  double upper = 1;
  for (size_t panel = 0; panel < ANGLE_PANELS; panel++) {
    const double lower = panel + 1 < ANGLE_PANELS ? upper / 2 : 0;
    for (size_t i = 0; i < rule.n; i++) {
      const size_t at = panel * ANGLE_NODES + i;
      const double x = lower + (upper - lower) * rule.x[i];
      const double mu = eta > 1 ? sqrt((eta - 1) * (eta + 1) + x * x) / eta : x;
      const double outside = eta < 1 ? sqrt((1 - eta) * (1 + eta) + eta * eta * x * x) : x;
      const double t = eta == 1 ? 1 : transport_transmittance(eta, mu, outside);
      to->mu[at] = mu;
      to->weight[at] = (upper - lower) * rule.weight[i] * t * (eta > 1 ? x / (eta * eta) : x);
    }
    upper = lower;
  }
}

double transport_single_diffuse(double eta, size_t moments, const double *moment) {
  struct angles angles;
  double before[ANGLES] = {0}, here[ANGLES], scattered[ANGLES][ANGLES] = {{0}};
  double entering = 0, sum = 0;
  find_angles(&angles, eta);
  for (size_t i = 0; i < ANGLES; i++) {
    here[i] = 1;
    entering += angles.weight[i];
  }
  for (size_t l = 0; l < moments; l++) {
    const double odd = (double)(2 * l + 1), factor = (l % 2 == 0 ? odd : -odd) * moment[l];
    for (size_t i = 0; i < ANGLES; i++) {
      const double left = factor * here[i];
      for (size_t j = 0; j <= i; j++) {
        scattered[i][j] += left * here[j];
      }
    }
    for (size_t i = 0; i < ANGLES; i++) {
      const double next = (odd * angles.mu[i] * here[i] - (double)l * before[i]) / (double)(l + 1);
      before[i] = here[i];
      here[i] = next;
    }
  }
  for (size_t i = 0; i < ANGLES; i++) {
    for (size_t j = 0; j <= i; j++) {
      sum += (j < i ? 2 : 1) * angles.weight[i] * angles.weight[j] * scattered[i][j] /
             (angles.mu[i] + angles.mu[j]);
    }
  }
  return 0.5 * sum / entering;
}
