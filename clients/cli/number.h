/* number: reads decimal numbers strictly, and writes them so that no digit is lost. */
#ifndef DIPOLE_CLI_NUMBER_H
#define DIPOLE_CLI_NUMBER_H

#include <stdbool.h>
#include <stdint.h>

#include "proto/decimal.h"

/* Room for any number that cli_number_format() writes. */
#define CLI_NUMBER_BYTES DECIMAL_BYTES

/* Reads a whole text as a decimal number, inf or nan, in the notation of the C locale. No spaces,
 * no hexadecimal. False also when the number is finite but beyond the range of doubles. */
bool cli_number_parse(const char *text, double *value);

/* Reads a whole text of decimal digits. */
bool cli_count_parse(const char *text, uint64_t *value);

/* Writes the fewest digits that read back to the same double, in plain or scientific notation,
 * whichever is shorter. Returns text. */
const char *cli_number_format(double value, char text[CLI_NUMBER_BYTES]);

/* Returns the decimal number with the fewest digits that reads back to the same float: 0.1 for
 * 0.1f. Infinities and NaN stay. */
double cli_number_of_single(float value);

/* Returns the nearest decimal number of 15 digits: 0.943 for 0.9430000000000001. Infinities and NaN
 * stay. */
double cli_number_rounded(double value);

#endif
