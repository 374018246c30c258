/* decay: the rate at which diffuse light decays far from its source. The same arguments give the
 * same bits on every machine. */
#ifndef DIPOLED_CORE_TRANSPORT_DECAY_H
#define DIPOLED_CORE_TRANSPORT_DECAY_H

#include <stddef.h>

/* Returns kappa of isotropic scattering, per mean free path 1 / (sigma_a + sigma_s): from 0 for
 * albedo 1 to 1 for albedo 0. The relative error is below 1e-11. albedo: 0 to 1. */
double transport_kappa(double albedo);

/* Returns kappa per reduced mean free path for Henyey and Greenstein's function. albedo: sigma_s (1 -
 * g) / (sigma_a + sigma_s (1 - g)), above 0, up to 1. g: -0.99 to 0.99. */
double transport_anisotropic_kappa(double albedo, double g);

/* Returns kappa per mean free path for a phase function with these moments: moment[l] is the mean of
 * P_l, moment[0] is 1, and those from `moments` on are 0. albedo: of single scattering. reversed: that
 * of light which is sent straight back beside it. absorbed: 1 less both. At most 1. */
double transport_decay_rate(const double *moment, size_t moments, double albedo, double reversed,
                            double absorbed);

#endif
