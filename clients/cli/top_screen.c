#include "clients/cli/top_screen.h"

#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/cli.h"
#include "clients/cli/terminal.h"
#include "clients/cli/top_write.h"

#define CLEAR "\033[2J"
#define HOME "\033[H"
#define CLEAR_LINE_REST "\033[K"
#define CLEAR_BELOW "\033[J"
#define HIDE_CURSOR "\033[?25l"
#define SHOW_CURSOR "\033[?25h"
#define BOLD "\033[1m"
#define NOT_BOLD "\033[0m"

static volatile sig_atomic_t is_on;

void top_screen_begin(void) {
  if (isatty(STDOUT_FILENO) == 1) {
    is_on = 1;
    fputs(HIDE_CURSOR CLEAR, stdout);
  }
}

bool top_screen_is_on(void) {
  return is_on != 0;
}

void top_screen_restore(void) {
  if (is_on) {
    is_on = 0;
    const ssize_t written = write(STDOUT_FILENO, SHOW_CURSOR, strlen(SHOW_CURSOR));
    (void)written; /* a terminal that is gone needs nothing */
  }
}

/* As much of a text as the terminal has room for, from its upper left corner; the first line is
 * bold. A last line is left for the cursor. */
static void draw(const char *text) {
  const cli_terminal terminal = cli_terminal_look();
  const size_t columns = terminal.columns, rows = terminal.rows > 1 ? terminal.rows - 1 : 1;
  fputs(HOME, stdout);
  for (size_t row = 0; row < rows && *text != '\0'; row++) {
    const size_t length = strcspn(text, "\n");
    const bool bold = row == 0 && terminal.styled;
    printf("%s%.*s%s" CLEAR_LINE_REST "\n", bold ? BOLD : "",
           (int)(length < columns ? length : columns), text, bold ? NOT_BOLD : "");
    text += length + (text[length] == '\n');
  }
  fputs(CLEAR_BELOW, stdout);
}

void top_screen_show(const dipole_info *info, const top_record *record) {
  char *text = NULL;
  size_t bytes = 0;
  FILE *file = open_memstream(&text, &bytes);
  if (file != NULL) {
    top_write_table(info, record, file);
    if (fclose(file) == 0) {
      draw(text);
    }
    free(text);
  }
}
