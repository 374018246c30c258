/* gnuplot: turns a script into a picture. */
#ifndef FIGURES_GNUPLOT_H
#define FIGURES_GNUPLOT_H

#include <stdio.h>

/* Runs gnuplot on a script, a file that has been written and is still open (it is closed), and
 * puts what gnuplot prints under this path once it is whole. Ends the program when gnuplot is
 * missing or fails. */
void gnuplot_draw(FILE *script, const char *path);

/* Ends the program when there is no gnuplot to run: to be asked before long work. */
void gnuplot_require(void);

#endif
