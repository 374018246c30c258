/* halfspace: the transport equation with anisotropic scattering in a half space, Fourier
 * transformed over the plane, at one wavenumber.
 *
 * Lengths in this module are in scaled mean free paths: the part of the phase function that a
 * truncated series cannot tell from unscattered light counts as unscattered (Joseph, Wiscombe,
 * Weinman 1976, delta-M).
 */
#ifndef DIPOLED_CORE_TRANSPORT_HALFSPACE_H
#define DIPOLED_CORE_TRANSPORT_HALFSPACE_H

#include <complex.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/core.h"

enum {
  HALFSPACE_MOMENTS_MAX = 256, /* largest number of moments of a truncated phase function */
  HALFSPACE_ETAS_MAX = 32,     /* largest number of boundaries that are solved together */
  HALFSPACE_CONES_MAX = 8,     /* largest number of cones of angles for each boundary */
};

/* A medium whose phase function has been truncated. */
typedef struct halfspace_medium {
  double albedo;        /* of single scattering, after the truncation */
  size_t moments;       /* number of moments, 1 to HALFSPACE_MOMENTS_MAX */
  const double *moment; /* moment[l] for l from 0, with moment[0] = 1 */
} halfspace_medium;

/* The functions of angle that the light is expanded in: for each hemisphere and each m from 0 to
 * `orders`, cos(m phi) sin^m(theta) times `degrees` - m polynomials of cos(theta), but at least
 * `degrees_least` of them. */
typedef struct halfspace_rules {
  size_t orders;
  size_t degrees;
  size_t degrees_least;
} halfspace_rules;

typedef struct halfspace halfspace;

/* Returns the angular integrals for one medium and some boundaries, and memory for solving with
 * them on an instruction set; or NULL if memory runs out. Each thread needs its own. The caller
 * frees it with transport_halfspace_free(), which accepts NULL. medium: it has to outlive the
 * result. etas: index inside over index outside, 1 to HALFSPACE_ETAS_MAX of them, each 0.2 to 5.
 * sines: that of the largest angle to the normal outside that a cone has, over min(1, eta), which is
 * that of all light; 0 to HALFSPACE_CONES_MAX of them, each above 0 and up to 1. */
halfspace *transport_halfspace_new(const core_isa *isa, const halfspace_rules *rules,
                                   const halfspace_medium *medium, const double *etas, size_t count,
                                   const double *sines, size_t cones);
void transport_halfspace_free(halfspace *of);

/* The exitance at one wavenumber, per power that has entered, for one boundary. */
typedef struct halfspace_exitance {
  double complex all;
  double complex single;  /* the part of `all` that was scattered once */
  double complex diffuse; /* if diffuse light (of the same radiance from all directions) enters */
  /* the part of `all` that leaves within each cone, less what was scattered once */
  double complex cone[HALFSPACE_CONES_MAX];
} halfspace_exitance;

/* Sets exitance[i] for boundary i. k: Re k >= 0, 0 <= Im k < kappa, in reciprocal scaled mean free
 * paths. kappa: decay rate of diffuse light in the same unit, not negative. For real k everything
 * is computed in real numbers. k and kappa are not both 0. Returns false if the equation is
 * singular, which happens for albedo 1 at k = 0 alone. */
bool transport_halfspace_solve(halfspace *of, double complex k, double kappa,
                               halfspace_exitance *exitance);

/* Sets single[i] to the part of the exitance `diffuse` at k = 0 that was scattered once, for
 * boundary i. Returns false if the equation is singular. */
bool transport_halfspace_diffuse_single(halfspace *of, double *single);

#endif
