#include "clients/cli/number.h"

#include <errno.h>
#include <fenv.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* ---- reading --------------------------------------------------------------------------------- */

bool cli_number_parse(const char *text, double *value) {
  const char *bare = text + (*text == '+' || *text == '-');
  const bool named = strcasecmp(bare, "inf") == 0 || strcasecmp(bare, "infinity") == 0 ||
                     strcasecmp(bare, "nan") == 0;
  char *end;
  if (!named && text[strspn(text, "0123456789.eE+-")] != '\0') {
    return false; /* strtod() would take spaces and hexadecimal digits, too */
  }
  *value = strtod(text, &end);
  return end > text && *end == '\0' && (named || isfinite(*value));
}

bool cli_count_parse(const char *text, uint64_t *value) {
  errno = 0;
  *value = strtoull(text, NULL, 10);
  return text[0] != '\0' && text[strspn(text, "0123456789")] == '\0' && errno == 0;
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Writes `count` digits of a value in scientific notation. Returns whether they read back to it. */
static bool write_digits(double value, int count, int rounding, char text[CLI_NUMBER_BYTES]) {
  fesetround(rounding);
  snprintf(text, CLI_NUMBER_BYTES, "%.*e", count - 1, value);
  fesetround(FE_TONEAREST);
  return strtod(text, NULL) == value;
}

/* Writes the shortest decimal that reads back to a positive and finite value, and of the shortest
 * ones the nearest. Below a power of two, doubles lie twice as close as above it. So there the
 * nearest decimal may belong to another double while the next above it belongs to this one. */
static void write_shortest(double value, char text[CLI_NUMBER_BYTES]) {
  int exponent;
  const bool power_of_two = frexp(value, &exponent) == 0.5;
  /* DBL_DIG digits find every decimal that has no more than these, but for subnormal numbers. */
  int count = value < DBL_MIN ? 1 : DBL_DIG;
  while (count < DBL_DECIMAL_DIG && !write_digits(value, count, FE_TONEAREST, text) &&
         !(power_of_two && write_digits(value, count, FE_UPWARD, text))) {
    count++;
  }
  if (count == DBL_DECIMAL_DIG) {
    write_digits(value, count, FE_TONEAREST, text);
  }
}

/* Writes 0.00123, 123000 or 12.3 for digits that stand for d.dd times 10 to the exponent. */
static int write_plain(const char *digits, int count, int exponent, char *text, size_t bytes) {
  static const char zeros[] = "0000000000000000";
  const int point = exponent + 1; /* digits before the point */
  if (point <= 0) {
    return snprintf(text, bytes, "0.%.*s%.*s", -point, zeros, count, digits);
  }
  if (point >= count) {
    return snprintf(text, bytes, "%.*s%.*s", count, digits, point - count, zeros);
  }
  return snprintf(text, bytes, "%.*s.%.*s", point, digits, count - point, digits + point);
}

const char *cli_number_format(double value, char text[CLI_NUMBER_BYTES]) {
  char digits[CLI_NUMBER_BYTES], plain[CLI_NUMBER_BYTES] = "";
  const char *sign = signbit(value) && !isnan(value) ? "-" : "";
  if (value == 0 || !isfinite(value)) {
    snprintf(text, CLI_NUMBER_BYTES, "%s%s", sign, value == 0 ? "0" : isinf(value) ? "inf" : "nan");
    return text;
  }
  write_shortest(fabs(value), digits); /* "d.ddde-05" */
  char *end = strchr(digits, 'e');
  const int exponent = (int)strtol(end + 1, NULL, 10);
  digits[1] = digits[0]; /* so that all digits stand side by side */
  while (end - digits > 2 && end[-1] == '0') {
    end--;
  }
  const int count = end - digits > 2 ? (int)(end - digits) - 1 : 1;
  const int length = snprintf(text, CLI_NUMBER_BYTES, "%s%c%s%.*se%d", sign, digits[1],
                              count > 1 ? "." : "", count - 1, digits + 2, exponent);
  /* Within these exponents the plain form has at most the zeros that write_plain() holds. */
  if (exponent >= -5 && exponent <= DBL_DIG) {
    const size_t room = sizeof plain - strlen(sign);
    memcpy(plain, sign, strlen(sign));
    if (write_plain(digits + 1, count, exponent, plain + strlen(sign), room) <=
        length - (int)strlen(sign)) {
      memcpy(text, plain, sizeof plain);
    }
  }
  return text;
}

double cli_number_of_single(float value) {
  char text[CLI_NUMBER_BYTES];
  for (int count = FLT_DIG; isfinite(value) && count <= FLT_DECIMAL_DIG; count++) {
    snprintf(text, sizeof text, "%.*e", count - 1, (double)value);
    if (strtof(text, NULL) == value) {
      return strtod(text, NULL);
    }
  }
  return (double)value;
}

double cli_number_rounded(double value) {
  char text[CLI_NUMBER_BYTES];
  snprintf(text, sizeof text, "%.*e", DBL_DIG - 1, value);
  const double rounded = strtod(text, NULL);
  return isfinite(rounded) ? rounded : value;
}
