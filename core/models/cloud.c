/* Quantized diffusion and the multipole: light as a cloud that diffuses, as sums of Gaussians.
 *
 * A cloud of light that starts at time 0 has at time t the profile e^(-r^2 / (4 D t)) / (4 pi D t)
 * across the axis. A share leaves(t) of this light leaves the medium per unit of time; it depends
 * on depths alone. With lengths in mean free paths 1 / sigma_t' and times in mean free paths of
 * light,
 *
 *   R(r) = p int e^(-sigma_a t) leaves(t) e^(-r^2 / (4 D t)) / (4 pi D t) dt
 *
 * A quadrature rule over time (core/diffusion.h) makes R a sum of Gaussians with positive weights.
 * So R is positive, and accurate to the tolerance at every r. The variant's switches choose p, D,
 * z_b, C_phi and C_E as they do for the dipole (d'Eon 2012, Table 2).
 *
 * Quantized diffusion (CORE_CLOUD_BEAM): d'Eon and Irving 2011, "A quantized-diffusion model for
 * rendering translucent materials". The medium is a half space and the source is a beam along all
 * depths. The paper uses a piecewise constant rule over time; this file uses core/diffusion.h. With
 * v = 2 D t,
 *
 *   w_phi(v, d) = 1 / 2 e^(-d^2 / (2 v)) erfcx((d + v) / sqrt(2 v))
 *   w_phiR = w_phi(v, 0) - w_phi(v, 2 z_b)
 *   w_E(v, d) = D [e^(-d^2 / (2 v)) / sqrt(2 pi v) - w_phi(v, d)]
 *   w_ER = w_E(v, 0) + w_E(v, 2 z_b)
 *   leaves(t) = C_phi w_phiR + C_E w_ER
 *
 * The model `extended` evaluates the exact continuous limit of this formula.
 *
 * Multipole: Donner, Jensen 2005, "Light diffusion in multi-layered translucent materials". The
 * medium is a slab of thickness d and the source is a point at depth 1. With L = d + 2 z_b there
 * are positive poles at 2 i L + 1 and negative poles at 2 i L - 1 - 2 z_b for every integer i.
 * While the cloud is young, leaves(t) is a sum over these poles. When the cloud has grown as wide
 * as the slab, leaves(t) is a sum over the sine modes between the boundaries (Poisson's dual of the
 * first sum). Both sums need few terms. CORE_SLAB_TRANSMITTED selects the light that leaves on the
 * far side. No variant contains the part of the beam that crosses the slab unscattered.
 *
 * Domain of quantized diffusion: every medium. Below LEAST tolerance mean free paths R is continued
 * in proportion to 1 / r. Without absorption R is continued in proportion to 1 / r^3 from MOST mean
 * free paths on, or from 1e-3 z_b MOST where that is more. Domain of the multipole: a thickness
 * from THICKNESS_LEAST to THICKNESS_MOST mean free paths, so that the source lies inside the slab;
 * a thicker slab is a half space.
 *
 * Error, relative: the tolerance (QUANTIZED_TOLERANCE or SLAB_TOLERANCE if the request names none),
 * plus 64 epsilon, plus 4 epsilon times the exponent with which R falls.
 */
#include "core/diffusion.h"
#include "core/models/gaussians.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define CORE_REAL 64
#include "core/models/lanes.h"

#define QUANTIZED_TOLERANCE 1e-4
#define SLAB_TOLERANCE 1e-12
#define TOLERANCE_MOST 0.1
#define LEAST 1e-2
#define MOST 1e10
/* an absorption rate below this does not change R at MOST mean free paths */
#define MOST_RATE 1e-28
#define LEAST_RATE 1e-250 /* a decay rate below this does not change R at 1e100 mean free paths */
#define THICKNESS_LEAST 1.1
#define THICKNESS_MOST 1e6

/* LAST_EXPONENT: the Gaussians serve radii where R has fallen by at most e^LAST_EXPONENT from its
 * value at r = 0; beyond, R has underflowed. FAR_EXPONENT: where R has fallen by more than
 * e^FAR_EXPONENT, core_cloud_ln_R() computes ln R instead of the Gaussians. */
