/* errors: how far models are from radiative transport, |R / R_transport - 1|, at the nodes. */
#ifndef TRADEOFF_ERRORS_H
#define TRADEOFF_ERRORS_H

#include "core/tools/tools.h"
#include "core/tools/tradeoff/nodes.h"
#include "core/tools/tradeoff/subjects.h"

/* One model at one node, in double precision; infinity where it refuses the medium. */
typedef struct errors_node {
  double worst[NODES_BANDS]; /* in each band of radii */
  double albedo;
} errors_node;

/* One subject at one node of the paper's; NaN where it could not be prepared. */
typedef struct errors_row {
  double worst; /* over all radii */
  double median;
  double worst_far; /* over the radii from ERRORS_FAR on */
  double albedo;
  double numerical; /* what the profile states, at the largest radius */
} errors_row;

#define ERRORS_FAR 1.0    /* mean free paths */
#define ERRORS_LEAST 1e-7 /* the tolerance of transport: smaller errors are not known */

typedef struct errors_table {
  const subjects *of;
  errors_node *nodes; /* [eta][ratio][model]; NULL: not measured */
  errors_row *rows;   /* [eta][ratio][subject], of the paper's; NULL: not measured */
} errors_table;

/* What is measured: all nodes, or the rows of the paper's nodes. */
enum errors_what { ERRORS_NODES, ERRORS_ROWS };

/* What errors_measure() adds to the progress. */
double errors_cost_us(enum errors_what what);

/* Solves transport at the nodes, by so many threads, and compares. To be freed with errors_free(). */
void errors_measure(errors_table *table, const subjects *of, enum errors_what what, size_t threads,
                    tools_progress *progress);
void errors_free(errors_table *table);

errors_node *errors_at_node(const errors_table *table, size_t eta, size_t ratio, size_t model);

/* eta, ratio: positions among the paper's; s: of the subject. */
errors_row *errors_at_row(const errors_table *table, size_t eta, size_t ratio, size_t s);

#endif
