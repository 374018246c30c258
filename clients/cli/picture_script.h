/* picture_script: a picture as a script for gnuplot. */
#ifndef DIPOLE_CLI_PICTURE_SCRIPT_H
#define DIPOLE_CLI_PICTURE_SCRIPT_H

#include "clients/cli/picture.h"

/* In pixels. */
void picture_size(const cli_picture *picture, size_t *width, size_t *height);

/* A cli_gnuplot_script; the context is a cli_picture. */
void picture_write_script(FILE *script, const void *context);

#endif
