/* text: bytes that grow in memory, which counts against the budget of all buffers. */
#ifndef DIPOLED_TEXT_H
#define DIPOLED_TEXT_H

#include <string.h>

#include "server/server.h"

struct text {
  struct budget *budget;
  char *bytes; /* without a zero byte at the end; NULL before the first one */
  size_t count;
  size_t capacity;
  bool failed; /* whether there was no memory; what was written since is lost */
  bool filled; /* JSON: whether the innermost object or array is not empty */
};

void text_init(struct text *text, struct budget *budget);

/* Empties the text. Keeps its memory for the next one if that is not much. */
void text_reset(struct text *text);

/* Frees unused memory, if it is much. */
void text_trim(struct text *text);

/* Frees the bytes and returns their memory to the budget. */
void text_free(struct text *text);

/* Gets memory for more bytes. Returns false if there is none, or was none before. */
bool text_grow(struct text *text, size_t bytes);

/* Makes room for this many bytes behind those that are there, and returns where it begins. Returns
 * NULL if there is no memory. The caller adds to `count` what it writes. */
static inline char *text_room(struct text *text, size_t bytes) {
  const bool fits = bytes <= text->capacity - text->count && !text->failed;
  return fits || (!text->failed && text_grow(text, bytes)) ? text->bytes + text->count : NULL;
}

/* Adds bytes as they are. */
static inline void text_add(struct text *text, const void *bytes, size_t count) {
  char *at = count > 0 ? text_room(text, count) : NULL;
  if (at != NULL) {
    memcpy(at, bytes, count);
    text->count += count;
  }
}

#endif
