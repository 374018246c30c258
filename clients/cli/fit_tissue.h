/* fit_tissue: the part of `dipole fit` that finds what a tissue is made of. */
#ifndef DIPOLE_CLI_FIT_TISSUE_H
#define DIPOLE_CLI_FIT_TISSUE_H

#include "clients/cli/cli.h"

/* Check and run the command with --unknown. Both return an exit status. */
int cli_fit_tissue_check(const cli_settings *settings);
int cli_fit_tissue_run(const cli_settings *settings, dipole_client *client);

/* The most readings that are said to be wrong. */
enum { CLI_FIT_REPORTED_MAX = 10 };

/* Says that the reading in a line, or its error, is wrong. */
void cli_fit_report_reading(const char *sample, uint64_t line, bool is_error);

/* Returns the name of a fit's status. */
const char *cli_fit_status(const dipole_info *info, unsigned id);

#endif
