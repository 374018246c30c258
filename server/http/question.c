#include "server/http/question.h"

#include <ctype.h>
#include <errno.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/channels.h"
#include "proto/decimal.h"

#define USUAL_ETA 1.3 /* as in all clients */

static wire_error bad(const char *field, const char *allowed) {
  return wire_error_make(WIRE_STATUS_BAD_VALUE, field, allowed);
}

static wire_error no_memory(void) {
  return wire_error_busy("max_total_bytes", "less at a time: max_total_bytes are in use", 1000);
}

static bool is_good(const wire_error *error) {
  return error->status == WIRE_STATUS_OK;
}

/* ---- JSON ------------------------------------------------------------------------------------ */

enum { DEPTH_MAX = 4 };

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
      return bad("body", depth > DEPTH_MAX
                             ? "JSON that is nested 4 deep at most"
                             : "fewer arrays and objects: a sixteenth of max_part_bytes");
    }
  }
  return wire_error_none();
}

json_t *http_question_parse(const char *bytes, size_t count, size_t brackets_max,
                            wire_error *error) {
  json_error_t why;
  char allowed[80];
  *error = check_brackets(bytes, count, brackets_max);
  if (!is_good(error)) {
    return NULL;
  }
  json_t *object = json_loadb(bytes, count, JSON_REJECT_DUPLICATES, &why);
  if (json_is_object(object)) {
    return object;
  }
  if (object != NULL) {
    json_decref(object);
    *error = bad("body", "a JSON object");
    return NULL;
  }
  /* What jansson quotes of the text may end in the middle of a character. */
  char *quoted = strstr(why.text, " near '");
  snprintf(allowed, sizeof allowed, "JSON (RFC 8259), which it is not at line %d: %.*s", why.line,
           (int)(quoted != NULL ? quoted - why.text : 0), why.text);
  *error = bad("body", allowed);
  return NULL;
}

/* ---- queries --------------------------------------------------------------------------------- */

static int digit_of(char character) {
  return !isxdigit((unsigned char)character) ? -1
         : character <= '9'                  ? character - '0'
                                             : (character | 0x20) - 'a' + 10;
}

/* Decodes %XX in place. Returns false if it finds another escape, or an escaped zero byte. */
static bool unescape(char *text) {
  char *to = text;
  for (const char *at = text; *at != '\0'; at++) {
    if (*at != '%') {
      *to++ = *at;
      continue;
    }
    const int high = digit_of(at[1]), low = high < 0 ? -1 : digit_of(at[2]);
    if (low < 0 || high + low == 0) {
      return false;
    }
    *to++ = (char)(high << 4 | low);
    at += 2;
  }
  *to = '\0';
  return true;
}

/* Makes a text, or a list of texts if there is a comma. Returns NULL if it is not UTF-8. */
static json_t *make_value(char *text) {
  if (strchr(text, ',') == NULL) {
    return json_string(text);
  }
  json_t *list = json_array();
  char *rest = text, *item;
  while ((item = strsep(&rest, ",")) != NULL) {
    if (json_array_append_new(list, json_string(item)) != 0) {
      json_decref(list);
      return NULL;
    }
  }
  return list;
}

static wire_error add_pair(json_t *object, char *pair) {
  char *value = strchr(pair, '=');
  if (value == NULL) {
    return bad("query", "NAME=VALUE, with & between them");
  }
  *value++ = '\0';
  if (!unescape(pair) || !unescape(value)) {
    return bad("query", "escapes %01 to %FF");
  }
  if (json_object_get(object, pair) != NULL) {
    return bad("query", "each name at most once");
  }
  return json_object_set_new(object, pair, make_value(value)) == 0
             ? wire_error_none()
             : bad("query", "names and values in UTF-8");
}

json_t *http_question_parse_query(const char *query, wire_error *error) {
  char *copy = strdup(query), *rest = copy, *pair;
  json_t *object = json_object();
  *error = copy != NULL && object != NULL ? wire_error_none() : no_memory();
  while (is_good(error) && (pair = strsep(&rest, "&")) != NULL) {
    if (*pair != '\0') {
      *error = add_pair(object, pair);
    }
  }
  free(copy);
  if (!is_good(error)) {
    json_decref(object);
    return NULL;
  }
  return object;
}

/* ---- values ---------------------------------------------------------------------------------- */

struct question {
  const struct http_message *message;
  const json_t *object;
  bool texts;
  struct http_text *payload;
  uint32_t medium_count;
  uint32_t parameter_count;
};

