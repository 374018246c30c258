/* lanes: what the kernels share where every value has a medium of its own (core/varying.h). A lane
 * is the medium of one value. */
#ifndef DIPOLED_CORE_MODELS_LANES_H
#define DIPOLED_CORE_MODELS_LANES_H

#include "core/varying.h"

/* Positions of the numbers that all lanes share. */
enum lane_shared {
  LANES_SCATTER, /* 1 - g of the media */
  /* the domain */
  LANES_SIGMA_T_LEAST,
  LANES_SIGMA_T_MOST,
  LANES_SCATTERED_LEAST, /* of sigma_s' / sigma_t', unless it is 0 */
  LANES_ABSORBS,         /* 1 if sigma_a must be more than 0, else 0 */
  /* Up to x (FAR + FAR_S s + FAR_S2 s^2) = 1 errors are stated, s = sqrt(sigma_a / sigma_t'). */
  LANES_FAR,
  LANES_FAR_S,
  LANES_FAR_S2,
  /* dipoles: the switches and moments of Table 2 (d'Eon 2012) */
  LANES_GROSJEAN, /* 1 or 0 */
  LANES_Z2_PER_D, /* 4 A */
  LANES_C_PHI,
  LANES_C_FLUX,
  /* Burley's profile */
  LANES_SURFACE_ALBEDO, /* the parameter, or -1 if the better dipole's albedo is taken */
  LANES_FIT,            /* of enum core_burley_fit, and the switches of the better dipole above */
  /* colours */
  LANES_SPECULAR, /* for each light */
  LANES_COLOUR_LEAST = LANES_SPECULAR + CORE_LIGHTS,
  LANES_COLOUR_MOST = LANES_COLOUR_LEAST + CORE_LIGHTS,
  LANES_SHARED = LANES_COLOUR_MOST + CORE_LIGHTS
};
_Static_assert((int)LANES_SHARED <= CORE_VARYING_SHARED_MAX, "the structure has room for them");

#include "core/kernel.h"

/* The medium of one value. */
struct lane {
  real sigma_t;   /* sigma_t', 1/mm */
  real mfp;       /* 1 / sigma_t' */
  real absorbed;  /* sigma_a / sigma_t' */
  real scattered; /* sigma_s' / sigma_t' */
};

static inline struct lane lane_of(const real *shared, real sigma_a, real sigma_s) {
  const real reduced = sigma_s * shared[LANES_SCATTER];
  struct lane lane;
  lane.sigma_t = sigma_a + reduced;
  lane.mfp = 1 / lane.sigma_t;
  lane.absorbed = sigma_a * lane.mfp;
  lane.scattered = reduced * lane.mfp;
  return lane;
}

/* Returns whether the kernels answer for a medium. & in place of && keeps branches out of loops. */
static inline int lane_good(const real *shared, real sigma_a, real sigma_s) {
  const struct lane lane = lane_of(shared, sigma_a, sigma_s);
  const int a = (sigma_a >= 0) & ((sigma_a > 0) | !(shared[LANES_ABSORBS] > 0));
  const int s = (sigma_s >= 0) & (lane.sigma_t >= shared[LANES_SIGMA_T_LEAST]) &
                (lane.sigma_t <= shared[LANES_SIGMA_T_MOST]);
  return a & s & (!(sigma_s > 0) | (lane.scattered >= shared[LANES_SCATTERED_LEAST]));
}

/* A dipole in units of z1 = 1 / sigma_t', as in core/models/dipole.c. */
struct lane_dipole {
  real power; /* alpha' or its square */
  real mu;
  real z2_less_1;
  real phi;          /* C_phi / D */
  real real_share;   /* e^(-mu z1) */
  real mirror_share; /* e^(-mu z2) */
  real between;      /* phi (e^(-mu z1) - e^(-mu z2)) / mu */
  real sum;          /* power times half of it is the albedo */
};

static inline struct lane_dipole lane_dipole_of(const real *shared, struct lane lane) {
  const int grosjean = shared[LANES_GROSJEAN] > 0;
  const real three_D = grosjean ? 1 + lane.absorbed : 1;
  const real diffusion = three_D * (REAL(1.0) / 3);
  struct lane_dipole dipole;
  dipole.power = grosjean ? lane.scattered * lane.scattered : lane.scattered;
  dipole.mu = real_sqrt(3 * lane.absorbed / three_D);
  dipole.z2_less_1 = shared[LANES_Z2_PER_D] * diffusion;
  dipole.phi = shared[LANES_C_PHI] / diffusion;
  const real_exp_values mirror = real_exp(-dipole.mu * dipole.z2_less_1);
  dipole.real_share = real_exp(-dipole.mu).exp;
  dipole.mirror_share = dipole.real_share * mirror.exp;
  dipole.between = dipole.phi * (dipole.real_share * dipole.z2_less_1) * mirror.quotient;
  dipole.sum =
      real_fma(shared[LANES_C_FLUX], dipole.real_share + dipole.mirror_share, dipole.between);
  return dipole;
}

#ifdef CORE_ISA

/* LANES_KERNEL(name, coefficients, fill, element, most) defines a kernel as in core/kernels.h. For
 * each value, fill(shared, lane, c) sets the coefficients c[coefficients] of its medium, and
 * element(c, x) is the result, for x from 0 to most. The compiler keeps c in registers. */
#define LANES_KERNEL(name, coefficients, fill, element, most)                                      \
  static void name(const real *restrict shared, const real *restrict words, size_t n,             \
                   const real *restrict sigma_a, const real *restrict sigma_s,                     \
                   const real *restrict in, real *restrict out) {                                  \
    (void)words;                                                                                   \
    for (size_t i = 0; i < n; i++) {                                                               \
      real c[coefficients];                                                                        \
      fill(shared, lane_of(shared, sigma_a[i], sigma_s[i]), c);                                    \
      const real value = element(c, in[i]);                                                        \
      const int good =                                                                             \
          lane_good(shared, sigma_a[i], sigma_s[i]) & (in[i] >= 0) & (in[i] <= (real)(most));      \
      out[i] = good ? value : (real)NAN;                                                           \
    }                                                                                              \
  }

/* The members of a kernel table for the kernels varying_sample, varying_R and so on. */
#define LANES_KERNELS_OF_ALL                                                                       \
  .varying_sample = varying_sample, .varying = {                                                   \
      [CORE_ELEMENTWISE_R] = varying_R,                                                            \
      [CORE_ELEMENTWISE_CDF] = varying_cdf,                                                        \
      [CORE_ELEMENTWISE_PDF] = varying_pdf,                                                        \
      [CORE_ELEMENTWISE_RING] = varying_ring,                                                      \
      [CORE_ELEMENTWISE_LN_R] = varying_ln_R,                                                      \
  }

#endif
#endif
