/* Histograms of durations: quantiles are within the bound that server/observe/latency.h states. */
#include <math.h>

#include "server/observe/latency.h"
#include "tests/unit/unit.h"

static struct histogram_sum merged(const struct histogram *histogram) {
  struct histogram_sum sum = {.count = 0};
  histogram_merge(&sum, histogram);
  return sum;
}

static uint64_t quantile_of(const struct histogram *histogram, double share) {
  const struct histogram_sum sum = merged(histogram);
  return histogram_quantile_ns(&sum, share);
}

/* Checks that a duration is found to within 1/64, half the width of a bucket relative to its
 * octave. */
static void assert_near(uint64_t found_ns, uint64_t ns) {
  assert_true(fabs((double)found_ns - (double)ns) <= (double)ns / 64 + 1);
}

UNIT_TEST(nothing_is_zero) {
  static struct histogram empty;
  const struct histogram_sum sum = merged(&empty);
  assert_int_equal(sum.count, 0);
  assert_int_equal(sum.most_ns, 0);
  assert_int_equal(histogram_quantile_ns(&sum, 0.5), 0);
  assert_int_equal(histogram_quantile_ns(&sum, 1), 0);
}

/* Each duration is found when the histogram also holds a longer one. Otherwise the longest duration
 * would limit the quantile. */
UNIT_TEST(each_duration_is_known) {
  uint64_t random = unit_seed();
  for (int i = 0; i < 3000; i++) {
    struct histogram one = {.sum_ns = 0};
    const uint64_t ns = (uint64_t)unit_random_log(&random, 1e3, 100e9);
    histogram_add(&one, ns, 3);
    histogram_add(&one, 130000000000, 1);
    assert_near(quantile_of(&one, 0.5), ns);
    assert_near(quantile_of(&one, 0.75), ns);
    assert_near(quantile_of(&one, 1), 130000000000);
    const struct histogram_sum sum = merged(&one);
    assert_int_equal(sum.sum_ns, 3 * ns + 130000000000);
    assert_int_equal(sum.count, 4);
    assert_int_equal(sum.most_ns, 130000000000);
  }
}

UNIT_TEST(ends_of_octaves) {
  for (unsigned octave = HISTOGRAM_LEAST_OCTAVE; octave <= HISTOGRAM_MOST_OCTAVE; octave++) {
    for (int64_t off = -1; off <= 1; off++) {
      static const struct histogram empty;
      struct histogram one = empty;
      const uint64_t ns = (UINT64_C(1) << octave) + (uint64_t)off;
      histogram_add(&one, ns, 1);
      histogram_add(&one, ns * 2, 1);
      assert_near(quantile_of(&one, 0.5), ns);
    }
  }
}

UNIT_TEST(durations_below_a_power_of_two) {
  for (unsigned octave = HISTOGRAM_LEAST_OCTAVE; octave <= HISTOGRAM_MOST_OCTAVE; octave++) {
    struct histogram two = {.sum_ns = 0};
    histogram_add(&two, (UINT64_C(1) << octave) - 1, 1);
    histogram_add(&two, UINT64_C(1) << octave, 1);
    const struct histogram_sum sum = merged(&two);
    assert_int_equal(histogram_below(&sum, octave), 1);
  }
}

/* Durations below and above all buckets are counted, and the longest one is exact. */
UNIT_TEST(very_short_and_very_long) {
  struct histogram both = {.sum_ns = 0};
  histogram_add(&both, 0, 1);
  histogram_add(&both, 5, 1);
  histogram_add(&both, UINT64_C(1) << 50, 1);
  assert_true(quantile_of(&both, 0.5) <= 32);
  assert_int_equal(quantile_of(&both, 0.9), UINT64_C(1) << 50);
  assert_int_equal(merged(&both).count, 3);
}

/* With the durations 1 to 1000 us, once each, a quantile is its rank in us. */
UNIT_TEST(quantiles_of_a_ramp) {
  static struct histogram ramp;
  for (uint64_t us = 1; us <= 1000; us++) {
    histogram_add(&ramp, us * 1000, 1);
  }
  assert_near(quantile_of(&ramp, 0.5), 500000);
  assert_near(quantile_of(&ramp, 0.9), 900000);
  assert_near(quantile_of(&ramp, 0.99), 990000);
  assert_near(quantile_of(&ramp, 0.999), 999000);
  assert_int_equal(quantile_of(&ramp, 1), 1000000);
  assert_near(quantile_of(&ramp, 1e-9), 1000);
  uint64_t last_ns = 0;
  for (double share = 0.001; share <= 1; share += 0.001) {
    const uint64_t ns = quantile_of(&ramp, share);
    assert_true(ns >= last_ns);
    last_ns = ns;
  }
}

UNIT_TEST(several_are_one) {
  static struct histogram parts[3];
  static struct histogram whole;
  uint64_t random = unit_seed();
  for (int i = 0; i < 10000; i++) {
    const uint64_t ns = (uint64_t)unit_random_log(&random, 1e3, 1e9);
    histogram_add(&parts[i % 3], ns, 1 + (uint64_t)i % 5);
    histogram_add(&whole, ns, 1 + (uint64_t)i % 5);
  }
  struct histogram_sum sum = {.count = 0};
  for (int i = 0; i < 3; i++) {
    histogram_merge(&sum, &parts[i]);
  }
  const struct histogram_sum expected = merged(&whole);
  assert_memory_equal(&sum, &expected, sizeof sum);
}