/* A value that is no array counts as an array of one. */
static size_t length_of(const json_t *value) {
  return json_is_array(value) ? json_array_size(value) : 1;
}

static const json_t *item_of(const json_t *value, size_t index) {
  return json_is_array(value) ? json_array_get(value, index) : value;
}

static wire_error read_number(const struct question *q, const char *field, const json_t *value,
                              double *number) {
  const char *text = json_string_value(value);
  *number = (double)NAN;
  if (json_is_number(value)) {
    *number = json_number_value(value);
  } else if (text != NULL && (q->texts || strcmp(text, "inf") == 0 || strcmp(text, "-inf") == 0) &&
             !decimal_read(text, number)) {
    *number = (double)NAN;
  }
  return isnan(*number) ? bad(field, "a number, or the text inf or -inf") : wire_error_none();
}

static wire_error read_count(const char *field, const json_t *value, uint64_t most,
                             uint64_t *number) {
  const char *text = json_string_value(value);
  char allowed[80];
  bool good = false;
  if (json_is_integer(value)) {
    good = json_integer_value(value) >= 0;
    *number = (uint64_t)json_integer_value(value);
  } else if (text != NULL && *text != '\0' && text[strspn(text, "0123456789")] == '\0') {
    errno = 0;
    *number = strtoull(text, NULL, 10);
    good = errno == 0;
  }
  if (good && *number <= most) {
    return wire_error_none();
  }
  snprintf(allowed, sizeof allowed, "an integer from 0 to %llu", (unsigned long long)most);
  return bad(field, allowed);
}

/* Reads one entry of a list by its name or id. */
static wire_error read_entry(const char *field, const core_choice *list, const json_t *value,
                             bool bits, uint64_t *id) {
  const char *name = json_string_value(value);
  const core_choice *entry = name != NULL ? core_choice_by_name(list, name) : NULL;
  if (entry == NULL) {
    const wire_error error = read_count(field, value, UINT16_MAX, id);
    entry = is_good(&error) ? core_choice_by_id(list, (unsigned)*id) : NULL;
  }
  if (entry == NULL) {
    return wire_error_not_in_list(field, list, bits ? "a sum of" : "one of");
  }
  *id = entry->id;
  return wire_error_none();
}

static wire_error read_choice(const char *field, const core_choice *list, const json_t *value,
                              bool bits, uint64_t *number) {
  wire_error error = wire_error_none();
  *number = 0;
  if (!bits && json_is_array(value)) {
    return bad(field, "one entry of its list");
  }
  for (size_t i = 0; is_good(&error) && i < length_of(value); i++) {
    uint64_t id = 0;
    error = read_entry(field, list, item_of(value, i), bits, &id);
    error.index = i;
    *number |= id;
  }
  return error;
}

/* ---- the payload ----------------------------------------------------------------------------- */

/* Writes a number of so many bytes, the lowest first. */
static void put_le(uint8_t *at, uint64_t number, size_t bytes) {
  for (size_t i = 0; i < bytes; i++) {
    at[i] = (uint8_t)(number >> (8 * i));
  }
}

/* Adds bytes, which start as 0, to the payload. Returns NULL if there is no memory. */
static uint8_t *add(const struct question *q, size_t bytes) {
  char *at = http_text_room(q->payload, bytes);
  if (at != NULL) {
    memset(at, 0, bytes);
    q->payload->count += bytes;
  }
  return (uint8_t *)at;
}

static wire_error add_medium(struct question *q, const wire_medium *medium) {
  if (q->medium_count == q->message->media_most) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "medium",
                           "one medium: a measured one has three, so give coefficients");
  }
  uint8_t *at = add(q, WIRE_BYTES_medium);
  if (at == NULL) {
    return no_memory();
  }
  wire_put_medium(at, medium);
  q->medium_count++;
  return wire_error_none();
}

static wire_error add_measured(struct question *q, const char *name) {
  const core_measured_medium *measured = core_measured_medium_by_name(name);
  wire_error error =
      measured != NULL ? wire_error_none() : bad("medium", "a name of /v1/media, or coefficients");
  for (int i = 0; is_good(&error) && i < 3; i++) {
    const core_medium *from = &measured->channel[i];
    const wire_medium medium = {from->sigma_a_per_mm, from->sigma_s_per_mm, from->g, from->eta};
    error = add_medium(q, &medium);
  }
  return error;
}

