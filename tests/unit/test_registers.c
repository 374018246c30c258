/* The Modbus register map's list. tests/e2e/test_modbus_map.py and test_modbus_functions.py test which
 * registers can be read and written, test_modbus_eval.py doubles, texts and the mirror. */
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
