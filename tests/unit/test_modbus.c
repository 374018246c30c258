/* The parts of Modbus without a daemon: parsing of requests, frames of serial lines, and networks.
 */
#include <arpa/inet.h>
#include <modbus.h>

#include "server/modbus/receiver.h"
#include "server/net/access.h"
#include "tests/unit/unit.h"

/* ---- requests ----------------------------------------------------------------------------- */

UNIT_TEST(lengths_are_told_by_the_beginning) {
  const uint8_t write[] = {16, 0, 0, 0, 2, 4, 0, 0, 0, 0};
  for (size_t bytes = 0; bytes <= sizeof write; bytes++) {
    assert_int_equal(modbus_pdu_bytes(write, bytes), bytes > 5 ? sizeof write : 0);
  }
  const uint8_t unknown[] = {99, 0, 0};
  assert_int_equal(modbus_pdu_bytes(unknown, 3), 0);
}

/* ---- serial lines ------------------------------------------------------------------------- */

static size_t close_frame(uint8_t *frame, size_t bytes) {
  const uint16_t sum = modbus_rtu_checksum(frame, bytes);
  frame[bytes] = (uint8_t)sum;
  frame[bytes + 1] = (uint8_t)(sum >> 8);
  return bytes + 2;
}

/* "123456789" is the usual input for checking an implementation of a checksum. */
UNIT_TEST(the_checksum_is_that_of_modbus) {
  assert_int_equal(modbus_rtu_checksum((const uint8_t *)"123456789", 9), 0x4b37);
}

static void check_frames(const uint8_t *bytes, size_t count, unsigned frames, size_t last,
                         size_t covered) {
  const struct modbus_rtu_frames found = modbus_rtu_split(bytes, count);
  assert_int_equal(found.count, frames);
  assert_int_equal(found.last, last);
  assert_int_equal(found.bytes, covered);
}

UNIT_TEST(a_frame_is_found) {
  uint8_t bytes[64] = {7, 3, 0, 0, 0, 1};
  const size_t count = close_frame(bytes, 6);
  assert_true(modbus_rtu_is_frame(bytes, count));
  check_frames(bytes, count, 1, 0, count);
  for (size_t some = 0; some < count; some++) {
    check_frames(bytes, some, 0, 0, 0);
  }
  bytes[2] ^= 1;
  check_frames(bytes, count, 0, 0, 0);
}

/* The frames are a request to another device, its answer, and a broadcast. Noise and a frame
 * follow. */
UNIT_TEST(frames_follow_each_other) {
  uint8_t bytes[64] = {9, 3, 0, 0, 0, 1};
  size_t at = close_frame(bytes, 6);
  const uint8_t answer[] = {9, 3, 2, 0, 5};
  memcpy(bytes + at, answer, sizeof answer);
  at += close_frame(bytes + at, sizeof answer);
  const uint8_t broadcast[] = {0, 6, 0, 0, 0, 1};
  memcpy(bytes + at, broadcast, sizeof broadcast);
  const size_t length = close_frame(bytes + at, sizeof broadcast);
  check_frames(bytes, at + length, 3, at, at + length);

  const uint8_t noise[] = {1, 2, 3};
  memcpy(bytes + at, noise, sizeof noise);
  memcpy(bytes + at + sizeof noise, broadcast, sizeof broadcast);
  const size_t behind = close_frame(bytes + at + sizeof noise, sizeof broadcast);
  check_frames(bytes, at + sizeof noise + behind, 2, 8, at);
}

