/* picture_script: a picture as a script for gnuplot. */
#ifndef DIPOLE_CLI_PICTURE_SCRIPT_H
#define DIPOLE_CLI_PICTURE_SCRIPT_H

#include "clients/cli/picture.h"

/* terminal: of gnuplot, with %zu twice for width and height in pixels. */
void picture_write_script(const cli_picture *picture, const char *terminal, FILE *script);

#endif
