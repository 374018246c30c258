/* nodes: makes the list of media and radii for the table, and the table's bytes from their
 * solutions. */
#ifndef DIPOLED_TOOLS_NODES_H
#define DIPOLED_TOOLS_NODES_H

#include "core/tools/transport_table/samples.h"

enum {
  /* samples of isotropic scattering: one for each eta */
  NODES_BELOW_1 = 24,
  NODES_FROM_1 = 32,
  NODES = NODES_BELOW_1 + NODES_FROM_1,
  /* samples of the difference D: one for each g, of which 0 needs none, and each albedo */
  NODES_D_G = 9,
  NODES_D_G_ZERO = 5, /* the point of g that is 0 */
  NODES_D_U = 14,
  NODES_D = (NODES_D_G - 1) * NODES_D_U
};

/* Makes the samples at Chebyshev's points in all coordinates. */
void nodes_make(const double *field, table_sample samples[NODES]);
void nodes_make_difference(const double *field, table_sample samples[NODES_D]);

/* Returns the albedo of point i of NODES_D_U, or of the middle of two points for i + 0.5. */
double nodes_albedo(const double *field, double i);

/* A table's bytes, which the caller frees. */
typedef struct table_bytes {
  uint8_t *bytes;
  size_t length;
} table_bytes;

/* Makes a table with the part for isotropic scattering. In it, D is 0. */
table_bytes nodes_encode(const double *field, const table_sample samples[NODES]);

/* Replaces D. Solves for the totals. */
void nodes_encode_difference(table_bytes *table, const table_sample samples[NODES_D]);

/* Writes the fields and the checksum into a table's bytes. */
void nodes_seal(table_bytes table, const double *field);

#endif
