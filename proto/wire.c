#include "proto/wire.h"

#include <stdio.h>
#include <string.h>

#include "core/varying.h"

/* ---- structures ------------------------------------------------------------------------------ */

/* Numbers are in memory as on the wire. */

static uint8_t *put_text(uint8_t *at, const char *text, size_t bytes) {
  const size_t length = strnlen(text, bytes);
  memcpy(at, text, length);
  memset(at + length, 0, bytes - length);
  return at + bytes;
}

static const uint8_t *get_text(const uint8_t *at, char *text, size_t bytes) {
  memcpy(text, at, bytes);
  text[bytes] = '\0';
  return at + bytes;
}

#define PUT_ONE(kind, field, ...)                                                                  \
  memcpy(at, &from->field, sizeof from->field);                                                    \
  at += sizeof from->field;
#define PUT_ARRAY(kind, field, count, ...) PUT_ONE(kind, field, )
#define PUT_TEXT(field, bytes, meaning) at = put_text(at, from->field, bytes);
#define GET_ONE(kind, field, ...)                                                                  \
  memcpy(&to->field, at, sizeof to->field);                                                        \
  at += sizeof to->field;
#define GET_ARRAY(kind, field, count, ...) GET_ONE(kind, field, )
#define GET_TEXT(field, bytes, meaning) at = get_text(at, to->field, bytes);

#define WIRE_STRUCTURE(name)                                                                       \
  void wire_put_##name(uint8_t *at, const wire_##name *from) {                                     \
    WIRE_FIELDS_##name(PUT_ONE, PUT_ARRAY, PUT_TEXT)(void) at;                                     \
  }                                                                                                \
  void wire_get_##name(const uint8_t *at, wire_##name *to) {                                       \
    WIRE_FIELDS_##name(GET_ONE, GET_ARRAY, GET_TEXT)(void) at;                                     \
  }                                                                                                \
  _Static_assert(WIRE_BYTES_##name % WIRE_ALIGNMENT == 0, #name " is padded");
#include "proto/messages.def"

void wire_set_text(char *field, size_t bytes, const char *text) {
  const size_t length = strnlen(text, bytes);
  memcpy(field, text, length);
  memset(field + length, 0, bytes + 1 - length);
}

/* ---- frames ---------------------------------------------------------------------------------- */

wire_error wire_error_none(void) {
  static const wire_error none = {.status = WIRE_STATUS_OK}; /* copying it is faster than zeroing */
  return none;
}

wire_error wire_error_make(enum wire_status status, const char *field, const char *allowed) {
  wire_error error = {.status = (uint16_t)status};
  WIRE_SET_TEXT(error.field, field);
  WIRE_SET_TEXT(error.allowed, allowed);
  return error;
}

wire_error wire_error_busy(const char *field, const char *allowed, uint32_t retry_after_ms) {
  wire_error error = wire_error_make(WIRE_STATUS_BUSY, field, allowed);
  error.retry_after_ms = retry_after_ms;
  return error;
}

/* Says what a frame begins with, and what seems to have come in its place. */
static const char *expected_magic(uint32_t magic) {
  if (magic == UINT32_C(0x584f5250) || magic == UINT32_C(0x0a0d0a0d)) { /* versions 1 and 2 */
    return "0x4c504944, the bytes D I P L, and before them no PROXY header of a balancer";
  }
  if ((magic & 0xffff) == 0x0316 || (magic & 0xffff) == 0x0315) { /* a handshake, an alert */
    return "0x4c504944, the bytes D I P L; this is TLS, which needs a tls: address";
  }
  if (magic == UINT32_C(0x20544547) || magic == UINT32_C(0x54534f50) ||
      magic == UINT32_C(0x50545448)) { /* GET, POST, the answer */
    return "0x4c504944, the bytes D I P L; this is HTTP, which has an address of its own";
  }
  return "0x4c504944, the bytes D I P L";
}

wire_error wire_header_check(const wire_header *header, uint64_t max_payload_bytes) {
  char allowed[64];
  if (header->magic != WIRE_MAGIC) {
    return wire_error_make(WIRE_STATUS_BAD_MAGIC, "magic", expected_magic(header->magic));
  }
  if (header->version != WIRE_VERSION) {
    snprintf(allowed, sizeof allowed, "%d", WIRE_VERSION);
    return wire_error_make(WIRE_STATUS_BAD_VERSION, "version", allowed);
  }
  if (header->payload_bytes > max_payload_bytes) {
    snprintf(allowed, sizeof allowed, "at most %llu", (unsigned long long)max_payload_bytes);
    return wire_error_make(WIRE_STATUS_TOO_LARGE, "payload_bytes", allowed);
  }
  if (header->payload_bytes % WIRE_ALIGNMENT != 0) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes", "a multiple of 8");
  }
  return wire_error_none();
}

