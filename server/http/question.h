/* question: translates what a client asks over HTTP into the payload of a request. */
#ifndef DIPOLED_HTTP_QUESTION_H
#define DIPOLED_HTTP_QUESTION_H

#include <jansson.h>

#include "server/http/fields.h"
#include "server/http/text.h"

/* Reads a JSON text: one object without a key that comes twice, with at most `brackets_max` arrays
 * and objects. Returns NULL and sets *error if it is none. The caller calls json_decref(). */
json_t *http_question_parse(const char *bytes, size_t count, size_t brackets_max,
                            wire_error *error);

/* Reads what follows the question mark of a URI: NAME=VALUE with & between them, where commas
 * separate the elements of a list. The object has texts and lists of texts. */
json_t *http_question_parse_query(const char *query, wire_error *error);

/* Writes the payload of a request, and its deadline. texts: whether numbers may be texts, as in a
 * query. The daemon checks the values when it answers the request. */
wire_error http_question_translate(const struct http_message *message, const json_t *object,
                                   bool texts, struct http_text *payload, uint32_t *deadline_ms);

#endif
