/* nodes: makes the list of media and radii for the table, and the table's bytes from their
 * solutions. */
#ifndef DIPOLED_TOOLS_NODES_H
#define DIPOLED_TOOLS_NODES_H

#include <stdbool.h>

#include "core/tools/transport_table/samples.h"
#include "core/transport/table.h"

enum {
  /* samples of isotropic scattering: one for each eta */
  NODES_BELOW_1 = 24,
  NODES_FROM_1 = 32,
  NODES = NODES_BELOW_1 + NODES_FROM_1,
  /* samples of the difference D: one for each g, of which 0 needs none, and each albedo */
  NODES_D_G = 19,
  NODES_D_G_ZERO = 11, /* index of the point of g that is 0; points of g above 0 precede it */
  NODES_D_U = 29,
  NODES_D = (NODES_D_G - 1) * NODES_D_U
};

/* Makes the samples at Chebyshev's points in all coordinates. */
void nodes_make(const double *field, table_sample samples[NODES]);
void nodes_make_difference(const double *field, table_sample samples[NODES_D]);

/* Returns the albedo whose u is the middle between points i and i + 1 of NODES_D_U. */
double nodes_albedo_between(const double *field, size_t i);

/* A table's bytes, which the caller frees. */
typedef struct table_bytes {
  uint8_t *bytes;
  size_t length;
  size_t isotropic; /* the length without the part for g other than 0 */
} table_bytes;

/* Makes a table with the part for isotropic scattering; D is 0. */
table_bytes nodes_encode(const double *field, const table_sample samples[NODES]);

/* Adds the table's part for g other than 0, D, and the totals of these media, for which it solves
 * them. */
void nodes_encode_difference(table_bytes *table, const table_sample samples[NODES_D]);

/* Writes the fields and the checksum into a table's bytes. */
void nodes_seal(table_bytes table, const double *field);

#endif
