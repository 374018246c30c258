/* A slab: the multipole, for a layer of finite thickness with the same medium on both sides.
 *
 * Source: Donner, Jensen 2005, "Light diffusion in multi-layered translucent materials": a point
 * source at depth z1 = 1 / sigma_t' and its images in two boundaries, at which the fluence vanishes
 * z_b outside the slab: with L = d + 2 z_b, positive poles at 2 i L + z1 and negative ones at
 * 2 i L - z1 - 2 z_b for every integer i. The switches of the dipole family (D, boundary, exitance)
 * are kept; with none of them, or all, a thick slab is the classical or the better dipole.
 *
 * Far from the source the poles' contributions cancel to many digits, so they are not summed at
 * their distances but in time: a cloud diffuses with e^(-r^2 / (4 D t)) / (4 pi D t) across and
 * between the boundaries like a sum over the same poles while it is young, and like the sum over the
 * boundaries' sine modes (Poisson's dual of that sum) when it has grown as wide as the slab; both
 * need a few terms. The integral over time becomes a sum of Gaussians (core/diffusion.h), all of
 * them positive: R > 0 and exact at every r.
 *
 *   R(r) = p int e^(-sigma_a t) [C_phi G(t, 0) + C_E D dG/dz(t, 0)] e^(-r^2 / (4 D t)) / (4 pi D t) dt
 *   T(r) = p int e^(-sigma_a t) [C_phi G(t, d) - C_E D dG/dz(t, d)] e^(-r^2 / (4 D t)) / (4 pi D t) dt
 *
 * The variant is a sum of the dipole's switches and, for the transmitted profile, SLAB_TRANSMITTED.
 * The beam that crosses the slab unscattered is in neither.
 *
 * Domain: thickness from THICKNESS_LEAST to THICKNESS_MOST mean free paths 1 / sigma_t' (the source
 * lies inside the slab; a thicker one is a half space).
 * Error: the tolerance (TOLERANCE when none is asked for) and 64 epsilon, relative.
 */
#include "core/diffusion.h"
#include "core/models/gaussians.h"

#include <math.h>
#include <stdlib.h>

#define CORE_REAL 64
#include "core/kernel.h"

#define TOLERANCE 1e-12
#define TOLERANCE_MOST 0.1
#define THICKNESS_LEAST 1.1
#define THICKNESS_MOST 1e6

#define PI 3.14159265358979323846

core_check_function core_slab_check;
core_prepare_function core_slab_prepare;

core_fault core_slab_check(const core_inputs *inputs, core_radii_range *radii) {
  (void)radii;
  const double mm = core_parameter_or(inputs, CORE_PARAMETER_THICKNESS, (double)NAN);
  const double thickness = mm * core_sigma_t_prime(inputs->medium);
  if (isnan(mm)) {
    return (core_fault){"thickness", "a thickness in mm: a slab needs it", 0};
  }
  if (!(thickness >= THICKNESS_LEAST && thickness <= THICKNESS_MOST)) {
    return (core_fault){"thickness", "1.1 to 1e6 mean free paths 1 / sigma_t'", 0};
  }
  return (core_fault){0};
}

/* In mean free paths. */
struct slab {
  double sigma_t_prime;
  double source; /* p of the dipole family */
  double absorbed;
  double diffusion;
  double zb;
  double thickness;
  double period; /* L */
  double c_phi;
  double c_flux;
  bool transmitted;
};

static struct slab make_slab(const core_inputs *inputs) {
  const core_medium *medium = inputs->medium;
  const core_fresnel fresnel = core_fresnel_moments(inputs->moments, medium->eta);
  const bool grosjean = (inputs->variant & CORE_DIPOLE_GROSJEAN) != 0;
  const bool boundary = (inputs->variant & CORE_DIPOLE_BOUNDARY) != 0;
  const bool exitance = (inputs->variant & CORE_DIPOLE_EXITANCE) != 0;
  struct slab slab = {.sigma_t_prime = core_sigma_t_prime(medium)};
  const double scattered = medium->sigma_s_per_mm * (1 - medium->g) / slab.sigma_t_prime;
  slab.absorbed = medium->sigma_a_per_mm / slab.sigma_t_prime;
  slab.diffusion = grosjean ? (1 + slab.absorbed) / 3 : 1.0 / 3;
  slab.source = grosjean ? scattered * scattered : scattered;
  const double lost = boundary ? fresnel.one_minus_3c2 : fresnel.one_minus_2c1;
  slab.zb = 2 * (2 - lost) / fresnel.one_minus_2c1 * slab.diffusion;
  slab.thickness = inputs->parameters->value[CORE_PARAMETER_THICKNESS] * slab.sigma_t_prime;
  slab.period = slab.thickness + 2 * slab.zb;
  slab.c_phi = exitance ? 0.25 * fresnel.one_minus_2c1 : 0;
  slab.c_flux = exitance ? 0.5 * fresnel.one_minus_3c2 : 1;
  slab.transmitted = (inputs->variant & CORE_SLAB_TRANSMITTED) != 0;
  return slab;
}

/* ---- the cloud between the boundaries ----------------------------------------------------------
 * Both sides look alike: y is the source's distance from the boundary where light leaves. */

