/* layer: how light of one wavenumber is reflected by a layer, and leaves a half space. */
#ifndef DIPOLED_CORE_SOLVER_LAYER_H
#define DIPOLED_CORE_SOLVER_LAYER_H

#include <complex.h>
#include <stdatomic.h>
#include <stdbool.h>

#include "core/solver/dense.h"
#include "core/solver/expansion.h"

/* The exitance at one wavenumber, per power that has entered, for one boundary. */
typedef struct layer_exitance {
  /* [0]: all light that leaves; [1 + i]: light within cone i; both without light scattered once and
   * without `beam`: light that was sent straight back, more than once */
  double complex part[1 + EXPANSION_CONES_MAX];
  double beam;
  double complex
      diffuse; /* like part[0] for diffuse incident light: the same radiance from all directions */
} layer_exitance;

/* Sets exitance[i] for boundary i of a half space. k: Re k >= 0, Im k >= 0, in reciprocal scaled
 * mean free paths, and not on the imaginary axis from kappa upwards. For real k everything is
 * computed in real numbers. kappa: decay rate of diffuse light in the same unit, not negative. k
 * and kappa are not both 0. Returns false if memory runs out or the equation is singular. */
bool solver_layer_halfspace(const expansion *of, double complex k, double kappa,
                            layer_exitance *exitance);

/* v = S A u with u = I+ + I- and v = I+ - I-. A is symmetric, S has the signs of expansion.h on its
 * diagonal. Column n of A is for the beam, whose v is `beam` times its u. */
typedef struct layer_relation {
  dense all; /* [n][n + 1] */
  double beam;
} layer_relation;

/* What a layer does to light, for one wavenumber. Both faces are alike. */
typedef struct layer_operators {
  /* A + B and B - A: v = A u at a face if the same light strikes both, v = B u if it has opposite
   * signs. Of a half space, `sum` is its A, and `apart` is not set. */
  layer_relation sum, apart;
  /* Of light that is scattered at most once: what passes, with what a beam scatters on, [n + 1][n +
   * 1]; and what a beam scatters back, a column. Both with the signs of the formulas. */
  dense passed_once;
  dense reflected_once;
} layer_operators;

/* Sets the operators of a layer. depth: its thickness in scaled mean free paths, above 0; infinite
 * for a half space, for which k and kappa are as for solver_layer_halfspace(). *to: its matrices
 * have room, real if Im k is 0 and complex otherwise. Returns false if memory runs out, the
 * equation is singular, or `stop`, which may be NULL, is true. */
bool solver_layer_operators(layer_operators *to, const expansion *of, double complex k,
                            double kappa, double depth, const atomic_bool *stop);

/* Spare matrices of the functions below, each as large as a relation's. */
enum { LAYER_SPARE = 3 };

/* Sets to = x a + y b. All have one shape; `to` may be a or b. */
void solver_layer_combine(layer_relation *to, double x, const layer_relation *a, double y,
                          const layer_relation *b);

/* Sets to = g s^-1 g, which may be s but not g. Returns false if s is singular. */
bool solver_layer_weigh(const dense spare[LAYER_SPARE], layer_relation *to, const layer_relation *g,
                        const layer_relation *s);

/* Set *to, [n + 1][n + 1] with the beam's row and the signs of the formulas, to the reflectance of
 * what has a relation, and *to to the relation of what has a reflectance. Return false if an equation
 * is singular. */
bool solver_layer_reflect(const dense spare[LAYER_SPARE], const expansion *of, const dense *to,
                          const layer_relation *from);
bool solver_layer_relate(const dense spare[LAYER_SPARE], const expansion *of, layer_relation *to,
                         const dense *from);

/* Sets v[n + 1] from u[n + 1], with the beam and the signs of the formulas. */
void solver_layer_apply(const dense *v, const expansion *of, const layer_relation *relation,
                        const dense *u);

/* Sets to[n][2] to I- under a boundary of `of`: of the beam, whose u is 1, and of diffuse light.
 * Returns false if the equation is singular. */
bool solver_layer_light_up(const dense spare[LAYER_SPARE], const expansion *of, const dense *to,
                           const layer_relation *under, size_t boundary);

#endif
