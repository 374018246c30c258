/* gnuplot: runs the program of that name. */
#ifndef DIPOLE_CLI_GNUPLOT_H
#define DIPOLE_CLI_GNUPLOT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

enum { CLI_GNUPLOT_ERROR_BYTES = 1024 };

/* Returns whether cli_gnuplot() can draw into a file of this name: it ends in .svg or .png. */
bool cli_gnuplot_draws(const char *path);

/* Writes what is to be drawn. The lines that choose gnuplot's terminal stand before it. */
typedef void cli_gnuplot_script(FILE *script, const void *context);

/* Draws into a file of which cli_gnuplot_draws() is true, `width` times `height` pixels; the file
 * is written only once the picture is whole. Returns false when that fails; `error` then says why
 * and what to do. */
bool cli_gnuplot(const char *path, size_t width, size_t height, cli_gnuplot_script *write,
                 const void *context, char error[CLI_GNUPLOT_ERROR_BYTES]);

/* Draws as text onto a stream, `width` times `height` characters for each plot of the script. */
bool cli_gnuplot_text(FILE *to, bool coloured, size_t width, size_t height,
                      cli_gnuplot_script *write, const void *context,
                      char error[CLI_GNUPLOT_ERROR_BYTES]);

/* Writes a text into a script as a string. No text can end it: all ASCII characters but letters,
 * digits and blanks are written as octal numbers, and control characters become question marks.
 * Every text that a file or a daemon says goes into a script through this. */
void cli_gnuplot_quote(FILE *script, const char *text);

#endif
