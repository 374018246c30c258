#include "clients/cli/cli.h"

#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "clients/c/error.h"

static const cli_command *running;

void cli_start(const cli_command *command) {
  running = command;
}

const cli_command *cli_running(void) {
  return running;
}

static void *checked(void *block) {
  if (block == NULL) {
    fputs("dipole: out of memory\n", stderr);
    exit(CLI_FAILED);
  }
  return block;
}

int cli_say(enum cli_status status, const char *format, ...) {
  va_list arguments;
  char *text = NULL;
  va_start(arguments, format);
  checked(vasprintf(&text, format, arguments) < 0 ? NULL : text);
  va_end(arguments);
  fprintf(stderr, "dipole %s: ", running->name);
  for (char *rest = text, *line; (line = strsep(&rest, "\n")) != NULL;) {
    libdipole_clean_text(line); /* it may quote a file */
    fprintf(stderr, "%s\n", line);
  }
  free(text);
  if (status == CLI_USAGE) {
    fprintf(stderr, "`dipole %s --help` tells more.\n", running->name);
  }
  return (int)status;
}

enum { COLUMNS_USUAL = 80, ROWS_USUAL = 24 };

/* NO_COLOR counts if it is set to any text but the empty one: https://no-color.org. */
static bool may_be_styled(void) {
  const char *no_color = getenv("NO_COLOR"), *term = getenv("TERM");
  return (no_color == NULL || no_color[0] == '\0') && (term == NULL || strcmp(term, "dumb") != 0);
}

cli_terminal cli_terminal_look(void) {
  struct winsize size = {0};
  cli_terminal terminal = {.columns = COLUMNS_USUAL, .rows = ROWS_USUAL};
  const bool is_terminal = isatty(STDOUT_FILENO) == 1;
  terminal.styled = is_terminal && may_be_styled();
  if (is_terminal && ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0) {
    terminal.columns = size.ws_col > 0 ? size.ws_col : COLUMNS_USUAL;
    terminal.rows = size.ws_row > 0 ? size.ws_row : ROWS_USUAL;
  }
  return terminal;
}

void *cli_allocate(size_t count, size_t size_bytes) {
  return checked(calloc(count > 0 ? count : 1, size_bytes));
}

void *cli_resize(void *block, size_t count, size_t size_bytes) {
  return checked(reallocarray(block, count > 0 ? count : 1, size_bytes));
}
