/* The targets for Modbus: `modbus` (TCP) and `rtu`. */
#include <modbus.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

#include "server/modbus/connection.h"
#include "server/modbus/receiver.h"
#include "tests/fuzz/daemon.h"

static struct modbus_units *units;

void fuzz_modbus_start(void) {
  fuzz_daemon_start();
  units = modbus_units_new(&fuzz_server);
  worker_give(&fuzz_worker, &units->client);
  fuzz_daemon_run(UV_RUN_NOWAIT);
}

static void check_pdu(const uint8_t *request, size_t request_bytes, const uint8_t *reply,
                      size_t bytes) {
  static const uint8_t exact_bytes[] = {[1] = 5, 5, 5, 5, 5, 5, [17] = 1, [22] = 7};
  CHECK(bytes >= 2 && bytes <= MODBUS_PDU_MAX);
  CHECK(reply[0] == request[0] || (reply[0] == (request[0] | 0x80) && bytes == 2));
  CHECK(reply[0] >= sizeof exact_bytes || exact_bytes[reply[0]] == 0 ||
        exact_bytes[reply[0]] == request_bytes);
}

/* Checks the replies to a stream, which come in its order. The daemon closes the connection after
 * bytes that are no frame. */
static void check_modbus(const uint8_t *at, size_t left, const struct fuzz_bytes *answers) {
  const uint8_t *reply = answers->bytes;
  size_t rest = answers->count;
  while (left >= 8 && at[2] == 0 && at[3] == 0 && at[4] == 0 && at[5] >= 2 && at[5] <= 254 &&
         at[7] < 0x80 && left >= 6u + at[5]) {
    CHECK(rest >= 8 && memcmp(reply, at, 2) == 0 && reply[6] == at[6] && reply[4] == 0);
    const size_t bytes = 6 + (size_t)reply[5];
    CHECK(rest >= bytes);
    check_pdu(at + 7, at[5] - 1u, reply + 7, bytes - 7);
    reply += bytes;
    rest -= bytes;
    left -= 6u + at[5];
    at += 6 + at[5];
  }
  CHECK(rest == 0);
}

/* The target for Modbus TCP with its socket. The first two bytes of an input have the meaning that
 * they have for fuzz_connection(). */
void fuzz_modbus(const uint8_t *data, size_t size) {
  int fds[2];
  struct fuzz_bytes answers = {0};
  if (size < 3) {
    return;
  }
  CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, fds) == 0);
  struct modbus_connection *client = modbus_connection_new(units, fds[0], NULL, ROLE_ALL);
  stats_add(&fuzz_server.stats, STATS_MODBUS_CONNECTIONS_OPEN, 1);
  worker_give(&fuzz_worker, &client->transport.client);
  struct fuzz_delivery delivery = fuzz_delivery_begin(data, 1);
  delivery.at = data + 2;
  delivery.left = size - 2;
  fuzz_daemon_talk(fds[1], &delivery, data[1], &answers);
  if (!(data[1] & 1)) {
    check_modbus(data + 2, size - 2, &answers);
  }
  while (units->users > 0) {
    fuzz_daemon_run(UV_RUN_ONCE);
  }
  modbus_units_reset(units); /* each input finds them as after a start */
  free(answers.bytes);
}

/* A serial line without a terminal (server/modbus/line.c). */
struct serial {
  struct client client;
  struct modbus_receiver receiver;
  bool echoes; /* whether the adapter returns the bytes that are written to it */
  uint64_t now_ns;
};

static void arrive_serial(struct serial *line, const uint8_t *bytes, size_t count) {
  while (count > 0) {
    size_t room;
    uint8_t *at = modbus_receiver_room(&line->receiver, &room);
    CHECK(room > 0);
    room = count < room ? count : room;
    memcpy(at, bytes, room);
    modbus_receiver_arrived(&line->receiver, room, line->now_ns);
    bytes += room;
    count -= room;
  }
}

static void send_serial(struct serial *line, uint8_t *frame, size_t pdu_bytes) {
  const size_t bytes = 3 + pdu_bytes;
  frame[0] = 1;
  const uint16_t sum = modbus_rtu_checksum(frame, 1 + pdu_bytes);
  frame[1 + pdu_bytes] = (uint8_t)sum;
  frame[2 + pdu_bytes] = (uint8_t)(sum >> 8);
  const bool probing = modbus_receiver_sent(&line->receiver, frame, bytes);
  arrive_serial(line, frame, line->echoes && probing ? 1 : 0);
  if (probing) {
    modbus_receiver_probed(&line->receiver);
  }
  arrive_serial(line, frame + probing, line->echoes ? bytes - probing : 0);
}

static void answer_serial(struct serial *line, const struct modbus_burst *burst) {
  uint8_t frame[MODBUS_RTU_MAX];
  const size_t bytes = burst->bytes - 3;
  struct modbus_unit *unit = NULL;
  CHECK(modbus_rtu_is_frame(burst->request, burst->bytes) && burst->request[0] <= 1);
  uint8_t *pdu = fuzz_copy(burst->request + 1, bytes);
  if (burst->request[0] == 0 && (modbus_pdu_roles(pdu[0]) & ROLE_WRITE) == 0) {
    free(pdu);
    return;
  }
  size_t replied_bytes =
      modbus_carry_out(units, &line->client, ROLE_ALL, 1, pdu, bytes, frame + 1, &unit);
  if (unit != NULL && replied_bytes == 0) {
    batch_finish(&fuzz_worker.context.batch, &fuzz_server.stats);
    units->client.kind->finish(&units->client);
    CHECK(unit->awaited == NULL);
    replied_bytes = modbus_late_reply(unit, pdu, bytes, frame + 1);
  }
  CHECK(replied_bytes > 0);
  if (burst->request[0] == 1) {
    check_pdu(pdu, bytes, frame + 1, replied_bytes);
    send_serial(line, frame, replied_bytes);
  }
  free(pdu);
}

static void on_serial_finish(struct client *client) {
  (void)client;
}

/* The bits of a byte that say how a piece arrives. */
enum { WITH_CHECKSUM = 1, AFTER_A_PAUSE = 2, BEFORE_A_SILENCE = 4, WITH_ECHO = 8 };

/* The target for Modbus RTU. An input is a row of pieces: how a piece arrives, its length, its
 * bytes. */
void fuzz_rtu(const uint8_t *data, size_t size) {
  static const struct client_kind kind = {.finish = on_serial_finish};
  struct serial line = {.client = {.kind = &kind, .worker = &fuzz_worker},
                        .receiver = {.number = 1, .silence_ns = 1000}};
  while (size >= 2) {
    const unsigned how = data[0];
    const size_t length = data[1] < size - 2 ? data[1] : size - 2;
    const uint16_t sum = modbus_rtu_checksum(data + 2, length);
    const uint8_t checksum[] = {(uint8_t)sum, (uint8_t)(sum >> 8)};
    line.now_ns += how & AFTER_A_PAUSE ? line.receiver.silence_ns : 1;
    line.echoes = how & WITH_ECHO;
    arrive_serial(&line, data + 2, length);
    arrive_serial(&line, checksum, how & WITH_CHECKSUM ? sizeof checksum : 0);
    modbus_receiver_is_whole(&line.receiver);
    if (how & BEFORE_A_SILENCE) {
      struct modbus_burst burst;
      modbus_receiver_end(&line.receiver, &burst);
      if (burst.bytes > 0) {
        answer_serial(&line, &burst);
      }
    }
    data += 2 + length;
    size -= 2 + length;
  }
  modbus_units_reset(units); /* each input finds them as after a start */
}
