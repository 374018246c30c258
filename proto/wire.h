/* wire: encodes and decodes the structures of the binary protocol, which PROTOCOL.md describes.
 *
 * Decoders never read past the bytes that they are given and never trust a count. Encoders never
 * write past the capacity that they are given. Nothing here uses a socket or allocates memory.
 */
#ifndef DIPOLED_WIRE_H
#define DIPOLED_WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/core.h"

/* Numbers are copied, and arrays used in place, so this machine must be little-endian like the protocol. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's arrays need swapping");

#define WIRE_MAGIC UINT32_C(0x4c504944)
#define WIRE_VERSION 2
#define WIRE_REPLY 0x8000      /* the type of a reply is that of its request plus this */
#define WIRE_TYPE_ERROR 0xffff /* type of an error frame, which is sent in place of a reply */
#define WIRE_ALIGNMENT 8       /* payloads, structures and arrays start at multiples of 8 bytes */

/* Constants that no option changes. */
#define WIRE_PING_MAX_BYTES 1024
#define WIRE_R_UNIT "1/mm^2 per unit of power that entered"

enum wire_type {
#define WIRE_MESSAGE(type, IDENT, name, ...) WIRE_TYPE_##IDENT = (type),
#include "proto/messages.def"
};

enum wire_status {
#define WIRE_STATUS(code, IDENT, modbus_exception, http, scpi, name, text)                         \
  WIRE_STATUS_##IDENT = (code),
#include "proto/statuses.def"
#undef WIRE_STATUS
};

enum wire_choice_kind {
#define WIRE_LIST(kind, IDENT, name, plural, list) WIRE_CHOICE_##IDENT = (kind),
#include "proto/messages.def"
};

/* ---- structures ------------------------------------------------------------------------------ */

/* There is one struct for each structure of messages.def: wire_header, wire_eval_request, and so
 * on. Text has room for a terminating zero, which the wire does not carry. */
#define WIRE_CTYPE_u16 uint16_t
#define WIRE_CTYPE_u32 uint32_t
#define WIRE_CTYPE_u64 uint64_t
#define WIRE_CTYPE_f64 double

#define WIRE_DECLARE_ONE(kind, field, meaning, ...) WIRE_CTYPE_##kind field;
#define WIRE_DECLARE_ARRAY(kind, field, count, meaning, ...) WIRE_CTYPE_##kind field[count];
#define WIRE_DECLARE_TEXT(field, bytes, meaning) char field[(bytes) + 1];

#define WIRE_STRUCTURE(name)                                                                       \
  typedef struct wire_##name {                                                                     \
    WIRE_FIELDS_##name(WIRE_DECLARE_ONE, WIRE_DECLARE_ARRAY, WIRE_DECLARE_TEXT)                    \
  } wire_##name;
#include "proto/messages.def"

/* The size of each structure on the wire: WIRE_BYTES_header, WIRE_BYTES_eval_request, and so on. */
#define WIRE_SIZE_u16 2
#define WIRE_SIZE_u32 4
#define WIRE_SIZE_u64 8
#define WIRE_SIZE_f64 8

#define WIRE_ADD_ONE(kind, field, meaning, ...) +WIRE_SIZE_##kind
#define WIRE_ADD_ARRAY(kind, field, count, meaning, ...) +WIRE_SIZE_##kind *(count)
#define WIRE_ADD_TEXT(field, bytes, meaning) +(bytes)

#define WIRE_STRUCTURE(name)                                                                       \
  WIRE_BYTES_##name = 0 WIRE_FIELDS_##name(WIRE_ADD_ONE, WIRE_ADD_ARRAY, WIRE_ADD_TEXT),
enum wire_bytes {
#include "proto/messages.def"
};

/* wire_put_<name>() writes WIRE_BYTES_<name> bytes to `at`, which has room for them.
 * wire_get_<name>() reads as many bytes from `at`. Neither can fail, and `at` needs no alignment.
 * Text that is longer than its field is cut. */
#define WIRE_STRUCTURE(name)                                                                       \
  void wire_put_##name(uint8_t *at, const wire_##name *from);                                      \
  void wire_get_##name(const uint8_t *at, wire_##name *to);
#include "proto/messages.def"

/* Copies text into a text field of `bytes` bytes and a terminating zero. Cuts text that is longer.
 */
void wire_set_text(char *field, size_t bytes, const char *text);
#define WIRE_SET_TEXT(field, text) wire_set_text((field), sizeof(field) - 1, (text))

/* ---- frames ---------------------------------------------------------------------------------- */

/* Rounds up to a multiple of WIRE_ALIGNMENT. bytes is at most SIZE_MAX - 7. */
static inline uint64_t wire_padded(uint64_t bytes) {
  return (bytes + 7) & ~UINT64_C(7);
}

/* Errors are values. Status WIRE_STATUS_OK stands for no error. wire_error_make() copies its texts.
 *
 * Functions that make an error are cold: compilers then keep the branches to them away from the
 * code of requests that are right. */
#define WIRE_COLD __attribute__((cold))
wire_error wire_error_none(void);
WIRE_COLD wire_error wire_error_make(enum wire_status status, const char *field,
                                     const char *allowed);

/* Returns BUSY. The field is the request's field that exceeds the capacity, or the name of the
 * limit that is reached. */
WIRE_COLD wire_error wire_error_busy(const char *field, const char *allowed,
                                     uint32_t retry_after_ms);

/* Returns BAD_VALUE with the entries of one of core's lists as what is allowed, for example "one of
 * 1 (f64), 2 (f32)". A long list is cut. `how` is "one of" or "a sum of". */
WIRE_COLD wire_error wire_error_not_in_list(const char *field, const core_choice *list,
                                            const char *how);

/* Returns true if wire_header_check() would return OK. */
static inline bool wire_header_is_good(const wire_header *header, uint64_t max_payload_bytes) {
  return header->magic == WIRE_MAGIC && header->version == WIRE_VERSION &&
         header->payload_bytes <= max_payload_bytes && header->payload_bytes % WIRE_ALIGNMENT == 0;
}

/* Returns the first fault of a header. max_payload_bytes is the receiver's limit. After BAD_MAGIC
 * the framing is lost. After any other fault the next frame starts payload_bytes further on. */
wire_error wire_header_check(const wire_header *header, uint64_t max_payload_bytes);

/* What proto/statuses.def says of a status: its name, as "busy", its text for people, the status of
 * HTTP, as 429, the exception of Modbus, the number of SCPI's error. */
typedef struct wire_status_row {
  const char *name, *text;
  unsigned http, exception;
  int scpi;
} wire_status_row;

/* Returns the row of a status. A code that is not in the list has the name "unknown". */
const wire_status_row *wire_status_of(unsigned status);

/* Returns the name of a message for the type of its request or of its reply. Returns "error" for
 * WIRE_TYPE_ERROR and "unknown" for other types. */
const char *wire_type_name(unsigned type);

/* ---- the list of choices --------------------------------------------------------------------- */

/* One list of everything that requests choose from: the lists of core/core.h, then the statuses. */
extern const core_choice wire_statuses[];
size_t wire_choice_count(void);
wire_choice wire_choice_at(size_t index); /* index is below wire_choice_count() */

#endif
