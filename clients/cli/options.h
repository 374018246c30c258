/* options: reads a command line and prints --help, both from the command's lists of options. */
#ifndef DIPOLE_CLI_OPTIONS_H
#define DIPOLE_CLI_OPTIONS_H

#include "clients/cli/cli.h"

/* Reads the command line of the running command into *settings, which starts with a cli_common and
 * is zero at first. Returns false if the command is over; *status is then its exit status, 0 after
 * --help. */
bool cli_options_read(int argc, char **argv, void *settings, int *status);

/* Frees what the values hold. */
void cli_options_free(void *settings);

/* Returns the running command's option for a field of a request, such as --sigma-a for sigma_a or
 * --from for radius_start; NULL if there is none. */
const cli_option *cli_options_find(const char *field);

/* Writes what --help says to standard output. */
void cli_options_help(const cli_command *command);

/* Returns whether one of the texts is this one. */
bool cli_texts_have(const cli_texts *texts, const char *text);

#endif
