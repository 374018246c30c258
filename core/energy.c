#include "core/energy.h"

#include <math.h>
#include <pthread.h>

#define CORE_REAL 64
#include "core/kernel.h"
#include "core/legendre.h"

/* The width of a panel in ln r. For a profile that falls like e^(-mu r), the series is exact to
 * double precision with this width wherever the panel has a noticeable share of the energy. */
#define WIDTH 0.5

enum { NODES = CORE_LEGENDRE_TERMS, KEPT = 96 };

static double radius_at(size_t panel, int i) {
  return real_exp_signed((double)panel * WIDTH + WIDTH * core_gauss_node(i));
}

/* The radii at the nodes of the first panels, over the first radius: all that most profiles need. */
static double kept[KEPT][NODES];
static pthread_once_t kept_once = PTHREAD_ONCE_INIT;

static void keep_radii(void) {
  for (size_t i = 0; i < KEPT * NODES; i++) {
    kept[i / NODES][i % NODES] = radius_at(i / NODES, (int)(i % NODES));
  }
}

static size_t panels_between(double first_mm, double last_mm) {
  return (size_t)ceil(real_log(last_mm / first_mm, 0) / WIDTH);
}

size_t core_energy_length(double first_mm, double last_mm) {
  return CORE_ENERGY_SERIES + panels_between(first_mm, last_mm) * CORE_ENERGY_TERMS;
}

/* Sets the Legendre series of the integral from -1 to s of a function given at the nodes of the
 * Gauss rule: int P_k = (P_(k+1) - P_(k-1)) / (2 k + 1). */
static void integrate_series(const double *g, double half_width, double *series) {
  double coefficients[NODES];
  core_legendre_fit(g, coefficients);
  for (int k = 0; k < CORE_ENERGY_TERMS; k++) {
    const double above = k > 0 ? coefficients[k - 1] / (2 * k - 1) : coefficients[0];
    const double below = k + 1 < NODES ? coefficients[k + 1] / (2 * k + 3) : 0;
    series[k] = half_width * (above - below);
  }
}

/* Returns the energy of a panel, and writes its series. */
static double build_panel(const core_kernels_f64 *kernels, const double *c, double first_mm,
                          size_t panel, double *series) {
  double r[NODES];
  double g[NODES];
  double energy = 0;
  for (int i = 0; i < NODES; i++) {
    r[i] = first_mm * (panel < KEPT ? kept[panel][i] : radius_at(panel, i));
  }
  core_run_f64(kernels, kernels->evaluate[CORE_ELEMENTWISE_R], c, NODES, r, g);
  for (int i = 0; i < NODES; i++) {
    g[i] *= 6.28318530717958647693 * r[i] * r[i];
    energy = fma(core_gauss_weight(i), g[i], energy);
  }
  integrate_series(g, 0.5 * WIDTH, series);
  return WIDTH * energy;
}

double core_energy_build(const core_kernels_f64 *kernels, const double *c, double first_mm,
                         double last_mm, double *table) {
  const size_t panels = panels_between(first_mm, last_mm);
  pthread_once(&kept_once, keep_radii);
  double ends[3] = {first_mm, first_mm * 1.0625, first_mm * 0x1p-64};
  double density[3]; /* 2 pi r R at these radii */
  core_run_f64(kernels, kernels->evaluate[CORE_ELEMENTWISE_R], c, 3, ends, density);
  for (int i = 0; i < 3; i++) {
    density[i] *= 6.28318530717958647693 * ends[i];
  }
  /* Below the first radius R is proportional to 1 / r, or it is R0 + R1 ln(first / r). In the
   * second case the energy within r is pi r^2 (R0 + R1 / 2 + R1 ln(first / r)). */
  const bool steep = !(density[1] > 1.03 * density[0]);
  const double rise = (density[2] * 0x1p64 / density[0] - 1) / real_log(0x1p64, 0); /* R1 / R0 */
  /* A logarithm rises by less than R itself in a factor e; more is 1 / r nearer to the source, where it
   * has no energy. */
  const bool rises = !steep && rise > 0 && rise < 1;
  double energy = density[0] * first_mm * (steep ? 1 : rises ? 0.5 + 0.25 * rise : 0.5);
  for (size_t i = 0; i < panels; i++) {
    double *series = table + CORE_ENERGY_SERIES + i * CORE_ENERGY_TERMS;
    const double gained = build_panel(kernels, c, first_mm, i, series);
    series[0] += energy;
    energy += gained;
  }
  for (size_t i = 0; energy > 0 && i < panels * CORE_ENERGY_TERMS; i++) {
    table[CORE_ENERGY_SERIES + i] /= energy;
  }
  table[CORE_ENERGY_PANELS] = (double)panels;
  table[CORE_ENERGY_FIRST_MM] = first_mm;
  table[CORE_ENERGY_PER_PANEL] = 1 / WIDTH;
  table[CORE_ENERGY_POWER] = steep ? 1 : 2;
  table[CORE_ENERGY_RISE] = rises ? rise / (1 + 0.5 * rise) : 0;
  return energy;
}
