/* The Modbus register map: its list, its checks, its mirror, and that REGISTERS.md is current. */
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
    assert_true(i == 0 ||
                block->first >= registers_blocks[i - 1].first + registers_blocks[i - 1].length);
    if (block->first >= REGISTERS_MIRROR) {
      assert_int_equal(block_of(block->first - REGISTERS_MIRROR)->length, block->length);
    }
  }
}

/* What one function 23 may write and read holds a whole job and its values. */
UNIT_TEST(a_job_fits_one_request) {
  assert_true(REGISTERS_AT_RADII + 2 * REGISTERS_RADII_MAX - REGISTERS_AT_COMMIT <= 121);
  assert_true(REGISTERS_AT_NOTES + 1 - REGISTERS_AT_STATUS <= 125);
  assert_int_equal(REGISTERS_AT_RADII - REGISTERS_AT_COMMIT, 20);
  assert_int_equal(REGISTERS_AT_R + 4 * 2 - REGISTERS_AT_STATUS, 20);
}

UNIT_TEST(reading_crosses_no_gap) {
  assert_true(registers_readable(0, 125)); /* scratch into input, which begins behind it */
  assert_true(registers_readable(219, 41));
  assert_false(registers_readable(219, 42));
  assert_false(registers_readable(260, 1));
  assert_false(registers_readable(299, 2));
  assert_true(registers_readable(REGISTERS_END - 1, 1));
  assert_false(registers_readable(REGISTERS_END - 1, 2));
  assert_false(registers_readable(65535, 125));
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

UNIT_TEST(self_tests_in_four_orders) {
  registers_reset(image);
  const uint16_t expected[] = {0x47f1, 0x2000, 0x2000, 0x47f1, 0xf147, 0x0020, 0x0020, 0xf147};
  assert_memory_equal(&image[REGISTERS_AT_SELF_TEST_ABCD], expected, sizeof expected);
}

UNIT_TEST(discovery_lists_the_blocks) {
  registers_reset(image);
  assert_int_equal(image[REGISTERS_AT_MAGIC], 0x4449);
  assert_int_equal(image[REGISTERS_AT_MAGIC + 1], 0x504c);
  const uint16_t *entry = &image[REGISTERS_AT_BLOCKS];
  unsigned blocks = 0;
  for (; *entry != 0xffff; entry += 3) {
    assert_true(registers_readable(entry[1], entry[2]));
    blocks++;
  }
  assert_int_equal(blocks, REGISTERS_BLOCKS);
}

/* ---- writing ------------------------------------------------------------------------------ */

static void put_float(uint8_t *at, float value, bool swapped) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  for (unsigned i = 0; i < 4; i++) {
    at[i ^ (swapped ? 2 : 0)] = (uint8_t)(bits >> (24 - 8 * i));
  }
}

static wire_error check_float(unsigned address, float value, unsigned *at) {
  uint8_t bytes[4];
  put_float(bytes, value, address >= REGISTERS_MIRROR);
  return registers_check(address, 2, bytes, at);
}

UNIT_TEST(a_float_is_written_on_both_sides) {
  registers_reset(image);
  for (unsigned side = 0; side <= REGISTERS_MIRROR; side += REGISTERS_MIRROR) {
    uint8_t bytes[4];
    const float value = side == 0 ? 1.5F : 0.3F;
    put_float(bytes, value, side > 0);
    registers_write(image, REGISTERS_AT_ETA + side, 2, bytes);
    assert_true(registers_f32(image, REGISTERS_AT_ETA) == value);
    assert_int_equal(image[REGISTERS_AT_ETA], image[REGISTERS_AT_ETA + REGISTERS_MIRROR + 1]);
    assert_int_equal(image[REGISTERS_AT_ETA + 1], image[REGISTERS_AT_ETA + REGISTERS_MIRROR]);
  }
  const uint8_t model[] = {0, 1};
  registers_write(image, REGISTERS_AT_MODEL + REGISTERS_MIRROR, 1, model);
  assert_int_equal(registers_u16(image, REGISTERS_AT_MODEL), 1);
}

UNIT_TEST(half_a_float_is_refused) {
  const uint8_t zeros[8] = {0};
  unsigned at;
  const struct {
    unsigned address, count, at;
  } halves[] = {
      {REGISTERS_AT_ETA, 1, REGISTERS_AT_ETA},
      {REGISTERS_AT_ETA + 1, 1, REGISTERS_AT_ETA},
      {REGISTERS_AT_ETA + 1, 2, REGISTERS_AT_ETA},
      {REGISTERS_AT_SIGMA_A, 3, REGISTERS_AT_SIGMA_S},
      {REGISTERS_AT_SIGMA_A + REGISTERS_MIRROR, 1, REGISTERS_AT_SIGMA_A},
  };
  for (size_t i = 0; i < sizeof halves / sizeof halves[0]; i++) {
    const wire_error error = registers_check(halves[i].address, halves[i].count, zeros, &at);
    assert_int_equal(error.status, WIRE_STATUS_BAD_ADDRESS);
    assert_int_equal(at, halves[i].at);
  }
}