/* Reads coefficients from an object whose members are numbers, or element `index` of lists. */
static wire_error read_coefficients(const struct question *q, const json_t *object, size_t index,
                                    wire_medium *medium) {
  double *const to[] = {&medium->sigma_a, &medium->sigma_s, &medium->g, &medium->eta};
  wire_error error = wire_error_none();
  for (int i = 0; is_good(&error) && http_fields_of_medium[i].name != NULL; i++) {
    const char *name = http_fields_of_medium[i].name;
    const json_t *value = json_object_get(object, name);
    if (value != NULL) {
      const size_t count = length_of(value);
      error = read_number(q, name, item_of(value, count > 1 ? index : 0), to[i]);
      error.index = index;
    } else if (to[i] == &medium->sigma_a || to[i] == &medium->sigma_s) {
      error = bad(name, "a number: a medium needs sigma_a and sigma_s");
    }
  }
  return error;
}

static wire_error add_coefficients(struct question *q, const json_t *object, size_t index) {
  wire_medium medium = {.eta = USUAL_ETA};
  const wire_error error = read_coefficients(q, object, index, &medium);
  return is_good(&error) ? add_medium(q, &medium) : error;
}

/* Checks the members of an object with coefficients. */
static wire_error check_object(const char *field, const json_t *object) {
  const char *key;
  json_t *value;
  json_object_foreach((json_t *)(uintptr_t)object, key, value) {
    bool known = false;
    for (int i = 0; http_fields_of_medium[i].name != NULL; i++) {
      known = known || strcmp(key, http_fields_of_medium[i].name) == 0;
    }
    if (!known || json_is_array(value)) {
      return bad(field, "objects of sigma_a, sigma_s, g and eta, each one number");
    }
  }
  return wire_error_none();
}

static wire_error add_media_object(struct question *q, const json_t *object) {
  const wire_error error = check_object("medium", object);
  return is_good(&error) ? add_coefficients(q, object, 0) : error;
}

/* Writes the known medium of a fit, which has one with scale `reference` alone. */
static wire_error add_reference(const struct question *q) {
  const json_t *object = json_object_get(q->object, "reference");
  const json_t *scale = json_object_get(q->object, "scale");
  uint64_t id = 0;
  if (q->message->type != WIRE_TYPE_FIT) {
    return wire_error_none();
  }
  wire_error error =
      scale != NULL ? read_choice("scale", core_fit_scales, scale, false, &id) : wire_error_none();
  if (is_good(&error) && (id == CORE_FIT_SCALE_REFERENCE) != json_is_object(object)) {
    error = bad("reference", "with scale reference an object of coefficients, else nothing");
  }
  if (!is_good(&error) || object == NULL) {
    return error;
  }
  wire_medium medium = {.eta = USUAL_ETA};
  error = check_object("reference", object);
  if (is_good(&error)) {
    error = read_coefficients(q, object, 0, &medium);
  }
  uint8_t *at = is_good(&error) ? add(q, WIRE_BYTES_medium) : NULL;
  if (at != NULL) {
    wire_put_medium(at, &medium);
  }
  return at == NULL && is_good(&error) ? no_memory() : error;
}

/* Reads lists of coefficients. A list of one holds for all media. */
static wire_error add_lists(struct question *q) {
  size_t count = 1;
  wire_error error = wire_error_none();
  for (int i = 0; http_fields_of_medium[i].name != NULL; i++) {
    const char *name = http_fields_of_medium[i].name;
    const json_t *value = json_object_get(q->object, name);
    const size_t length = value != NULL ? length_of(value) : 1;
    if (length == 0 || (count > 1 && length > 1 && length != count)) {
      return wire_error_make(WIRE_STATUS_BAD_COUNT, name, "one value, or as many as the others");
    }
    count = length > count ? length : count;
  }
  for (size_t i = 0; is_good(&error) && i < count; i++) {
    error = add_coefficients(q, q->object, i);
  }
  return error;
}

static wire_error add_media(struct question *q) {
  const json_t *medium = json_object_get(q->object, "medium");
  wire_error error = wire_error_none();
  if (q->message->media_most == 0) {
    return error;
  }
  for (int i = 0; medium != NULL && http_fields_of_medium[i].name != NULL; i++) {
    if (json_object_get(q->object, http_fields_of_medium[i].name) != NULL) {
      return bad(http_fields_of_medium[i].name, "nothing beside medium");
    }
  }
  if (medium == NULL) {
    return add_lists(q);
  }
  for (size_t i = 0; is_good(&error) && i < length_of(medium); i++) {
    const json_t *item = item_of(medium, i);
    error = json_is_string(item) ? add_measured(q, json_string_value(item))
            : json_is_object(item)
                ? add_media_object(q, item)
                : bad("medium", "names of /v1/media, or objects of coefficients");
  }
  return error;
}