#define LAST_EXPONENT 826
#define FAR_EXPONENT 700

#define PI 3.14159265358979323846

core_fault core_cloud_check(const core_inputs *inputs, core_radii_range *radii) {
  (void)radii;
  const double thickness = inputs->medium->thickness_mm * core_sigma_t_prime(inputs->medium);
  if ((inputs->variant & CORE_CLOUD_BEAM) != 0) {
    return (core_fault){0};
  }
  if (!(thickness > 0)) {
    return (core_fault){"thickness", "above 0 mm: this model is of a slab", 0};
  }
  if (!(thickness >= THICKNESS_LEAST && thickness <= THICKNESS_MOST)) {
    return (core_fault){"thickness",
                        "1.1 to 1e6 mean free paths; one is 1 / (sigma_a + sigma_s (1 - g)) mm", 0};
  }
  return (core_fault){0};
}

/* The quantities of the formula above, with lengths in mean free paths. All fields are double,
 * because the table of Gaussians keeps a copy of this structure. */
struct cloud {
  double sigma_t_prime;
  double source; /* p: strength of the source */
  double absorbed;
  double diffusion;
  double zb;
  double c_phi;
  double c_flux;
  double thickness; /* d: thickness of the slab; 0: a half space */
  /* distance from the source to the boundary where light leaves, or 0 for a beam */
  double y;
  double transmitted; /* 1: light that the slab transmits; 0: reflected light */
  double rate;        /* rate of the slowest decay: sigma_a + D (pi / L)^2 */
};
_Static_assert(sizeof(struct cloud) <= GAUSSIANS_FAR_FIELDS * sizeof(double), "the table has room");

/* Returns L. */
static double period_of(const struct cloud *cloud) {
  return cloud->thickness + 2 * cloud->zb;
}

static struct cloud make_cloud(const core_inputs *inputs) {
  double shared[CORE_VARYING_SHARED_MAX];
  const struct lane lane = lane_of_medium(shared, inputs->variant, inputs->moments, inputs->medium);
  const struct lane_dipole dipole = lane_dipole_of(shared, lane);
  struct cloud cloud = {
      .sigma_t_prime = lane.sigma_t,
      .source = dipole.power,
      .absorbed = lane.absorbed,
      .diffusion = dipole.diffusion,
      .zb = 0.5 * dipole.z2_less_1,
      .c_phi = shared[LANES_C_PHI],
      .c_flux = shared[LANES_C_FLUX],
  };
  cloud.rate = cloud.absorbed;
  if ((inputs->variant & CORE_CLOUD_BEAM) == 0) {
    cloud.thickness = inputs->medium->thickness_mm * cloud.sigma_t_prime;
    cloud.transmitted = (inputs->variant & CORE_SLAB_TRANSMITTED) != 0;
    cloud.y = cloud.transmitted > 0 ? cloud.thickness - 1 : 1;
    const double period = period_of(&cloud);
    cloud.rate += cloud.diffusion * (PI / period) * (PI / period);
  }
  return cloud;
}

/* ---- a beam in a half space ----------------------------------------------------------------- */

/* Returns leaves(t) of a beam in a half space, written so that no difference loses digits: with y =
 * sqrt(v / 2), 1 / sqrt(2 pi v) - w_phi(v, 0) = 1 / 2 (1 / (sqrt(pi) y) - erfcx(y)). */
static double leaves_half_space(const struct cloud *cloud, double time) {
  const double v = 2 * cloud->diffusion * time;
  const double y = sqrt(0.5 * v);
  const double further = 2 * cloud->zb / sqrt(2 * v);
  const double mirrored = further + y;
  const real_exp_values mirror = real_exp(-further * further);
  const double beyond = core_erfcx(mirrored);
  const double phi = core_erfcx_fall(y, further) + mirror.one_minus_exp * beyond;
  /* 1 / (sqrt(pi) y) - erfcx(mirrored) is `nearer` plus the shortfall at `mirrored` */
  const double per_root_pi = 0.56418958354775628695;
  const double nearer = per_root_pi * further / (y * mirrored);
  const double flux =
      core_erfcx_shortfall(y) + mirror.exp * (core_erfcx_shortfall(mirrored) + nearer);
  return 0.5 * fma(cloud->c_phi, phi, cloud->c_flux * cloud->diffusion * flux);
}

