#include "clients/cli/number.h"

#include <errno.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* ---- powers of ten --------------------------------------------------------------------------- */

/* The powers of ten that are doubles, as the first EXACT_POWERS are. */
enum { EXACT_POWERS = 23 };
static const double exact_powers[EXACT_POWERS] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                                  1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                                  1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

/* Computes digits times 10^exponent if one operation on exact numbers does, so that the result is
 * rounded once. Returns false otherwise. */
static bool compose(uint64_t digits, int exponent, double *value) {
  if (digits > UINT64_C(1) << DBL_MANT_DIG || abs(exponent) >= EXACT_POWERS) {
    return false;
  }
  *value = exponent < 0 ? (double)digits / exact_powers[-exponent]
                        : (double)digits * exact_powers[exponent];
  return true;
}

/* ---- reading --------------------------------------------------------------------------------- */

/* Reads digits while their number fits into 64 bits. *places counts them. */
static const char *read_digits(const char *text, uint64_t *digits, int *places) {
  for (; *text >= '0' && *text <= '9' && *digits < UINT64_MAX / 10 - 1; text++) {
    *digits = 10 * *digits + (uint64_t)(*text - '0');
    ++*places;
  }
  return text;
}

/* Reads a number of few digits and a small exponent. Returns false for any other text. */
static bool parse_short(const char *text, double *value) {
  uint64_t digits = 0, power = 0;
  int places = 0, decimals = 0, power_places = 0;
  const bool negative = *text == '-';
  text = read_digits(text + (*text == '+' || negative), &digits, &places);
  if (*text == '.') {
    text = read_digits(text + 1, &digits, &decimals);
  }
  bool good = places + decimals > 0;
  if (*text == 'e' || *text == 'E') {
    const bool down = text[1] == '-';
    text = read_digits(text + 1 + (down || text[1] == '+'), &power, &power_places);
    good = good && power_places > 0 && power < 1000;
    decimals += down ? (int)(power % 1000) : -(int)(power % 1000);
  }
  if (!good || *text != '\0' || !compose(digits, -decimals, value)) {
    return false;
  }
  *value = negative ? -*value : *value;
  return true;
}

bool cli_number_parse(const char *text, double *value) {
  if (parse_short(text, value)) {
    return true;
  }
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

const char *cli_number_format(double value, char text[CLI_NUMBER_BYTES]) {
  decimal_write(value, text);
  return text;
}

double cli_number_of_single(float value) {
  char text[CLI_NUMBER_BYTES];
  double found;
  decimal_write_single(value, text);
  return isfinite(value) && parse_short(text, &found) ? found : strtod(text, NULL);
}

double cli_number_rounded(double value) {
  char text[CLI_NUMBER_BYTES];
  snprintf(text, sizeof text, "%.*e", DBL_DIG - 1, value);
  const double rounded = strtod(text, NULL);
  return isfinite(rounded) ? rounded : value;
}
