/* question: translates what a client asks over HTTP into the payload of a request. */
#ifndef DIPOLED_HTTP_QUESTION_H
#define DIPOLED_HTTP_QUESTION_H

#include "server/http/fields.h"
#include "server/http/text.h"
#include "server/http/values.h"

/* Writes the payload of a request, of at most bytes_max bytes, its deadline, and whether its g is a
 * default. The daemon checks the values when it answers the request. */
wire_error http_question_translate(const struct http_message *message,
                                   const struct http_values *values, struct http_text *payload,
                                   size_t bytes_max, uint32_t *deadline_ms, bool *g_is_default);

#endif
