/* plain_walk: Monte Carlo as a simple scalar program: one photon after the other, in double
 * precision, with weights and roulette as in MCML (L. Wang, S. Jacques, L. Zheng 1995). The tests
 * compare the results of core's walk with it.
 *
 * Lengths are in mean free paths.
 */
#ifndef DIPOLED_TESTS_PLAIN_WALK_H
#define DIPOLED_TESTS_PLAIN_WALK_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "core/splitmix.h"

typedef struct plain_medium {
  double albedo;
  double g;
  double eta;
  double thickness; /* INFINITY means a half space */
} plain_medium;

enum plain_fate { PLAIN_REFLECTED, PLAIN_TRANSMITTED, PLAIN_INSIDE };

/* The last position of a photon. weight: that with which it left, or still has. */
typedef struct plain_photon {
  double x, y, z;
  double ux, uy, uz;
  double path; /* its length so far */
  double weight;
  bool scattered;
  enum plain_fate fate;
} plain_photon;

#define PLAIN_ROULETTE_WEIGHT 1e-4
#define PLAIN_ROULETTE_CHANCE 0.1

/* Returns a random number from (0, 1). */
static inline double plain_random(uint64_t *state) {
  return ((double)(core_splitmix(state) >> 12) + 0.5) * 0x1p-52;
}

/* Returns the Fresnel reflectance of unpolarized light from inside. */
static inline double plain_reflectance(double eta, double ci) {
  const double st_squared = eta * eta * (1 - ci) * (1 + ci);
  if (st_squared >= 1) {
    return 1;
  }
  const double ct = sqrt(1 - st_squared);
  const double s = (eta * ci - ct) / (eta * ci + ct);
  const double p = (eta * ct - ci) / (eta * ct + ci);
  return 0.5 * (s * s + p * p);
}

/* Moves a photon to its next collision. Returns false if it has left the medium. */
static inline bool plain_fly(const plain_medium *medium, plain_photon *p, uint64_t *random) {
  double path = -log(plain_random(random));
  for (;;) {
    const double height = p->uz < 0 ? p->z : medium->thickness - p->z;
    const double way = p->uz == 0 ? (double)INFINITY : height / fabs(p->uz);
    const double flown = fmin(way, path);
    p->path += flown;
    p->x += p->ux * flown;
    p->y += p->uy * flown;
    if (way >= path) {
      p->z += p->uz * flown;
      return true;
    }
    p->z = p->uz < 0 ? 0 : medium->thickness;
    path -= way;
    if (plain_random(random) >= plain_reflectance(medium->eta, fabs(p->uz))) {
      p->fate = p->uz < 0 ? PLAIN_REFLECTED : PLAIN_TRANSMITTED;
      return false;
    }
    p->uz = -p->uz;
  }
}

static inline double plain_henyey_greenstein(double g, double u) {
  if (g == 0) {
    return 2 * u - 1;
  }
  const double t = (1 - g * g) / (1 - g + 2 * g * u);
  return (1 + g * g - t * t) / (2 * g);
}

static inline void plain_scatter(const plain_medium *medium, plain_photon *p, uint64_t *random) {
  const double cosine = fmin(1, fmax(-1, plain_henyey_greenstein(medium->g, plain_random(random))));
  const double sine = sqrt((1 - cosine) * (1 + cosine));
  const double azimuth = 6.28318530717958647693 * plain_random(random);
  const double a = sine * cos(azimuth);
  const double b = sine * sin(azimuth);
  const double x = p->ux, y = p->uy, z = p->uz;
  const double across = sqrt(x * x + y * y);
  if (across < 1e-10) {
    p->ux = a;
    p->uy = b;
    p->uz = cosine * (z < 0 ? -1 : 1);
  } else {
    p->ux = (a * x * z - b * y) / across + cosine * x;
    p->uy = (a * y * z + b * x) / across + cosine * y;
    p->uz = cosine * z - a * across;
  }
  p->scattered = true;
}

/* Walks one photon, which starts straight down inside the medium. */
static inline plain_photon plain_walk(const plain_medium *medium, uint64_t *random) {
  plain_photon p = {.uz = 1, .weight = 1, .fate = PLAIN_INSIDE};
  while (plain_fly(medium, &p, random)) {
    p.weight *= medium->albedo;
    if (p.weight < PLAIN_ROULETTE_WEIGHT) {
      if (p.weight == 0 || plain_random(random) > PLAIN_ROULETTE_CHANCE) {
        return p;
      }
      p.weight /= PLAIN_ROULETTE_CHANCE;
    }
    plain_scatter(medium, &p, random);
  }
  return p;
}

#endif