/* The requests and answers of every function of the standard have their lengths. */
UNIT_TEST(frames_of_functions_that_are_not_served) {
  static const struct {
    uint8_t bytes[16];
    size_t count;
  } pdus[] = {
      {{7}, 1},           {{7, 0x6d}, 2},        {{8, 0, 0, 0xa5, 0x37}, 5},
      {{11}, 1},          {{11, 0, 0, 1, 8}, 5}, {{12}, 1},
      {{12, 2, 0, 0}, 4}, {{20, 3, 6, 0, 4}, 5}, {{21, 4, 6, 0, 4, 0}, 6},
      {{24, 4, 0xde}, 3}, {{24, 0, 2, 0, 0}, 5}, {{0x99, 2}, 2},
  };
  for (size_t i = 0; i < sizeof pdus / sizeof pdus[0]; i++) {
    uint8_t bytes[64] = {9};
    memcpy(bytes + 1, pdus[i].bytes, pdus[i].count);
    const size_t first = close_frame(bytes, 1 + pdus[i].count);
    const uint8_t request[] = {7, 6, 0, 0, 0, 1};
    memcpy(bytes + first, request, sizeof request);
    const size_t all = first + close_frame(bytes + first, sizeof request);
    check_frames(bytes, all, 2, first, all);
    struct modbus_request parsed;
    if (pdus[i].bytes[0] < 0x80) {
      assert_int_equal(modbus_pdu_parse(bytes + 1, pdus[i].count, &parsed),
                       MODBUS_EXCEPTION_ILLEGAL_FUNCTION);
    }
  }
}

/* ---- what is received from a line --------------------------------------------------------- */

enum { SILENCE_NS = 2000000 };

/* Gives bytes to the receiver. later_ns: how long after the last bytes they arrive. */
static void arrive(struct modbus_receiver *receiver, const uint8_t *bytes, size_t count,
                   uint64_t later_ns) {
  size_t room;
  uint8_t *at = modbus_receiver_room(receiver, &room);
  assert_true(room >= count);
  memcpy(at, bytes, count);
  modbus_receiver_arrived(receiver, count, receiver->arrived_ns + later_ns);
}

static size_t end(struct modbus_receiver *receiver) {
  struct modbus_burst burst;
  modbus_receiver_end(receiver, &burst);
  return burst.bytes;
}

/* A request in two pieces is found if the pause between them is short, as adapters make it. If the
 * pause is long, the pieces are no request, but a request behind them is found. */
UNIT_TEST(pauses_within_a_request) {
  uint8_t bytes[8] = {7, 6, 0, 0, 0, 1};
  const size_t count = close_frame(bytes, 6);
  struct modbus_receiver receiver = {.number = 7, .silence_ns = SILENCE_NS};
  for (size_t cut = 1; cut < count; cut++) {
    arrive(&receiver, bytes, cut, SILENCE_NS);
    assert_false(modbus_receiver_is_whole(&receiver));
    arrive(&receiver, bytes + cut, count - cut, SILENCE_NS);
    assert_true(modbus_receiver_is_whole(&receiver));
    assert_int_equal(end(&receiver), count);

    arrive(&receiver, bytes, cut, SILENCE_NS);
    assert_int_equal(end(&receiver), 0);
    arrive(&receiver, bytes + cut, count - cut, SILENCE_NS);
    assert_int_equal(end(&receiver), 0);

    arrive(&receiver, bytes, cut, SILENCE_NS);
    assert_int_equal(end(&receiver), 0);
    arrive(&receiver, bytes, count, SILENCE_NS);
    assert_int_equal(end(&receiver), count);
  }
}

/* The short silence ends an echo, and a request behind it: their last pieces alone. */
UNIT_TEST(a_request_behind_an_echo) {
  uint8_t bytes[15] = {7, 3, 2, 0, 0, [7] = 7, 6, 0, 0, 0, 1};
  const size_t echo = close_frame(bytes, 5), all = echo + close_frame(bytes + echo, 6);
  struct modbus_receiver receiver = {.number = 7, .silence_ns = SILENCE_NS};
  for (size_t cut = 1; cut < all; cut++) {
    assert_false(modbus_receiver_sent(&receiver, bytes, echo));
    arrive(&receiver, bytes, cut, 1);
    assert_int_equal(modbus_receiver_is_whole(&receiver), cut == echo);
    arrive(&receiver, bytes + cut, all - cut, 1);
    assert_true(modbus_receiver_is_whole(&receiver));
    assert_int_equal(end(&receiver), all - echo);
  }
}

/* Bytes behind noise are taken for a request only if there is a silence between them and the
 * noise. */
