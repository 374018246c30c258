/* write: what was measured, as files. */
#ifndef TRADEOFF_WRITE_H
#define TRADEOFF_WRITE_H

#include "core/tools/tradeoff/costs.h"
#include "core/tools/tradeoff/errors.h"

/* A row for each model, evaluator, ratio and eta of the paper's; empty where a medium is refused.
 * The columns: model, evaluator, ratio, eta, cost_ns, prepare_ns, and as in errors_row. */
void write_csv(const char *path, const errors_table *errors, const costs_of *costs);

/* core/tradeoff.def, which core/choose.c reads. */
void write_table(const char *path, const errors_table *errors, const costs_of *costs);

#endif
