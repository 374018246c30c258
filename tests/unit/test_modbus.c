/* What Modbus is made of, without a daemon: requests taken apart, frames of serial lines, networks.
 */
#include <arpa/inet.h>
#include <modbus.h>

#include "server/modbus/access.h"
#include "server/modbus/codec.h"
#include "tests/unit/unit.h"

/* ---- requests ----------------------------------------------------------------------------- */

UNIT_TEST(requests_are_taken_apart) {
  const uint8_t pdu[] = {23, 1, 44, 0, 8, 0, 100, 0, 2, 4, 1, 2, 3, 4};
  struct modbus_request request;
  assert_int_equal(modbus_pdu_parse(pdu, sizeof pdu, &request), 0);
  assert_int_equal(request.function, 23);
  assert_int_equal(request.address, 300);
  assert_int_equal(request.count, 8);
  assert_int_equal(request.write_address, 100);
  assert_int_equal(request.write_count, 2);
  assert_ptr_equal(request.values, pdu + 10);
}

/* For random bytes: a request that is accepted has the length and counts that the codec relies
 * on. */
UNIT_TEST(what_is_let_through_is_whole) {
  uint64_t random = unit_seed();
  size_t passed = 0;
  for (int i = 0; i < 300000; i++) {
    uint8_t pdu[MODBUS_PDU_MAX];
    static const uint8_t functions[] = {1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23, 43};
    unit_random_bytes(&random, pdu, sizeof pdu);
    pdu[0] = functions[unit_random_below(&random, sizeof functions)];
    pdu[3] = pdu[0] == 5 ? 0xff * (pdu[3] & 1) : 0; /* counts are small, */
    pdu[4] = pdu[0] == 5 ? 0 : pdu[4];
    pdu[7] = 0;
    pdu[5] = pdu[0] == 15 ? (uint8_t)((pdu[4] + 7) / 8) : pdu[0] == 16 ? 2 * pdu[4] : pdu[5];
    pdu[9] = 2 * pdu[8]; /* and fit, more often than not */
    const size_t length = modbus_pdu_bytes(pdu, sizeof pdu);
    const size_t bytes =
        unit_random_below(&random, 4) == 0 ? 1 + unit_random_below(&random, sizeof pdu) : length;
    if (bytes > sizeof pdu) {
      continue;
    }
    struct modbus_request request;
    if (modbus_pdu_parse(pdu, bytes, &request) != 0) {
      continue;
    }
    passed++;
    assert_int_equal(bytes, length);
    assert_true(request.count <= 2000 && request.write_count <= 123);
    if (request.values != NULL) {
      assert_true(request.values + 2 * request.write_count == pdu + bytes);
    }
    if (pdu[0] == 15) {
      assert_true(6 + (request.count + 7) / 8 == bytes);
    }
  }
  assert_true(passed > 1000);
}

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

/* "123456789" is what everybody checks a checksum with. */
UNIT_TEST(the_checksum_is_that_of_modbus) {
  assert_int_equal(modbus_rtu_checksum((const uint8_t *)"123456789", 9), 0x4b37);
}

UNIT_TEST(a_request_is_found) {
  uint8_t bytes[64] = {7, 3, 0, 0, 0, 1};
  const size_t count = close_frame(bytes, 6);
  size_t begin;
  assert_true(modbus_rtu_is_frame(bytes, count));
  assert_int_equal(modbus_rtu_find(bytes, count, 7, &begin), count);
  assert_int_equal(begin, 0);
  assert_int_equal(modbus_rtu_find(bytes, count, 8, &begin), 0);
  for (size_t some = 0; some < count; some++) {
    assert_int_equal(modbus_rtu_find(bytes, some, 7, &begin), 0);
  }
  bytes[2] ^= 1;
  assert_int_equal(modbus_rtu_find(bytes, count, 7, &begin), 0);
  assert_int_equal(begin, count);
}

/* Behind a request to another device, its answer, and noise. */
UNIT_TEST(a_request_is_found_behind_others) {
  uint8_t bytes[64] = {9, 3, 0, 0, 0, 1};
  size_t at = close_frame(bytes, 6);
  const uint8_t answer[] = {9, 3, 2, 0, 5};
  memcpy(bytes + at, answer, sizeof answer);
  at += close_frame(bytes + at, sizeof answer);
  const uint8_t broadcast[] = {0, 6, 0, 0, 0, 1};
  memcpy(bytes + at, broadcast, sizeof broadcast);
  const size_t length = close_frame(bytes + at, sizeof broadcast);
  size_t begin;
  assert_int_equal(modbus_rtu_find(bytes, at + length, 7, &begin), length);
  assert_int_equal(begin, at);

  const uint8_t noise[] = {1, 2, 3};
  memcpy(bytes + at, noise, sizeof noise);
  at += sizeof noise;
  const uint8_t request[] = {7, 6, 0, 0, 0, 1};
  memcpy(bytes + at, request, sizeof request);
  const size_t mine = close_frame(bytes + at, sizeof request);
  assert_int_equal(modbus_rtu_find(bytes, at + mine, 7, &begin), mine);
  assert_int_equal(begin, at);
}

UNIT_TEST(any_bytes_can_be_searched) {
  uint64_t random = unit_seed();
  for (int i = 0; i < 20000; i++) {
    uint8_t bytes[300];
    const size_t count = unit_random_below(&random, sizeof bytes + 1);
    unit_random_bytes(&random, bytes, sizeof bytes);
    uint8_t *exact = malloc(count > 0 ? count : 1); /* so that a sanitizer sees what is beyond */
    memcpy(exact, bytes, count);
    size_t begin;
    const size_t found = modbus_rtu_find(exact, count, bytes[0], &begin);
    assert_true(begin <= count && found <= count - begin);
    free(exact);
  }
}

/* ---- networks ----------------------------------------------------------------------------- */

static bool allows(const char *network, const char *address) {
  struct options_list list = {.items = {network}, .count = network != NULL};
  struct modbus_access access;
  const char *wrong;
  assert_true(modbus_access_read(&list, &access, &wrong));
  struct sockaddr_in ipv4 = {.sin_family = AF_INET};
  struct sockaddr_in6 ipv6 = {.sin6_family = AF_INET6};
  if (inet_pton(AF_INET, address, &ipv4.sin_addr) == 1) {
    return modbus_access_allows(&access, (const struct sockaddr *)&ipv4);
  }
  assert_int_equal(inet_pton(AF_INET6, address, &ipv6.sin6_addr), 1);
  return modbus_access_allows(&access, (const struct sockaddr *)&ipv6);
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
    struct modbus_access access;
    const char *item;
    assert_false(modbus_access_read(&list, &access, &item));
    assert_string_equal(item, wrong[i]);
  }
}
