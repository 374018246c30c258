#include "proto/decimal.h"

#include <float.h>
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* ---- powers of ten --------------------------------------------------------------------------- */

enum {
  POWER_MIN = -292, /* range of exponents k of the powers 10^k that doubles need */
  POWER_MAX = 324,
  /* words of 32 bits of a power: 10^324 has 1077 bits, and 2^1279 / 10^292 leaves 309 */
  LIMBS = 40,
};

/* The 128 leading bits of 10^k, rounded up. */
static struct power {
  uint64_t high;
  uint64_t low;
} powers[POWER_MAX - POWER_MIN + 1];
static atomic_bool powers_are_made;

/* Returns the 128 leading bits of a number, plus 1 if other bits are set or `inexact`. */
static struct power leading_bits(const uint32_t number[LIMBS], bool inexact) {
  int top = LIMBS - 1;
  while (number[top] == 0) {
    top--;
  }
  uint64_t words[4] = {0}; /* each limb with the one below it, the highest first */
  for (int i = 0; i < 4 && top >= i; i++) {
    words[i] = (uint64_t)number[top - i] << 32 | (top > i ? number[top - i - 1] : 0);
  }
  for (int i = 0; i + 5 <= top; i++) {
    inexact |= number[i] != 0;
  }
  const int shift = __builtin_clzll(words[0]);
  const uint64_t high = words[0] << shift | (words[1] & UINT32_MAX) >> (32 - shift);
  const uint64_t low = words[2] << shift | (words[3] & UINT32_MAX) >> (32 - shift);
  const bool more = inexact || (uint32_t)(words[3] << shift) != 0;
  return (struct power){high + (more && low == UINT64_MAX), low + more};
}

