/* schema: the messages, structures and payloads of messages.def as tables, and what walks over them:
 * checks of requests, and the offsets and lengths of what follows a structure.
 *
 * The functions never read past the bytes that they are given, and no count overflows. They allocate
 * nothing. */
#ifndef DIPOLED_PROTO_SCHEMA_H
#define DIPOLED_PROTO_SCHEMA_H

#include <string.h>

#include "core/core.h"
#include "proto/wire.h"

/* A layer of a medium has the same layout on the wire and in core, so core reads payloads in place. */
_Static_assert(sizeof(core_medium) == WIRE_BYTES_medium, "one layer after the other");

/* ---- fields ---------------------------------------------------------------------------------- */

enum schema_kind {
  SCHEMA_NONE,
  SCHEMA_u8,
  SCHEMA_u16,
  SCHEMA_u32,
  SCHEMA_u64,
  SCHEMA_f32,
  SCHEMA_f64,
  SCHEMA_text,
  SCHEMA_REAL, /* kind of a part: numbers in the evaluator's precision */
  SCHEMA_LIST, /* kind of a part: structures */
};

/* A field of a structure. messages.def says what its attributes mean. */
typedef struct schema_field {
  const char *name; /* NULL ends a list of fields */
  enum schema_kind kind;
  unsigned count; /* number of values, or bytes of a text */
  unsigned bytes; /* of all values */
  const char *meaning;
  const char *unit;        /* NULL: none */
  const core_choice *list; /* the list whose ids are valid; NULL: the field is a number */
  bool bits;               /* whether the value is a mask of ids of the list */
  bool or_zero, hidden, required;
  bool spans, ranged; /* spans: least and most are set; ranged: they are checked */
  double least, most;
  double too_large;    /* values from this on are TOO_LARGE; 0: no such limit */
  uint16_t status;     /* the status if a value is out of range */
  const char *allowed; /* text for the error; NULL: made from the range */
  /* name of a field: where that is zero_at, this one must be 0; NULL: none */
  const char *zero_with;
  uint16_t zero_at;
  const char *zero_text;
  double usual;
} schema_field;

/* Reads the number of a field, or one of several, at this place. */
double schema_number_at(const schema_field *field, const void *at);

/* Writes it as the field's kind has it: an integer has its bits. */
void schema_put_number(const schema_field *field, double number, void *at);

/* Read and write a number of an array of floats, if `single`, or of doubles, at any place. */
static inline double schema_real_at(const void *values, uint64_t index, bool single) {
  float narrow;
  double wide;
  if (!single) {
    memcpy(&wide, (const char *)values + index * sizeof wide, sizeof wide);
    return wide;
  }
  memcpy(&narrow, (const char *)values + index * sizeof narrow, sizeof narrow);
  return (double)narrow;
}

static inline void schema_put_real(void *values, uint64_t index, bool single, double number) {
  const float narrow = (float)number;
  const size_t bytes = single ? sizeof narrow : sizeof number;
  memcpy((char *)values + index * bytes, single ? (const void *)&narrow : (const void *)&number,
         bytes);
}

/* Returns the name of a kind, as messages.def has it. */
const char *schema_kind_name(enum schema_kind kind);

/* Returns the sum of all entries of a list. */
unsigned schema_all_bits(const core_choice *list);

/* Returns how many bits are set. They are few, so that this is faster than libgcc's function. */
static inline unsigned schema_bit_count(uint64_t bits) {
  unsigned count = 0;
  for (; bits != 0; bits &= bits - 1) {
    count++;
  }
  return count;
}

/* Returns up to 8 bytes as a number, or 0 in place of more. Copies of constant lengths are single
 * instructions. */
static inline uint64_t schema_bits_at(const void *at, size_t bytes) {
  uint64_t bits = 0;
  switch (bytes) {
  case 2:
    memcpy(&bits, at, 2);
    break;
  case 4:
    memcpy(&bits, at, 4);
    break;
  case 8:
    memcpy(&bits, at, 8);
    break;
  default:
    memcpy(&bits, at, bytes < sizeof bits ? bytes : 0);
  }
  return bits;
}

/* Returns whether a field names content by its hash, two numbers; in JSON it is one text. */
static inline bool schema_is_name(const schema_field *field) {
  return field->kind == SCHEMA_u64 && field->count == 2;
}

typedef struct schema_structure {
  const char *name;
  const schema_field *fields;
  size_t bytes;
} schema_structure;

/* The structures: schema_structures[SCHEMA_STRUCTURE_medium] and so on. */
enum {
#define WIRE_STRUCTURE(name) SCHEMA_STRUCTURE_##name,
#include "proto/messages.def"
  SCHEMA_STRUCTURES
};
extern const schema_structure schema_structures[SCHEMA_STRUCTURES];

/* ---- payloads -------------------------------------------------------------------------------- */

/* A number that is read from the first structures: a field, or the number of its bits that are in a
 * mask. */
typedef struct schema_number {
  const char *name; /* NULL: the number 1 */
  uint16_t offset;
  uint8_t bytes;
  uint32_t mask; /* 0: the field itself; else its bits in this mask are counted */
} schema_number;

/* How JSON gives a list of numbers. */
enum schema_form {
  SCHEMA_GIVEN,     /* a list is required unless a rule makes its numbers */
  SCHEMA_ZEROS,     /* a list is optional; its numbers are then 0 */
  SCHEMA_EACH,      /* a list, or one number for all; which ones are given is checked elsewhere */
  SCHEMA_SETS,      /* a list, or a list of lists: one for each set */
  SCHEMA_POSITIONS, /* x, y and z, each a list, or one number for all */
  SCHEMA_CHANNELS,  /* a list, or a list of lists: one for each channel; each may be one number */
};

