/* Single scattering of a normally incident beam, exactly.
 *
 * Source: the radiative transfer equation's first order; e.g. Habel, Christensen, Jarosz 2013,
 * section 5.3. A photon goes down to depth t, scatters towards the surface at distance r and
 * leaves. With d = sqrt(r^2 + t^2) and mu = t / d, the cosine at which it strikes the surface,
 *
 *   R(r) = int_t sigma_s e^(-sigma_t t) p(-mu) e^(-sigma_t d) T(mu) mu / d^2 dt
 *
 * where T = 1 - F is the Fresnel transmittance from inside (0 beyond the critical angle) and p the
 * phase function of Henyey and Greenstein 1941, (1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^(3/2)). The
 * substitution t = r sinh(u) makes mu = tanh(u) and t + d = r e^u, so
 *
 *   R(r) = sigma_s / r  int_(u_c)^inf e^(-sigma_t r e^u) p T tanh(u) / cosh(u) du
 *
 * with cosh(u_c) = eta for eta > 1 and u_c = 0 otherwise. Only the exponential depends on r. The
 * trapezoidal rule in ln(E - e^(u_c)), E = e^u, therefore makes R(r) a sum over nodes, sigma_s / r sum
 * w e^(-sigma_t r E), as core/transport/single.h does it. The energy of this sum within r is 2 pi
 * sigma_s / sigma_t sum w / E (1 - e^(-sigma_t r E)).
 *
 * This model uses sigma_s and g of the medium itself, without a similarity relation.
 *
 * R is infinite at r = 0, where 2 pi r R is finite.
 *
 * Domain: eta from SINGLE_ETA_MIN to SINGLE_ETA_MAX. An albedo below ALBEDO_LEAST is taken as 0.
 *
 * Error: SINGLE_ERROR + 4 epsilon (1 + sigma_t r e^(u_c)), relative.
 */
#include "core/kernels.h"

#define SINGLE_ERROR 1e-13

/* Positions in the table that preparation makes. */
enum coefficient {
  SIGMA_T,   /* 1/mm */
  EXPONENT,  /* e^(u_c) */
  ABSORBED,  /* sigma_a / sigma_t */
  SCATTERED, /* sigma_s / sigma_t */
  R_SCALE,   /* sigma_s; R is this times the sum over the nodes, divided by r */
  CDF_SCALE, /* 2 pi sigma_s / (sigma_t albedo) */
  CDF_LIMIT, /* limit of the cdf at infinity: 1, or 0 if nothing scatters */
  /* Beyond tau = FAR the sum falls like f^-FAR_POWER (1 + FAR_BEND f^-FAR_BEND_POWER), with f = tau
   * / FAR. */
  FAR_POWER,
  FAR_BEND,
  FAR_BEND_POWER,
  NODE_COUNT,
  NODES_BEGIN,      /* first of NODE_FIELDS numbers for each node */
  NODE_FURTHER = 0, /* E - e^(u_c) */
  NODE_WEIGHT,      /* weight w of the node */
  NODE_ENERGY,      /* w / E of the node, for the energy */
  NODE_FIELDS
};

/* Up to this tau the nodes resolve the integrand next to the critical angle. */
#define FAR 1e12

#ifdef CORE_ISA

#include "core/kernel.h"

#if CORE_REAL == 64

#include "core/models/blocks.h"

/* The kernels compute numerator 2^UP_EXPONENT / (r UP): so the quotient underflows only where R
 * itself does, although the exponential in the numerator may underflow earlier. */
#define UP_EXPONENT 64
#define UP 0x1p64

static inline size_t node_count(const double *c) {
  return (size_t)c[NODE_COUNT];
}

static inline double node(const double *c, size_t k, int field) {
  return c[NODES_BEGIN + k * NODE_FIELDS + (size_t)field];
}

/* Returns e^-x. From x = 600 on no term counts, and products of numbers that underflow take long. */
static inline real_exp_values falling(double x) {
  return real_exp(-real_min(x, 600));
}

/* The terms of the sums over the nodes at tau = sigma_t r: R_term() and slope_term() return theirs
 * times e^(tau e^(u_c)), energy_term() without that factor. */
