#include <string.h>

#include "clients/c/client.h"

/* The bytes of the character at text, whose first byte says how many there are; 1 when it is not
 * well-formed. Overlong forms and surrogates are left alone: they draw nothing harmful. */
static size_t character_bytes(const unsigned char *text) {
  const size_t bytes = text[0] >= 0xf0 ? 4 : text[0] >= 0xe0 ? 3 : text[0] >= 0xc2 ? 2 : 1;
  if (text[0] > 0xf4) {
    return 1;
  }
  for (size_t i = 1; i < bytes; i++) {
    if ((text[i] & 0xc0) != 0x80) { /* the terminating zero too */
      return 1;
    }
  }
  return bytes;
}

/* U+0080 to U+009F are control characters like those below U+0020. */
static bool is_control(const unsigned char *text, size_t bytes) {
  return bytes == 1 ? text[0] < 0x20 || text[0] == 0x7f
                    : bytes == 2 && text[0] == 0xc2 && text[1] < 0xa0;
}

void libdipole_clean_text(char *text) {
  unsigned char *at = (unsigned char *)text;
  while (*at != '\0') {
    const size_t bytes = character_bytes(at);
    if (is_control(at, bytes) || (bytes == 1 && *at >= 0x80)) {
      memset(at, '?', bytes);
    }
    at += bytes;
  }
}
