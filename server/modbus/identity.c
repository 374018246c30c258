#include "server/modbus/identity.h"

#include <modbus.h>
#include <stdbool.h>
#include <string.h>

#include "server/modbus/pdu.h"

/* What is asked for, in the third byte of the request. */
enum { BASIC = 1, REGULAR, EXTENDED, INDIVIDUAL };

enum {
  CONFORMITY = 0x82, /* basic and regular objects, as a stream and one by one */
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

size_t modbus_identity_report(unsigned unit, uint8_t *answer) {
  answer[0] = MODBUS_FC_REPORT_SLAVE_ID;
  answer[2] = (uint8_t)unit;
  answer[3] = 0xff; /* it runs */
  const size_t bytes = 4 + put_text(answer + 4, "dipoled " DIPOLED_VERSION);
  answer[1] = (uint8_t)(bytes - 2);
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

/* A stream begins with the object that is named, or, if it is not there, with the first. */
static bool is_asked_for(const struct object *object, unsigned code, unsigned id) {
  if (code == INDIVIDUAL) {
    return object->id == id;
  }
  const unsigned last = code == BASIC ? BASIC_LAST : UINT8_MAX;
  return object->id <= last && (object->id >= id || !is_there(id) || id > last);
}

size_t modbus_identity_read(const uint8_t *pdu, uint8_t *answer, unsigned *exception) {
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
  /* All of them fit one answer: no more follow. */
  const uint8_t head[] = {pdu[0], pdu[1], (uint8_t)code, CONFORMITY, 0, 0, 0};
  memcpy(answer, head, sizeof head);
  size_t bytes = sizeof head;
  for (size_t i = 0; i < OBJECTS; i++) {
    if (is_asked_for(&objects[i], code, id)) {
      answer[6]++;
      answer[bytes++] = (uint8_t)objects[i].id;
      const size_t length = put_text(answer + bytes + 1, objects[i].value);
      answer[bytes++] = (uint8_t)length;
      bytes += length;
    }
  }
  return bytes;
}
