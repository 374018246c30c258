/* wire: the binary protocol's structures, encoded and decoded; PROTOCOL.md is its text for people.
 *
 * Decoders never read past the bytes they are given and never trust a count; encoders never write
 * past the capacity they are given. No sockets, no allocation.
 */
#ifndef DIPOLED_WIRE_H
#define DIPOLED_WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct core_choice; /* of core.h */

#define WIRE_MAGIC UINT32_C(0x4c504944)
#define WIRE_VERSION 1
#define WIRE_REPLY 0x8000      /* added to the type of a request */
#define WIRE_TYPE_ERROR 0xffff /* an error instead of a reply */
#define WIRE_ALIGNMENT 8       /* of payloads, structures and arrays within a frame */

/* Limits that no option changes. */
#define WIRE_PING_MAX_BYTES 1024
#define WIRE_R_UNIT "1/mm^2 per unit of power that entered"

enum wire_type {
#define WIRE_MESSAGE(type, IDENT, name) WIRE_TYPE_##IDENT = (type),
#include "proto/messages.def"
};

enum wire_status {
#define WIRE_STATUS(code, IDENT, modbus_exception, name, text) WIRE_STATUS_##IDENT = (code),
#include "proto/statuses.def"
#undef WIRE_STATUS
};

enum wire_choice_kind {
  WIRE_CHOICE_MODEL = 1,
  WIRE_CHOICE_EVALUATOR,
  WIRE_CHOICE_MOMENTS,
  WIRE_CHOICE_QUANTITY,
  WIRE_CHOICE_SPACING,
  WIRE_CHOICE_STATUS,
  WIRE_CHOICE_PARAMETER,
  WIRE_CHOICE_NOTE,
  WIRE_CHOICE_DRAW,
  WIRE_CHOICE_LENGTH,
};

/* ---- structures -------------------------------------------------------------------------------
 */

/* One struct for each structure of messages.def: wire_header, wire_eval_request, ... Text has room
 * for a terminating zero, which the wire does not carry. */
#define WIRE_CTYPE_u16 uint16_t
#define WIRE_CTYPE_u32 uint32_t
#define WIRE_CTYPE_u64 uint64_t
#define WIRE_CTYPE_f64 double

#define WIRE_DECLARE_ONE(kind, field, meaning) WIRE_CTYPE_##kind field;
#define WIRE_DECLARE_ARRAY(kind, field, count, meaning) WIRE_CTYPE_##kind field[count];
#define WIRE_DECLARE_TEXT(field, bytes, meaning) char field[(bytes) + 1];

#define WIRE_STRUCTURE(name, about)                                                                \
  typedef struct wire_##name {                                                                     \
    WIRE_FIELDS_##name(WIRE_DECLARE_ONE, WIRE_DECLARE_ARRAY, WIRE_DECLARE_TEXT)                    \
  } wire_##name;
#include "proto/messages.def"

/* WIRE_BYTES_header, WIRE_BYTES_eval_request, ...: their sizes on the wire. */
#define WIRE_SIZE_u16 2
#define WIRE_SIZE_u32 4
#define WIRE_SIZE_u64 8
#define WIRE_SIZE_f64 8

#define WIRE_ADD_ONE(kind, field, meaning) +WIRE_SIZE_##kind
#define WIRE_ADD_ARRAY(kind, field, count, meaning) +WIRE_SIZE_##kind *(count)
#define WIRE_ADD_TEXT(field, bytes, meaning) +(bytes)

#define WIRE_STRUCTURE(name, about)                                                                \
  WIRE_BYTES_##name = 0 WIRE_FIELDS_##name(WIRE_ADD_ONE, WIRE_ADD_ARRAY, WIRE_ADD_TEXT),
enum wire_bytes {
#include "proto/messages.def"
};

/* wire_put_header(at, &header), ...: writes WIRE_BYTES_<name> bytes to at, which has room for them.
 * wire_get_header(at, &header), ...: reads as many from at. Neither can fail; at needs no
 * alignment. Text longer than its field is cut. */
#define WIRE_STRUCTURE(name, about)                                                                \
  void wire_put_##name(uint8_t *at, const wire_##name *from);                                      \
  void wire_get_##name(const uint8_t *at, wire_##name *to);
#include "proto/messages.def"

/* Copies text into a text field of `bytes` bytes plus its terminating zero, cutting it if needed.
 */
void wire_set_text(char *field, size_t bytes, const char *text);
#define WIRE_SET_TEXT(field, text) wire_set_text((field), sizeof(field) - 1, (text))

/* ---- frames -----------------------------------------------------------------------------------
 */

/* Rounds up to WIRE_ALIGNMENT. bytes <= SIZE_MAX - 7. */
static inline uint64_t wire_padded(uint64_t bytes) {
  return (bytes + 7) & ~UINT64_C(7);
}

/* An error as a value; status == WIRE_STATUS_OK: none. */
wire_error wire_error_none(void);
wire_error wire_error_make(enum wire_status status, const char *field, const char *allowed);

/* BAD_VALUE: "one of 1 (f64), 2 (f32)", so that the reader of an error need not look the list up
 * unless it is long. how: "one of", "a sum of". list: one of core's. */
wire_error wire_error_not_in_list(const char *field, const struct core_choice *list,
                                  const char *how);

/* Whether wire_header_check() would find nothing wrong. */
static inline bool wire_header_is_good(const wire_header *header, uint64_t max_payload_bytes) {
  return header->magic == WIRE_MAGIC && header->version == WIRE_VERSION &&
         header->payload_bytes <= max_payload_bytes && header->payload_bytes % WIRE_ALIGNMENT == 0;
}

/* What a header alone shows to be wrong. max_payload_bytes: the receiver's limit. After BAD_MAGIC
 * the framing is lost; after any other error the next frame begins payload_bytes further on. */
wire_error wire_header_check(const wire_header *header, uint64_t max_payload_bytes);

/* "ok", "busy", ...; "unknown" for a code that is not in the list. */
const char *wire_status_name(unsigned status);
const char *wire_status_text(unsigned status);

/* "hello", ...; also for replies; "error"; "unknown". */
const char *wire_type_name(unsigned type);

/* ---- the list of choices ----------------------------------------------------------------------
 */

/* Everything that a request chooses from: the lists of core.h and the statuses. */
size_t wire_choice_count(void);
wire_choice wire_choice_at(size_t index); /* index < wire_choice_count() */

/* ---- documentation ----------------------------------------------------------------------------
 */

/* Writes the byte tables of PROTOCOL.md, as Markdown, through print(context, text). */
void wire_describe(void (*print)(void *context, const char *text), void *context);

#endif
