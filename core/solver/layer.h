/* layer: how light of one wavenumber is reflected by a layer, and leaves a half space. */
#ifndef DIPOLED_CORE_SOLVER_LAYER_H
#define DIPOLED_CORE_SOLVER_LAYER_H

#include <complex.h>
#include <stdbool.h>

#include "core/solver/dense.h"
#include "core/solver/expansion.h"

/* The exitance at one wavenumber, per power that has entered, for one boundary. */
typedef struct layer_exitance {
  double complex single; /* light of all angles that was scattered once */
  /* [0]: all light that leaves; [1 + i]: light within cone i; both without light scattered once */
  double complex part[1 + EXPANSION_CONES_MAX];
  double complex
      diffuse; /* like part[0] for diffuse incident light: the same radiance from all directions */
} layer_exitance;

/* Sets exitance[i] for boundary i of a half space. k: Re k >= 0, Im k >= 0, in reciprocal scaled
 * mean free paths, and not on the imaginary axis from kappa upwards. For real k everything is
 * computed in real numbers. kappa: decay rate of diffuse light in the same unit, not negative. k
 * and kappa are not both 0. Returns false if memory runs out or the equation is singular. */
bool solver_layer_halfspace(const expansion *of, double complex k, double kappa,
                            layer_exitance *exitance);

/* What a layer does to light that strikes it, for one wavenumber. Matrices are
 * [n + 1][n + 1], with the signs of the formulas; the last row and column belong to the beam. Both
 * faces are alike. */
typedef struct layer_operators {
  dense reflected;
  dense transmitted; /* not set for a half space */
  /* Of light that is scattered at most once: what passes, with what a beam scatters on; and what a
   * beam scatters back, a column. */
  dense passed_once;
  dense reflected_once;
} layer_operators;

/* Sets the operators of a layer. depth: its thickness in scaled mean free paths, above 0; infinite
 * for a half space, for which k and kappa are as for solver_layer_halfspace(). *to: its matrices
 * have room, real if Im k is 0 and complex otherwise. Returns false if memory runs out or the
 * equation is singular. */
bool solver_layer_operators(const layer_operators *to, const expansion *of, double complex k,
                            double kappa, double depth);

#endif
