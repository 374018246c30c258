/* cloud: files of points: CSV, and binary PLY (little-endian). */
#ifndef DIPOLE_CLI_CLOUD_H
#define DIPOLE_CLI_CLOUD_H

#include <stdbool.h>
#include <stdint.h>

typedef struct cli_cloud {
  const char *file;
  uint64_t count;
  uint32_t channels; /* powers of each point; 0 if none are wanted */
  double *xyz_mm;    /* [count][3] */
  float *power_W;    /* [count][channels] */
  uint64_t *lines;   /* [count] of a CSV file; else NULL */
} cli_cloud;

enum { CLI_CLOUD_CHANNELS_MAX = 8 };

/* Returns whether a name ends with .ply. */
bool cli_cloud_is_ply(const char *file);

/* Reads a file whose columns, or properties of vertices, are x, y and z, and if powers are wanted
 * power_1, power_2 and so on, or power alone; others are passed over. If something is wrong, says
 * what and where, and returns false. Free *cloud in any case. */
bool cli_cloud_read(const char *file, bool with_power, cli_cloud *cloud);
void cli_cloud_free(cli_cloud *cloud);

/* Writes sums M[count][channels] at the positions of a cloud, as CSV with columns M_1, M_2 and so
 * on, or as PLY with properties of the same names and colours red, green and blue (sRGB; the largest
 * sum is white) if the name ends with .ply. file: NULL for standard output. If it fails, says why
 * and returns false. */
bool cli_cloud_write(const char *file, const cli_cloud *at, uint32_t channels, const double *M);

/* Writes where point i stands, as "FILE:LINE: " or "FILE: vertex I: ". */
void cli_cloud_place(const cli_cloud *cloud, uint64_t i, char *text, uint64_t bytes);

#endif
