#include "server/http/values.h"

#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/decimal.h"

static wire_error bad_value(const char *field, const char *allowed) {
  return wire_error_make(WIRE_STATUS_BAD_VALUE, field, allowed);
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
      return bad_value("body", depth > DEPTH_MAX
                                   ? "JSON that is nested 4 deep at most"
                                   : "fewer arrays and objects: a sixteenth of max_part_bytes");
    }
  }
  return wire_error_none();
}

/* Whether there was no memory: jansson tells some of those faults as wrong JSON. */
static _Thread_local bool lacks_memory;

static void *allocate(size_t bytes) {
  void *memory = malloc(bytes);
  lacks_memory |= memory == NULL;
  return memory;
}

wire_error http_values_parse(struct http_values *values, const char *bytes, size_t count,
                             size_t brackets_max) {
  json_error_t why;
  char allowed[80];
  const wire_error error = check_brackets(bytes, count, brackets_max);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  lacks_memory = false;
  json_set_alloc_funcs(allocate, free);
  json_t *object = json_loadb(bytes, count, JSON_REJECT_DUPLICATES, &why);
  if (json_is_object(object)) {
    values->object = object;
    return error;
  }
  if (lacks_memory) {
    json_decref(object);
    return wire_error_busy("max_total_bytes", "less data at a time: there is no memory", 1000);
  }
  if (object != NULL) {
    json_decref(object);
    return bad_value("body", "a JSON object");
  }
  /* What jansson quotes of the text may end in the middle of a character. */
  const char *quoted = strstr(why.text, " near ");
  snprintf(allowed, sizeof allowed, "JSON (RFC 8259), which it is not at line %d: %.*s", why.line,
           (int)(quoted != NULL ? quoted - why.text : (ptrdiff_t)strlen(why.text)), why.text);
  return bad_value("body", allowed);
}

bool http_values_of_object(struct http_values *values, struct http_value value) {
  values->object = value.json;
  return json_is_object(value.json);
}

/* ---- queries --------------------------------------------------------------------------------- */

static int digit_of(char character) {
  return !isxdigit((unsigned char)character) ? -1
         : character <= '9'                  ? character - '0'
                                             : (character | 0x20) - 'a' + 10;
}

/* Decodes %XX in place, and ends each element of a list with a zero byte. Returns how many elements
 * there are, or 0 if it finds another escape, or an escaped zero byte. */
static size_t unescape(char *text) {
  char *to = text;
  size_t count = 1;
  for (const char *at = text; *at != '\0'; at++) {
    char byte = *at;
    if (byte == '%') {
      const int high = digit_of(at[1]), low = high < 0 ? -1 : digit_of(at[2]);
      if (low < 0 || high + low == 0) {
        return 0;
      }
      byte = (char)(high << 4 | low);
      at += 2;
    }
    count += byte == ',';
    *to++ = byte == ',' ? '\0' : byte;
  }
  *to = '\0';
  return count;
}

static wire_error add_pair(struct http_values *values, char *pair) {
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
  _Static_assert(HTTP_QUERY_NAMES == 64, "the error says so");
  if (values->name_count == HTTP_QUERY_NAMES || http_value_given(http_values_get(values, pair))) {
    return bad_value("query", "at most 64 names, each once: a list has commas, as in r=0.5,1,2");
  }
  values->initials |= UINT64_C(1) << (pair[0] & 63);
  values->names[values->name_count].name = pair;
  values->names[values->name_count++].value = (struct http_value){NULL, text, count};
  return wire_error_none();
}

wire_error http_values_parse_query(struct http_values *values, char *query) {
  values->object = NULL;
  values->initials = 0;
  values->name_count = 0;
  for (char *pair = query, *next; pair != NULL; pair = next) {
    next = strchr(pair, '&');
    if (next != NULL) {
      *next++ = '\0';
    }
    if (*pair != '\0') {
      const wire_error error = add_pair(values, pair);
      if (error.status != WIRE_STATUS_OK) {
        return error;
      }
    }
  }
  return wire_error_none();
}

/* ---- names ----------------------------------------------------------------------------------- */

void http_values_free(struct http_values *values) {
  json_decref((json_t *)(uintptr_t)values->object);
}

struct http_value http_values_find(const struct http_values *values, const char *name) {
  if (values->object != NULL) {
    return (struct http_value){.json = json_object_get(values->object, name)};
  }
  for (size_t i = 0; i < values->name_count; i++) {
    if (http_values_same(values->names[i].name, name)) {
      return values->names[i].value;
    }
  }
  return (struct http_value){0};
}

