/* The payloads of eval replies: no count wraps, and parts are as large as they may be. test_messages.py
 * has wrong requests and replies. */
#include "proto/eval.h"
#include "tests/unit/unit.h"

/* ---- replies ------------------------------------------------------------------------------ */

enum { ALL_QUANTITIES = (CORE_ARRAYS | CORE_OF_CHANNEL | CORE_QUANTITY_RADIUS) };

static bool has(unsigned wanted, enum core_quantity quantity) {
  return (wanted & quantity) != 0;
}

static unsigned array_count(unsigned wanted) {
  return (unsigned)__builtin_popcount(wanted & CORE_ARRAYS);
}

/* Returns the expected result of eval_reply_layout(), computed in 128 bits so that nothing wraps.
 */
static bool fits(unsigned evaluator, unsigned wanted, uint32_t channels, uint64_t count,
                 uint64_t max_bytes) {
  const unsigned __int128 array =
      ((unsigned __int128)count * core_evaluator_bytes(evaluator) + 7) / 8 * 8;
  const unsigned arrays = array_count(wanted);
  /* at most 2^35 arrays of 2^67 bytes: this fits into 128 bits */
  const unsigned __int128 bytes =
      40 + (8 + 24 * (unsigned)__builtin_popcount(wanted)) * (unsigned __int128)channels +
      array * (has(wanted, CORE_QUANTITY_RADIUS) + (unsigned __int128)arrays * channels);
  return bytes <= max_bytes;
}

static void assert_fits_as_it_should(unsigned evaluator, unsigned wanted, uint32_t channels,
                                     uint64_t count, uint64_t max_bytes) {
  eval_layout layout;
  const bool expected = fits(evaluator, wanted, channels, count, max_bytes);
  UNIT_FAIL_IF(
      eval_reply_layout(evaluator, wanted, channels, count, max_bytes, &layout) != expected,
      "evaluator %u wanted %u channels %u count %llu in %llu bytes: fits is %d", evaluator, wanted,
      channels, (unsigned long long)count, (unsigned long long)max_bytes, expected);
}

/* Returns quantities without the balance, whose shares have an array of their own. */
static unsigned random_wanted(uint64_t *random) {
  return (1 + (unsigned)unit_random_below(random, ALL_QUANTITIES)) &
         ~(unsigned)CORE_QUANTITY_BALANCE;
}

/* The counts lie on both sides of every limit at which a product could wrap. */
UNIT_TEST(layouts_do_not_wrap) {
  static const uint64_t limits[] = {4096,           UINT32_MAX,      (uint64_t)1 << 40,
                                    UINT64_MAX / 2, UINT64_MAX - 65, UINT64_MAX};
  static const uint32_t channels[] = {1, 2, 3, 5, 1u << 27, UINT32_MAX - 1, UINT32_MAX};
  uint64_t random = unit_seed();
  for (int i = 0; i < 200000; i++) {
    const unsigned evaluator = i % 2 ? CORE_EVALUATOR_F64 : CORE_EVALUATOR_F32;
    const unsigned wanted = random_wanted(&random);
    const uint32_t channel_count = channels[unit_random_below(&random, 7)];
    const uint64_t limit = limits[unit_random_below(&random, 6)];
    const unsigned arrays = array_count(wanted);
    const uint64_t all = has(wanted, CORE_QUANTITY_RADIUS) + (uint64_t)arrays * channel_count;
    /* counts near the largest one that fits, near a wrap, or random */
    const uint64_t largest = limit / (all > 0 ? all : 1) / core_evaluator_bytes(evaluator);
    const uint64_t bases[] = {largest, (uint64_t)1 << (58 + i % 6), unit_random(&random), 0};
    const uint64_t count = bases[i % 4] + unit_random_below(&random, 40) - 20;
    assert_fits_as_it_should(evaluator, wanted, channel_count, count, limit);
  }
}

/* eval_part_radii() returns the largest multiple of EVAL_PART_RADII that fits. */
UNIT_TEST(parts_are_as_large_as_they_may_be) {
  uint64_t random = unit_seed();
  size_t none = 0;
  for (int i = 0; i < 20000; i++) {
    const unsigned evaluator = i % 2 ? CORE_EVALUATOR_F64 : CORE_EVALUATOR_F32;
    const unsigned wanted = random_wanted(&random);
    const uint32_t channels = 1 + (uint32_t)unit_random_below(&random, 64);
    const uint64_t most = 4096 + unit_random_below(&random, i % 3 ? 1 << 20 : 1 << 14);
    const uint64_t radii = eval_part_radii(evaluator, wanted, channels, most);
    if (array_count(wanted) == 0 && !has(wanted, CORE_QUANTITY_RADIUS)) {
      assert_true(radii == UINT64_MAX);
      continue;
    }
    assert_int_equal(radii % EVAL_PART_RADII, 0);
    assert_true(fits(evaluator, wanted, channels, radii, most) || radii == 0);
    assert_false(fits(evaluator, wanted, channels, radii + EVAL_PART_RADII, most));
    none += radii == 0;
  }
  assert_true(none > 0);
  assert_true(eval_part_radii(CORE_EVALUATOR_F64, CORE_QUANTITY_ALBEDO, 200, 4096) == 0);
  assert_int_equal(eval_part_radii(CORE_EVALUATOR_F64, CORE_QUANTITY_R, 1, 4096), 256);
}
