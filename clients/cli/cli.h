/* cli: what every file of the command `dipole` needs: how a command is described, what options
 * hold, how to fail, and memory. */
#ifndef DIPOLE_CLI_H
#define DIPOLE_CLI_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <time.h>

#include "clients/c/dipole.h"
#include "core/core.h"

enum cli_status { CLI_OK = 0, CLI_FAILED = 1, CLI_USAGE = 2, CLI_BAD_ROWS = 3 };

/* ---- options --------------------------------------------------------------------------------- */

typedef struct cli_count {
  bool given;
  uint64_t value;
} cli_count;

typedef struct cli_number {
  bool given;
  double value;
} cli_number;

/* The value of an option that is a parameter of core/choices.def. */
typedef struct cli_given {
  const char *text; /* the value as given; NULL: the option is not given */
  double value;     /* the value of a parameter that is a number */
} cli_given;

typedef struct cli_numbers {
  size_t count; /* number of items; 0: the option is not given */
  double *items;
} cli_numbers;

typedef struct cli_texts {
  size_t count; /* number of texts; 0: the option is not given */
  char **items;
  const char *whole; /* the names as given, separated by commas */
} cli_texts;

enum cli_option_kind {
  CLI_HEADING,   /* a heading of --help, and no option */
  CLI_SWITCH,    /* bool */
  CLI_TEXT,      /* const char * */
  CLI_FILE,      /* the same */
  CLI_COUNT,     /* cli_count */
  CLI_COUNT32,   /* cli_count, up to UINT32_MAX */
  CLI_NUMBER,    /* cli_number */
  CLI_ONE,       /* cli_numbers with one number */
  CLI_NUMBERS,   /* cli_numbers, separated by commas */
  CLI_NAME,      /* cli_texts with one name */
  CLI_NAMES,     /* cli_texts, separated by commas */
  CLI_FILES,     /* cli_texts: each use of the option adds one */
  CLI_PARAMETER, /* cli_given */
};

typedef struct cli_option {
  /* the member of cli_settings, with _ replaced by - on the command line; NULL ends a list */
  const char *name;
  const char *help; /* of any length; --help breaks it into lines */
  enum cli_option_kind kind;
  size_t offset;        /* offset of its value in cli_settings */
  const char *usual;    /* the default, which --help shows; NULL: none */
  const char *argument; /* placeholder for its value in --help; NULL: the usual one of its kind */
} cli_option;

/* Entries of a list of options. */
#define CLI_TITLE(heading)                                                                         \
  { heading, NULL, CLI_HEADING, 0, NULL, NULL }
