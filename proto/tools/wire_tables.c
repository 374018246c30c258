/* wire-tables PROTOCOL.md REGISTERS.md schema.py: writes the tables of the wire's structures and
 * statuses into the blocks ```table NAMES of the first document, those of the register map between the
 * markers of the second, and the messages, structures and lists for Python into the third. It makes
 * them from the same lists as the code. */
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/registers.h"
#include "proto/wire.h"

#define BEGIN "<!-- tables: begin -->\n"
#define END "<!-- tables: end -->\n"
#define BLOCK "\n```table "

static char *read_file(const char *path) {
  FILE *file = fopen(path, "rb");
  if (file == NULL) {
    return NULL;
  }
  char *text = NULL;
  if (fseek(file, 0, SEEK_END) == 0) {
    const long bytes = ftell(file);
    rewind(file);
    text = bytes >= 0 ? malloc((size_t)bytes + 1) : NULL;
    if (text != NULL) {
      text[fread(text, 1, (size_t)bytes, file)] = '\0';
    }
  }
  fclose(file);
  return text;
}

static void print(void *context, const char *text) {
  fputs(text, context);
}

static int fail(const char *path, const char *what) {
  fprintf(stderr, "wire-tables: %s: %s\n", path, what);
  return EXIT_FAILURE;
}

/* ---- of structures --------------------------------------------------------------------------- */

struct description {
  FILE *file;
  const char *structure;
  bool in_part;
  size_t offset_bytes;
};

static void describe_field(struct description *to, const char *kind, const char *field,
                           size_t count, size_t size_bytes, const char *meaning) {
  char type[32];
  char row[256];
  /* The table of `part` describes the fields with which others begin. */
  const bool has_part = strcmp(to->structure, "part") != 0;
  const bool begins = has_part && to->offset_bytes == 0 && strcmp(field, "part") == 0;
  to->in_part = begins || (to->in_part && to->offset_bytes < WIRE_BYTES_part);
  if (to->in_part) {
    fputs(begins ? "part@0\n" : "", to->file);
    to->offset_bytes += size_bytes;
    return;
  }
  if (count == 1) {
    snprintf(type, sizeof type, "%s@%zu", kind, to->offset_bytes);
  } else {
    snprintf(type, sizeof type, "%s[%zu]@%zu", kind, count, to->offset_bytes);
  }
  const bool alone = meaning[0] == '\0';
  snprintf(row, sizeof row, alone ? "%-12s %s%s\n" : "%-12s %-22s  %s\n", type, field, meaning);
  fputs(row, to->file);
  to->offset_bytes += count * size_bytes;
}

