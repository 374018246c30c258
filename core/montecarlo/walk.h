/* walk: photons in lanes: the inner loop of Monte Carlo. Internal to core/montecarlo.
 *
 * Lengths are in mean free paths 1 / sigma_t; z points into the medium, which begins at z = 0.
 */
#ifndef DIPOLED_CORE_MONTECARLO_WALK_H
#define DIPOLED_CORE_MONTECARLO_WALK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* WALK_LANES photons at most are walked together; loops go over a multiple of WALK_GROUP of them,
 * the widest register of any instruction set. */
enum { WALK_LANES = 64, WALK_GROUP = 16 };

/* What the walk has to know of medium and geometry. */
typedef struct walk_medium {
  bool isotropic;
  bool slab;
  uint32_t key[2];
  float g_sign; /* 1 or -1 */
  float g_size; /* |g| */
  float one_minus_g;
  float one_plus_g;
  float thickness; /* infinite: half space */
  /* The squared cosine outside is cosine_constant + cosine_factor s, where s is the squared sine
   * inside if all bits of by_sine are set, and the squared cosine if none is, whichever loses fewer
   * digits. */
  float eta;
  uint32_t by_sine;
  float cosine_constant;
  float cosine_factor;
  /* Where the first collision is: its depth is -ln(first_rest + w first_share), w uniform; from the
   * other side, the light having been reflected there, with the probability first_turned. */
  float first_share;
  float first_rest;
  float first_turned;
} walk_medium;

/* What became of a photon in its last flight. */
enum walk_fate {
  WALK_GOES_ON,
  WALK_REFLECTED,   /* left through z = 0 */
  WALK_TRANSMITTED, /* left through z = thickness */
  WALK_ENDED,       /* was scattered as often as it may be */
};

/* Each lane's photon is where it was scattered last; when it has left, x and y are still those, and
 * `way` is the path from there to the boundary. */
typedef struct walk_lanes {
  float x[WALK_LANES];
  float y[WALK_LANES];
  float z[WALK_LANES];
  float ux[WALK_LANES];
  float uy[WALK_LANES];
  float uz[WALK_LANES];
  float way[WALK_LANES];
  uint32_t collisions[WALK_LANES]; /* so far */
  uint32_t last[WALK_LANES];       /* the collision that ends the walk */
  uint32_t photon[WALK_LANES];     /* low half of its index */
  uint32_t fate[WALK_LANES];       /* enum walk_fate */
} walk_lanes;

/* Photons with consecutive indices, at their first collision. */
typedef struct walk_launch {
  float z[WALK_LANES];
  float uz[WALK_LANES];        /* 1 or -1: where they come from */
  uint32_t chance[WALK_LANES]; /* below 2^31, uniform; decides how long roulette lets them live */
} walk_launch;

/* Fills *launch with photons first to first + WALK_LANES - 1. first: a multiple of WALK_LANES. */
typedef void walk_launch_function(const walk_medium *medium, uint64_t first, walk_launch *launch);

/* Scatters the first `lanes` photons (a multiple of WALK_GROUP) once and lets each fly to its next
 * collision or out. high: the high half of their indices. */
typedef void walk_step_function(const walk_medium *medium, uint32_t high, size_t lanes,
                                walk_lanes *walk);

typedef struct walk_functions {
  walk_launch_function *launch;
  walk_step_function *step;
} walk_functions;

#endif