/* A cloud up to YOUNG L^2 / D is summed over poles, then over modes; so many of either leave out
 * less than 1e-17. */
#define YOUNG 0.05
enum { POLES = 3, MODES = 10 };

/* C_phi G + C_E (flux) of a positive pole at distance q and its negative mirror at q + 2 z_b beyond
 * the boundary, from g(q) = e^(-q^2 / (4 D t)) / sqrt(4 pi D t): fluences subtract, fluxes
 * D q / (2 D t) g add. */
static double pair(const struct slab *slab, double time, double q) {
  const double four_dt = 4 * slab->diffusion * time;
  const double two_zb = 2 * slab->zb;
  const double near = real_exp(-q * q / four_dt).exp;
  const real_exp_values mirror = real_exp(-two_zb * (2 * q + two_zb) / four_dt);
  const double flux = (q + (q + two_zb) * mirror.exp) / (2 * time);
  return near * fma(slab->c_flux, flux, slab->c_phi * mirror.one_minus_exp) / sqrt(PI * four_dt);
}

/* All pairs, gathered at the boundary: those of the images 2 i L + y and -(2 i L - y - 2 z_b). */
static double young(const struct slab *slab, double time, double y) {
  double sum = 0;
  for (int i = POLES; i >= 1; i--) {
    const double away = 2 * i * slab->period;
    sum += pair(slab, time, away + y) - pair(slab, time, away - y - 2 * slab->zb);
  }
  return sum + pair(slab, time, y);
}

struct angle {
  double sine;
  double cosine;
};

/* Of x from 0 to pi, by their power series. */
static struct angle angle_of(double x) {
  const double squared = x * x;
  double sine = 0;
  double cosine = 0;
  for (int k = 14; k >= 1; k--) {
    sine = (1 + sine) * -squared / ((2 * k) * (2 * k + 1));
    cosine = (1 + cosine) * -squared / ((2 * k - 1) * (2 * k));
  }
  return (struct angle){x * (1 + sine), 1 + cosine};
}

static struct angle angle_sum(struct angle a, struct angle b) {
  return (struct angle){fma(a.sine, b.cosine, a.cosine * b.sine),
                        fma(a.cosine, b.cosine, -a.sine * b.sine)};
}

/* G(t, z) = 2 / L sum_n sin(n pi (z + z_b) / L) sin(n pi (y + z_b) / L) e^(-D (n pi / L)^2 t) */
static double grown(const struct slab *slab, double time, double y) {
  const double wave = PI / slab->period;
  const struct angle boundary = angle_of(wave * slab->zb);
  const struct angle source = angle_of(wave * (y + slab->zb));
  struct angle at_boundary = boundary;
  struct angle at_source = source;
  double sum = 0;
  for (int n = 1; n <= MODES; n++) {
    const double decayed = real_exp(-slab->diffusion * (n * wave) * (n * wave) * time).exp;
    const double flux = slab->diffusion * n * wave * at_boundary.cosine;
    sum =
        fma(fma(slab->c_flux, flux, slab->c_phi * at_boundary.sine), at_source.sine * decayed, sum);
    at_boundary = angle_sum(at_boundary, boundary);
    at_source = angle_sum(at_source, source);
  }
  return 2 / slab->period * sum;
}

static core_gaussian gaussian_at(const struct slab *slab, double y, double time, double weight) {
  const double four_dt = 4 * slab->diffusion * time;
  const bool is_young = slab->diffusion * time < YOUNG * slab->period * slab->period;
  const double leaves = is_young ? young(slab, time, y) : grown(slab, time, y);
  const double alive = real_exp(-slab->absorbed * time).exp;
  const double squared = slab->sigma_t_prime * slab->sigma_t_prime;
  /* In the first instants of a cloud far from the boundary nothing but rounding is left. */
  return (core_gaussian){fmax(slab->source * weight * alive * leaves, 0) * squared / (PI * four_dt),
                         squared / four_dt};
}

core_fault core_slab_prepare(const core_inputs *inputs, core_preparation *preparation) {
  preparation->notes = core_similarity_note(inputs);
  const struct slab slab = make_slab(inputs);
  const double tolerance =
      fmin(core_parameter_or(inputs, CORE_PARAMETER_TOLERANCE, TOLERANCE), TOLERANCE_MOST);
  const double y = slab.transmitted ? slab.thickness - 1 : 1;
  const double lowest = PI / slab.period;
  const double rate = slab.absorbed + slab.diffusion * lowest * lowest;
  const double earliest = y * y / (4 * 45 * slab.diffusion);
  const core_times times = core_times_make(rate, earliest, (double)INFINITY, tolerance);
  core_gaussian *gaussians = malloc(times.count * sizeof *gaussians);
  if (gaussians == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  for (size_t i = 0; i < times.count; i++) {
    double time;
    double weight;
    core_times_node(&times, i, &time, &weight);
    gaussians[i] = gaussian_at(&slab, y, time, weight);
  }
  const core_fault fault = core_gaussians_table(gaussians, times.count, 0, preparation);
  free(gaussians);
  preparation->error = tolerance;
  preparation->error_epsilons = 64;
  return fault;
}