/* ---- a point between the boundaries of a slab ---------------------------------------------------
 *
 * The slab is symmetric: y is the distance from the source to the boundary where light leaves. The
 * functions young() and grown() both return leaves(t) e^(y^2 / (4 D t) + D (pi / L)^2 t), which
 * varies slowly with t.
 */

/* Up to the time YOUNG L^2 / D the code sums POLES pairs of poles, later it sums MODES modes. If
 * the slab is thinner than z_b, poles on both sides of it nearly cancel after the time YOUNG_THIN
 * L^2 / D, and the code sums MODES_THIN modes from then on. What these sums leave out is less than
 * 1e-17.
 */
#define YOUNG 0.12
#define YOUNG_THIN 0.015
enum { POLES = 3, MODES = 7, MODES_THIN = 17 };

static bool is_thin(const struct cloud *cloud) {
  return cloud->thickness < cloud->zb;
}

/* Returns the light from a positive pole at distance q from the boundary and from its negative
 * mirror image at distance q + 2 z_b beyond it, both made of g(q) = e^(-q^2 / (4 D t)) / sqrt(4 pi
 * D t). Their fluences subtract, and their fluxes D q / (2 D t) g(q) add. The result is divided by
 * e^(-y^2 / (4 D t)), as is that of images(). */
static double pair(const struct cloud *cloud, double time, double q) {
  const double four_dt = 4 * cloud->diffusion * time;
  const double two_zb = 2 * cloud->zb;
  const real_exp_values mirror = real_exp(-two_zb * (2 * q + two_zb) / four_dt);
  const double flux = (q + (q + two_zb) * mirror.exp) / (2 * time);
  const double near = real_exp((cloud->y - q) * (cloud->y + q) / four_dt).exp;
  return near * fma(cloud->c_flux, flux, cloud->c_phi * mirror.one_minus_exp) / sqrt(PI * four_dt);
}

/* Returns pair() at q = middle - h - z_b less pair() at q = middle + h - z_b, with h = 1 + z_b:
 * these poles lie on both sides of one image of the far boundary and nearly cancel in a thick slab.
 * The result is divided by e^(-y^2 / (4 D t)). With T = 4 D t, A = 4 middle z_b / T, B = 4 middle h
 * / T and C = 4 z_b h / T the sum of the four fluences divided by g(q) is
 *
 *   1 - e^(C - A) - e^(C - B) + e^(-A - B)
 *     = (1 - e^(-A)) (1 - e^(-B)) - (1 - e^(-C)) (e^(C - A) + e^(C - B))
 */
static double images(const struct cloud *cloud, double time, double middle, double q) {
  const double four_dt = 4 * cloud->diffusion * time;
  const double zb = cloud->zb;
  const double h = 1 + zb;
  const double a = 4 * zb / four_dt;
  const double b = 4 * h / four_dt;
  const real_exp_values nearer_a = real_exp(-a * (middle - h));  /* e^(C - A) */
  const real_exp_values nearer_b = real_exp(-b * (middle - zb)); /* e^(C - B) */
  const real_exp_values further_b = real_exp(-b * (middle + zb));
  const double both = real_exp(-a * middle).one_minus_exp * real_exp(-b * middle).one_minus_exp;
  const double fluence = both - real_exp(-a * h).one_minus_exp * (nearer_a.exp + nearer_b.exp);
  const double real_flux = q * nearer_b.one_minus_exp - 2 * h * nearer_b.exp;
  const double mirror_flux = (q + 2 * zb) * further_b.one_minus_exp - 2 * h * further_b.exp;
  const double flux = fma(nearer_a.exp, mirror_flux, real_flux) / (2 * time);
  const double near = real_exp((cloud->y - q) * (cloud->y + q) / four_dt).exp;
  return near * fma(cloud->c_flux, flux, cloud->c_phi * fluence) / sqrt(PI * four_dt);
}

