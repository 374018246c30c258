/* picture_file: a picture as a file, drawn by gnuplot. */
#ifndef DIPOLE_CLI_PICTURE_FILE_H
#define DIPOLE_CLI_PICTURE_FILE_H

#include "clients/cli/picture.h"

/* Whether a file of this name can hold a picture. */
bool picture_file_is_one(const char *path);

/* Says what is wrong; an exit status. A file of this name that is there already is replaced only
 * by a whole picture. */
int picture_file_draw(const cli_command *command, const cli_picture *picture, const char *path);

#endif
