/* gnuplot: pictures, drawn by the program of that name. */
#ifndef DIPOLE_CLI_GNUPLOT_H
#define DIPOLE_CLI_GNUPLOT_H

#include "clients/cli/cli.h"

/* Whether a picture can have this name; */
bool cli_gnuplot_draws(const char *path);

/* and says so when it cannot. */
bool cli_gnuplot_check(const cli_command *command, const char *path);

/* Writes what is to be drawn, after the lines that choose the picture's format. */
typedef void cli_gnuplot_script(FILE *script, const void *context);

/* Draws into a file whose name has been checked, width x height pixels; an exit status. */
int cli_gnuplot(const cli_command *command, const char *path, size_t width, size_t height,
                cli_gnuplot_script *write, const void *context);

/* Writes a text into a script, quoted. */
void cli_gnuplot_text(FILE *script, const char *text);

#endif
