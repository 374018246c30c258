/* decimal: reads decimal numbers strictly, and writes numbers as the shortest decimals that read
 * back to the same bits, for texts such as CSV and JSON. */
#ifndef DIPOLED_PROTO_DECIMAL_H
#define DIPOLED_PROTO_DECIMAL_H

#include <stdbool.h>
#include <stddef.h>

enum { DECIMAL_BYTES = 40 }; /* more than the longest text, which has 24 bytes */

/* Writes the shortest decimal that reads back to the value, and of the shortest ones the nearest:
 * 0.032, 1e-9, 123000, -0. Infinities are "inf" and "-inf"; a NaN is "nan". Returns the length; a
 * zero byte follows.
 *
 * Source: Giulietti 2020, "The Schubfach way to render doubles", Section 9 and Figure 7. */
size_t decimal_write(double value, char text[DECIMAL_BYTES]);

/* The same for the shortest decimal that reads back to the same float: 0.1 for 0.1f. */
size_t decimal_write_single(float value, char text[DECIMAL_BYTES]);

/* Reads a whole text as a decimal number, inf, infinity or nan, in the notation of the C locale. No
 * spaces, no hexadecimal. Returns false also when the number is finite but beyond the range of
 * doubles. */
bool decimal_read(const char *text, double *value);

/* Returns whether a digit follows a 0 at the start. In a list this is half of a number with a decimal
 * comma: 0,05 is not meant as 0 and 5. */
bool decimal_starts_with_zero(const char *text);

#endif