UNIT_TEST(a_request_begins_behind_silence) {
  const uint8_t noise[] = {0xff, 0x00, 0x17};
  uint8_t bytes[8] = {7, 6, 0, 0, 0, 1};
  const size_t count = close_frame(bytes, 6);
  struct modbus_receiver receiver = {.number = 7, .silence_ns = SILENCE_NS};
  for (uint64_t later_ns = SILENCE_NS - 1; later_ns <= SILENCE_NS; later_ns++) {
    arrive(&receiver, noise, sizeof noise, SILENCE_NS);
    arrive(&receiver, bytes, count, later_ns);
    struct modbus_burst burst;
    modbus_receiver_end(&receiver, &burst);
    assert_true(burst.bad);
    assert_int_equal(burst.bytes, later_ns == SILENCE_NS ? count : 0);
    modbus_receiver_reset(&receiver);
  }
}

/* A line without any silence costs no more memory. If all its bytes are frames, the request at
 * their end is found. */
UNIT_TEST(a_line_that_is_never_silent) {
  uint8_t other[8] = {9, 6, 0, 0, 0, 1}, mine[8] = {7, 6, 0, 0, 0, 1};
  close_frame(other, 6);
  close_frame(mine, 6);
  struct modbus_receiver receiver = {.number = 7, .silence_ns = SILENCE_NS};
  for (int i = 0; i < 1000; i++) {
    for (size_t k = 0; k < sizeof other; k += 4) {
      arrive(&receiver, other + k, 4, 1);
    }
  }
  arrive(&receiver, mine, sizeof mine, 1);
  assert_int_equal(end(&receiver), sizeof mine);
}

/* ---- networks ----------------------------------------------------------------------------- */

static bool allows(const char *network, const char *address) {
  struct options_list list = {.items = {network}, .count = network != NULL};
  struct access access;
  const char *wrong;
  assert_true(access_read(&list, &access_this_machine, &access, &wrong));
  struct sockaddr_in ipv4 = {.sin_family = AF_INET};
  struct sockaddr_in6 ipv6 = {.sin6_family = AF_INET6};
  if (inet_pton(AF_INET, address, &ipv4.sin_addr) == 1) {
    return access_allows(&access, (const struct sockaddr *)&ipv4);
  }
  assert_int_equal(inet_pton(AF_INET6, address, &ipv6.sin6_addr), 1);
  return access_allows(&access, (const struct sockaddr *)&ipv6);
}

UNIT_TEST(networks_allow_their_addresses) {
  const struct {
    const char *network;
    const char *address;
    bool allowed;
  } cases[] = {
      {NULL, "127.0.0.1", true},
      {NULL, "127.255.1.1", true},
      {NULL, "::1", true},
      {NULL, "10.0.0.1", false},
      {NULL, "fe80::1", false},
      {NULL, "::ffff:127.0.0.1", true},
      {"10.1.0.0/16", "10.1.255.255", true},
      {"10.1.0.0/16", "10.2.0.0", false},
      {"10.1.0.0/15", "10.0.0.0", true},
      {"10.1.2.3", "10.1.2.3", true},
      {"10.1.2.3", "10.1.2.2", false},
      {"0.0.0.0/0", "192.0.2.1", true},
      {"0.0.0.0/0", "2001:db8::1", false},
      {"::/0", "2001:db8::1", true},
      {"::/0", "192.0.2.1", false},
      {"2001:db8::/33", "2001:db8:7fff::", true},
      {"2001:db8::/33", "2001:db8:8000::", false},
      {"10.0.0.0/8", "::ffff:10.9.9.9", true},
  };
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    assert_int_equal(allows(cases[i].network, cases[i].address), cases[i].allowed);
  }
}

UNIT_TEST(what_is_no_network) {
  const char *const wrong[] = {
      "",       "localhost",      "10.0.0.0/33", "10.0.0.0/", "10.0.0.0/-1",
      "10.0.0", "2001:db8::/129", "10.0.0.0/8 ", "/8",        "10.0.0.0/8/8"};
  for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
    struct options_list list = {.items = {"10.0.0.0/8", wrong[i]}, .count = 2};
    struct access access;
    const char *item;
    assert_false(access_read(&list, &access_this_machine, &access, &item));
    assert_string_equal(item, wrong[i]);
  }
}
