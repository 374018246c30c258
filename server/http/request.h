/* request: translates a request over HTTP into the payload of a request, by the tables of
 * proto/schema.h. */
#ifndef DIPOLED_HTTP_REQUEST_H
#define DIPOLED_HTTP_REQUEST_H

#include "proto/schema.h"
#include "server/http/text.h"

/* Writes the payload of a request, of at most bytes_max bytes, its deadline, and whether its g is a
 * default. text: JSON of text_bytes bytes, or, in_query, what follows the "?" of a URI with a zero byte
 * behind it, which changes. The daemon checks the values when it serves the request. */
wire_error http_request_translate(const schema_message *message, char *text, size_t text_bytes,
                                  bool in_query, struct text *payload, size_t bytes_max,
                                  uint32_t *deadline_ms, bool *g_is_default);

/* The lists of numbers of a request in JSON: one for each part that has an `about`, but x, y and z for
 * positions. Sets *name to the name of list `index`. Returns its part, or NULL behind the last. */
const schema_part *http_request_list(const schema_payload *request, unsigned index,
                                     const char **name);

/* Returns the list of the optional numbers that a request may have as fields: parameters, or the
 * properties of a tissue. It may be empty. */
const core_choice *http_request_numbers(const schema_payload *request);

/* Returns how many media a request may have: 0, 1 or UINT_MAX. */
unsigned http_request_media(const schema_payload *request);

#endif
