/* eval: values of models at radii, as `dipole eval`, `plot` and `sample` request them and write
 * them. */
#ifndef DIPOLE_CLI_EVAL_H
#define DIPOLE_CLI_EVAL_H

#include "clients/cli/profile.h"

/* ---- replies ----------------------------------------------------------------------- */

/* The values of one model and channel. Single precision values are held as the doubles that they
 * equal. */
typedef struct cli_eval_values {
  double albedo;                             /* NaN if it is not wanted */
  dipole_errors errors;                      /* the largest of all quantities */
  dipole_errors of_each[CLI_QUANTITIES_MAX]; /* of each of the report's quantities */
  double *arrays[CLI_QUANTITIES_MAX]; /* [place_count] for each of the report's quantities; NULL for
                                         the albedo */
} cli_eval_values;

typedef struct cli_eval_model {
  const dipole_choice *choice; /* NULL until the daemon has chosen it */
  const dipole_choice *evaluator;
  bool named; /* on the command line, and not only as one of all: its refusal is a failure */
  bool
      is_reference; /* of the others: it is requested without the parameters that it does not take */
  unsigned notes;   /* ids of the daemon's notes */
} cli_eval_model;

typedef struct cli_eval_report {
  cli_profile profile; /* each model takes what it can of the parameters */
  cli_quantities quantities;
  size_t model_count; /* how many models replied */
  cli_eval_model *models;
  bool chosen;               /* the daemon has chosen the model */
  const char *place;         /* where values are: "r", "f" or, of drawn radii, "u" */
  size_t place_count;        /* 0 if there is only the albedo */
  double *places;            /* [place_count] as the daemon used them: mm, 1/mm or a number */
  double least, most;        /* of the finite places, while the report is written */
  bool diverges;             /* transport does at r = 0, which the model errors leave out */
  cli_eval_values *values;   /* [model_count * channel_count], model by model */
  const dipole_choice *draw; /* of drawn radii; else NULL */
  uint64_t seed, first;      /* of drawn radii */
} cli_eval_report;

/* Adds a model, or notes that it is named if it is there already. Returns what the report has of
 * it, until the next call. */
cli_eval_model *cli_eval_add_model(cli_eval_report *report, const dipole_choice *model, bool named);

/* Makes room for the values of all models and channels, which have no arrays yet. */
void cli_eval_make_values(cli_eval_report *report);

/* ---- requests ---------------------------------------------------------------------------------- */

/* The options of an evaluation. */
extern const cli_option cli_eval_options[];

/* The option --f. */
#define CLI_EVAL_F_OPTION                                                                          \
  CLI_OPTION(NUMBERS, f, NULL,                                                                     \
             "in place of radii: these spatial frequencies of striped light, 1/mm, for R_f")

/* Checks everything that can be checked without a daemon. Returns an exit status. */
int cli_eval_check(cli_settings *settings);

/* Fills a zeroed report by requests to a daemon. Of all models, those are left out that refuse the
 * query, with a line each on standard error. Says what is wrong and returns an exit status. */
int cli_eval_ask(const cli_settings *settings, dipole_client *client, cli_eval_report *report);

/* Fills a zeroed report from the file of tables, without a daemon. */
int cli_eval_table(const cli_settings *settings, cli_eval_report *report, dipole_info **info);

/* Sets the radii of a query to those that are requested, in single or double precision; to none if
 * no quantity has a value for each radius. */
void cli_eval_set_radii(const cli_settings *settings, const cli_eval_report *report, bool single,
                        dipole_query *query);

/* Looks up the quantities, R and the albedo by default, and sets where values are. Says what is
 * wrong and returns false if that fails. */
bool cli_eval_take_quantities(const cli_settings *settings, cli_eval_report *report);

/* ---- drawing, in plot.c ---------------------------------------------------------------------- */

/* Draws R over r, which is one of the report's quantities, into the files; on a logarithmic axis if
 * the ratios between radii are equal. Says what is wrong and returns an exit status. */
int cli_plot_R(const cli_eval_report *report, const cli_texts *paths);

#endif
