/* wire-tables PROTOCOL.md REGISTERS.md schema.py: writes the tables of the wire's structures and
 * statuses into the blocks ```table NAMES of the first document, those of the register map between the
 * markers of the second, and the messages, structures and lists for Python into the third. It makes
 * them from the same lists as the code. */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/registers.h"
#include "proto/schema.h"

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

/* Adds a text to a row, behind what is there. */
static void add(char *row, size_t room, const char *before, const char *text) {
  const size_t length = strlen(row);
  snprintf(row + length, room - length, "%s%s", length > 0 ? before : "", text);
}

/* Writes what a field means: its unit, its range, its meaning and, in brackets, its default. */
static void describe_meaning(const schema_field *field, char *text, size_t room) {
  char number[64];
  text[0] = '\0';
  add(text, room, "", field->unit != NULL ? field->unit : "");
  const bool flag = field->least == 0 && field->most == 1; /* its meaning says so */
  if (field->spans && field->list == NULL && field->most > 0 && !flag) {
    if (isinf(field->most)) {
      snprintf(number, sizeof number, ">=%g", field->least);
    } else {
      snprintf(number, sizeof number, "%g to %g", field->least, field->most);
    }
    add(text, room, "; ", number);
  }
  if (field->meaning[0] != '\0') {
    add(text, room, "; ", field->meaning);
  }
  if (field->list != NULL && field->usual > 0 && !field->bits) {
    snprintf(number, sizeof number, "[%s]",
             core_choice_by_id(field->list, (unsigned)field->usual)->name);
    add(text, room, " ", number);
  } else if (field->list == NULL && field->usual > 0) {
    snprintf(number, sizeof number, "[%g]", field->usual);
    add(text, room, " ", number);
  }
}

/* Describes the fields of a structure. The table of `part` describes those with which others begin. */
static void describe_fields(const schema_structure *structure, FILE *file) {
  const schema_field *field = structure->fields;
  size_t offset = 0;
  if (strcmp(field->name, "part") == 0 && structure->bytes > WIRE_BYTES_part) {
    fputs("part@0\n", file);
    for (; offset < WIRE_BYTES_part; field++) {
      offset += schema_field_bytes(field);
    }
  }
  for (; field->name != NULL; offset += schema_field_bytes(field), field++) {
    char type[32], meaning[256];
    if (field->count == 1) {
      snprintf(type, sizeof type, "%s@%zu", schema_kind_name(field->kind), offset);
    } else {
      snprintf(type, sizeof type, "%s[%u]@%zu", schema_kind_name(field->kind), field->count,
               offset);
    }
    describe_meaning(field, meaning, sizeof meaning);
    fprintf(file, meaning[0] == '\0' ? "%-12s %s%s\n" : "%-12s %-22s  %s\n", type, field->name,
            meaning);
  }
}

static const schema_structure *find_structure(const char *name) {
  for (size_t i = 0; i < SCHEMA_STRUCTURES; i++) {
    if (strcmp(schema_structures[i].name, name) == 0) {
      return &schema_structures[i];
    }
  }
  return NULL;
}

