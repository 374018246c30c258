/* stack: light in layers at one wavenumber. See stack.c for the formulas. Lengths are in any unit, and
 * k, rates and indices are those of the caller. */
#ifndef DIPOLED_CORE_SOLVER_STACK_H
#define DIPOLED_CORE_SOLVER_STACK_H

#include <complex.h>
#include <stdatomic.h>
#include <stdbool.h>

#include "core/solver/level.h"

enum { STACK_REFLECTIONS_MAX = 24 };

/* One layer after its phase function has been truncated. */
typedef struct stack_layer {
  expansion_medium medium;
  double extinction; /* scaled extinction coefficient, of the beam and of scattered light */
  double sigma_s, g; /* of the true phase function, without truncation */
  double thickness;  /* infinite for a half space, which is then the last layer */
  double index;      /* refractive index over that above the stack */
  double kappa;      /* for a half space: decay rate of diffuse light */
} stack_layer;

typedef struct stack stack;

/* Returns the integrals for a stack, or NULL if memory runs out or `stop` is true, which is NULL or
 * kept, as any thread may set it. The caller frees them with solver_stack_free(), which accepts NULL.
 * layers: 1 to SOLVER_LAYERS_MAX, kept as they are until then. below: the index below over that
 * above. */
stack *solver_stack_new(const core_isa *isa, const expansion_rules *rules,
                        const stack_layer *layers, size_t count, double below,
                        const atomic_bool *stop);
void solver_stack_free(stack *of);

/* Returns the sum of the cubes of the layers' numbers of functions: a wavenumber takes as long. */
double solver_stack_cost(const expansion_rules *rules, const stack_layer *layers, size_t count,
                         double below);

/* What leaves a stack, Fourier transformed over the plane, per power that has entered. */
typedef struct stack_exitance {
  /* Above and below. all: light that was scattered; once: that part of it that was scattered once,
   * and reflected inside at most `reflections` times; beam: light that was not scattered. */
  double complex all[2], once[2], beam[2];
  /* Net downward flux at the upper and the lower face of each layer. Over a half space it is known for
   * k = 0 alone. */
  double complex net[SOLVER_LAYERS_MAX][2];
} stack_exitance;

/* Sets *exitance at one wavenumber k, which is not 0 if the last layer is a half space without
 * absorption. Returns false if memory runs out, an equation is singular or the caller stops. */
bool solver_stack_at(const stack *of, double complex k, unsigned reflections,
                     stack_exitance *exitance);

/* Sets *exitance to the light that leaves, scattered more than once, a half space of the medium of
 * layer `i`, whose index is that of the first one. k: not 0. Returns false as above. */
bool solver_stack_halfspace(const stack *of, size_t i, double complex k, double complex *exitance);

#endif
