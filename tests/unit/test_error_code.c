/* Errors stored in a byte are rounded up, never down, and by at most one step. */
#include <math.h>

#include "core/model_error.h"
#include "tests/unit/unit.h"

UNIT_TEST(codes_and_errors_belong_together) {
  for (unsigned code = 0; code < CORE_ERROR_CODE_ANY; code++) {
    const double error = core_error_of_code(code);
    assert_int_equal(core_error_code(error), code);
    assert_int_equal(core_error_code(error * (1 + 1e-12)), code + 1);
  }
  assert_true(core_error_of_code(0) == 1e-4);
  assert_true(core_error_of_code(CORE_ERROR_CODE_ANY - 1) > 100);
}

UNIT_TEST(errors_are_rounded_up) {
  uint64_t random = unit_seed();
  for (int i = 0; i < 10000; i++) {
    const double error = unit_random_log(&random, 1e-4, 100);
    const double kept = core_error_of_code(core_error_code(error));
    assert_true(kept >= error && kept <= error * (error < 0.8 ? 1.0401 : 1.2501));
  }
}

UNIT_TEST(what_is_out_of_range) {
  assert_int_equal(core_error_code(0), 0);
  assert_int_equal(core_error_code(1e-300), 0);
  assert_int_equal(core_error_code(1e9), CORE_ERROR_CODE_ANY);
  assert_int_equal(core_error_code((double)INFINITY), CORE_ERROR_CODE_ANY);
  assert_int_equal(core_error_code((double)NAN), CORE_ERROR_CODE_ANY);
  assert_true(isinf(core_error_of_code(CORE_ERROR_CODE_ANY)));
}
