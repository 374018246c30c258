#include "server/modbus/rtu.h"

#include <modbus.h>

#include "server/modbus/pdu.h"

enum { CHECKSUM_BYTES = 2 };

uint16_t modbus_rtu_checksum(const uint8_t *bytes, size_t count) {
  /* what four bits do */
  static const uint16_t steps[] = {0x0000, 0xcc01, 0xd801, 0x1400, 0xf001, 0x3c00, 0x2800, 0xe401,
                                   0xa001, 0x6c00, 0x7800, 0xb401, 0x5000, 0x9c01, 0x8801, 0x4400};
  uint16_t sum = 0xffff;
  for (size_t i = 0; i < count; i++) {
    sum ^= bytes[i];
    sum = (uint16_t)(sum >> 4 ^ steps[sum & 15]);
    sum = (uint16_t)(sum >> 4 ^ steps[sum & 15]);
  }
  return sum;
}

bool modbus_rtu_is_frame(const uint8_t *bytes, size_t count) {
  return count >= MODBUS_RTU_MIN && count <= MODBUS_RTU_MAX &&
         modbus_rtu_checksum(bytes, count - CHECKSUM_BYTES) ==
             (bytes[count - 2] | bytes[count - 1] << 8);
}

/* How long an answer is that begins with these bytes; 0: they do not say. */
static size_t answer_bytes(const uint8_t *bytes, size_t count) {
  if (count < 3) {
    return 0;
  }
  if (bytes[1] >= 0x80) {
    return 5;
  }
  switch (bytes[1]) {
  case MODBUS_FC_READ_COILS:
  case MODBUS_FC_READ_DISCRETE_INPUTS:
  case MODBUS_FC_READ_HOLDING_REGISTERS:
  case MODBUS_FC_READ_INPUT_REGISTERS:
  case MODBUS_FC_REPORT_SLAVE_ID:
  case MODBUS_FC_WRITE_AND_READ_REGISTERS:
    return 3 + (size_t)bytes[2] + CHECKSUM_BYTES;
  case MODBUS_FC_WRITE_MULTIPLE_COILS:
  case MODBUS_FC_WRITE_MULTIPLE_REGISTERS:
    return 6 + CHECKSUM_BYTES;
  default:
    return 0;
  }
}

static bool is_frame_of(const uint8_t *bytes, size_t count, size_t length) {
  return length > 0 && length <= count && modbus_rtu_is_frame(bytes, length);
}

/* The length of the frame that the bytes begin with, a request or an answer; 0: none. If it could
 * be both, the shorter: a frame with a zero behind it, which begins a broadcast, is a frame again.
 */
static size_t first_frame(const uint8_t *bytes, size_t count) {
  const size_t pdu = count > 1 ? modbus_pdu_bytes(bytes + 1, count - 1) : 0;
  const size_t request = pdu > 0 ? 1 + pdu + CHECKSUM_BYTES : 0;
  const size_t answer = answer_bytes(bytes, count);
  const size_t shorter = request < answer ? request : answer;
  const size_t longer = request < answer ? answer : request;
  if (is_frame_of(bytes, count, shorter)) {
    return shorter;
  }
  return is_frame_of(bytes, count, longer) ? longer : 0;
}

static bool is_request(const uint8_t *bytes, size_t count, unsigned unit) {
  const size_t pdu = count > 1 ? modbus_pdu_bytes(bytes + 1, count - 1) : 0;
  return bytes[0] == unit && count == 1 + pdu + CHECKSUM_BYTES && modbus_rtu_is_frame(bytes, count);
}

size_t modbus_rtu_find(const uint8_t *bytes, size_t count, unsigned unit, size_t *begin) {
  /* Frame by frame; the last may be of an unknown function, and has no length then. */
  size_t length;
  *begin = 0;
  while ((length = first_frame(bytes + *begin, count - *begin)) > 0 && length < count - *begin) {
    *begin += length;
  }
  const size_t left = count - *begin;
  if (modbus_rtu_is_frame(bytes + *begin, left)) {
    return bytes[*begin] == unit || bytes[*begin] == 0 ? left : 0;
  }
  /* There is noise: a request to this unit may stand behind it. */
  for (; *begin < count; ++*begin) {
    if (is_request(bytes + *begin, count - *begin, unit)) {
      return count - *begin;
    }
  }
  return 0;
}
