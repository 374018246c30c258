/* wire-tables PROTOCOL.md REGISTERS.md: replaces what stands between the markers of these two
 * documents by the byte tables of the wire and the tables of the register map. It makes them from
 * the same lists as the code. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/registers.h"
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

static int rewrite(const char *path,
                   void (*describe)(void (*print)(void *context, const char *text),
                                    void *context)) {
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
  describe(print, file);
  fputs(end, file);
  free(text);
  return fclose(file) == 0 ? EXIT_SUCCESS : fail(path, "cannot be written");
}

int main(int argc, char **argv) {
  if (argc != 3) {
    fprintf(stderr, "usage: wire-tables PROTOCOL.md REGISTERS.md\n");
    return 2;
  }
  const int written = rewrite(argv[1], wire_describe);
  return written == EXIT_SUCCESS ? rewrite(argv[2], registers_describe) : written;
}
