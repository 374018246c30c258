/* registers: the Modbus register map, which REGISTERS.md describes.
 *
 * An image of the map is an array of REGISTERS_END registers in the machine's byte order. Its index
 * is the PDU address; mirrors have no values of their own. Nothing here uses a socket or allocates memory.
 */
#ifndef DIPOLED_REGISTERS_H
#define DIPOLED_REGISTERS_H

#include <float.h>
#include <math.h>
#include <string.h>

#include "core/tissue/tissue.h"
#include "proto/wire.h"

#define REGISTERS_MAGIC 0x4449504c
#define REGISTERS_VERSION 1

enum {
  REGISTERS_RADII_MAX = 50,
  REGISTERS_WANTED_MAX = 4, /* of an eval: R, albedo, cdf, S */
  REGISTERS_MIRROR = 2000,  /* distance from a register to its mirror, if it has one */
  REGISTERS_FIT_READINGS_MAX = 25,
  REGISTERS_WAVELENGTHS_MAX = 6, /* of the fit of a tissue, as the three that follow */
  REGISTERS_PLACES_MAX = 8,
  REGISTERS_SOUGHT_MAX = 8,
  REGISTERS_PROPERTIES_MAX = 18,
  REGISTERS_TISSUE_READINGS_MAX = REGISTERS_WAVELENGTHS_MAX * REGISTERS_PLACES_MAX,
  REGISTERS_END = 11320, /* registers in an image */
  REGISTERS_COILS = 100, /* coils, from address 0 on */
  REGISTERS_ERROR_TEXT_BYTES = 80,
  REGISTERS_FIT_STATUS_NAME_BYTES = 16,
};

/* The quantities that can be wanted: those that have output registers. */
#define REGISTERS_QUANTITIES                                                                       \
  (CORE_QUANTITY_R | CORE_QUANTITY_ALBEDO | CORE_QUANTITY_CDF | CORE_QUANTITY_S | CORE_QUANTITY_T)

/* PDU address of a parameter of core. */
#define REGISTERS_PARAMETER_AT(id)                                                                 \
  ((id) == CORE_PARAMETER_TOLERANCE ? 104 : 216 + 2 * (id) + ((id) > 16 ? 6 : 0))

enum {
  REGISTERS_BLOCKS = 0
#define REGISTERS_BLOCK(id, IDENT, first, length, name, about) +1
#include "proto/registers.def"
};

/* The kinds of jobs that a unit can have, from 0 on. */
enum registers_job_kind {
#define REGISTERS_JOB(MESSAGE, ...) REGISTERS_JOB_##MESSAGE,
#include "proto/registers.def"
  REGISTERS_JOBS
};

static inline bool registers_is_fit(enum registers_job_kind kind) {
  return kind == REGISTERS_JOB_FIT || kind == REGISTERS_JOB_FIT_TISSUE;
}

/* The PDU address of each field: REGISTERS_AT_COMMIT and so on. */
enum registers_address {
#define REGISTERS_FIELD(IDENT, address, ...) REGISTERS_AT_##IDENT = (address),
#include "proto/registers.def"
};

enum registers_type {
  REGISTERS_U16,
  REGISTERS_U32,
  REGISTERS_F32,
  REGISTERS_F64,
  REGISTERS_TEXT,
  REGISTERS_BITS
};

enum registers_access { REGISTERS_RO, REGISTERS_RW, REGISTERS_OPTIONAL };

/* Values of the register `status`. */
enum registers_status {
  REGISTERS_STATUS_IDLE,
  REGISTERS_STATUS_BUSY,
  REGISTERS_STATUS_DONE,
  REGISTERS_STATUS_ERROR,
  REGISTERS_STATUS_CANCELLED,
  REGISTERS_STATUS_UNFITTED, /* a fit that is no success */
};

/* The distances of a job's other registers from its register `status`. */
enum registers_behind_status {
  REGISTERS_BEHIND_DONE = 1,
  REGISTERS_BEHIND_ERROR,
  REGISTERS_BEHIND_ERROR_ADDRESS,
  REGISTERS_BEHIND_SEQUENCE,
  REGISTERS_BEHIND_COUNT,
};

/* The PDU addresses of the fields that all kinds of jobs have. */
typedef struct registers_job {
  unsigned message; /* of the protocol */
  unsigned commit;
  unsigned cancel;
  unsigned deadline; /* 0: there is none */
  unsigned status;
  unsigned progress; /* 0: there is none */
  unsigned error_text;
} registers_job;

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
  const core_choice *list; /* the allowed ids; NULL: all values from least to most are allowed */
  double initial;
  const char *about;
} registers_field;

