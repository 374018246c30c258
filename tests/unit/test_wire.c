/* The wire's text and names. The target messages of tests/fuzz writes and reads every
 * structure; the examples of PROTOCOL.md hold their sizes; test_hello_and_statistics.py has the lists, and
 * test_messages.py wrong headers. */
#include "proto/wire.h"
#include "tests/unit/unit.h"

enum { GUARD = 0xa5 };

/* ---- text --------------------------------------------------------------------------------- */

UNIT_TEST(text_is_cut_and_padded) {
  wire_error error;
  memset(&error, GUARD, sizeof error);
  WIRE_SET_TEXT(error.field, "eta");
  assert_string_equal(error.field, "eta");
  for (size_t i = 3; i < sizeof error.field; i++) {
    assert_int_equal(error.field[i], 0);
  }
  WIRE_SET_TEXT(error.field, "0123456789012345678901234567890123456789");
  assert_string_equal(error.field, "01234567890123456789012345678901");
  WIRE_SET_TEXT(error.field, "");
  assert_string_equal(error.field, "");
}

/* A field that is full has no zero byte on the wire; the struct gets one. */
UNIT_TEST(full_text_needs_no_zero_on_the_wire) {
  uint8_t bytes[WIRE_BYTES_value];
  wire_value value;
  memset(bytes, 'x', sizeof bytes);
  memset(&value, GUARD, sizeof value);
  wire_get_value(bytes, &value);
  assert_int_equal(strlen(value.name), sizeof value.name - 1);
}

/* The bytes behind the zero byte of a text are dropped. */
UNIT_TEST(text_ends_at_its_zero_byte) {
  uint8_t bytes[WIRE_BYTES_value];
  wire_value value;
  memset(bytes, 'x', sizeof bytes);
  bytes[3] = 0;
  wire_get_value(bytes, &value);
  assert_string_equal(value.name, "xxx");
  wire_put_value(bytes, &value);
  assert_memory_equal(bytes, "xxx\0\0\0\0\0", 8);
}

/* ---- names -------------------------------------------------------------------------------- */

UNIT_TEST(statuses_and_types_have_names) {
#define WIRE_STATUS(code, IDENT, modbus_exception, status, number, listed, told)                   \
  assert_string_equal(wire_status_of(code)->name, listed);                                         \
  assert_string_equal(wire_status_of(code)->text, told);
#include "proto/statuses.def"
#undef WIRE_STATUS
#define WIRE_MESSAGE(type, IDENT, name, ...)                                                       \
  assert_string_equal(wire_type_name(type), name);                                                 \
  assert_string_equal(wire_type_name((type) | WIRE_REPLY), name);
#include "proto/messages.def"
  assert_string_equal(wire_type_name(WIRE_TYPE_ERROR), "error");
  assert_string_equal(wire_type_name(0), "unknown");
  assert_string_equal(wire_type_name(0x7abc), "unknown");
  assert_string_equal(wire_status_of(0xffff)->name, "unknown");
  assert_true(strlen(wire_status_of(0xffff)->text) > 0);
}
