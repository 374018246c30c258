/* image: reads and writes pictures whose values are numbers: PNG (libpng, and lcms2 for its colours) and the portable float
 * map PFM (Debevec 1998). */
#ifndef DIPOLE_CLI_IMAGE_H
#define DIPOLE_CLI_IMAGE_H

#include <stdbool.h>
#include <stddef.h>

enum { CLI_IMAGE_SIDE_MAX = 65536 };

/* An image with 1 (grey) or 3 (red, green, blue) channels. */
typedef struct cli_image {
  size_t width, height; /* 1 to CLI_IMAGE_SIDE_MAX */
  size_t channels;
  float *values; /* [height][width][channels], the first row at the top */
} cli_image;

/* Reads a file: PNG or PFM, as its first bytes say. Says on standard error if an opacity is left
 * out. The values of a PNG are shares of the largest one; unless `linear`, they become linear light of
 * the primaries of sRGB, as the file says by a colour profile or gAMA, else from sRGB. Says what is wrong and returns
 * false if it cannot be read. The caller frees image->values with free(). */
bool cli_image_read(const char *file, bool linear, cli_image *image);

/* Returns whether the name of a file ends as that of a format that can be written. shares: whether
 * all values are from 0 to 1, as those of a PNG have to be. */
bool cli_image_can_write(const char *file, bool shares);

/* Writes a file: PFM, or a PNG of 16 bits with linear values, as its name says; in a PNG NaN is 0.
 * Says what is wrong and returns false if it cannot be written. */
bool cli_image_write(const char *file, const cli_image *image);

#endif
