/* wire-tables PROTOCOL.md REGISTERS.md: writes the tables of the wire's structures and statuses into
 * the blocks ```table NAMES of the first document, and those of the register map between the
 * markers of the second. It makes them from the same lists as the code. */
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
    known = wire_describe(begin, print, file) && known;
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
  if (argc != 3) {
    fprintf(stderr, "usage: wire-tables PROTOCOL.md REGISTERS.md\n");
    return 2;
  }
  const int written = rewrite_blocks(argv[1]);
  return written == EXIT_SUCCESS ? rewrite_tables(argv[2]) : written;
}
