/* plot: draws what `dipole eval` and `dipole plot` have asked for. */
#ifndef DIPOLE_CLI_PLOT_H
#define DIPOLE_CLI_PLOT_H

#include "clients/cli/eval.h"

/* Draws R over r, which is one of the report's quantities, into the files; on a logarithmic axis if
 * the ratios between radii are equal. Says what is wrong and returns an exit status. */
int cli_plot_R(const cli_eval_report *report, const cli_texts *paths);

#endif
