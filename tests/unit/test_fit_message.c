/* The payloads of fit requests and replies: the offsets of their parts. Refusals are tested in
 * tests/fuzz and tests/e2e/test_fit.py. */
#include "proto/fit.h"

#include <math.h>

#include "proto/channels.h"
#include "tests/unit/unit.h"

enum { PAYLOAD_MAX = 8192 };

/* Writes a request whose values and errors are 1, 2, 3, ... Returns its bytes. */
static size_t build(uint8_t *payload, const core_fit_design *design, uint64_t set_count) {
  const fit_start start = {{.set_count = set_count, .residuals = 1},
                           {.model = CORE_MODEL_BETTER,
                            .moments = CORE_MOMENTS_EXACT,
                            .axis = CORE_FIT_AXIS_RADIUS,
                            .scale = (uint16_t)design->scale,
                            .reading_count = (uint32_t)design->count,
                            .parameter_count = 2,
                            .g = 0.5,
                            .eta = 1.4}};
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = 0.25;
  parameters.value[CORE_PARAMETER_DETECTOR_NA] = 0.22;
  schema_layout layout;
  schema_lay_out(&schema_fit_request, &start, UINT64_MAX, &layout, NULL);
  memcpy(payload, &start, sizeof start);
  channels_put_parameters(payload + layout.parts[FIT_PARAMETERS].at, &parameters);
  schema_put_part(payload, &layout, FIT_REFERENCE, &design->reference);
  schema_put_part(payload, &layout, FIT_AT, design->at);
  schema_put_part(payload, &layout, FIT_SOURCE, design->source_mm);
  uint8_t *at = schema_put_part(payload, &layout, FIT_DETECTOR, design->detector_mm);
  for (uint64_t i = 0; i < 2 * set_count * design->count; i++) {
    const double number = (double)(i + 1);
    memcpy(at + i * sizeof number, &number, sizeof number);
  }
  return (size_t)layout.payload_bytes;
}

UNIT_TEST(requests_are_taken_apart) {
  const double at[] = {1, 2, 3, 4}, source[] = {5, 6, 7, 8};
  for (unsigned scale = CORE_FIT_SCALE_ABSOLUTE; scale <= CORE_FIT_SCALE_REFERENCE; scale++) {
    for (uint64_t sets = 1; sets < 6; sets++) {
      _Alignas(8) uint8_t payload[PAYLOAD_MAX];
      const core_fit_design design = {.count = 4,
                                      .at = at,
                                      .source_mm = source,
                                      .scale = scale,
                                      .reference = {0.1, 0.2, 0.3, 0.4}};
      const size_t bytes = build(payload, &design, sets);
      fit_request request;
      fit_design read;
      assert_int_equal(fit_request_parse(payload, bytes, &request).status, WIRE_STATUS_OK);
      assert_int_equal(request.fixed.set_count, sets);
      assert_true(request.values[0] == 1 && request.errors[0] == 4.0 * (double)sets + 1);
      assert_true(request.errors[4 * sets - 1] == 8.0 * (double)sets);
      fit_design_read(request.design_bytes, &read);
      assert_int_equal(read.design.count, 4);
      assert_true(read.design.g == 0.5 && read.design.eta == 1.4 && read.design.scale == scale);
      assert_true(read.parameters.value[CORE_PARAMETER_TOLERANCE] == 0.25);
      assert_memory_equal(read.design.at, at, sizeof at);
      assert_memory_equal(read.design.source_mm, source, sizeof source);
      assert_true(read.design.detector_mm[3] == 0);
      /* The aperture is a parameter on the wire, and no parameter of the model. */
      assert_true(read.design.detector_na == 0.22);
      assert_true(isnan(read.parameters.value[CORE_PARAMETER_DETECTOR_NA]));
      assert_true(scale != CORE_FIT_SCALE_REFERENCE || read.design.reference.eta == 0.4);
      for (size_t wrong = 0; wrong < bytes; wrong += 8) {
        assert_int_not_equal(fit_request_parse(payload, wrong, &request).status, WIRE_STATUS_OK);
      }
    }
  }
}

UNIT_TEST(replies_have_a_structure_and_residuals_for_each_set) {
  uint8_t payload[PAYLOAD_MAX] = {0};
  for (uint32_t residuals = 0; residuals < 5; residuals += 4) {
    for (uint64_t count = 0; count < 20; count++) {
      const wire_fit_reply fixed = {.part_count = 1, .count = count, .reading_count = residuals};
      const size_t whole = (size_t)fit_reply_bytes(count, residuals);
      wire_fit_reply got;
      wire_put_fit_reply(payload, &fixed);
      assert_int_equal(fit_residuals_offset(count), WIRE_BYTES_fit_reply + 152 * count);
      assert_int_equal(whole, fit_residuals_offset(count) + 8 * residuals * count);
      for (size_t bytes = 0; bytes < whole + 200; bytes += 8) {
        assert_int_equal(fit_reply_parse(payload, bytes, &got), bytes == whole);
      }
      assert_int_equal(fit_part_sets(residuals, whole), count);
    }
  }
  assert_int_equal(fit_part_sets(4, 0), 0);
}
