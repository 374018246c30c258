/* The Modbus register map: its list, and that REGISTERS.md is current. tests/e2e/test_modbus_map.py
 * and test_modbus_functions.py test which registers can be read and written. */
#include "proto/registers.h"
#include "tests/unit/unit.h"

static uint16_t image[REGISTERS_END];

/* ---- the list ----------------------------------------------------------------------------- */

static const registers_block *block_of(unsigned address) {
  for (unsigned i = 0; i < REGISTERS_BLOCKS; i++) {
    if (address - registers_blocks[i].first < registers_blocks[i].length) {
      return &registers_blocks[i];
    }
  }
  return NULL;
}

UNIT_TEST(every_field_lies_in_one_block) {
  for (const registers_field *field = registers_fields; field->name != NULL; field++) {
    const unsigned end = field->address + field->count * registers_width(field->type);
    assert_non_null(block_of(field->address));
    assert_ptr_equal(block_of(field->address), block_of(end - 1));
    assert_true(registers_readable(field->address, end - field->address));
  }
}

UNIT_TEST(blocks_are_numbered_and_within_the_image) {
  for (unsigned i = 0; i < REGISTERS_BLOCKS; i++) {
    const registers_block *block = &registers_blocks[i];
    assert_int_equal(block->id, i + 1);
    assert_true(block->first + block->length <= REGISTERS_END);
    for (unsigned k = 0; k < i; k++) {
      assert_true(block->first >= registers_blocks[k].first + registers_blocks[k].length ||
                  registers_blocks[k].first >= block->first + block->length);
    }
    if (block->first / REGISTERS_MIRROR % 2 == 1) { /* The block is a mirror. */
      assert_int_equal(block_of(block->first - REGISTERS_MIRROR)->length, block->length);
    }
  }
}

/* One request of function 23 can write a whole job and read all its values. */
UNIT_TEST(a_job_fits_one_request) {
  assert_true(REGISTERS_AT_RADII + 2 * REGISTERS_RADII_MAX - REGISTERS_AT_COMMIT <= 121);
  assert_true(REGISTERS_AT_NOTES + 1 - REGISTERS_AT_STATUS <= 125);
  assert_int_equal(REGISTERS_AT_RADII - REGISTERS_AT_COMMIT, 20);
  assert_int_equal(REGISTERS_AT_R + 4 * 2 - REGISTERS_AT_STATUS, 20);
}

/* ---- defaults ----------------------------------------------------------------------------- */

UNIT_TEST(the_defaults_may_be_written) {
  registers_reset(image);
  uint8_t values[2 * 260];
  for (unsigned i = 0; i < 260; i++) {
    values[2 * i] = (uint8_t)(image[i] >> 8);
    values[2 * i + 1] = (uint8_t)image[i];
  }
  unsigned at;
  assert_int_equal(registers_check(0, 236, values, &at).status, WIRE_STATUS_OK);
  assert_int_equal(registers_check(0, 237, values, &at).status, WIRE_STATUS_BAD_ADDRESS);
  assert_int_equal(at, 236);
}

/* ---- values ------------------------------------------------------------------------------- */

UNIT_TEST(optional_values) {
  registers_reset(image);
  for (unsigned id = 1; id < CORE_PARAMETERS_END; id++) {
    assert_true(isnan(registers_optional(image, REGISTERS_PARAMETER_AT(id))));
  }
  registers_set_f32(image, REGISTERS_AT_THICKNESS, 2.5F);
  assert_true(registers_optional(image, REGISTERS_AT_THICKNESS) == 2.5);
}

UNIT_TEST(doubles_and_text) {
  registers_reset(image);
  registers_set_f64(image, REGISTERS_AT_ALBEDO_DOUBLE, 123456.0); /* words 40fe 2400 0000 0000 */
  assert_int_equal(image[REGISTERS_AT_ALBEDO_DOUBLE], 0x40fe);
  assert_int_equal(image[REGISTERS_AT_ALBEDO_DOUBLE + 1], 0x2400);
  registers_set_text(image, REGISTERS_AT_ERROR_TEXT, 40, "abc");
  assert_int_equal(image[REGISTERS_AT_ERROR_TEXT], 'a' << 8 | 'b');
  assert_int_equal(image[REGISTERS_AT_ERROR_TEXT + 1], 'c' << 8);
  assert_int_equal(image[REGISTERS_AT_ERROR_TEXT + 2], 0);
  uint8_t mirrored[2];
  registers_read(image, REGISTERS_AT_ERROR_TEXT + REGISTERS_MIRROR, 1, mirrored);
  assert_memory_equal(mirrored, "ab", 2);
}

UNIT_TEST(fields_of_requests_have_registers) {
  assert_int_equal(registers_of_field(&registers_jobs[REGISTERS_JOB_EVAL], "sigma_a", 0),
                   REGISTERS_AT_SIGMA_A);
  assert_int_equal(registers_of_field(&registers_jobs[REGISTERS_JOB_EVAL], "r", 3),
                   REGISTERS_AT_RADII + 6);
  assert_int_equal(registers_of_field(&registers_jobs[REGISTERS_JOB_EVAL], "thickness", 0),
                   REGISTERS_AT_THICKNESS);
  assert_int_equal(registers_of_field(&registers_jobs[REGISTERS_JOB_EVAL], "memory", 0),
                   REGISTERS_AT_COMMIT);
}

UNIT_TEST(inclusion_sees_the_mirror) {
  assert_true(registers_include(100, 14, REGISTERS_AT_COMMIT));
  assert_true(registers_include(2100, 1, REGISTERS_AT_COMMIT));
  assert_false(registers_include(101, 14, REGISTERS_AT_COMMIT));
  assert_false(registers_include(0, 100, REGISTERS_AT_COMMIT));
}