static double young(const struct cloud *cloud, double time) {
  const double h_and_zb = 1 + 2 * cloud->zb;
  double sum = 0;
  for (int i = POLES; i >= 1; i--) {
    const bool transmitted = cloud->transmitted > 0;
    const double middle = (transmitted ? 2 * i - 1 : 2 * i) * period_of(cloud);
    const double q = transmitted && i == 1 ? cloud->y : middle - h_and_zb;
    sum += transmitted ? images(cloud, time, middle, q) : -images(cloud, time, middle, q);
  }
  const double wave = PI / period_of(cloud);
  const double slow = real_exp(-cloud->diffusion * wave * wave * time).exp;
  return (sum + (cloud->transmitted > 0 ? 0 : pair(cloud, time, cloud->y))) / slow;
}

struct angle {
  double sine;
  double cosine;
};

/* Returns sine and cosine of x, from 0 to pi, by their power series. */
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

/* Returns sine and cosine of wave times the distance of a depth z from the extrapolated boundary,
 * z + z_b. In a thin slab this is almost a right angle, and the code takes its complement, so that
 * the cosine keeps its digits. */
static struct angle angle_at(const struct cloud *cloud, double wave, double z) {
  if (!is_thin(cloud)) {
    return angle_of(wave * (z + cloud->zb));
  }
  const struct angle complement = angle_of(wave * (0.5 * cloud->thickness - z));
  return (struct angle){complement.cosine, complement.sine};
}

/* Returns the light from the modes of the slab, divided by e^(-y^2 / (4 D t) - D (pi / L)^2 t). The
 * fluence is 2 / L sum_n sin(n pi (z + z_b) / L) sin(n pi h / L) e^(-D (n pi / L)^2 t) at z = 0
 * with h = 1 + z_b. The signs alternate for the boundary far from the source. */
static double grown(const struct cloud *cloud, double time) {
  const double wave = PI / period_of(cloud);
  const struct angle boundary = angle_at(cloud, wave, 0);
  const struct angle source = angle_at(cloud, wave, 1);
  const int modes = is_thin(cloud) ? MODES_THIN : MODES;
  struct angle at_boundary = boundary;
  struct angle at_source = source;
  double sum = 0;
  double sign = 1;
  for (int n = 1; n <= modes; n++) {
    const double faster = cloud->diffusion * wave * wave * ((n - 1) * (n + 1));
    const double decayed = sign * real_exp(-faster * time).exp;
    const double flux = cloud->diffusion * n * wave * at_boundary.cosine;
    sum = fma(fma(cloud->c_flux, flux, cloud->c_phi * at_boundary.sine), at_source.sine * decayed,
              sum);
    at_boundary = angle_sum(at_boundary, boundary);
    at_source = angle_sum(at_source, source);
    sign = cloud->transmitted > 0 ? -sign : sign;
  }
  const double risen = real_exp(-cloud->y * cloud->y / (4 * cloud->diffusion * time)).exp;
  return 2 / period_of(cloud) * sum / risen;
}

/* ---- slabs and beams ------------------------------------------------------------------------- */

/* Returns the share of the light that leaves per unit of time, at t = time. The share is multiplied
 * by e^(y^2 / (4 D t) + (rate - sigma_a) t), so that it varies slowly. y, D and rate are y,
 * diffusion and rate of struct cloud. Slabs and beams both use this function. */
static double leaves(const void *context, double time) {
  const struct cloud *cloud = context;
  if (!(cloud->thickness > 0)) {
    return leaves_half_space(cloud, time);
  }
  const double length = period_of(cloud);
  const double until = (is_thin(cloud) ? YOUNG_THIN : YOUNG) * length * length;
  return cloud->diffusion * time < until ? young(cloud, time) : grown(cloud, time);
}

/* Returns the Gaussian of a node of the rule over time, in 1/mm^2. Its weight is multiplied by e^(y
 * sqrt(rate / D)), which is the inverse of the decay at r = 0. */
