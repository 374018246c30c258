#include "clients/cli/number.h"

#include <errno.h>
#include <fenv.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "core/dd.h"

/* ---- powers of ten --------------------------------------------------------------------------- */

/* The powers of ten that are doubles, as the first EXACT_POWERS are. */
enum { EXACT_POWERS = 23 };
static const double exact_powers[EXACT_POWERS] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                                  1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                                  1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

/* 10^(16 i), each within 2^-106 of it, relative. */
enum { POWERS = 18, POWER_STEP = 16 };
static const dd powers[POWERS] = {
    {0x1p+0, 0},
    {0x1.1c37937e08p+53, 0},
    {0x1.3b8b5b5056e17p+106, -0x1.3107fp+52},
    {0x1.5e531a0a1c873p+159, -0x1.14b4c7a76a406p+105},
    {0x1.84f03e93ff9f5p+212, -0x1.2ac340948e389p+157},
    {0x1.afcef51f0fb5fp+265, -0x1.08f322e84da1p+204},
    {0x1.df67562d8b363p+318, -0x1.ae9d180b58861p+264},
    {0x1.0a1f5b8132466p+372, 0x1.4f01f167b5e3p+318},
    {0x1.27748f9301d32p+425, -0x1.901cc86649e4ap+371},
    {0x1.4805738b51a75p+478, -0x1.18a0e9df9363ap+423},
    {0x1.6c2d4256ffcc3p+531, -0x1.56a2119e533adp+474},
    {0x1.945145230b378p+584, -0x1.b20a11c22bf0cp+527},
    {0x1.c0e1ef1a724ebp+637, -0x1.4abd220ed605cp+583},
    {0x1.f25c186a6f04cp+690, 0x1.45a7709a56ccep+635},
    {0x1.14a52dffc6799p+744, 0x1.2f82bd6b70d9ap+689},
    {0x1.33234de7ad7e3p+797, -0x1.34a66b24bc3ebp+741},
    {0x1.54fdd7f73bf3cp+850, -0x1.7222446fe467p+795},
    {0x1.7a93a2954f3b8p+903, -0x1.beda693cdd93bp+849},
};

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

/* ---- digits ---------------------------------------------------------------------------------- */

/* The decimal digits[0].digits[1]... times 10^exponent, without zeros at its end. */
typedef struct decimal {
  char digits[CLI_NUMBER_BYTES];
  int count;
  int exponent;
} decimal;

static void trim(decimal *to) {
  while (to->count > 1 && to->digits[to->count - 1] == '0') {
    to->count--;
  }
}

enum { DIGITS = 17 }; /* so many digits tell any two doubles apart: DBL_DECIMAL_DIG */

/* Finds the shortest decimal nearer than half_ulp to a value, and of the shortest ones the nearest.
 * The value is scaled to an integer of DIGITS digits and a rest. `step` is the first power of ten
 * to whose multiples the integer is rounded. The scaled value is computed with some 100 bits.
 * Returns false if they do not decide, which is rare, and for powers of two, which are not as far
 * from the number below as from that above. */
static bool find_quickly(double value, double half_ulp, uint64_t step, decimal *to) {
  int binary;
  if (frexp(value, &binary) == 0.5 || value < 1e-250 || value > 1e250) {
    return false;
  }
  /* The logarithm's floor, or one less. */
  to->exponent = (int)floor((binary - 1) * 0.30102999566398120);
  dd scaled;
  double half;
  for (;;) {
    const int power = DIGITS - 1 - to->exponent, size = abs(power);
    const dd tens = dd_mul(powers[size / POWER_STEP], dd_from(exact_powers[size % POWER_STEP]));
    scaled = power < 0 ? dd_div(dd_from(value), tens) : dd_mul(tens, dd_from(value));
    half = power < 0 ? half_ulp / tens.hi : half_ulp * tens.hi;
    if (scaled.hi < 1e17) {
      break;
    }
    to->exponent++;
  }
  const double low = floor(scaled.lo), rest = scaled.lo - low;
  const uint64_t whole = (uint64_t)((int64_t)scaled.hi + (int64_t)low);
  if (whole < UINT64_C(10000000000000000)) {
    return false;
  }
  for (;; step /= 10) {
    const double below = (double)(whole % step) + rest, above = (double)step - below;
    const double distance = fmin(below, above), doubt = (double)step * 0x1p-36;
    if (step == 0 || fabs(below - above) < doubt || fabs(distance - half) < doubt) {
      return false;
    }
    if (distance < half) {
      uint64_t digits = whole - whole % step + (above < below ? step : 0);
      to->count = DIGITS;
      to->exponent += digits == UINT64_C(100000000000000000);
      digits /= digits == UINT64_C(100000000000000000) ? 10 : 1;
      for (int i = DIGITS - 1; i >= 0; i--, digits /= 10) {
        to->digits[i] = (char)('0' + digits % 10);
      }
      trim(to);
      return true;
    }
  }
}

/* Takes the digits of a text like d.ddde-05. */
static void take_digits(const char *text, decimal *to) {
  const char *end = strchr(text, 'e');
  to->exponent = (int)strtol(end + 1, NULL, 10);
  to->digits[0] = text[0];
  to->count = end - text > 2 ? (int)(end - text) - 1 : 1;
  memcpy(to->digits + 1, text + 2, (size_t)to->count - 1);
  trim(to);
}

