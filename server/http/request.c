#include "server/http/request.h"

#include <ctype.h>
#include <errno.h>
#include <jansson.h>
#include <limits.h>
#include <math.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/queue.h>

#include "proto/decimal.h"
#include "proto/gather.h"
#include "proto/schema.h"
#include "proto/varying.h"
#include "server/jobs/job.h"
#include "server/store/media.h"

/* The same default in all clients. */
#define USUAL_ETA 1.3

WIRE_COLD static wire_error bad_value(const char *field, const char *allowed) {
  return wire_error_make(WIRE_STATUS_BAD_VALUE, field, allowed);
}

/* Compares two names. Few of those that are looked for begin alike. */
static inline bool is_same(const char *one, const char *other) {
  return one[0] == other[0] && strcmp(one, other) == 0;
}

/* ---- JSON ------------------------------------------------------------------------------------ */

enum {
  DEPTH_MAX = 4,
  BRACKET_BYTES = 16, /* of a body's limit, for each array or object that the body may have */
};

/* Checks how many brackets a text has, and how deep, so that a parser takes little memory. */
static wire_error check_brackets(const char *bytes, size_t count, size_t brackets_max) {
  size_t brackets = 0;
  int depth = 0;
  bool in_string = false;
  for (size_t i = 0; i < count; i++) {
    if (bytes[i] == '"') {
      in_string = !in_string;
    } else if (in_string) {
      i += bytes[i] == '\\';
    } else if (bytes[i] == '[' || bytes[i] == '{') {
      brackets++;
      depth++;
    } else if (bytes[i] == ']' || bytes[i] == '}') {
      depth--;
    }
    if (depth > DEPTH_MAX || brackets > brackets_max) {
      return bad_value("body", depth > DEPTH_MAX
                                   ? "JSON that is nested 4 deep at most"
                                   : "fewer arrays and objects: a sixteenth of max_part_bytes");
    }
  }
  return wire_error_none();
}

/* Memory for the values of a small request, which is not used again before the next one. jansson takes
 * all memory from here, so that a request's values are released together. */
enum { PAGE_BYTES = 4096, ALIGNMENT = 16 };
static _Thread_local _Alignas(ALIGNMENT) char page[PAGE_BYTES];
static _Thread_local size_t page_used;

/* Memory of its own for a value, which is behind this. */
struct piece {
  _Alignas(ALIGNMENT) LIST_ENTRY(piece) others;
};

static _Thread_local LIST_HEAD(pieces, piece) pieces;

/* Where a thread that parses goes on without memory; NULL if none parses. */
static _Thread_local jmp_buf *no_memory;