/* Writes a table. Returns false if there is neither a structure nor a list of this name. */
static bool describe_one(const char *name, FILE *file) {
  const schema_structure *structure = find_structure(name);
  if (structure != NULL) {
    fprintf(file, "%s (%zu)\n", name, structure->bytes);
    describe_fields(structure, file);
    return true;
  }
  if (strcmp(name, "statuses") != 0) {
    return false;
  }
  fputs("code status         HTTP\n", file);
#define WIRE_STATUS(code, IDENT, modbus_exception, http, text_name, text)                          \
  fprintf(file, "%-4d %-14s %d\n", code, #IDENT, http);
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

/* Lines of Python have at most this many columns. */
enum { COLUMNS = 100 };

/* Writes an item of a text, in the next line if it has no room in this one. */
static void write_item(FILE *file, size_t *column, const char *item) {
  const size_t length = strlen(item);
  if (*column + length + 1 > COLUMNS) {
    fputs("\"\n        \"", file);
    *column = 9;
  }
  fputs(item, file);
  *column += length;
}

static void write_structure(FILE *file, const schema_structure *structure) {
  size_t column = 9;
  fprintf(file, "\n    \"%s\": (\n        \"", structure->name);
  for (const schema_field *field = structure->fields; field->name != NULL; field++) {
    char item[64];
    const char *kind = schema_kind_name(field->kind);
    if (field->count == 1) {
      snprintf(item, sizeof item, "%s %s, ", kind, field->name);
    } else {
      snprintf(item, sizeof item, "%s %s[%u], ", kind, field->name, field->count);
    }
    write_item(file, &column, item);
  }
  fputs("\"\n    ),", file);
}

static void write_number(FILE *file, const schema_number *number) {
  fputs(number->name, file);
  if (number->mask != 0) {
    fprintf(file, "&%u", number->mask);
  }
}

/* Writes a product in brackets, if there is one. */
static void write_product(FILE *file, const schema_number *factors, unsigned times, unsigned more) {
  if (factors[0].name == NULL) {
    return;
  }
  fputc('[', file);
  for (int i = 0; i < SCHEMA_FACTORS && factors[i].name != NULL; i++) {
    fputs(i > 0 ? "*" : "", file);
    write_number(file, &factors[i]);
  }
  fprintf(file, times > 1 ? "*%u" : "", times);
  fprintf(file, more > 0 ? "+%u]" : "]", more);
}

static void write_part(FILE *file, const schema_part *part) {
  fprintf(file, "        \"%s %s",
          part->kind == SCHEMA_LIST ? part->structure->name : schema_kind_name(part->kind),
          part->name);
  write_product(file, part->arrays, 1, 0);
  write_product(file, part->count, part->times, part->more);
  fputs(part->rest ? "[]" : "", file);
  if (part->when.name != NULL) {
    fputs(part->unless ? " unless " : " if ", file);
    write_number(file, &part->when);
    fprintf(file, " is %llu", (unsigned long long)part->is);
  }
  fputs("\",\n", file);
}

static void write_payload(FILE *file, const schema_payload *payload) {
  fprintf(file, "    \"%s\": (\n", payload->name);
  for (int i = 0; i < 2 && payload->structures[i] != NULL; i++) {
    fprintf(file, "        \"%s\",\n", payload->structures[i]->name);
  }
  for (const schema_part *part = payload->parts; part->name != NULL; part++) {
    if (!part->never) {
      write_part(file, part);
    }
  }
  fputs("    ),\n", file);
}

static int write_schema(const char *path) {
  FILE *file = fopen(path, "wb");
  if (file == NULL) {
    return fail(path, "cannot be written");
  }
  fputs(
      "\"\"\"The messages, structures and lists of dipoled's protocol. `make docs` makes this file "
      "from proto/.\"\"\"\n\nMESSAGES = {\n",
      file);
#define WIRE_MESSAGE(type, IDENT, name, ...) fprintf(file, "    \"%s\": %d,\n", name, type);
#include "proto/messages.def"
  fputs("}\n\n# kinds of choices, by their number\nKINDS = {\n", file);
#define WIRE_LIST(kind, IDENT, name, list) fprintf(file, "    %d: \"%s\",\n", kind, name);
#include "proto/messages.def"
  fputs("}\n\nSTATUSES = {\n", file);
#define WIRE_STATUS(code, IDENT, modbus_exception, http, name, text)                               \
  fprintf(file, "    %d: \"%s\",\n", code, name);
#include "proto/statuses.def"
#undef WIRE_STATUS
  fputs("}\n\n# quantities with a value for each radius and channel, in the order of a reply's "
        "arrays\n"
        "ELEMENTWISE = (",
        file);
  for (const core_choice *one = core_quantities; one->name != NULL; one++) {
    if (core_quantity_elementwise(one->id)) {
      fprintf(file, one == core_quantities ? "%u" : ", %u", one->id);
    }
  }
  fputs(")\n\nSTRUCTURES = {", file);
  for (size_t i = 0; i < SCHEMA_STRUCTURES; i++) {
    write_structure(file, &schema_structures[i]);
  }
  fputs("\n}\n\n"
        "# The structures that a payload begins with, and its parts: element, name, number of "
        "arrays, and\n"
        "# of elements in each; wanted&12 is how many of these bits `wanted` has; [] is all that "
        "is left.\n"
        "PAYLOADS = {\n",
        file);
#define WIRE_PAYLOAD(name, ...) write_payload(file, &schema_##name);
#include "proto/messages.def"
  fputs("}\n", file);
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
