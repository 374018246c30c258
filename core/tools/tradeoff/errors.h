/* errors: measures the errors of models against transport, |R / R_transport - 1|, at the nodes. */
#ifndef TRADEOFF_ERRORS_H
#define TRADEOFF_ERRORS_H

#include "core/tools/tools.h"
#include "core/tools/tradeoff/nodes.h"
#include "core/tools/tradeoff/subjects.h"

/* The errors of one model at one node, in double precision; infinite if it refuses the medium. */
typedef struct errors_node {
  double worst[NODES_BANDS]; /* the largest in each band of radii */
  double albedo;
} errors_node;

/* The errors of one subject at one node of the paper's; NaN if it could not be prepared. */
typedef struct errors_row {
  double worst;     /* largest over all radii */
  double median;    /* median over all radii */
  double worst_far; /* largest over the radii from ERRORS_FAR on */
  double albedo;
  double numerical; /* numerical error that the profile states for the largest radius */
} errors_row;

#define ERRORS_FAR 1.0    /* a radius in mean free paths */
#define ERRORS_LEAST 1e-7 /* transport's own tolerance; smaller errors cannot be measured */

typedef struct errors_table {
  const subjects *of;
  errors_node *nodes; /* [eta][ratio][model]; NULL if not measured */
  errors_row *rows;   /* [eta][ratio][subject], the paper's nodes; NULL if not measured */
} errors_table;

/* ERRORS_NODES fills in errors_table.nodes for all nodes, ERRORS_ROWS fills in errors_table.rows.
 */
enum errors_what { ERRORS_NODES, ERRORS_ROWS };

/* The work that errors_measure() adds to the progress. */
double errors_cost_us(enum errors_what what);

/* Solves transport at the nodes and compares the models with it. Free the table with errors_free().
 */
void errors_measure(errors_table *table, const subjects *of, enum errors_what what, size_t threads,
                    tools_progress *progress);
void errors_free(errors_table *table);

/* eta, ratio: positions among all nodes; model: position in subjects.models. */
errors_node *errors_at_node(const errors_table *table, size_t eta, size_t ratio, size_t model);

/* eta, ratio: positions among the paper's nodes; s: position in subjects.all. */
errors_row *errors_at_row(const errors_table *table, size_t eta, size_t ratio, size_t s);

#endif
