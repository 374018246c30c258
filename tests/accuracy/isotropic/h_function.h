/* h_function: the H function, which solves the half space without a boundary exactly.
 *
 * Take an index-matched half space of isotropic scatterers. A source e^(-pz) in it gives a source
 * function S with int_0^inf e^(-qz) S(z) dz = H(p) H(q) / (p + q) (Chandrasekhar 1950 for k = 0;
 * Rybicki 1971 for searchlights).
 */
#ifndef DIPOLED_TESTS_ISOTROPIC_H_FUNCTION_H
#define DIPOLED_TESTS_ISOTROPIC_H_FUNCTION_H

#include <complex.h>
#include <stddef.h>

/* A rule for ln H at one albedo and wavenumber. */
typedef struct h_function h_function;

/* Returns a rule to be set up by isotropic_h_set(), or NULL if memory runs out. One rule can be set
 * up again and again without further allocation. The caller frees it with isotropic_h_free(), which
 * accepts NULL. */
h_function *isotropic_h_new(void);
void isotropic_h_free(h_function *of);

/* Sets the rule up. albedo: in (0, 1]; kappa: transport_kappa(albedo); k: a wavenumber as
 * isotropic_nodes_make() accepts it, with k^2 + kappa^2 not 0; p_max: the largest modulus of a
 * decay rate that isotropic_h_log() will get; accuracy: 1e-14 to 1e-2, of ln H. */
void isotropic_h_set(h_function *to, double albedo, double kappa, double complex k, double p_max,
                     double accuracy);

/* Sets log_h[i] to ln H(p[i]) for n decay rates p, which are those that isotropic_nodes_make()
 * makes, or 1. Both arrays have n elements and do not overlap. */
void isotropic_h_log(const h_function *of, size_t n, const double complex *p,
                     double complex *log_h);

#endif
