#include "proto/registers.h"

#include <stdio.h>

#include "core/lut/lut.h"

const registers_block registers_blocks[REGISTERS_BLOCKS] = {
#define REGISTERS_BLOCK(id, IDENT, first, length, name, about) {id, first, length, name, about},
#include "proto/registers.def"
};

const registers_job registers_jobs[REGISTERS_JOBS] = {
#define REGISTERS_JOB(MESSAGE, PREFIX, deadline, progress)                                         \
  {WIRE_TYPE_##MESSAGE,                                                                            \
   REGISTERS_AT_##PREFIX##COMMIT,                                                                  \
   REGISTERS_AT_##PREFIX##CANCEL,                                                                  \
   deadline,                                                                                       \
   REGISTERS_AT_##PREFIX##STATUS,                                                                  \
   progress,                                                                                       \
   REGISTERS_AT_##PREFIX##ERROR_TEXT},
#include "proto/registers.def"
};

const registers_field registers_fields[] = {
#define REGISTERS_FIELD(IDENT, address, count, TYPE, ACCESS, name, unit, least, most, list,        \
                        initial, about)                                                            \
  {address, count, REGISTERS_##TYPE, REGISTERS_##ACCESS, name, unit, least, most, list,            \
   initial, about},
#include "proto/registers.def"
    {0, 0, REGISTERS_U16, REGISTERS_RO, NULL, NULL, 0, 0, NULL, 0, NULL},
};

/* ---- what is at an address ------------------------------------------------------------------- */

#define WIDTH_U16 1
#define WIDTH_U32 2
#define WIDTH_F32 2
#define WIDTH_F64 4
#define WIDTH_TEXT 1
#define WIDTH_BITS 1

enum index {
#define REGISTERS_FIELD(IDENT, ...) INDEX_##IDENT,
#include "proto/registers.def"
  FIELDS
};

/* For each register, 1 + the index of its block, or 0 if it is in no block. field_at holds the same
 * for fields. The compiler refuses overlaps. */
static const uint8_t block_at[REGISTERS_END] = {
#define REGISTERS_BLOCK(id, IDENT, first, length, name, about)                                     \
  [(first)...(first) + (length)-1] = (id),
#include "proto/registers.def"
};

