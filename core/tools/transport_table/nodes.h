/* nodes: makes the list of media and radii for the table, and the table's bytes from their
 * solutions. */
#ifndef DIPOLED_TOOLS_NODES_H
#define DIPOLED_TOOLS_NODES_H

#include "core/tools/transport_table/samples.h"

enum { NODES_BELOW_1 = 24, NODES_FROM_1 = 32, NODES = NODES_BELOW_1 + NODES_FROM_1 };

/* Makes the samples at Chebyshev's points in all coordinates, one for each v on both sides. */
void nodes_make(const double *field, table_sample samples[NODES]);

/* Returns the table's bytes, malloc()ed. nodes_seal() sets the error and the checksum in them. */
uint8_t *nodes_encode(const double *field, const table_sample samples[NODES], size_t *length);

/* Writes the error and the checksum into a table's bytes. */
void nodes_seal(uint8_t *bytes, size_t length, double error);

#endif