/* The models whose names a parameter takes, besides their ids. */
static const core_choice *choices_of_parameter(unsigned id) {
  return id == CORE_PARAMETER_FIT_MODEL ? core_models
         : id == CORE_PARAMETER_PHASE   ? core_phases
                                        : NULL;
}

static wire_error add_parameters(struct question *q) {
  for (const core_choice *one = core_parameter_list; one->name != NULL; one++) {
    const json_t *value = json_object_get(q->object, one->name);
    wire_parameter parameter = {.parameter = (uint16_t)one->id};
    const core_choice *list = choices_of_parameter(one->id);
    if (value == NULL || !q->message->parameters) {
      continue;
    }
    uint64_t id = 0;
    wire_error error = list != NULL && json_is_string(value)
                           ? read_choice(one->name, list, value, false, &id)
                           : read_number(q, one->name, value, &parameter.value);
    if (!is_good(&error)) {
      return error;
    }
    parameter.value = list != NULL && id > 0 ? (double)id : parameter.value;
    uint8_t *at = add(q, WIRE_BYTES_parameter);
    if (at == NULL) {
      return no_memory();
    }
    wire_put_parameter(at, &parameter);
    q->parameter_count++;
  }
  return wire_error_none();
}

/* Writes a number in single precision. Returns false if it is too large or too small for it. */
static bool put_single(uint8_t *at, double number) {
  const float single = (float)number;
  memcpy(at, &single, sizeof single);
  return isfinite(single) == isfinite(number) && (single != 0) == (number != 0);
}

static wire_error add_numbers(const struct question *q, const char *name, const json_t *value,
                              bool single) {
  const size_t count = length_of(value), bytes = single ? sizeof(float) : sizeof(double);
  uint8_t *at = add(q, (size_t)wire_padded(count * bytes));
  if (at == NULL) {
    return no_memory();
  }
  for (size_t i = 0; i < count; i++, at += bytes) {
    double number;
    wire_error error = read_number(q, name, item_of(value, i), &number);
    if (is_good(&error) && single && !put_single(at, number)) {
      error = bad(name, "1e-45 to 3.4e38, 0 or inf: single precision; f64 has more");
    } else if (!single) {
      memcpy(at, &number, sizeof number);
    }
    if (!is_good(&error)) {
      error.index = i;
      return error;
    }
  }
  return wire_error_none();
}

/* Returns how many sets of readings a list has. */
static size_t sets_of(const json_t *value) {
  return json_is_array(json_array_get(value, 0)) ? json_array_size(value) : 1;
}

/* Writes the readings of all sets, each as many as `count`. */
static wire_error add_sets(const struct question *q, const char *name, const json_t *value,
                           size_t count) {
  const size_t sets = sets_of(value);
  const bool is_nested = json_is_array(json_array_get(value, 0));
  wire_error error = wire_error_none();
  for (size_t i = 0; is_good(&error) && i < sets; i++) {
    const json_t *set = is_nested ? json_array_get(value, i) : value;
    error = length_of(set) == count
                ? add_numbers(q, name, set, false)
                : wire_error_make(WIRE_STATUS_BAD_COUNT, name, "as many in each set as in `at`");
  }
  return error;
}

/* ---- the fixed part -------------------------------------------------------------------------- */

/* Returns the list that a field counts or whose rule the field is; NULL if there is none. */
static const struct http_list *list_of(const struct http_message *message, const char *field) {
  for (int i = 0; i < HTTP_LISTS && message->lists[i].name != NULL; i++) {
    const struct http_list *list = &message->lists[i];
    if (strcmp(list->count, field) == 0 || (list->rule != NULL && strcmp(list->rule, field) == 0)) {
      return list;
    }
  }
  return NULL;
}

/* What holds for a choice that the request leaves out, as of the command line: transport by table
 * unless a model or a tolerance is given. */
