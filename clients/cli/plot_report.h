/* plot_report: the picture of what `dipole eval` and `dipole plot` get. */
#ifndef DIPOLE_CLI_PLOT_REPORT_H
#define DIPOLE_CLI_PLOT_REPORT_H

#include "clients/cli/eval_report.h"
#include "clients/cli/picture.h"

/* Returns the axes of this name; NULL if there are none. */
const cli_axes *cli_axes_find(const char *name);

/* Adds a row of panels with the quantity at a position of the report; behind it are the standard
 * errors of the model `mc`. The label "" stands for the quantity's name and unit. */
void cli_plot_row(cli_picture *picture, const cli_eval_report *report, cli_row row,
                  size_t quantity);

/* Names what was evaluated, and draws. */
int cli_plot_report(cli_picture *picture, const cli_eval_report *report, const cli_texts *paths);

/* Draws R, on logarithmic axes if the radii are in equal ratios, else over a linear one. The report
 * must have R. */
int cli_plot_R(const cli_eval_report *report, const cli_texts *paths);

#endif
