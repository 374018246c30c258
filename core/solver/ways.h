/* ways: light that is scattered once in layers, exactly, in real space. Lengths are in any unit. */
#ifndef DIPOLED_CORE_SOLVER_WAYS_H
#define DIPOLED_CORE_SOLVER_WAYS_H

#include <complex.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/solver/stack.h"

enum { WAYS_MAX = 512 };

/* A way of light after its scattering in a layer until it leaves. */
typedef struct ways_path {
  size_t layer;
  bool upwards;                          /* whether light goes upwards after its scattering */
  size_t side;                           /* side where it leaves: 0 above, 1 below */
  unsigned reflections;                  /* number of reflections */
  unsigned char full[SOLVER_LAYERS_MAX]; /* how often it crosses each layer completely */
  /* how often it passes, and is reflected by, each boundary */
  unsigned char through[SOLVER_LAYERS_MAX + 1], back[SOLVER_LAYERS_MAX + 1];
} ways_path;

typedef struct ways {
  size_t count, layers;
  const stack_layer *layer;
  double index_below;
  unsigned reflections_most;
  /* the beams on their way down at a layer's head, and up at its foot, with so many reflections or
   * fewer */
  double down[SOLVER_LAYERS_MAX][STACK_REFLECTIONS_MAX + 1],
      up[SOLVER_LAYERS_MAX][STACK_REFLECTIONS_MAX + 1];
  ways_path way[WAYS_MAX];
} ways;

/* Sets *to to all ways with at most so many reflections, together with the beam's, as count in layers
 * of these depths. below: the index below over that above. layer: kept as it is. */
void solver_ways_find(ways *to, const stack_layer *layer, size_t layers, double below);

/* Returns R (side 0) or T (side 1) of light scattered once, at the radius r > 0, per squared unit
 * of length and per power that entered. */
double solver_ways_at(const ways *of, size_t side, double r);

/* Returns the light scattered once that leaves below without a reflection, Fourier transformed over
 * the plane, over the beam that leaves with it. No layer is a half space. k: infinite for the limit
 * of k times this. */
double complex solver_ways_onwards(const ways *of, double complex k);

#endif
