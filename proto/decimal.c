#include "proto/decimal.h"

#include <float.h>
#include <math.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

__extension__ typedef unsigned __int128 u128;

/* ---- powers of ten --------------------------------------------------------------------------- */

enum {
  POWER_MIN = -292, /* the powers of ten that a double needs */
  POWER_MAX = 324,
  LIMBS = 20, /* of 64 bits: 10^324 takes 1077 bits, and 2^1279 / 10^292 leaves 309 */
};

/* The 128 leading bits of 10^k, rounded up. */
static struct power {
  uint64_t high;
  uint64_t low;
} powers[POWER_MAX - POWER_MIN + 1];

/* Returns the 128 leading bits of a number, plus 1 if other bits are set or `inexact`. */
static struct power leading_bits(const uint64_t number[LIMBS], bool inexact) {
  int top = LIMBS - 1;
  while (number[top] == 0) {
    top--;
  }
  uint64_t limbs[3]; /* the highest first */
  for (int i = 0; i < 3; i++) {
    limbs[i] = top >= i ? number[top - i] : 0;
  }
  for (int i = 0; i + 3 <= top; i++) {
    inexact |= number[i] != 0;
  }
  const int shift = __builtin_clzll(limbs[0]);
  u128 bits = (u128)limbs[0] << 64 | limbs[1];
  if (shift > 0) {
    bits = bits << shift | limbs[2] >> (64 - shift);
  }
  bits += inexact || limbs[2] << shift != 0;
  return (struct power){(uint64_t)(bits >> 64), (uint64_t)bits};
}

static void make_powers(void) {
  uint64_t number[LIMBS] = {1};
  for (int k = 0; k <= POWER_MAX; k++) {
    powers[k - POWER_MIN] = leading_bits(number, false);
    u128 carry = 0;
    for (int i = 0; i < LIMBS; i++) {
      carry += (u128)number[i] * 10;
      number[i] = (uint64_t)carry;
      carry >>= 64;
    }
  }
  memset(number, 0, sizeof number);
  number[LIMBS - 1] = UINT64_C(1) << 63;
  for (int k = -1; k >= POWER_MIN; k--) {
    u128 rest = 0;
    for (int i = LIMBS - 1; i >= 0; i--) {
      rest = rest << 64 | number[i];
      number[i] = (uint64_t)(rest / 10);
      rest %= 10;
    }
    powers[k - POWER_MIN] = leading_bits(number, true);
  }
}

/* These return the floor of log10(2^e), log10(3/4 2^e) and log2(10^e), for exponents of doubles. */
static int log10_of_power_of_2(int e) {
  return (e * 1262611) >> 22;
}

static int log10_of_three_quarters(int e) {
  return (e * 1262611 - 524031) >> 22;
}

static int log2_of_power_of_10(int e) {
  return (e * 1741647) >> 19;
}

/* ---- digits ---------------------------------------------------------------------------------- */

/* An integer times ten to an exponent. */
struct digits {
  uint64_t integer;
  int exponent;
};

/* Returns the product of a power and a number, in units of 2^128. Its last bit is also set if any
 * bits are cut off. */
static uint64_t product(struct power power, uint64_t number) {
  const u128 low = (u128)power.low * number;
  const u128 high = (u128)power.high * number + (uint64_t)(low >> 64);
  return (uint64_t)(high >> 64) | ((uint64_t)high > 1);
}

/* Returns the shortest decimal within half the distance to the neighbours of significand
 * 2^exponent, and of the shortest ones the nearest. `power_of_two`: the lower neighbour is half as
 * far. The names are those of the paper: vb is four times the value, and vbl and vbr are four times
 * the bounds, in units of ten to the power k. */
static struct digits shortest(uint64_t significand, int exponent, bool power_of_two) {
  const uint64_t odd = significand & 1, c = significand << 2;
  const int k = power_of_two ? log10_of_three_quarters(exponent) : log10_of_power_of_2(exponent);
  const int h = exponent + log2_of_power_of_10(-k) + 1;
  const struct power g = powers[-k - POWER_MIN];
  const uint64_t vb = product(g, c << h);
  const uint64_t vbl = product(g, (c - (power_of_two ? 1 : 2)) << h) + odd;
  const uint64_t vbr = product(g, (c + 2) << h) - odd;
  const uint64_t s = vb >> 2, ten = s / 10;
  if (s >= 10) { /* one digit less */
    const bool below = vbl <= 40 * ten, above = 40 * ten + 40 <= vbr;
    if (below != above) {
      return (struct digits){ten + above, k + 1};
    }
  }
  const bool below = vbl <= 4 * s, above = 4 * s + 4 <= vbr;
  if (below != above) {
    return (struct digits){s + above, k};
  }
  const uint64_t middle = 4 * s + 2;
  return (struct digits){s + (vb > middle || (vb == middle && (s & 1) != 0)), k};
}

/* ---- text ------------------------------------------------------------------------------------ */

