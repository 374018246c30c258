#include "clients/cli/cli.h"

#include <stdarg.h>
#include <stdlib.h>

static const cli_command *running;

void cli_start(const cli_command *command) {
  running = command;
}

const cli_command *cli_running(void) {
  return running;
}

static void write_message(const char *format, va_list arguments) {
  fprintf(stderr, "dipole %s: ", running->name);
  vfprintf(stderr, format, arguments);
  fputc('\n', stderr);
}

void cli_say(const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  write_message(format, arguments);
  va_end(arguments);
}

int cli_fail(const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  write_message(format, arguments);
  va_end(arguments);
  return CLI_FAILED;
}

int cli_fail_usage(const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  write_message(format, arguments);
  va_end(arguments);
  fprintf(stderr, "`dipole %s --help` tells more.\n", running->name);
  return CLI_USAGE;
}

static void *checked(void *block) {
  if (block == NULL) {
    fputs("dipole: out of memory\n", stderr);
    exit(CLI_FAILED);
  }
  return block;
}

void *cli_allocate(size_t count, size_t size_bytes) {
  return checked(calloc(count > 0 ? count : 1, size_bytes));
}

void *cli_resize(void *block, size_t count, size_t size_bytes) {
  return checked(reallocarray(block, count > 0 ? count : 1, size_bytes));
}
