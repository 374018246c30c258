/* json: a JSON text, written piece by piece. */
#ifndef DIPOLE_CLI_JSON_H
#define DIPOLE_CLI_JSON_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

typedef struct cli_json {
  FILE *file;
  int depth;
  bool one_line; /* the whole text stands on one line */
  bool filled;   /* the innermost object or array is not empty */
} cli_json;

/* Every value has a key, which is NULL for an element of an array and for the outermost value. That
 * one is an object. */
void cli_json_begin(cli_json *json, const char *key, char bracket); /* { or [ */
void cli_json_end(cli_json *json, char bracket);                    /* } or ] */
void cli_json_text(cli_json *json, const char *key, const char *text);

/* Writes an object of texts: pairs of a name and a text, then NULL. */
void cli_json_texts(cli_json *json, const char *key, ...) __attribute__((sentinel));

void cli_json_count(cli_json *json, const char *key, uint64_t value);
void cli_json_counts(cli_json *json, const char *key, const uint32_t *values, size_t count);

/* NaN, which JSON does not know, is null; infinities are the texts "inf" and "-inf". */
void cli_json_number(cli_json *json, const char *key, double value);
void cli_json_numbers(cli_json *json, const char *key, const double *values, size_t count);

#endif
