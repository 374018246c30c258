#include "clients/cli/number.h"

#include <ctype.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* A double that has at most DBL_DIG digits is found by asking for DBL_DIG of them; no double needs
 * more than DBL_DECIMAL_DIG. */
enum { DIGITS_MAX = DBL_DECIMAL_DIG };

/* ---- reading ------------------------------------------------------------------------------- */

static size_t count_digits(const char *text) {
  return strspn(text, "0123456789");
}

static bool is_decimal(const char *text) {
  const size_t whole = count_digits(text);
  text += whole;
  size_t part = 0;
  if (*text == '.') {
    part = count_digits(text + 1);
    text += 1 + part;
  }
  if (whole + part == 0) {
    return false;
  }
  if (*text == 'e' || *text == 'E') {
    text++;
    text += *text == '+' || *text == '-';
    const size_t exponent = count_digits(text);
    if (exponent == 0) {
      return false;
    }
    text += exponent;
  }
  return *text == '\0';
}

bool cli_number_parse(const char *text, double *value) {
  const char *unsigned_text = text + (*text == '+' || *text == '-');
  const bool decimal = is_decimal(unsigned_text);
  if (!decimal && strcasecmp(unsigned_text, "inf") != 0 &&
      strcasecmp(unsigned_text, "infinity") != 0 && strcasecmp(unsigned_text, "nan") != 0) {
    return false;
  }
  *value = strtod(text, NULL);
  return !decimal || isfinite(*value);
}

bool cli_count_parse(const char *text, uint64_t *value) {
  const size_t digits = count_digits(text);
  if (digits == 0 || text[digits] != '\0') {
    return false;
  }
  *value = 0;
  for (size_t i = 0; i < digits; i++) {
    const unsigned digit = (unsigned)(text[i] - '0');
    if (*value > (UINT64_MAX - digit) / 10) {
      return false;
    }
    *value = *value * 10 + digit;
  }
  return true;
}

/* ---- writing ------------------------------------------------------------------------------- */

/* d.ddd * 10^exponent, without the point. */
typedef struct decimal {
  char digits[DIGITS_MAX + 2];
  int count;
  int exponent;
} decimal;

/* The decimal of `count` digits that is nearest to value. */
static decimal round_to(double value, int count) {
  char text[CLI_NUMBER_BYTES];
  decimal result = {.count = count};
  snprintf(text, sizeof text, "%.*e", count - 1, value);
  result.digits[0] = text[0];
  memcpy(result.digits + 1, text + 2, (size_t)count - 1);
  result.exponent = (int)strtol(strchr(text, 'e') + 1, NULL, 10);
  return result;
}

static decimal without_zeros(decimal from) {
  while (from.count > 1 && from.digits[from.count - 1] == '0') {
    from.count--;
  }
  return from;
}

/* The next larger decimal with as many digits. */
static decimal next_above(decimal from) {
  int at = from.count - 1;
  while (at >= 0 && from.digits[at] == '9') {
    from.digits[at--] = '0';
  }
  if (at < 0) {
    from.digits[0] = '1';
    from.exponent++;
  } else {
    from.digits[at]++;
  }
  return from;
}

static bool reads_back(const decimal *from, double value) {
  char text[CLI_NUMBER_BYTES + 8];
  snprintf(text, sizeof text, "%.*se%d", from->count, from->digits,
           from->exponent - (from->count - 1));
  return strtod(text, NULL) == value;
}

/* The shortest decimal that reads back to value, which is positive and finite, and of the shortest
 * ones the nearest. Below a power of two doubles lie twice as close as above it, so there the
 * nearest decimal may be another double's while the next above it is still this one's. */
static decimal shortest(double value) {
  int exponent;
  const bool power_of_two = frexp(value, &exponent) == 0.5;
  /* Subnormal numbers may need but a single digit; for others asking for DBL_DIG finds all that
   * have no more than that. */
  for (int count = value < DBL_MIN ? 1 : DBL_DIG; count < DIGITS_MAX; count++) {
    const decimal nearest = round_to(value, count);
    if (reads_back(&nearest, value)) {
      return without_zeros(nearest);
    }
    const decimal above = next_above(nearest);
    if (power_of_two && reads_back(&above, value)) {
      return without_zeros(above);
    }
  }
  return without_zeros(round_to(value, DIGITS_MAX));
}

static int write_plain(const decimal *from, char *text, size_t bytes) {
  const int point = from->exponent + 1; /* digits before the point */
  if (point <= 0) {
    return snprintf(text, bytes, "0.%.*s%.*s", -point, "0000000000000000", from->count,
                    from->digits);
  }
  if (point >= from->count) {
    return snprintf(text, bytes, "%.*s%.*s", from->count, from->digits, point - from->count,
                    "0000000000000000");
  }
  return snprintf(text, bytes, "%.*s.%.*s", point, from->digits, from->count - point,
                  from->digits + point);
}

static int write_scientific(const decimal *from, char *text, size_t bytes) {
  return snprintf(text, bytes, "%c%s%.*se%d", from->digits[0], from->count > 1 ? "." : "",
                  from->count - 1, from->digits + 1, from->exponent);
}

const char *cli_number_format(double value, char text[CLI_NUMBER_BYTES]) {
  char scientific[CLI_NUMBER_BYTES];
  char *at = text;
  if (isnan(value)) {
    return memcpy(text, "nan", 4);
  }
  if (signbit(value)) {
    *at++ = '-';
    value = -value;
  }
  if (value == 0 || isinf(value)) {
    memcpy(at, value == 0 ? "0" : "inf", value == 0 ? 2 : 4);
    return text;
  }
  const decimal digits = shortest(value);
  const int scientific_bytes = write_scientific(&digits, scientific, sizeof scientific);
  /* Within these exponents the plain form has at most the zeros that write_plain() holds. */
  if (digits.exponent >= -5 && digits.exponent <= DBL_DIG &&
      write_plain(&digits, at, CLI_NUMBER_BYTES - 1) <= scientific_bytes) {
    return text;
  }
  memcpy(at, scientific, (size_t)scientific_bytes + 1);
  return text;
}
