/* Shortest decimals: they read back to the same bits, and no shorter one does. */
#include <math.h>

#include "proto/decimal.h"
#include "tests/unit/unit.h"

enum { RANDOM_VALUES = 200000 };

static double of_bits(uint64_t bits) {
  double value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

/* Returns the number of digits from the first to the last that is not 0. */
static int digits_in(const char *text) {
  int count = 0, zeros = 0;
  for (; *text != '\0' && *text != 'e'; text++) {
    if (*text == '0' && count > 0) {
      zeros++;
    } else if (*text >= '1' && *text <= '9') {
      count += zeros + 1;
      zeros = 0;
    }
  }
  return count;
}

/* Of the decimals with as many digits, printf() writes the nearest; with fewer, none may read back.
 * Below a power of two, the next decimal above the nearest with fewer digits may read back. */
static void check(double value) {
  char text[DECIMAL_BYTES], other[64];
  const size_t length = decimal_write(value, text);
  assert_int_equal(length, strlen(text));
  const double back = strtod(text, NULL);
  assert_memory_equal(&back, &value, sizeof value);
  const int digits = digits_in(text);
  snprintf(other, sizeof other, "%.*e", digits - 1, value);
  int exponent;
  if (strtod(other, NULL) == value) {
    assert_true(fabsl(strtold(text, NULL) - (long double)value) <=
                fabsl(strtold(other, NULL) - (long double)value) * (1 + 1e-3L));
  } else {
    assert_true(frexp(fabs(value), &exponent) == 0.5);
  }
  if (digits > 1) {
    snprintf(other, sizeof other, "%.*e", digits - 2, value);
    assert_true(strtod(other, NULL) != value);
  }
}

UNIT_TEST(known_texts) {
  static const struct {
    double value;
    const char *text;
  } known[] = {{0.1, "0.1"},
               {0.032, "0.032"},
               {1e-9, "1e-9"},
               {123000, "123000"},
               {1e23, "1e23"},
               {-0.0, "-0"},
               {5e-324, "5e-324"},
               {12.5, "12.5"},
               {1.7976931348623157e308, "1.7976931348623157e308"},
               {0.00123, "0.00123"},
               {-2.5e-7, "-2.5e-7"},
               {9007199254740993, "9007199254740992"},
               {(double)INFINITY, "inf"},
               {-(double)INFINITY, "-inf"},
               {(double)NAN, "nan"}};
  char text[DECIMAL_BYTES];
  for (size_t i = 0; i < sizeof known / sizeof known[0]; i++) {
    decimal_write(known[i].value, text);
    assert_string_equal(text, known[i].text);
  }
}

UNIT_TEST(powers_of_two) {
  for (int exponent = -1074; exponent < 1024; exponent++) {
    check(ldexp(1, exponent));
    check(nextafter(ldexp(1, exponent), INFINITY));
  }
}

UNIT_TEST(random_values) {
  uint64_t random = unit_seed();
  for (int i = 0; i < RANDOM_VALUES; i++) {
    const uint64_t bits = unit_random(&random);
    const double any = of_bits(bits);
    if (isfinite(any)) {
      check(any);
    }
    check((double)(bits >> 11) * 0x1p-53 + 0x1p-60);
    check((double)(float)((double)(bits >> 40) * 1e-3 + 1e-6));
    check((double)(bits % 100000 + 1) / 1000);
  }
}

UNIT_TEST(single_precision) {
  uint64_t random = unit_seed();
  for (int i = 0; i < RANDOM_VALUES; i++) {
    const uint32_t bits = (uint32_t)unit_random(&random);
    char text[DECIMAL_BYTES], other[64];
    float value;
    memcpy(&value, &bits, sizeof value);
    if (!isfinite(value)) {
      continue;
    }
    decimal_write_single(value, text);
    const float back = strtof(text, NULL);
    assert_memory_equal(&back, &value, sizeof value);
    const int digits = digits_in(text);
    snprintf(other, sizeof other, "%.*e", digits > 1 ? digits - 2 : 0, (double)value);
    assert_true(digits < 2 || strtof(other, NULL) != value);
  }
}

/* Whatever strtod() takes as a whole and in decimal digits is that number; all else is refused. */
UNIT_TEST(texts_are_read_as_by_strtod) {
  static const char letters[] = "0123456789..eeE+-";
  static const char *const refused[] = {"", " 1", "1 ", "0x10", "nan(1)", "1e999", "infi", "1,5"};
  uint64_t random = unit_seed();
  double value;
  for (size_t i = 0; i < sizeof refused / sizeof refused[0]; i++) {
    assert_false(decimal_read(refused[i], &value));
  }
  for (int i = 0; i < RANDOM_VALUES; i++) {
    char text[8] = {0}, *end;
    for (size_t k = 0, length = 1 + unit_random_below(&random, 7); k < length; k++) {
      text[k] = letters[unit_random_below(&random, sizeof letters - 1)];
    }
    const double expected = strtod(text, &end);
    const bool good = end > text && *end == '\0' && isfinite(expected);
    assert_int_equal(decimal_read(text, &value), good);
    assert_true(!good || memcmp(&value, &expected, sizeof value) == 0);
  }
}
