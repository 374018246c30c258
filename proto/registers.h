/* registers: the Modbus register map; REGISTERS.md is its text for people.
 *
 * An image of the map is an array of REGISTERS_END registers, in the machine's byte order, with the
 * PDU address for its index. No sockets, no allocation.
 */
#ifndef DIPOLED_REGISTERS_H
#define DIPOLED_REGISTERS_H

#include <float.h>
#include <math.h>
#include <string.h>

#include "core/core.h"
#include "proto/wire.h"

#define REGISTERS_MAGIC 0x4449504c
#define REGISTERS_VERSION 1

enum {
  REGISTERS_RADII_MAX = 50,
  REGISTERS_MIRROR = 2000, /* from a register of the input and output blocks to its mirror */
  REGISTERS_END = 2660,    /* of the image */
  REGISTERS_COILS = 100,   /* plain bits, from 0 */
  REGISTERS_ERROR_TEXT_BYTES = 80,
};

/* Of a parameter of the core. */
#define REGISTERS_PARAMETER_AT(id) ((id) == CORE_PARAMETER_TOLERANCE ? 104 : 216 + 2 * (id))

enum {
  REGISTERS_BLOCKS = 0
#define REGISTERS_BLOCK(id, IDENT, first, length, name, about) +1
#include "proto/registers.def"
};

/* REGISTERS_AT_COMMIT, ...: PDU addresses. */
enum registers_address {
#define REGISTERS_FIELD(IDENT, address, count, TYPE, ACCESS, name, unit, least, most, list,        \
                        initial, about)                                                            \
  REGISTERS_AT_##IDENT = (address),
#define REGISTERS_STATISTIC(IDENT, address, name, about) REGISTERS_AT_STATISTIC_##IDENT = (address),
#include "proto/registers.def"
};

enum registers_type { REGISTERS_U16, REGISTERS_U32, REGISTERS_F32, REGISTERS_F64, REGISTERS_TEXT };

enum registers_access { REGISTERS_RO, REGISTERS_RW, REGISTERS_OPTIONAL };

/* What the register `status` holds. */
enum registers_status {
  REGISTERS_STATUS_IDLE,
  REGISTERS_STATUS_BUSY,
  REGISTERS_STATUS_DONE,
  REGISTERS_STATUS_ERROR
};

typedef struct registers_block {
  unsigned id;
  unsigned first;
  unsigned length;
  const char *name;
  const char *about;
} registers_block;

typedef struct registers_field {
  unsigned address;
  unsigned count;
  enum registers_type type;
  enum registers_access access;
  const char *name;
  const char *unit;
  double least;
  double most;
  const core_choice *list; /* NULL: least to most */
  double initial;
  const char *about;
} registers_field;

extern const registers_block registers_blocks[REGISTERS_BLOCKS];

/* In the order of the list; ends with an entry whose name is NULL. */
extern const registers_field registers_fields[];

/* The registers of one value. */
unsigned registers_width(enum registers_type type);

/* Writes the defaults and all that never changes into an image. */
void registers_reset(uint16_t image[REGISTERS_END]);

/* Whether all of `count` registers (at least 1) from an address on can be read. */
bool registers_readable(unsigned address, unsigned count);

/* Checks a write of `count` registers from an address on, `values` in the order of a PDU: they can
 * all be written, no value is covered in part, each is in its range. Status OK, BAD_ADDRESS or
 * BAD_VALUE; *at: the register at fault, where its value begins, in the block that is not mirrored.
 */
wire_error registers_check(unsigned address, unsigned count, const uint8_t *values, unsigned *at);

/* Writes what registers_check() has passed, and its mirror. */
void registers_write(uint16_t image[REGISTERS_END], unsigned address, unsigned count,
                     const uint8_t *values);

/* Whether `count` registers from an address on include another one, or its mirror. */
bool registers_include(unsigned address, unsigned count, unsigned another);

/* The register of the input that a field of an eval request is made from, for `index` of an array;
 * REGISTERS_AT_COMMIT when there is none of its own. */
unsigned registers_of_field(const char *field, uint64_t index);

/* Values of an image. */
static inline uint16_t registers_u16(const uint16_t image[REGISTERS_END], unsigned address) {
  return image[address];
}

static inline float registers_f32(const uint16_t image[REGISTERS_END], unsigned address) {
  const uint32_t bits = (uint32_t)image[address] << 16 | image[address + 1];
  float value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

/* Setting one sets its mirror, if it has one. */
void registers_set_u16(uint16_t image[REGISTERS_END], unsigned address, unsigned value);
void registers_set_u32(uint16_t image[REGISTERS_END], unsigned address, uint32_t value);
void registers_set_f32(uint16_t image[REGISTERS_END], unsigned address, float value);
void registers_set_f64(uint16_t image[REGISTERS_END], unsigned address, double value);

/* A text field of `count` registers; text that is longer is cut. */
void registers_set_text(uint16_t image[REGISTERS_END], unsigned address, unsigned count,
                        const char *text);

/* The value of an optional field; NaN: not given. */
double registers_optional(const uint16_t image[REGISTERS_END], unsigned parameter);

/* Writes the tables of REGISTERS.md, as Markdown, through print(context, text). */
void registers_describe(void (*print)(void *context, const char *text), void *context);

#endif
