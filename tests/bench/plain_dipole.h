/* plain_dipole: the dipoles as a simple scalar program computes them with the C library. The
 * benchmark compares the kernels' speed with it. */
#ifndef DIPOLED_BENCH_PLAIN_DIPOLE_H
#define DIPOLED_BENCH_PLAIN_DIPOLE_H

#include "core/core.h"

/* The constants of the formula. Lengths are in mm. */
typedef struct plain_dipole {
  double scale; /* p / (4 pi) */
  double mu_tr;
  double z1;
  double z2;
  double phi;  /* C_phi / D; 0 without the switch for exitance */
  double flux; /* C_E */
} plain_dipole;

plain_dipole plain_dipole_prepare(int switches, const core_medium *medium);

void plain_dipole_f64(const plain_dipole *dipole, size_t n, const double *r, double *R);
void plain_dipole_f32(const plain_dipole *dipole, size_t n, const float *r, float *R);

#endif
