#include "core/tools/phases/mie.h"

#include <complex.h>
#include <math.h>
#include <string.h>

#include "core/tools/tools.h"
#include "core/transport/gauss.h"

enum { TERMS_MAX = 120, PANELS = 12, PANEL_NODES = 24, ANGLES = PANELS * PANEL_NODES, SIZES = 21 };

/* Adds |S1|^2 + |S2|^2 of a sphere, times `share`, at each cosine. The equations are those of
 * Bohren and Huffman 1983, section 4.8 and Appendix A: D is the logarithmic derivative of psi(index
 * x), by downward recurrence; psi and chi are Riccati and Bessel's functions of x. Returns the
 * number of terms. */
static size_t add_sphere(double index, double x, double share, const double *mu, double *sum) {
  const size_t terms = (size_t)(x + 4 * cbrt(x) + 2);
  double D[TERMS_MAX + 16] = {0}, before[ANGLES] = {0}, here[ANGLES];
  double complex S1[ANGLES] = {0}, S2[ANGLES] = {0};
  if (terms > TERMS_MAX) {
    tools_fail("a sphere of size %g is too large", x);
  }
  for (size_t n = terms + 15; n > 1; n--) {
    const double ratio = (double)n / (index * x);
    D[n - 1] = ratio - 1 / (D[n] + ratio);
  }
  double psi0 = cos(x), psi1 = sin(x), chi0 = -sin(x), chi1 = cos(x);
  for (size_t i = 0; i < ANGLES; i++) {
    here[i] = 1;
  }
  for (size_t n = 1; n <= terms; n++) {
    const double order = (double)n;
    const double psi = (2 * order - 1) * psi1 / x - psi0, chi = (2 * order - 1) * chi1 / x - chi0;
    const double complex xi = CMPLX(psi, -chi), xi1 = CMPLX(psi1, -chi1);
    const double electric = D[n] / index + order / x, magnetic = index * D[n] + order / x;
    const double complex a = (electric * psi - psi1) / (electric * xi - xi1);
    const double complex b = (magnetic * psi - psi1) / (magnetic * xi - xi1);
    const double factor = (2 * order + 1) / (order * (order + 1));
    for (size_t i = 0; i < ANGLES; i++) {
      const double tau = order * mu[i] * here[i] - (order + 1) * before[i];
      S1[i] += factor * (a * here[i] + b * tau);
      S2[i] += factor * (a * tau + b * here[i]);
      const double next = ((2 * order + 1) * mu[i] * here[i] - (order + 1) * before[i]) / order;
      before[i] = here[i];
      here[i] = next;
    }
    psi0 = psi1;
    psi1 = psi;
    chi0 = chi1;
    chi1 = chi;
  }
  for (size_t i = 0; i < ANGLES; i++) {
    sum[i] += share * (creal(S1[i] * conj(S1[i])) + creal(S2[i] * conj(S2[i])));
  }
  return terms;
}

/* The phase function is a polynomial of degree 2 terms in the cosine, so further moments are 0. */
size_t mie_moments(double index, double size, double spread, double *moment, size_t moments_most) {
  double mu[ANGLES], weight[ANGLES], p[ANGLES] = {0};
  gauss_rule rule;
  transport_gauss(&rule, PANEL_NODES);
  for (size_t i = 0; i < ANGLES; i++) {
    mu[i] = -1 + 2.0 / PANELS * ((double)(i / PANEL_NODES) + rule.x[i % PANEL_NODES]);
    weight[i] = 2.0 / PANELS * rule.weight[i % PANEL_NODES];
  }
  size_t terms = 0;
  const int sizes = spread > 0 ? SIZES : 1;
  for (int i = 0; i < sizes; i++) {
    const double t = sizes > 1 ? 3 * (2.0 * i / (sizes - 1) - 1) : 0; /* up to 3 deviations */
    const size_t more = add_sphere(index, size * exp(spread * t), exp(-0.5 * t * t), mu, p);
    terms = more > terms ? more : terms;
  }
  const size_t count = 2 * terms + 1 < moments_most ? 2 * terms + 1 : moments_most;
  memset(moment, 0, count * sizeof *moment);
  for (size_t i = 0; i < ANGLES; i++) {
    double before = 0, here = 1;
    for (size_t l = 0; l < count; l++) {
      const double order = (double)l;
      const double next = ((2 * order + 1) * mu[i] * here - order * before) / (order + 1);
      moment[l] += weight[i] * p[i] * here;
      before = here;
      here = next;
    }
  }
  for (size_t l = count; l-- > 0;) {
    moment[l] /= moment[0];
  }
  return count;
}
