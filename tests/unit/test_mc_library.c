/* dipole_mc() against a peer that follows a script: any number of progress reports at any time, and
 * answers that do not fit the request. */
#include <math.h>

#include "proto/mc.h"
#include "tests/unit/peer_scripts.h"
#include "tests/unit/unit.h"

enum { RINGS = 2, TABLE_BYTES = WIRE_BYTES_mc_reply + 24 + WIRE_BYTES_mc_energy + 6 * 8 };

static const dipole_mc_query query = {.medium = {0.1, 1, 0, 1.3},
                                      .thickness_mm = (double)INFINITY,
                                      .spacing = DIPOLE_LINEAR,
                                      .ring_count = RINGS,
                                      .radius_stop_mm = 2,
                                      .photons = 1000};

/* The behaviour of the peer. */
struct script {
  uint64_t progress; /* number of progress replies before the table */
  bool waits;        /* whether the peer waits for a cancel request before it sends the table */
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

static bool answer_cancel(int fd) {
  peer_frame cancel;
  uint8_t payload[WIRE_BYTES_cancel_reply];
  const wire_cancel_reply found = {.found = 1};
  if (!peer_receive(fd, &cancel)) {
    return false;
  }
  wire_put_cancel_reply(payload, &found);
  const bool sent = peer_send(fd, WIRE_TYPE_CANCEL | WIRE_REPLY, cancel.header.request_id, payload,
                              sizeof payload);
  free(cancel.payload);
  return sent;
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
  if (script->waits) {
    answer_cancel(fd);
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

/* Counts the calls of progress(), and says after how many to cancel. */
struct listener {
  uint64_t told, photons, enough;
};

static bool listen_to(void *context, const dipole_mc_progress *now) {
  struct listener *listener = context;
  assert_true(now->photons > listener->photons);
  listener->photons = now->photons;
  listener->told++;
  return listener->told < listener->enough;
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

/* Runs a job against a script. expected: DIPOLE_ERROR_NONE for a correct table, or the kind of the
 * error. */
static void run(struct script script, struct listener *listener, enum dipole_error_kind expected) {
  scripted_peer peer;
  dipole_mc_result *result = NULL;
  dipole_error error = {0};
  dipole_client *client = peer_begin(&peer, follow_script, &script);
  const bool good =
      dipole_mc(client, &query, listener != NULL ? listen_to : NULL, listener, &result, &error);
  assert_int_equal(good, expected == DIPOLE_ERROR_NONE);
  if (good) {
    assert_table(result);
    assert_true(dipole_ping(client, &error));
  } else {
    assert_int_equal(error.kind, expected);
    assert_false(dipole_ping(client, &error));
  }
  dipole_mc_result_free(result);
  peer_finish(&peer, client);
}

UNIT_TEST(tables_come_after_any_progress) {
  static const uint64_t counts[] = {0, 1, 2, 5000};
  for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++) {
    struct listener listener = {.enough = UINT64_MAX};
    run(honest(counts[i]), NULL, DIPOLE_ERROR_NONE);
    run(honest(counts[i]), &listener, DIPOLE_ERROR_NONE);
    assert_true(listener.told <= counts[i]); /* Older reports may be skipped. */
  }
}

UNIT_TEST(callers_can_cancel) {
  struct script script = honest(1);
  struct listener listener = {.enough = 1};
  script.waits = true;
  run(script, &listener, DIPOLE_ERROR_NONE);
  assert_int_equal(listener.told, 1);
}

UNIT_TEST(other_answers_are_refused) {
  struct script script = honest(0);
  script.last.albedo_count = 2;
  run(script, NULL, DIPOLE_ERROR_PROTOCOL);
  script = honest(0);
  script.last.ring_count = 1;
  run(script, NULL, DIPOLE_ERROR_PROTOCOL);
  script = honest(0);
  script.last.side_count = 2;
  run(script, NULL, DIPOLE_ERROR_PROTOCOL);
  script = honest(1);
  script.last.state = MC_STOPPED + 1;
  run(script, NULL, DIPOLE_ERROR_PROTOCOL);
  script = honest(1);
  script.last.state = MC_UNDER_WAY;
  run(script, NULL, DIPOLE_ERROR_PROTOCOL);
  for (size_t bytes = 0; bytes <= TABLE_BYTES + 64; bytes += 8) {
    script = honest(1);
    script.last_bytes = bytes;
    run(script, NULL, bytes == TABLE_BYTES ? DIPOLE_ERROR_NONE : DIPOLE_ERROR_PROTOCOL);
  }
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
