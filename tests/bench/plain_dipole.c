#include "tests/bench/plain_dipole.h"

#include <math.h>

/* Keeps the compiler from vectorizing a loop, at any optimization level: the kernels are compared
 * with a scalar loop. */
#if defined(__clang__)
#define ONE_AT_A_TIME _Pragma("clang loop vectorize(disable) interleave(disable)")
#else
#define ONE_AT_A_TIME
#pragma GCC optimize("no-tree-vectorize")
#endif

plain_dipole plain_dipole_prepare(int switches, const core_medium *medium) {
  const double sigma_s_prime = medium->sigma_s_per_mm * (1 - medium->g);
  const double sigma_t_prime = medium->sigma_a_per_mm + sigma_s_prime;
  const double alpha_prime = sigma_s_prime / sigma_t_prime;
  const bool grosjean = (switches & CORE_DIPOLE_GROSJEAN) != 0;
  const bool exitance = (switches & CORE_DIPOLE_EXITANCE) != 0;
  const core_fresnel fresnel = core_fresnel_moments(CORE_MOMENTS_EXACT, medium->eta);
  const double reflected =
      1 - ((switches & CORE_DIPOLE_BOUNDARY) != 0 ? fresnel.one_minus_3c2 : fresnel.one_minus_2c1);
  const double D = (grosjean ? 1 + medium->sigma_a_per_mm / sigma_t_prime : 1) / 3 / sigma_t_prime;
  const double z1 = 1 / sigma_t_prime;
  return (plain_dipole){
      .scale = (grosjean ? alpha_prime * alpha_prime : alpha_prime) / (4 * acos(-1)),
      .mu_tr = sqrt(medium->sigma_a_per_mm / D),
      .z1 = z1,
      .z2 = z1 + 4 * D * (1 + reflected) / fresnel.one_minus_2c1,
      .phi = exitance ? fresnel.one_minus_2c1 / 4 / D : 0,
      .flux = exitance ? fresnel.one_minus_3c2 / 2 : 1,
  };
}

/* DEFINE_PLAIN defines two loops. The one without the terms of the fluence is what a renderer has
 * that knows only the classical dipole. */
#define DEFINE_PLAIN(name, real, sqrt_of, exp_of)                                                  \
  static void name##_flux(const plain_dipole *dipole, size_t n, const real *r, real *R) {          \
    const real scale = (real)(dipole->scale * dipole->flux);                                       \
    const real mu = (real)dipole->mu_tr;                                                           \
    const real z1 = (real)dipole->z1;                                                              \
    const real z2 = (real)dipole->z2;                                                              \
    ONE_AT_A_TIME                                                                                  \
    for (size_t i = 0; i < n; i++) {                                                               \
      const real d1 = sqrt_of(r[i] * r[i] + z1 * z1);                                              \
      const real d2 = sqrt_of(r[i] * r[i] + z2 * z2);                                              \
      R[i] = scale * (z1 * (1 + mu * d1) * exp_of(-mu * d1) / (d1 * d1 * d1) +                     \
                      z2 * (1 + mu * d2) * exp_of(-mu * d2) / (d2 * d2 * d2));                     \
    }                                                                                              \
  }                                                                                                \
  static void name##_both(const plain_dipole *dipole, size_t n, const real *r, real *R) {          \
    const real scale = (real)dipole->scale;                                                        \
    const real mu = (real)dipole->mu_tr;                                                           \
    const real z1 = (real)dipole->z1;                                                              \
    const real z2 = (real)dipole->z2;                                                              \
    const real phi = (real)dipole->phi;                                                            \
    const real flux = (real)dipole->flux;                                                          \
    ONE_AT_A_TIME                                                                                  \
    for (size_t i = 0; i < n; i++) {                                                               \
      const real d1 = sqrt_of(r[i] * r[i] + z1 * z1);                                              \
      const real d2 = sqrt_of(r[i] * r[i] + z2 * z2);                                              \
      const real e1 = exp_of(-mu * d1) / d1;                                                       \
      const real e2 = exp_of(-mu * d2) / d2;                                                       \
      R[i] = scale * (phi * (e1 - e2) + flux * (z1 * (1 + mu * d1) * e1 / (d1 * d1) +              \
                                                z2 * (1 + mu * d2) * e2 / (d2 * d2)));             \
    }                                                                                              \
  }                                                                                                \
  void name(const plain_dipole *dipole, size_t n, const real *r, real *R) {                        \
    (dipole->phi == 0 ? name##_flux : name##_both)(dipole, n, r, R);                               \
  }

DEFINE_PLAIN(plain_dipole_f64, double, sqrt, exp)
DEFINE_PLAIN(plain_dipole_f32, float, sqrtf, expf)
