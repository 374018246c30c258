/* image: images in files: PNG (libpng, lcms2 for colours) and the float map PFM (Debevec 1998). */
#ifndef DIPOLE_CLI_IMAGE_H
#define DIPOLE_CLI_IMAGE_H

#include "clients/cli/cli.h"

/* An image with 1 (grey) or 3 (red, green, blue) channels. */
typedef struct cli_image {
  size_t width, height; /* 1 to 65536 */
  size_t channels;
  float *values; /* [height][width][channels], the first row at the top; free() frees them */
} cli_image;

/* Reads a file: PNG or PFM, as its first bytes say. Says on standard error if an opacity is left
 * out. The values of a PNG are shares of the largest one; unless `linear`, they become linear light
 * of the primaries of sRGB, as the file says by a colour profile or gAMA, else from sRGB. Says what
 * is wrong and returns false if it cannot be read. */
bool cli_image_read(const char *file, bool linear, cli_image *of);

/* Writes a file: PFM, or a PNG of 16 bits with linear values, as its name says; in a PNG NaN is 0.
 * Says what is wrong and returns false if it cannot be written. */
bool cli_image_write(const char *file, const cli_image *of);

/* Writes it there as a PNG or a PFM, for cli_image_write(). Returns false after a message if that is not
 * possible; of a PFM, ferror(to) says so. */
bool cli_image_put(const char *name, FILE *to, bool png, const cli_image *of);

#endif