const char *http_values_unknown(const struct http_values *values,
                                bool (*is_known)(const void *context, const char *name),
                                const void *context) {
  const char *name;
  json_t *value;
  json_object_foreach((json_t *)(uintptr_t)values->object, name, value) {
    if (!is_known(context, name)) {
      return name;
    }
  }
  for (size_t i = 0; values->object == NULL && i < values->name_count; i++) {
    if (!is_known(context, values->names[i].name)) {
      return values->names[i].name;
    }
  }
  return NULL;
}

/* ---- elements -------------------------------------------------------------------------------- */

const char *http_value_text(struct http_value value) {
  return value.count == 1 ? value.text : json_string_value(value.json);
}

size_t http_value_count(struct http_value value) {
  return value.text != NULL          ? value.count
         : json_is_array(value.json) ? json_array_size(value.json)
                                     : 1;
}

struct http_elements http_elements_of(struct http_value value) {
  return (struct http_elements){value, 0, value.text};
}

struct http_value http_elements_next(struct http_elements *elements) {
  const struct http_value list = elements->list;
  const bool is_array = json_is_array(list.json);
  const char *text = elements->text;
  if (list.text == NULL ? !is_array : list.count == 1) {
    return list;
  }
  if (is_array) {
    const size_t at = json_array_size(list.json) > 1 ? elements->next++ : 0;
    return (struct http_value){.json = json_array_get(list.json, at)};
  }
  if (elements->next == list.count) {
    return (struct http_value){0};
  }
  elements->next++;
  elements->text += strlen(text) + 1;
  return (struct http_value){.text = text, .count = 1};
}

/* ---- reading --------------------------------------------------------------------------------- */

/* Reads a number from a text. One with a leading zero is none: a list 0,05 is meant as 0.05. */
static bool read_text(const char *text, double *number) {
  return !decimal_starts_with_zero(text) && decimal_read(text, number);
}

bool http_value_number(struct http_value value, double *number) {
  const char *text = http_value_text(value);
  *number = (double)NAN;
  if (json_is_number(value.json)) {
    *number = json_number_value(value.json);
  } else if (text != NULL &&
             (value.text != NULL || strcmp(text, "inf") == 0 || strcmp(text, "-inf") == 0) &&
             !read_text(text, number)) {
    *number = (double)NAN;
  }
  return !isnan(*number);
}

bool http_elements_number(struct http_elements *elements, double *number) {
  const struct http_value list = elements->list;
  if (list.text == NULL || list.count == 1 || elements->next == list.count) {
    return http_value_number(http_elements_next(elements), number);
  }
  const char *text = elements->text;
  elements->next++;
  elements->text += strlen(text) + 1;
  if (!read_text(text, number)) {
    *number = (double)NAN;
  }
  return !isnan(*number);
}

wire_error http_value_read_count(struct http_value value, const char *field, uint64_t most,
                                 uint64_t *number) {
  const char *text = http_value_text(value);
  char allowed[80];
  bool good = false;
  if (json_is_integer(value.json)) {
    good = json_integer_value(value.json) >= 0;
    *number = (uint64_t)json_integer_value(value.json);
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
static wire_error read_entry(struct http_value value, const char *field, const core_choice *list,
                             bool bits, uint64_t *id) {
  const char *name = http_value_text(value);
  const core_choice *entry = name != NULL ? core_choice_by_name(list, name) : NULL;
  if (entry == NULL) {
    const wire_error error = http_value_read_count(value, field, UINT16_MAX, id);
    entry = error.status == WIRE_STATUS_OK ? core_choice_by_id(list, (unsigned)*id) : NULL;
  }
  if (entry == NULL) {
    return wire_error_not_in_list(field, list, bits ? "a sum of" : "one of");
  }
  *id = entry->id;
  return wire_error_none();
}

wire_error http_value_read_choice(struct http_value value, const char *field,
                                  const core_choice *list, bool bits, uint64_t *number) {
  const size_t count = http_value_count(value);
  struct http_elements elements = http_elements_of(value);
  wire_error error = wire_error_none();
  *number = 0;
  if (!bits && (count != 1 || json_is_array(value.json))) {
    return bad_value(field, "one entry of its list");
  }
  for (size_t i = 0; error.status == WIRE_STATUS_OK && i < count; i++) {
    uint64_t id = 0;
    error = read_entry(http_elements_next(&elements), field, list, bits, &id);
    error.index = i;
    *number |= id;
  }
  return error;
}
