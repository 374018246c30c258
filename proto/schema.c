#include "proto/schema.h"

#include <assert.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include "core/fit/spectral.h"
#include "core/gather/gather.h"
#include "core/montecarlo/montecarlo.h"
#include "core/tissue/tissue.h"
#include "core/varying.h"

/* ---- tables ---------------------------------------------------------------------------------- */

#define ONE_OF(choices) .list = choices
#define SUM_OF(choices) .list = choices, .bits = true
#define SPAN(from, to) .least = from, .most = to, .spans = true
#define RANGE(from, to) SPAN(from, to), .ranged = true
#define AT_LEAST(from) RANGE(from, (double)INFINITY)
#define FLAG RANGE(0, 1), .allowed = "0 or 1"
#define PADDING RANGE(0, 0), .hidden = true, .allowed = "0"
#define TOO_LARGE(to) .too_large = to
#define OR_ZERO .or_zero = true
#define ZERO_WITH(field, id, text) .zero_with = field, .zero_at = id, .zero_text = text
#define ALLOWED(text) .allowed = text
#define UNIT(text) .unit = text
#define USUAL(number) .usual = number
#define REQUIRED .required = true
#define HIDDEN .hidden = true
#define STATUS(IDENT) .status = WIRE_STATUS_##IDENT
#define MODEL ONE_OF(core_models), USUAL(CORE_MODEL_TRANSPORT)
#define MOMENTS ONE_OF(core_moments_list), USUAL(CORE_MOMENTS_EXACT)
#define ETA SPAN(CORE_ETA_MIN, CORE_ETA_MAX), USUAL(1.3)
#define COUNT HIDDEN, STATUS(BAD_COUNT)
#define ERROR_TARGET OR_ZERO, RANGE(1e-9, 1), ALLOWED("0 (none), or 1e-9 to 1")
#define LAYER_COUNT COUNT, RANGE(1, CORE_LAYERS_MAX), USUAL(1)

#define ONE(value, field, about, ...)                                                              \
  {.name = #field,                                                                                 \
   .kind = SCHEMA_##value,                                                                         \
   .count = 1,                                                                                     \
   .bytes = WIRE_SIZE_##value,                                                                     \
   .meaning = about,                                                                               \
   __VA_ARGS__},
#define ARRAY(value, field, values, about, ...)                                                    \
  {.name = #field,                                                                                 \
   .kind = SCHEMA_##value,                                                                         \
   .count = values,                                                                                \
   .bytes = (values)*WIRE_SIZE_##value,                                                            \
   .meaning = about,                                                                               \
   __VA_ARGS__},
