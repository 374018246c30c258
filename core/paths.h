/* paths: how long light travels in a medium, and modulated light.
 *
 * Each path of light that leaves at r has lost e^(-sigma_a l) over its length l in the medium, so
 * that the mean of l is -d ln R / d sigma_a; with the sigma_a of one layer, it is the mean length
 * within that layer. The differential path length factor is it over r (Delpy et al. 1988, "Estimation of
 * optical pathlength through tissue from direct time of flight measurement").
 *
 * Light whose power is modulated with the angular frequency omega lags by omega n l / c after the
 * path l. So its phase and amplitude are those of R at the complex absorption sigma_a + i omega n / c,
 * with sigma_s unchanged. R is continued to there from real absorptions sigma_a + s. As a function of
 * s it is the Laplace transform of the time of flight, whose singularities are real and at most
 * -sigma_a of the layer that absorbs least; they are on the imaginary axis of u = sqrt(sigma_a + s).
 * R falls about as e^(-kappa r), kappa in proportion to u. Hence R e^(-b u) is interpolated between
 * Chebyshev's nodes in u, with b from the first and the last of them, by a polynomial, which is
 * evaluated at the complex u. Against the classical dipole in closed form R is within 1e-6 at 100
 * MHz in tissue, relative, and within 1e-3 at 1 GHz (tests/accuracy/test_paths.c).
 */
#ifndef DIPOLED_CORE_PATHS_H
#define DIPOLED_CORE_PATHS_H

#include <complex.h>

#include "core/core.h"

#define CORE_LIGHT_SPEED_MM_PER_PS 0.299792458

enum { CORE_MODULATION_NODES_MAX = 9 };

/* Real absorptions u^2 at which R is known. */
typedef struct core_nodes {
  unsigned count;
  double u[CORE_MODULATION_NODES_MAX]; /* descending */
} core_nodes;

/* What a profile of modulated light owns. Its medium is at u = here, its complex absorption at
 * u = there. */
typedef struct core_modulation {
  core_nodes nodes; /* count 0: the frequency is 0, or no node is needed */
  double here;
  double complex there;
  core_profile node[CORE_MODULATION_NODES_MAX]; /* owned, of evaluator f64 */
} core_modulation;

/* How R is continued to u: the weight of each node's value; for the last two terms of the Chebyshev
 * series, each node's share in the coefficient, and the polynomial at u. */
typedef struct core_continuation {
  double complex u, weight[CORE_MODULATION_NODES_MAX], polynomial[2];
  double share[2][CORE_MODULATION_NODES_MAX];
} core_continuation;

/* ln R at u; is_known: whether R is no difference of much larger numbers. A change of ln R by d at
 * node j changes it by weight[j] relative[j] d, or of any logarithm of an analytic function. */
typedef struct core_continued {
  bool is_known;
  double complex ln_R, relative[CORE_MODULATION_NODES_MAX];
} core_continued;

/* Returns sqrt(sigma_a + i wavenumber), the u of light with wavenumber = omega n / c. */
double complex core_modulated_u(double sigma_a_per_mm, double wavenumber_per_mm);

/* Returns nodes for u and for what is nearer to the real axis. few: takes few nodes, far apart, which
 * multiply the errors of R at the nodes less. least: of all nodes. */
core_nodes core_nodes_around(bool few, double least, double complex u);

core_continuation core_continue_to(const core_nodes *nodes, double complex u);

/* ln_R: that at node j is ln_R[j * stride]. */
void core_continue(const core_nodes *nodes, const core_continuation to[2], const double *ln_R,
                   size_t stride, core_continued at[2]);

/* Returns the error of the angle of R at u[0], or of ln |R| there; if u[1] is not NULL less ln R
 * there. at: what is continued to the two; error[j]: that of ln R at node j. */
double core_continued_error(const core_nodes *nodes, bool is_angle,
                            const core_continuation *const u[2], const core_continued at[2],
                            const double *error);

/* Replaces derivatives of ln R by ln sigma_a at n radii by PATH, DPF or TIME. */
void core_paths_make(const core_profile *profile, enum core_quantity quantity, size_t n,
                     const double *r, double *values);

/* Evaluates PHASE or MODULATION at n radii, PHASE_F or MODULATION_F at n frequencies. */
void core_modulation_eval(const core_profile *profile, enum core_quantity quantity, size_t n,
                          const double *r, double *out);

/* Returns the absolute error of one of these seven quantities at radii, or frequencies, from least to
 * most.
 * derivative: the errors of BY_SIGMA_A there. */
core_stated_errors core_paths_errors(const core_profile *profile, enum core_quantity quantity,
                                     core_stated_errors derivative, core_radii_range radii);

#endif
