#include "server/http/text.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/decimal.h"

enum { FIRST_BYTES = 4096, KEPT_BYTES = 16384 };

void http_text_init(struct http_text *text, struct server *server) {
  *text = (struct http_text){.server = server};
}

void http_text_reset(struct http_text *text) {
  if (text->failed || text->capacity > KEPT_BYTES) {
    http_text_free(text);
  }
  text->count = 0;
  text->filled = false;
}

void http_text_free(struct http_text *text) {
  free(text->bytes);
  server_return_bytes(text->server, text->capacity);
  *text = (struct http_text){.server = text->server};
}

static bool grow(struct http_text *text, size_t wanted) {
  size_t capacity = text->capacity > 0 ? text->capacity : FIRST_BYTES;
  while (capacity < wanted) {
    capacity *= 2;
  }
  if (!server_take_bytes(text->server, capacity - text->capacity)) {
    return false;
  }
  char *bytes = realloc(text->bytes, capacity);
  if (bytes == NULL) {
    server_return_bytes(text->server, capacity - text->capacity);
    return false;
  }
  text->bytes = bytes;
  text->capacity = capacity;
  return true;
}

char *http_text_room(struct http_text *text, size_t bytes) {
  if (!text->failed && bytes > text->capacity - text->count) {
    text->failed = !grow(text, text->count + bytes);
  }
  return text->failed ? NULL : text->bytes + text->count;
}

void http_text_add(struct http_text *text, const char *bytes, size_t count) {
  char *at = http_text_room(text, count);
  if (at != NULL && count > 0) {
    memcpy(at, bytes, count);
    text->count += count;
  }
}

/* Returns how many bytes come before the first one that needs an escape. */
static size_t plain_bytes(const char *string) {
  size_t count = 0;
  while ((unsigned char)string[count] >= 0x20 && string[count] != '"' && string[count] != '\\') {
    count++;
  }
  return count;
}

static void add_escape(struct http_text *text, unsigned char byte) {
  char escaped[8];
  const int length = byte < 0x20 ? snprintf(escaped, sizeof escaped, "\\u%04x", byte)
                                 : snprintf(escaped, sizeof escaped, "\\%c", byte);
  http_text_add(text, escaped, (size_t)length);
}

static void add_string(struct http_text *text, const char *string) {
  http_text_add(text, "\"", 1);
  for (;;) {
    const size_t plain = plain_bytes(string);
    http_text_add(text, string, plain);
    string += plain;
    if (*string == '\0') {
      break;
    }
    add_escape(text, (unsigned char)*string++);
  }
  http_text_add(text, "\"", 1);
}

/* Starts a value. Keys are names from lists of the protocol, which need no escapes. */
static void start_value(struct http_text *text, const char *key) {
  const size_t length = key != NULL ? strlen(key) : 0;
  char *at = http_text_room(text, length + 4);
  if (at != NULL) {
    char *const begin = at;
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
    text->count += (size_t)(at - begin);
  }
  text->filled = true;
}

void http_text_begin(struct http_text *text, const char *key, char bracket) {
  start_value(text, key);
  http_text_add(text, &bracket, 1);
  text->filled = false;
}

void http_text_end(struct http_text *text, char bracket) {
  http_text_add(text, &bracket, 1);
  text->filled = true;
}

void http_text_string(struct http_text *text, const char *key, const char *string) {
  start_value(text, key);
  add_string(text, string);
}

static size_t write_number(double value, char *at) {
  if (isfinite(value) && value != 0) {
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

void http_text_number(struct http_text *text, const char *key, double value) {
  start_value(text, key);
  char *at = http_text_room(text, DECIMAL_BYTES);
  if (at != NULL) {
    text->count += write_number(value, at);
  }
}

/* Room for so many numbers is made at a time. */
enum { NUMBERS_AT_ONCE = 256 };

void http_text_numbers(struct http_text *text, const char *key, const void *values, uint64_t count,
                       bool single) {
  char *at = NULL;
  http_text_begin(text, key, '[');
  for (uint64_t i = 0; i < count; i++) {
    if (i % NUMBERS_AT_ONCE == 0) {
      const uint64_t left = count - i;
      at = http_text_room(text, (DECIMAL_BYTES + 1) *
                                    (size_t)(left < NUMBERS_AT_ONCE ? left : NUMBERS_AT_ONCE));
      if (at == NULL) {
        return;
      }
    }
    char *const begin = at;
    if (i > 0) {
      *at++ = ',';
    }
    at +=
        write_number(single ? (double)((const float *)values)[i] : ((const double *)values)[i], at);
    text->count += (size_t)(at - begin);
  }
  http_text_end(text, ']');
}

void http_text_count(struct http_text *text, const char *key, uint64_t value) {
  char digits[24];
  snprintf(digits, sizeof digits, "%llu", (unsigned long long)value);
  http_text_raw(text, key, digits);
}

void http_text_bool(struct http_text *text, const char *key, bool value) {
  http_text_raw(text, key, value ? "true" : "false");
}

void http_text_raw(struct http_text *text, const char *key, const char *json) {
  start_value(text, key);
  http_text_add(text, json, strlen(json));
}
