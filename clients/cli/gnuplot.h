/* gnuplot: runs the program of that name. */
#ifndef DIPOLE_CLI_GNUPLOT_H
#define DIPOLE_CLI_GNUPLOT_H

#include <stdio.h>

/* The name that stands for text on standard output. */
#define CLI_PICTURE_TERMINAL "-"

/* Runs gnuplot on a script, and copies what it draws into a file, which is written only once the
 * picture is whole, or for CLI_PICTURE_TERMINAL onto standard output. Says what is wrong and
 * returns an exit status. */
int cli_gnuplot(FILE *script, const char *path);

/* Writes a text into a script as a string. No text can end it: all ASCII characters but letters,
 * digits and blanks are written as octal numbers, and control characters become question marks.
 * Every text that a file or a daemon says goes into a script through this. */
void cli_gnuplot_quote(FILE *script, const char *text);

#endif