enum { SCHEMA_FACTORS = 3, SCHEMA_PARTS = 10 };

/* An array, or several of equal length, that follows the first structures or another part. */
typedef struct schema_part {
  const char *name;   /* its name in JSON and in errors */
  const char *plural; /* its name in errors */
  enum schema_kind kind;
  const schema_structure *structure; /* of SCHEMA_LIST */
  schema_number evaluator;           /* of SCHEMA_REAL */
  schema_number count[SCHEMA_FACTORS], arrays[SCHEMA_FACTORS];
  /* number of elements: the product of count[], times `times` (0 means 1), plus `more` */
  unsigned times, more;
  schema_number when; /* the part exists only if this number is equal to `is`; no name: always */
  uint64_t is;
  /* unless: the part exists only if the number differs from `is` */
  bool unless, never, exact, rest;
  enum schema_form form;
  const char *about; /* NULL: it is no list of JSON */
  const char *unit;  /* NULL: none */
} schema_part;

typedef struct schema_payload {
  const char *name;
  const schema_structure *structures[2]; /* the structures at its start; NULL after the last */
  const schema_part *parts;              /* ends with an entry whose name is NULL */
  size_t fixed_bytes;                    /* bytes of the structures */
} schema_payload;

/* The payloads: schema_eval_request and so on. */
#define WIRE_PAYLOAD(name, ...) extern const schema_payload schema_##name;
#include "proto/messages.def"
extern const schema_payload schema_nothing;

typedef struct schema_message {
  unsigned type; /* enum wire_type; 0 ends the list of messages */
  const char *name;
  const schema_payload *request, *reply;
  const char *about; /* description for HTTP; NULL: HTTP does not serve it */
} schema_message;

extern const schema_message schema_messages[];

/* Returns the field of a payload's structures that has this name, or NULL. */
const schema_field *schema_field_of(const schema_payload *payload, const char *name);

/* The same; sets *at to its offset. */
const schema_field *schema_field_at(const schema_payload *payload, const char *name, size_t *at);

/* Where the parts of a payload are. Offsets count from its start. */
typedef struct schema_layout {
  uint64_t payload_bytes;
  struct {
    uint64_t at;          /* offset of the part, or where it would be */
    uint64_t count;       /* elements of each array; 0: the part does not exist */
    uint64_t bytes;       /* bytes of one element */
    uint64_t array_bytes; /* bytes of each array with its padding */
  } parts[SCHEMA_PARTS];
} schema_layout;

/* Computes the layout of a payload that begins with these structures (bytes as on the wire). Returns
 * false if it is longer than bytes_max; then *part is the first one that does not fit, if `part` is
 * not NULL. */
bool schema_lay_out(const schema_payload *payload, const void *start, uint64_t bytes_max,
                    schema_layout *layout, const schema_part **part);

/* Returns the bytes of a payload that begins with these structures; UINT64_MAX: more than can be. */
uint64_t schema_bytes(const schema_payload *payload, const void *start);

/* Returns the bytes of a part of a reply with this many elements. The reply's structure starts with
 * wire_part, whose count does not matter. */
uint64_t schema_part_bytes(const schema_payload *payload, const void *start, uint64_t count);

/* Returns how many elements a part of a reply may have so that its payload takes at most bytes_max:
 * a multiple of `unit`, possibly 0. Returns UINT64_MAX if elements take no bytes. */
uint64_t schema_part_values(const schema_payload *payload, const void *start, unsigned unit,
                            uint64_t bytes_max);

/* Checks a request: its length, then its fields in their order, then the counts of its parts and
 * their padding. Returns the first fault. */
wire_error schema_check(const schema_payload *payload, const uint8_t *bytes, size_t count,
                        schema_layout *layout);

/* Checks one value of a field against its list or range. bits: as on the wire, filled up by zeros. */
wire_error schema_check_value(const schema_field *field, uint64_t bits);

/* Returns whether a reply has the length that its structures announce. */
bool schema_is_whole(const schema_payload *payload, const uint8_t *bytes, uint64_t count,
                     schema_layout *layout);

/* Writes a part: its elements, or zeros if they are NULL, and the padding of one array. Returns where
 * it ends. */
uint8_t *schema_put_part(uint8_t *payload, const schema_layout *layout, unsigned part,
                         const void *elements);

/* ---- parameters ------------------------------------------------------------------------------- */

/* Parses `count` parameter structures, which the caller knows to be in the payload. Checks their
 * ids and padding, that each parameter comes at most once, and that no value is NaN. The error's
 * index is the position of the structure. Core checks the ranges. layer_count: of the request's
 * media. */
wire_error schema_parse_parameters(const uint8_t *at, uint32_t count, uint32_t layer_count,
                                   core_parameters *parameters);

/* The same for the numbers of any list: sets values[id], which have to be NaN before. */
wire_error schema_parse_numbers(const uint8_t *at, uint32_t count, const core_choice *list,
                                double *values);

/* Writes the numbers that are given, that is, not NaN, in the order of their ids: values[end], to `at`,
 * WIRE_BYTES_parameter each, unless it is NULL. Returns how many there are. */
uint16_t schema_put_numbers(void *at, const double *values, unsigned end);

/* Returns how many parameters are given. */
uint32_t schema_count_parameters(const core_parameters *parameters);

/* Writes the parameters that are given. Returns the number of bytes. */
size_t schema_put_parameters(uint8_t *at, const core_parameters *parameters);

#endif
