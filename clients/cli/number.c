#include "clients/cli/number.h"

#include <errno.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- reading --------------------------------------------------------------------------------- */

bool cli_number_parse(const char *text, double *value) {
  return decimal_read(text, value);
}

bool cli_count_parse(const char *text, uint64_t *value) {
  errno = 0;
  *value = strtoull(text, NULL, 10);
  return text[0] != '\0' && text[strspn(text, "0123456789")] == '\0' && errno == 0;
}

/* ---- writing --------------------------------------------------------------------------------- */

const char *cli_number_format(double value, char text[CLI_NUMBER_BYTES]) {
  decimal_write(value, text);
  return text;
}

double cli_number_of_single(float value) {
  char text[CLI_NUMBER_BYTES];
  double found = (double)value;
  decimal_write_single(value, text);
  return decimal_read(text, &found) ? found : (double)value;
}

double cli_number_rounded(double value) {
  char text[CLI_NUMBER_BYTES];
  snprintf(text, sizeof text, "%.*e", DBL_DIG - 1, value);
  const double rounded = strtod(text, NULL);
  return isfinite(rounded) ? rounded : value;
}
