/* options: a command's long options, one table for each command, from which the command line is
 * read and --help is made. */
#ifndef DIPOLE_CLI_OPTIONS_H
#define DIPOLE_CLI_OPTIONS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct cli_command;

typedef struct cli_count {
  bool given;
  uint64_t value;
} cli_count;

typedef struct cli_number {
  bool given;
  double value;
} cli_number;

typedef struct cli_numbers {
  size_t count; /* 0: not given */
  double *items;
} cli_numbers;

typedef struct cli_texts {
  size_t count; /* 0: not given */
  char **items;
} cli_texts;

enum cli_option_kind {
  CLI_HEADING, /* no option: a heading for --help */
  CLI_SWITCH,  /* bool */
  CLI_TEXT,    /* const char * */
  CLI_COUNT,   /* cli_count */
  CLI_NUMBER,  /* cli_number */
  CLI_NUMBERS, /* cli_numbers, separated by commas */
  CLI_NAMES,   /* cli_texts, separated by commas */
  CLI_TEXTS,   /* cli_texts, one more each time that the option is given */
  CLI_FILES,   /* likewise; the command's usual file where no value follows */
};

typedef struct cli_option {
  const char *name;     /* without the dashes; NULL: the end of the table */
  const char *argument; /* what --help calls its value; NULL: it has none */
  const char *help;
  enum cli_option_kind kind;
  size_t offset; /* of its value in the command's settings */
} cli_option;

/* The settings of every command start with these. */
typedef struct cli_common {
  const char *connect; /* one or several; NULL: $DIPOLED, else a private daemon */
  const char *format;  /* one of the command's formats */
  cli_count timeout_ms;
  cli_count retry_ms;
} cli_common;

/* Reads the command line into *settings, which starts with a cli_common and is zero at first.
 * False: the command is over, with *status (0 after --help). *operand: NULL when there is none. */
bool cli_options_read(const struct cli_command *command, int argc, char **argv, void *settings,
                      const char **operand, int *status);

/* The command's option for a field of a request, whose name has _ where the option's has -; NULL:
 * none. */
const cli_option *cli_options_find(const struct cli_command *command, const char *field);

/* Frees what the values hold. */
void cli_options_free(const struct cli_command *command, void *settings);

/* Writes what --help says to standard output. */
void cli_options_help(const struct cli_command *command);

#endif
