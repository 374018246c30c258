/* eval: how `dipole eval` and `dipole plot` ask, and how `dipole eval` writes. */
#ifndef DIPOLE_CLI_EVAL_H
#define DIPOLE_CLI_EVAL_H

#include "clients/cli/eval_report.h"

typedef struct cli_eval_settings {
  cli_profile_settings profile; /* `model` is not used */
  const char *table;            /* the file of tables to evaluate; NULL to ask a daemon */
  cli_texts model;
  const char *reference; /* a model that is asked too, with what it takes of the parameters */
  cli_numbers r, f;
  bool at_f; /* f is given, and r is not */
  cli_number from, to;
  cli_count count;
  bool logarithmic;
  cli_texts wanted;
  cli_texts plot;
} cli_eval_settings;

/* The options of an evaluation, for settings that start with a cli_eval_settings. */
extern const cli_option cli_eval_options[];

/* The option --f. at: where the numbers lie. */
#define CLI_EVAL_F_OPTION(at)                                                                      \
  {                                                                                                \
    "f", "X[,X...]",                                                                               \
        "in place of radii: these spatial frequencies of striped light, 1/mm, for R_f",            \
        CLI_NUMBERS, at, NULL                                                                      \
  }

/* Checks everything that can be checked without a daemon, and sets at_f. Returns an exit status. */
int cli_eval_check(cli_eval_settings *settings);

/* Fills a zeroed report by asking a daemon. Of all models, those are left out that refuse the
 * query, with a line each on standard error. Says what is wrong and returns an exit status; free
 * the report in any case. */
int cli_eval_ask(const cli_eval_settings *settings, dipole_client *client, cli_eval_report *report);

/* Fills a zeroed report from the file of tables, without a daemon. The report refers to *info, so
 * free the report first. */
int cli_eval_table(const cli_eval_settings *settings, cli_eval_report *report, dipole_info **info);

/* The radii of one query. */
typedef struct cli_eval_radii {
  unsigned spacing;
  uint64_t count;
  double start_mm, stop_mm;
  const double *f64; /* a list in either precision; NULL if there is none */
  float *f32;        /* to be freed */
} cli_eval_radii;

/* Returns the radii that are asked for. The list is empty if no quantity has a value for each
 * radius. */
cli_eval_radii cli_eval_make_radii(const cli_eval_settings *settings,
                                   const cli_eval_report *report);

/* Writes the report to standard output; nothing for CLI_NONE. */
void cli_eval_write(const cli_eval_report *report, enum cli_form form);

#endif
