#include <stdlib.h>

#include "clients/cli/cli.h"

static _Noreturn void give_up(void) {
  fputs("dipole: out of memory\n", stderr);
  exit(CLI_FAILED);
}

void *cli_allocate(size_t count, size_t size_bytes) {
  void *block = calloc(count > 0 ? count : 1, size_bytes);
  if (block == NULL) {
    give_up();
  }
  return block;
}

void *cli_resize(void *block, size_t count, size_t size_bytes) {
  void *resized = reallocarray(block, count > 0 ? count : 1, size_bytes);
  if (resized == NULL) {
    give_up();
  }
  return resized;
}
