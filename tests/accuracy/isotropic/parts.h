/* parts: what the files of the isotropic solver have for each other. A wavenumber k, in radians per
 * mean free path, lies in the first quadrant, with Im k < 1 or Re k > Im k / 3. */
#ifndef DIPOLED_TESTS_ISOTROPIC_PARTS_H
#define DIPOLED_TESTS_ISOTROPIC_PARTS_H

#include <complex.h>
#include <stddef.h>

/* Sets *sine to sinh z and *cosine to cosh z. sinh z loses no digits near z = 0. */
void isotropic_sinhcosh(double complex z, double complex *sine, double complex *cosine);

/* The measures of the transport equation at one wavenumber, as points and weights, see nodes.c. */
typedef struct nodes {
  size_t n;
  double complex p[2048], kernel[2048], exit[2048];
} nodes;

/* Makes the nodes for an eta, 0.05 to 20, and an accuracy of kernel and exitance, 1e-14 to 1e-2. No two
 * of the decay rates p have the sum 0. */
void isotropic_nodes(nodes *to, double eta, double accuracy, double complex k);

/* Returns the exitance of light scattered at least twice, Fourier transformed over the plane, per power
 * that has entered. kappa: transport_kappa(albedo), with k^2 + kappa^2 not 0. */
double complex isotropic_exitance(double eta, double accuracy, double complex k, double albedo,
                                  double kappa);

#endif