static const uint16_t field_at[REGISTERS_END] = {
#define REGISTERS_FIELD(IDENT, address, count, TYPE, ...)                                          \
  [(address)...(address) + (count)*WIDTH_##TYPE - 1] = 1 + INDEX_##IDENT,
#include "proto/registers.def"
};

_Static_assert(FIELDS < UINT16_MAX, "two bytes hold each");

/* Returns the field of a register outside the mirror, or NULL if the register has none. */
static const registers_field *find_field(unsigned address) {
  return address < REGISTERS_END && field_at[address] > 0 ? &registers_fields[field_at[address] - 1]
                                                          : NULL;
}

/* Registers and mirrors alternate: blocks from 0 on, mirrors from 2000 on, blocks from 4000 on, and
 * so forth. */
static bool is_mirror(unsigned address) {
  return address / REGISTERS_MIRROR % 2 == 1;
}

/* Maps a mirror to its register, and a register to itself. */
static unsigned unmirrored(unsigned address) {
  return is_mirror(address) ? address - REGISTERS_MIRROR : address;
}

#define REGISTERS_FIELD(IDENT, address, count, TYPE, ...)                                          \
  _Static_assert(WIDTH_##TYPE != 2 || (address) % 2 == 0, "the mirror is found by the lowest "     \
                                                          "bit");
#include "proto/registers.def"

static bool is_mirrored(unsigned address) {
  const unsigned mirror = address + REGISTERS_MIRROR;
  return !is_mirror(address) && mirror < REGISTERS_END && block_at[mirror] > 0;
}

/* Returns whether a request, which is shorter than the distance of a mirror, has registers of none. */
static bool is_plain(unsigned address, unsigned count) {
  return !is_mirror(address) && !is_mirror(address + count - 1);
}

/* Returns where the image has a register, or that of a mirror, which swaps the words of values of two. */
static unsigned image_index(unsigned address) {
  if (!is_mirror(address)) {
    return address;
  }
  const registers_field *field = find_field(unmirrored(address));
  return unmirrored(address) ^ (field != NULL && registers_width(field->type) == 2);
}

bool registers_readable(unsigned address, unsigned count) {
  const unsigned end = address + count;
  while (address < end) {
    if (address >= REGISTERS_END || block_at[address] == 0) {
      return false;
    }
    const registers_block *block = &registers_blocks[block_at[address] - 1];
    address = block->first + block->length;
  }
  return true;
}

bool registers_include(unsigned address, unsigned count, unsigned another) {
  return another - address < count || another + REGISTERS_MIRROR - address < count;
}

static bool is_input_block(unsigned block) {
  return block == block_at[REGISTERS_AT_COMMIT] || block == block_at[REGISTERS_AT_WANTED] ||
         block == block_at[REGISTERS_AT_LAYER_COUNT];
}

const registers_field *registers_named(const registers_job *job, const char *name, bool is_result) {
  const unsigned own = block_at[is_result ? job->status : job->commit];
  const registers_field *found = NULL;
  for (const registers_field *at = registers_fields; at->name != NULL; at++) {
    const unsigned block = block_at[at->address];
    if ((block == own || (found == NULL && !is_result && is_input_block(block))) &&
        (at->access == REGISTERS_RO) == is_result && strcmp(at->name, name) == 0) {
      found = at;
      if (block == own) {
        break;
      }
    }
  }
  return found;
}

unsigned registers_of_field(const registers_job *job, const char *field, uint64_t index) {
  char below[64];
  snprintf(below, sizeof below, "below_%s", field);
  const registers_field *found = index > 0 ? registers_named(job, below, false) : NULL;
  found = found != NULL ? found : registers_named(job, field, false);
  return found == NULL ? job->commit
                       : found->address + (unsigned)(index < found->count ? index : 0) *
                                              registers_width(found->type);
}

unsigned registers_of_error(const registers_job *job, wire_error *error) {
  const unsigned at = registers_of_field(job, error->field, error->index);
  if (at == job->commit && error->field[0] != '\0') {
    char named[sizeof error->field + sizeof error->allowed + 2];
    snprintf(named, sizeof named, "%s: %s", error->field, error->allowed);
    snprintf(error->allowed, sizeof error->allowed, "%.*s", (int)sizeof error->allowed - 1, named);
  }
  return at;
}

/* ---- values ---------------------------------------------------------------------------------- */

static uint16_t swapped(uint16_t word) {
  return (uint16_t)(word << 8 | word >> 8);
}

void registers_read(const uint16_t image[REGISTERS_END], unsigned address, unsigned count,
                    uint8_t *values) {
  const bool plain = is_plain(address, count);
  for (size_t i = 0; i < count; i++) {
    const uint16_t word = swapped(image[plain ? address + i : image_index(address + (unsigned)i)]);
    memcpy(values + 2 * i, &word, sizeof word);
  }
}

void registers_set_text(uint16_t image[REGISTERS_END], unsigned address, unsigned count,
                        const char *text) {
  for (unsigned i = 0; i < count; i++) {
    const unsigned high = (unsigned char)*text;
    text += high != 0;
    const unsigned low = (unsigned char)*text;
    text += low != 0;
    registers_set_u16(image, address + i, high << 8 | low);
  }
}

static bool is_given(const registers_field *field, double value) {
  return !(value == -1 || (value == 0 && field->least > 0));
}

/* Further limits of float fields. A float32 that is the nearest to one of them counts as this
 * limit. */
static const struct limit {
  unsigned address;
  double value;
} limits[] = {
#define ETA_LIMITS(P, id, IDENT, name, about, eta_min, eta_max)                                    \
  {REGISTERS_AT_ETA, eta_min}, {REGISTERS_AT_ETA, eta_max},
    CORE_EACH_MOMENTS(ETA_LIMITS, ){REGISTERS_AT_PARAMETER_TOLERANCE, CORE_LUT_TOLERANCE_MIN},
};

double registers_number(const uint16_t image[REGISTERS_END], unsigned address) {
  const registers_field *field = find_field(address);
  const float value = registers_f32(image, address);
  if (field->access == REGISTERS_OPTIONAL && !is_given(field, (double)value)) {
    return (double)NAN;
  }
  const double ends[] = {field->least, field->most};
  for (size_t i = 0; i < sizeof ends / sizeof ends[0]; i++) {
    if (value == (float)ends[i]) {
      return ends[i];
    }
  }
  for (size_t i = 0; i < sizeof limits / sizeof limits[0]; i++) {
    if (limits[i].address == field->address && value == (float)limits[i].value) {
      return limits[i].value;
    }
  }
  return (double)value;
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Returns register number `index` of a PDU's values. */
static uint16_t word_at(const uint8_t *values, size_t index) {
  uint16_t word;
  memcpy(&word, values + 2 * index, sizeof word);
  return swapped(word); /* on machines whose lowest byte is the first (proto/wire.c) */
}

static bool is_in_range(const registers_field *field, double value) {
  if (field->type == REGISTERS_F32) {
    /* The float32 that is the nearest to a limit counts as the limit. */
    return (value >= (double)(float)field->least && value <= (double)(float)field->most) ||
           (field->access == REGISTERS_OPTIONAL && !is_given(field, value));
  }
  if (field->list != NULL) {
    return (value == 0 && field->least == 0) ||
           core_choice_by_id(field->list, (unsigned)value) != NULL;
  }
  return value >= field->least &&
         (field->type == REGISTERS_BITS ? ((unsigned)value & ~(unsigned)field->most) == 0
                                        : value <= field->most);
}

static wire_error bad_address(const char *allowed) {
  return wire_error_make(WIRE_STATUS_BAD_ADDRESS, "", allowed);
}

int registers_digits(enum registers_type type) {
  return type == REGISTERS_U32 ? 10 : 8;
}

void registers_bits_text(const registers_field *field, char *text, size_t room) {
  size_t length = (size_t)snprintf(text, room, "a sum of");
  const char *before = " ";
  for (unsigned bit = 1; bit <= (unsigned)field->most && length < room; bit *= 2) {
    if ((unsigned)field->most & bit) {
      length += (size_t)snprintf(text + length, room - length, "%s%u", before, bit);
      before = ", ";
    }
  }
}

static wire_error out_of_range(const registers_field *field) {
  char allowed[80];
  if (field->list != NULL) {
    return wire_error_not_in_list(field->name, field->list, field->least == 0 ? "0," : "one of");
  }
  if (field->type == REGISTERS_BITS) {
    registers_bits_text(field, allowed, sizeof allowed);
    return wire_error_make(WIRE_STATUS_BAD_VALUE, field->name, allowed);
  }
  snprintf(allowed, sizeof allowed, "%.*g to %.*g%s", registers_digits(field->type), field->least,
           registers_digits(field->type), field->most,
           field->access == REGISTERS_OPTIONAL ? ", or -1: not given" : "");
  return wire_error_make(WIRE_STATUS_BAD_VALUE, field->name, allowed);
}

/* Returns the field that a write to a register changes, or NULL if that register cannot be written.
 * *at is the register outside the mirror. */
static const registers_field *find_writable(unsigned address, unsigned *at) {
  *at = unmirrored(address);
  const registers_field *field = address == *at || is_mirrored(*at) ? find_field(*at) : NULL;
  if (field == NULL) {
    *at = address;
    return NULL;
  }
  return field->access != REGISTERS_RO ? field : NULL;
}

/* For a write of a value at `here`, sets *field to the field that it changes, *at to the first
 * register of the value outside the mirror, and *width to the number of its registers. The write
 * has the registers up to `end` - 1. Returns NULL, or what is allowed if such a write is not. */
static const char *check_address(unsigned here, unsigned end, unsigned *at,
                                 const registers_field **field, unsigned *width) {
  *field = find_writable(here, at);
  if (*field == NULL) {
    return "a register of the map that can be written";
  }
  *width = registers_width((*field)->type);
  const unsigned inside = (*at - (*field)->address) & (*width - 1); /* of 1, 2 or 4 */
  *at -= inside;
  return inside == 0 && end - here >= *width ? NULL : "both registers of a value in one request";
}

/* Returns the value that a write gives to a field. words: the registers that are written. swapped:
 * whether they are written in the mirror. */
static double value_of(const registers_field *field, const uint8_t *words, bool swapped) {
  const uint16_t one = word_at(words, 0);
  if (registers_width(field->type) == 1) {
    return one;
  }
  const uint16_t other = word_at(words, 1);
  const uint32_t bits = swapped ? (uint32_t)other << 16 | one : (uint32_t)one << 16 | other;
  float real;
  memcpy(&real, &bits, sizeof real);
  return field->type == REGISTERS_F32 ? (double)real : (double)bits;
}

wire_error registers_check(unsigned address, unsigned count, const uint8_t *values, unsigned *at) {
  const unsigned end = address + count;
  const registers_field *field, *wrong = NULL; /* wrong: the first field whose value is wrong */
  unsigned width, wrong_at = 0;
  for (unsigned here = address; here < end;) {
    const char *allowed = check_address(here, end, at, &field, &width);
    if (allowed != NULL) { /* counts are checked before values */
      return bad_address(allowed);
    }
    const bool swapped = here != *at;
    const unsigned field_end = field->address + field->count * width;
    for (unsigned base = *at; base < field_end && here + width <= end; base += width) {
      if (wrong == NULL &&
          !is_in_range(field, value_of(field, values + 2 * (here - address), swapped))) {
        wrong = field;
        wrong_at = base;
      }
      here += width;
    }
  }
  if (wrong != NULL) {
    *at = wrong_at;
    return out_of_range(wrong);
  }
  return wire_error_none();
}

static void set_initial(uint16_t image[REGISTERS_END], const registers_field *field);

static void set_defaults(uint16_t image[REGISTERS_END]) {
  for (const registers_field *field = registers_fields; field->name != NULL; field++) {
    if (field->access != REGISTERS_RO) {
      set_initial(image, field);
    }
  }
}

static void put_words(uint16_t image[REGISTERS_END], unsigned address, unsigned count,
                      const uint8_t *values) {
  const bool plain = is_plain(address, count);
  for (size_t i = 0; i < count; i++) {
    image[plain ? address + i : image_index(address + (unsigned)i)] = word_at(values, i);
  }
}

void registers_write(uint16_t image[REGISTERS_END], unsigned address, unsigned count,
                     const uint8_t *values) {
  put_words(image, address, count, values);
  if (image[REGISTERS_AT_DEFAULTS] != 0) {
    set_defaults(image);
    put_words(image, address, count, values);
    image[REGISTERS_AT_DEFAULTS] = 0;
  }
}

/* ---- what is there from the start ------------------------------------------------------------ */

static void set_initial(uint16_t image[REGISTERS_END], const registers_field *field) {
  const unsigned width = registers_width(field->type);
  for (unsigned i = 0; i < field->count; i++) {
    const unsigned address = field->address + i * width;
    switch (field->type) {
    case REGISTERS_U16:
    case REGISTERS_BITS:
    case REGISTERS_TEXT:
      registers_set_u16(image, address, (unsigned)field->initial);
      break;
    case REGISTERS_U32:
      registers_set_u32(image, address, (uint32_t)field->initial);
      break;
    case REGISTERS_F32:
      registers_set_f32(image, address, (float)field->initial);
      break;
    case REGISTERS_F64:
      registers_set_f64(image, address, field->initial);
      break;
    }
  }
}

void registers_clear(uint16_t image[REGISTERS_END], const registers_job *job) {
  for (const registers_field *field = registers_fields; field->name != NULL; field++) {
    if (field->access == REGISTERS_RO && block_at[field->address] == block_at[job->status] &&
        field->address > job->status + REGISTERS_BEHIND_COUNT &&
        field->address != job->error_text) {
      set_initial(image, field);
    }
  }
}

static void set_self_tests(uint16_t image[REGISTERS_END]) {
  for (unsigned i = 0; i < 2; i++) {
    const uint16_t word = image[REGISTERS_AT_SELF_TEST_ABCD + i];
    image[REGISTERS_AT_SELF_TEST_CDAB + 1 - i] = word;
    image[REGISTERS_AT_SELF_TEST_BADC + i] = swapped(word);
    image[REGISTERS_AT_SELF_TEST_DCBA + 1 - i] = swapped(word);
  }
}

void registers_reset(uint16_t image[REGISTERS_END]) {
  memset(image, 0, REGISTERS_END * sizeof *image);
  for (const registers_field *field = registers_fields; field->name != NULL; field++) {
    set_initial(image, field);
  }
  set_self_tests(image);
  for (unsigned i = 0; i < REGISTERS_BLOCKS; i++) {
    uint16_t *entry = &image[REGISTERS_AT_BLOCKS + 3 * i];
    entry[0] = (uint16_t)registers_blocks[i].id;
    entry[1] = (uint16_t)registers_blocks[i].first;
    entry[2] = (uint16_t)registers_blocks[i].length;
  }
}