const wire_status_row *wire_status_of(unsigned status) {
  static const wire_status_row statuses[] = {
#define WIRE_STATUS(code, IDENT, modbus_exception, http, scpi, name, text)                         \
  [code] = {name, text, http, modbus_exception, scpi},
#include "proto/statuses.def"
#undef WIRE_STATUS
  };
  static const wire_status_row unknown = {"unknown", "an error that this version does not know",
                                          500, 4, -300};
  return status < sizeof statuses / sizeof statuses[0] ? &statuses[status] : &unknown;
}

const char *wire_type_name(unsigned type) {
  if (type == WIRE_TYPE_ERROR) {
    return "error";
  }
  switch (type & ~(unsigned)WIRE_REPLY) {
#define WIRE_MESSAGE(type, IDENT, name, ...)                                                       \
  case type:                                                                                       \
    return name;
#include "proto/messages.def"
  default:
    return "unknown";
  }
}

wire_error wire_error_not_in_list(const char *field, const core_choice *list, const char *how) {
  static const char more[] = " ... of the list in hello";
  char allowed[81];
  size_t length = (size_t)snprintf(allowed, sizeof allowed, "%s", how);
  for (const core_choice *entry = list; entry->name != NULL; entry++) {
    char item[64];
    const int bytes = snprintf(item, sizeof item, "%s%u (%s)", entry == list ? " " : ", ",
                               entry->id, entry->name);
    const size_t room = sizeof allowed - (entry[1].name != NULL ? sizeof more : 1);
    if (length + (size_t)bytes > room) {
      snprintf(allowed + length, sizeof allowed - length, "%s", more);
      break;
    }
    length += (size_t)snprintf(allowed + length, sizeof allowed - length, "%s", item);
  }
  return wire_error_make(WIRE_STATUS_BAD_VALUE, field, allowed);
}

/* ---- the list of choices --------------------------------------------------------------------- */

const core_choice wire_statuses[] = {
#define WIRE_STATUS(code, IDENT, modbus_exception, http, scpi, name, text) {code, name, text},
#include "proto/statuses.def"
#undef WIRE_STATUS
    {0, NULL, NULL},
};

static const struct {
  enum wire_choice_kind kind;
  const core_choice *list;
} choice_lists[] = {
#define WIRE_LIST(kind, IDENT, name, plural, list) {WIRE_CHOICE_##IDENT, list},
#include "proto/messages.def"
};

enum { CHOICE_LISTS = sizeof choice_lists / sizeof choice_lists[0] };

static size_t list_length(const core_choice *list) {
  size_t length = 0;
  while (list[length].name != NULL) {
    length++;
  }
  return length;
}

size_t wire_choice_count(void) {
  size_t count = 0;
  for (size_t i = 0; i < CHOICE_LISTS; i++) {
    count += list_length(choice_lists[i].list);
  }
  return count;
}

wire_choice wire_choice_at(size_t index) {
  size_t list = 0;
  while (index >= list_length(choice_lists[list].list)) {
    index -= list_length(choice_lists[list].list);
    list++;
  }
  const core_choice *entry = &choice_lists[list].list[index];
  wire_choice choice = {.kind = (uint32_t)choice_lists[list].kind, .id = (uint32_t)entry->id};
  WIRE_SET_TEXT(choice.name, entry->name);
  WIRE_SET_TEXT(choice.about, entry->about);
  return choice;
}
