/* The payload of a sample request, and the offsets of the arrays of its reply. */
#include "proto/sample.h"

#include "tests/unit/unit.h"

enum { PAYLOAD_MAX = 1024 };

typedef struct sample {
  wire_sample_request fixed;
  unsigned listed; /* how many numbers the payload lists */
  unsigned tail;   /* size of these numbers and their padding */
} sample;

static sample right(unsigned draw, unsigned count) {
  const bool list = draw == CORE_DRAW_LIST;
  return (sample){.fixed = {.model = CORE_MODEL_BETTER,
                            .evaluator = CORE_EVALUATOR_F32,
                            .moments = CORE_MOMENTS_EXACT,
                            .wanted = CORE_QUANTITY_RADIUS | CORE_QUANTITY_PDF,
                            .medium_count = 2,
                            .draw = (uint16_t)draw,
                            .parameter_count = 1,
                            .sample_count = count,
                            .sample_first = draw == CORE_DRAW_RANDOM ? 9 : 0,
                            .seed = list || draw == CORE_DRAW_REGULAR ? 0 : 5},
                  .listed = list ? count : 0,
                  .tail = list ? (count * 4 + 7) / 8 * 8 : 0};
}

static size_t build(uint8_t *payload, const sample *of) {
  const wire_medium medium = {0.1, 1, 0.5, 1.3};
  const wire_parameter parameter = {.parameter = CORE_PARAMETER_COS_IN, .value = 0.5};
  memset(payload, 0, PAYLOAD_MAX);
  wire_put_sample_request(payload, &of->fixed);
  uint8_t *at = payload + WIRE_BYTES_sample_request;
  for (unsigned i = 0; i < 2; i++, at += WIRE_BYTES_medium) {
    wire_put_medium(at, &medium);
  }
  wire_put_parameter(at, &parameter);
  at += WIRE_BYTES_parameter;
  for (unsigned i = 0; i < of->listed; i++) {
    const float u = (float)i / 16;
    memcpy(at + i * sizeof u, &u, sizeof u);
  }
  return (size_t)(at - payload) + of->tail;
}

UNIT_TEST(requests_are_taken_apart) {
  for (unsigned draw = CORE_DRAW_LIST; draw <= CORE_DRAW_RANDOM; draw++) {
    for (unsigned count = 0; count < 16; count++) {
      const sample of = right(draw, count);
      _Alignas(8) uint8_t payload[PAYLOAD_MAX];
      core_draw made;
      eval_request request;
      const size_t bytes = build(payload, &of);
      assert_int_equal(bytes, schema_bytes(&schema_sample_request, &of.fixed));
      assert_int_equal(sample_request_parse(payload, bytes, &made, &request).status,
                       WIRE_STATUS_OK);
      assert_true(made.rule == draw && made.count == count);
      assert_true(made.first == of.fixed.sample_first && made.seed == of.fixed.seed);
      assert_int_equal(request.fixed.model, CORE_MODEL_BETTER);
      assert_int_equal(request.fixed.evaluator, CORE_EVALUATOR_F32);
      assert_int_equal(request.fixed.wanted, of.fixed.wanted);
      assert_int_equal(request.fixed.medium_count, 2);
      assert_int_equal(request.fixed.radius_count, count);
      assert_ptr_equal(request.media, payload + WIRE_BYTES_sample_request);
      assert_true(request.parameters.value[CORE_PARAMETER_COS_IN] == 0.5);
      assert_int_equal(request.radii != NULL, draw == CORE_DRAW_LIST);
      for (unsigned i = 0; i < of.listed; i++) {
        assert_true(((const float *)request.radii)[i] == (float)i / 16);
      }
    }
  }
}

/* The layout is that of an eval reply, except that each channel has its own array of radii. */
UNIT_TEST(radii_are_an_array_of_each_channel) {
  const unsigned wanted =
      CORE_QUANTITY_R | CORE_QUANTITY_RADIUS | CORE_QUANTITY_PDF | CORE_QUANTITY_ALBEDO;
  eval_layout drawn, once;
  assert_true(eval_reply_layout(CORE_EVALUATOR_F64, wanted | EVAL_DRAWN, 3, 10, 4096, &drawn));
  assert_true(eval_reply_layout(CORE_EVALUATOR_F64, wanted, 3, 10, 4096, &once));
  assert_int_equal(drawn.arrays_per_channel, 3);
  assert_int_equal(once.arrays_per_channel, 2);
  assert_int_equal(drawn.payload_bytes, once.payload_bytes + 2 * 80);
  assert_int_equal(drawn.arrays_offset, eval_albedo_offset(3) + 3 * drawn.errors_per_channel *
                                                                    WIRE_BYTES_quantity_error);
  const enum core_quantity order[] = {CORE_QUANTITY_R, CORE_QUANTITY_RADIUS, CORE_QUANTITY_PDF};
  for (uint32_t i = 0; i < 9; i++) {
    assert_int_equal(eval_array_offset(&drawn, wanted | EVAL_DRAWN, i / 3, order[i % 3]),
                     drawn.arrays_offset + i * 80);
  }
  uint8_t payload[4096] = {0};
  const wire_eval_reply fixed = {.evaluator = CORE_EVALUATOR_F64,
                                 .wanted = (uint16_t)wanted,
                                 .channel_count = 3,
                                 .count = 10,
                                 .part_count = 1};
  wire_eval_reply got;
  eval_layout layout;
  wire_put_eval_reply(payload, &fixed);
  assert_true(eval_reply_parse(payload, drawn.payload_bytes, true, &got, &layout));
  assert_false(eval_reply_parse(payload, drawn.payload_bytes, false, &got, &layout));
  assert_false(eval_reply_parse(payload, once.payload_bytes, true, &got, &layout));
}