#define TEXT(field, values, about)                                                                 \
  {.name = #field, .kind = SCHEMA_text, .count = values, .bytes = values, .meaning = about},
#define WIRE_STRUCTURE(structure)                                                                  \
  static const schema_field fields_of_##structure[] = {                                            \
      WIRE_FIELDS_##structure(ONE, ARRAY, TEXT){.name = NULL}};
#include "proto/messages.def"

const schema_structure schema_structures[SCHEMA_STRUCTURES] = {
#define WIRE_STRUCTURE(structure) {#structure, fields_of_##structure, WIRE_BYTES_##structure},
#include "proto/messages.def"
};

/* A struct without text is on the wire as it is in memory. */
#define NO_TEXT(...)
#define ONE_TEXT(...) +1
#define WIRE_STRUCTURE(name)                                                                       \
  _Static_assert(sizeof(wire_##name) == WIRE_BYTES_##name ||                                       \
                     WIRE_FIELDS_##name(NO_TEXT, NO_TEXT, ONE_TEXT) + 0 > 0,                       \
                 #name " has gaps");
#include "proto/messages.def"

#define STRUCTURE(name) &schema_structures[SCHEMA_STRUCTURE_##name]
#define BEGINS_ONE(one) .structures = {STRUCTURE(one)}, .fixed_bytes = WIRE_BYTES_##one
#define BEGINS_TWO(one, two)                                                                       \
  .structures = {STRUCTURE(one), STRUCTURE(two)}, .fixed_bytes = WIRE_BYTES_##one + WIRE_BYTES_##two
#define BEGINS_OF(one, two, name, ...) name
#define BEGINS(...) BEGINS_OF(__VA_ARGS__, BEGINS_TWO, BEGINS_ONE, )(__VA_ARGS__)

/* Before any text, members of a struct have the same offsets as on the wire. */
#define NUMBER(structure, field, before, bits)                                                     \
  {                                                                                                \
#field, (uint16_t)((before) + offsetof(wire_##structure, field)),                              \
        sizeof((wire_##structure *)NULL)->field, bits                                              \
  }
#define N(structure, field) NUMBER(structure, field, 0, 0)
#define BITS(structure, field, bits) NUMBER(structure, field, 0, bits)
#define AFTER(first, structure, field) NUMBER(structure, field, WIRE_BYTES_##first, 0)

#define u8 SCHEMA_u8
#define u32 SCHEMA_u32
#define u64 SCHEMA_u64
#define f32 SCHEMA_f32
#define f64 SCHEMA_f64
#define REAL(structure) SCHEMA_REAL, .evaluator = N(structure, evaluator)
#define LIST_OF(name) SCHEMA_LIST, .structure = STRUCTURE(name)
#define COUNT_OF(...) .count = {__VA_ARGS__}
#define ARRAYS(...) .arrays = {__VA_ARGS__}
#define TIMES(n) .times = n
#define MORE(n) .more = n
#define WHEN(number, value) .when = number, .is = value
#define UNLESS(number, value) .when = number, .is = value, .unless = true
#define NEVER .never = true
#define EXACT .exact = true
#define ALL_THAT_IS_LEFT .rest = true
#define FORM(name) .form = SCHEMA_##name
#define ABOUT(text) .about = text
#define PART(part, of_many, element, ...)                                                          \
  { .name = part, .plural = of_many, .kind = element, __VA_ARGS__ }
#define WIRE_PAYLOAD(payload, begins, ...)                                                         \
  static const schema_part parts_of_##payload[SCHEMA_PARTS + 1] = {__VA_ARGS__};                   \
  const schema_payload schema_##payload = {.name = #payload, begins, .parts = parts_of_##payload};
#include "proto/messages.def"

const schema_payload schema_nothing = {.name = "nothing", .parts = &parts_of_hello_request[0]};

const schema_message schema_messages[] = {
#define WIRE_MESSAGE(type, IDENT, name, ROLE, LATENCY, request, reply, about)                      \
  {type, name, &schema_##request, &schema_##reply, about},
#include "proto/messages.def"
    {0, NULL, NULL, NULL, NULL},
};

/* ---- fields ---------------------------------------------------------------------------------- */

const char *schema_kind_name(enum schema_kind kind) {
  static const char *const names[] = {
      [SCHEMA_u8] = "u8",   [SCHEMA_u16] = "u16", [SCHEMA_u32] = "u32",   [SCHEMA_u64] = "u64",
      [SCHEMA_f32] = "f32", [SCHEMA_f64] = "f64", [SCHEMA_text] = "text", [SCHEMA_REAL] = "real",
  };
  return names[kind];
}

static size_t kind_bytes(enum schema_kind kind) {
  static const uint8_t bytes[] = {
      [SCHEMA_u8] = 1,  [SCHEMA_u16] = 2, [SCHEMA_u32] = 4, [SCHEMA_u64] = 8,
      [SCHEMA_f32] = 4, [SCHEMA_f64] = 8, [SCHEMA_text] = 1};
  return bytes[kind];
}

const schema_field *schema_field_at(const schema_payload *payload, const char *name, size_t *at) {
  *at = 0;
  for (int i = 0; i < 2 && payload->structures[i] != NULL; i++) {
    for (const schema_field *field = payload->structures[i]->fields; field->name != NULL; field++) {
      if (field->name[0] == name[0] && strcmp(field->name, name) == 0) {
        return field;
      }
      *at += field->bytes;
    }
  }
  return NULL;
}

const schema_field *schema_field_of(const schema_payload *payload, const char *name) {
  size_t at;
  return schema_field_at(payload, name, &at);
}

unsigned schema_all_bits(const core_choice *list) {
  unsigned all = 0;
  for (; list->name != NULL; list++) {
    all |= list->id;
  }
  return all;
}

static bool is_allowed(const schema_field *field, uint64_t bits, double value) {
  return (field->or_zero && value == 0) ||
         ((field->list == NULL ||
           (field->bits ? (bits & ~(uint64_t)schema_all_bits(field->list)) == 0
                        : core_choice_by_id(field->list, (unsigned)bits) != NULL)) &&
          (!field->ranged || (value >= field->least && value <= field->most)));
}

WIRE_COLD static wire_error out_of_range(const schema_field *field) {
  char allowed[81];
  if (field->list != NULL && field->allowed == NULL) {
    return wire_error_not_in_list(field->name, field->list,
                                  field->bits      ? "a sum of"
                                  : field->or_zero ? "0 or one of"
                                                   : "one of");
  }
  if (field->most == (double)INFINITY) {
    snprintf(allowed, sizeof allowed, "at least %.10g", field->least);
  } else {
    snprintf(allowed, sizeof allowed, "%.10g to %.10g", field->least, field->most);
  }
  return wire_error_make(field->status != 0 ? field->status : WIRE_STATUS_BAD_VALUE, field->name,
                         field->allowed != NULL ? field->allowed : allowed);
}

WIRE_COLD static wire_error too_large(const schema_field *field) {
  char allowed[81];
  snprintf(allowed, sizeof allowed, "at most %.10g", field->too_large);
  return wire_error_make(WIRE_STATUS_TOO_LARGE, field->name, allowed);
}

WIRE_COLD static wire_error too_short(const schema_payload *payload) {
  char allowed[81];
  const bool two = payload->structures[1] != NULL;
  snprintf(allowed, sizeof allowed, "at least %zu: %s%s%s", payload->fixed_bytes,
           payload->structures[0]->name, two ? " and " : "",
           two ? payload->structures[1]->name : "");
  return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes", allowed);
}

double schema_number_at(const schema_field *field, const void *at) {
  const uint64_t integer = schema_bits_at(at, field->bytes / field->count);
  double real;
  memcpy(&real, &integer, sizeof real);
  return field->kind == SCHEMA_f64 ? real : (double)integer;
}

void schema_put_number(const schema_field *field, double number, void *at) {
  if (field->kind == SCHEMA_f64) {
    memcpy(at, &number, sizeof number);
  } else {
    const uint64_t integer = (uint64_t)number;
    memcpy(at, &integer, kind_bytes(field->kind));
  }
}

/* Checks a value, and sets *error if it is wrong. */
static bool check_value(const schema_field *field, uint64_t bits, wire_error *error) {
  double value;
  memcpy(&value, &bits, sizeof value);
  value = field->kind == SCHEMA_f64 ? value : (double)bits;
  if ((field->list != NULL || field->ranged) && !is_allowed(field, bits, value)) {
    *error = out_of_range(field);
    return false;
  }
  if (field->too_large > 0 && value > field->too_large) {
    *error = too_large(field);
    return false;
  }
  return true;
}

wire_error schema_check_value(const schema_field *field, uint64_t bits) {
  wire_error error = wire_error_none();
  check_value(field, bits, &error);
  return error;
}

static wire_error check_fields(const schema_payload *payload, const uint8_t *bytes, size_t count) {
  if (count < payload->fixed_bytes) {
    return too_short(payload);
  }
  const uint8_t *at = bytes;
  for (int i = 0; i < 2 && payload->structures[i] != NULL; i++) {
    for (const schema_field *field = payload->structures[i]->fields; field->name != NULL; field++) {
      const size_t field_bytes = field->bytes;
      const uint64_t bits = schema_bits_at(at, field_bytes);
      wire_error error;
      if (!check_value(field, bits, &error)) {
        return error;
      }
      if (field->zero_with != NULL && bits << 1 != 0) { /* it is neither 0 nor -0. */
        size_t with_at;
        const schema_field *with = schema_field_at(payload, field->zero_with, &with_at);
        assert(with != NULL);
        if (schema_number_at(with, bytes + with_at) == field->zero_at) {
          return wire_error_make(WIRE_STATUS_BAD_VALUE, field->name, field->zero_text);
        }
      }
      at += field_bytes;
    }
  }
  return wire_error_none();
}

/* ---- layouts --------------------------------------------------------------------------------- */

static inline uint64_t number_of(const schema_number *number, const uint8_t *start) {
  const uint64_t value = schema_bits_at(start + number->offset, number->bytes);
  return number->mask != 0 ? schema_bit_count(value & number->mask) : value;
}

/* Returns `value` times all numbers, or UINT64_MAX in place of wrapping around. */
static uint64_t times_all(uint64_t value, const schema_number numbers[SCHEMA_FACTORS],
                          const uint8_t *start) {
  for (int i = 0; i < SCHEMA_FACTORS && numbers[i].name != NULL; i++) {
    if (__builtin_mul_overflow(value, number_of(&numbers[i], start), &value)) {
      value = UINT64_MAX;
    }
  }
  return value;
}

static size_t element_bytes(const schema_part *part, const uint8_t *start) {
  return part->kind == SCHEMA_REAL
             ? core_evaluator_bytes((unsigned)number_of(&part->evaluator, start))
         : part->kind == SCHEMA_LIST ? part->structure->bytes
                                     : kind_bytes(part->kind);
}

static bool is_there(const schema_part *part, const uint8_t *start) {
  return !part->never && !part->rest &&
         (part->when.name == NULL || (number_of(&part->when, start) == part->is) != part->unless);
}

bool schema_lay_out(const schema_payload *payload, const void *start, uint64_t bytes_max,
                    schema_layout *layout, const schema_part **too_long) {
  uint64_t at = payload->fixed_bytes;
  for (int i = 0; i < SCHEMA_PARTS && payload->parts[i].name != NULL; i++) {
    const schema_part *part = &payload->parts[i];
    const bool there = is_there(part, start);
    uint64_t count = there ? times_all(part->times > 0 ? part->times : 1, part->count, start) : 0;
    count += there && count < UINT64_MAX ? part->more : 0; /* which is at most 1 */
    const uint64_t bytes = element_bytes(part, start);
    uint64_t used;
    const bool wraps =
        __builtin_mul_overflow(count, bytes, &used) || used > UINT64_MAX - WIRE_ALIGNMENT;
    const uint64_t padded = wraps ? UINT64_MAX : wire_padded(used);
    layout->parts[i].at = at;
    layout->parts[i].count = count;
    layout->parts[i].bytes = bytes;
    layout->parts[i].array_bytes = padded;
    if (__builtin_add_overflow(at, times_all(padded, part->arrays, start), &at) || at > bytes_max ||
        at == UINT64_MAX || (there && bytes == 0)) {
      if (too_long != NULL) {
        *too_long = part;
      }
      return false;
    }
  }
  layout->payload_bytes = at;
  return at <= bytes_max;
}

uint64_t schema_bytes(const schema_payload *payload, const void *start) {
  schema_layout layout;
  return schema_lay_out(payload, start, UINT64_MAX, &layout, NULL) ? layout.payload_bytes
                                                                   : UINT64_MAX;
}

uint64_t schema_part_bytes(const schema_payload *payload, const void *start, uint64_t count) {
  uint8_t fixed[2 * WIRE_BYTES_varying_reply];
  memcpy(fixed, start, payload->fixed_bytes);
  memcpy(fixed + offsetof(wire_part, count), &count, sizeof count);
  return schema_bytes(payload, fixed);
}

uint64_t schema_part_values(const schema_payload *payload, const void *start, unsigned unit,
                            uint64_t bytes_max) {
  const uint64_t none = schema_part_bytes(payload, start, 0);
  const uint64_t each = schema_part_bytes(payload, start, unit) - none;
  return each == 0          ? (bytes_max >= none ? UINT64_MAX : 0)
         : bytes_max > none ? (bytes_max - none) / each * unit
                            : 0;
}

/* ---- checking -------------------------------------------------------------------------------- */

/* Makes the error of a part that has more elements than the payload holds. */
WIRE_COLD static wire_error too_many(const schema_part *part) {
  char allowed[81];
  const char *field = "payload_bytes";
  for (int i = 0; i < SCHEMA_FACTORS && part->count[i].name != NULL; i++) {
    field = part->count[i].name;
  }
  snprintf(allowed, sizeof allowed,
           part->exact ? "as many %s as the payload holds" : "no more %s than the payload holds",
           part->plural);
  return wire_error_make(
      part->count[0].name != NULL ? WIRE_STATUS_BAD_COUNT : WIRE_STATUS_BAD_LENGTH, field, allowed);
}

/* Makes the error of a payload with bytes behind its last part. */
WIRE_COLD static wire_error too_long(const schema_payload *payload, const uint8_t *start) {
  char allowed[81];
  const schema_part *last = NULL;
  for (int i = 0; i < SCHEMA_PARTS && payload->parts[i].name != NULL; i++) {
    last =
        payload->parts[i].rest || is_there(&payload->parts[i], start) ? &payload->parts[i] : last;
  }
  if (last != NULL && last->exact) {
    return too_many(last);
  }
  if (last != NULL) {
    snprintf(allowed, sizeof allowed, "nothing after the %s but padding to a multiple of 8",
             last->plural);
  } else {
    snprintf(allowed, sizeof allowed, "%zu", payload->fixed_bytes);
  }
  return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes", allowed);
}

/* Counts the elements of a last part that takes all bytes that are left. Returns false if they are
 * no whole number. */
static bool take_rest(const schema_payload *payload, size_t count, schema_layout *layout) {
  for (int i = 0; i < SCHEMA_PARTS && payload->parts[i].name != NULL; i++) {
    if (payload->parts[i].rest) {
      layout->parts[i].count = (count - layout->payload_bytes) / layout->parts[i].bytes;
      layout->parts[i].array_bytes = layout->parts[i].count * layout->parts[i].bytes;
      layout->payload_bytes += layout->parts[i].array_bytes;
    }
  }
  return layout->payload_bytes == count;
}

static wire_error check_padding(const schema_payload *payload, const uint8_t *bytes,
                                const schema_layout *layout) {
  static const uint8_t zeros[WIRE_ALIGNMENT];
  for (int i = 0; i < SCHEMA_PARTS && payload->parts[i].name != NULL; i++) {
    const uint64_t used = layout->parts[i].count * layout->parts[i].bytes;
    if (memcmp(bytes + layout->parts[i].at + used, zeros,
               (size_t)(layout->parts[i].array_bytes - used)) != 0) {
      return wire_error_make(WIRE_STATUS_BAD_VALUE, payload->parts[i].name,
                             "zero bytes of padding behind the last number");
    }
  }
  return wire_error_none();
}

wire_error schema_check(const schema_payload *payload, const uint8_t *bytes, size_t count,
                        schema_layout *layout) {
  const schema_part *part = NULL;
  const wire_error error = check_fields(payload, bytes, count);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  if (!schema_lay_out(payload, bytes, count, layout, &part)) {
    return too_many(part);
  }
  return take_rest(payload, count, layout) ? check_padding(payload, bytes, layout)
                                           : too_long(payload, bytes);
}

bool schema_is_whole(const schema_payload *payload, const uint8_t *bytes, uint64_t count,
                     schema_layout *layout) {
  return count >= payload->fixed_bytes && schema_lay_out(payload, bytes, count, layout, NULL) &&
         layout->payload_bytes == count;
}

/* ---- writing --------------------------------------------------------------------------------- */

uint8_t *schema_put_part(uint8_t *payload, const schema_layout *layout, unsigned part,
                         const void *elements) {
  uint8_t *at = payload + layout->parts[part].at;
  const size_t used = (size_t)(layout->parts[part].count * layout->parts[part].bytes);
  const size_t kept = elements != NULL ? used : 0;
  if (kept > 0) {
    memcpy(at, elements, kept);
  }
  memset(at + kept, 0, (size_t)layout->parts[part].array_bytes - kept);
  return at + layout->parts[part].array_bytes;
}

/* ---- parameters ------------------------------------------------------------------------------ */

static wire_error parse_parameter(const uint8_t *at, const core_choice *list, double *values) {
  wire_parameter parameter;
  wire_get_parameter(at, &parameter);
  const core_choice *one = core_choice_by_id(list, parameter.parameter);
  if (one == NULL) {
    return wire_error_not_in_list("parameter", list, "one of");
  }
  if (parameter.zero != 0 || parameter.zero_too != 0) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, parameter.zero != 0 ? "zero" : "zero_too", "0");
  }
  if (!isnan(values[one->id])) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "parameter", "each at most once");
  }
  if (isnan(parameter.value)) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, one->name,
                           "a number; a parameter that is not wanted is left out");
  }
  values[one->id] = parameter.value;
  return wire_error_none();
}

