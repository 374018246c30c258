#include "server/net/text.h"

#include <stdlib.h>

enum { FIRST_BYTES = 4096, KEPT_BYTES = 16384 };

void text_init(struct text *text, struct budget *budget) {
  *text = (struct text){.budget = budget};
}

void text_reset(struct text *text) {
  if (text->failed || text->capacity > KEPT_BYTES) {
    text_free(text);
  }
  text->count = 0;
  text->filled = false;
}

void text_free(struct text *text) {
  if (text->bytes != NULL) { /* a locked instruction takes longer than most texts */
    free(text->bytes);
    budget_return(text->budget, text->capacity);
  }
  *text = (struct text){.budget = text->budget};
}

void text_trim(struct text *text) {
  char *bytes = text->capacity > KEPT_BYTES && text->count > 0
                    ? budget_resize(text->budget, text->bytes, text->capacity, text->count, 0)
                    : NULL;
  if (bytes != NULL) {
    text->bytes = bytes;
    text->capacity = text->count;
  }
}

bool text_grow(struct text *text, size_t bytes) {
  const size_t wanted = text->count + bytes;
  size_t capacity = text->capacity > 0 ? text->capacity : FIRST_BYTES;
  while (capacity < wanted) {
    capacity *= 2;
  }
  char *grown = budget_resize(text->budget, text->bytes, text->capacity, capacity, KEPT_BYTES);
  text->failed = grown == NULL;
  if (grown != NULL) {
    text->bytes = grown;
    text->capacity = capacity;
  }
  return grown != NULL;
}
