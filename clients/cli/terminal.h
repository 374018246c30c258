/* terminal: what is known of the terminal that standard output is. */
#ifndef DIPOLE_CLI_TERMINAL_H
#define DIPOLE_CLI_TERMINAL_H

#include <stdbool.h>
#include <stddef.h>

typedef struct cli_terminal {
  bool styled; /* standard output is a terminal that may get colours and bold type: NO_COLOR is not
                  set, and TERM is not dumb */
  size_t columns, rows; /* 80 and 24 if standard output does not say, or is no terminal */
} cli_terminal;

/* Returns the terminal as it is now: the user may change its size. */
cli_terminal cli_terminal_look(void);

#endif
