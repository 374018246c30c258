#include "clients/cli/json.h"

#include <math.h>
#include <stdarg.h>

#include "clients/c/error.h"
#include "clients/cli/number.h"

static void write_text(FILE *file, const char *text) {
  fputc('"', file);
  for (size_t bytes; *text != '\0'; text += bytes > 0 ? bytes : 1) {
    const unsigned char byte = (unsigned char)*text;
    bytes = libdipole_character_bytes(text);
    if (byte == '"' || byte == '\\') {
      fprintf(file, "\\%c", byte);
    } else if (byte < 0x20 || bytes == 0) {
      fprintf(file, "\\u%04x", bytes == 0 ? 0xfffdU : byte);
    } else {
      fwrite(text, 1, bytes, file);
    }
  }
  fputc('"', file);
}

static void write_number(FILE *file, double value) {
  char text[CLI_NUMBER_BYTES];
  cli_number_format(value, text);
  if (isinf(value)) {
    write_text(file, text);
  } else {
    fputs(isnan(value) ? "null" : text, file);
  }
}

static void start_line(const cli_json *json) {
  if (json->one_line) {
    return;
  }
  fprintf(json->file, "\n%*s", 2 * json->depth, "");
}

static void start_value(cli_json *json, const char *key) {
  if (json->filled) {
    fputs(json->one_line ? ", " : ",", json->file);
  }
  if (json->depth > 0) {
    start_line(json);
  }
  if (key != NULL) {
    write_text(json->file, key);
    fputs(": ", json->file);
  }
  json->filled = true;
}

void cli_json_begin(cli_json *json, const char *key, char bracket) {
  start_value(json, key);
  fputc(bracket, json->file);
  json->depth++;
  json->filled = false;
}

void cli_json_end(cli_json *json, char bracket) {
  json->depth--;
  if (json->filled) {
    start_line(json);
  }
  fputc(bracket, json->file);
  json->filled = true;
  if (json->depth == 0) {
    fputc('\n', json->file);
  }
}

void cli_json_text(cli_json *json, const char *key, const char *text) {
  start_value(json, key);
  write_text(json->file, text);
}

void cli_json_texts(cli_json *json, const char *key, ...) {
  va_list pairs;
  const char *name;
  va_start(pairs, key);
  cli_json_begin(json, key, '{');
  while ((name = va_arg(pairs, const char *)) != NULL) {
    cli_json_text(json, name, va_arg(pairs, const char *));
  }
  cli_json_end(json, '}');
  va_end(pairs);
}

void cli_json_count(cli_json *json, const char *key, uint64_t value) {
  start_value(json, key);
  fprintf(json->file, "%llu", (unsigned long long)value);
}

void cli_json_number(cli_json *json, const char *key, double value) {
  start_value(json, key);
  write_number(json->file, value);
}

void cli_json_numbers(cli_json *json, const char *key, const double *values, size_t count) {
  start_value(json, key);
  fputc('[', json->file);
  for (size_t i = 0; i < count; i++) {
    fputs(i > 0 ? ", " : "", json->file);
    write_number(json->file, values[i]);
  }
  fputc(']', json->file);
}

void cli_json_counts(cli_json *json, const char *key, const uint32_t *values, size_t count) {
  start_value(json, key);
  fputc('[', json->file);
  for (size_t i = 0; i < count; i++) {
    fprintf(json->file, "%s%lu", i > 0 ? ", " : "", (unsigned long)values[i]);
  }
  fputc(']', json->file);
}
