/* The payloads of invert requests and replies: the offsets of their parts. Refusals are tested in
 * tests/fuzz/fuzz.c and tests/e2e/test_invert.py. */
#include "proto/invert.h"

#include "tests/unit/unit.h"

enum { PAYLOAD_MAX = 1024 };

static size_t build(uint8_t *payload, uint64_t count) {
  const wire_invert_request fixed = {.model = CORE_MODEL_BETTER,
                                     .moments = CORE_MOMENTS_EXACT,
                                     .given = CORE_LENGTH_DIFFUSE,
                                     .medium_count = count,
                                     .g = 0.5,
                                     .eta = 1.4};
  wire_put_invert_request(payload, &fixed);
  for (uint64_t i = 0; i < 2 * count; i++) {
    const double number = 1.0 / (double)(i + 1);
    memcpy(payload + WIRE_BYTES_invert_request + i * sizeof number, &number, sizeof number);
  }
  return (size_t)schema_bytes(&schema_invert_request, &fixed);
}

UNIT_TEST(requests_are_taken_apart) {
  for (uint64_t count = 1; count < 20; count++) {
    _Alignas(8) uint8_t payload[PAYLOAD_MAX];
    invert_request request;
    const size_t bytes = build(payload, count);
    assert_int_equal(bytes, 32 + 16 * count);
    assert_int_equal(invert_request_parse(payload, bytes, &request).status, WIRE_STATUS_OK);
    assert_int_equal(request.fixed.medium_count, count);
    assert_true(request.fixed.g == 0.5 && request.fixed.eta == 1.4);
    for (uint64_t i = 0; i < count; i++) {
      assert_true(request.albedos[i] == 1.0 / (double)(i + 1));
      assert_true(request.lengths[i] == 1.0 / (double)(count + i + 1));
    }
  }
}

UNIT_TEST(replies_have_three_arrays) {
  uint8_t payload[PAYLOAD_MAX] = {0};
  const wire_invert_reply none = {.count = 0};
  for (uint64_t count = 0; count < 20; count++) {
    const wire_invert_reply fixed = {.part_count = 1, .count = count};
    const size_t whole = (size_t)invert_reply_bytes(count);
    wire_invert_reply got;
    wire_put_invert_reply(payload, &fixed);
    assert_int_equal(whole, WIRE_BYTES_invert_reply + 24 * count);
    for (enum invert_array i = INVERT_SIGMA_A; i < INVERT_ARRAYS; i++) {
      assert_int_equal(invert_array_offset(i, count), WIRE_BYTES_invert_reply + 8 * i * count);
    }
    for (size_t bytes = 0; bytes < whole + 48; bytes++) {
      assert_int_equal(invert_reply_parse(payload, bytes, &got), bytes == whole);
    }
    assert_int_equal(schema_part_values(&schema_invert_reply, &none, 1, whole), count);
    assert_int_equal(schema_part_values(&schema_invert_reply, &none, 1, whole + 23), count);
  }
  assert_int_equal(schema_part_values(&schema_invert_reply, &none, 1, 0), 0);
}

UNIT_TEST(replies_that_contradict_themselves_are_refused) {
  uint8_t payload[PAYLOAD_MAX] = {0};
  wire_invert_reply got;
  const wire_invert_reply wrong[] = {
      {.part_count = 0, .count = 2},
      {.part = 1, .part_count = 1, .count = 2},
      {.part_count = 1, .count = 2, .missing_count = 3},
      {.part_count = 1, .count = UINT64_MAX / 24 + 3},
  };
  for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
    wire_put_invert_reply(payload, &wrong[i]);
    assert_false(invert_reply_parse(payload, (size_t)invert_reply_bytes(2), &got));
  }
}
