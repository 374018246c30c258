/* Quantized diffusion: the extended source's cloud as a sum of Gaussians over time.
 *
 * Source: d'Eon and Irving 2011, "A quantized-diffusion model for rendering translucent materials",
 * in units of the mean free path 1 / sigma_t' and with the better dipole's D, z_b, C_phi and C_E
 * (d'Eon 2012, Table 2). Times are quantized by the rule of core/diffusion.h instead of the paper's
 * piecewise constant one, which makes the number of Gaussians for a tolerance small. With the
 * variance v = 2 D t and the beam's integral over depth
 *
 *   w_phi(v, d) = alpha' / 2 e^(-d^2 / (2 v)) erfcx((d + v) / sqrt(2 v))
 *   w_phiR = w_phi(v, 0) - w_phi(v, 2 z_b)
 *   w_E(v, d) = D [alpha' e^(-d^2 / (2 v)) / sqrt(2 pi v) - w_phi(v, d)],  w_ER = w_E(v, 0) + w_E(v, 2 z_b)
 *
 *   R(x) = alpha' int e^(-sigma_a t) (C_phi w_phiR + C_E w_ER) e^(-x^2 / (2 v)) / (2 pi v) dt
 *
 * The exact formula is the continuous limit, the model `extended`.
 *
 * Domain: every medium that core_medium_check() accepts; radii to MOST mean free paths where
 * absorption is less than ABSORBED_LEAST of the extinction (which R(MOST) does not feel), else to
 * infinity; below LEAST tolerance mean free paths R is continued like 1 / r.
 * Error: the tolerance (TOLERANCE when none is asked for), relative; tests/accuracy/test_models.c.
 */
#include "core/diffusion.h"
#include "core/models/gaussians.h"

#include <math.h>
#include <stdlib.h>

#define CORE_REAL 64
#include "core/kernel.h"

#define TOLERANCE 1e-4
#define TOLERANCE_MOST 0.1
#define LEAST 1e-2
#define MOST 1e13
#define ABSORBED_LEAST 1e-28

core_check_function core_quantized_check;
core_prepare_function core_quantized_prepare;

core_fault core_quantized_check(const core_inputs *inputs, core_radii_range *radii) {
  (void)inputs;
  (void)radii;
  return (core_fault){0};
}

struct cloud {
  double sigma_t_prime;
  double albedo_prime;
  double absorbed; /* sigma_a */
  double diffusion;
  double two_zb;
  double c_phi;
  double c_flux;
};

static struct cloud make_cloud(const core_inputs *inputs) {
  const core_medium *medium = inputs->medium;
  const double sigma_s_prime = medium->sigma_s_per_mm * (1 - medium->g);
  const double sigma_t_prime = medium->sigma_a_per_mm + sigma_s_prime;
  const core_fresnel fresnel = core_fresnel_moments(inputs->moments, medium->eta);
  struct cloud cloud = {
      .sigma_t_prime = sigma_t_prime,
      .albedo_prime = sigma_s_prime / sigma_t_prime,
      .absorbed = medium->sigma_a_per_mm / sigma_t_prime,
      .c_phi = 0.25 * fresnel.one_minus_2c1,
      .c_flux = 0.5 * fresnel.one_minus_3c2,
  };
  cloud.diffusion = (1 + cloud.absorbed) / 3;
  cloud.two_zb = 4 * (2 - fresnel.one_minus_3c2) / fresnel.one_minus_2c1 * cloud.diffusion;
  return cloud;
}

/* C_phi w_phiR + C_E w_ER over alpha', in which nothing cancels:
 * alpha' / sqrt(2 pi v) - w_phi(v, 0) = alpha' / 2 (1 / (sqrt(pi) y) - erfcx(y)), y = sqrt(v / 2). */
static double leaves(const struct cloud *cloud, double v) {
  const double y = sqrt(0.5 * v);
  const double further = cloud->two_zb / sqrt(2 * v);
  const double mirrored = further + y;
  const real_exp_values mirror = real_exp(-further * further);
  const double beyond = core_erfcx(mirrored);
  const double phi = core_erfcx_fall(y, further) + mirror.one_minus_exp * beyond;
  /* 1 / (sqrt(pi) y) - erfcx(mirrored), from the shortfall at `mirrored` */
  const double per_root_pi = 0.56418958354775628695;
  const double nearer = per_root_pi * further / (y * mirrored);
  const double flux =
      core_erfcx_shortfall(y) + mirror.exp * (core_erfcx_shortfall(mirrored) + nearer);
  return 0.5 * fma(cloud->c_phi, phi, cloud->c_flux * cloud->diffusion * flux);
}

static core_gaussian gaussian_at(const struct cloud *cloud, double time, double weight) {
  const double v = 2 * cloud->diffusion * time;
  const double alive = real_exp(-cloud->absorbed * time).exp;
  const double source = cloud->albedo_prime * cloud->albedo_prime;
  const double squared = cloud->sigma_t_prime * cloud->sigma_t_prime;
  const double across = squared / (6.28318530717958647693 * v);
  return (core_gaussian){source * weight * alive * leaves(cloud, v) * across, squared / (2 * v)};
}

core_fault core_quantized_prepare(const core_inputs *inputs, core_preparation *preparation) {
  preparation->notes = core_similarity_note(inputs);
  const struct cloud cloud = make_cloud(inputs);
  const double tolerance =
      fmin(core_parameter_or(inputs, CORE_PARAMETER_TOLERANCE, TOLERANCE), TOLERANCE_MOST);
  const double least = LEAST * tolerance;
  /* e^(-x^2 / (4 D t)) leaves nothing at the least radius before, and all of it at the largest
   * after */
  const double earliest = least * least / (160 * cloud.diffusion);
  const double latest = MOST * MOST * 1e12;
  const core_times times =
      core_times_make(fmax(cloud.absorbed, ABSORBED_LEAST), earliest, latest, tolerance);
  core_gaussian *gaussians = malloc(times.count * sizeof *gaussians);
  if (gaussians == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  for (size_t i = 0; i < times.count; i++) {
    double time;
    double weight;
    core_times_node(&times, i, &time, &weight);
    gaussians[i] = gaussian_at(&cloud, time, weight);
  }
  const core_fault fault =
      core_gaussians_table(gaussians, times.count, least / cloud.sigma_t_prime, preparation);
  free(gaussians);
  preparation->error = tolerance;
  return fault;
}
