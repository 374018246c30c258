#include "server/modbus/codec.h"

#include <modbus.h>
#include <string.h>

#include "server/net/roles.h"

/* ---- requests -------------------------------------------------------------------------------- */

static unsigned word(const uint8_t *at) {
  return (unsigned)at[0] << 8 | at[1];
}

/* The lengths of the PDUs of each function. The list has functions that the daemon does not serve,
 * because other devices on a serial line may use them. */
static const struct function {
  uint8_t request;        /* length of a request, without the values that it counts */
  uint8_t request_values; /* position of the byte that counts the bytes of values, or 0 */
  uint8_t reply; /* length of a reply, without the values that it counts; 0: it is not known */
  uint8_t reply_values;
  unsigned roles; /* roles that a master needs; 0: the daemon does not serve it */
} functions[] = {
    [MODBUS_FC_READ_COILS] = {5, 0, 2, 1, ROLE_READ},
    [MODBUS_FC_READ_DISCRETE_INPUTS] = {5, 0, 2, 1, ROLE_READ},
    [MODBUS_FC_READ_HOLDING_REGISTERS] = {5, 0, 2, 1, ROLE_READ},
    [MODBUS_FC_READ_INPUT_REGISTERS] = {5, 0, 2, 1, ROLE_READ},
    [MODBUS_FC_WRITE_SINGLE_COIL] = {5, 0, 5, 0, ROLE_WRITE},
    [MODBUS_FC_WRITE_SINGLE_REGISTER] = {5, 0, 5, 0, ROLE_WRITE},
    [MODBUS_FC_READ_EXCEPTION_STATUS] = {1, 0, 2, 0, 0},
    [MODBUS_FC_DIAGNOSTICS] = {5, 0, 5, 0, 0},
    [0x0b] = {1, 0, 5, 0, 0}, /* get comm event counter */
    [0x0c] = {1, 0, 2, 1, 0}, /* get comm event log */
    [MODBUS_FC_WRITE_MULTIPLE_COILS] = {6, 5, 5, 0, ROLE_WRITE},
    [MODBUS_FC_WRITE_MULTIPLE_REGISTERS] = {6, 5, 5, 0, ROLE_WRITE},
    [MODBUS_FC_REPORT_SLAVE_ID] = {1, 0, 2, 1, ROLE_READ},
    [0x14] = {2, 1, 2, 1, 0}, /* read file record */
    [0x15] = {2, 1, 2, 1, 0}, /* write file record */
    [MODBUS_FC_MASK_WRITE_REGISTER] = {7, 0, 7, 0, ROLE_WRITE},
    [MODBUS_FC_WRITE_AND_READ_REGISTERS] = {10, 9, 2, 1, ROLE_READ | ROLE_WRITE},
    [0x18] = {3, 0, 3, 2, 0}, /* read FIFO queue */
    [MODBUS_FC_READ_DEVICE_ID] = {4, 0, 0, 0, ROLE_READ},
};

/* Finds a function by its number. Returns NULL if it is unknown. */
static const struct function *find_function(unsigned number) {
  const bool known =
      number < sizeof functions / sizeof functions[0] && functions[number].request > 0;
  return known ? &functions[number] : NULL;
}

/* Returns the length of a PDU of `fixed` bytes and of as many values as the byte at `values` says.
 * Returns 0 if there are too few bytes to tell. */
static size_t counted(const uint8_t *pdu, size_t bytes, size_t fixed, size_t values) {
  if (bytes <= values) {
    return 0;
  }
  return fixed + (values > 0 ? (size_t)pdu[values] : 0);
}

size_t modbus_pdu_bytes(const uint8_t *pdu, size_t bytes) {
  const struct function *function = bytes > 0 ? find_function(pdu[0]) : NULL;
  return function == NULL ? 0 : counted(pdu, bytes, function->request, function->request_values);
}

unsigned modbus_pdu_roles(unsigned number) {
  const struct function *function = find_function(number);
  return function != NULL ? function->roles : 0;
}

static bool within(unsigned count, unsigned most) {
  return count >= 1 && count <= most;
}

