/* values: the named values that a client sends over HTTP, which are the members of a JSON object or
 * those of a query. */
#ifndef DIPOLED_HTTP_VALUES_H
#define DIPOLED_HTTP_VALUES_H

#include <jansson.h>
#include <string.h>

#include "core/core.h"
#include "proto/wire.h"

enum { HTTP_QUERY_NAMES = 64 }; /* most names in a query */

/* Either a value of JSON, or one text or more of a query, each of which ends with a zero byte.
 * Neither if it was not given. */
struct http_value {
  const json_t *json;
  const char *text;
  size_t count; /* of texts */
};

struct http_values {
  const json_t *object; /* NULL: the value is a query */
  uint64_t initials; /* of the names in the query: bit i is set if the first byte modulo 64 is i */
  size_t name_count; /* number of names in the query */
  struct {
    const char *name;
    struct http_value value;
  } names[HTTP_QUERY_NAMES];
};

/* Reads a JSON text: one object without a key that comes twice, with at most `brackets_max` arrays
 * and objects. On success the caller frees the values. */
wire_error http_values_parse(struct http_values *values, const char *bytes, size_t count,
                             size_t brackets_max);

/* Reads what follows the "?" of a URI: NAME=VALUE with & between them, where commas
 * separate the elements of a list. The values lie in the query, which this changes. On success the
 * caller frees the values. */
wire_error http_values_parse_query(struct http_values *values, char *query);

void http_values_free(struct http_values *values);

/* Takes the members of an object as values, which are not to be freed. Returns false if the value
 * is no object. */
bool http_values_of_object(struct http_values *values, struct http_value value);

struct http_value http_values_find(const struct http_values *values, const char *name);

/* Returns the value of a name, which is not given if there is none. Most names that are looked for
 * are not in a query. */
static inline struct http_value http_values_get(const struct http_values *values,
                                                const char *name) {
  return values->object == NULL && (values->initials >> (name[0] & 63) & 1) == 0
             ? (struct http_value){0}
             : http_values_find(values, name);
}

/* Returns the first name that `is_known` does not know, or NULL. */
const char *http_values_unknown(const struct http_values *values,
                                bool (*is_known)(const void *context, const char *name),
                                const void *context);

/* Compares two names. Few of those that are looked for begin alike. */
static inline bool http_values_same(const char *one, const char *other) {
  return one[0] == other[0] && strcmp(one, other) == 0;
}

static inline bool http_value_given(struct http_value value) {
  return value.json != NULL || value.text != NULL;
}

/* Returns the text of a value that is one text, or NULL. */
const char *http_value_text(struct http_value value);

/* Returns how many elements a value has. What is no list counts as a list of one. */
size_t http_value_count(struct http_value value);

/* The elements of a value, one after the other. */
struct http_elements {
  struct http_value list;
  size_t next;
  const char *text;
};

struct http_elements http_elements_of(struct http_value value);

/* Reads the next element as http_value_number() does. A list of one has it again and again. Returns
 * false, and sets *number to NaN, if it is no number or if there is none. */
bool http_elements_number(struct http_elements *elements, double *number);

/* Returns the next element. A list of one has it again and again; other lists end with values that
 * are not given. */
struct http_value http_elements_next(struct http_elements *elements);

/* Reads a number; in JSON also the texts inf and -inf, in a query all numbers are texts. Returns
 * false, and sets *number to NaN, if it is none. */
bool http_value_number(struct http_value value, double *number);

/* These read one value and name the field at fault. most: the largest integer allowed.
 * bits: the value is a list of entries, whose sum is wanted; else it is one entry. */
wire_error http_value_read_count(struct http_value value, const char *field, uint64_t most,
                                 uint64_t *number);
wire_error http_value_read_choice(struct http_value value, const char *field,
                                  const core_choice *list, bool bits, uint64_t *number);

#endif