wire_error schema_parse_parameters(const uint8_t *at, uint32_t count, uint32_t layer_count,
                                   core_parameters *parameters) {
  *parameters = core_parameters_none();
  parameters->layer_count = layer_count;
  return schema_parse_numbers(at, count, core_parameter_list, parameters->value);
}

wire_error schema_parse_numbers(const uint8_t *at, uint32_t count, const core_choice *list,
                                double *values) {
  for (uint32_t i = 0; i < count; i++) {
    wire_error error = parse_parameter(at + (size_t)i * WIRE_BYTES_parameter, list, values);
    if (error.status != WIRE_STATUS_OK) {
      error.index = i;
      return error;
    }
  }
  return wire_error_none();
}

uint16_t schema_put_numbers(void *at, const double *values, unsigned end) {
  uint8_t *to = at;
  uint16_t count = 0;
  for (unsigned id = 0; id < end; id++) {
    if (!isnan(values[id])) {
      const wire_parameter one = {.parameter = (uint16_t)id, .value = values[id]};
      if (to != NULL) {
        wire_put_parameter(to + (size_t)count * WIRE_BYTES_parameter, &one);
      }
      count++;
    }
  }
  return count;
}

uint32_t schema_count_parameters(const core_parameters *parameters) {
  return schema_put_numbers(NULL, parameters->value, CORE_PARAMETERS_END);
}

size_t schema_put_parameters(uint8_t *at, const core_parameters *parameters) {
  return schema_put_numbers(at, parameters->value, CORE_PARAMETERS_END) *
         (size_t)WIRE_BYTES_parameter;
}
