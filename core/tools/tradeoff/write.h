/* write: writes the measured costs and errors to files. */
#ifndef TRADEOFF_WRITE_H
#define TRADEOFF_WRITE_H

#include "core/tools/tradeoff/costs.h"
#include "core/tools/tradeoff/errors.h"
#include "core/tools/tradeoff/similarity.h"

/* Writes a row for each model, evaluator, ratio and eta of the paper's; fields are empty if a
 * medium is refused. The columns are model, evaluator, ratio, eta, cost_ns, prepare_ns and those of
 * errors_row. */
void write_csv(const char *path, const errors_table *errors, const costs_of *costs);

/* Writes core/model_errors.def, which core/model_error.c includes. The table has errors->nodes. */
void write_errors(const char *path, const errors_table *errors,
                  similarity_node similarity[SIMILARITY_GS][SIMILARITY_RATIOS]);

/* Writes core/costs.def, which core/choose.c includes. The table has errors->rows. */
void write_costs(const char *path, const errors_table *errors, const costs_of *costs);

#endif
