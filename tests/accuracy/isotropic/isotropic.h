/* isotropic: radiative transport without noise, by another way than core/solver/, which it checks, as
 * it checks the table, whose part for g = 0 is made with it. A pencil beam enters a half space of
 * isotropic scatterers at right angles through a smooth boundary with Fresnel's reflectance.
 *
 * Method: Fourier transform over the plane, Laplace transform over depth, H functions, a low-rank
 * system for each wavenumber (equation.c), wavenumbers on a hyperbola in the complex plane. Light
 * scattered once is computed in real space (core/transport/single.c). test_transport.c compares it
 * with published values.
 *
 * Units: lengths are in mean free paths, 1 / (sigma_a + sigma_s). R is per squared mean free path.
 * All energies are per power that has entered, which excludes the specular reflection of the beam.
 *
 * The same input gives the same bits on every machine. Out of memory, it ends the program.
 */
#ifndef DIPOLED_TESTS_ISOTROPIC_H
#define DIPOLED_TESTS_ISOTROPIC_H

/* The solution for one medium. It is immutable, so any number of threads may read it. */
typedef struct isotropic_solution isotropic_solution;

/* R keeps the tolerance from r = 0 to where e^(-kappa r) is e^-30, which is 30 mean free paths or more
 * for every albedo, or e^-110. Beyond, R is not exact. */
#define ISOTROPIC_REACH 30.0
#define ISOTROPIC_REACH_FAR 110.0

/* Solves one medium. eta: index inside over index outside, 0.25 to 4. albedo: of single scattering,
 * sigma_s / (sigma_a + sigma_s), 0 to 1. tolerance: of R and of the energy within a radius, relative,
 * 1e-9 to 1e-3. reach: one of the two above. The caller frees the solution. */
isotropic_solution *isotropic_solve(double eta, double albedo, double tolerance, double reach);
void isotropic_free(isotropic_solution *of);

/* The values at one radius. */
typedef struct isotropic_values {
  double R;
  double single; /* the part of R of light scattered once */
  double within; /* energy that leaves within r, from 0 to the total */
} isotropic_values;

/* r: from 1e-290 to 1e60. */
isotropic_values isotropic_at(const isotropic_solution *of, double r);

/* Returns the total energy that leaves. Its relative error is below 1e-10. */
double isotropic_total(const isotropic_solution *of);

#endif
