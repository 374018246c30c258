/* The wire's text, headers and names. The target messages of tests/fuzz writes and reads every
 * structure; the examples of PROTOCOL.md hold their sizes; test_hello_and_statistics.py has the lists. */
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

/* ---- headers ------------------------------------------------------------------------------ */

static const wire_header good_header = {
    .magic = WIRE_MAGIC,
    .version = WIRE_VERSION,
    .type = WIRE_TYPE_EVAL,
    .request_id = 7,
    .payload_bytes = 64,
};

static void assert_header(wire_header header, uint64_t max_payload_bytes, enum wire_status status,
                          const char *field) {
  const wire_error error = wire_header_check(&header, max_payload_bytes);
  assert_int_equal(error.status, status);
  assert_string_equal(error.field, field);
  assert_int_equal(strlen(error.allowed) > 0, status != WIRE_STATUS_OK);
}

/* The first fault of a header counts, in this order: magic, version, length. */
UNIT_TEST(headers_are_checked) {
  static const struct {
    uint32_t magic;
    uint16_t version;
    uint32_t payload_bytes;
    uint64_t max_payload_bytes;
    enum wire_status status;
    const char *field;
  } rows[] = {
      {WIRE_MAGIC, WIRE_VERSION, 64, 64, WIRE_STATUS_OK, ""},
      {WIRE_MAGIC, WIRE_VERSION, 64, UINT64_MAX, WIRE_STATUS_OK, ""},
      {WIRE_MAGIC, WIRE_VERSION, 0, 0, WIRE_STATUS_OK, ""},
      {WIRE_MAGIC, WIRE_VERSION, UINT32_MAX - 7, UINT32_MAX, WIRE_STATUS_OK, ""},
      {WIRE_MAGIC, WIRE_VERSION, 64, 63, WIRE_STATUS_TOO_LARGE, "payload_bytes"},
      {WIRE_MAGIC, WIRE_VERSION, UINT32_MAX, 1024, WIRE_STATUS_TOO_LARGE, "payload_bytes"},
      {WIRE_MAGIC, 99, 65, 1024, WIRE_STATUS_BAD_VERSION, "version"},
      {WIRE_MAGIC, 99, 64, 63, WIRE_STATUS_BAD_VERSION, "version"},
      {WIRE_MAGIC, 0, 64, 1024, WIRE_STATUS_BAD_VERSION, "version"},
      {0, 99, 64, 1024, WIRE_STATUS_BAD_MAGIC, "magic"},
      {0x4449504c, WIRE_VERSION, 64, 1024, WIRE_STATUS_BAD_MAGIC, "magic"}, /* big-endian magic */
  };
  wire_header header = good_header;
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    header.magic = rows[i].magic;
    header.version = rows[i].version;
    header.payload_bytes = rows[i].payload_bytes;
    assert_header(header, rows[i].max_payload_bytes, rows[i].status, rows[i].field);
  }
  header = good_header;
  for (uint32_t rest = 1; rest < WIRE_ALIGNMENT; rest++) {
    header.payload_bytes = 64 + rest;
    assert_header(header, 1024, WIRE_STATUS_BAD_LENGTH, "payload_bytes");
  }
}

UNIT_TEST(the_magic_reads_as_text) {
  uint8_t bytes[WIRE_BYTES_header];
  wire_put_header(bytes, &good_header);
  assert_memory_equal(bytes, "DIPL", 4);
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