#define DESCRIBE_ONE(kind, field, meaning)                                                         \
  describe_field(&to, #kind, #field, 1, WIRE_SIZE_##kind, meaning);
#define DESCRIBE_ARRAY(kind, field, count, meaning)                                                \
  describe_field(&to, #kind, #field, count, WIRE_SIZE_##kind, meaning);
#define DESCRIBE_TEXT(field, bytes, meaning) describe_field(&to, "text", #field, bytes, 1, meaning);

static void describe_status(struct description *to, int code, const char *ident, int http) {
  fprintf(to->file, "%-4d %-14s %d\n", code, ident, http);
}

/* Writes a table. Returns false if there is neither a structure nor a list of this name. */
static bool describe_one(const char *name, FILE *file) {
  struct description to = {.file = file, .structure = name};
#define WIRE_STRUCTURE(structure)                                                                  \
  if (strcmp(name, #structure) == 0) {                                                             \
    fprintf(file, "%s (%d)\n", name, WIRE_BYTES_##structure);                                      \
    WIRE_FIELDS_##structure(DESCRIBE_ONE, DESCRIBE_ARRAY, DESCRIBE_TEXT) return true;              \
  }
#include "proto/messages.def"
  if (strcmp(name, "statuses") != 0) {
    return false;
  }
  fputs("code status         HTTP\n", file);
#define WIRE_STATUS(code, IDENT, modbus_exception, http, text_name, text)                          \
  describe_status(&to, code, #IDENT, http);
#include "proto/statuses.def"
#undef WIRE_STATUS
  return true;
}

/* Writes the tables of all names, with blank lines between. */
static bool describe_tables(const char *names, FILE *file) {
  char name[32];
  int length;
  for (const char *at = names; sscanf(at, "%31s%n", name, &length) == 1; at += length) {
    if (at != names) {
      fputs("\n", file);
    }
    if (!describe_one(name, file)) {
      return false;
    }
  }
  return true;
}

/* ---- of the Python client -------------------------------------------------------------------- */

/* Lines of Python have at most so many columns. */
enum { COLUMNS = 100 };

static void write_field(FILE *file, size_t *column, const char *kind, const char *field,
                        int count) {
  char text[64];
  const int bytes = count == 1 ? snprintf(text, sizeof text, "%s %s, ", kind, field)
                               : snprintf(text, sizeof text, "%s %s[%d], ", kind, field, count);
  if (*column + (size_t)bytes + 1 > COLUMNS) {
    fputs("\"\n        \"", file);
    *column = 9;
  }
  *column += (size_t)fprintf(file, "%s", text);
}

#define WRITE_ONE(kind, field, meaning) write_field(file, &column, #kind, #field, 1);
#define WRITE_ARRAY(kind, field, count, meaning) write_field(file, &column, #kind, #field, count);
#define WRITE_TEXT(field, bytes, meaning) write_field(file, &column, "text", #field, bytes);

static int write_schema(const char *path) {
  FILE *file = fopen(path, "wb");
  if (file == NULL) {
    return fail(path, "cannot be written");
  }
  fputs(
      "\"\"\"The messages, structures and lists of dipoled's protocol. `make docs` makes this file "
      "from proto/.\"\"\"\n\nMESSAGES = {\n",
      file);
#define WIRE_MESSAGE(type, IDENT, name) fprintf(file, "    \"%s\": %d,\n", name, type);
#include "proto/messages.def"
  fputs("}\n\n# kinds of choices, by their number\nKINDS = {\n", file);
#define WIRE_LIST(kind, IDENT, name, list) fprintf(file, "    %d: \"%s\",\n", kind, name);
#include "proto/messages.def"
  fputs("}\n\nSTATUSES = {\n", file);
#define WIRE_STATUS(code, IDENT, modbus_exception, http, name, text)                               \
  fprintf(file, "    %d: \"%s\",\n", code, name);
#include "proto/statuses.def"
#undef WIRE_STATUS
  fputs("}\n\nSTRUCTURES = {", file);
#define WIRE_STRUCTURE(structure)                                                                  \
  {                                                                                                \
    size_t column = 9;                                                                             \
    fputs("\n    \"" #structure "\": (\n        \"", file);                                        \
    WIRE_FIELDS_##structure(WRITE_ONE, WRITE_ARRAY, WRITE_TEXT) fputs("\"\n    ),", file);         \
  }
#include "proto/messages.def"
  fputs("\n}\n", file);
  return fclose(file) == 0 ? EXIT_SUCCESS : fail(path, "cannot be written");
}

/* ---- of the documents ------------------------------------------------------------------------ */

/* Replaces the lines of each block that begins with ```table NAMES. */
static int rewrite_blocks(const char *path) {
  char *text = read_file(path);
  FILE *file = text != NULL ? fopen(path, "wb") : NULL;
  if (file == NULL) {
    free(text);
    return fail(path, "cannot be read and written");
  }
  const char *rest = text;
  bool known = true;
  for (char *begin; (begin = strstr(rest, BLOCK)) != NULL;) {
    begin += strlen(BLOCK);
    char *lines = begin + strcspn(begin, "\n");
    char *end = strstr(lines, "\n```");
    if (end == NULL) {
      break;
    }
    fprintf(file, "%.*s\n", (int)(lines - rest), rest);
    *lines = '\0';
    known = describe_tables(begin, file) && known;
    rest = end + 1;
  }
  fputs(rest, file);
  free(text);
  if (fclose(file) != 0) {
    return fail(path, "cannot be written");
  }
  return known ? EXIT_SUCCESS : fail(path, "has a table of no structure");
}

static int rewrite_tables(const char *path) {
  char *text = read_file(path);
  if (text == NULL) {
    return fail(path, "cannot be read");
  }
  char *begin = strstr(text, BEGIN);
  char *end = begin != NULL ? strstr(begin, END) : NULL;
  if (end == NULL) {
    free(text);
    return fail(path, "has no markers for the tables");
  }
  FILE *file = fopen(path, "wb");
  if (file == NULL) {
    free(text);
    return fail(path, "cannot be written");
  }
  fwrite(text, 1, (size_t)(begin - text) + strlen(BEGIN), file);
  registers_describe(print, file);
  fputs(end, file);
  free(text);
  return fclose(file) == 0 ? EXIT_SUCCESS : fail(path, "cannot be written");
}

int main(int argc, char **argv) {
  if (argc != 4) {
    fprintf(stderr, "usage: wire-tables PROTOCOL.md REGISTERS.md schema.py\n");
    return 2;
  }
  const bool bad = rewrite_blocks(argv[1]) != EXIT_SUCCESS ||
                   rewrite_tables(argv[2]) != EXIT_SUCCESS || write_schema(argv[3]) != EXIT_SUCCESS;
  return bad ? EXIT_FAILURE : EXIT_SUCCESS;
}
