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

static wire_error no_memory(void) {
  return wire_error_busy("max_total_bytes", "less data at a time: there is no memory", 1000);
}

json_t *http_values_parse(const char *bytes, size_t count, size_t brackets_max, wire_error *error) {
  json_error_t why;
  char allowed[80];
  *error = check_brackets(bytes, count, brackets_max);
  if (error->status != WIRE_STATUS_OK) {
    return NULL;
  }
  lacks_memory = false;
  json_set_alloc_funcs(allocate, free);
  json_t *object = json_loadb(bytes, count, JSON_REJECT_DUPLICATES, &why);
  if (json_is_object(object)) {
    return object;
  }
  /* What jansson quotes of the text may end in the middle of a character. */
  const char *quoted = strstr(why.text, " near ");
  snprintf(allowed, sizeof allowed, "JSON (RFC 8259), which it is not at line %d: %.*s", why.line,
           (int)(quoted != NULL ? quoted - why.text : (ptrdiff_t)strlen(why.text)), why.text);
  *error =
      lacks_memory ? no_memory() : bad_value("body", object != NULL ? "a JSON object" : allowed);
  json_decref(object);
  return NULL;
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

/* Makes a text, or a list of texts, each of which ends with a zero byte. Returns NULL if there is no
 * memory. */
static json_t *make_value(const char *text, size_t count) {
  if (count == 1) {
    return json_string_nocheck(text);
  }
  json_t *list = json_array();
  for (bool good = true; good && count > 0; count--, text += strlen(text) + 1) {
    good = json_array_append_new(list, json_string_nocheck(text)) == 0;
    if (!good) {
      json_decref(list);
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
  if (json_object_get(object, pair) != NULL) {
    return bad_value("query", "each name once: a list has commas, as in r=0.5,1,2");
  }
  return json_object_set_new_nocheck(object, pair, make_value(text, count)) == 0 ? wire_error_none()
                                                                                 : no_memory();
}

json_t *http_values_parse_query(char *query, wire_error *error) {
  json_t *object = json_object();
  *error = object != NULL ? wire_error_none() : no_memory();
  for (char *pair; error->status == WIRE_STATUS_OK && (pair = strsep(&query, "&")) != NULL;) {
    if (*pair != '\0') {
      *error = add_pair(object, pair);
    }
  }
  if (error->status != WIRE_STATUS_OK) {
    json_decref(object);
    return NULL;
  }
  return object;
}

/* ---- reading --------------------------------------------------------------------------------- */

size_t http_value_count(const json_t *value) {
  return json_is_array(value) ? json_array_size(value) : 1;
}

const json_t *http_value_at(const json_t *value, size_t index) {
  return json_is_array(value) ? json_array_get(value, json_array_size(value) > 1 ? index : 0)
                              : value;
}

/* In a query, a number with a leading zero is none: a list 0,05 is meant as 0.05. */
bool http_value_number(const json_t *value, bool in_query, double *number) {
  const char *text = json_string_value(value);
  *number = json_is_number(value) ? json_number_value(value) : (double)NAN;
  if (text != NULL && (in_query || strcmp(text, "inf") == 0 || strcmp(text, "-inf") == 0) &&
      (decimal_starts_with_zero(text) || !decimal_read(text, number))) {
    *number = (double)NAN;
  }
  return !isnan(*number);
}

wire_error http_value_read_count(const json_t *value, const char *field, uint64_t most,
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
    const wire_error error = http_value_read_count(value, field, UINT16_MAX, id);
    entry = error.status == WIRE_STATUS_OK ? core_choice_by_id(list, (unsigned)*id) : NULL;
  }
  if (entry == NULL) {
    return wire_error_not_in_list(field, list, bits ? "a sum of" : "one of");
  }
  *id = entry->id;
  return wire_error_none();
}

wire_error http_value_read_choice(const json_t *value, const char *field, const core_choice *list,
                                  bool bits, uint64_t *number) {
  const size_t count = http_value_count(value);
  wire_error error = wire_error_none();
  *number = 0;
  if (!bits && (count != 1 || json_is_array(value))) {
    return bad_value(field, "one entry of its list");
  }
  for (size_t i = 0; error.status == WIRE_STATUS_OK && i < count; i++) {
    uint64_t id = 0;
    error = read_entry(http_value_at(value, i), field, list, bits, &id);
    error.index = i;
    *number |= id;
  }
  return error;
}
