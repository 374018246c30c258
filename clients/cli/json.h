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
  bool one_line; /* for one text on each line */
  bool filled;   /* something stands in the innermost object or array already */
} cli_json;

/* Every value has a key, or NULL where it is an element of an array. The first and outermost one is
 * an object. */
void cli_json_begin(cli_json *json, const char *key, char bracket); /* { or [ */
void cli_json_end(cli_json *json, char bracket);                    /* } or ] */
void cli_json_text(cli_json *json, const char *key, const char *text);
void cli_json_count(cli_json *json, const char *key, uint64_t value);
void cli_json_counts(cli_json *json, const char *key, const uint32_t *values, size_t count);

/* NaN, which JSON cannot say, is null; infinities are the texts "inf" and "-inf". */
void cli_json_number(cli_json *json, const char *key, double value);
void cli_json_numbers(cli_json *json, const char *key, const double *values, size_t count);

#endif
