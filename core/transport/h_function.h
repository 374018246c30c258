/* h_function: the H function, by which the half space without a boundary is solved exactly.
 *
 * A source e^(-pz) in a half space of isotropic scatterers, index-matched, gives a source function
 * S with int_0^inf e^(-qz) S(z) dz = H(p) H(q) / (p + q) (Chandrasekhar 1950 for k = 0; Rybicki
 * 1971 for searchlights).
 */
#ifndef DIPOLED_CORE_TRANSPORT_H_FUNCTION_H
#define DIPOLED_CORE_TRANSPORT_H_FUNCTION_H

#include <complex.h>
#include <stddef.h>

/* A rule for ln H at one albedo and wavenumber. */
typedef struct h_function h_function;

/* Rules are reused, so that an equation solved again and again allocates nothing. NULL: no memory.
 */
h_function *transport_h_new(void);
void transport_h_free(h_function *of);

/* Sets the rule up: albedo in (0, 1], its kappa, k as transport_nodes_make() takes it with
 * k^2 + kappa^2 not 0, decay rates up to p_max, accuracy 1e-14 to 1e-2. */
void transport_h_set(h_function *to, double albedo, double kappa, double complex k, double p_max,
                     double accuracy);

/* ln H(p[i]) to log_h[i], n of each; decay rates as transport_nodes_make() makes them, or 1. The
 * arrays do not overlap. */
void transport_h_log(const h_function *of, size_t n, const double complex *p,
                     double complex *log_h);

#endif