static const char *usual_choice(const struct question *q, const char *field) {
  const struct http_list *list = list_of(q->message, field);
  const bool named = json_object_get(q->object, "model") != NULL;
  if (list != NULL) {
    return json_object_get(q->object, list->name) != NULL || strcmp(field, "draw") != 0 ? "list"
                                                                                        : "random";
  }
  return strcmp(field, "model") == 0       ? "transport"
         : strcmp(field, "evaluator") == 0 ? (named ? "f64" : "lut")
         : strcmp(field, "moments") == 0   ? "exact"
         : strcmp(field, "axis") == 0      ? "r"
         : strcmp(field, "scale") == 0     ? "absolute"
                                           : NULL;
}

/* Returns whether the request leaves the choice of the model to its tolerance. */
static bool chooses_by_tolerance(const struct question *q) {
  return q->message->request[0] == http_fields_of_eval_request &&
         (q->message->type == WIRE_TYPE_OFFERS || json_object_get(q->object, "tolerance") != NULL);
}

static wire_error read_list_field(const struct question *q, const struct http_field *field,
                                  const core_choice *list, bool bits, uint64_t *number) {
  const json_t *value = json_object_get(q->object, field->name);
  if (value != NULL) {
    return read_choice(field->name, list, value, bits, number);
  }
  if (strcmp(field->name, "model") == 0 && chooses_by_tolerance(q)) {
    *number = 0;
    return wire_error_none();
  }
  if (bits) {
    wire_error error = wire_error_none();
    char names[64], *rest = names, *name;
    snprintf(names, sizeof names, "%s", q->message->wanted);
    while ((name = strsep(&rest, ",")) != NULL) {
      *number |= core_choice_by_name(list, name)->id;
    }
    return error;
  }
  const char *usual = usual_choice(q, field->name);
  if (usual == NULL) {
    return wire_error_not_in_list(field->name, list, "one of");
  }
  *number = core_choice_by_name(list, usual)->id;
  return wire_error_none();
}

/* Reads a number that is no choice and no count of an array. One that is not given is 0. */
static wire_error read_plain(const struct question *q, const struct http_field *field,
                             uint64_t *number) {
  static const uint64_t most[] = {
      [HTTP_u16] = UINT16_MAX, [HTTP_u32] = UINT32_MAX, [HTTP_u64] = UINT64_MAX};
  const json_t *value = json_object_get(q->object, field->name);
  double real = strcmp(field->name, "eta") == 0 ? USUAL_ETA : 0;
  if (value == NULL) {
    memcpy(number, &real, sizeof real); /* 0 has the same bits in every kind */
    return wire_error_none();
  }
  if (field->kind != HTTP_f64) {
    return read_count(field->name, value, most[field->kind], number);
  }
  const wire_error error = read_number(q, field->name, value, &real);
  memcpy(number, &real, sizeof real);
  return error;
}

static wire_error read_field(const struct question *q, const struct http_field *field,
                             uint64_t *number) {
  bool bits = false;
  const core_choice *choices = http_choices_of(field->name, &bits);
  const struct http_list *list = list_of(q->message, field->name);
  const json_t *values = list != NULL ? json_object_get(q->object, list->name) : NULL;
  if (choices != NULL) {
    return read_list_field(q, field, choices, bits, number);
  }
  if (values != NULL) {
    *number = list->kind == HTTP_SETS ? sets_of(values) : length_of(values);
    return json_object_get(q->object, field->name) == NULL
               ? wire_error_none()
               : bad(field->name, "nothing beside the list that it counts");
  }
  if (list == NULL && http_is_internal(field->name)) {
    *number = strcmp(field->name, "medium_count") == 0      ? q->medium_count
              : strcmp(field->name, "parameter_count") == 0 ? q->parameter_count
                                                            : 0;
    return wire_error_none();
  }
  return read_plain(q, field, number);
}

static size_t bytes_of(const struct http_message *message) {
  size_t bytes = 0;
  for (int i = 0; i < HTTP_STRUCTURES && message->request[i] != NULL; i++) {
    for (const struct http_field *field = message->request[i]; field->name != NULL; field++) {
      bytes += http_field_bytes(field);
    }
  }
  return bytes;
}

/* Writes a structure of the fixed part at *offset, which it moves. Sets *single to whether the
 * evaluator has single precision. */
