/* mie: phase functions of dielectric spheres (Mie 1908). */
#ifndef DIPOLED_PHASES_MIE_H
#define DIPOLED_PHASES_MIE_H

#include <stddef.h>

/* Sets the Legendre moments of the phase function of spheres without absorption, moment[0] = 1, and
 * returns how many of them are not 0, at most moments_most. index: refractive index of the spheres
 * over that of the medium around them. size: circumference over wavelength, up to 40, of the median
 * sphere. spread: standard deviation of the logarithm of the size, 0 for equal spheres. */
size_t mie_moments(double index, double size, double spread, double *moment, size_t moments_most);

#endif
