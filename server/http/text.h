/* text: a JSON text that grows in memory, which counts against the budget of all buffers. */
#ifndef DIPOLED_HTTP_TEXT_H
#define DIPOLED_HTTP_TEXT_H

#include "proto/schema.h"
#include "server/server.h"

struct http_text {
  struct budget *budget;
  char *bytes; /* without a zero byte at the end; NULL before the first one */
  size_t count;
  size_t capacity;
  bool failed; /* whether there was no memory; what was written since is lost */
  bool filled; /* whether the innermost object or array is not empty */
};

void http_text_init(struct http_text *text, struct budget *budget);

/* Empties the text. Keeps its memory for the next one if that is not much. */
void http_text_reset(struct http_text *text);

/* Frees unused memory, if it is much. */
void http_text_trim(struct http_text *text);

/* Frees the bytes and returns their memory to the budget. */
void http_text_free(struct http_text *text);

/* Makes room for this many bytes behind those that are there, and returns where it begins. Returns
 * NULL if there is no memory. The caller adds to `count` what it writes. */
char *http_text_room(struct http_text *text, size_t bytes);

/* Adds bytes as they are. */
void http_text_add(struct http_text *text, const char *bytes, size_t count);

/* These write a value. Each has a key, or NULL for an element of an array and the outermost value.
 * Keys are taken as they are.
 * bracket: { or [, then } or ]. Numbers that are NaN, which JSON does not know, are null;
 * infinities are the texts "inf" and "-inf". Texts are UTF-8. */
void http_text_begin(struct http_text *text, const char *key, char bracket);
void http_text_end(struct http_text *text, char bracket);
void http_text_string(struct http_text *text, const char *key, const char *string);
void http_text_number(struct http_text *text, const char *key, double value);
void http_text_field(struct http_text *text, const schema_field *field, double value);
void http_text_numbers(struct http_text *text, const char *key, const void *values, uint64_t count,
                       bool single); /* values are float if `single`, else double */
void http_text_count(struct http_text *text, const char *key, uint64_t value);

/* Writes a value that is JSON already. */
void http_text_raw(struct http_text *text, const char *key, const char *json);

#endif
