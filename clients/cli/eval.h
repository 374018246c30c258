/* eval: values of models at radii, as `dipole eval`, `plot` and `sample` request and write them. */
#ifndef DIPOLE_CLI_EVAL_H
#define DIPOLE_CLI_EVAL_H

#include "clients/cli/profile.h"

/* The quantities without radii. */
#define CLI_OF_CHANNEL (unsigned)(DIPOLE_ALBEDO | DIPOLE_BALANCE)

/* ---- replies ----------------------------------------------------------------------- */

/* The values of one model and channel. Those of single precision are doubles that equal them. */
typedef struct cli_eval_values {
  double albedo;                             /* albedo of the medium; NaN if it is not wanted */
  dipole_balance balance;                    /* zeros if it is not wanted */
  dipole_errors errors;                      /* the largest errors of all quantities */
  dipole_errors of_each[CLI_QUANTITIES_MAX]; /* the errors of each of the report's quantities */
  double *arrays[CLI_QUANTITIES_MAX]; /* [place_count] for each of the report's quantities; NULL for
                                         those of CLI_OF_CHANNEL */
} cli_eval_values;

typedef struct cli_eval_model {
  const dipole_choice *choice; /* the model; NULL until the daemon has chosen it */
  const dipole_choice *evaluator;
  bool named; /* named on the command line, not only by `all`: its refusal is a failure */
  bool
      /* only a reference for the others: requested without parameters that it does not take */
      is_reference;
  unsigned notes; /* mask of the daemon's notes */
} cli_eval_model;

typedef struct cli_eval_report {
  cli_profile profile; /* `parameters` are for all models; each gets those that it takes */
  cli_quantities quantities;
  size_t model_count; /* how many models replied */
  cli_eval_model *models;
  bool chosen;               /* whether the daemon chose the model */
  const char *place;         /* where values are: "r", "f" or, of drawn radii, "u" */
  size_t place_count;        /* number of places; 0 if only the albedo is wanted */
  double *places;            /* [place_count] as the daemon used them: mm, 1/mm or a number */
  double least, most;        /* range of the finite places, set while the report is written */
  bool diverges;             /* a quantity diverges at r = 0, which model errors exclude */
  cli_eval_values *values;   /* [model_count * channel_count], model by model */
  const dipole_choice *draw; /* rule of drawn radii; else NULL */
  uint64_t seed, first;      /* of drawn radii: seed and position of the first number */
} cli_eval_report;

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
int cli_eval_request(const cli_settings *settings, dipole_client *client, cli_eval_report *report);

/* ---- drawing, in plot.c ---------------------------------------------------------------------- */

/* Draws R over r, which is one of the report's quantities, into the files; on a logarithmic axis if
 * the ratios between radii are equal. Says what is wrong and returns an exit status. */
int cli_plot_R(const cli_eval_report *report, const cli_texts *paths);

/* Reads the file of --mci and writes what MCML would estimate from it. Returns an exit status. */
int cli_mci(const cli_settings *settings);

#endif
