/* terminal: what there is to know of the terminal that standard output is. */
#ifndef DIPOLE_CLI_TERMINAL_H
#define DIPOLE_CLI_TERMINAL_H

#include <stdbool.h>
#include <stddef.h>

typedef struct cli_terminal {
  bool is_one; /* standard output is a terminal */
  bool styled; /* and may get colours and bold type: NO_COLOR is not set, and TERM is not dumb */
  size_t columns, rows; /* 80 and 24 where it does not say, or is none */
} cli_terminal;

/* As it is now: a person may change the size. */
cli_terminal cli_terminal_look(void);

#endif