static inline double R_term(const double *c, size_t k, double tau) {
  return node(c, k, NODE_WEIGHT) * falling(tau * node(c, k, NODE_FURTHER)).exp;
}

/* Returns a term of -dR/dr, (1 + tau E) w e^(-tau E), times e^(tau e^(u_c)). */
static inline double slope_term(const double *c, size_t k, double tau) {
  const double further = node(c, k, NODE_FURTHER);
  const double falls = real_fma(tau, further + c[EXPONENT], 1);
  return node(c, k, NODE_WEIGHT) * (falls * falling(tau * further).exp);
}

/* Returns a term of -d / d ln tau, times e^(tau e^(u_c)), without that of this factor. */
static inline double fall_term(const double *c, size_t k, double tau) {
  const double further = tau * node(c, k, NODE_FURTHER);
  return node(c, k, NODE_WEIGHT) * (further * falling(further).exp);
}

static inline double energy_term(const double *c, size_t k, double tau) {
  const double further = node(c, k, NODE_FURTHER);
  return node(c, k, NODE_ENERGY) * falling(tau * (further + c[EXPONENT])).one_minus_exp;
}

BLOCK_SUM(sum_R, node_count, R_term)
BLOCK_SUM(sum_slope, node_count, slope_term)
BLOCK_SUM(sum_fall, node_count, fall_term)
BLOCK_SUM(sum_energy, node_count, energy_term)

/* Returns tau = sigma_t r, at most 1e100: there every term has underflowed and no product
 * overflows. */
static inline double optical_radius(const double *c, double r) {
  return real_min(r * c[SIGMA_T], 1e100);
}

static inline double finish_R(const double *c, double r, double tau, double sum) {
  const double ring = real_times_exp(c[R_SCALE] * sum, -c[EXPONENT] * tau, UP_EXPONENT);
  return c[CDF_LIMIT] > 0 ? ring / (r * UP) : 0;
}

static inline double finish_slope(const double *c, double r, double tau, double sum) {
  const double ring = real_times_exp(c[R_SCALE] * sum, -c[EXPONENT] * tau, UP_EXPONENT);
  const double near = (ring / r) / (r * UP);
  /* Where the exponential is small, the slope is too, although 1 / r^2 may be large. */
  const double far =
      real_times_exp(c[R_SCALE] * sum / real_max(r * r, 1e-300), -c[EXPONENT] * tau, 0);
  return c[CDF_LIMIT] > 0 ? -(c[EXPONENT] * tau > 300 ? far : near) : 0;
}

/* Returns tau for ln R, at most FAR. Beyond FAR finish_ln_R() continues the sum by powers of
 * tau. */
static inline double begin_ln_R(const double *c, double r) {
  return real_min(r * c[SIGMA_T], FAR);
}

static inline double finish_ln_R(const double *c, double r, double near, double sum) {
  const double tau = real_max(r * c[SIGMA_T], near);
  const double positive = real_max(c[R_SCALE] * sum, 1e-300);
  const double ln_further = tau > FAR && tau < 1e100 ? real_log(tau * (1 / FAR), 0) : 0;
  const double bend = 1 + c[FAR_BEND] * real_exp(-c[FAR_BEND_POWER] * ln_further).exp;
  const double bent = tau > FAR ? real_log(bend / (1 + c[FAR_BEND]), 0) : 0;
  const double kept = real_min(real_max(r, 1e-300), 1e300);
  /* Near R = 1 the difference of two logarithms would cancel, so the logarithm of the quotient is
   * taken wherever the quotient is a normal number. */
  const double quotient = positive / kept;
  const bool normal = quotient > 1e-290 && quotient < 1e290;
  const double ratio = real_log(normal ? quotient : positive, 0) - real_log(normal ? 1 : kept, 0);
  const double fallen = real_fma(-c[FAR_POWER], ln_further, ratio) + bent;
  const double ln_R = real_fma(-c[EXPONENT], real_min(tau, 1e100), fallen);
  const double bounded = tau < 1e100 ? ln_R : -(double)INFINITY;
  return c[CDF_LIMIT] > 0 ? (r > 0 ? bounded : (double)INFINITY) : -(double)INFINITY;
}

