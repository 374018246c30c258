/* dipole_mc() against a peer that follows a script: the table, progress after the end, and arguments
 * that are not sent. */
#include <math.h>

#include "proto/mc.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

enum { RINGS = 2, TABLE_BYTES = WIRE_BYTES_mc_reply + 24 + WIRE_BYTES_mc_energy + 6 * 8 };

static const dipole_mc_query query = {.medium = {0.1, 1, 0, 1.3},
                                      .spacing = DIPOLE_LINEAR,
                                      .ring_count = RINGS,
                                      .radius_stop_mm = 2,
                                      .photons = 1000};

/* The behaviour of the peer. */
struct script {
  uint64_t progress; /* number of progress replies before the table */
  bool after;        /* whether the peer wrongly sends progress after the table */
  wire_mc_reply last;
  size_t last_bytes;
};

static struct script honest(uint64_t progress) {
  return (struct script){.progress = progress,
                         .last = {.state = MC_PHOTONS_WALKED,
                                  .side_count = 1,
                                  .albedo_count = 1,
                                  .ring_count = RINGS,
                                  .photons = 4096,
                                  .error_total = 0.5},
                         .last_bytes = TABLE_BYTES};
}

static bool send_progress(int fd, uint64_t id, uint64_t number) {
  uint8_t payload[WIRE_BYTES_mc_reply];
  const wire_mc_reply reply = {.side_count = 1, .number = number, .photons = 100 * number};
  wire_put_mc_reply(payload, &reply);
  return peer_send(fd, WIRE_TYPE_MC | WIRE_REPLY, id, payload, sizeof payload);
}

/* Sends a table with the edges 1, 2, 3, photons 4, 5, values 6, 7 and errors 8, 9. */
static bool send_table(int fd, uint64_t id, const struct script *script) {
  _Alignas(8) uint8_t payload[TABLE_BYTES + 64] = {0};
  const wire_mc_energy energy = {.albedo = 0.25, .reflected = 0.5, .over = {0.125, 0}};
  mc_layout layout;
  assert_true(mc_reply_layout(1, 1, RINGS, &layout));
  wire_put_mc_reply(payload, &script->last);
  for (size_t i = 0; i < 3; i++) {
    ((double *)(void *)(payload + layout.edges_offset))[i] = 1 + (double)i;
  }
  wire_put_mc_energy(payload + layout.energies_offset, &energy);
  for (size_t i = 0; i < RINGS; i++) {
    ((uint64_t *)(void *)(payload + layout.photons_offset))[i] = 4 + i;
    ((double *)(void *)(payload + layout.rings_offset))[i] = 6 + (double)i;
    ((double *)(void *)(payload + layout.rings_offset))[RINGS + i] = 8 + (double)i;
  }
  return peer_send(fd, WIRE_TYPE_MC | WIRE_REPLY, id, payload, script->last_bytes);
}

static void follow_script(int fd, void *context) {
  const struct script *script = context;
  peer_frame request;
  if (!peer_say_hello(fd) || !peer_receive(fd, &request)) {
    return;
  }
  const uint64_t id = request.header.request_id;
  free(request.payload);
  for (uint64_t i = 1; i <= script->progress; i++) {
    send_progress(fd, id, i);
  }
  send_table(fd, id, script);
  if (script->after) {
    send_progress(fd, id, script->progress + 1);
  }
  while (peer_receive(fd, &request)) { /* until the client is gone */
    peer_send(fd, (uint16_t)(request.header.type | WIRE_REPLY), request.header.request_id,
              request.payload, request.header.payload_bytes);
    free(request.payload);
  }
}

static void assert_table(const dipole_mc_result *result) {
  assert_int_equal(result->end, DIPOLE_MC_PHOTONS);
  assert_int_equal(result->last.photons, 4096);
  assert_true(result->edges_mm[0] == 1 && result->edges_mm[2] == 3);
  assert_true(result->energies[0].albedo == 0.25 && result->energies[0].R.value == 0.5);
  assert_true(result->energies[0].over[DIPOLE_MC_REFLECTED].value == 0.125);
  assert_true(dipole_mc_values(result, 0, DIPOLE_MC_REFLECTED)[1] == 7);
  assert_true(dipole_mc_errors(result, 0, DIPOLE_MC_REFLECTED)[1] == 9);
  assert_int_equal(dipole_mc_photons(result, DIPOLE_MC_REFLECTED)[1], 5);
  assert_null(dipole_mc_values(result, 0, DIPOLE_MC_TRANSMITTED));
  assert_null(dipole_mc_errors(result, 1, DIPOLE_MC_REFLECTED));
  assert_null(dipole_mc_photons(result, DIPOLE_MC_TRANSMITTED));
}

UNIT_TEST(progress_after_the_end_is_a_fault) {
  struct script script = honest(1);
  script.after = true;
  scripted_peer peer;
  dipole_mc_result *result = NULL;
  dipole_error error = {0};
  dipole_client *client = peer_begin(&peer, follow_script, &script);
  /* The wrong report may arrive together with the table, or only during the ping. */
  const bool good = dipole_mc(client, &query, NULL, NULL, &result, &error);
  assert_true(good ? !dipole_ping(client, &error) : error.kind == DIPOLE_ERROR_PROTOCOL);
  assert_int_equal(error.kind, DIPOLE_ERROR_PROTOCOL);
  dipole_mc_result_free(result);
  peer_finish(&peer, client);
}

UNIT_TEST(wrong_arguments_are_not_sent) {
  struct script script = honest(0);
  scripted_peer peer;
  dipole_mc_result *result = NULL;
  dipole_error error = {0};
  dipole_client *client = peer_begin(&peer, follow_script, &script);
  dipole_mc_query wrong[3] = {query, query, query};
  wrong[0].albedo_count = 1;
  wrong[1].albedo_count = CORE_MC_ALBEDOS_MAX + 1;
  wrong[2].spacing = 65536;
  for (size_t i = 0; i < 3; i++) {
    assert_false(dipole_mc(client, &wrong[i], NULL, NULL, &result, &error));
    assert_int_equal(error.kind, DIPOLE_ERROR_ARGUMENT);
    assert_null(result);
  }
  assert_true(dipole_mc(client, &query, NULL, NULL, &result, NULL));
  assert_table(result);
  dipole_mc_result_free(result);
  peer_finish(&peer, client);
}
