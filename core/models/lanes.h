/* lanes: what the kernels share where every value has its own medium (core/varying.h). A lane
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
  LANES_SCATTERED_LEAST, /* least sigma_s' / sigma_t' where sigma_s' is not 0 */
  LANES_ABSORBS,         /* 1 if the model requires sigma_a > 0, else 0 */
  /* Up to x (FAR + FAR_S s + FAR_S2 s^2) = 1 errors are stated, s = sqrt(sigma_a / sigma_t'). */
  LANES_FAR,
  LANES_FAR_S,
  LANES_FAR_S2,
  /* dipoles: the switches and moments of Table 2 (d'Eon 2012) */
  LANES_GROSJEAN, /* 1 or 0 */
  LANES_Z2_PER_D, /* 4 A */
  LANES_C_PHI,
  LANES_C_FLUX,
  LANES_C_BETWEEN, /* 4 A C_phi: 1 + 3 C2 or 1 + 2 C1, exactly */
  /* Burley's profile */
  LANES_SURFACE_ALBEDO, /* the parameter `surface_albedo`; -1: the better dipole's albedo is used */
  LANES_FIT,            /* enum core_burley_fit */
  /* colours */
  LANES_SPECULAR, /* for each light: the share that the surface reflects */
  LANES_COLOUR_LEAST = LANES_SPECULAR + CORE_LIGHTS,
  LANES_COLOUR_MOST = LANES_COLOUR_LEAST + CORE_LIGHTS,
  LANES_SHARED = LANES_COLOUR_MOST + CORE_LIGHTS
};
_Static_assert((int)LANES_SHARED <= CORE_VARYING_SHARED_MAX, "the structure has room for them");

#include "core/kernel.h"

/* The medium of one value. */
struct lane {
  real sigma_a;   /* 1/mm */
  real sigma_t;   /* sigma_t', 1/mm */
  real mfp;       /* 1 / sigma_t' */
  real absorbed;  /* sigma_a / sigma_t' */
  real scattered; /* sigma_s' / sigma_t' */
};

static inline struct lane lane_of(const real *shared, real sigma_a, real sigma_s) {
  const real reduced = sigma_s * shared[LANES_SCATTER];
  struct lane lane;
  lane.sigma_a = sigma_a;
  lane.sigma_t = sigma_a + reduced;
  lane.mfp = 1 / lane.sigma_t;
  lane.absorbed = sigma_a * lane.mfp;
  /* 1 without absorption, exactly; by sums, since a choice keeps the loops of surfaces from vectors */
  const real white = sigma_a > 0 ? 0 : 1;
  lane.scattered = reduced * lane.mfp * (1 - white) + white;
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
  real power; /* alpha' or alpha'^2, by the model */
  real mu;
  real diffusion; /* D */
  real z2_less_1;
  real phi;          /* C_phi / D */
  real real_share;   /* e^(-mu z1) */
  real mirror_share; /* e^(-mu z2) */
  real between;      /* phi (e^(-mu z1) - e^(-mu z2)) / mu */
  real sum;          /* the albedo is power * sum / 2 */
};

static inline struct lane_dipole lane_dipole_of(const real *shared, struct lane lane) {
  const int grosjean = shared[LANES_GROSJEAN] > 0;
  const real three_D = grosjean ? 1 + lane.absorbed : 1;
  const real diffusion = three_D * (REAL(1.0) / 3);
  struct lane_dipole dipole;
  dipole.power = grosjean ? lane.scattered * lane.scattered : lane.scattered;
  dipole.diffusion = diffusion;
  dipole.mu = real_sqrt(3 * lane.absorbed / three_D);
  dipole.z2_less_1 = shared[LANES_Z2_PER_D] * diffusion;
  dipole.phi = shared[LANES_C_PHI] / diffusion;
  const real_exp_values mirror = real_exp(-dipole.mu * dipole.z2_less_1);
  dipole.real_share = real_exp(-dipole.mu).exp;
  dipole.mirror_share = dipole.real_share * mirror.exp;
  /* For sigma_a = 0 the better dipole's sum is exactly 2. */
  dipole.between = shared[LANES_C_BETWEEN] * dipole.real_share * mirror.quotient;
  dipole.sum =
      real_fma(shared[LANES_C_FLUX], dipole.real_share + dipole.mirror_share, dipole.between);
  return dipole;
}

/* Derivatives by ln a, times 1 - a, with a = sigma_a / sigma_t': of ln mu, of ln phi (those of ln
 * z2_less_1 are the opposite) and of ln power. */
struct lane_slopes {
  real mu;
  real phi;
  real power;
};

static inline struct lane_slopes lane_slopes_of(int grosjean, real absorbed, real scattered) {
  const real falls = scattered / (1 + absorbed);
  return (struct lane_slopes){
      .mu = REAL(0.5) * (grosjean ? falls : scattered),
      .phi = grosjean ? -absorbed * falls : 0,
      .power = grosjean ? -2 * absorbed : -absorbed,
  };
}

