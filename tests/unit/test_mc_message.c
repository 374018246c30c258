/* The payloads of mc requests and replies: the offsets of their parts. Refusals are tested in
 * tests/fuzz/fuzz.c and tests/e2e/test_mc.py. */
#include <math.h>

#include "proto/channels.h"
#include "proto/mc.h"
#include "tests/unit/unit.h"

enum { PAYLOAD_MAX = 1024 };

static size_t build(uint8_t *payload, uint32_t albedo_count) {
  const wire_mc_request fixed = {.spacing = CORE_SPACING_LINEAR,
                                 .albedo_count = (uint16_t)albedo_count,
                                 .ring_count = 3,
                                 .radius_stop = 2,
                                 .thickness = (double)INFINITY,
                                 .seed = 5,
                                 .photons = 6};
  const wire_medium medium = {0.1, 1, 0.5, 1.3};
  wire_put_mc_request(payload, &fixed);
  wire_put_medium(payload + WIRE_BYTES_mc_request, &medium);
  uint8_t *at = payload + WIRE_BYTES_mc_request + WIRE_BYTES_medium;
  for (uint32_t i = 0; i < albedo_count; i++) {
    const double albedo = 1.0 / (i + 1);
    memcpy(at + i * sizeof albedo, &albedo, sizeof albedo);
  }
  return (size_t)schema_bytes(&schema_mc_request, &fixed);
}

UNIT_TEST(requests_are_taken_apart) {
  for (uint32_t albedos = 0; albedos <= CORE_MC_ALBEDOS_MAX; albedos++) {
    uint8_t payload[PAYLOAD_MAX];
    mc_request request;
    const size_t bytes = build(payload, albedos);
    assert_int_equal(bytes, 96 + 8 * albedos);
    assert_int_equal(mc_request_parse(payload, bytes, &request).status, WIRE_STATUS_OK);
    assert_int_equal(request.fixed.seed, 5);
    assert_int_equal(request.fixed.photons, 6);
    assert_true(request.medium.g == 0.5 && isinf(request.fixed.thickness));
    for (uint32_t i = 0; i < albedos; i++) {
      assert_true(request.albedo[i] == 1.0 / (i + 1));
    }
  }
}

/* Parameters follow the albedos. */
UNIT_TEST(requests_may_have_parameters) {
  for (uint32_t albedos = 0; albedos <= CORE_MC_ALBEDOS_MAX; albedos += 8) {
    uint8_t payload[PAYLOAD_MAX];
    mc_request request;
    const size_t before = build(payload, albedos);
    core_parameters parameters = core_parameters_none();
    parameters.value[CORE_PARAMETER_PHASE] = CORE_PHASE_MODIFIED;
    parameters.value[CORE_PARAMETER_PHASE_SHARE] = 0.75;
    const size_t bytes = before + channels_put_parameters(payload + before, &parameters);
    assert_int_equal(bytes, before + 2 * WIRE_BYTES_parameter);
    assert_int_equal(mc_request_parse(payload, bytes, &request).status, WIRE_STATUS_OK);
    assert_true(request.parameters.value[CORE_PARAMETER_PHASE] == CORE_PHASE_MODIFIED);
    assert_true(request.parameters.value[CORE_PARAMETER_PHASE_SHARE] == 0.75);
    assert_true(isnan(request.parameters.value[CORE_PARAMETER_PHASE_G]));
    assert_int_equal(mc_request_parse(payload, bytes - 8, &request).status, WIRE_STATUS_BAD_LENGTH);
  }
}

/* The arrays lie one behind the other, and fill the payload. */
UNIT_TEST(tables_are_laid_out_without_gaps) {
  for (uint32_t i = 0; i < 64; i++) {
    const uint32_t sides = 1 + i % 2, albedos = 1 + i / 2 % 16, rings = 1 + i * 65;
    mc_layout layout;
    assert_true(mc_reply_layout(sides, albedos, rings, &layout));
    assert_int_equal(layout.edges_offset, WIRE_BYTES_mc_reply);
    size_t at = layout.edges_offset + 8 * (rings + 1);
    assert_int_equal(layout.energies_offset, at);
    at += (size_t)albedos * WIRE_BYTES_mc_energy;
    for (uint32_t side = 0; side < sides; side++, at += 8 * rings) {
      assert_int_equal(mc_photons_offset(&layout, rings, side), at);
    }
    for (uint32_t albedo = 0; albedo < albedos; albedo++) {
      for (uint32_t side = 0; side < sides; side++, at += 16 * rings) {
        assert_int_equal(mc_rings_offset(&layout, sides, rings, albedo, side, false), at);
        assert_int_equal(mc_rings_offset(&layout, sides, rings, albedo, side, true),
                         at + 8 * rings);
      }
    }
    assert_int_equal(layout.payload_bytes, at);
  }
}

UNIT_TEST(counts_out_of_range_have_no_layout) {
  mc_layout layout;
  assert_true(mc_reply_layout(2, CORE_MC_ALBEDOS_MAX, CORE_MC_RINGS_MAX, &layout));
  assert_false(mc_reply_layout(0, 1, 1, &layout));
  assert_false(mc_reply_layout(3, 1, 1, &layout));
  assert_false(mc_reply_layout(1, 0, 1, &layout));
  assert_false(mc_reply_layout(1, CORE_MC_ALBEDOS_MAX + 1, 1, &layout));
  assert_false(mc_reply_layout(1, 1, 0, &layout));
  assert_false(mc_reply_layout(1, 1, CORE_MC_RINGS_MAX + 1, &layout));
  assert_false(mc_reply_layout(UINT32_MAX, UINT32_MAX, UINT32_MAX, &layout));
}

UNIT_TEST(replies_have_the_shape_that_they_announce) {
  uint8_t payload[PAYLOAD_MAX] = {0};
  wire_mc_reply fixed = {.state = MC_UNDER_WAY, .side_count = 1, .number = 3}, parsed;
  mc_layout layout;
  wire_put_mc_reply(payload, &fixed);
  assert_true(mc_reply_parse(payload, WIRE_BYTES_mc_reply, &parsed, &layout));
  assert_int_equal(parsed.number, 3);
  assert_false(mc_reply_parse(payload, WIRE_BYTES_mc_reply - 8, &parsed, &layout));
  assert_false(mc_reply_parse(payload, WIRE_BYTES_mc_reply + 8, &parsed, &layout));
  fixed.state = MC_CANCELLED;
  wire_put_mc_reply(payload, &fixed);
  assert_false(mc_reply_parse(payload, WIRE_BYTES_mc_reply, &parsed, &layout));
  fixed.albedo_count = 1;
  fixed.ring_count = 2;
  wire_put_mc_reply(payload, &fixed);
  const size_t right = WIRE_BYTES_mc_reply + 3 * 8 + WIRE_BYTES_mc_energy + 2 * 8 + 4 * 8;
  for (size_t bytes = 0; bytes <= PAYLOAD_MAX; bytes += 8) {
    assert_int_equal(mc_reply_parse(payload, bytes, &parsed, &layout), bytes == right);
  }
}