static wire_error put_fixed(const struct question *q, const struct http_field *fields,
                            size_t *offset, bool *single) {
  wire_error error = wire_error_none();
  for (const struct http_field *field = fields; field->name != NULL; field++) {
    uint64_t number = 0;
    error = read_field(q, field, &number);
    if (!is_good(&error)) {
      return error;
    }
    const size_t bytes = http_field_bytes(field);
    put_le((uint8_t *)q->payload->bytes + *offset, number, bytes);
    *offset += bytes;
    if (strcmp(field->name, "evaluator") == 0) {
      *single = core_evaluator_bytes((unsigned)number) == sizeof(float);
    }
  }
  return error;
}

/* ---- all of it ------------------------------------------------------------------------------- */

static bool is_known(const struct http_message *message, const char *key) {
  bool known =
      strcmp(key, "deadline_ms") == 0 || (message->media_most > 0 && strcmp(key, "medium") == 0);
  const struct http_list *list = list_of(message, key);
  const bool follows = http_is_internal(key) || (list != NULL && list->rule == NULL);
  for (int i = 0; i < HTTP_STRUCTURES && message->request[i] != NULL; i++) {
    for (const struct http_field *field = message->request[i]; field->name != NULL; field++) {
      known = known || (strcmp(field->name, key) == 0 && !follows);
    }
  }
  known = known || (message->type == WIRE_TYPE_FIT && strcmp(key, "reference") == 0);
  for (int i = 0; message->media_most > 0 && http_fields_of_medium[i].name != NULL; i++) {
    known = known || strcmp(key, http_fields_of_medium[i].name) == 0;
  }
  for (int i = 0; i < HTTP_LISTS && message->lists[i].name != NULL; i++) {
    known = known || strcmp(key, message->lists[i].name) == 0;
  }
  return known || (message->parameters && core_choice_by_name(core_parameter_list, key) != NULL);
}

static wire_error check_keys(const struct http_message *message, const json_t *object) {
  const char *key;
  json_t *value;
  json_object_foreach((json_t *)(uintptr_t)object, key, value) {
    if (!is_known(message, key)) {
      const bool fits = key[0] != '\0' && strlen(key) < sizeof((wire_error *)NULL)->field;
      return bad(fits ? key : "body", "only fields that /v1/openapi.json lists for this request");
    }
  }
  return wire_error_none();
}

static wire_error add_list(const struct question *q, const struct http_list *list, bool single) {
  const json_t *value = json_object_get(q->object, list->name);
  const json_t *first = json_object_get(q->object, q->message->lists[0].name);
  const size_t count = first != NULL ? length_of(first) : 0;
  if (value == NULL && list->kind == HTTP_ZEROS) {
    return add(q, count * sizeof(double)) != NULL ? wire_error_none() : no_memory();
  }
  if (value == NULL) {
    return list->rule != NULL ? wire_error_none() : bad(list->name, "a list: it has to be given");
  }
  if (list->kind == HTTP_SETS) {
    return add_sets(q, list->name, value, count);
  }
  return length_of(value) == count
             ? add_numbers(q, list->name, value, single)
             : wire_error_make(WIRE_STATUS_BAD_COUNT, list->name, "as many as in the other list");
}

static wire_error add_all_lists(const struct question *q, bool single) {
  wire_error error = wire_error_none();
  for (int i = 0; is_good(&error) && i < HTTP_LISTS && q->message->lists[i].name != NULL; i++) {
    error = add_list(q, &q->message->lists[i], single);
  }
  return error;
}

wire_error http_question_translate(const struct http_message *message, const json_t *object,
                                   bool texts, struct http_text *payload, uint32_t *deadline_ms) {
  struct question q = {message, object, texts, payload, 0, 0};
  const json_t *deadline = json_object_get(object, "deadline_ms");
  uint64_t limit_ms = 0;
  size_t offset = 0;
  bool single = false;
  wire_error error = check_keys(message, object);
  if (is_good(&error) && deadline != NULL) {
    error = read_count("deadline_ms", deadline, UINT32_MAX, &limit_ms);
  }
  *deadline_ms = (uint32_t)limit_ms;
  if (is_good(&error) && add(&q, bytes_of(message)) == NULL) {
    error = no_memory();
  }
  if (is_good(&error)) {
    error = add_media(&q);
  }
  if (is_good(&error)) {
    error = add_parameters(&q);
  }
  if (is_good(&error)) {
    error = add_reference(&q);
  }
  for (int i = 0; is_good(&error) && i < HTTP_STRUCTURES && message->request[i] != NULL; i++) {
    error = put_fixed(&q, message->request[i], &offset, &single);
  }
  return is_good(&error) ? add_all_lists(&q, single) : error;
}