/* Returns the derivative of ln albedo by ln sigma_a; that by ln sigma_s' is the opposite. */
static inline real lane_albedo_slope(const real *shared, struct lane lane, struct lane_dipole d) {
  const struct lane_slopes by =
      lane_slopes_of(shared[LANES_GROSJEAN] > 0, lane.absorbed, lane.scattered);
  const real flux = shared[LANES_C_FLUX], z2 = 1 + d.z2_less_1;
  const real fluxes = flux * d.mu * real_fma(z2, d.mirror_share, d.real_share);
  const real by_mu = d.phi * real_fma(z2, d.mirror_share, -d.real_share) - d.between - fluxes;
  const real by_z2 = real_fma(-flux, d.mu, d.phi) * d.mirror_share * d.z2_less_1;
  return by.power + real_fma(by.mu, by_mu, by.phi * (d.between - by_z2)) / d.sum;
}

/* Sets the numbers of a dipole that all lanes share, from its switches. */
static inline void lanes_share_dipole(double *shared, int variant, core_fresnel fresnel) {
  const int exitance = (variant & CORE_DIPOLE_EXITANCE) != 0;
  const double lost =
      (variant & CORE_DIPOLE_BOUNDARY) ? fresnel.one_minus_3c2 : fresnel.one_minus_2c1;
  shared[LANES_GROSJEAN] = (variant & CORE_DIPOLE_GROSJEAN) != 0;
  shared[LANES_Z2_PER_D] = 4 * (2 - lost) / fresnel.one_minus_2c1; /* 4 A */
  shared[LANES_C_PHI] = exitance ? 0.25 * fresnel.one_minus_2c1 : 0;
  shared[LANES_C_FLUX] = exitance ? 0.5 * fresnel.one_minus_3c2 : 1;
  shared[LANES_C_BETWEEN] = exitance ? 2 - lost : 0;
}

#ifndef CORE_ISA
/* Sets the numbers shared by media with this one's g and eta, and returns the medium. variant: the
 * switches of a dipole. */
static inline struct lane lane_of_medium(double *shared, int variant, enum core_moments moments,
                                         const core_medium *medium) {
  shared[LANES_SCATTER] = 1 - medium->g;
  lanes_share_dipole(shared, variant, core_fresnel_moments(moments, medium->eta));
  return lane_of(shared, medium->sigma_a_per_mm, medium->sigma_s_per_mm);
}
#else

/* LANES_KERNEL(name, coefficients, fill, element, most) defines a kernel as in core/kernels.h. For
 * each value, fill(shared, lane, c) sets the coefficients c[coefficients] of its medium, and
 * element(c, x) is the result, for x from 0 to most. The compiler keeps c in registers. */
#define LANES_KERNEL(name, coefficients, fill, element, most)                                      \
  static void name(const real *restrict shared, const real *restrict words, size_t n,              \
                   const real *restrict sigma_a, const real *restrict sigma_s,                     \
                   const real *restrict in, real *restrict out) {                                  \
    (void)words;                                                                                   \
    CORE_FOR_LANES(i, n) {                                                                         \
      real c[coefficients];                                                                        \
      fill(shared, lane_of(shared, sigma_a[i], sigma_s[i]), c);                                    \
      const real value = element(c, in[i]);                                                        \
      const int good =                                                                             \
          lane_good(shared, sigma_a[i], sigma_s[i]) & (in[i] >= 0) & (in[i] <= (real)(most));      \
      out[i] = good ? value : (real)NAN;                                                           \
    }                                                                                              \
  }

/* LANES_GRADIENT(name, coefficients, fill, ln_R, both) defines a kernel of ln R and its
 * derivatives: both(c, r) returns a structure with the members by_a and by_s. */
#define LANES_GRADIENT(name, coefficients, fill, ln_R, both)                                       \
  static void name(const real *restrict shared, const real *restrict words, size_t n,              \
                   const real *restrict sigma_a, const real *restrict sigma_s,                     \
                   const real *restrict r, real *restrict out, real *restrict by_a,                \
                   real *restrict by_s) {                                                          \
    (void)words;                                                                                   \
    CORE_FOR_LANES(i, n) {                                                                         \
      real c[coefficients];                                                                        \
      fill(shared, lane_of(shared, sigma_a[i], sigma_s[i]), c);                                    \
      const int good = lane_good(shared, sigma_a[i], sigma_s[i]) & (r[i] >= 0);                    \
      const struct derivatives found = both(c, r[i]);                                              \
      const real value = ln_R(c, r[i]);                                                            \
      out[i] = good ? value : (real)NAN;                                                           \
      by_a[i] = good ? found.by_a : (real)NAN;                                                     \
      by_s[i] = good ? found.by_s : (real)NAN;                                                     \
    }                                                                                              \
  }

/* The members of a kernel table for the kernels varying_sample, varying_R and so on. */
#define LANES_KERNELS_OF_ALL                                                                       \
  .varying_sample = varying_sample, .varying_albedo = varying_albedo,                              \
  .varying = {                                                                                     \
      [CORE_ELEMENTWISE_R] = varying_R,                                                            \
      [CORE_ELEMENTWISE_CDF] = varying_cdf,                                                        \
  }

#endif
#endif
