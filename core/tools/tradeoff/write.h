/* write: what was measured, as files. */
#ifndef TRADEOFF_WRITE_H
#define TRADEOFF_WRITE_H

#include "core/tools/tradeoff/costs.h"
#include "core/tools/tradeoff/errors.h"
#include "core/tools/tradeoff/similarity.h"

/* A row for each model, evaluator, ratio and eta of the paper's; empty where a medium is refused.
 * The columns: model, evaluator, ratio, eta, cost_ns, prepare_ns, and as in errors_row. */
void write_csv(const char *path, const errors_table *errors, const costs_of *costs);

/* core/model_errors.def, which core/model_error.c reads; errors: of all nodes. */
void write_errors(const char *path, const errors_table *errors,
                  similarity_node similarity[SIMILARITY_GS][SIMILARITY_RATIOS]);

/* core/costs.def, which core/choose.c reads; errors: the rows. */
void write_costs(const char *path, const errors_table *errors, const costs_of *costs);

#endif