/* Returns the cdf: 1 where 1 - cdf is less than a rounding error, and less than 1 before. */
static inline double finish_cdf(const double *c, double r, double tau, double sum) {
  (void)r;
  const double inside = c[CDF_LIMIT] > 0 ? real_min(c[CDF_SCALE] * sum, REAL_BELOW_1) : 0;
  return c[EXPONENT] * tau > 40 ? c[CDF_LIMIT] : inside;
}

BLOCK_KERNEL(eval_R, optical_radius, sum_R, finish_R)
BLOCK_KERNEL(eval_slope, optical_radius, sum_slope, finish_slope)
BLOCK_KERNEL(eval_ln_R, begin_ln_R, sum_R, finish_ln_R)
BLOCK_KERNEL(eval_cdf, optical_radius, sum_energy, finish_cdf)

/* R is sigma_s times a function of sigma_t and r, and that is 1 / r times a function of tau. Sets
 * out[n] to the derivative d of the latter's logarithm by ln tau, and then to offset + share d. */
static void eval_derivative(const double *c, size_t n, const double *r, double offset, double share,
                            double *out) {
  for (size_t done = 0; done < n; done += BLOCK_LANES) {
    const size_t count = CORE_WHOLE(n - done < BLOCK_LANES ? n - done : BLOCK_LANES);
    double near[BLOCK_LANES], sum[BLOCK_LANES], fall[BLOCK_LANES];
    for (size_t i = 0; i < count; i++) {
      near[i] = begin_ln_R(c, r[done + i] + 0);
    }
    sum_R(c, count, near, sum);
    sum_fall(c, count, near, fall);
    for (size_t i = 0; i < count; i++) {
      const double tau = optical_radius(c, r[done + i] + 0);
      const double falls = real_fma(c[EXPONENT], tau, fall[i] / sum[i]);
      /* where R is 0, its derivatives are 0 */
      out[done + i] = ((c[CDF_LIMIT] > 0) & (tau < 1e100)) ? real_fma(-share, falls, offset) : 0;
    }
  }
}

static void eval_by_a(const double *restrict c, size_t n, const double *restrict r,
                      double *restrict out) {
  eval_derivative(c, n, r, 0, c[ABSORBED], out);
}

static void eval_by_s(const double *restrict c, size_t n, const double *restrict r,
                      double *restrict out) {
  eval_derivative(c, n, r, 1, c[SCATTERED], out);
}

CORE_KERNEL_TABLE(single, CORE_KERNELS_OF_ALL, .evaluate[CORE_ELEMENTWISE_BY_SIGMA_A] = eval_by_a,
                  .evaluate[CORE_ELEMENTWISE_BY_SIGMA_S] = eval_by_s);

#else
CORE_KERNEL_TABLE_NONE(single);
#endif

#else /* what follows prepares a profile, and is compiled once for all instruction sets */

#include <stdlib.h>

#define CORE_REAL 64
#include "core/kernel.h"
#include "core/transport/single.h"

#define SINGLE_ETA_MIN 0.1
#define SINGLE_ETA_MAX 10
#define ALBEDO_LEAST 1e-250
/* The nodes are STEP apart in ln(E - e^(u_c)), from FIRST to LAST. For g near -1 the integrand first rises
 * as the phase function does, up to E = 2 / (1 + g), and LAST is that much farther. */
#define STEP 0.24
#define FIRST (-53.0)
#define LAST 36.0
/* cost of one value in kernel evaluations of a dipole, measured with `build/bench kernel` */
#define COST 110

#define TEXT_(x) #x
#define TEXT(x) TEXT_(x)

core_fault core_single_check(const core_inputs *inputs, core_radii_range *radii) {
  (void)radii;
  const double eta = inputs->medium->eta;
  if (!(eta >= SINGLE_ETA_MIN && eta <= SINGLE_ETA_MAX)) {
    return (core_fault){
        "eta", TEXT(SINGLE_ETA_MIN) " to " TEXT(SINGLE_ETA_MAX) " with single scattering", 0};
  }
  return (core_fault){0};
}

/* Returns the phase function of light that leaves at the cosine mu, with E = e^u. squared = 1 + g^2 + 2
 * g mu; for g < 0 that form would cancel, so it is written with 1 - mu = 2 / (1 + E^2). */
