/* readings: reads a CSV file of readings by column names, and groups them into samples. */
#ifndef DIPOLE_CLI_READINGS_H
#define DIPOLE_CLI_READINGS_H

#include "clients/cli/cli.h"

/* The readings of one medium: `count` of them from `first` on. */
typedef struct cli_sample {
  char *name;
  double g, eta, detector_na; /* NAN if the file does not say */
  size_t first, count;
} cli_sample;

typedef struct cli_readings {
  const char *source; /* name of the file, for messages */
  bool frequency;     /* the places are spatial frequencies */
  size_t sample_count;
  cli_sample *samples; /* in the order of their first lines */
  size_t count;
  /* [count], by samples and within them in the order of the file. A cell that is empty is NAN. */
  double *at, *values, *errors, *source_mm, *detector_mm;
  uint64_t *lines; /* of the file, from 1 on */
} cli_readings;

/* Reads a file; NULL or "-" stands for standard input. Says what is wrong and returns an exit
 * status. */
int cli_readings_read(const char *path, cli_readings *readings);

#endif