/* Reads the fields of a PDU whose length is right. Returns false if a count or value is wrong. */
static bool take_counts(const uint8_t *pdu, struct modbus_request *request) {
  switch (request->function) {
  case MODBUS_FC_READ_COILS:
  case MODBUS_FC_READ_DISCRETE_INPUTS:
    request->count = word(pdu + 3);
    return within(request->count, MODBUS_MAX_READ_BITS);
  case MODBUS_FC_READ_HOLDING_REGISTERS:
  case MODBUS_FC_READ_INPUT_REGISTERS:
    request->count = word(pdu + 3);
    return within(request->count, MODBUS_MAX_READ_REGISTERS);
  case MODBUS_FC_WRITE_SINGLE_COIL:
    request->count = 1;
    request->bits = pdu + 3;
    return word(pdu + 3) == 0 || word(pdu + 3) == 0xff00;
  case MODBUS_FC_WRITE_MULTIPLE_COILS:
    request->count = word(pdu + 3);
    request->bits = pdu + 6;
    return within(request->count, MODBUS_MAX_WRITE_BITS) && pdu[5] == (request->count + 7) / 8;
  case MODBUS_FC_WRITE_SINGLE_REGISTER:
    request->write_count = 1;
    request->values = pdu + 3;
    return true;
  case MODBUS_FC_WRITE_MULTIPLE_REGISTERS:
    request->write_count = word(pdu + 3);
    request->values = pdu + 6;
    return within(request->write_count, MODBUS_MAX_WRITE_REGISTERS) &&
           pdu[5] == 2 * request->write_count;
  case MODBUS_FC_MASK_WRITE_REGISTER:
    request->write_count = 1;
    request->and_mask = word(pdu + 3);
    request->or_mask = word(pdu + 5);
    return true;
  case MODBUS_FC_WRITE_AND_READ_REGISTERS:
    request->count = word(pdu + 3);
    request->write_address = word(pdu + 5);
    request->write_count = word(pdu + 7);
    request->values = pdu + 10;
    return within(request->count, MODBUS_MAX_WR_READ_REGISTERS) &&
           within(request->write_count, MODBUS_MAX_WR_WRITE_REGISTERS) &&
           pdu[9] == 2 * request->write_count;
  default:
    return true;
  }
}

unsigned modbus_pdu_parse(const uint8_t *pdu, size_t bytes, struct modbus_request *request) {
  *request = (struct modbus_request){.function = pdu[0]};
  const struct function *function = find_function(request->function);
  if (function == NULL || function->roles == 0 ||
      (request->function == MODBUS_FC_READ_DEVICE_ID && bytes > 1 && pdu[1] != 0x0e)) {
    return MODBUS_EXCEPTION_ILLEGAL_FUNCTION;
  }
  if (bytes != modbus_pdu_bytes(pdu, bytes)) {
    return MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE;
  }
  if (bytes >= 3) {
    request->address = request->write_address = word(pdu + 1);
  }
  return take_counts(pdu, request) ? 0 : MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE;
}

/* ---- frames of serial lines ------------------------------------------------------------------ */

enum { CHECKSUM_BYTES = 2 };