static void *allocate(size_t bytes) {
  if (bytes <= PAGE_BYTES - page_used) {
    char *piece = page + page_used;
    page_used += (bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
    return piece;
  }
  struct piece *piece = malloc(sizeof *piece + bytes);
  if (piece == NULL && no_memory != NULL) {
    longjmp(*no_memory, 1);
  }
  if (piece == NULL) {
    return NULL;
  }
  LIST_INSERT_HEAD(&pieces, piece, others);
  return piece + 1;
}

static void release_piece(void *memory) {
  if ((uintptr_t)memory - (uintptr_t)page >= PAGE_BYTES) {
    struct piece *piece = (struct piece *)memory - 1;
    LIST_REMOVE(piece, others);
    free(piece);
  }
}

/* Calls json_loadb(). Returns false if memory runs out: jansson 2.14 then takes a string for whole of
 * which it has kept a part, and reads and writes beyond it, so it is left without being told. */
static bool load_json(const char *bytes, size_t count, json_t **object, json_error_t *why) {
  jmp_buf out;
  no_memory = &out;
  if (setjmp(out) == 0) {
    *object = json_loadb(bytes, count, JSON_REJECT_DUPLICATES, why);
    no_memory = NULL;
    return true;
  }
  no_memory = NULL;
  return false;
}

/* Reads a JSON text: one object without a key that comes twice. On failure, sets *error and returns
 * NULL. */
static json_t *parse_json(const char *bytes, size_t count, size_t brackets_max, wire_error *error) {
  json_error_t why;
  json_t *object;
  char allowed[80];
  *error = check_brackets(bytes, count, brackets_max);
  if (error->status != WIRE_STATUS_OK) {
    return NULL;
  }
  if (!load_json(bytes, count, &object, &why)) {
    *error = job_busy();
    return NULL;
  }
  if (json_is_object(object)) {
    return object;
  }
  /* What jansson quotes of the text may end in the middle of a character. */
  const char *quoted = strstr(why.text, " near ");
  snprintf(allowed, sizeof allowed, "JSON (RFC 8259), which it is not at line %d: %.*s", why.line,
           (int)(quoted != NULL ? quoted - why.text : (ptrdiff_t)strlen(why.text)), why.text);
  *error = bad_value("body", object != NULL ? "a JSON object" : allowed);
  return NULL;
}

/* ---- queries --------------------------------------------------------------------------------- */

/* Returns what two hexadecimal digits say, or 0 if there are no two. */
static unsigned long byte_of(const char *digits) {
  const char pair[3] = {digits[0], digits[0] != '\0' ? digits[1] : '\0', '\0'};
  return isxdigit((unsigned char)pair[0]) && isxdigit((unsigned char)pair[1])
             ? strtoul(pair, NULL, 16)
             : 0;
}

/* Decodes %XX in place, and ends each element of a list with a zero byte. Returns how many elements
 * there are, or 0 if it finds another escape, or an escaped zero byte. */
static size_t unescape(char *text) {
  char *to = text;
  size_t count = 1;
  for (const char *at = text; *at != '\0'; at++) {
    char byte = *at;
    if (byte == '%') {
      byte = (char)byte_of(at + 1);
      if (byte == '\0') {
        return 0;
      }
      at += 2;
    }
    count += byte == ',';
    *to++ = byte == ',' ? '\0' : byte;
  }
  *to = '\0';
  return count;
}

/* Makes a text, or a list of texts, each of which ends with a zero byte. Returns NULL if there is no
 * memory. */
static json_t *make_value(const char *text, size_t count) {
  if (count == 1) {
    return json_string_nocheck(text);
  }
  json_t *list = json_array();
  for (size_t bytes; count > 0; count--, text += bytes + 1) {
    bytes = strlen(text);
    if (json_array_append_new(list, json_stringn_nocheck(text, bytes)) != 0) {
      return NULL;
    }
  }
  return list;
}

static wire_error add_pair(json_t *object, char *pair) {
  char *text = strchr(pair, '=');
  if (text == NULL) {
    return bad_value("query", "NAME=VALUE, with & between them");
  }
  *text++ = '\0';
  const size_t name_count = unescape(pair), count = unescape(text);
  if (name_count == 0 || count == 0) {
    return bad_value("query", "escapes %01 to %FF");
  }
  if (name_count > 1) {
    return bad_value("query", "names without commas");
  }
  const size_t pairs = json_object_size(object);
  if (json_object_set_new_nocheck(object, pair, make_value(text, count)) != 0) {
    return job_busy();
  }
  return json_object_size(object) > pairs
             ? wire_error_none()
             : bad_value("query",
                         "each name once: a list has commas, as in r=0.5,1,2; layers need POST");
}

/* Reads what follows the "?" of a URI, likewise: NAME=VALUE with & between them, where commas separate
 * the elements of a list. Values are texts, or arrays of texts. Changes the text. */
static json_t *parse_query(char *query, wire_error *error) {
  json_t *object = json_object();
  *error = object != NULL ? wire_error_none() : job_busy();
  for (char *pair; error->status == WIRE_STATUS_OK && (pair = strsep(&query, "&")) != NULL;) {
    if (*pair != '\0') {
      *error = add_pair(object, pair);
    }
  }
  return error->status == WIRE_STATUS_OK ? object : NULL;
}

/* ---- reading --------------------------------------------------------------------------------- */

/* Returns how many elements a value has. What is no list counts as a list of one. */
static size_t count_of(const json_t *value) {
  return json_is_array(value) ? json_array_size(value) : 1;
}

/* Returns an element, or NULL if there are fewer. A list of one has it at each index. */
static const json_t *element_of(const json_t *value, size_t index) {
  return json_is_array(value) ? json_array_get(value, json_array_size(value) > 1 ? index : 0)
                              : value;
}

static wire_error parse_count(const json_t *value, const char *field, uint64_t most,
                              uint64_t *number) {
  const char *text = json_string_value(value);
  char allowed[80];
  bool good = false;
  if (json_is_integer(value)) {
    good = json_integer_value(value) >= 0;
    *number = (uint64_t)json_integer_value(value);
  } else if (text != NULL && *text != '\0' && text[strspn(text, "0123456789")] == '\0' &&
             (text[0] != '0' || text[1] == '\0')) {
    errno = 0;
    *number = strtoull(text, NULL, 10);
    good = errno == 0;
  }
  if (good && *number <= most) {
    return wire_error_none();
  }
  snprintf(allowed, sizeof allowed, "an integer from 0 to %llu", (unsigned long long)most);
  return bad_value(field, allowed);
}

/* Reads one entry of a list by its name or id. */
static wire_error read_entry(const json_t *value, const char *field, const core_choice *list,
                             bool bits, uint64_t *id) {
  const char *name = json_string_value(value);
  const core_choice *entry = name != NULL ? core_choice_by_name(list, name) : NULL;
  if (entry == NULL) {
    const wire_error error = parse_count(value, field, UINT32_MAX, id);
    entry = error.status == WIRE_STATUS_OK ? core_choice_by_id(list, (unsigned)*id) : NULL;
  }
  if (entry == NULL) {
    return wire_error_not_in_list(field, list, bits ? "a sum of" : "one of");
  }
  *id = entry->id;
  return wire_error_none();
}

/* Reads an entry of a list by its name or id, or, with `bits`, the sum of entries. */
static wire_error parse_choice(const json_t *value, const char *field, const core_choice *list,
                               bool bits, uint64_t *number) {
  const size_t count = count_of(value);
  wire_error error = wire_error_none();
  *number = 0;
  if (!bits && (count != 1 || json_is_array(value))) {
    return bad_value(field, "one entry of its list");
  }
  for (size_t i = 0; error.status == WIRE_STATUS_OK && i < count; i++) {
    uint64_t id = 0;
    error = read_entry(element_of(value, i), field, list, bits, &id);
    error.index = i;
    *number |= id;
  }
  return error;
}

/* ---- the payload ----------------------------------------------------------------------------- */

const schema_part *http_request_list(const schema_payload *request, unsigned index,
                                     const char **name) {
  static const char *const axes[] = {"x", "y", "z"};
  for (const schema_part *part = request->parts; part->name != NULL; part++) {
    const bool positions = part->form == SCHEMA_POSITIONS;
    const unsigned names = part->about == NULL || part->kind == SCHEMA_LIST ? 0 : positions ? 3 : 1;
    if (index < names) {
      *name = positions ? axes[index] : part->name;
      return part;
    }
    index -= names;
  }
  return NULL;
}

unsigned http_request_media(const schema_payload *request) {
  const schema_part *first = &request->parts[0];
  return first->name == NULL || strcmp(first->name, "medium") != 0 ? 0
         : first->count[1].name == NULL                            ? 1
                                                                   : UINT_MAX;
}

struct translation {
  const schema_message *message;
  const json_t *values;
  bool in_query;     /* whether the values are those of a query */
  uint64_t initials; /* of their names: bit i is set if the first byte modulo 64 is i */
  struct text *payload;
  size_t bytes_max; /* most bytes of the payload */
  uint32_t medium_count;
  uint32_t layer_count; /* layers of each medium; 0: no medium has been read */
  double thickness_mm;  /* mm, thickness of media that do not state one */
  uint32_t parameter_count;
  bool g_is_default;
  wire_error error; /* the error, set if a function returns false */
};

WIRE_COLD static bool fail_with(struct translation *t, wire_error error) {
  t->error = error;
  return false;
}

/* The fault is that of an element of a list. */
WIRE_COLD static bool fail_at(struct translation *t, wire_error error, size_t index) {
  error.index = index;
  return fail_with(t, error);
}

/* Returns whether a value could be read. */
static bool was_read(struct translation *t, wire_error error) {
  return error.status == WIRE_STATUS_OK || fail_with(t, error);
}

static wire_error not_a_number(const char *field) {
  return bad_value(field, "a number, with a point as in 0.05 (0,05 is two), or inf or -inf");
}

/* Returns NULL if a value is not given, as most that are looked for. */
static const json_t *value_of(const struct translation *t, const char *name) {
  return (t->initials >> (name[0] & 63) & 1) != 0 ? json_object_get(t->values, name) : NULL;
}

/* Reads a number, or the texts inf and -inf. In a query all numbers are texts; a text such as 05 is
 * refused, because who writes the list 0,05 means 0.05. If this fails, it returns false and sets
 * *number to NaN. */
static bool read_number(const struct translation *t, const json_t *value, double *number) {
  const char *text = json_string_value(value);
  *number = json_is_number(value) ? json_number_value(value) : (double)NAN;
  if (text != NULL && (t->in_query || strcmp(text, "inf") == 0 || strcmp(text, "-inf") == 0) &&
      (decimal_starts_with_zero(text) || !decimal_read(text, number))) {
    *number = (double)NAN;
  }
  return !isnan(*number);
}

/* Adds bytes, which start as 0, to the payload. On failure returns NULL. */
static uint8_t *add_bytes(struct translation *t, size_t bytes) {
  if (bytes > t->bytes_max - t->payload->count) {
    fail_with(t, wire_error_make(WIRE_STATUS_TOO_LARGE, "body",
                                 "over HTTP as many values as a frame of max_part_bytes holds"));
    return NULL;
  }
  char *at = text_room(t->payload, bytes);
  if (at == NULL) {
    fail_with(t, job_busy());
    return NULL;
  }
  memset(at, 0, bytes);
  t->payload->count += bytes;
  return (uint8_t *)at;
}

/* Begins the medium with this index, which has `layers` layers. */
static bool begin_medium(struct translation *t, size_t layers, size_t index) {
  if (t->medium_count == http_request_media(t->message->request)) {
    return fail_with(t,
                     wire_error_make(WIRE_STATUS_BAD_COUNT, "medium",
                                     "one medium: a measured one has three, so give coefficients"));
  }
  if (layers == 0 || layers > CORE_LAYERS_MAX || (t->layer_count > 0 && layers != t->layer_count)) {
    return fail_at(
        t, wire_error_make(WIRE_STATUS_BAD_COUNT, "layer_count", "1 to 8, the same in each medium"),
        index);
  }
  t->layer_count = (uint32_t)layers;
  t->medium_count++;
  return true;
}

/* Adds a structure, which is on the wire as it is in memory. */
static bool add_structure(struct translation *t, const void *structure, size_t bytes) {
  uint8_t *at = add_bytes(t, bytes);
  return at != NULL && memcpy(at, structure, bytes) != NULL;
}

static bool add_measured(struct translation *t, const char *name, size_t index) {
  const core_measured_medium *measured = media_named(name);
  bool good = measured != NULL ||
              fail_at(t, bad_value("medium", "a name of /v1/media, or coefficients"), index);
  const size_t layers = measured != NULL ? measured->layer_count : 0;
  if (layers > 1 && t->thickness_mm > 0) {
    return fail_at(t, bad_value("thickness", "none: the medium's layers have theirs"), index);
  }
  for (size_t i = 0; good && i < 3 * layers; i++) {
    const core_medium *from = &measured->channel[i];
    const wire_medium layer = {from->sigma_a_per_mm, from->sigma_s_per_mm, from->g, from->eta,
                               layers > 1 ? from->thickness_mm : t->thickness_mm};
    good = (i % layers > 0 || begin_medium(t, layers, index)) &&
           add_structure(t, &layer, sizeof layer);
  }
  return good;
}

/* The coefficients of a medium, in the order of their fields. */
enum { COEFFICIENTS = 5 };
static const schema_payload medium_alone = {
    .structures = {&schema_structures[SCHEMA_STRUCTURE_medium]}};
#define medium_fields (schema_structures[SCHEMA_STRUCTURE_medium].fields)

static wire_error eta_of_fit(void) {
  return bad_value("eta", "a number: the index inside over outside, which has no default in a fit");
}

/* Adds a layer of coefficients, the next element of each. layer: what holds without them; an eta of NAN
 * has to be given. */
static bool add_coefficients(struct translation *t, const json_t *values, size_t element,
                             size_t index, wire_medium layer) {
  double *const to[COEFFICIENTS] = {&layer.sigma_a, &layer.sigma_s, &layer.g, &layer.eta,
                                    &layer.thickness};
  for (int i = 0; i < COEFFICIENTS; i++) {
    const char *name = medium_fields[i].name;
    const json_t *list = json_object_get(values, name);
    if (list != NULL) {
      if (!read_number(t, element_of(list, element), to[i])) {
        return fail_at(t, not_a_number(name), index);
      }
    } else if (i < 2) {
      return fail_at(
          t, bad_value(name, "a number: a medium needs sigma_a and sigma_s, or a name as medium"),
          index);
    } else if (isnan(*to[i])) {
      return fail_at(t, eta_of_fit(), index);
    }
  }
  return add_structure(t, &layer, sizeof layer);
}

static bool is_coefficient(const char *name, const json_t *value) {
  for (int i = 0; i < COEFFICIENTS; i++) {
    if (is_same(name, medium_fields[i].name)) {
      return !json_is_array(value);
    }
  }
  return false;
}

/* Adds a layer from an object with its coefficients. usual_eta: NAN if there is none. */
static bool add_object(struct translation *t, const char *field, const json_t *value, size_t index,
                       double usual_eta) {
  const char *name;
  json_t *member;
  if (!json_is_object(value)) {
    return fail_at(t, bad_value(field, "names of /v1/media, or objects of coefficients"), index);
  }
  json_object_foreach((json_t *)(uintptr_t)value, name, member) {
    if (!is_coefficient(name, member)) {
      return fail_at(
          t, bad_value(field, "objects of sigma_a, sigma_s, g, eta, thickness, each one number"),
          index);
    }
  }
  return add_coefficients(t, value, 0, index,
                          (wire_medium){.eta = usual_eta, .thickness = t->thickness_mm});
}

/* Writes the known medium of a fit, which has one with scale `reference` alone. */
static bool add_reference(struct translation *t) {
  const json_t *object = value_of(t, "reference"), *scale = value_of(t, "scale");
  uint64_t id = 0;
  if (t->message->type != WIRE_TYPE_FIT) {
    return true;
  }
  if (scale != NULL && !was_read(t, parse_choice(scale, "scale", core_fit_scales, false, &id))) {
    return false;
  }
  if ((id == CORE_FIT_SCALE_REFERENCE) != json_is_object(object)) {
    return fail_with(
        t, bad_value("reference", "with scale reference an object of coefficients, else nothing"));
  }
  return object == NULL || add_object(t, "reference", object, 0, (double)NAN);
}

/* Reads lists of coefficients. A list of one holds for all media. */
static bool add_media_lists(struct translation *t) {
  size_t count = 1;
  bool good = true;
  for (int i = 0; i < COEFFICIENTS; i++) {
    const size_t length = count_of(value_of(t, medium_fields[i].name));
    if (length == 0 || (count > 1 && length > 1 && length != count)) {
      return fail_with(t, wire_error_make(WIRE_STATUS_BAD_COUNT, medium_fields[i].name,
                                          "one value, or as many as the others"));
    }
    count = length > count ? length : count;
  }
  for (size_t i = 0; good && i < count; i++) {
    good = begin_medium(t, 1, i) &&
           add_coefficients(t, t->values, i, i, (wire_medium){.eta = USUAL_ETA});
  }
  return good;
}

/* Adds a medium: an object, or a list of them, one for each layer. */
static bool add_medium(struct translation *t, const json_t *item, size_t index) {
  const size_t layers = count_of(item);
  bool good = begin_medium(t, layers, index);
  for (size_t i = 0; good && i < layers; i++) {
    good = add_object(t, "medium", element_of(item, i), index, USUAL_ETA);
  }
  return good;
}

/* Adds the media: by names, or by coefficients. A thickness of its own is that of media without one. */
static bool add_media(struct translation *t) {
  const json_t *media = value_of(t, "medium"), *thickness = value_of(t, "thickness");
  if (http_request_media(t->message->request) == 0) {
    return true;
  }
  if (media == NULL) {
    return add_media_lists(t);
  }
  for (int i = 0; i + 1 < COEFFICIENTS; i++) {
    if (value_of(t, medium_fields[i].name) != NULL) {
      return fail_with(t, bad_value(medium_fields[i].name, "nothing beside medium"));
    }
  }
  if (thickness != NULL && !read_number(t, thickness, &t->thickness_mm)) {
    return fail_with(t, not_a_number("thickness"));
  }
  const size_t count = count_of(media);
  bool good = true;
  for (size_t i = 0; good && i < count; i++) {
    const json_t *item = element_of(media, i);
    const char *name = json_string_value(item);
    good = name != NULL ? add_measured(t, name, i) : add_medium(t, item, i);
  }
  return good;
}

/* Returns a request's field that JSON has, or NULL. */
static const schema_field *shown_field(const schema_message *message, const char *name) {
  const schema_field *field = schema_field_of(message->request, name);
  return field != NULL && !field->hidden ? field : NULL;
}

const core_choice *http_request_numbers(const schema_payload *request) {
  static const core_choice none[] = {{0, NULL, NULL}};
  return schema_field_of(request, "parameter_count") != NULL  ? core_parameter_list
         : schema_field_of(request, "property_count") != NULL ? core_properties
                                                              : none;
}

/* Writes what a fit of a tissue seeks: names, or objects with a name and limits. */
static bool add_sought(struct translation *t) {
  const json_t *list = t->message->type == WIRE_TYPE_FIT_TISSUE ? value_of(t, "sought") : NULL;
  for (size_t i = 0; list != NULL && i < count_of(list); i++) {
    const json_t *one = element_of(list, i), *low = json_object_get(one, "low");
    const json_t *high = json_object_get(one, "high"), *name = json_object_get(one, "property");
    const size_t members = (size_t)(low != NULL) + (high != NULL) + (name != NULL);
    wire_sought sought = {.property = 0};
    uint64_t id = 0;
    if (json_object_size(one) != members || (json_is_object(one) && name == NULL)) {
      return fail_at(t, bad_value("sought", "names, or objects of property, low and high"), i);
    }
    if (!was_read(t,
                  read_entry(name != NULL ? name : one, "sought", core_properties, false, &id))) {
      return false;
    }
    if ((low != NULL && !read_number(t, low, &sought.low)) ||
        (high != NULL && !read_number(t, high, &sought.high))) {
      return fail_at(t, not_a_number("sought"), i);
    }
    sought.property = (uint16_t)id;
    if (!add_structure(t, &sought, sizeof sought)) {
      return false;
    }
  }
  return true;
}

static bool add_parameters(struct translation *t) {
  const core_choice *numbers = http_request_numbers(t->message->request);
  for (const core_choice *one = numbers; one->name != NULL; one++) {
    const json_t *value = value_of(t, one->name);
    wire_parameter parameter = {.parameter = (uint16_t)one->id};
    const bool is_model = numbers == core_parameter_list && one->id == CORE_PARAMETER_FIT_MODEL;
    if (value == NULL || shown_field(t->message, one->name) != NULL) {
      continue;
    }
    uint64_t id = 0;
    const bool named = is_model && json_string_value(value) != NULL;
    if (named && !was_read(t, parse_choice(value, one->name, core_models, false, &id))) {
      return false;
    }
    if (!named && !read_number(t, value, &parameter.value)) {
      return fail_with(t, not_a_number(one->name));
    }
    parameter.value = named ? (double)id : parameter.value;
    if (!add_structure(t, &parameter, sizeof parameter)) {
      return false;
    }
    t->parameter_count++;
  }
  return true;
}

/* ---- the fixed part -------------------------------------------------------------------------- */

/* Returns the list that another field can replace by a rule, if this field says so or counts it; NULL
 * if there is none. */
static const schema_part *ruled_list(const schema_message *message, const char *field) {
  for (const schema_part *part = message->request->parts; part->name != NULL; part++) {
    if (part->about != NULL && part->kind != SCHEMA_LIST && part->form == SCHEMA_GIVEN &&
        part->when.name != NULL &&
        (is_same(part->when.name, field) || is_same(part->count[0].name, field))) {
      return part;
    }
  }
  return NULL;
}

/* Returns whether the media of a varying request are given by colours. */
static bool is_coloured(const struct translation *t) {
  return value_of(t, "colour") != NULL;
}

/* Returns what the third array of a varying request holds. */
static enum varying_numbers numbers_of(const struct translation *t) {
  return value_of(t, "r") != NULL   ? VARYING_RADII
         : value_of(t, "u") != NULL ? VARYING_DRAWN
                                    : VARYING_NONE;
}

/* Returns whether the usual evaluator is the table: for transport, named or not, where the table can
 * be as exact as the tolerance. */
static bool is_tabled(const struct translation *t) {
  const json_t *model = value_of(t, "model");
  uint64_t id = CORE_MODEL_TRANSPORT;
  double tolerance;
  read_number(t, value_of(t, "tolerance"), &tolerance); /* NaN: not given */
  if (model != NULL) {
    /* a wrong name is refused later */
    parse_choice(model, "model", core_models, false, &id);
  }
  return core_solves((unsigned)id) && !(tolerance < CORE_LUT_TOLERANCE_MIN);
}

/* Returns whether the request leaves the choice of the model to its tolerance. */
static bool chooses_by_tolerance(const struct translation *t) {
  return t->message->type == WIRE_TYPE_OFFERS ||
         (t->message->type == WIRE_TYPE_EVAL && value_of(t, "tolerance") != NULL);
}

/* What holds for the quantities and coefficients of a varying request that leaves them out. */
static unsigned usual_of_varying(const struct translation *t, const char *field) {
  static const unsigned quantities[VARYING_NUMBERS] = {
      [VARYING_RADII] = CORE_QUANTITY_R, [VARYING_DRAWN] = CORE_QUANTITY_RADIUS};
  const enum varying_numbers numbers = numbers_of(t);
  return is_same(field, "wanted") ? quantities[numbers]
         : is_coloured(t) && numbers == VARYING_NONE
             ? (unsigned)CORE_COEFFICIENT_SIGMA_A | (unsigned)CORE_COEFFICIENT_SIGMA_S
             : 0;
}

/* What holds for a choice that the request leaves out, where it depends on others. */
static unsigned usual_choice(const struct translation *t, const schema_field *field) {
  const bool varying = t->message->type == WIRE_TYPE_VARYING;
  const schema_part *list = ruled_list(t->message, field->name);
  if (list != NULL && value_of(t, list->name) != NULL) {
    return (unsigned)list->is;
  }
  if (varying && field->bits) {
    return usual_of_varying(t, field->name);
  }
  if ((varying && field->or_zero && !is_coloured(t)) ||
      (is_same(field->name, "model") && chooses_by_tolerance(t))) {
    return 0;
  }
  if (field->bits && t->message->type == WIRE_TYPE_OFFERS) {
    return CORE_QUANTITY_R;
  }
  return is_same(field->name, "evaluator") && !varying && is_tabled(t) ? CORE_EVALUATOR_LUT
                                                                       : (unsigned)field->usual;
}

static bool read_choice(struct translation *t, const schema_field *field, uint64_t *number) {
  const json_t *value = value_of(t, field->name);
  const schema_part *list = ruled_list(t->message, field->name);
  if (value != NULL) {
    return was_read(t, parse_choice(value, field->name, field->list, field->bits, number)) &&
           (list == NULL || value_of(t, list->name) == NULL || *number == list->is ||
            fail_with(t, bad_value(field->name, "list, beside a list of numbers")));
  }
  *number = usual_choice(t, field);
  return *number != 0 || field->or_zero || field->bits ||
         fail_with(t, wire_error_not_in_list(field->name, field->list, "one of"));
}

/* Reads a number that is no choice and no count of an array. */
static bool read_plain(struct translation *t, const schema_field *field, uint64_t *number) {
  static const uint64_t most[] = {
      [SCHEMA_u16] = UINT16_MAX, [SCHEMA_u32] = UINT32_MAX, [SCHEMA_u64] = UINT64_MAX};
  const json_t *value = value_of(t, field->name);
  double real = field->usual;
  bool good = true;
  if (field->kind != SCHEMA_f64) {
    *number = (uint64_t)real;
    return value == NULL || was_read(t, parse_count(value, field->name, most[field->kind], number));
  }
  if (value != NULL) {
    good = read_number(t, value, &real) || fail_with(t, not_a_number(field->name));
  } else if (field->required) {
    return fail_with(t, eta_of_fit());
  } else {
    t->g_is_default |= is_same(field->name, "g");
  }
  memcpy(number, &real, sizeof real);
  return good;
}

/* Returns whether a list of numbers is one of JSON, with a list for each set or channel. */
static bool is_nested(const json_t *list) {
  return json_is_array(json_array_get(list, 0));
}

/* Returns how many sets of readings, or channels, a list has. */
static size_t sets_of(const json_t *list) {
  return is_nested(list) ? count_of(list) : 1;
}

/* Returns the length of the longest list that is given, of those that may be one number for all. */
static size_t longest(const struct translation *t) {
  const char *name;
  const schema_part *part;
  size_t count = 0;
  for (unsigned i = 0; (part = http_request_list(t->message->request, i, &name)) != NULL; i++) {
    const bool counts = part->form == SCHEMA_EACH || part->form == SCHEMA_POSITIONS;
    const json_t *value = value_of(t, name);
    const size_t length = counts && value != NULL ? count_of(value) : 0;
    count = length > count ? length : count;
  }
  return count;
}

/* Returns a number that JSON does not have: it counts elements that follow, or is 0. */
static uint64_t counted(const struct translation *t, const schema_field *field) {
  if (is_same(field->name, "layer_count")) {
    return t->layer_count;
  }
  for (const schema_part *part = t->message->request->parts; part->name != NULL; part++) {
    const char *first = part->count[0].name, *second = part->count[1].name;
    if ((first == NULL || !is_same(first, field->name)) &&
        (second == NULL || !is_same(second, field->name))) {
      continue;
    }
    const json_t *list = value_of(t, part->name);
    return part->form == SCHEMA_EACH || part->form == SCHEMA_POSITIONS         ? longest(t)
           : part->form == SCHEMA_CHANNELS || part->form == SCHEMA_SETS        ? sets_of(list)
           : part->kind != SCHEMA_LIST && list != NULL                         ? count_of(list)
           : is_same(part->name, "medium")                                     ? t->medium_count
           : part->structure == &schema_structures[SCHEMA_STRUCTURE_parameter] ? t->parameter_count
           : is_same(part->name, "sought") && list != NULL                     ? count_of(list)
                                                                               : 0;
  }
  return is_same(field->name, "numbers")       ? numbers_of(t)
         : is_same(field->name, "point_count") ? longest(t)
                                               : 0;
}

static bool read_field(struct translation *t, const schema_field *field, uint64_t *number) {
  if (field->list != NULL) {
    const bool read = read_choice(t, field, number);
    const unsigned type = t->message->type;
    if (is_same(field->name, "wanted") && *number != 0 &&
        (type == WIRE_TYPE_EVAL || type == WIRE_TYPE_SAMPLE || type == WIRE_TYPE_VARYING)) {
      *number |= CORE_QUANTITY_MODEL_ERROR; /* model_error is always wanted, as in Python */
    }
    return read;
  }
  if (field->hidden) {
    *number = counted(t, field);
    return true;
  }
  const schema_part *list = ruled_list(t->message, field->name);
  const json_t *values = value_of(t, list != NULL ? list->name : "");
  if (values != NULL) {
    *number = count_of(values);
    return value_of(t, field->name) == NULL ||
           fail_with(t, bad_value(field->name, "nothing beside the list that it counts"));
  }
  return read_plain(t, field, number);
}

enum { NAME_DIGITS = 32 };

/* Reads the name of a set, which a request that sends the points may leave out. */
static bool put_name(struct translation *t, const schema_field *field, uint8_t *at) {
  const json_t *value = value_of(t, field->name);
  const char *digits = value != NULL ? json_string_value(value) : "";
  const size_t count = digits != NULL ? strlen(digits) : 0;
  if (value == NULL && t->message->type != WIRE_TYPE_GATHER) {
    return true;
  }
  if (count != NAME_DIGITS || strspn(digits, "0123456789abcdef") != count) {
    return fail_with(t, bad_value(field->name, "32 hexadecimal digits: the `set` of /v1/points"));
  }
  for (size_t i = 0; i < field->bytes; i++) {
    at[i] = (uint8_t)byte_of(digits + 2 * i);
  }
  return true;
}

/* Writes a structure of the fixed part at *offset, which it moves. Sets *single to whether the
 * evaluator has single precision. */
static bool put_fixed(struct translation *t, const schema_field *fields, size_t *offset,
                      bool *single) {
  for (const schema_field *field = fields; field->name != NULL; field++) {
    uint64_t number = 0;
    uint8_t *at = (uint8_t *)t->payload->bytes + *offset;
    if (!(schema_is_name(field) ? put_name(t, field, at) : read_field(t, field, &number))) {
      return false;
    }
    if (!schema_is_name(field)) {
      memcpy(at, &number, field->bytes); /* the lowest byte is the first (proto/wire.c) */
    }
    *offset += field->bytes;
    if (is_same(field->name, "evaluator")) {
      *single = core_evaluator_bytes((unsigned)number) == sizeof(float);
    }
  }
  return true;
}

/* ---- the whole request ----------------------------------------------------------------------- */

static bool is_known(const schema_message *message, const char *key) {
  const char *name;
  for (unsigned i = 0; http_request_list(message->request, i, &name) != NULL; i++) {
    if (is_same(name, key)) {
      return true;
    }
  }
  const bool media = http_request_media(message->request) > 0;
  return shown_field(message, key) != NULL || strcmp(key, "deadline_ms") == 0 ||
         (media && (strcmp(key, "medium") == 0 || schema_field_of(&medium_alone, key) != NULL)) ||
         (message->type == WIRE_TYPE_FIT && strcmp(key, "reference") == 0) ||
         (message->type == WIRE_TYPE_FIT_TISSUE && strcmp(key, "sought") == 0) ||
         core_choice_by_name(http_request_numbers(message->request), key) != NULL;
}

/* Returns whether an error can name a key: a short text of printable ASCII. */
static bool can_be_named(const char *key) {
  size_t length = 0;
  while (key[length] > ' ' && key[length] <= '~') {
    length++;
  }
  return key[length] == '\0' && length > 0 && length < sizeof((wire_error *)NULL)->field;
}

static bool check_keys(struct translation *t) {
  const char *key;
  json_t *value;
  json_object_foreach((json_t *)(uintptr_t)t->values, key, value) {
    t->initials |= UINT64_C(1) << (key[0] & 63);
    if (!is_known(t->message, key)) {
      return fail_with(t, bad_value(can_be_named(key) ? key : "body",
                                    "only fields that /v1/openapi.json lists for this request"));
    }
  }
  return true;
}

/* Checks that a varying request has one pair of lists for its media, and at most one list of
 * numbers. */
static bool check_pairs(struct translation *t) {
  const bool coloured = is_coloured(t) || value_of(t, "length") != NULL;
  const char *const wanted[] = {coloured ? "colour" : "sigma_a", coloured ? "length" : "sigma_s"};
  const char *const others[] = {coloured ? "sigma_a" : "given", coloured ? "sigma_s" : "light"};
  for (int i = 0; i < 2; i++) {
    if (value_of(t, others[i]) != NULL) {
      return fail_with(t, bad_value(others[i], coloured ? "nothing beside colour and length"
                                                        : "nothing beside sigma_a and sigma_s"));
    }
    if (value_of(t, wanted[i]) == NULL) {
      return fail_with(
          t, bad_value(wanted[i], "numbers: give sigma_a and sigma_s, or colour and length"));
    }
  }
  return value_of(t, "r") == NULL || value_of(t, "u") == NULL ||
         fail_with(t, bad_value("u", "nothing beside r"));
}

/* Writes `count` numbers, each of them `step` bytes behind the last: those of a list, or, if `spreads`,
 * its only one again and again. */
static bool put_numbers(struct translation *t, const char *name, const json_t *list, size_t count,
                        bool spreads, uint8_t *at, size_t step, bool single) {
  const size_t length = count_of(list);
  if (list == NULL) {
    return fail_with(t, bad_value(name, "numbers: it has to be given"));
  }
  if (length != count && !(spreads && length == 1)) {
    return fail_with(t, wire_error_make(WIRE_STATUS_BAD_COUNT, name,
                                        spreads ? "one value, or as many as the others"
                                                : "as many as in the other lists"));
  }
  for (size_t i = 0; i < count; i++, at += step) {
    double number;
    if (!read_number(t, element_of(list, i), &number)) {
      return fail_at(t, not_a_number(name), i);
    }
    const float rounded = (float)number;
    if (single && (isfinite(rounded) != isfinite(number) || (rounded == 0) != (number == 0))) {
      return fail_at(t, bad_value(name, "1e-45 to 3.4e38, 0 or inf: single precision"), i);
    }
    memcpy(at, single ? (const void *)&rounded : (const void *)&number,
           single ? sizeof rounded : sizeof number);
  }
  return true;
}

/* Writes a part that is lists of numbers, `total` in all: the sets of readings one after the other, the
 * coordinates of a position, or the powers of a point, side by side. */
static bool add_lists(struct translation *t, const schema_part *part, uint64_t total, bool single) {
  static const char *const axes[GATHER_AXES] = {"x", "y", "z"};
  const bool positions = part->form == SCHEMA_POSITIONS;
  const bool sides = positions || part->form == SCHEMA_CHANNELS;
  const bool spreads = sides || part->form == SCHEMA_EACH;
  const json_t *value = value_of(t, part->name);
  const bool given = positions || value != NULL;
  if (!given && (part->form == SCHEMA_EACH || part->when.name != NULL)) {
    return true;
  }
  const bool nests = part->form == SCHEMA_CHANNELS || part->form == SCHEMA_SETS;
  const size_t sets = positions ? GATHER_AXES : nests ? sets_of(value) : 1;
  const size_t all = part->form == SCHEMA_SETS ? sets_of(value_of(t, "values")) : 1;
  const size_t count = spreads ? longest(t) : all > 0 ? (size_t)total / all : 0;
  const bool short_ones = part->kind == SCHEMA_f32 || (single && part->kind == SCHEMA_REAL);
  const size_t bytes = short_ones ? sizeof(float) : sizeof(double);
  uint8_t *at = add_bytes(t, (size_t)wire_padded(count * sets * bytes));
  bool good = at != NULL;
  for (size_t i = 0; good && i < sets && (given || part->form != SCHEMA_ZEROS); i++) {
    const json_t *list = positions                   ? value_of(t, axes[i])
                         : nests && is_nested(value) ? json_array_get(value, i)
                                                     : value;
    good =
        put_numbers(t, positions ? axes[i] : part->name, list, count, spreads,
                    at + (sides ? i : i * count) * bytes, sides ? sets * bytes : bytes, short_ones);
  }
  return good;
}

/* Names the set that is written, unless the request does. */
static void name_points(struct translation *t) {
  wire_points_request fixed;
  uint8_t *at = (uint8_t *)t->payload->bytes;
  wire_get_points_request(at, &fixed);
  if (value_of(t, "set") == NULL) {
    const uint8_t *xyz = at + WIRE_BYTES_points_request;
    const uint8_t *power = xyz + fixed.point_count * GATHER_AXES * sizeof(double);
    gather_name name;
    gather_name_start(&name, fixed.channel_count, fixed.point_count);
    gather_name_add(&name, fixed.point_count, (const double *)(const void *)xyz,
                    (const float *)(const void *)power);
    gather_name_end(&name, fixed.set);
    wire_put_points_request(at, &fixed);
  }
}

static bool read_deadline(struct translation *t, uint32_t *deadline_ms) {
  const json_t *value = value_of(t, "deadline_ms");
  uint64_t limit_ms = 0;
  const bool good =
      value == NULL || was_read(t, parse_count(value, "deadline_ms", UINT32_MAX, &limit_ms));
  *deadline_ms = (uint32_t)limit_ms;
  return good;
}

/* Writes the whole payload. */
static bool put_all(struct translation *t, uint32_t *deadline_ms) {
  const schema_payload *request = t->message->request;
  size_t offset = 0;
  bool single = false;
  bool good = check_keys(t) && read_deadline(t, deadline_ms) &&
              (t->message->type != WIRE_TYPE_VARYING || check_pairs(t)) &&
              add_bytes(t, request->fixed_bytes) != NULL && add_media(t) && add_parameters(t) &&
              add_sought(t) && add_reference(t);
  for (int i = 0; good && i < 2 && request->structures[i] != NULL; i++) {
    good = put_fixed(t, request->structures[i]->fields, &offset, &single);
  }
  _Static_assert(CORE_GATHER_CHANNELS_MAX == 8, "the error says so");
  if (good && sets_of(value_of(t, "power")) > CORE_GATHER_CHANNELS_MAX) {
    return fail_with(t, wire_error_make(WIRE_STATUS_BAD_COUNT, "channel_count", "1 to 8"));
  }
  schema_layout layout = {.payload_bytes = 0};
  good = good && (schema_lay_out(request, t->payload->bytes, t->bytes_max, &layout, NULL) ||
                  add_bytes(t, SIZE_MAX) != NULL);
  for (unsigned i = 0; good && request->parts[i].name != NULL; i++) {
    const schema_part *part = &request->parts[i];
    good = part->about == NULL || part->kind == SCHEMA_LIST ||
           add_lists(t, part, layout.parts[i].count, single);
  }
  if (good && t->message->type == WIRE_TYPE_POINTS) {
    name_points(t);
  }
  return good;
}

wire_error http_request_translate(const schema_message *message, char *text, size_t text_bytes,
                                  bool in_query, struct text *payload, size_t bytes_max,
                                  uint32_t *deadline_ms, bool *g_is_default) {
  wire_error error = wire_error_none();
  page_used = 0;
  json_set_alloc_funcs(allocate, release_piece);
  json_t *values = in_query ? parse_query(text, &error)
                            : parse_json(text, text_bytes, bytes_max / BRACKET_BYTES, &error);
  struct translation t = {.message = message,
                          .values = values,
                          .in_query = in_query,
                          .payload = payload,
                          .bytes_max = bytes_max};
  *deadline_ms = 0;
  if (values != NULL && !put_all(&t, deadline_ms)) {
    error = t.error;
  }
  *g_is_default = t.g_is_default;
  while (!LIST_EMPTY(&pieces)) {
    release_piece(LIST_FIRST(&pieces) + 1);
  }
  return error;
}
