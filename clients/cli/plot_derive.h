/* plot_derive: quantities that `dipole plot` makes of others, added to a report of
 * `dipole eval` so that they are drawn and written as all are. */
#ifndef DIPOLE_CLI_PLOT_DERIVE_H
#define DIPOLE_CLI_PLOT_DERIVE_H

#include "clients/cli/eval.h"

/* What a derived quantity is called; lives as long as the report that it is added to. */
typedef struct plot_derived {
  dipole_choice choice; /* with an id that no quantity has */
  char name[64], about[96];
} plot_derived;

/* The power 1 / gamma of the quantity at a position (gamma above 0); NaN where it is negative.
 * Returns the position of what was added. */
size_t plot_add_gamma(cli_eval_report *report, size_t quantity, double gamma,
                      plot_derived *derived);

/* How far the quantity of each model is from that of a model of the report, relative to the
 * latter; NaN where that is 0 or either is infinite. Likewise. */
size_t plot_add_deviation(cli_eval_report *report, size_t quantity, size_t reference,
                          plot_derived *derived);

#endif
