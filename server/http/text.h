/* text: writes JSON into a text. */
#ifndef DIPOLED_HTTP_TEXT_H
#define DIPOLED_HTTP_TEXT_H

#include "proto/schema.h"
#include "server/net/text.h"

/* These write a value. Each has a key, or NULL for an element of an array and the outermost value.
 * Keys are taken as they are.
 * bracket: { or [, then } or ]. Numbers that are NaN, which JSON does not know, are null;
 * infinities are the texts "inf" and "-inf". Texts are UTF-8. */
void http_text_begin(struct text *text, const char *key, char bracket);
void http_text_end(struct text *text, char bracket);
void http_text_string(struct text *text, const char *key, const char *string);
void http_text_number(struct text *text, const char *key, double value);
void http_text_numbers(struct text *text, const char *key, const void *values, uint64_t count,
                       bool single); /* values are float if `single`, else double */
void http_text_count(struct text *text, const char *key, uint64_t value);

/* Writes a value that is JSON already. */
void http_text_raw(struct text *text, const char *key, const char *json);

#endif
