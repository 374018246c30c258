/* complete: what may stand next in a command line, for the shells. */
#ifndef DIPOLE_CLI_COMPLETE_H
#define DIPOLE_CLI_COMPLETE_H

/* Writes what the last word of a command line of `dipole` may become, each on a line, with what
 * --help says about commands and options behind a tab; nothing where it is the name of a file or a
 * number. It asks no daemon. Returns an exit status. */
int cli_complete(const char *line);

#endif
