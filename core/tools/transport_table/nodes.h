/* nodes: the media and radii that the table is made from, and the table's bytes from them. */
#ifndef DIPOLED_TOOLS_NODES_H
#define DIPOLED_TOOLS_NODES_H

#include "core/tools/transport_table/samples.h"

enum { NODES_BELOW_1 = 24, NODES_FROM_1 = 32, NODES = NODES_BELOW_1 + NODES_FROM_1 };

/* Chebyshev's points in all coordinates: a sample for each v of both sides. */
void nodes_make(const double *field, table_sample samples[NODES]);

/* The table's bytes, malloc(), without its error and its checksum: nodes_seal() sets them. */
uint8_t *nodes_encode(const double *field, const table_sample samples[NODES], size_t *length);

/* Puts the error and the checksum into a table's bytes. */
void nodes_seal(uint8_t *bytes, size_t length, double error);

#endif
