/* reply: translates replies and errors of the binary protocol into JSON. */
#ifndef DIPOLED_HTTP_REPLY_H
#define DIPOLED_HTTP_REPLY_H

#include "proto/schema.h"
#include "server/http/text.h"

/* Writes the reply to a request that HTTP has. Both payloads are those of the daemon's own
 * frames: complete and valid. g_is_default: whether the request left g out. */
void http_reply_write(const schema_message *message, const uint8_t *request, bool g_is_default,
                      const uint8_t *payload, size_t payload_bytes, struct text *text);

/* Writes the replies to the requests hello and media. */
void http_reply_write_models(const uint8_t *payload, struct text *text);
void http_reply_write_media(const uint8_t *payload, struct text *text);

/* Writes an error, and returns the status of HTTP that proto/statuses.def gives it. */
unsigned http_reply_write_error(const wire_error *error, struct text *text);

#endif