uint16_t modbus_rtu_checksum(const uint8_t *bytes, size_t count) {
  /* the change of the checksum for each value of four bits */
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

/* Returns the length of the reply's PDU that begins with these bytes, or 0 if they do not say. */
static size_t reply_pdu_bytes(const uint8_t *pdu, size_t bytes) {
  if (bytes > 0 && pdu[0] >= 0x80) {
    return 2;
  }
  const struct function *function = bytes > 0 ? find_function(pdu[0]) : NULL;
  return function == NULL || function->reply == 0
             ? 0
             : counted(pdu, bytes, function->reply, function->reply_values);
}

static bool begins_with_frame(const uint8_t *bytes, size_t count, size_t pdu_bytes) {
  const size_t length = 1 + pdu_bytes + CHECKSUM_BYTES;
  return pdu_bytes > 0 && length <= count && modbus_rtu_is_frame(bytes, length);
}

/* Returns the length of the frame, a request or a reply, at the start of the bytes. Returns 0 if
 * there is none. If two lengths are possible, the shorter one is right: a frame followed by a zero,
 * which starts a broadcast, also passes the checksum. */
static size_t first_frame(const uint8_t *bytes, size_t count) {
  const size_t request = count > 1 ? modbus_pdu_bytes(bytes + 1, count - 1) : 0;
  const size_t reply = count > 1 ? reply_pdu_bytes(bytes + 1, count - 1) : 0;
  const size_t shorter = request < reply ? request : reply;
  const size_t longer = request < reply ? reply : request;
  const size_t pdu = begins_with_frame(bytes, count, shorter)  ? shorter
                     : begins_with_frame(bytes, count, longer) ? longer
                                                               : 0;
  if (pdu > 0) {
    return 1 + pdu + CHECKSUM_BYTES;
  }
  return modbus_rtu_is_frame(bytes, count) ? count : 0;
}

struct modbus_rtu_frames modbus_rtu_split(const uint8_t *bytes, size_t count) {
  struct modbus_rtu_frames frames = {0};
  size_t length;
  while ((length = first_frame(bytes + frames.bytes, count - frames.bytes)) > 0) {
    frames.count++;
    frames.last = frames.bytes;
    frames.bytes += length;
  }
  return frames;
}

/* ---- identification -------------------------------------------------------------------------- */

/* Values of the third byte of a request of function 43/14. */
enum { BASIC = 1, REGULAR, EXTENDED, INDIVIDUAL };

enum {
  CONFORMITY = 0x82, /* basic and regular objects can be read all at once or one by one */
  BASIC_LAST = 2,
};

struct object {
  unsigned id;
  const char *value;
};

static const struct object objects[] = {
#define MODBUS_OBJECT(id, name, value) {id, value},
#include "server/modbus/identity.def"
#undef MODBUS_OBJECT
};

enum { OBJECTS = sizeof objects / sizeof objects[0] };

static size_t put_text(uint8_t *at, const char *text) {
  const size_t length = strlen(text);
  memcpy(at, text, length);
  return length;
}

size_t modbus_identity_report(unsigned unit, uint8_t *reply) {
  reply[0] = MODBUS_FC_REPORT_SLAVE_ID;
  reply[2] = (uint8_t)unit;
  reply[3] = 0xff; /* run indicator: on */
  const size_t bytes = 4 + put_text(reply + 4, "dipoled " DIPOLED_VERSION);
  reply[1] = (uint8_t)(bytes - 2);
  return bytes;
}

static bool is_there(unsigned id) {
  for (size_t i = 0; i < OBJECTS; i++) {
    if (objects[i].id == id) {
      return true;
    }
  }
  return false;
}

/* Returns whether an object goes into the reply. A request for all objects of a kind gets those
 * from object `id` on, or all if there is no object `id`. */
static bool is_requested(const struct object *object, unsigned code, unsigned id) {
  if (code == INDIVIDUAL) {
    return object->id == id;
  }
  const unsigned last = code == BASIC ? BASIC_LAST : UINT8_MAX;
  return object->id <= last && (object->id >= id || !is_there(id) || id > last);
}

size_t modbus_identity_read(const uint8_t *pdu, uint8_t *reply, unsigned *exception) {
  const unsigned code = pdu[2];
  const unsigned id = pdu[3];
  if (code < BASIC || code > INDIVIDUAL) {
    *exception = MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE;
    return 0;
  }
  if (code == INDIVIDUAL && !is_there(id)) {
    *exception = MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS;
    return 0;
  }
  /* The zeros say that no more objects follow: all fit into one reply. */
  const uint8_t head[] = {pdu[0], pdu[1], (uint8_t)code, CONFORMITY, 0, 0, 0};
  memcpy(reply, head, sizeof head);
  size_t bytes = sizeof head;
  for (size_t i = 0; i < OBJECTS; i++) {
    if (is_requested(&objects[i], code, id)) {
      reply[6]++;
      reply[bytes++] = (uint8_t)objects[i].id;
      const size_t length = put_text(reply + bytes + 1, objects[i].value);
      reply[bytes++] = (uint8_t)length;
      bytes += length;
    }
  }
  return bytes;
}
