#include "clients/cli/cli.h"

#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
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
    libdipole_clean_text(line); /* a message may quote a file */
    fprintf(stderr, "%s\n", line);
  }
  free(text);
  if (status == CLI_USAGE) {
    fprintf(stderr, "`dipole %s --help` says more.\n", running->name);
  }
  return (int)status;
}

bool cli_ends_with(const char *text, const char *ending) {
  const size_t length = strlen(text), end = strlen(ending);
  return length > end && strcmp(text + length - end, ending) == 0;
}

enum { COLUMNS_USUAL = 80, ROWS_USUAL = 24 };

cli_terminal cli_terminal_look(void) {
  struct winsize size = {0};
  cli_terminal terminal = {.columns = COLUMNS_USUAL, .rows = ROWS_USUAL};
  const bool is_terminal = isatty(STDOUT_FILENO) == 1;
  /* NO_COLOR counts if it is set to any text but the empty one: https://no-color.org. */
  const char *no_color = getenv("NO_COLOR"), *term = getenv("TERM");
  terminal.styled = is_terminal && (no_color == NULL || no_color[0] == '\0') &&
                    (term == NULL || strcmp(term, "dumb") != 0);
  if (is_terminal && ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0) {
    terminal.columns = size.ws_col > 0 ? size.ws_col : COLUMNS_USUAL;
    terminal.rows = size.ws_row > 0 ? size.ws_row : ROWS_USUAL;
  }
  return terminal;
}

/* A header before each block of memory. The headers are a ring, so that all blocks can be freed. */
typedef struct chain {
  _Alignas(max_align_t) struct chain *next;
  struct chain *before;
} chain;

static chain ring = {&ring, &ring};

static void unlink_block(chain *one) {
  one->next->before = one->before;
  one->before->next = one->next;
}

static void *link_block(chain *one) {
  *one = (chain){ring.next, &ring};
  one->next->before = one->before->next = one;
  return one + 1;
}

/* Returns the size of a block and its header; SIZE_MAX if it is too large. */
static size_t size_of(size_t count, size_t size_bytes) {
  size_t bytes;
  return __builtin_mul_overflow(count, size_bytes, &bytes) || bytes > SIZE_MAX / 2
             ? SIZE_MAX / 2
             : sizeof(chain) + bytes;
}

void *cli_allocate(size_t count, size_t size_bytes) {
  return link_block(checked(calloc(1, size_of(count, size_bytes))));
}

void *cli_resize(void *block, size_t count, size_t size_bytes) {
  chain *one = block != NULL ? (chain *)block - 1 : NULL;
  if (one != NULL) {
    unlink_block(one);
  }
  return link_block(checked(realloc(one, size_of(count, size_bytes))));
}

bool cli_file_end(FILE *file, const char *path, bool written) {
  struct stat kind;
  const bool removes = file != stdout && fstat(fileno(file), &kind) == 0 && S_ISREG(kind.st_mode);
  written = written && fflush(file) == 0;
  written = (file == stdout || fclose(file) == 0) && written;
  if (!written && removes) {
    unlink(path);
  }
  return written;
}

char *cli_copy(const char *text, size_t length) {
  return memcpy(cli_allocate(length + 1, 1), text, length);
}

void cli_free(void *block) {
  if (block != NULL) {
    unlink_block((chain *)block - 1);
    free((chain *)block - 1);
  }
}

void cli_free_all(void) {
  while (ring.next != &ring) {
    cli_free(ring.next + 1);
  }
}
