/* walk: photons in lanes, the inner loop of Monte Carlo. Internal to core/montecarlo.
 *
 * Lengths are in mean free paths 1 / sigma_t. z points into the medium, which begins at z = 0.
 */
#ifndef DIPOLED_CORE_MONTECARLO_WALK_H
#define DIPOLED_CORE_MONTECARLO_WALK_H

#include <stdint.h>

#include "core/montecarlo/montecarlo.h"

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

/* A boundary for light from one of its sides. The squared cosine beyond is cosine_constant +
 * cosine_factor s. If all bits of by_sine are set, s is the squared sine on this side, and if no bit
 * is set, the squared cosine; the plan chooses the one that loses fewer digits. */
typedef struct walk_boundary {
  float eta; /* index on this side over that beyond */
  uint32_t by_sine;
  float cosine_constant;
  float cosine_factor;
} walk_boundary;

enum walk_geometry { WALK_HALF_SPACE, WALK_SLAB, WALK_LAYERS };

/* The medium and geometry as the walk uses them. */
typedef struct walk_medium {
  enum walk_phase phase;
  enum walk_geometry geometry;
  uint32_t key[2];
  uint32_t last; /* index of the lowest layer */
  /* Each layer's, in arrays of their own, as gathering loads need it. The one layer of a homogeneous
   * medium has a mean free path of 1. */
  float mfp[CORE_LAYERS_MAX];
  float thickness[CORE_LAYERS_MAX]; /* thickness of each layer; INFINITY: a half space */
  float albedo[CORE_LAYERS_MAX];    /* for WALK_LAYERS only */
  float g_sign[CORE_LAYERS_MAX];    /* walk_hg */
  float g_size[CORE_LAYERS_MAX];
  float g_one_minus[CORE_LAYERS_MAX];
  float g_one_plus[CORE_LAYERS_MAX];
  /* walk_boundary; the head of layer i for light in it has the index 2 i, its foot 2 i + 1 */
  float eta[2 * CORE_LAYERS_MAX];
  uint32_t by_sine[2 * CORE_LAYERS_MAX];
  float cosine_constant[2 * CORE_LAYERS_MAX];
  float cosine_factor[2 * CORE_LAYERS_MAX];
  /* The optical depth of a first collision is -ln(first_rest + w first_share), w uniform. */
  float first_share[CORE_LAYERS_MAX];
  float first_rest[CORE_LAYERS_MAX];
  walk_hg second; /* the second function of WALK_TWO_TERM */
  /* Of the 2^31 points of a uniform number, the first `share` draw from the first layer's function
   * and the others from the second function of a mixture. */
  uint32_t share;
  float share_inverse; /* 1 / share */
  float rest_inverse;  /* 1 / (2^31 - share), or 0 */
  /* The first collision is on the way up in layer 0, down in it, up in layer 1, ... with the
   * probabilities whose sums these are; the last sum is left out. On the way up its depth counts from
   * the foot of the layer. */
  float first_sum[2 * CORE_LAYERS_MAX - 1];
  /* Roulette in WALK_LAYERS: the least weight is roulette_weight max(1, sqrt(n long_path_inverse))
   * after n flights. */
  float roulette_weight;
  float long_path_inverse;
} walk_medium;

/* The fate of a photon in its last flight. */
enum walk_fate {
  WALK_GOES_ON,
  WALK_REFLECTED,   /* the photon left through the top */
  WALK_TRANSMITTED, /* the photon left through the lowest layer's foot */
  WALK_ENDED,       /* the photon collided as often as `last` allows, or has no weight left */
};

/* The photons of all lanes. Each photon is where it collided last, or in layers where it met a
 * boundary since. When a photon has left, x and y are still those of that place, and `way` is the
 * path from there to the boundary. */
typedef struct walk_lanes {
  float x[WALK_LANES];
  float y[WALK_LANES];
  float z[WALK_LANES]; /* depth below the upper face of the layer */
  float ux[WALK_LANES];
  float uy[WALK_LANES];
  float uz[WALK_LANES];
  float way[WALK_LANES];
  /* number of collisions so far, in layers also of boundaries met */
  uint32_t collisions[WALK_LANES];
  uint32_t last[WALK_LANES];   /* number of the collision that ends the walk */
  uint32_t photon[WALK_LANES]; /* low half of the photon's index */
  uint32_t fate[WALK_LANES];   /* enum walk_fate */
  /* For WALK_LAYERS only. The weight before the last flight's collision, after it, and after
   * roulette; all three are equal if the flight had none. */
  int32_t layer[WALK_LANES];
  uint32_t collided[WALK_LANES]; /* a mask: set if the last flight ended with a collision */
  float before[WALK_LANES];
  float after[WALK_LANES];
  float weight[WALK_LANES];
} walk_lanes;

/* Photons with consecutive indices, each at its first collision. */
typedef struct walk_launch {
  int32_t layer[WALK_LANES];
  float z[WALK_LANES];
  float uz[WALK_LANES]; /* direction before the first collision: 1 down, -1 up */
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