/* Writes `count` digits of a value in scientific notation. Returns whether they read back to it. */
static bool write_digits(double value, int count, int rounding, char text[CLI_NUMBER_BYTES]) {
  fesetround(rounding);
  snprintf(text, CLI_NUMBER_BYTES, "%.*e", count - 1, value);
  fesetround(FE_TONEAREST);
  return strtod(text, NULL) == value;
}

/* Finds the shortest decimal that reads back to a positive and finite value, and of the shortest
 * ones the nearest. Below a power of two, doubles lie twice as close as above it. So there the
 * nearest decimal may belong to another double while the next above it belongs to this one. */
static void find_shortest(double value, decimal *to) {
  int exponent;
  char text[CLI_NUMBER_BYTES];
  const bool power_of_two = frexp(value, &exponent) == 0.5;
  if (value >= DBL_MIN && find_quickly(value, ldexp(1, exponent - DBL_MANT_DIG - 1), 100, to)) {
    return;
  }
  /* DBL_DIG digits find every decimal that has no more than these, but for subnormal numbers. */
  int count = value < DBL_MIN ? 1 : DBL_DIG;
  while (count < DBL_DECIMAL_DIG && !write_digits(value, count, FE_TONEAREST, text) &&
         !(power_of_two && write_digits(value, count, FE_UPWARD, text))) {
    count++;
  }
  if (count == DBL_DECIMAL_DIG) {
    write_digits(value, count, FE_TONEAREST, text);
  }
  take_digits(text, to);
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Writes 1.23e-9. */
static int write_scientific(const decimal *from, char *text) {
  char *at = text;
  *at++ = from->digits[0];
  if (from->count > 1) {
    *at++ = '.';
    memcpy(at, from->digits + 1, (size_t)from->count - 1);
    at += from->count - 1;
  }
  return (int)(at - text) + sprintf(at, "e%d", from->exponent);
}

/* Returns the length of the plain notation: 0.00123, 123000 or 12.3. */
static int plain_length(const decimal *from) {
  const int point = from->exponent + 1; /* digits before the point */
  return point <= 0 ? 2 - point + from->count : point >= from->count ? point : from->count + 1;
}

static void write_plain(const decimal *from, char *text) {
  const int point = from->exponent + 1;
  const int before = point <= 0 ? 0 : point < from->count ? point : from->count;
  memset(text, '0', (size_t)plain_length(from));
  memcpy(text, from->digits, (size_t)before);
  if (before < from->count) {
    char *at = text + (point > 0 ? point : 1);
    *at = '.';
    memcpy(at + 1 + (point < 0 ? -point : 0), from->digits + before,
           (size_t)(from->count - before));
  }
  text[plain_length(from)] = '\0';
}

const char *cli_number_format(double value, char text[CLI_NUMBER_BYTES]) {
  decimal digits;
  char scientific[CLI_NUMBER_BYTES];
  char *at = text;
  if (signbit(value) && !isnan(value)) {
    *at++ = '-';
  }
  if (value == 0 || !isfinite(value)) {
    strcpy(at, value == 0 ? "0" : isinf(value) ? "inf" : "nan");
    return text;
  }
  find_shortest(fabs(value), &digits);
  /* Within these exponents the plain notation may be the shorter one. */
  const bool plain = digits.exponent >= -5 && digits.exponent <= DBL_DIG;
  const int least = digits.count + (digits.count > 1 ? 3 : 2); /* 3e9, 1.23e9: or longer */
  if (plain && (plain_length(&digits) <= least ||
                plain_length(&digits) <= write_scientific(&digits, scientific))) {
    write_plain(&digits, at);
  } else {
    write_scientific(&digits, at);
  }
  return text;
}

/* Finds the shortest decimal that reads back to a positive and finite float. */
static void find_shortest_single(float value, decimal *to) {
  int exponent;
  char text[CLI_NUMBER_BYTES];
  frexpf(value, &exponent);
  /* From FLT_DIG digits on. */
  if (value >= FLT_MIN && find_quickly((double)value, ldexp(1, exponent - FLT_MANT_DIG - 1),
                                       UINT64_C(100000000000), to)) {
    return;
  }
  for (int count = FLT_DIG; count <= FLT_DECIMAL_DIG; count++) {
    snprintf(text, sizeof text, "%.*e", count - 1, (double)value);
    if (strtof(text, NULL) == value) {
      break;
    }
  }
  take_digits(text, to);
}

double cli_number_of_single(float value) {
  decimal digits;
  char text[CLI_NUMBER_BYTES];
  double found;
  if (value == 0 || !isfinite(value)) {
    return (double)value;
  }
  find_shortest_single(fabsf(value), &digits);
  uint64_t whole = 0;
  for (int i = 0; i < digits.count; i++) {
    whole = 10 * whole + (uint64_t)(digits.digits[i] - '0');
  }
  if (!compose(whole, digits.exponent - digits.count + 1, &found)) {
    write_scientific(&digits, text);
    found = strtod(text, NULL);
  }
  return value < 0 ? -found : found;
}

double cli_number_rounded(double value) {
  char text[CLI_NUMBER_BYTES];
  snprintf(text, sizeof text, "%.*e", DBL_DIG - 1, value);
  const double rounded = strtod(text, NULL);
  return isfinite(rounded) ? rounded : value;
}
