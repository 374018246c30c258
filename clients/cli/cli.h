/* cli: what the commands of `dipole` share. */
#ifndef DIPOLE_CLI_H
#define DIPOLE_CLI_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include "clients/c/dipole.h"
#include "clients/cli/options.h"

enum cli_status { CLI_OK = 0, CLI_FAILED = 1, CLI_USAGE = 2, CLI_BAD_ROWS = 3 };

typedef struct cli_command {
  const char *name;
  const char *operand;  /* what --help calls it; NULL: the command takes none */
  const char *about;    /* one line */
  const char *more;     /* what else --help says; ends with a newline, or NULL */
  const char *examples; /* lines; ends with a newline */
  const char *formats;  /* the values of --format, separated by commas; the first is the default */
  const cli_option *options; /* its own, beside those of all commands; ends with an empty one */
  const cli_option *shared_options; /* likewise, of some commands; NULL: none */
  const char *usual_file;           /* for options of kind CLI_FILES */
  int (*run)(const struct cli_command *command, int argc, char **argv); /* an exit status */
} cli_command;

/* Every command; ends with an empty one. */
extern const cli_command *const cli_commands[];

extern const cli_command cli_command_eval;
extern const cli_command cli_command_plot;
extern const cli_command cli_command_points;
extern const cli_command cli_command_sample;
extern const cli_command cli_command_invert;
extern const cli_command cli_command_table;
extern const cli_command cli_command_mc;
extern const cli_command cli_command_media;
extern const cli_command cli_command_info;
extern const cli_command cli_command_top;
extern const cli_command cli_command_bench;

/* Says on standard error what is wrong, after "dipole COMMAND: ". Returns CLI_FAILED. */
int cli_fail(const cli_command *command, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* The same for a wrong command line, with a hint at --help. Returns CLI_USAGE. */
int cli_fail_usage(const cli_command *command, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* ---- memory.c: there is nothing that a command could do without it, so these never fail ---- */

void *cli_allocate(size_t count, size_t size_bytes); /* zeroed */
void *cli_resize(void *block, size_t count, size_t size_bytes);

/* ---- daemon.c ------------------------------------------------------------------------------ */

/* What --timeout-ms and --retry-ms say. */
void cli_connection_options(const cli_common *common, dipole_options *options);

/* Connects as --connect, --timeout-ms and --retry-ms say; says why when it cannot. */
bool cli_open(const cli_command *command, const cli_common *common, dipole_client **client);

/* A command without options of its own: reads the common ones, connects, and shows what it has to
 * show in a format (NULL: the default). An exit status. */
int cli_run_plain(const cli_command *command, int argc, char **argv,
                  int (*show)(const cli_command *command, const char *format,
                              dipole_client *client));

/* Whether a daemon that has been busy since start_ms is to be asked once more. */
bool cli_is_patient(const cli_common *common, int64_t start_ms);

/* dipole_eval_parts(), asked again for as long as the daemon is busy, within bounds: the parts may then come again from the first on. */
bool cli_eval_parts(dipole_client *client, const cli_common *common, const dipole_query *query,
                    bool (*part)(void *context, const dipole_result *part, uint64_t radius_first),
                    void *context, dipole_error *error);

/* Likewise dipole_offers() and dipole_table_fetch(). */
bool cli_offers(dipole_client *client, const cli_common *common, const dipole_query *query,
                dipole_offer **offers, size_t *count, size_t *taken, dipole_error *error);
bool cli_table_fetch(dipole_client *client, const cli_common *common,
                     const dipole_table_query *query, dipole_table **table, dipole_error *error);

/* Likewise dipole_sample() and dipole_invert(). */
bool cli_sample(dipole_client *client, const cli_common *common, const dipole_sample_query *query,
                dipole_result **result, dipole_error *error);
bool cli_invert(dipole_client *client, const cli_common *common, const dipole_invert_query *query,
                dipole_inversion **inversion, dipole_error *error);

/* Waits as long as a busy daemon asks for, within reason. */
void cli_nap(const dipole_error *busy);

/* Milliseconds since some moment in the past. */
int64_t cli_now_ms(void);

/* ---- names.c ------------------------------------------------------------------------------- */

/* The first choice of a kind for which *from <= its position; *from then follows it. NULL: none. */
const dipole_choice *cli_next_choice(const dipole_info *info, enum dipole_kind kind, size_t *from);

/* The choice of a kind with this name; NULL: none. */
const dipole_choice *cli_choice(const dipole_info *info, enum dipole_kind kind, const char *name);

/* The choice of a kind with this id; NULL: none. */
const dipole_choice *cli_choice_of_id(const dipole_info *info, enum dipole_kind kind, unsigned id);

/* Whether the sum of notes holds one of the daemon's. */
bool cli_is_noted(unsigned notes, const dipole_choice *note);

/* " (--sigma-a)": the option that a field of a request is given by; "" when there is none. */
const char *cli_option_of(const cli_command *command, const char *field, char *text, size_t bytes);

/* The same, saying which names there are when it is none of them. */
const dipole_choice *cli_named(const cli_command *command, const dipole_info *info,
                               enum dipole_kind kind, const char *option, const char *name);

/* "classical, better": all names of a kind, or ", ..." instead of those that do not fit. */
void cli_list_names(const dipole_info *info, enum dipole_kind kind, char *text, size_t bytes);

#endif