UNIT_TEST(values_out_of_range_are_refused) {
  const struct {
    unsigned address;
    float value;
    bool good;
  } cases[] = {
      {REGISTERS_AT_ETA, 0, false},
      {REGISTERS_AT_ETA, 1000, true},
      {REGISTERS_AT_ETA, NAN, false},
      {REGISTERS_AT_ETA + REGISTERS_MIRROR, NAN, false},
      {REGISTERS_AT_ETA + REGISTERS_MIRROR, 1.3F, true},
      {REGISTERS_AT_G, 1, false},
      {REGISTERS_AT_G, -1, false},
      {REGISTERS_AT_G, 0.99999994F, true},
      {REGISTERS_AT_SIGMA_S, -1e-30F, false},
      {REGISTERS_AT_SIGMA_S, INFINITY, false},
      {REGISTERS_AT_RADII + 98, INFINITY, true},
      {REGISTERS_AT_RADII, -0.0F, true},
      {REGISTERS_AT_RADIUS_STOP, INFINITY, false},
      {REGISTERS_AT_PARAMETER_TOLERANCE, 0, true},
      {REGISTERS_AT_PARAMETER_TOLERANCE, -1, true},
      {REGISTERS_AT_PARAMETER_TOLERANCE, -0.5F, false},
      {REGISTERS_AT_PARAMETER_TOLERANCE, 1.5F, false},
      {REGISTERS_AT_PARAMETER_SURFACE_ALBEDO, 0, true},
  };
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    unsigned at;
    const wire_error error = check_float(cases[i].address, cases[i].value, &at);
    assert_int_equal(error.status, cases[i].good ? WIRE_STATUS_OK : WIRE_STATUS_BAD_VALUE);
    assert_true(cases[i].good || at == cases[i].address % REGISTERS_MIRROR);
  }
}

UNIT_TEST(ids_are_those_of_the_lists) {
  unsigned at;
  for (unsigned id = 0; id < 300; id++) {
    const uint8_t bytes[] = {(uint8_t)(id >> 8), (uint8_t)id};
    const bool model = id == 0 || core_choice_by_id(core_models, id) != NULL;
    const bool evaluator = core_choice_by_id(core_evaluators, id) != NULL;
    assert_int_equal(registers_check(REGISTERS_AT_MODEL, 1, bytes, &at).status == WIRE_STATUS_OK,
                     model);
    assert_int_equal(
        registers_check(REGISTERS_AT_EVALUATOR, 1, bytes, &at).status == WIRE_STATUS_OK, evaluator);
  }
}

UNIT_TEST(only_blocks_to_write_are_written) {
  const uint8_t zeros[4] = {0};
  const unsigned addresses[] = {240,  299,  300,  620,  700,           1200,
                                1999, 2000, 2099, 2300, REGISTERS_END, 65535};
  for (size_t i = 0; i < sizeof addresses / sizeof addresses[0]; i++) {
    unsigned at;
    assert_int_equal(registers_check(addresses[i], 1, zeros, &at).status, WIRE_STATUS_BAD_ADDRESS);
  }
}

/* ---- values ------------------------------------------------------------------------------- */

UNIT_TEST(optional_values) {
  registers_reset(image);
  for (unsigned id = 1; id < CORE_PARAMETERS_END; id++) {
    assert_true(isnan(registers_optional(image, id)));
  }
  registers_set_f32(image, REGISTERS_AT_PARAMETER_THICKNESS, 2.5F);
  assert_true(registers_optional(image, CORE_PARAMETER_THICKNESS) == 2.5);
}

UNIT_TEST(doubles_and_text) {
  registers_reset(image);
  registers_set_f64(image, REGISTERS_AT_ALBEDO_DOUBLE, 123456.0); /* 40fe 2400 0000 0000 */
  assert_int_equal(image[REGISTERS_AT_ALBEDO_DOUBLE], 0x40fe);
  assert_int_equal(image[REGISTERS_AT_ALBEDO_DOUBLE + 1], 0x2400);
  registers_set_text(image, REGISTERS_AT_ERROR_TEXT, 40, "abc");
  assert_int_equal(image[REGISTERS_AT_ERROR_TEXT], 'a' << 8 | 'b');
  assert_int_equal(image[REGISTERS_AT_ERROR_TEXT + 1], 'c' << 8);
  assert_int_equal(image[REGISTERS_AT_ERROR_TEXT + 2], 0);
  assert_int_equal(image[REGISTERS_AT_ERROR_TEXT + REGISTERS_MIRROR], 'a' << 8 | 'b');
}

UNIT_TEST(fields_of_requests_have_registers) {
  assert_int_equal(registers_of_field("sigma_a", 0), REGISTERS_AT_SIGMA_A);
  assert_int_equal(registers_of_field("r", 3), REGISTERS_AT_RADII + 6);
  assert_int_equal(registers_of_field("thickness", 0), REGISTERS_AT_PARAMETER_THICKNESS);
  assert_int_equal(registers_of_field("memory", 0), REGISTERS_AT_COMMIT);
}

UNIT_TEST(inclusion_sees_the_mirror) {
  assert_true(registers_include(100, 14, REGISTERS_AT_COMMIT));
  assert_true(registers_include(2100, 1, REGISTERS_AT_COMMIT));
  assert_false(registers_include(101, 14, REGISTERS_AT_COMMIT));
  assert_false(registers_include(0, 100, REGISTERS_AT_COMMIT));
}

UNIT_TEST(the_maps_tables_are_those_of_the_list) {
  unit_assert_tables("proto/REGISTERS.md", registers_describe);
}
