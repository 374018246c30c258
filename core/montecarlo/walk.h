/* walk: photons in lanes, the inner loop of Monte Carlo. Internal to core/montecarlo.
 *
 * Lengths are in mean free paths 1 / sigma_t. z points into the medium, which begins at z = 0.
 */
#ifndef DIPOLED_CORE_MONTECARLO_WALK_H
#define DIPOLED_CORE_MONTECARLO_WALK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* At most WALK_LANES photons are walked together. Loops go over a multiple of WALK_GROUP of them,
 * which is the number of floats in the widest register of any instruction set. */
enum { WALK_LANES = 64, WALK_GROUP = 16 };

#define WALK_POINTS (UINT32_C(1) << 31) /* number of points of a uniform number */

/* How a photon is deflected. WALK_MODIFIED and WALK_TWO_TERM mix two functions. */
enum walk_phase { WALK_ISOTROPIC, WALK_HENYEY_GREENSTEIN, WALK_MODIFIED, WALK_TWO_TERM };

/* Henyey and Greenstein's function */
typedef struct walk_hg {
  float sign; /* sign of g: 1 or -1 */
  float size; /* |g| */
  float one_minus;
  float one_plus;
} walk_hg;

/* The medium and geometry as the walk uses them. */
typedef struct walk_medium {
  enum walk_phase phase;
  bool slab;
  uint32_t key[2];
  walk_hg hg[2]; /* hg[1] is for WALK_TWO_TERM only */
  /* Of the 2^31 points of a uniform number, the first `share` draw from hg[0] and the others from
   * the second function of a mixture. */
  uint32_t share;
  float share_inverse; /* 1 / share */
  float rest_inverse;  /* 1 / (2^31 - share), or 0 */
  float thickness;     /* thickness of a slab; INFINITY for a half space */
  /* The squared cosine outside is cosine_constant + cosine_factor s. If all bits of by_sine are
   * set, s is the squared sine inside, and if no bit is set, the squared cosine inside; the plan
   * chooses the one that loses fewer digits. */
  float eta;
  uint32_t by_sine;
  float cosine_constant;
  float cosine_factor;
  /* The depth of the first collision is -ln(first_rest + w first_share), w uniform. With the
   * probability first_turned the light was reflected at the other side first, and the depth counts
   * from there. */
  float first_share;
  float first_rest;
  float first_turned;
} walk_medium;

/* The fate of a photon in its last flight. */
enum walk_fate {
  WALK_GOES_ON,
  WALK_REFLECTED,   /* the photon left through z = 0 */
  WALK_TRANSMITTED, /* the photon left through z = thickness */
  WALK_ENDED,       /* the photon collided as often as `last` allows */
};

/* The photons of all lanes. Each photon is where it collided last. When a photon has left, x and y
 * are still those of its last collision, and `way` is the path from there to the boundary. */
typedef struct walk_lanes {
  float x[WALK_LANES];
  float y[WALK_LANES];
  float z[WALK_LANES];
  float ux[WALK_LANES];
  float uy[WALK_LANES];
  float uz[WALK_LANES];
  float way[WALK_LANES];
  uint32_t collisions[WALK_LANES]; /* number of collisions so far */
  uint32_t last[WALK_LANES];       /* number of the collision that ends the walk */
  uint32_t photon[WALK_LANES];     /* low half of the photon's index */
  uint32_t fate[WALK_LANES];       /* enum walk_fate */
} walk_lanes;

/* Photons with consecutive indices, each at its first collision. */
typedef struct walk_launch {
  float z[WALK_LANES];
  float uz[WALK_LANES]; /* direction before the first collision: 1 is down, -1 up */
  /* uniform, below 2^31; decides how long roulette lets the photon live */
  uint32_t chance[WALK_LANES];
} walk_launch;

/* Fills *launch with photons first to first + WALK_LANES - 1. first: a multiple of WALK_LANES. */
typedef void walk_launch_function(const walk_medium *medium, uint64_t first, walk_launch *launch);

/* Scatters the first `lanes` photons (a multiple of WALK_GROUP) once, and moves each of them to its
 * next collision or out of the medium. high: the high half of the photons' indices. */
typedef void walk_step_function(const walk_medium *medium, uint32_t high, size_t lanes,
                                walk_lanes *walk);

typedef struct walk_functions {
  walk_launch_function *launch;
  walk_step_function *step;
} walk_functions;

#endif
