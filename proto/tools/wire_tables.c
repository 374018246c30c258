/* wire-tables FILE: writes the byte tables of the wire between the markers of PROTOCOL.md, so that
 * the document is made from the list that the code is made from. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/wire.h"

#define BEGIN "<!-- tables: begin -->\n"
#define END "<!-- tables: end -->\n"

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

int main(int argc, char **argv) {
  if (argc != 2) {
    fprintf(stderr, "usage: wire-tables PROTOCOL.md\n");
    return 2;
  }
  char *text = read_file(argv[1]);
  if (text == NULL) {
    return fail(argv[1], "cannot be read");
  }
  char *begin = strstr(text, BEGIN);
  char *end = begin != NULL ? strstr(begin, END) : NULL;
  if (end == NULL) {
    free(text);
    return fail(argv[1], "has no markers for the tables");
  }
  FILE *file = fopen(argv[1], "wb");
  if (file == NULL) {
    free(text);
    return fail(argv[1], "cannot be written");
  }
  fwrite(text, 1, (size_t)(begin - text) + strlen(BEGIN), file);
  wire_describe(print, file);
  fputs(end, file);
  free(text);
  return fclose(file) == 0 ? EXIT_SUCCESS : fail(argv[1], "cannot be written");
}
