/* values: the named values that a client sends over HTTP, which are the members of a JSON object. A
 * query becomes such an object, too: its values are texts, or arrays of texts for lists. */
#ifndef DIPOLED_HTTP_VALUES_H
#define DIPOLED_HTTP_VALUES_H

#include <jansson.h>
#include <string.h>

#include "core/core.h"
#include "proto/wire.h"

/* Reads a JSON text: one object without a key that comes twice, with at most `brackets_max` arrays
 * and objects. The caller releases the object by json_decref(). On failure, sets *error and returns
 * NULL. */
json_t *http_values_parse(const char *bytes, size_t count, size_t brackets_max, wire_error *error);

/* Reads what follows the "?" of a URI, likewise: NAME=VALUE with & between them, where commas separate
 * the elements of a list. Changes the text. */
json_t *http_values_parse_query(char *query, wire_error *error);

/* Compares two names. Few of those that are looked for begin alike. */
static inline bool http_values_same(const char *one, const char *other) {
  return one[0] == other[0] && strcmp(one, other) == 0;
}

/* Returns how many elements a value has. What is no list counts as a list of one. */
size_t http_value_count(const json_t *value);

/* Returns an element, or NULL if there are fewer. A list of one has it at each index. */
const json_t *http_value_at(const json_t *value, size_t index);

/* Reads a number, or the texts inf and -inf; in a query (in_query) all numbers are texts. Returns
 * false, and sets *number to NaN, if it is none. */
bool http_value_number(const json_t *value, bool in_query, double *number);

/* These read one value and name the field at fault. most: the largest integer allowed.
 * bits: the value is a list of entries, whose sum is wanted; else it is one entry. */
wire_error http_value_read_count(const json_t *value, const char *field, uint64_t most,
                                 uint64_t *number);
wire_error http_value_read_choice(const json_t *value, const char *field, const core_choice *list,
                                  bool bits, uint64_t *number);

#endif
