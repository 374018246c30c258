/* reference: the dipole family with many digits, from the formulas of d'Eon 2012, Table 2, as the
 * paper gives them. No form is chosen for the digits that it keeps; where terms cancel, there are
 * more bits instead. Tests measure the kernels against it. */
#ifndef DIPOLED_TESTS_REFERENCE_H
#define DIPOLED_TESTS_REFERENCE_H

#include <mpfr.h>

#include "core/kernels.h"
#include "tests/accuracy/reference_fresnel.h"

/* The paper's quantities for one medium; lengths in mm. Read mu_tr_per_mm, z1_mm and albedo. */
typedef struct reference_dipole {
  bool scatters;       /* if false, R, albedo, cdf and pdf are 0 */
  mpfr_t prefactor;    /* alpha' or alpha'^2 */
  mpfr_t diffusion_mm; /* D */
  mpfr_t mu_tr_per_mm;
  mpfr_t z1_mm; /* the depth of the source */
  mpfr_t z2_mm; /* the height of the source's mirror image */
  mpfr_t c_phi;
  mpfr_t c_flux; /* C_E */
  mpfr_t albedo;
} reference_dipole;

/* switches: a sum of enum core_dipole_switch. Any medium of positive sigma_t' will do. Prepare once
 * after init, as often as wanted; clear at last. */
void reference_dipole_init(reference_dipole *dipole);
void reference_dipole_prepare(reference_dipole *dipole, int switches, enum core_moments moments,
                              const core_medium *medium);
void reference_dipole_clear(reference_dipole *dipole);

/* The elementwise quantities at one radius, by their position in the list. */
typedef struct reference_values {
  mpfr_t of[CORE_ELEMENTWISE_COUNT];
} reference_values;

void reference_values_init(reference_values *values);
void reference_values_clear(reference_values *values);

/* Computes all quantities at r mm, which may be infinite. Their relative errors are below 1e-33,
 * and so is the absolute error of ln R. ln R is -infinity only where R is 0. */
void reference_dipole_evaluate(const reference_dipole *dipole, double r_mm,
                               reference_values *values);

/* Returns 1 + mu_tr d_r, the condition number of e^(-mu_tr d_r). */
double reference_dipole_condition(const reference_dipole *dipole, double r_mm);

/* Returns the switches of a model of the dipole family, or -1 for a model of another family. */
int reference_switches(unsigned model);

#endif