static void make_powers(void) {
  uint32_t number[LIMBS] = {1};
  for (int k = 0; k <= POWER_MAX; k++) {
    powers[k - POWER_MIN] = leading_bits(number, false);
    uint64_t carry = 0;
    for (int i = 0; i < LIMBS; i++) {
      carry += (uint64_t)number[i] * 10;
      number[i] = (uint32_t)carry;
      carry >>= 32;
    }
  }
  memset(number, 0, sizeof number);
  number[LIMBS - 1] = UINT32_C(1) << 31;
  for (int k = -1; k >= POWER_MIN; k--) {
    uint64_t rest = 0;
    for (int i = LIMBS - 1; i >= 0; i--) {
      rest = rest << 32 | number[i];
      number[i] = (uint32_t)(rest / 10);
      rest %= 10;
    }
    powers[k - POWER_MIN] = leading_bits(number, true);
  }
  atomic_store_explicit(&powers_are_made, true, memory_order_release);
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

/* The decimal number integer * 10^exponent. */
struct digits {
  uint64_t integer;
  int exponent;
};

static struct power multiply(uint64_t a, uint64_t b) {
#ifdef __SIZEOF_INT128__
  __extension__ const unsigned __int128 whole = (unsigned __int128)a * b;
  return (struct power){(uint64_t)(whole >> 64), (uint64_t)whole};
#else /* 32-bit machines have no such type */
  const uint64_t a_low = (uint32_t)a, b_low = (uint32_t)b, a_high = a >> 32, b_high = b >> 32;
  const uint64_t low = a_low * b_low, one = a_high * b_low + (low >> 32);
  const uint64_t other = a_low * b_high + (uint32_t)one;
  return (struct power){a_high * b_high + (one >> 32) + (other >> 32), other << 32 | (uint32_t)low};
#endif
}

/* Returns the product of a power and a number, in units of 2^128. Its last bit is also set if any
 * bits are cut off. */
static uint64_t product(struct power power, uint64_t number) {
  const struct power high = multiply(power.high, number);
  const uint64_t middle = high.low + multiply(power.low, number).high;
  return (high.high + (middle < high.low)) | (middle > 1);
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
  /* Whether the decimals next to the value lie within the bounds, with all digits and with one less.
   * Which ones do is chance, so that jumps would be foreseen badly. */
  const bool below = vbl <= 4 * s, above = 4 * s + 4 <= vbr;
  const bool ten_below = vbl <= 40 * ten, ten_above = 40 * ten + 40 <= vbr;
  const bool shorter = ten_below != ten_above && s >= 10;
  const bool nearer = vb > 4 * s + 2 || (vb == 4 * s + 2 && (s & 1) != 0);
  const uint64_t whole = s + (below != above ? above : nearer);
  return (struct digits){shorter ? ten + ten_above : whole, k + shorter};
}

/* ---- text ------------------------------------------------------------------------------------ */

/* Returns the eight digits of a number below 10^8 as bytes, the first digit in the lowest byte. It
 * splits the number into halves, pairs and digits, all parts of a word at the same time: a quotient q
 * and the rest n - 100 q behind it are n 2^16 - q (100 2^16 - 1), likewise for the others. A product
 * with 10486 / 2^20 is the quotient by 100 for numbers below 10000, and one with 103 / 2^10 the
 * quotient by 10 for numbers below 100. */
static inline uint64_t eight_digits(uint64_t number) {
  const uint64_t halves = (number << 32) - number / 10000 * ((UINT64_C(10000) << 32) - 1);
  const uint64_t hundreds = (halves * 10486 >> 20) & UINT64_C(0x7f0000007f);
  const uint64_t pairs = (halves << 16) - hundreds * ((100 << 16) - 1);
  const uint64_t tens = (pairs * 103 >> 10) & UINT64_C(0x000f000f000f000f);
  return (pairs << 8) - tens * ((10 << 8) - 1);
}

/* 17 digits, as many as a shortest decimal has at most, the first of which is not 0. */
struct text {
  char first;
  uint64_t middle, low; /* eight digits each, the first one in the lowest byte */
  size_t count;         /* number of digits up to the last one that is not 0 */
  int exponent;         /* power of ten of the first digit */
};

/* decimal: of a positive integer below 10^17 */
static inline struct text make_text(struct digits decimal) {
  static const uint64_t tens[] = {1e0, 1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,
                                  1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17};
  const uint64_t zeros = UINT64_C(0x3030303030303030);
  int digits = (64 - __builtin_clzll(decimal.integer)) * 1233 >> 12; /* log10(2) = 1233 / 2^12 */
  digits += decimal.integer >= tens[digits];
  const uint64_t integer = decimal.integer * tens[17 - digits], high = integer / tens[8];
  const uint64_t middle = eight_digits(high % tens[8]), low = eight_digits(integer % tens[8]);
  return (struct text){.first = (char)('0' + high / tens[8]),
                       .middle = middle | zeros,
                       .low = low | zeros,
                       .count = low != 0      ? 17 - (size_t)__builtin_clzll(low) / 8
                                : middle != 0 ? 9 - (size_t)__builtin_clzll(middle) / 8
                                              : 1,
                       .exponent = decimal.exponent + digits - 1};
}

static inline void put_all_digits(const struct text *from, char *text) {
  text[0] = from->first;
  memcpy(text + 1, &from->middle, sizeof from->middle);
  memcpy(text + 9, &from->low, sizeof from->low);
}

/* Writes the digits with a point behind the first `whole` of them, 1 to 16, if there are more.
 * Returns the length. */
static inline size_t put_digits(const struct text *from, size_t whole, char *text) {
  put_all_digits(from, text + 1);
  text[0] = from->first;
  memmove(text + 1, text + 2, whole - 1);
  text[whole] = from->count > whole ? '.' : '0';
  return from->count > whole ? from->count + 1 : whole;
}

/* Writes a positive and finite decimal: 0.00123, 123000, 12.3, or d.ddde-5. The plain form is taken
 * unless it is longer. Returns its length; behind it are characters of no meaning. */
static inline size_t write_decimal(struct digits decimal, char *text) {
  const struct text made = make_text(decimal);
  const int exponent = made.exponent, several = made.count > 1;
  /* 0.00d and d.e-3 have the same length, as have 0.000dd and d.de-4. */
  if (exponent < 0 && exponent >= -2 - several) {
    memcpy(text, "0.0000", 6);
    put_all_digits(&made, text + 1 - exponent);
    return made.count + 1 + (size_t)-exponent;
  }
  /* A point among the digits takes less than an exponent. Zeros behind them may take more. */
  const int scientific = (int)made.count + several + (exponent < 10 ? 2 : 3);
  if (exponent >= 0 &&
      (exponent < (int)made.count - 1 || (exponent <= 15 && exponent + 1 <= scientific))) {
    return put_digits(&made, (size_t)exponent + 1, text);
  }
  unsigned size = (unsigned)abs(exponent);
  size_t length = put_digits(&made, 1, text);
  text[length++] = 'e';
  text[length] = '-';
  length += exponent < 0;
  if (size >= 100) {
    text[length++] = (char)('0' + size / 100);
  }
  if (size >= 10) {
    text[length++] = (char)('0' + size / 10 % 10);
  }
  text[length++] = (char)('0' + size % 10);
  return length;
}

/* Writes a NaN, an infinity or a zero. */
static size_t write_name(double value, char text[DECIMAL_BYTES]) {
  const char *name = isnan(value) ? "nan" : isinf(value) ? "inf" : "0";
  const size_t sign = signbit(value) && !isnan(value), length = strlen(name);
  text[0] = '-';
  memcpy(text + sign, name, length + 1);
  return sign + length;
}

/* Writes a value that is finite and not 0. magnitude: its bits in IEEE 754 without the sign, for
 * significands of `precision` bits. least: the binary exponent of the smallest subnormal number. */
static inline size_t write_bits(bool negative, uint64_t magnitude, int precision, int least,
                                char text[DECIMAL_BYTES]) {
  static pthread_once_t once = PTHREAD_ONCE_INIT;
  if (!atomic_load_explicit(&powers_are_made, memory_order_acquire)) {
    pthread_once(&once, make_powers);
  }
  const uint64_t hidden = UINT64_C(1) << (precision - 1), fraction = magnitude & (hidden - 1);
  const int biased = (int)(magnitude >> (precision - 1));
  const struct digits decimal =
      shortest(biased > 0 ? fraction | hidden : fraction, (biased > 0 ? biased - 1 : 0) + least,
               fraction == 0 && biased > 1);
  text[0] = '-';
  const size_t length = negative + write_decimal(decimal, text + negative);
  text[length] = '\0';
  return length;
}

size_t decimal_write(double value, char text[DECIMAL_BYTES]) {
  uint64_t bits;
  memcpy(&bits, &value, sizeof bits);
  const uint64_t magnitude = bits & (UINT64_MAX >> 1), infinity = UINT64_C(0x7ff) << 52;
  return magnitude - 1 < infinity - 1
             ? write_bits(bits >> 63, magnitude, DBL_MANT_DIG, DBL_MIN_EXP - DBL_MANT_DIG, text)
             : write_name(value, text);
}

size_t decimal_write_single(float value, char text[DECIMAL_BYTES]) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  const uint32_t magnitude = bits & (UINT32_MAX >> 1), infinity = UINT32_C(0xff) << 23;
  return magnitude - 1 < infinity - 1
             ? write_bits(bits >> 31, magnitude, FLT_MANT_DIG, FLT_MIN_EXP - FLT_MANT_DIG, text)
             : write_name((double)value, text);
}

/* ---- reading --------------------------------------------------------------------------------- */

/* The powers of ten that doubles represent exactly. */
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

bool decimal_starts_with_zero(const char *text) {
  text += *text == '-' || *text == '+';
  return text[0] == '0' && text[1] >= '0' && text[1] <= '9';
}