static core_gaussian gaussian_at(const struct cloud *cloud, double time, double weight) {
  const double four_dt = 4 * cloud->diffusion * time;
  const double apart = sqrt(cloud->rate * time) - cloud->y / sqrt(four_dt);
  const double exponent = cloud->y > 0 ? apart * apart : cloud->rate * time;
  const double alive = real_exp(-exponent).exp;
  const double squared = cloud->sigma_t_prime * cloud->sigma_t_prime;
  /* Shortly after time 0 a cloud far from the boundary gives only rounding errors, which may be
   * negative. */
  const double source = cloud->source * weight * alive * fmax(leaves(cloud, time), 0);
  return (core_gaussian){source * squared / (PI * four_dt), squared / four_dt};
}

double core_cloud_ln_R(const double *far, double r) {
  struct cloud cloud;
  memcpy(&cloud, far, sizeof cloud);
  const double x = r * cloud.sigma_t_prime;
  if (x > 1e100) {
    return -(double)INFINITY;
  }
  const double rho = sqrt(fma(x, x, cloud.y * cloud.y));
  const double ln = core_diffusion_ln(cloud.rate, cloud.diffusion, rho, leaves, &cloud);
  return ln + real_log(cloud.source, 0) + 2 * real_log(cloud.sigma_t_prime, 0);
}

core_fault core_cloud_prepare(const core_inputs *inputs, core_preparation *preparation) {
  preparation->notes = core_similarity_note(inputs);
  const struct cloud cloud = make_cloud(inputs);
  const bool slab = cloud.thickness > 0;
  const double given = core_parameter_or(inputs, CORE_PARAMETER_TOLERANCE,
                                         slab ? SLAB_TOLERANCE : QUANTIZED_TOLERANCE);
  const double tolerance = fmin(given, TOLERANCE_MOST);
  /* dR/dr is a steeper function of time than R, so the rule over time needs a smaller tolerance
   * than R alone would. The rule's tolerance is smallest for the far side of a slab.
   * For a beam, it is a smaller share of the wanted tolerance if the wanted one is below 1e-4. */
  const double digits = 9.25 / -real_log(tolerance, 0);
  const double beam = digits < 1 ? digits * digits : 1;
  const double rule = (cloud.transmitted > 0 ? 0.05 : slab ? 0.4 : beam) * tolerance;
  const double least = slab ? 0 : LEAST * tolerance;
  const double mu = sqrt(cloud.rate / cloud.diffusion);
  const bool fades = cloud.rate > LEAST_RATE;
  /* R falls like 1 / r^3 where r is many times z_b */
  const double wider = fmax(1, 1e-3 * cloud.zb);
  const double most = MOST * wider;
  const double rate = fades ? cloud.rate : MOST_RATE / (wider * wider);
  /* Before the first node e^(-rate t - (r^2 + y^2) / (4 D t)) is less than e^-45 times its value at
   * its saddle point. */
  const double c = slab ? mu + 45 / cloud.y : 0;
  const double earliest = slab ? cloud.y / (2 * cloud.diffusion * (c + sqrt((c - mu) * (c + mu))))
                               : least * least / (160 * cloud.diffusion);
  const double latest = core_times_latest(rate, mu * cloud.y + LAST_EXPONENT);
  const core_times times = core_times_make(rate, earliest, latest, rule);
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
  const double mfp_mm = 1 / cloud.sigma_t_prime;
  const double reach = FAR_EXPONENT / mu;
  core_gaussian_ends ends = {
      .least_mm = least / cloud.sigma_t_prime,
      .most_mm = fades ? (double)INFINITY : most * mfp_mm,
      .shift = mu * cloud.y,
      .far_mm = fades ? sqrt(reach * (reach + 2 * cloud.y)) * mfp_mm : (double)INFINITY,
  };
  memcpy(ends.far, &cloud, sizeof cloud);
  const core_fault fault = core_gaussians_table(gaussians, times.count, &ends, preparation);
  free(gaussians);
  preparation->error = tolerance;
  preparation->error_epsilons = 64 + 4 * ends.shift;
  preparation->error_epsilons_per_mm = 4 * mu * cloud.sigma_t_prime;
  return fault;
}