extern const registers_block registers_blocks[REGISTERS_BLOCKS];

extern const registers_job registers_jobs[REGISTERS_JOBS];

/* The fields in the order of registers.def. The last entry has the name NULL. */
extern const registers_field registers_fields[];

/* Returns how many registers one value takes. */
static inline unsigned registers_width(enum registers_type type) {
  return type == REGISTERS_F64 ? 4 : type == REGISTERS_U32 || type == REGISTERS_F32 ? 2 : 1;
}

/* Sets an image to the defaults and constants of the map. */
void registers_reset(uint16_t image[REGISTERS_END]);

/* Returns true if `count` registers, at least 1, can all be read from an address on. */
bool registers_readable(unsigned address, unsigned count);

/* Sets the results of a job to what they are before the first ones. */
void registers_clear(uint16_t image[REGISTERS_END], const registers_job *job);

/* Checks a write of `count` registers from an address on. `values` holds them as in a PDU. First it
 * checks that all of them are writable and each value is whole, then that each value is in its
 * range. Returns status OK, BAD_ADDRESS or BAD_VALUE. With a fault, *at is the first register of
 * the value at fault, not its mirror. */
wire_error registers_check(unsigned address, unsigned count, const uint8_t *values, unsigned *at);

/* Writes registers that registers_check() has passed, or that are restored. If that sets `defaults`,
 * all other registers that can be written get their defaults before. */
void registers_write(uint16_t image[REGISTERS_END], unsigned address, unsigned count,
                     const uint8_t *values);

/* Returns true if `count` registers from an address on include the register `another` or its
 * mirror. */
bool registers_include(unsigned address, unsigned count, unsigned another);

/* Returns the field of this name that a job's request comes from: in the block of its commit, or else
 * in block 2 or 3. is_result: that its reply goes to, in the block of its status. NULL: there is none. */
const registers_field *registers_named(const registers_job *job, const char *name, bool is_result);

/* Returns the register that a field of a job's request comes from. `index` is the position in an
 * array. Returns the register of the commit if the field has no register. */
unsigned registers_of_field(const registers_job *job, const char *field, uint64_t index);

/* Returns the register of an error's field. If there is none, `allowed` then names the field, too. */
unsigned registers_of_error(const registers_job *job, wire_error *error);

/* These read one value of an image, or of registers. */
static inline uint16_t registers_u16(const uint16_t *image, unsigned address) {
  return image[address];
}

static inline uint32_t registers_u32(const uint16_t *image, unsigned address) {
  uint32_t words;
  memcpy(&words, &image[address], sizeof words);
  return words << 16 | words >> 16; /* on machines whose lowest byte is the first (proto/wire.c) */
}

static inline float registers_f32(const uint16_t *image, unsigned address) {
  const uint32_t bits = registers_u32(image, address);
  float value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

/* Reads `count` registers, as in a PDU. */
void registers_read(const uint16_t image[REGISTERS_END], unsigned address, unsigned count,
                    uint8_t *values);

/* These set one value. */
static inline void registers_set_u16(uint16_t *image, unsigned address, unsigned value) {
  image[address] = (uint16_t)value;
}

static inline void registers_set_u32(uint16_t *image, unsigned address, uint32_t value) {
  const uint32_t words = value << 16 | value >> 16;
  memcpy(&image[address], &words, sizeof words);
}

static inline void registers_set_f32(uint16_t *image, unsigned address, float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  registers_set_u32(image, address, bits);
}

static inline void registers_set_f64(uint16_t *image, unsigned address, double value) {
  uint64_t bits;
  memcpy(&bits, &value, sizeof bits);
  registers_set_u32(image, address, (uint32_t)(bits >> 32));
  registers_set_u32(image, address + 2, (uint32_t)bits);
}

/* Sets a text field of `count` registers. Cuts text that is longer. */
void registers_set_text(uint16_t image[REGISTERS_END], unsigned address, unsigned count,
                        const char *text);

/* Returns the value of a field of type F32. A float32 that is the nearest to a limit of the field
 * counts as this limit: (float)0.001 is above 0.001, and (float)1e-6 is below 1e-6. The limits are
 * those of the field's range, for eta also those of the moments, and for the tolerance also that of
 * lut. An optional value that is not given is NaN. */
double registers_number(const uint16_t image[REGISTERS_END], unsigned address);

/* Returns how many digits a text needs for a limit of a field of this type. */
int registers_digits(enum registers_type type);

/* Writes the bits that a field of type BITS may be a sum of, for example "a sum of 1, 2, 4". */
void registers_bits_text(const registers_field *field, char *text, size_t room);

#endif