/* Two digits at a time. */
static size_t write_integer(uint64_t integer, char *text) {
  static const char pairs[] = "00010203040506070809101112131415161718192021222324"
                              "25262728293031323334353637383940414243444546474849"
                              "50515253545556575859606162636465666768697071727374"
                              "75767778798081828384858687888990919293949596979899";
  char reversed[DECIMAL_BYTES], *at = reversed + sizeof reversed;
  for (; integer >= 100; integer /= 100) {
    at -= 2;
    memcpy(at, pairs + 2 * (integer % 100), 2);
  }
  at -= 2;
  memcpy(at, pairs + 2 * integer, 2);
  at += integer < 10;
  const size_t count = (size_t)(reversed + sizeof reversed - at);
  memcpy(text, at, count);
  return count;
}

/* Returns the length of d.ddde-5 for digits whose first one stands for 10^exponent. */
static size_t scientific_length(size_t count, int exponent) {
  const int size = exponent < 0 ? -exponent : exponent;
  return count + (count > 1) + 1 + (exponent < 0) + (size < 10 ? 1 : size < 100 ? 2 : 3);
}

static void write_scientific(const char *digits, size_t count, int exponent, char *text) {
  *text++ = digits[0];
  if (count > 1) {
    *text++ = '.';
    memcpy(text, digits + 1, count - 1);
    text += count - 1;
  }
  *text++ = 'e';
  if (exponent < 0) {
    *text++ = '-';
  }
  write_integer((uint64_t)(exponent < 0 ? -exponent : exponent), text);
}

/* Returns the length of 0.00123, 123000 or 12.3. */
static size_t plain_length(size_t count, int exponent) {
  const size_t whole = exponent < 0 ? 0 : (size_t)exponent + 1; /* digits before the point */
  return whole == 0 ? count + 1 + (size_t)-exponent : count > whole ? count + 1 : whole;
}

static void write_plain(const char *digits, size_t count, int exponent, char *text) {
  const size_t whole = exponent < 0 ? 0 : (size_t)exponent + 1;
  if (whole == 0) {
    memset(text, '0', (size_t)-exponent + 1);
    text[1] = '.';
    memcpy(text + 1 - exponent, digits, count);
  } else if (count <= whole) {
    memcpy(text, digits, count);
    memset(text + count, '0', whole - count);
  } else {
    memcpy(text, digits, whole);
    text[whole] = '.';
    memcpy(text + whole + 1, digits + whole, count - whole);
  }
}

/* Writes a positive and finite decimal. The plain form is taken unless it is longer. */
static size_t write_decimal(struct digits decimal, char *text) {
  char digits[DECIMAL_BYTES];
  size_t count = write_integer(decimal.integer, digits);
  const int exponent = decimal.exponent + (int)count - 1;
  while (count > 1 && digits[count - 1] == '0') {
    count--;
  }
  const size_t scientific = scientific_length(count, exponent);
  const size_t plain = exponent < -5 || exponent > 15 ? SIZE_MAX : plain_length(count, exponent);
  if (plain > scientific) {
    write_scientific(digits, count, exponent, text);
    return scientific;
  }
  write_plain(digits, count, exponent, text);
  return plain;
}

/* Writes a value. magnitude: its bits in IEEE 754 without the sign, for significands of `precision`
 * bits. least: the binary exponent of the smallest subnormal number. */
static size_t write_bits(double value, uint64_t magnitude, int precision, int least,
                         char text[DECIMAL_BYTES]) {
  static pthread_once_t once = PTHREAD_ONCE_INIT;
  const char *name = isnan(value) ? "nan" : isinf(value) ? "inf" : value == 0 ? "0" : NULL;
  size_t length = signbit(value) && !isnan(value);
  text[0] = '-';
  if (name != NULL) {
    memcpy(text + length, name, strlen(name));
    length += strlen(name);
  } else {
    pthread_once(&once, make_powers);
    const uint64_t hidden = UINT64_C(1) << (precision - 1), fraction = magnitude & (hidden - 1);
    const int biased = (int)(magnitude >> (precision - 1));
    const struct digits decimal =
        shortest(biased > 0 ? fraction | hidden : fraction, (biased > 0 ? biased - 1 : 0) + least,
                 fraction == 0 && biased > 1);
    length += write_decimal(decimal, text + length);
  }
  text[length] = '\0';
  return length;
}

size_t decimal_write(double value, char text[DECIMAL_BYTES]) {
  uint64_t bits;
  memcpy(&bits, &value, sizeof bits);
  return write_bits(value, bits & (UINT64_MAX >> 1), DBL_MANT_DIG, DBL_MIN_EXP - DBL_MANT_DIG,
                    text);
}

size_t decimal_write_single(float value, char text[DECIMAL_BYTES]) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  return write_bits((double)value, bits & (UINT32_MAX >> 1), FLT_MANT_DIG,
                    FLT_MIN_EXP - FLT_MANT_DIG, text);
}

/* ---- reading --------------------------------------------------------------------------------- */

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

bool decimal_read(const char *text, double *value) {
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
