/* picture_text: a picture as characters. */
#ifndef DIPOLE_CLI_PICTURE_TEXT_H
#define DIPOLE_CLI_PICTURE_TEXT_H

#include "clients/cli/picture.h"

/* Panel below panel, each as large as the terminal, then the legend. With colours where standard
 * output is a terminal that may have them. */
void picture_write_text(const cli_picture *picture, FILE *file);

#endif