static double phase_at(double g, double mu, double E) {
  const double backward = (1 + g) * (1 + g) - 4 * g / fma(E, E, 1);
  const double forward = fma(g, g, 1) + 2 * g * mu;
  const double squared = g < 0 ? backward : forward;
  return (1 - g) * (1 + g) / (12.5663706143591729539 * squared * sqrt(squared));
}

/* Returns the sum of R_term() at tau. */
static double sum_at(const double *c, double tau) {
  double sum = 0;
  for (size_t k = 0; k < (size_t)c[NODE_COUNT]; k++) {
    const double *node = &c[NODES_BEGIN + k * NODE_FIELDS];
    sum += node[NODE_WEIGHT] * real_exp(-tau * node[NODE_FURTHER]).exp;
  }
  return sum;
}

/* Next to the critical angle w is in proportion to (E - e^(u_c))^q, so that the sum falls in
 * proportion to tau^-(q + 1). Here q is 1/2 for eta > 1, where T is like a square root; 1 for eta =
 * 1, where T = 1; and 2 for eta < 1, where T is in proportion to mu at grazing incidence. The next
 * term of w has a power that is larger by 1/2 for eta > 1, else by 1. Its factor, FAR_BEND, follows
 * from the sum at FAR and at an earlier tau. */
static void set_far(double *c, double eta) {
  const double earlier = 16;
  const double power = eta > 1 ? 1.5 : eta < 1 ? 3 : 2;
  const double rise = eta > 1 ? 4 : 16;                    /* earlier^FAR_BEND_POWER */
  const double fall = eta > 1 ? 64 : eta < 1 ? 4096 : 256; /* earlier^power */
  const double ratio = sum_at(c, FAR / earlier) / fall / sum_at(c, FAR);
  c[FAR_POWER] = power;
  c[FAR_BEND_POWER] = eta > 1 ? 0.5 : 1;
  c[FAR_BEND] = (ratio - 1) / (rise - ratio);
}

core_fault core_single_prepare(const core_inputs *inputs, core_preparation *preparation) {
  const core_medium *medium = inputs->medium;
  const double eta = medium->eta;
  const double sigma_s = medium->sigma_s_per_mm;
  const double sigma_t = medium->sigma_a_per_mm + sigma_s;
  const double least = eta > 1 ? eta + sqrt((eta - 1) * (eta + 1)) : 1; /* e^(u_c) */
  const double last = LAST + fmax(real_log(2 / (1 + medium->g), 0), 0);
  const size_t nodes = 1 + (size_t)ceil((last - FIRST) / STEP);
  preparation->table_bytes = (NODES_BEGIN + nodes * NODE_FIELDS) * sizeof(double);
  double *c = malloc(preparation->table_bytes);
  if (c == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  double energy = 0;
  for (size_t k = 0; k < nodes; k++) {
    double *to = &c[NODES_BEGIN + k * NODE_FIELDS];
    const double further = real_exp_signed(fma((double)k, STEP, FIRST));
    const single_node node = transport_single_node(eta, least, further);
    to[NODE_FURTHER] = further;
    to[NODE_WEIGHT] = STEP * further * node.weight * phase_at(medium->g, node.mu, node.rate);
    to[NODE_ENERGY] = to[NODE_WEIGHT] / node.rate;
    energy += to[NODE_ENERGY];
  }
  const double two_pi = 6.28318530717958647693;
  const double albedo = two_pi * (sigma_s / sigma_t) * energy;
  const bool scatters = albedo >= ALBEDO_LEAST;
  preparation->albedo = scatters ? albedo : 0;
  c[SIGMA_T] = sigma_t;
  c[ABSORBED] = medium->sigma_a_per_mm / sigma_t;
  c[SCATTERED] = sigma_s / sigma_t;
  c[EXPONENT] = least;
  c[R_SCALE] = scatters ? sigma_s : 0;
  c[CDF_SCALE] = 1 / energy;
  c[CDF_LIMIT] = scatters;
  c[NODE_COUNT] = (double)nodes;
  set_far(c, eta);
  preparation->table = c;
  preparation->error = SINGLE_ERROR;
  preparation->error_epsilons = 4;
  preparation->error_epsilons_per_mm = 4 * sigma_t * least;
  preparation->scale_mm = 1 / sigma_t;
  preparation->cost = COST;
  return (core_fault){0};
}

#endif
