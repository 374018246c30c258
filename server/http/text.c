#include "server/http/text.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "proto/decimal.h"

enum { ESCAPE_BYTES = 6 };

static char *put_string(char *at, const char *string) {
  *at++ = '"';
  for (; *string != '\0'; string++) {
    const unsigned char byte = (unsigned char)*string;
    if (byte < 0x20 || byte == '"' || byte == '\\') {
      at += sprintf(at, byte < 0x20 ? "\\u%04x" : "\\%c", byte);
    } else {
      *at++ = (char)byte;
    }
  }
  *at++ = '"';
  return at;
}

/* Starts a value, for which it makes room. Returns where it begins, or NULL if there is no memory.
 * Keys are names from lists of the protocol, which need no escapes. */
static char *start_value(struct text *text, const char *key, size_t bytes) {
  const size_t length = key != NULL ? strlen(key) : 0;
  char *at = text_room(text, length + 4 + bytes);
  if (at == NULL) {
    return NULL;
  }
  if (text->filled) {
    *at++ = ',';
  }
  if (key != NULL) {
    *at++ = '"';
    memcpy(at, key, length);
    at += length;
    *at++ = '"';
    *at++ = ':';
  }
  text->filled = true;
  return at;
}

/* Ends a value: `at` is where the next one begins. */
static void end_value(struct text *text, const char *at) {
  text->count = (size_t)(at - text->bytes);
}

void http_text_begin(struct text *text, const char *key, char bracket) {
  char *at = start_value(text, key, 1);
  if (at != NULL) {
    *at = bracket;
    end_value(text, at + 1);
  }
  text->filled = false;
}

void http_text_end(struct text *text, char bracket) {
  text_add(text, &bracket, 1);
  text->filled = true;
}

void http_text_string(struct text *text, const char *key, const char *string) {
  char *at = start_value(text, key, ESCAPE_BYTES * strlen(string) + 2);
  if (at != NULL) {
    end_value(text, put_string(at, string));
  }
}

static size_t write_number(double value, char *at) {
  if (value != 0 && isfinite(value)) {
    return decimal_write(value, at);
  }
  /* Some readers take -0 for an integer, and lose its sign. */
  const char *name = value == 0     ? (signbit(value) ? "-0.0" : "0")
                     : isnan(value) ? "null"
                     : value > 0    ? "\"inf\""
                                    : "\"-inf\"";
  memcpy(at, name, strlen(name));
  return strlen(name);
}

/* Writes a number likewise, from what was written before: replies repeat radii and coefficients. */
static size_t write_again(double value, char at[DECIMAL_BYTES]) {
  enum { KEPT_BITS = 9, KEPT_BYTES = 24 };
  static _Thread_local struct {
    uint64_t bits;
    uint64_t length; /* 0: none was written */
    char text[KEPT_BYTES];
  } kept[1 << KEPT_BITS], *one;
  uint64_t bits;
  memcpy(&bits, &value, sizeof bits);
  one = &kept[bits * UINT64_C(0x9e3779b97f4a7c15) >> (64 - KEPT_BITS)];
  if (one->bits == bits && one->length > 0) {
    memcpy(at, one->text, KEPT_BYTES);
    return one->length;
  }
  one->bits = bits;
  one->length = write_number(value, at);
  memcpy(one->text, at, KEPT_BYTES);
  return one->length;
}

void http_text_number(struct text *text, const char *key, double value) {
  char *at = start_value(text, key, DECIMAL_BYTES);
  if (at != NULL) {
    end_value(text, at + write_again(value, at));
  }
}

void http_text_numbers(struct text *text, const char *key, const void *values, uint64_t count,
                       bool single) {
  http_text_begin(text, key, '[');
  for (uint64_t i = 0; i < count; i++) {
    char *at = text_room(text, DECIMAL_BYTES + 1);
    if (at == NULL) {
      return;
    }
    *at = ',';
    at += i > 0;
    at += write_number(schema_real_at(values, i, single), at);
    end_value(text, at);
  }
  http_text_end(text, ']');
}

void http_text_count(struct text *text, const char *key, uint64_t value) {
  char digits[24] = "", *first = &digits[sizeof digits - 1];
  do {
    *--first = (char)('0' + value % 10);
    value /= 10;
  } while (value > 0);
  http_text_raw(text, key, first);
}

void http_text_raw(struct text *text, const char *key, const char *json) {
  const size_t length = strlen(json);
  char *at = start_value(text, key, length);
  if (at != NULL) {
    memcpy(at, json, length);
    end_value(text, at + length);
  }
}
