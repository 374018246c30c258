/* options: reads a command line and prints --help, both from the command's lists of options. */
#ifndef DIPOLE_CLI_OPTIONS_H
#define DIPOLE_CLI_OPTIONS_H

#include "clients/cli/cli.h"

/* Reads the command line of the running command into *settings, which is zero at first. Returns
 * false if the command ends here; *status is then its exit status, which is 0 after --help. */
bool cli_options_read(int argc, char **argv, cli_settings *settings, int *status);

/* Returns the running command's option for a field of a request, such as --sigma-a for sigma_a or
 * --from for radius_start; NULL if there is none. */
const cli_option *cli_options_find(const char *field);

/* Returns the options and headings of a command, in the order of --help, with the names that they
 * have on a command line; NULL as a name ends the list, which is valid until another is made. */
const cli_option *cli_options_of(const cli_command *command);

/* Writes what the last word of a command line of `dipole` may become, each on a line, with what
 * --help says about commands and options behind a tab; nothing where it is the name of a file or a
 * number. It needs no daemon. Returns an exit status. */
int cli_complete(const char *line);

/* The known name that is the nearest to a name that is unknown: to suggest it.
 * Starts as {0}; its name is NULL as long as no known name is near enough. */
typedef struct cli_nearest {
  const char *name;
  unsigned distance; /* as of core_name_distance() */
} cli_nearest;

/* Compares a known name, which is near enough if it is at most `most` apart from `name`. */
void cli_nearest_try(cli_nearest *so_far, const char *name, const char *known, size_t most);

/* Writes what --help says to standard output. */
void cli_options_help(const cli_command *command);

/* Returns the value for a channel: an option has one value for all channels, or one for each.
 * Returns `otherwise` if the option is not given. */
double cli_numbers_pick(const cli_numbers *numbers, size_t channel, double otherwise);

/* Returns the numbers as an array of double, or of float. */
const void *cli_numbers_in(const cli_numbers *numbers, bool single);

/* Returns whether a list of names with commas between them has a name. */
bool cli_in_list(const char *list, const char *name);

/* Returns whether `text` is one of the texts. */
bool cli_texts_have(const cli_texts *texts, const char *text);

#endif