#define CLI_OPTION(kind, member, usual, help)                                                      \
  { #member, help, CLI_##kind, offsetof(cli_settings, member), usual, NULL }

/* What --format can say. CLI_NONE: the command writes no values, but for example a picture. */
enum cli_form { CLI_NONE, CLI_TABLE, CLI_CSV, CLI_JSON };

/* What the options of all commands say. A command has options only for the members that it uses. */
typedef struct cli_settings {
  const char *connect; /* one address or several; NULL for $DIPOLED or else a private daemon */
  bool is_service;     /* whether the daemon is the installed service, without being named */
  const char *ca, *certificate, *key; /* files for tls: addresses; NULL if they are not given */
  const char *format;                 /* what --format says; NULL if it is not given */
  enum cli_form form;                 /* what --format means, also if it is not given */
  cli_count timeout_ms, retry_ms, deadline_ms;
  const char *operand, *second_operand;      /* NULL if they are not given */
  cli_given parameters[CORE_PARAMETERS_END]; /* those that the command takes, by their ids */
  cli_texts medium, channel;
  cli_numbers sigma_a, sigma_s, g, eta, thickness;
  cli_texts layer;
  cli_texts tissue, wavelengths, unknown;
  cli_numbers scatter;
  const char *haemoglobin;
  cli_texts model;
  const char *moments, *evaluator;
  cli_numbers albedo, mean_free_path, diffuse_mean_free_path, classical_diffuse_path,
      extinction_path;
  cli_numbers r, f, u;
  cli_number from, to;
  cli_count count, rings, seed, first;
  bool log;
  cli_texts wanted, plot;
  const char *output;      /* a file of tables, or of maps */
  const char *mci;         /* an input file of MCML */
  const char *not_for_mci; /* an option that was given, which means nothing beside --mci */
  bool errors, deviation;
  const char *quantity, *axes, *draw, *scale, *light;
  cli_numbers reference;
  bool specular, linear, srgb, typed;
  const char *source, *target, *unit; /* names of conventions, and of the unit of a scene */
  cli_numbers colour, length, range;
  cli_count taps, size;
  bool common;
  cli_texts coefficients;
  cli_number tolerance;
  cli_number photons, error, total_error;
  cli_number seconds;
  cli_count connections, in_flight, radii, large_radii;
} cli_settings;

/* ---- commands -------------------------------------------------------------------------------- */

enum { CLI_LISTS_MAX = 6 };

typedef struct cli_command {
  const char *name;
  const char *operand; /* name of the operand in --help; NULL if the command takes none */
  /* name of an optional second operand; NULL if the command takes none */
  const char *second_operand;
  const char *about;    /* one line */
  const char *more;     /* paragraphs for --help, with \n between them; NULL if there are none */
  const char *examples; /* example command lines; the text ends with a newline */
  const char *formats;  /* the values of --format, separated by commas; the first is the default */
  const cli_option *options[CLI_LISTS_MAX]; /* lists of its options, in the order of --help */
  unsigned parameters; /* bit 1 << id for each parameter that it takes, which --help lists */

  /* Checks and completes the settings before any request. NULL if there is nothing to
   * check. Returns an exit status; the command continues if that is CLI_OK. */
  int (*check)(cli_settings *settings);

  /* Without --connect and $DIPOLED, the command uses the installed service if it runs. */
  bool shows_service;

  /* Returns whether the command needs no daemon. NULL if it always needs one. */
  bool (*is_local)(const cli_settings *settings);

  /* Does the work and returns an exit status. client: NULL if is_local() said so. */
  int (*run)(const cli_settings *settings, dipole_client *client);
} cli_command;

/* All commands, in the order of help; NULL ends the list. */
extern const cli_command *const cli_commands[];

/* Remembers which command runs, for the messages below. Call this first, once. */
void cli_start(const cli_command *command);
const cli_command *cli_running(void);

/* ---- failing --------------------------------------------------------------------------------- */

/* Writes "dipole COMMAND: " and the message to standard error, and after CLI_USAGE a hint at
 * --help. Returns the status. */
int cli_say(enum cli_status status, const char *format, ...) __attribute__((format(printf, 2, 3)));

#define cli_fail(...) cli_say(CLI_FAILED, __VA_ARGS__)
#define cli_fail_usage(...) cli_say(CLI_USAGE, __VA_ARGS__) /* the command line is wrong */

/* The same, for functions that return whether they have succeeded: these return false. */
#define cli_fails(...) (cli_fail(__VA_ARGS__) == CLI_OK)
#define cli_fails_usage(...) (cli_fail_usage(__VA_ARGS__) == CLI_OK)

/* Returns whether a text ends with another, which is shorter. */
bool cli_ends_with(const char *text, const char *ending);

/* ---- the terminal that standard output is ---------------------------------------------------- */

typedef struct cli_terminal {
  bool styled; /* standard output is a terminal that may get colours and bold type: NO_COLOR is not
                  set, and TERM is not dumb */
  size_t columns, rows; /* 80 and 24 if standard output does not say, or is no terminal */
} cli_terminal;

/* Returns the terminal as it is now: the user may change its size. */
cli_terminal cli_terminal_look(void);

/* ---- time ------------------------------------------------------------------------------------ */

/* These return the time since some moment in the past. */
static inline uint64_t cli_now_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (uint64_t)now.tv_sec * 1000000000 + (uint64_t)now.tv_nsec;
}

static inline int64_t cli_now_ms(void) {
  return (int64_t)(cli_now_ns() / 1000000);
}

/* Returns the larger number, or NaN if either is NaN. */
static inline double cli_larger(double a, double b) {
  return a != a || a > b ? a : b;
}

/* ---- memory: all of it is freed when the command has ended ----------------------------------- */

/* Ends a file or standard output whose writing has succeeded so far or not. A file that is not whole is
 * removed. Returns whether it is whole; else errno says why not. */
bool cli_file_end(FILE *file, const char *path, bool written);

/* These functions end the program when no memory is left. Blocks need not be freed, but those of
 * work that may go on for long are. */
void *cli_allocate(size_t count, size_t size_bytes);            /* zeroed */
void *cli_resize(void *block, size_t count, size_t size_bytes); /* block may be NULL */
char *cli_copy(const char *text, size_t length);
void cli_free(void *block);
void cli_free_all(void);

#endif
