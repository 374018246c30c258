/* layer: how light of one wavenumber is reflected by a layer, and leaves a half space. */
#ifndef DIPOLED_CORE_SOLVER_LAYER_H
#define DIPOLED_CORE_SOLVER_LAYER_H

#include <complex.h>
#include <stdbool.h>

#include "core/solver/expansion.h"

/* The exitance at one wavenumber, per power that has entered, for one boundary. */
typedef struct layer_exitance {
  double complex single; /* of light of all angles that was scattered once */
  /* all that leaves, then what leaves within each cone, each less what was scattered once */
  double complex part[1 + EXPANSION_CONES_MAX];
  double complex
      diffuse; /* all, if diffuse light (of the same radiance from all directions) enters */
} layer_exitance;

/* Sets exitance[i] for boundary i of a half space. k: Re k >= 0, Im k >= 0, in reciprocal scaled
 * mean free paths, and not on the imaginary axis from kappa upwards. For real k everything is
 * computed in real numbers. kappa: decay rate of diffuse light in the same unit, not negative. k
 * and kappa are not both 0. Returns false if memory runs out or the equation is singular. */
bool solver_layer_halfspace(const expansion *of, double complex k, double kappa,
                            layer_exitance *exitance);

#endif
